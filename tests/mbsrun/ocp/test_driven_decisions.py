"""Given motions of driven joints by hand: what they may read, derivatives, faults, and conflicts with a problem."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsgen.documents import Finding
from mbsgen.expressions import ExpressionError
from mbsrun.ocp.problem.driving import (
    Guide,
    _find_excess,
    _varies_at_start,
    derive,
    find_conflicts,
    find_wrong_motions,
    varies,
)
from mbsrun.ocp.problem.problem import Bounds, Drive, End, Form, Problem, Unknown
from tests.mbsrun.ocp.plants import FREE_RANGE, push

TIMES = np.array([0.0, 0.25, 0.5])


def drive_of(*joints: str, driven: tuple[int, ...] = (1,), dependent: tuple[int, ...] = ()) -> Any:
    coordinates = [SimpleNamespace(name=name) for name in joints]
    return SimpleNamespace(
        coordinates=coordinates, positions=joints, driven=driven, dependent=dependent, quaternions=(), loops=()
    )


def state(text: str, **given: Any) -> Problem:
    """A problem of joints a and b, of which b is driven; both have bounds of 1 and rates of 4."""
    wide = FREE_RANGE
    known: dict[str, Any] = {
        "start_q": (0.0, 0.0), "start_qd": (0.0, 0.0), "driven": (Drive(1, text),), "end": End(),
        "bounds": Bounds((wide, (-1.0, 1.0)), (wide, (-4.0, 4.0)), (wide,)), "horizon": 2.0,
    }  # fmt: skip
    return replace(push(4), **(known | given))


def show(findings: Any) -> list[tuple[str, str]]:
    return [(".".join(map(str, x.place)), x.finding) for x in findings]


def test_motions_have_their_derivatives_by_time() -> None:
    """sin 3t + k t^2 at t, of the joints in the model's order; a horizon and unknowns are read."""
    manifest = drive_of("a", "b", driven=(0, 1))
    drives = (Drive(1, "sin(3*t) + k*t**2"), Drive(0, "n*t/T"))
    guide = Guide(drives, manifest, {"k": 5.0}, {"n": 6.0})
    q, qd, qdd = guide.read(TIMES, 2.0)
    t = TIMES
    assert q == pytest.approx(np.column_stack((3 * t, np.sin(3 * t) + 5 * t**2)))
    assert qd == pytest.approx(np.column_stack((np.full(3, 3.0), 3 * np.cos(3 * t) + 10 * t)))
    assert qdd == pytest.approx(np.column_stack((np.zeros(3), -9 * np.sin(3 * t) + 10)))
    other, *_ = guide.read(TIMES.reshape(1, 3), 4.0, np.array([8.0]))
    assert other.shape == (1, 3, 2)
    assert other[0, :, 0] == pytest.approx(2 * t)
    assert not np.isfinite(Guide((Drive(1, "1/t"),), drive_of("a", "b")).read(TIMES, 1.0)[0][0]).any()
    parts = guide.put(TIMES, 2.0, np.array([6.0]), np.full((3, 2), 9.0), np.full((3, 2), 9.0))
    assert [part.tolist() for part in parts] == [pytest.approx(q), pytest.approx(qd)]
    with pytest.raises(ExpressionError):
        derive("abs(t)")


def test_only_entries_of_driven_joints_are_put() -> None:
    guide = Guide((Drive(1, "7*t"),), drive_of("a", "b", "c"))
    before = np.full((3, 3), 9.0)
    q, qd, qdd = guide.put(TIMES, 1.0, np.zeros(0), before, before, before)
    assert q.tolist() == [[9.0, 7 * t, 9.0] for t in TIMES.tolist()]
    assert (qd[:, 1].tolist(), qdd[:, 1].tolist()) == ([7.0] * 3, [0.0] * 3)
    assert (before == 9).all()


def test_a_motion_varies_with_what_the_solver_chooses() -> None:
    unknown = {"unknowns": (Unknown("n"),)}
    for text, given, expected in (
        ("t", {}, False),
        ("t/T", {}, False),
        ("t", {"horizon_range": (1.0, 3.0)}, True),
        ("T", {"horizon_range": (1.0, 3.0)}, True),
        ("1", {"horizon_range": (1.0, 3.0)}, False),
        ("n*t", unknown, True),
        ("m*t", unknown, False),
    ):
        assert varies(text, state(text, **given)) is expected


def test_every_driven_joint_has_one_motion() -> None:
    manifest = drive_of("a", "b", "c", driven=(1, 2))
    good = [Drive(2, "t"), Drive(1, "k*T")]
    assert show(find_wrong_motions(good, ["k"], manifest)) == []
    (missing,) = find_wrong_motions(good[:1], [], manifest)
    assert (missing.place, missing.finding, missing.remedy) == (
        ("driven",),
        "the model drives b, and the problem gives no motion of it",
        "give it under driven, as b: 0.1*t",
    )
    wrong = [*good, Drive(0, "t"), Drive(1, "t")]
    assert show(find_wrong_motions(wrong, ["k"], manifest)) == [
        ("driven.2", "the model does not drive it"),
        ("driven.3", "the joint has a motion already"),
    ]


