"""Closing loops outside the kernels: derivatives are differences of poses, and singular poses give finite numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mbsrun.closure import Closure, OpenError
from tests.mbsrun.ocp.closed_plants import FIVE_BAR_POSE, five_bar, pendulum_of_rods

SHOULDERS = [0, 2]


def test_velocities_and_accelerations_are_differences_of_closed_poses() -> None:
    """Shoulders go along y + t yd; central differences of second order leave h^2 and rounding / h^2."""
    closure, rng, h = Closure(five_bar()), np.random.default_rng(1), 1e-4
    q = closure.close(np.array(FIVE_BAR_POSE) + rng.uniform(-0.1, 0.1, (3, 4)), SHOULDERS)
    assert closure.measure(q) < 1e-14
    yd = rng.uniform(-1, 1, (3, 2))
    before, after = q.copy(), q.copy()
    before[:, SHOULDERS] -= h * yd
    after[:, SHOULDERS] += h * yd
    before, after = (closure.close(x, SHOULDERS) for x in (before, after))
    qd = closure.complete_velocities(q, SHOULDERS, yd)
    qdd = closure.complete_accelerations(q, qd, SHOULDERS, np.zeros((3, 2)))
    assert qd == pytest.approx((after - before) / (2 * h), abs=1e-6)
    assert qdd == pytest.approx((after - 2 * q + before) / h**2, abs=1e-5)
    assert closure.measure_rates(q, qd) < 1e-14


def test_a_batch_of_poses_is_closed_as_each_of_them_alone() -> None:
    """One of them is closed already, and one cannot be: each ends by itself."""
    closure = Closure(five_bar())
    closed = closure.close(np.array(FIVE_BAR_POSE), SHOULDERS)
    poses = np.array([closed, [2.0, -1.0, 1.0, 1.2], [3.1, -1.05, 0.0, 1.05], [np.nan] * 4])
    found = closure.close(poses, SHOULDERS)
    for pose, own in zip(poses, found, strict=True):
        assert own == pytest.approx(closure.close(pose, SHOULDERS), nan_ok=True, rel=1e-12)
    assert [closure.is_closed(own) for own in found] == [True, True, False, False]


def test_a_singular_pose_gives_the_least_change() -> None:
    """Where the rod is level, J = (1, 0): no velocity of x is possible, and any velocity of y."""
    closure, level = Closure(pendulum_of_rods()), np.array([1.0, 0.0])
    assert closure.complete_velocities(level, [0], np.array([0.5])) == pytest.approx([0.5, 0.0])
    assert closure.project_velocities(level, np.array([0.5, 0.3])) == pytest.approx([0.0, 0.3])
    with pytest.raises(OpenError, match="loop loop: it stays open by"):
        closure.move(np.array([0.0, -1.0]), [0], np.array([1.5]))


def test_the_equations_of_one_state_have_the_bits_of_a_batch() -> None:
    """One state takes a shorter way into C than several; shapes () and (1,) of states give the same numbers."""
    closure, rng = Closure(five_bar()), np.random.default_rng(2)
    q, qd = rng.uniform(-1, 1, (2, 3, 4))
    many = (closure.gaps(q), closure.rates(q, qd), closure.jacobian(q), closure.bias(q, qd))
    for k in range(3):
        for states, at in (((q[k], qd[k]), ...), ((q[k : k + 1], qd[k : k + 1]), 0)):
            one = (closure.gaps(states[0]), closure.rates(*states), closure.jacobian(states[0]), closure.bias(*states))
            for own, every in zip(one, many, strict=True):
                assert np.array_equal(own[at], every[k])
