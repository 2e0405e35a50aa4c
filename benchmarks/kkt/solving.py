"""Solve a program by IPOPT with one linear solver or another, all else equal; IPOPT's own clock measures the algebra.

IPOPT counts what a linear solver takes, with the conversion of its matrices, as `StdAugSystemSolverMultiSolve`.
"""

from __future__ import annotations

import math
import multiprocessing
import re
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca

from benchmarks.kkt.transcription import Problem, Program, Scheme, transcribe
from mbsrun.ocp.ground.linear import MUMPS, OWN, set_up

SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
SAME = 1e-6  # relative difference of costs within which two optima are one
LIMIT = 40.0  # s by the clock, after which a first solve by MUMPS is ended: within a factorisation IPOPT cannot do that
LONG = 2.0  # s; a program that one solver takes longer for is solved once
DEFAULTS = "mumps, defaults"
SOLVERS: tuple[str, ...] = (OWN, MUMPS, DEFAULTS)
COMMON: Mapping[str, Any] = {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 500}
_FORKED = multiprocessing.get_context("fork")
_ALGEBRA = re.compile(r"StdAugSystemSolverMultiSolve\.*:\s+([\d.]+) \(sys:\s+([\d.]+)")


@dataclass(frozen=True)
class Effort:
    """The effort of a solve: iterations, and seconds of the processor."""

    status: str
    iterations: int
    cost: float
    seconds: float
    seconds_algebra: float


@dataclass(frozen=True)
class Row:
    """A program, solved by one linear solver: the quickest of several rounds, and the median."""

    problem: str
    scheme: str
    variables: int
    constraints: int
    solver: str
    status: str
    iterations: int
    cost: float
    rounds: int
    seconds: float
    seconds_median: float
    seconds_algebra: float
    seconds_algebra_median: float

    @property
    def is_solved(self) -> bool:
        """Return whether IPOPT converged, to its tolerance or to the acceptable one."""
        return self.status in SOLVED


@dataclass(frozen=True)
class Case:
    """The rows of a program: the project's solver, then MUMPS with the project's options and with IPOPT's."""

    rows: tuple[Row, ...]
    optimum: float | None
    digits: float

    @property
    def own(self) -> Row:
        """Return the row of the project's solver."""
        return self.rows[0]

    @property
    def peer(self) -> Row:
        """Return the quicker row of MUMPS; a solved one, if there is one."""
        peers = [row for row in self.rows[1:] if row.is_solved] or self.rows[1:]
        return min(peers, key=lambda row: row.seconds_algebra)

    @property
    def is_lost(self) -> bool:
        """Return whether MUMPS solves it, and the project's solver does not, or ends in a worse minimum."""
        solved = [row.cost for row in self.rows[1:] if row.is_solved]
        if not solved:
            return False
        return not self.own.is_solved or self.own.cost > max(solved) + SAME * abs(max(solved))

    @property
    def is_same(self) -> bool:
        """Return whether all that converge have one optimum."""
        costs = [row.cost for row in self.rows if row.is_solved]
        return all(abs(cost - costs[0]) <= SAME * abs(costs[0]) for cost in costs)

    @property
    def is_comparable(self) -> bool:
        """Return whether both converge to one optimum, in about as many iterations."""
        own, peer = self.own, self.peer
        return self.is_same and own.is_solved and peer.is_solved and abs(own.iterations - peer.iterations) <= 3

    @property
    def algebra(self) -> float:
        """Return the time of MUMPS over the time of the project's solver, for linear algebra."""
        return self.peer.seconds_algebra / self.own.seconds_algebra

    @property
    def algebra_median(self) -> float:
        """Return the same by the medians of rounds."""
        return self.peer.seconds_algebra_median / self.own.seconds_algebra_median

    @property
    def whole(self) -> float:
        """Return the same for whole solves."""
        return self.peer.seconds / self.own.seconds


def list_options(solver: str) -> Mapping[str, Any]:
    """Return the options of IPOPT that choose a solver of SOLVERS."""
    return {"linear_solver": "mumps"} if solver == DEFAULTS else set_up(solver)


