"""Solvers that CasADi brings, given the kernels as external functions: fatrop, and IPOPT as the reference.

fatrop: Vanroye, Sathya, De Schutter, Decre (2023), a primal-dual interior-point method for problems in stages. It finds
the stages by the order of variables and constraints: states, then inputs; dynamics, then the torques.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.mpc.problem import JOINTS, STATES, Answer, Array, Iterate, Task
from mbsrun.external import OnDemand
from mbsrun.ocp.linear import OWN, set_up

MODEL = Path(__file__).parents[1] / "models" / "panda.yaml"
QUIET: Mapping[str, Any] = {"print_time": False, "error_on_fail": False, "calc_lam_p": False}
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "fatrop": {"fatrop": {"tolerance": 1e-7, "print_level": 0}},
    "ipopt": {"ipopt": {"tol": 1e-7, "print_level": 0, "sb": "yes"}},
}


def load_torque() -> ca.Function:
    """Return the Panda's inverse dynamics, (q, qd, a, u) -> torques less u, as a generated kernel."""
    return OnDemand(MODEL).casadi("impl")


class CasadiPeer:
    """A task as a nonlinear program in the order of its stages."""

    def __init__(self, task: Task, name: str, torque: ca.Function) -> None:
        """Write the program with inverse dynamics, and make a solver of SETTINGS for it."""
        self.name, self._task = name, task
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
        options = {**QUIET, **SETTINGS[name]}
        if name == "fatrop":
            options |= {"structure_detection": "auto", "equality": equality}
        else:
            options["ipopt"] = {**options["ipopt"], **set_up(OWN)}
        self._solver = ca.nlpsol("mpc", name, nlp, options)
        most = np.concatenate(bounds)
        self._bounds = {"lbg": -most, "ubg": most}
        inner = np.concatenate([task.lower_x, -task.acceleration]), np.concatenate([task.upper_x, task.acceleration])
        free = np.full(STATES, np.inf)
        self._lower = np.concatenate([-free, np.tile(inner[0], N)[STATES:], task.lower_x])
        self._upper = np.concatenate([free, np.tile(inner[1], N)[STATES:], task.upper_x])
        self._size = n

    def solve(self, start: Array, guess: Iterate, rounds: int) -> Answer:
        """Solve from a state of the robot and a guess, several times; return the quickest answer."""
        return min((self._solve(start, guess) for _ in range(rounds)), key=lambda answer: answer.seconds)

    def _solve(self, start: Array, guess: Iterate) -> Answer:
        N = self._task.intervals
        packed = np.append(np.hstack([guess.x[:-1], guess.a]).ravel(), guess.x[-1])
        begin = time.process_time()
        found = self._solver(x0=packed, p=start, lbx=self._lower, ubx=self._upper, **self._bounds)
        seconds = time.process_time() - begin
        told = self._solver.stats()
        answer = found["x"].full().ravel()
        stages = answer[: N * self._size].reshape(N, self._size)
        iterate = Iterate(np.vstack([stages[:, :STATES], answer[N * self._size :]]), stages[:, STATES:])
        return Answer(str(told["return_status"]), bool(told["success"]), int(told["iter_count"]), iterate, seconds)
