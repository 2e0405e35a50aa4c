"""Kinks of given motions, by hand, and courses of driven joints."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsgen.expressions import parse
from mbsrun.simulation.course import Course, check_course, find_jump, follow, stand
from mbsrun.simulation.drive import DriveError


@pytest.mark.parametrize(
    ("text", "time", "change", "function"),
    [
        ("abs(t - 0.3)", 0.3, 2.0, "abs"),
        ("-a*abs(2*t - 0.6)", 0.3, -12.0, "abs"),
        ("max(t, 0.75)", 0.75, 1.0, "max"),
        ("max(0.75, 3*t)", 0.25, 3.0, "max"),
        ("min(t, 0.75)", 0.75, -1.0, "min"),
        ("5*t + sin(abs(t - 0.5))", 0.5, 2.0, "abs"),
        ("abs(t - 0.6) + max(t, 0.2)", 0.2, 1.0, "max"),
        ("max(t, 0.6) + abs(t - 0.2)", 0.2, 2.0, "abs"),
        ("abs(abs(t - 0.5) - 0.25)", 0.25, 2.0, "abs"),
        ("abs(t - 0.999)", 0.999, 2.0, "abs"),
        ("abs(t - 1e-3)", 1e-3, 2.0, "abs"),
    ],
)
def test_the_first_jump_of_a_velocity_is_found(text: str, time: float, change: float, function: str) -> None:
    """To rounding of the time, with the function that makes it."""
    jump = find_jump(parse(text), {"a": 3.0}, 1.0)
    assert jump is not None
    assert jump.time == pytest.approx(time, abs=1e-14)
    assert jump.change == pytest.approx(change, rel=1e-6)
    assert jump.function == function


@pytest.mark.parametrize(
    "text",
    ["t**2", "abs(t + 0.1)", "abs(t - 1.1)", "abs(a)*t", "abs(t - 0.5)**3", "max(t, 1.5)", "0*abs(t - 0.5)", "sqrt(t)"],
)
def test_velocities_without_a_jump_have_none(text: str) -> None:
    assert find_jump(parse(text), {"a": 3.0}, 1.0) is None


@pytest.mark.parametrize(("part", "jumps"), [(0.9e-6, False), (1.1e-6, True)])
def test_a_jump_of_rounding_is_none(part: float, jumps: bool) -> None:
    """Up to 1e-6 of the largest velocity, here of 4."""
    assert (find_jump(parse(f"4*t + {2 * part}*abs(t - 0.5)"), {}, 1.0) is not None) == jumps


@pytest.mark.parametrize("duration", [0.01, 1.0, 250.0])
def test_jumps_are_found_in_motions_of_any_duration(duration: float) -> None:
    jump = find_jump(parse("abs(t - s)"), {"s": 0.37 * duration}, duration)
    assert jump is not None
    assert jump.time == pytest.approx(0.37 * duration, rel=1e-14)


def test_a_steep_course_is_no_jump() -> None:
    """Where the velocity goes on changing beside a kink by more than at it, the change is the course's."""
    assert find_jump(parse("1e-4*tanh(1e7*(t - 0.5)) + 1e-4*abs(t - 0.5)"), {}, 1.0) is None


def make_manifest() -> Any:
    names = ("a", "b.qx", "c", "d")
    return SimpleNamespace(
        coordinates=[SimpleNamespace(name=name) for name in ("a", "b", "c", "d")], positions=names, driven=(2, 3)
    )


@pytest.mark.parametrize(("off", "is_there"), [(2.9e-9, True), (3.1e-9, False)])
@pytest.mark.parametrize("entry", [2, 3])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_start_is_where_the_course_begins(off: float, is_there: bool, entry: int, sign: int) -> None:
    """To 1e-9 of 1 + its size, here of 2; velocities too."""
    course = follow([parse("-2 + 2*t"), parse("2 - 2*t")], ["c", "d"], {})
    q, qd = np.array([9.0, 9.0, -2.0, 2.0]), np.array([9.0, 9.0, 2.0, -2.0])
    check_course(make_manifest(), course, q, qd)
    for kind, x in (("q", q), ("qd", qd)):
        x[entry] += sign * off
        if is_there:
            check_course(make_manifest(), course, q, qd)
        else:
            with pytest.raises(ValueError, match=f"{kind} of driven joint {'cd'[entry - 2]} starts at"):
                check_course(make_manifest(), course, q, qd)
        x[entry] -= sign * off
    with pytest.raises(ValueError, match=r"the course has shape \(1,\); 2 driven joints expected"):
        check_course(make_manifest(), stand([1.0]), q, qd)


def test_courses_have_their_derivatives() -> None:
    course = follow([parse("a*t**3"), parse("a")], ["c", "d"], {"a": 2.0})
    for found, expected in zip(course.at(3.0), ([54.0, 2.0], [54.0, 0.0], [36.0, 0.0]), strict=True):
        assert found == pytest.approx(expected)
    assert not course.is_constant
    assert follow([parse("a")], ["c"], {"a": 2.0}).is_constant
    held: Course = stand([1.0, 2.0])
    assert held.is_constant
    assert [x.tolist() for x in held.states(np.zeros(2))] == [[[1.0, 2.0]] * 2, [[0.0, 0.0]] * 2, [[0.0, 0.0]] * 2]
    with pytest.raises(DriveError) as caught:
        follow([parse("t"), parse("sqrt(1 - t)")], ["c", "d"], {}).states(np.array([0.5, 2.0, 3.0]))
    assert caught.value.finding == "the motion of joint d has no finite value or derivative at t = 2 s"
