"""Stops and dry friction of joints by hand: numbers, touched stops, brakes, guards, and names of changes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation.integration.joints import Joints, are_held, name_change
from mbsrun.simulation.motion import FORCE, PLACE, SPEED, Guard, Kind, Mode

Array = NDArray[np.float64]
NONE = np.array([], dtype=np.intp)


def joint(name: str, stops: tuple[Any, Any, Any] | None = None, friction: dict[str, Any] | None = None) -> Any:
    """A coordinate with stops (lower, upper, restitution) and friction."""
    known = {"torque": 0.0, "static": 0.0, "stribeck": None, "one_way": 0}
    return SimpleNamespace(
        name=name,
        stops=stops and SimpleNamespace(lower=stops[0], upper=stops[1], restitution=stops[2]),
        friction=None if friction is None else SimpleNamespace(**(known | friction)),
    )


def read(*joints: Any, driven: tuple[int, ...] = (), positions: tuple[str, ...] | None = None) -> Joints:
    places = positions or tuple(x.name for x in joints)
    return Joints.of(SimpleNamespace(coordinates=joints, positions=places, driven=driven))  # type: ignore[arg-type]


STOPPED = joint("a", (-1.0, 3.0, 0.5))
RUBBED = joint("b", None, {"torque": 2.0, "static": 5.0, "stribeck": 0.5})
PLAIN = joint("c")
SOFT = joint("d", (-1.0, 1.0, None))
HALF = joint("e", (None, 2.0, 0.0), {"torque": 1.0, "static": 4.0})
CLUTCH = joint("f", None, {"torque": 0.5, "static": 0.75, "one_way": -1})


def test_numbers_are_read_of_rigid_stops_and_dry_friction() -> None:
    """A stop without a restitution is a spring, and stops nothing here; a quaternion's joint has no place."""
    found = read(STOPPED, RUBBED, PLAIN, SOFT, HALF, CLUTCH, driven=(2,), positions=("a", "x", "b", "d", "e", "f"))
    assert found.place == (0, 2, -1, 3, 4, 5)
    assert found.lower.tolist() == [-1, -np.inf, -np.inf, -np.inf, -np.inf, -np.inf]
    assert found.upper.tolist() == [3, np.inf, np.inf, np.inf, 2, np.inf]
    assert found.restitution.tolist() == [0.5, 0, 0, 0, 0, 0]
    assert found.is_dry.tolist() == [False, True, False, False, True, True]
    assert found.torque.tolist() == [0, 2, 0, 0, 1, 0.5]
    assert found.static.tolist() == [0, 5, 0, 0, 4, 0.75]
    assert found.stribeck.tolist() == [0, 0.5, 0, 0, 0, 0]
    assert found.one_way.tolist() == [0, 0, 0, 0, 0, -1]
    assert (found.is_driven.tolist(), found.driven) == ([False, False, True, False, False, False], [2])
    assert found.starting.tolist() == [0, 5, 0, 0, 1, 0.5]


@pytest.mark.parametrize(("off", "is_there"), [(0.9e-12, True), (1.1e-12, False)])
@pytest.mark.parametrize(("k", "side", "stop"), [(0, 1, -0.5), (0, -1, 3.0), (1, 1, -1000.0), (1, -1, 1000.0)])
def test_stops_are_touched_within_a_trillionth_of_their_place_or_of_1(
    off: float, is_there: bool, k: int, side: int, stop: float
) -> None:
    """A joint that touches is put there exactly, from inside and from beyond; beyond by more is said."""
    joints, size = read(joint("a", (-0.5, 3.0, 0.5)), joint("far", (-1000.0, 1000.0, 0.0))), max(1.0, abs(stop))
    q = np.zeros(2)
    q[k] = stop + side * off * size
    assert joints.touch(q)[k] == (side if is_there else 0)
    assert (q[k] == stop) == is_there
    assert joints.touch(q)[1 - k] == 0
    q[k] = stop - side * 5
    assert joints.find_beyond(q) == [("a" if k == 0 else "far", stop - side * 5, stop)]
    assert joints.touch(q)[k] == side
    assert q[k] == stop
    q[k] = stop - side * off * size
    assert len(joints.find_beyond(q)) == (0 if is_there else 1)


def test_joints_without_stops_touch_none() -> None:
    assert read(PLAIN, RUBBED).touch(np.array([0.0, 1e300])).tolist() == [0, 0]


def test_clutches_press_their_own_way_and_others_away_from_the_stop() -> None:
    joints = read(STOPPED, HALF, CLUTCH)
    assert joints.press(np.array([1, -1, 0])).tolist() == [1, -1, -1]
    assert joints.find_stops(np.array([1, -1, 1])).tolist() == [-1, 2, 0]
    assert joints.find_stops(np.array([-1, 1, 0])).tolist() == [3, 0, 0]


def test_friction_falls_from_static_to_sliding_over_the_stribeck_speed() -> None:
    joints = read(RUBBED, HALF, PLAIN)
    speeds = np.array([[0.0, 0.0, 1.0], [0.5, 0.5, 1.0], [-0.25, 9.0, 1.0], [50.0, 1.0, 0.0]])
    fall = np.exp(-((speeds[:, 0] / 0.5) ** 2))
    assert joints.rub(speeds)[:, 0] == pytest.approx(2 + 3 * fall)
    assert joints.rub(speeds)[:, 1:].tolist() == [[1.0, 0.0]] * 4
    h = 1e-6
    for k in range(3):
        shift = h * np.eye(3)[k]
        slope = (joints.rub(speeds + shift) - joints.rub(speeds - shift)) / (2 * h)
        assert joints.steepen(speeds)[:, k] == pytest.approx(slope[:, k], abs=1e-8)