class Attempt:
    """IPOPT for a program, with one linear solver."""

    def __init__(self, program: Program, solver: str, folder: Path, twin: Attempt | None = None) -> None:
        """Make it, with the functions of a twin; IPOPT writes its statistics to a file of the folder."""
        self._program, self._told = program, folder / f"{solver}.txt"
        told: dict[str, Any] = {"output_file": str(self._told), "file_print_level": 4, "print_timing_statistics": "yes"}
        self._solver = ca.nlpsol(
            "kkt",
            "ipopt",
            program.nlp,
            {
                "expand": True,
                "print_time": False,
                "error_on_fail": False,
                "show_eval_warnings": False,
                "calc_lam_p": False,
                "no_nlp_grad": True,
                **(twin.functions if twin else {}),
                "ipopt": {**COMMON, **told, **list_options(solver)},
            },
        )

    @property
    def functions(self) -> dict[str, ca.Function]:
        """Return the derivatives, for another solver of the same program."""
        names = {"grad_f": "nlp_grad_f", "jac_g": "nlp_jac_g", "hess_lag": "nlp_hess_l"}
        return {option: self._solver.get_function(name) for option, name in names.items()}

    def solve(self) -> Effort:
        """Solve from the start of the program."""
        p = self._program
        begin = time.process_time()
        answer = self._solver(x0=p.start, lbx=p.lower, ubx=p.upper, lbg=p.g_lower, ubg=p.g_upper)
        seconds = time.process_time() - begin
        done = self._solver.stats()
        user, system = _ALGEBRA.findall(self._told.read_text("utf-8", errors="replace"))[-1]
        cost = float(answer["f"])
        return Effort(done["return_status"], done["iter_count"], cost, seconds, float(user) + float(system))


def solve_within(attempt: Attempt, seconds: float) -> Effort:
    """Solve in another process, which is ended after some seconds."""
    receiver, sender = _FORKED.Pipe(duplex=False)
    process = _FORKED.Process(target=lambda: sender.send(attempt.solve()))
    process.start()
    effort = receiver.recv() if receiver.poll(seconds) else Effort("Time_Limit", 0, math.nan, seconds, seconds)
    process.kill()
    process.join()
    return effort if isinstance(effort, Effort) else Effort("No_Answer", 0, math.nan, seconds, seconds)


def make_attempts(program: Program, folder: Path) -> dict[str, Attempt]:
    """Make IPOPT for all linear solvers."""
    first = Attempt(program, OWN, folder)
    return {OWN: first, **{solver: Attempt(program, solver, folder, first) for solver in SOLVERS if solver != OWN}}


def measure(problem: Problem, scheme: Scheme, rounds: int, intervals: int | None = None) -> Case:
    """Solve a problem by all linear solvers; then by the project's and the quicker MUMPS in turn, once a round."""
    program = transcribe(problem, scheme, intervals)
    with tempfile.TemporaryDirectory() as folder:
        attempts = make_attempts(program, Path(folder))
        efforts = {OWN: [attempts[OWN].solve()]}
        efforts |= {solver: [solve_within(attempts[solver], LIMIT)] for solver in SOLVERS if solver != OWN}
        peers = [x for x in SOLVERS[1:] if efforts[x][0].status in SOLVED] or SOLVERS[1:]
        quicker = min(peers, key=lambda solver: efforts[solver][0].seconds_algebra)
        pair = (OWN, quicker)
        is_long = max(efforts[solver][0].seconds for solver in pair) > LONG
        for _ in range(1, 1 if is_long else rounds):
            for solver in pair:
                efforts[solver].append(attempts[solver].solve())
    sizes = int(program.nlp["x"].numel()), int(program.nlp["g"].numel())
    rows = [_make_row(problem, scheme, sizes, solver, efforts[solver]) for solver in SOLVERS]
    return Case(tuple(rows), problem.optimum, problem.digits)


def _make_row(problem: Problem, scheme: Scheme, sizes: tuple[int, int], solver: str, efforts: Sequence[Effort]) -> Row:
    first = efforts[0]
    whole, algebra = [e.seconds for e in efforts], [max(e.seconds_algebra, 5e-4) for e in efforts]
    return Row(
        problem.name,
        scheme.name,
        *sizes,
        solver,
        first.status,
        first.iterations,
        first.cost,
        len(efforts),
        min(whole),
        statistics.median(whole),
        min(algebra),
        statistics.median(algebra),
    )
