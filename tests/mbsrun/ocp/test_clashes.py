"""Descriptions of a failed search: the worst violation first, its limits, and the ends that it stands against."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.transcription.clashes import Found, Names, describe, describe_point, see_solver

NAMES = Names(
    {0: "the bounds of x", 1: "the bounds of v", 3: "the input"},
    {0: "friction", 1: "end: x", 2: "the loops in interval 1", 3: "start: x", 4: "constraint a"},
    frozenset({2}),
)


def make(**changes: Any) -> Found:
    """Make a point at which nothing is violated or at a limit, and only row 1 is an equation."""
    inside = Found(
        x=np.zeros(4),
        bounds=(np.full(4, -5.0), np.full(4, 5.0)),
        g=np.zeros(5),
        row_bounds=(np.array([-1.0, 0.0, -1.0, -1.0, -np.inf]), np.array([1.0, 0.0, 1.0, 1.0, 1.0])),
    )
    return replace(inside, **changes)


def rows(*values: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(values)


def test_nothing_violated_says_nothing() -> None:
    assert describe_point(make(), NAMES) == ""
    assert describe_point(make(x=rows(5, 0, 0, 0)), NAMES) == ""  # at a limit, and nothing else
    assert describe_point(make(g=rows(0, 0.9e-6, 0, 0, 0)), NAMES) == ""
    assert describe_point(make(g=rows(0, 1.1e-6, 0, 0, 0)), NAMES) == "end: x"


def test_the_worst_violation_comes_first() -> None:
    """Beyond lower and upper limits alike; variables as well, from their own tolerance on."""
    text = describe_point(make(g=rows(-1.5, 0.25, 0, 1.75, 0)), NAMES)
    assert text.startswith("start: x, friction, end: x")
    text = describe_point(make(g=rows(0, 0.25, 0, 0, 0), x=rows(-5.5, 0, 9, 0)), NAMES)  # variable 2 has no name
    assert text.startswith("the bounds of x, end: x")
    text = describe_point(make(g=rows(0, 0.25, 0, 0, 0), x=rows(5 + 0.5e-4, 0, 0, 0)), NAMES)
    assert text == "end: x; at their limits: the bounds of x"
    text = describe_point(make(g=rows(0, 0.25, 0, 0, 0), x=rows(5 + 2e-4, 0, 0, 0)), NAMES)
    assert text.startswith("end: x, the bounds of x")


def test_equations_of_the_motion_are_named_where_no_condition_is_violated() -> None:
    assert describe_point(make(g=rows(0, 0, 7, 0, 0)), NAMES).startswith("the loops in interval 1")
    assert "loops" not in describe_point(make(g=rows(0, 0.5, 7, 0, 0)), NAMES)


def test_conditions_of_the_end_are_what_others_stand_against() -> None:
    """Unless a condition of the start or of the end gives way itself."""
    assert describe_point(make(g=rows(3, 0, 0, 0, 0)), NAMES) == "friction, against end: x"
    assert describe_point(make(g=rows(3, 0, 0, 2, 0)), NAMES) == "friction, start: x"
    assert describe_point(make(g=rows(3, 0.5, 0, 0, 0)), NAMES) == "friction, end: x"
    free = make(g=rows(3, 0, 0, 0, 0), row_bounds=(np.full(5, -1.0), np.ones(5)))
    assert describe_point(free, NAMES) == "friction"


def test_limits_that_bind_are_listed() -> None:
    """Ranges alone: equal bounds are given values, which are no limits; near counts beside 1, or beside the value."""
    text = describe_point(make(g=rows(3, 0, 0, 0, 1 - 0.9e-4), x=rows(0, -5, 0, 4.9)), NAMES)
    assert text == "friction, against end: x; at their limits: the bounds of v, constraint a"
    far = make(g=rows(3, 0, 0, 0, 1 - 2.2e-4), x=rows(0, 5 - 5e-4, 0, 5 - 7e-4))
    assert describe_point(far, NAMES) == "friction, against end: x; at their limits: the bounds of v"
    held = make(g=rows(3, 0, 0, 0, 0), bounds=(np.zeros(4), np.zeros(4)))
    assert describe_point(held, NAMES) == "friction, against end: x"


def test_four_descriptions_are_shown_each_once() -> None:
    many = Names({}, {i: f"row {i // 2}" for i in range(12)}, frozenset())
    assert describe([0, 1, 2, 3, 4, 6], many) == "row 0, row 1, row 2, row 3"
    assert describe([8, 0, 2, 4, 6], many) == "row 4, row 0, row 1, row 2, ..."
    assert describe([99], many) == ""


def test_numbers_that_are_none_are_no_violation() -> None:
    assert describe_point(make(g=rows(np.nan, 0, 0, 0, 0)), NAMES) == ""


def test_a_solver_sees_the_variables_and_rows_that_are_kept() -> None:
    program = SimpleNamespace(kept=np.array([1, 3]), kept_rows=np.array([2, 4]))
    assert see_solver(NAMES, cast(Program, program)) == Names(
        {0: "the bounds of v", 1: "the input"}, {0: "the loops in interval 1", 1: "constraint a"}, frozenset({0})
    )
