"""Coordinates as a group: turns against matrix exponentials of scipy, derivatives against differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsrun.quaternions import Quaternion
from mbsrun.simulation.integration.groups import Attitude, Group, Turn, cross

Array = NDArray[np.float64]
AXIS = np.array([0.48, -0.6, 0.64])
ANGLES = (2.5, 0.7, 1.2e-3, 0.9e-3, 1e-5, 1e-9, 0.0)


def differ(f: Callable[[Array], Array], x: Array, h: float = 1e-5) -> Array:
    """Return the derivatives by central differences, the last axis by x."""
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(x.size)], axis=-1)


def turn(w: Array) -> Array:
    return np.asarray(Rotation.from_rotvec(w).as_matrix())


@pytest.mark.parametrize("angle", ANGLES)
def test_turns_are_exponentials(angle: float) -> None:
    """The quaternion of a turn, and c = 2 tan(angle / 2) along its axis."""
    found = Turn(angle * AXIS)
    assert Rotation.from_quat(found.quaternion).as_rotvec() == pytest.approx(angle * AXIS, abs=1e-15)
    assert np.linalg.norm(found.quaternion) == pytest.approx(1.0, abs=1e-15)
    assert found.c == pytest.approx(2 * np.tan(angle / 2) * AXIS, rel=1e-12, abs=1e-20)
    assert found.square == pytest.approx(angle**2)


@pytest.mark.parametrize("angle", ANGLES)
def test_derivatives_of_a_turn(angle: float) -> None:
    """Exp(w) moves by exp(w) A(-w)^-1 dw; c and A^T p by their own derivatives."""
    w, p = angle * AXIS, np.array([0.3, 1.1, -0.7])
    for k, rate in enumerate(np.moveaxis(differ(turn, w), -1, 0)):
        way = np.linalg.solve(Turn(-w).A, np.eye(3)[k])
        assert turn(w).T @ rate == pytest.approx(cross(way), abs=1e-9)
    assert Turn(w).c_by_w == pytest.approx(differ(lambda x: Turn(x).c, w), rel=1e-8, abs=1e-8)
    assert Turn(w).vary(p) == pytest.approx(differ(lambda x: Turn(x).A.T @ p, w), abs=1e-8)


@pytest.mark.parametrize("square", [0.99e-6, 1.01e-6])
def test_functions_of_an_angle_meet_their_limits(square: float) -> None:
    """Where the limit takes over, both sides agree to the square of the angle."""
    found = Turn(np.sqrt(square) * AXIS)
    angle = np.sqrt(square)
    assert found.k == pytest.approx(2 * np.tan(angle / 2) / angle, rel=1e-14)
    assert found.s == pytest.approx(1 / 12, abs=2 * square / 720)
    slope = found.c_by_w - found.k * np.eye(3)
    assert slope == pytest.approx(np.outer(AXIS, AXIS) * square / 6, rel=1e-5, abs=1e-13)


def test_the_product_is_a_matrix() -> None:
    a, b = np.array([1.0, 2.0, -3.0]), np.array([0.5, -1.0, 4.0])
    assert cross(a) @ b == pytest.approx(np.cross(a, b))


FREE = Attitude(Quaternion("hull", first=4, spin=4), is_free=True)  # a number, then the place, then the quaternion
BALL = Attitude(Quaternion("ball", first=8, spin=7), is_free=False)
GROUP = Group((FREE, BALL), 10, (np.array([0]), np.array([0])))
START = np.concatenate(([0.3, 1.0, 2.0, 3.0], Rotation.from_rotvec([0.2, 0.5, -1.0]).as_quat(),
                        Rotation.from_rotvec([-0.7, 0.1, 0.4]).as_quat()))  # fmt: skip
X = np.array([0.25, 0.6, -0.3, 0.8, 0.4, -0.9, 0.5, 0.3, 0.2, -0.6])


def read(q: Array) -> tuple[float, Array, Array, Array]:
    """Return the number, the place, and both attitudes."""
    return float(q[0]), q[1:4], Rotation.from_quat(q[4:8]).as_matrix(), Rotation.from_quat(q[8:]).as_matrix()


def test_a_motion_adds_numbers_composes_turns_and_shifts_along_the_mean_attitude() -> None:
    """The shift is R (1 + exp(w~)) d' / 2, where (1 + exp(w~)) / 2 d' = d + (2 c x d + c x (c x d)) / (4 + c.c)."""
    number, place, R, S = read(START)
    moved = read(GROUP.move(START, X))
    d, w, ball = X[1:4], X[4:7], X[7:]
    assert moved[0] == pytest.approx(number + 0.25)
    assert moved[1] == pytest.approx(place + R @ (np.eye(3) + turn(w)) @ d / 2, abs=1e-14)
    assert moved[2] == pytest.approx(R @ turn(w), abs=1e-14)
    assert moved[3] == pytest.approx(S @ turn(ball), abs=1e-14)
    back = GROUP.move(GROUP.move(START, X), -X)
    assert back == pytest.approx(START, abs=1e-14)
    stretched = GROUP.move(np.concatenate((START[:4], 1.001 * START[4:])), X)
    assert np.linalg.norm(stretched[4:8]) == pytest.approx(1.0, abs=1e-15)
    assert not GROUP.is_flat
    flat = Group((), 2, (np.arange(2), np.arange(2)))
    assert flat.is_flat
    assert flat.move(np.array([1.0, 2.0]), np.array([0.5, -1.0])).tolist() == [1.5, 1.0]


def test_the_way_of_a_motion_along_the_group() -> None:
    """Rates along the moved axes are A(-x)^-1 dx, and A is 1 for numbers."""

    def along(x: Array) -> Array:
        number, place, R, S = read(GROUP.move(START, x))
        return np.concatenate(([number], place, R.ravel(), S.ravel()))

    _, _, R, S = read(GROUP.move(START, X))
    carried = GROUP.carry(X)
    for k, rate in enumerate(differ(along, X).T):
        assert rate[0] == pytest.approx(carried[0, k], abs=1e-9)
        assert R.T @ rate[1:4] == pytest.approx(carried[1:4, k], abs=1e-8)
        assert R.T @ rate[4:13].reshape(3, 3) == pytest.approx(cross(carried[4:7, k]), abs=1e-8)
        assert S.T @ rate[13:].reshape(3, 3) == pytest.approx(cross(carried[7:, k]), abs=1e-8)
    assert carried @ GROUP.trivialise(-X) == pytest.approx(np.eye(10), abs=1e-13)


def test_momenta_vary_with_the_motion() -> None:
    p = np.array([2.0, 0.5, -1.0, 0.3, 0.8, 0.1, -0.4, 1.2, -0.6, 0.9])
    expected = differ(lambda x: GROUP.trivialise(x).T @ p, X)
    assert GROUP.vary(X, p) == pytest.approx(expected, abs=1e-8)


def test_moving_axes_turn_momenta() -> None:
    """Of a free body (w x f, w x k + d x f); of a ball w x k; of numbers nothing."""
    v, p = X, np.array([2.0, 0.5, -1.0, 0.3, 0.8, 0.1, -0.4, 1.2, -0.6, 0.9])
    d, w, f, k = v[1:4], v[4:7], p[1:4], p[4:7]
    expected = [0.0, *np.cross(w, f), *(np.cross(w, k) + np.cross(d, f)), *np.cross(v[7:], p[7:])]
    assert GROUP.gyrate(v, p) == pytest.approx(expected)
