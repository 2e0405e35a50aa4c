"""Answers that are judged: a gap where a problem is convex, and another method where the first one has no answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from mbsrun.ocp.ground.status import ACCEPTABLE, INFEASIBLE, SOLVED
from mbsrun.ocp.problem.problem import Bounds, Constraint, Cost, SolverOptions, Term
from mbsrun.ocp.solution.solution import Run, Solution
from mbsrun.ocp.solving.judging import tell_both, wants_other
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