@pytest.mark.parametrize(
    ("text", "finding", "remedy"),
    [
        ("1 +", None, None),
        ("abs(t)", None, None),
        ("speel*t", 'unknown name "speel"', 'did you mean "speed"?'),
        ("zzzz*t", 'unknown name "zzzz"', "a motion reads t, T, speed"),
    ],
)
def test_motions_read_time_horizon_constants_and_unknowns(text: str, finding: str | None, remedy: str | None) -> None:
    (found,) = find_wrong_motions([Drive(1, text)], ["speed"], drive_of("a", "b"))
    assert found.place == ("driven", 0)
    assert finding is None or (found.finding, found.remedy) == (finding, remedy)


def test_known_motions_stay_within_the_bounds_of_their_joint() -> None:
    """Of places and of velocities, at the grid's points; a motion that the solver changes is held by the program."""
    manifest = drive_of("a", "b")
    assert show(find_conflicts(state("0.5*t"), manifest)) == []
    (place,) = find_conflicts(state("0.75*t"), manifest)
    assert place.place == ("driven", "b")
    assert place.finding == "the motion is 1.5 at t = 2 s, out of [-1, 1]"
    assert place.remedy == "move it within the bounds, or widen these"
    (speed,) = find_conflicts(state("sin(5*t)"), manifest)
    assert speed.finding.startswith("the velocity is ")
    assert speed.finding.endswith("out of [-4, 4]")
    assert show(find_conflicts(state("0.75*t", horizon_range=(1.0, 3.0)), manifest)) == []
    (wild,) = find_conflicts(state("1/(t - 0.5)"), manifest)
    assert wild.finding == "the motion has no finite value or derivative at t = 0.5 s"
    assert show(find_conflicts(state("99"), drive_of("a", "b", driven=()))) == []


def test_ends_and_other_forms_are_refused_with_driven_joints() -> None:
    manifest = drive_of("a", "b")
    end = End(coordinates=((0, 0.0), (1, 0.0)), velocities=((1, 0.0),), accelerations=((0, 0.0), (1, 0.0)))
    assert show(find_conflicts(state("0*t", end=end), manifest)) == [
        (f"end.{key}.b", "its motion is given under driven") for key in ("pose", "velocity", "acceleration")
    ]
    (form,) = find_conflicts(state("0*t", form=Form.SHOOTING), manifest)
    assert form.place == ("form",)
    assert form.finding == f"the {Form.SHOOTING.value} form takes no driven joints, and the model drives b"


def test_excess_is_judged_relative_to_the_motion() -> None:
    """To 1e-9 of 1 and the value; the largest is named with its time, on either side."""
    found = Finding(("driven", "b"), "the motion", "")
    t = np.array([0.0, 1.0, 2.0])
    for values, limits, text in (
        ([0.0, 3.0, 1.0], (-1.0, 2.0), "the motion is 3 at t = 1 s, out of [-1, 2]"),
        ([-2.0, 2.5, 1.0], (-1.0, 2.0), "the motion is -2 at t = 0 s, out of [-1, 2]"),
        ([0.0, 3 + 3.9e-9, 1.0], (-1.0, 3.0), ""),
        ([0.0, 3 + 4.1e-9, 1.0], (-1.0, 3.0), "the motion is 3 at t = 1 s, out of [-1, 3]"),
    ):
        told = [x.finding for x in _find_excess(t, np.array(values), limits, found)]
        assert told == ([text] if text else [])


def test_loops_do_not_start_where_the_solver_chooses() -> None:
    """A motion that begins at another place, or at another velocity, with another horizon or unknown."""
    loops = drive_of("a", "b", dependent=(0,))
    free = {"horizon_range": (1.0, 3.0), "unknowns": (Unknown("n", (0.0, 1.0), 0.5),)}
    for text, starts_anywhere in (
        ("t", False),
        ("n*t**2", False),
        ("n", True),
        ("n*t", True),
        ("t/T", True),
        ("T*t**2", False),
        ("cos(t/T)", False),
    ):
        problem = state(text, **free)
        assert _varies_at_start(Guide.of(problem, loops), 0, problem) is starts_anywhere
        told = show(find_conflicts(problem, loops))
        assert told == (
            [("driven.b", "the loops would start in a pose or at a velocity that the solver chooses")]
            if starts_anywhere
            else []
        )
        assert show(find_conflicts(problem, drive_of("a", "b"))) == []
