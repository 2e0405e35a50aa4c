"""Solvers that CasADi brings, given the kernels as external functions: fatrop, and IPOPT as the reference.

fatrop: Vanroye, Sathya, De Schutter, Decre (2023), a primal-dual interior-point method for problems in stages. It finds
the stages by the order of variables and constraints: states, then inputs; dynamics, then the torques.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.mpc.problem import JOINTS, STATES, Answer, Array, Iterate, Task
from mbsrun.external import OnDemand
from mbsrun.ocp.ground.linear import OWN, set_up

MODEL = Path(__file__).parents[1] / "models" / "panda.yaml"
QUIET: Mapping[str, Any] = {"print_time": False, "error_on_fail": False, "calc_lam_p": False}
KEPT: Mapping[str, Any] = {  # IPOPT stays near the point and the multipliers that it gets
    "warm_start_init_point": "yes",
    **dict.fromkeys(("warm_start_bound_push", "warm_start_mult_bound_push", "warm_start_bound_frac"), 1e-8),
}


@dataclass(frozen=True)
class Settings:
    """A solver of CasADi, and the options that it takes."""

    name: str
    options: Mapping[str, Any]
    linear: str = OWN  # IPOPT's linear solver
    multipliers: str = "zero"  # or `kept`: from the solution before, to start from

    def __str__(self) -> str:
        """Name the options as the solver does."""
        options = ", ".join(f"{name} {value}" for name, value in self.options.items() if name not in KEPT)
        linear = f"linear solver {self.linear}, " if self.name == "ipopt" else ""
        return f"{linear}{options}, {self.multipliers} multipliers"


REFERENCE = Settings("ipopt", {"tol": 1e-12, "bound_relax_factor": 0.0})


def list_settings(name: str) -> Iterator[Settings]:
    """List the grid of options that is searched for a solver; its defaults are the first."""
    if name == "fatrop":
        for tolerance, barrier in product((1e-8, 1e-7, 1e-6), (0.1, 1e-2, 1e-3)):
            yield Settings(name, {"tolerance": tolerance, "mu_init": barrier})
        return
    yield Settings(name, {"tol": 1e-8, "mu_init": 0.1}, "mumps")
    for tolerance, strategy in product((1e-8, 1e-7), ("monotone", "adaptive")):
        yield Settings(name, {"tol": tolerance, "mu_init": 0.1, "mu_strategy": strategy})
    for tolerance, barrier in product((1e-8, 1e-7), (1e-2, 1e-4, 1e-7)):
        options = {"tol": tolerance, "mu_init": barrier}
        yield Settings(name, options)
        yield Settings(name, {**options, **KEPT}, multipliers="kept")


def load_torque() -> ca.Function:
    """Return the Panda's inverse dynamics, (q, qd, a, u) -> torques less u, as a generated kernel."""
    return OnDemand(MODEL).casadi("impl")


class CasadiPeer:
    """A task as a nonlinear program in the order of its stages."""

    def __init__(self, task: Task, settings: Settings, torque: ca.Function) -> None:
        """Write the program with inverse dynamics, and make a solver for it."""
        name, self.name, self.settings, self._task = settings.name, settings.name, settings, task
        N, n = task.intervals, STATES + JOINTS
        states = [ca.MX.sym(f"x{k}", STATES) for k in range(N + 1)]
        inputs = [ca.MX.sym(f"a{k}", JOINTS) for k in range(N)]
        start = ca.MX.sym("start", STATES)
        rows, equality, bounds = [], [], []
        goal = np.concatenate([task.target, np.zeros(JOINTS)])
        Q, E = np.repeat(task.weights[:2], JOINTS), np.repeat(task.end_weights, JOINTS)
        cost = ca.dot(E, (states[N] - goal) ** 2) / 2
        for k, (x, a) in enumerate(zip(states[:-1], inputs, strict=True)):
            held = [x - start] if k == 0 else []  # fatrop takes no equal bounds
            rows.append(states[k + 1] - task.A @ x - task.B @ a)
            rows += [*held, torque(x[:JOINTS], x[JOINTS:], a, np.zeros(JOINTS))]
            equality += [True] * STATES * (1 + len(held)) + [False] * JOINTS
            bounds += [np.zeros(STATES * (1 + len(held))), task.torque]
            cost += task.step / 2 * (ca.dot(Q, (x - goal) ** 2) + task.weights[2] * ca.sumsqr(a))
        order = [v for pair in zip(states[:-1], inputs, strict=True) for v in pair]
        nlp: dict[str, Any] = {"x": ca.vertcat(*order, states[N]), "f": cost, "g": ca.vertcat(*rows), "p": start}
        own = {"print_level": 0, **settings.options}
        options = {**QUIET, name: own}
        if name == "fatrop":
            options |= {"structure_detection": "auto", "equality": equality}
        else:
            own |= {"sb": "yes", **set_up(settings.linear)}
        self._solver = ca.nlpsol("mpc", name, nlp, options)
        most = np.concatenate(bounds)
        self._bounds = {"lbg": -most, "ubg": most}
        inner = np.concatenate([task.lower_x, -task.acceleration]), np.concatenate([task.upper_x, task.acceleration])
        free = np.full(STATES, np.inf)
        self._lower = np.concatenate([-free, np.tile(inner[0], N)[STATES:], task.lower_x])
        self._upper = np.concatenate([free, np.tile(inner[1], N)[STATES:], task.upper_x])
        self._size = n

        self._given: dict[str, Any] = {}
        self._found: dict[str, Any] = {}

    def prepare(self, start: Array, guess: Iterate, *, shifts: bool) -> None:
        """Keep where solves begin."""
        packed = np.append(np.hstack([guess.x[:-1], guess.a]).ravel(), guess.x[-1])
        self._given = {"x0": packed, "p": start}
        if shifts and self.settings.multipliers == "kept":
            self._given |= self._shift()

    def _shift(self) -> dict[str, Array]:
        """Return the multipliers of the solution before, a step ahead; the last step keeps its own."""
        N, rows = self._task.intervals, STATES + JOINTS
        of_x, of_g = (self._found[name].full().ravel() for name in ("lam_x", "lam_g"))
        inner = of_x[: N * self._size].reshape(N, self._size)
        g = np.delete(of_g, np.arange(STATES, 2 * STATES)).reshape(N, rows)
        moved = np.vstack([g[1:], g[-1:]]).ravel()
        held = of_g[STATES : 2 * STATES]
        return {
            "lam_x0": np.append(np.vstack([inner[1:], inner[-1:]]).ravel(), of_x[N * self._size :]),
            "lam_g0": np.concatenate([moved[:STATES], held, moved[STATES:]]),
        }

    def solve(self) -> Answer:
        """Solve once."""
        N = self._task.intervals
        begin = time.process_time()
        found = self._solver(lbx=self._lower, ubx=self._upper, **self._given, **self._bounds)
        seconds = time.process_time() - begin
        told, self._found = self._solver.stats(), found
        answer = found["x"].full().ravel()
        stages = answer[: N * self._size].reshape(N, self._size)
        iterate = Iterate(np.vstack([stages[:, :STATES], answer[N * self._size :]]), stages[:, STATES:])
        return Answer(str(told["return_status"]), bool(told["success"]), int(told["iter_count"]), iterate, seconds)
