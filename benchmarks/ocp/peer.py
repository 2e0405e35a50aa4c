"""The peer: the same optimal control problem in plain CasADi, as its users write it.

The equations of motion are an afternoon's Newton-Euler in SX, mapped over the collocation points; CasADi differentiates
the whole, and runs it in its virtual machine, or as C that it generates and compiles. It takes nothing from `mbsrun`
but the values of a problem and a guess, and has points and weights of its own.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.problem import Problem
from mbsrun.ocp.trajectory import Trajectory

Array = NDArray[np.float64]

FLAGS = ["-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno"]


@dataclass(frozen=True)
class Effort:
    """What a solve took, in processor time."""

    status: str
    iterations: int
    cost: float
    cpu_seconds: float
    cpu_seconds_evaluating: float


class Peer:
    """A transcribed problem."""

    def __init__(
        self,
        problem: Problem,
        dynamics: Mapping[str, ca.Function],
        place: ca.Function,
        ipopt: Mapping[str, Any],
        is_compiled: bool,
    ) -> None:
        """Write the program, and make IPOPT for it; `place` gives the position of the sensor that has a target."""
        begin = time.perf_counter()
        self.problem = problem
        representation, N, d = problem.representation, problem.intervals, problem.degree
        n, m, h = len(problem.start_q), len(problem.bounds.u), problem.horizon / problem.intervals
        points_of_scheme = ca.collocation_points(d, problem.family.value)
        C, D, _ = (ca.sparsify(c, 1e-12) for c in ca.collocation_coeff(points_of_scheme))  # Radau's D is 1 at the end
        has_z = not representation.is_ode
        w: list[ca.MX] = []
        bounds: list[Array] = []
        states = np.array(problem.bounds.q + problem.bounds.qd)

        def new(name: str, size: int, limits: Array | None = None) -> ca.MX:
            w.append(ca.MX.sym(name, size))
            bounds.append(np.tile((-np.inf, np.inf), (size, 1)) if limits is None else limits)
            return w[-1]

        mesh, points, z, u = [new("x0", 2 * n, states)], [], [], []
        for k in range(N):
            for j in range(d):
                points.append(new(f"x{k}_{j}", 2 * n, states))
                if has_z:
                    z.append(new(f"z{k}_{j}", n))
            u.append(new(f"u{k}", m, np.array(problem.bounds.u).reshape(-1, 2)))
            mesh.append(new(f"x{k + 1}", 2 * n, states))
        X, U = ca.horzcat(*points), ca.horzcat(*(u[i // d] for i in range(N * d)))
        kernel = dynamics[{"IMPL": "impl", "SEMI": "semi"}.get(representation.value, "exp")]
        inputs = (X[:n, :], X[n:, :], ca.horzcat(*z), U) if not representation.is_explicit else (X[:n, :], X[n:, :], U)
        values = kernel.map(N * d)(*inputs)
        Z = ca.horzcat(*z) if has_z else values
        residual = (Z - values if representation.is_explicit else values) if has_z else None
        slopes = ca.vertcat(X[n:, :], Z)
        g: list[Any] = [mesh[0] - np.array(problem.start_q + problem.start_qd)]
        for k in range(N):
            nodes = ca.horzcat(mesh[k], *points[k * d : (k + 1) * d])
            for j in range(d):
                g.append(nodes @ C[:, j] - h * slopes[:, k * d + j])
                if residual is not None:
                    g.append(residual[:, k * d + j])
            g.append(nodes @ D - mesh[k + 1])
        end_q, end_qd = mesh[-1][:n], mesh[-1][n:]
        target = np.array(problem.end.sensors[0][1])
        # Radau's last point is the end
        end_z = z[-1] if has_z else dynamics["exp"](end_q, end_qd, u[-1])
        g += [place(end_q) - target, end_qd, end_z]
        inputs_cost = h * sum(ca.sumsqr(v) for v in u)
        rates_cost = sum(ca.sumsqr(u[k + 1] - u[k]) for k in range(N - 1)) / h
        nlp: dict[str, Any] = {
            "x": ca.vertcat(*w),
            "f": problem.cost.inputs * inputs_cost + problem.cost.input_rates * rates_cost,
            "g": ca.vertcat(*g),
        }
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False}
        options["ipopt"] = {"print_level": 0, "sb": "yes", "tol": 1e-8, **ipopt}
        if is_compiled:
            options |= {"jit": True, "compiler": "shell", "jit_options": {"flags": FLAGS, "verbose": False}}
        self._solver = ca.nlpsol("peer", "ipopt", nlp, options)
        self._lower, self._upper = np.concatenate(bounds).T
        self.variables, self.constraints = int(nlp["x"].numel()), int(nlp["g"].numel())
        self.jacobian_nonzeros = int(self._solver.get_function("nlp_jac_g").nnz_out(1))
        self.seconds_building = time.perf_counter() - begin

    def solve(self, guess: Trajectory) -> Effort:
        """Solve from a guess."""
        begin = time.process_time()
        answer = self._solver(x0=self._pack(guess), lbx=self._lower, ubx=self._upper, lbg=0, ubg=0)
        seconds, statistics = time.process_time() - begin, self._solver.stats()
        evaluating = sum(value for key, value in statistics.items() if key.startswith("t_proc_nlp_"))
        cost = float(answer["f"])
        return Effort(statistics["return_status"], statistics["iter_count"], cost, seconds, evaluating)

    def _pack(self, guess: Trajectory) -> Array:
        parts = [guess.q[0], guess.qd[0]]
        for k in range(self.problem.intervals):
            for j in range(self.problem.degree):
                parts += [guess.point_q[k, j], guess.point_qd[k, j]]
                if not self.problem.representation.is_ode:
                    parts.append(guess.point_qdd[k, j])
            parts += [guess.u[k], guess.q[k + 1], guess.qd[k + 1]]
        return np.concatenate(parts)


def write_dynamics(functions: Mapping[str, ca.Function]) -> dict[str, ca.Function]:
    """Give impl, semi (M qdd + c - Q) and exp, of impl and exp alone, without common subexpressions."""
    impl, exp = functions["impl"], functions["exp"]
    q, qd, qdd, u = (ca.SX.sym(impl.name_in(i), impl.size1_in(i)) for i in range(4))
    M = ca.jacobian(impl(q, qd, qdd, u), qdd)
    semi = M @ qdd + impl(q, qd, ca.SX(qdd.numel(), 1), u)
    options = {"cse": True}
    return {
        "impl": ca.Function("impl", [q, qd, qdd, u], [impl(q, qd, qdd, u)], options),
        "semi": ca.Function("semi", [q, qd, qdd, u], [semi], options),
        "exp": ca.Function("exp", [q, qd, u], [exp(q, qd, u)], options),
    }


def list_settings(problem: Problem) -> dict[str, dict[str, Any]]:
    """Give IPOPT's options by name: its own defaults, and those that were found to be fastest."""
    scale = 1 / max(problem.cost.inputs, problem.cost.input_rates)
    mumps = {"mumps_pivot_order": 0, "mumps_scaling": 0, "mumps_permuting_scaling": 0}
    return {"defaults": {}, "tuned": {"nlp_scaling_method": "none", "obj_scaling_factor": scale, **mumps}}
