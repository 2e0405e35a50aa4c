"""Answers that are judged: a gap where a problem is convex, and another method where the first one has no answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.ground.status import ACCEPTABLE, INFEASIBLE, NOT_FEASIBLE, NOT_OPTIMAL, SOLVED, STALLED
from mbsrun.ocp.problem.problem import Bounds, Constraint, Cost, SolverOptions, Term
from mbsrun.ocp.solution.solution import Run, Solution
from mbsrun.ocp.solving import judging
from mbsrun.ocp.solving.judging import Outcome, _is_convex, _is_semidefinite, appeal, examine, tell_both, wants_other
from mbsrun.ocp.solving.optimality import Judgement
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

FREE = (FREE_RANGE,)
BOUNDED = Bounds(FREE, FREE, ((-9.0, 9.0),))
CASES: dict[str, tuple[dict[str, Any], bool]] = {
    "a quadratic cost": ({}, True),
    "a linear cost": ({"cost": Cost(0.0, terminal=(Term("qd_slide", -1.0),)), "bounds": BOUNDED, "end": None}, True),
    "a linear row": ({"constraints": (Constraint("q_slide + qd_slide", (-9.0, 9.0)),)}, True),
    "products that are convex": ({"cost": Cost(1.0, running=(Term("(q_slide - 2*u_slide)**2", 3.0),))}, True),
    "a cost of fourth degree": ({"cost": Cost(1.0, running=(Term("q_slide**4", 1.0),))}, False),
    "a curved row": ({"constraints": (Constraint("q_slide**2", (-9.0, 4.0)),)}, False),
    "a cost that bends down": ({"cost": Cost(1.0, running=(Term("(q_slide - u_slide)**2", -0.1),))}, False),
}


@pytest.mark.parametrize("name", CASES)
def test_convex_problems_have_a_gap(name: str) -> None:
    """Rows are linear, and the second derivatives of the cost are constant and not negative."""
    changes, is_convex = CASES[name]
    problem = push(4)
    changes = {key: replace(problem.end, velocity_zero=False) if key == "end" else x for key, x in changes.items()}
    found = solve(replace(problem, **changes), double_integrator())
    assert isinstance(found, Solution)
    assert (found.run.gap is not None) == is_convex
    if found.run.gap is not None:
        assert 0 <= found.run.gap <= 1e-5 * max(abs(found.cost.total), 1.0)


def test_another_method_is_asked_where_the_first_one_has_no_answer() -> None:
    """Of `mbs` alone, unless an option forbids it, and where no time is over."""
    run = Run(INFEASIBLE[0], 3, 0.0, 0.0, method="mbs")
    free = SolverOptions()
    assert wants_other(free, run)
    for status in (SOLVED, ACCEPTABLE, "Maximum_CpuTime_Exceeded", "Maximum_WallTime_Exceeded"):
        assert not wants_other(free, replace(run, status=status))
    assert not wants_other(free, replace(run, method="ipopt"))
    for fallback, expected in ((True, True), (False, False)):
        assert wants_other(SolverOptions(method="mbs", fallback=fallback), run) is expected
    assert not wants_other(SolverOptions(method="mbs"), run)


@dataclass(frozen=True)
class Lost:
    """A failure."""

    run: Run
    finding: str
    place: str = ""


@dataclass(frozen=True)
class Found:
    """An answer."""

    run: Run


def test_both_methods_are_named() -> None:
    first = Lost(Run(INFEASIBLE[0], 3, 0.0, 0.0, method="mbs"), "no way")
    answer = tell_both(first, Found(Run(SOLVED, 4, 0.0, 0.0, method="ipopt")))
    assert isinstance(answer, Found)
    assert answer.run.instead == "mbs had no answer (no way); this one is of ipopt"
    second = Lost(Run("Maximum_Iterations_Exceeded", 9, 0.0, 0.0, method="ipopt"), "too long")
    found = tell_both(first, second)
    assert isinstance(found, Lost)
    assert found.run is first.run
    assert found.finding.startswith("no way; ipopt, asked next, had no answer either (")
    same = tell_both(replace(first, place="cost"), replace(second, place="cost"))
    assert isinstance(same, Lost)
    assert same.finding == "no way; ipopt, asked next, had no answer either"
    apart = tell_both(replace(first, place="cost"), replace(second, place="end"))
    assert isinstance(apart, Lost)
    assert apart.finding.endswith(")")


# --- the judge's word -----------------------------------------------------------------------------------------------


def judged(**given: Any) -> Judgement:
    known = {"decrease": 0.0, "allowed": 1e-3, "reach": 2.0, "violation": 0.0, "allowed_violation": 1e-6}
    return Judgement(**(known | given), is_sure=given.pop("is_sure", True))  # type: ignore[arg-type]


def look(monkeypatch: pytest.MonkeyPatch, found: Judgement | None, *, is_convex: bool = False) -> tuple[Run, str]:
    monkeypatch.setattr(judging, "_judge", lambda *_: found)
    monkeypatch.setattr(judging, "_is_convex", lambda *_: is_convex)
    outcome: Any = SimpleNamespace(run=Run(SOLVED, 3, 0.0, 0.0))
    return examine(None, outcome, SolverOptions(), 1.0)  # type: ignore[arg-type]


def test_a_run_has_what_the_judge_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A violation first; a decrease where it is sure; a gap where the problem is convex."""
    assert look(monkeypatch, None) == (Run(SOLVED, 3, 0.0, 0.0), "")
    bad = {"violation": 2e-6, "decrease": 1.0}
    run, cause = look(monkeypatch, replace(judged(), **bad))
    assert (run.status, run.decrease) == (NOT_FEASIBLE, None)
    assert cause == "by 2.0e-06 of the sizes of their terms, where 1e-06 is allowed"
    unsure = replace(judged(), decrease=1.0, is_sure=False)
    assert look(monkeypatch, unsure, is_convex=True) == (Run(SOLVED, 3, 0.0, 0.0), "")
    run, cause = look(monkeypatch, replace(judged(), decrease=0.5), is_convex=True)
    assert (run.status, run.decrease, run.reach, run.gap) == (NOT_OPTIMAL, 0.5, 2.0, None)
    assert cause.endswith("by 2.5e-01 of the decrease that its gradient alone permits; 5e-04 is the limit")
    for is_convex in (True, False):
        run, cause = look(monkeypatch, replace(judged(), decrease=1e-4), is_convex=is_convex)
        assert (run.status, run.decrease, run.reach, cause) == (SOLVED, 1e-4, 2.0, "")
        assert run.gap == (1e-4 if is_convex else None)
    assert judged(reach=0.0).ratio == 0.0


