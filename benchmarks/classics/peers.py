"""The peer: a published problem in plain CasADi, by the same collocation on the same mesh, solved by IPOPT.

It takes the mesh, the scheme and the numbers of the guess from `mbsrun`, so that both begin at one point. The equations
are its own; CasADi differentiates them, and evaluates them in its virtual machine.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.kkt.transcription import Problem, Program, collocate, transcribe
from benchmarks.ocp.peer import Effort

Array = NDArray[np.float64]

COMMON: Mapping[str, Any] = {"print_level": 0, "sb": "yes", "max_iter": 500}
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "MUMPS": {"linear_solver": "mumps"},
    "MUMPS, adaptive": {"linear_solver": "mumps", "mu_strategy": "adaptive"},
    "MUMPS, tuned": {"linear_solver": "mumps", "mumps_scaling": 0, "mumps_pivot_order": 0},
}


class Peer:
    """A problem in plain CasADi, transcribed once and solved in several settings."""

    def __init__(
        self, problem: Problem, family: str, degree: int, intervals: int, *, is_constant: bool, tolerance: float
    ) -> None:
        """Transcribe it."""
        self._tolerance = tolerance
        scheme = collocate(family, degree, is_constant=is_constant)
        self.program: Program = transcribe(problem, scheme, intervals)
        self._solvers: dict[str, ca.Function] = {}

    @property
    def sizes(self) -> tuple[int, int]:
        """Count variables and rows."""
        return int(self.program.nlp["x"].numel()), int(self.program.nlp["g"].numel())

    def solve(self, setting: str, start: Array) -> Effort:
        """Solve from a start, in one of SETTINGS."""
        solver = self._solvers.get(setting)
        if solver is None:
            options = {**COMMON, "tol": self._tolerance, **SETTINGS[setting]}
            quiet = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False, "calc_lam_p": False}
            solver = ca.nlpsol("peer", "ipopt", self.program.nlp, {"expand": True, **quiet, "ipopt": options})
            self._solvers[setting] = solver
        p = self.program
        begin = time.process_time()
        answer = solver(x0=start, lbx=p.lower, ubx=p.upper, lbg=p.g_lower, ubg=p.g_upper)
        seconds = time.process_time() - begin
        done = solver.stats()
        evaluating = sum(value for key, value in done.items() if key.startswith("t_proc_nlp_"))
        return Effort(done["return_status"], done["iter_count"], float(answer["f"]), seconds, evaluating)


def place_start(states: Array, points: Array, inputs: Array, horizon: float | None) -> Array:
    """Put a guess into a peer's variables.

    States (N + 1, n) at the mesh points, (N, d, n) at the points, and inputs (N, values, m), one or d in an interval.
    """
    N = len(points)
    intervals = np.concatenate((states[:-1], points.reshape(N, -1), inputs.reshape(N, -1)), axis=1)
    return np.concatenate((intervals.ravel(), states[-1], [] if horizon is None else [horizon]))
