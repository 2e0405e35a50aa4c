"""`solver.threads`: solves with threads have the bits of solves without; refusals."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.errors import MbsError
from mbsrun.library import CompileError
from mbsrun.ocp.evaluation.stages import interface
from mbsrun.ocp.evaluation.stages import threads as teams
from mbsrun.ocp.methods import METHODS
from mbsrun.ocp.problem.problem import Form, Problem, Representation, SolverOptions
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.runs import Progress
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.checks import ProblemError
from tests.mbsrun.ocp.stages.shipped import read

SHOOTING = {"form": Form.SHOOTING, "representation": Representation.EXP1_O}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "arm of the paper": ("arm_reach", {"intervals": 8}),
    "free horizon": ("planar_arm_fastest", {"intervals": 8}),
    "closed loop": ("five_bar_reach", {"intervals": 6}),
    "quaternion": ("satellite_turn", {"intervals": 6}),
    "shooting, bounds": ("cart_pole_swing_up", {**SHOOTING, "intervals": 10, "degree": 3}),
    "path constraints": ("leg_step", {"intervals": 6}),
}


def use(problem: Problem, threads: int) -> Problem:
    return replace(problem, solver=replace(problem.solver, threads=threads))


def describe(outcome: Solution | Failure, path: list[Progress]) -> tuple[Any, ...]:
    """All numbers of an outcome except times."""
    assert isinstance(outcome, Solution), outcome
    motion = outcome.trajectory
    states = tuple(np.asarray(part).tobytes() for part in (motion.q, motion.qd, motion.u, motion.t, motion.point_qdd))
    return outcome.run.status, outcome.run.iterations, outcome.cost.total, states, tuple(path)


@pytest.mark.parametrize("name", CASES)
def test_threads_give_the_bits_of_one(name: str) -> None:
    """On one core and on several, whoever comes first."""
    file, changes = CASES[name]
    problem, plant = read(file, **changes)
    found = []
    for threads in (1, 2, 3):
        chosen, path = use(problem, threads), list[Progress]()
        found.append(describe(solve(chosen, plant, path.append), path))
    assert found[1:] == found[:1] * 2


def test_an_infeasible_problem_names_the_same_rows() -> None:
    problem, plant = read("cart_pole_swing_up", intervals=10, degree=3)
    weak = replace(problem, bounds=replace(problem.bounds, u=((-0.5, 0.5),)))
    found = [solve(use(weak, threads), plant) for threads in (1, 2)]
    assert all(isinstance(outcome, Failure) for outcome in found)
    assert len({(outcome.finding, outcome.run.iterations) for outcome in found if isinstance(outcome, Failure)}) == 1


def test_an_interrupt_ends_a_solve_with_threads() -> None:
    """The threads end, too: the next solve is a whole one."""
    problem, plant = read("cart_pole_swing_up", intervals=10, degree=3)

    def stop(progress: Progress) -> None:
        if progress.iteration == 2:
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            solve(use(problem, 2), plant, stop)
    assert isinstance(solve(use(problem, 2), plant), Solution)


@pytest.mark.parametrize(
    ("options", "finding"),
    [
        ({"threads": 2, "method": "ipopt"}, "found 2, but ipopt has one thread"),
        ({"threads": 2, "options": (("mu_strategy", "adaptive"),)}, "found 2, but ipopt has one thread"),
        ({"threads": 65}, "found 65"),
        ({"threads": 0}, "found 0"),
    ],
)
def test_threads_that_no_solve_has_are_refused(options: dict[str, Any], finding: str) -> None:
    problem, plant = read("cart_pole_swing_up", intervals=4, degree=3)
    with pytest.raises(ProblemError, match=f"solver.threads: {finding}"):
        Solver(replace(problem, solver=SolverOptions(**options)), plant)


@pytest.mark.parametrize("method", METHODS)
def test_another_method_keeps_threads_if_it_has_some(method: Any) -> None:
    """None stands for the default, which has threads."""
    kept = SolverOptions(threads=2).with_method(method).threads
    assert (kept == 2) == METHODS[method].has_threads


def test_a_compiler_without_threads_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread needs none of this."""

    def fail(*_: Any, **__: Any) -> Path:
        raise CompileError("pthread.h: no such file")

    problem, plant = read("cart_pole_swing_up", intervals=4, degree=3)
    monkeypatch.setattr(interface, "compile_library", fail)
    monkeypatch.setattr(teams, "load_threads", inspect.unwrap(interface.load_threads))
    with pytest.raises(MbsError, match=r"solver.threads: .* leave it out\. pthread.h: no such file"):
        solve(use(problem, 2), plant)
    assert isinstance(solve(problem, plant), Solution)


def test_times_of_workers_are_added() -> None:
    problem, plant = read("cart_pole_swing_up", intervals=10, degree=3)
    outcome = solve(use(problem, 2), plant)
    assert isinstance(outcome, Solution)
    run = outcome.run
    assert 0 < run.seconds_evaluating <= run.cpu_seconds_evaluating