def test_an_outcome_without_more_digits_is_acceptable_where_it_is_optimal(monkeypatch: pytest.MonkeyPatch) -> None:
    for found, status, x, expected in (
        (judged(), STALLED, 1.0, ACCEPTABLE),
        (judged(), "other", 1.0, "other"),
        (judged(), STALLED, float("nan"), STALLED),
        (None, STALLED, 1.0, STALLED),
        (replace(judged(), violation=1.0), STALLED, 1.0, STALLED),
        (replace(judged(), decrease=1.0), STALLED, 1.0, STALLED),
    ):
        monkeypatch.setattr(judging, "_judge", lambda *_, found=found: found)
        outcome: Any = Outcome(Run(status, 3, 0.0, 0.0), np.array([x]), (), None, None)  # type: ignore[arg-type]
        assert appeal(None, outcome, SolverOptions(), 1.0).run.status == expected  # type: ignore[arg-type]


def test_semidefinite_matrices_are_judged_block_by_block() -> None:
    """Down to -1e-12 of the largest entry."""
    for least, expected in ((0.0, True), (-0.9e-12, True), (-1.1e-12, False), (-1.0, False)):
        H = sparse.csc_array(np.diag([4.0, 4 * least, 1.0]))
        assert _is_semidefinite(H, 4.0) is expected
    mixed = np.zeros((4, 4))
    mixed[np.ix_([0, 2], [0, 2])] = [[1.0, 2.0], [2.0, 1.0]]
    assert not _is_semidefinite(sparse.csc_array(mixed + np.diag([0.0, 5.0, 0.0, 5.0])), 5.0)
    mixed[np.ix_([0, 2], [0, 2])] = [[2.0, 2.0], [2.0, 2.0]]
    assert _is_semidefinite(sparse.csc_array(mixed + np.diag([0.0, 5.0, 0.0, 5.0])), 5.0)


class Bent(NumpyProgram):
    """A cost sum H x^2/2 in two variables with a part that varies with x."""

    def __init__(self, H: list[list[float]], change: float = 0.0, *, has_curved_rows: bool = False) -> None:
        self.H, self.change, self._curved = np.array(H), change, has_curved_rows

    @property
    def has_curved_rows(self) -> bool:
        return self._curved

    def hessian(self, x: Any, p: Any, weight: float, rows: Any) -> Any:  # noqa: ARG002  # as of programs
        assert weight == 1.0
        assert not rows.any()
        return sparse.triu(sparse.csc_array(self.H + self.change * x[0] * np.eye(2)), format="csc")


@pytest.mark.parametrize(
    ("program", "is_convex"),
    [
        (Bent([[2e-3, 1e-3], [1e-3, 2e-3]]), True),
        (Bent([[2e-3, 3e-3], [3e-3, 2e-3]]), False),
        (Bent([[2e-3, 1e-3], [1e-3, 2e-3]], 1e-12), False),
        (Bent([[2e3, 1e3], [1e3, 2e3]], 1e-11), True),
        (Bent([[2.0, 0.0], [0.0, -1e-3]]), False),
        (Bent([[2.0, 0.0], [0.0, 2.0]], has_curved_rows=True), False),
        (Bent([[2.0, 0.0], [0.0, 2.0]], float("nan")), False),
        (Bent([[0.0, 0.0], [0.0, 0.0]]), True),
        (SimpleNamespace(has_curved_rows=False), False),
    ],
)
def test_a_cost_is_convex_where_its_second_derivatives_stay_and_are_not_negative(program: Any, is_convex: bool) -> None:
    """Relative to the largest of them, however small it is; of programs that NumPy evaluates alone."""
    prepared: Any = SimpleNamespace(numpy=program, data=SimpleNamespace(constraints=3))
    outcome: Any = SimpleNamespace(x=np.array([0.5, 1.0]), start=SimpleNamespace(parameters=None))
    assert _is_convex(prepared, outcome) is is_convex
