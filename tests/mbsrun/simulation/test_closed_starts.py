"""Starts of a motion with a closed loop: a point in the plane that stays 1 m from the origin, h = (x^2 + y^2 - 1) / 2.

So y follows from x, and x x' + y y' = 0; every closed start has a closed form.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from mbsrun.closure import Closure, OpenError
from mbsrun.simulation.closing import Start, check_closed, close_start, complete_velocities
from mbsrun.simulation.course import stand
from tests.mbsrun.ocp.closed_plants import pendulum_of_rods
from tests.mbsrun.peer import Peer

NONE: frozenset[int] = frozenset()
BASE = np.array([0.0, -1.0])


class Rods(Peer):
    """The kernels, also of no states at all."""

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Evaluate; of no states, return arrays of the same shapes."""
        if any(np.ndim(x) == 2 and not len(np.asarray(x)) for x in inputs.values()):
            one = {key: np.zeros((1, *np.shape(x)[1:])) for key, x in inputs.items()}
            return {key: value[:0] for key, value in super().__call__(name, sparse=sparse, **one).items()}
        return super().__call__(name, sparse=sparse, **inputs)


PLANT: Any = pendulum_of_rods()
PLANT.__class__ = Rods


def close(
    q: tuple[float, float],
    qd: tuple[float, float] = (0.0, 0.0),
    placed: frozenset[int] = NONE,
    moving: frozenset[int] = NONE,
) -> tuple[list[float], list[float], str]:
    found, rates, note = close_start(PLANT, Start(BASE, np.array(q), np.array(qd), placed, moving), stand([]))
    return found.tolist(), rates.tolist(), note


def test_given_entries_are_kept_and_the_others_follow() -> None:
    """On the branch of the base: below the origin."""
    place, speeds, note = close((0.6, -1.0), (0.4, 0.0), frozenset({0}), frozenset({0}))
    assert (place, note) == (pytest.approx([0.6, -0.8], abs=1e-9), "")
    assert speeds == pytest.approx([0.4, 0.3], abs=1e-9)
    start = Start(np.array([0.6, -0.8]), np.array([0.0, -0.6]), np.array([0.0, 0.4]), frozenset({1}), frozenset({1}))
    q, qd, note = close_start(PLANT, start, stand([]))
    assert (q.tolist(), note) == (pytest.approx([0.8, -0.6], abs=1e-9), "")
    assert qd.tolist() == pytest.approx([0.3, 0.4], abs=1e-9)


def test_without_given_entries_it_stays_where_it_was() -> None:
    assert close((0.0, -1.0)) == (pytest.approx([0.0, -1.0], abs=1e-9), pytest.approx([0.0, 0.0]), "")


@pytest.mark.parametrize(("off", "is_noted"), [(0.9e-9, False), (1.1e-9, True), (-1.1e-9, True), (4e-4, True)])
def test_a_pose_that_is_nearly_closed_is_moved_with_a_note(off: float, is_noted: bool) -> None:
    """Above 1e-9, of the given coordinates; the point moves along the way to the origin."""
    q, _, note = close((0.6 * (1 + off / 0.8), -0.8 * (1 + off / 0.8)), placed=frozenset({0, 1}))
    assert q == pytest.approx([0.6, -0.8], abs=1e-7)
    expected = f"the loops were not closed at the given start: coordinates were changed by up to {abs(off):.2g}"
    assert note == (expected if is_noted else "")


def test_a_pose_that_is_open_by_more_than_a_millimetre_is_refused() -> None:
    """h = 0.9e-3 is nearly closed, 1.1e-3 is open."""
    r = np.sqrt(1 + 2 * 0.9e-3)
    assert close((0.6 * r, -0.8 * r), placed=frozenset({0, 1}))[2].endswith("by up to 0.00072")
    r = np.sqrt(1 + 2 * 1.1e-3)
    with pytest.raises(OpenError):
        close((0.6 * r, -0.8 * r), placed=frozenset({0, 1}))


def test_velocities_follow_from_the_given_ones() -> None:
    """x' = -y y' / x; contradicting ones, and more than rounding, are refused with their rate."""
    closure, q = Closure(PLANT), np.array([0.6, -0.8])
    assert complete_velocities(closure, q, np.array([0.4, 9.0]), [0]) == pytest.approx([0.4, 0.3])
    assert complete_velocities(closure, q, np.array([9.0, 0.3]), [1]) == pytest.approx([0.4, 0.3])
    assert complete_velocities(closure, q, np.array([9.0, 9.0]), []) == pytest.approx([0.0, 0.0])
    assert complete_velocities(closure, q, np.array([0.4, 0.3]), [0, 1]) == pytest.approx([0.4, 0.3])
    with pytest.raises(
        OpenError, match=r"the given velocities open it at a rate of 0\.08; give independent joints only"
    ):
        complete_velocities(closure, q, np.array([0.4, 0.2]), [0, 1])


@pytest.mark.parametrize("speed", [0.0, 3.0])
@pytest.mark.parametrize(("part", "is_open"), [(0.9e-9, False), (1.1e-9, True)])
def test_a_state_is_closed_up_to_rounding(speed: float, part: float, is_open: bool) -> None:
    """1e-9 of 1 and the largest velocity, for gaps and for their rates."""
    most = part * (1 + speed)
    q, qd = np.array([np.sqrt(1 + 2 * most), 0.0]), np.array([0.0, speed])
    slow = np.array([most / (1 - part), speed])
    slow[0] = part * (1 + max(abs(slow))) if speed == 0 else most
    for name, state in (("is open by", (q, qd)), ("opens at", (np.array([1.0, 0.0]), slow))):
        if is_open:
            with pytest.raises(OpenError, match=name):
                check_closed(PLANT, *state)
        else:
            check_closed(PLANT, *state)
