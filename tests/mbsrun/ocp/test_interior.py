"""The way to many digits near a solution: Newton's steps of products, and programs that are solved by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.optima.interior import Centre, Limited, Side, Task, _begin, _limit, _State, _sum
from mbsrun.ocp.optima.status import NOT_CONVERGED

Array = NDArray[np.float64]
NONE = np.inf


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_makes_products_mu_to_first_order(sign: float, rng: np.random.Generator) -> None:
    """s dz + z ds = mu - s z, and s + ds is the distance of the next values."""
    opened = np.array([True, True, False, True])
    limits, values, change, mu = np.array([0.5, NONE, 1.0, -2.0]), rng.normal(size=4), rng.normal(size=4), 0.3
    limited = Limited.find(limits, sign, opened)
    assert limited.at.tolist() == [0, 3]
    side = Side(limited, rng.uniform(0.1, 2.0, 2), rng.uniform(0.1, 2.0, 2))
    side.aim(values, change, mu)
    assert side.s * side.dz + side.z * side.ds == pytest.approx(mu - side.s * side.z, rel=1e-12)
    assert side.s + side.ds == pytest.approx(sign * (values + change - limits)[[0, 3]], rel=1e-12)


def approach(target: Array, start: Array, lam: Array) -> Centre:
    """Minimise sum (x - target)^2 / 2 with 0 <= x <= 1, x0 + x1 <= 1/2, x2 - x3 = 0, x4 = 1/4, from near a solution."""
    J = sparse.csc_array(np.array([[1.0, 1, 0, 0, 0], [0, 0, 1, -1, 0]]))
    bounds = np.array([0.0, 0, 0, 0, 0.25]), np.array([1.0, 1, 1, 1, 0.25])
    task = Task(
        bounds,
        (np.array([-NONE, 0.0]), np.array([0.5, 0.0])),
        np.ones(5),
        lambda x: (J @ x, x - target, Matrix(J)),
        lambda *_: Matrix(sparse.csc_array(np.eye(5))),
    )
    found = task.approach(start, lam)
    assert isinstance(found, Centre)
    return found


def test_a_program_is_solved_to_rounding() -> None:
    """Of x0 and x1 half the excess goes to the row; x2 = x3 stay at their upper limits; x4 is held.

    Multipliers: 1/2 of the row; of x2 = x3 = 1, 1 + 2 = 3 and -(-0.5) of the equality, which both upper limits share.
    """
    target = np.array([0.75, 0.75, 0.5, 3.0, 0.0])
    found = approach(target, np.array([0.25, 0.25, 0.9999, 1.0, 0.3]) - 1e-5, np.array([0.5, 0.0]) + 1e-5)
    assert found.x == pytest.approx([0.25, 0.25, 1.0, 1.0, 0.25], abs=1e-9)
    zeta = found.x - target + np.array([found.lam[0], found.lam[0], found.lam[1], -found.lam[1], 0.0])
    low, high = found.below[1], found.above[1]
    assert zeta[:4] == pytest.approx((low - high)[:4], abs=1e-9)
    assert found.lam[0] == pytest.approx(0.5, abs=1e-9)
    assert high[2] + high[3] == pytest.approx(1.5, abs=1e-9)
    assert found.row_above[1] == pytest.approx([0.5, 0.0], abs=1e-9)


def test_limits_that_act_and_others_come_apart() -> None:
    """Products of distances and multipliers are rounding; without a limit the distance is infinite."""
    found = approach(
        np.array([0.1, 0.2, -1.0, -1.5, 0.0]), np.array([0.1, 0.2, 1e-6, 0.0, 0.25]), np.array([1e-9, 0.25])
    )
    assert found.x == pytest.approx([0.1, 0.2, 0.0, 0.0, 0.25], abs=1e-9)
    for s, z in (found.below, found.above, found.row_below, found.row_above):
        assert (z[np.isinf(s)] == 0).all()
        assert (np.where(np.isinf(s), 0.0, s) * z < 1e-15).all()
    assert found.below[1][2] + found.below[1][3] == pytest.approx(2.5, abs=1e-9)
    assert found.row_above[1][0] == pytest.approx(0.0, abs=1e-12)
    assert np.isinf(found.row_below[0]).all()


def test_steps_end_before_the_nearest_limit() -> None:
    """A part of 0.995 of the way to it; falling numbers alone have one."""
    assert _limit(np.array([1.0, 2.0]), np.array([-0.5, 3.0])) == 1.0
    assert _limit(np.array([1.0, 2.0, 1.0]), np.array([-2.0, -8.0, 9.0])) == pytest.approx(0.995 / 4, rel=1e-14)
    assert _limit(np.array([1.0]), np.array([-1.0])) == 0.995
    assert _limit(np.zeros(0), np.zeros(0)) == 1.0


def test_first_distances_and_multipliers_are_positive() -> None:
    """Where there is none it is small, by the size of a variable and the scale of forces."""
    limited = Limited(np.array([0, 1, 3]), np.array([1.0, 2.0, 3.0]), 1.0)
    values, force = np.array([1.5, 2.0, 9.0, 2.9]), np.array([-4.0, 3.0, 7.0, -1.0])
    side = _begin(values, force, limited, np.array([1.0, 10.0, 1.0, 100.0]), 2.0)
    assert side.s == pytest.approx([0.5, 1e-11, 1e-10], rel=1e-9)
    assert side.z == pytest.approx([1e-9 * 2 / 0.5, 3.0, 2.0 / 100], rel=1e-9)
    upper = _begin(values, force, Limited(limited.at, limited.value, -1.0), np.ones(4), 1.0)
    assert upper.s == pytest.approx([1e-12, 1e-12, 0.1], rel=1e-9)
    assert upper.z == pytest.approx([4.0, 1.0, 1.0], rel=1e-9)


@pytest.mark.parametrize(("distances", "forces"), [(0.25, 1.0), (1.0, 0.25), (0.5, 0.25)])
def test_points_and_multipliers_go_their_own_lengths(distances: float, forces: float) -> None:
    """The least of both is returned."""
    none = np.zeros(0)
    J = sparse.csc_array((0, 1))
    task = Task(
        (np.zeros(1), np.full(1, NONE)), (none, none), np.ones(1), lambda x: (none, x, Matrix(J)), lambda *_: Matrix(J)
    )
    state = _State.begin(task, np.array([2.0]), none)
    (lower, _) = state.sides
    state.dx, lower.ds = np.array([1.0]), -lower.s * 0.995 / distances
    lower.dz = -lower.z * 0.995 / forces
    if distances == 1.0:
        lower.ds = -0.5 * lower.s
    if forces == 1.0:
        lower.dz = -0.5 * lower.z
    s, z = lower.s.copy(), lower.z.copy()
    assert state.step() == pytest.approx(min(distances, forces), rel=1e-12)
    assert state.x == pytest.approx([2.0 + distances], rel=1e-12)
    assert lower.s == pytest.approx(s + distances * lower.ds, rel=1e-12)
    assert lower.z == pytest.approx(z + forces * lower.dz, rel=1e-12)


def test_forces_of_limits_and_their_stiffness() -> None:
    """mu / s, less what moves a distance to the one that it should have; a number may have two limits."""
    values, mu = np.array([1.0, 5.0]), 0.5
    lower = Side(Limited(np.array([0]), np.array([0.25]), 1.0), np.array([0.5]), np.array([2.0]))
    upper = Side(Limited(np.array([0, 1]), np.array([3.0, 9.0]), -1.0), np.array([2.0, 1.0]), np.array([1.0, 8.0]))
    weights, forces = _sum([lower, upper], values, mu)
    assert weights == pytest.approx([2.0 / 0.5 + 1.0 / 2.0, 8.0], rel=1e-14)
    assert forces == pytest.approx([(1.0 - 4.0 * 0.25) - 0.25, -(0.5 - 8.0 * 3.0)], rel=1e-14)


def test_a_start_far_from_all_digits_comes_back_or_says_so() -> None:
    """Within a thousand sizes of the first point."""
    target = np.array([0.1, 0.2, 0.5, 0.5, 0.25])
    found = approach(target, target + 0.01, np.zeros(2))
    assert found.x == pytest.approx(target, abs=1e-9)
    J = sparse.csc_array((0, 1))
    none = np.zeros(0)
    open_ = np.full(1, -NONE), np.full(1, NONE)
    for place, status in ((999.0, None), (1001.0, NOT_CONVERGED)):
        task = Task(
            open_,
            (none, none),
            np.ones(1),
            lambda x, place=place: (none, x - place, Matrix(J)),
            lambda *_: Matrix(sparse.csc_array(np.eye(1))),
        )
        end = task.approach(np.zeros(1), none)
        assert end == status if isinstance(end, str) else end.x == pytest.approx([place])
        assert isinstance(end, str) == (status is not None)