def test_brakes_hold_the_locking_joints_and_push_other_resting_ones() -> None:
    """Sliding joints are braked against their way, by friction that falls; a free joint has none."""
    joints = read(RUBBED, HALF, RUBBED, STOPPED, PLAIN)
    modes = np.array([Mode.BACKWARD, Mode.STICKS, Mode.STICKS, Mode.LOWER, Mode.FREE])
    forces = np.array([0.0, 7.0, 8.0, -9.0, 0.0])
    brakes = joints.brake(modes, forces, np.array([1]))
    held, signs, torques, falls, slowness = vars(brakes).values()
    assert list(held) == [0, 1, 0, 0, 0]
    assert np.asarray(signs).tolist() == [-1, 0, 1, 1, 0]
    assert np.asarray(torques)[[0, 2, 3, 4]].tolist() == [2, -8, 9, 0]
    assert np.asarray(falls)[[0, 2, 3, 4]].tolist() == [3, 0, 0, 0]
    assert np.asarray(slowness).tolist() == [2, 0, 2, 0, 0]


def test_guards_are_what_must_hold_while_a_mode_lasts() -> None:
    """Forces of locking joints at rest, up to a slack of 2e-14; else ways of sliding, and places between stops."""
    joints = read(STOPPED, RUBBED, HALF, CLUTCH, joint("g", None, {"torque": 0.0, "static": 1.0, "one_way": 1}))

    def guard(modes: list[int], forces: list[float], locking: Any = NONE) -> list[Guard]:
        return joints.guard(np.array(modes), np.array(forces), np.array(locking))

    none = [0.0] * 5
    assert guard([0, 0, 0, 0, 0], none) == [
        Guard(PLACE, 0, 0, 1.0, -1.0),
        Guard(PLACE, 0, 0, -1.0, 3.0),
        Guard(PLACE, 2, 2, -1.0, 2.0),
    ]
    assert guard([3, 1, -1, -1, 1], none) == [
        Guard(SPEED, 1, 1, 1.0, 0.0),
        Guard(SPEED, 2, 2, -1.0, 0.0),
        Guard(PLACE, 2, 2, -1.0, 2.0),
        Guard(SPEED, 3, 3, -1.0, 0.0),
        Guard(SPEED, 4, 4, 1.0, 0.0),
    ]
    assert guard([3, 2, 2, 2, 2], [100.0, 0, 0, 0, 0]) == []
    slack = 2e-14 * 100
    assert guard([3, 2, 4, 2, 2], [100.0, 0, 0, 0, 0], [0, 1, 2, 3, 4]) == [
        Guard(FORCE, 0, 0, 1.0, -slack),
        Guard(FORCE, 1, 1, -1.0, 5 + slack),
        Guard(FORCE, 1, 1, 1.0, -5 - slack),
        Guard(FORCE, 2, 2, -1.0, 4 + slack),
        Guard(FORCE, 3, 3, -1.0, 0.75 + slack),
        Guard(FORCE, 4, 4, 1.0, -1 - slack),
    ]
    (up, down) = guard([0, 2, 0, 0, 0], none, [1])[2:4]
    assert (up.level, down.level) == (5 + 2e-14 * 5, -5 - 2e-14 * 5)
    assert [x.kind for x in guard([4, 0, 0, 0, 0], none, [0])] == [FORCE, PLACE]
    assert are_held([-1, 0, 1, 2, 3, 4]).tolist() == [False, False, False, True, True, True]


def test_velocities_of_rounding_are_rest_where_something_can_hold_the_joint() -> None:
    lower = joint("h", (0.0, None, 0.0))
    joints = read(STOPPED, RUBBED, HALF, lower, PLAIN, SOFT)
    for part, is_still in ((0.9e-13, True), (1.1e-13, False)):
        for sign in (1, -1):
            qd = np.full(6, sign * part * 4.0)
            joints.still(qd, 4.0)
            assert (qd == 0).tolist() == [is_still] * 4 + [False, False]


def test_changes_of_modes_have_names() -> None:
    """A joint that sticks comes to rest; one that slides the other way turns round; what begins freely is no event."""
    f, b, n, s, low, up = Mode.FORWARD, Mode.BACKWARD, Mode.FREE, Mode.STICKS, Mode.LOWER, Mode.UPPER
    found = {
        **{(old, s): Kind.STICK for old in (f, b, n, low, up)},
        **{(s, new): Kind.SLIP for new in (f, b)},
        **{(old, new): Kind.REST for new in (low, up) for old in (f, b, n, s, low, up) if old != new},
        **{(old, new): Kind.LEAVE for old in (low, up) for new in (f, b, n)},
        (f, b): Kind.REVERSE,
        (b, f): Kind.REVERSE,
    }
    for old in Mode:
        for new in Mode:
            assert name_change(int(old), int(new)) == found.get((old, new)), (old, new)
