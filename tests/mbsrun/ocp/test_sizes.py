"""Usual sizes of states and controls that are guessed as 0: each rule by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import rest
from mbsrun.ocp.guessing.sizes import (
    _balance,
    _differentiate,
    _find_acceleration,
    _find_largest,
    _find_magnitude,
    _find_reach,
    _find_stated,
    _put,
    _size_moving,
    _spread_sizes,
    size_added,
)
from mbsrun.ocp.guessing.state_guess import complete, list_parts
from mbsrun.ocp.problem.problem import Bounds, Control, Problem, State
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import Peer, double_integrator

Array = NDArray[np.float64]
INF = np.inf
SCHEME = schemes.build(Family.RADAU, 2)


def test_numbers_are_measured_by_their_largest_finite_magnitude() -> None:
    assert _find_largest(np.array([[1.0, -INF, np.nan], [-3.0, 2.0, INF]])).tolist() == [3, 2, 0]
    assert _find_largest(np.zeros((0, 2))).tolist() == [0, 0]
    assert (_find_magnitude((-3.0, 2.0)), _find_magnitude((-INF, 2.0)), _find_magnitude((-INF, INF))) == (3, 2, 0)


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ({}, 0.0),
        ({"guess": -3.0}, 3.0),
        ({"guess": (-4.0, 1.0)}, 4.0),
        ({"guess": (1.0, -5.0)}, 5.0),
        ({"guess": (-1.0, 6.0)}, 6.0),
        ({"start": (-2.0, 1.0)}, 2.0),
        ({"end": (-INF, 7.0), "guess": 1.0}, 7.0),
    ],
)
def test_a_state_is_as_large_as_a_file_says(given: dict[str, Any], size: float) -> None:
    assert _find_stated(State("s", "1", **given)) == size


def test_a_size_balances_the_rate_that_it_moves() -> None:
    """By its slope; by the root of its curvature where that is 0; nothing where the state's size is unknown."""
    slopes = np.array([[4.0, 0.0, 0.0], [2.0, 3.0, 0.0]])
    curvatures = np.array([[9.0, 0.5, 0.0], [8.0, 8.0, 0.0]])
    balanced, known = np.array([[2.0], [6.0]]), np.array([[True], [False]])
    assert _balance(balanced, known, slopes, curvatures).tolist() == [[0.5, np.sqrt(8.0), INF], [INF] * 3]
    assert _balance(balanced, ~known, slopes, curvatures).tolist() == [[INF] * 3, [3, 2, INF]]


def test_sizes_spread_from_known_ones() -> None:
    """Of positions x, velocities v and forces f: x' = v, v' = f / 2, within 2 s; x is 3."""
    slopes, none = np.array([[0.0, 1, 0], [0, 0, 0.5]]), np.zeros((2, 3))
    sizes = np.array([3.0, 0, 0])
    assert _spread_sizes(sizes, np.zeros(2), slopes, none, 2.0).tolist() == [3, 1.5, 1.5]
    assert sizes.tolist() == [3, 0, 0]
    # v changes by 10 * 2 within the horizon; then a force balances 20 / 2 or the rate 10
    assert _spread_sizes(sizes, np.array([0.0, 10.0]), slopes, none, 2.0).tolist() == [3, 20, 20]
    assert _spread_sizes(sizes, np.array([0.0, 0.4e-9]), slopes, none, 2.0).tolist() == [3, 1.5, 1.5]
    # the rate of x is known to be 4 along the guess
    assert _spread_sizes(sizes, np.array([4.0, 0.0]), slopes, none, 2.0).tolist() == [3, 4, 4]
    # a known term of the same rate: x' = v + 5 f, f is 2
    slopes[0, 2] = 5
    assert _spread_sizes(np.array([3.0, 0, 2]), np.zeros(2), slopes, none, 2.0).tolist() == [3, 10, 2]
    # the least of two: both states are 3, f moves one by 6 and the other one by 1/2
    slopes = np.array([[0.0, 0, 6], [0, 0, 0.5]])
    assert _spread_sizes(np.array([3.0, 3, 0]), np.zeros(2), slopes, none, 1.0).tolist() == [3, 3, 0.5]
    # a budget of squares: b' = f^2 has the curvature 2
    curvatures = np.array([[0.0, 2.0]])
    assert _spread_sizes(np.array([8.0, 0]), np.zeros(1), np.zeros((1, 2)), curvatures, 2.0).tolist() == [8, 2]


def test_changes_below_a_billionth_are_rounding() -> None:
    none = np.zeros((1, 1))
    for rate, size in ((0.49e-9, 0.49e-9 * 2), (0.6e-9, 1.2e-9)):
        assert _spread_sizes(np.zeros(1), np.array([rate]), none, none, 2.0) == pytest.approx([size], rel=1e-12)
    loop = np.array([[3.0]])  # its own slope moves no other
    assert _find_reach(np.zeros(1), np.array([0.0]), loop, 2.0).tolist() == [0.0]


def test_small_reaches_are_sizes() -> None:
    """T (|r| + sum of slopes times sizes), of known sizes and reaches alone; at most 1e-4."""
    slopes = np.array([[9.0, 1, 0], [0, 0, 0.5]])
    assert _find_reach(np.array([0, 0, 1e-9]), np.zeros(2), slopes, 2.0) == pytest.approx([2e-9, 1e-9])
    assert _find_reach(np.array([0, 0, 1e-9]), np.array([3e-9, 0]), slopes, 2.0) == pytest.approx([8e-9, 1e-9])
    assert _find_reach(np.array([0, 0, 0.0]), np.array([3e-9, 0]), slopes, 2.0) == pytest.approx([0, 0])
    assert _find_reach(np.array([0, 0, 0.9e-4]), np.zeros(2), slopes, 2.0) == pytest.approx([0, 0.9e-4])
    assert _find_reach(np.array([0, 0, 1.1e-4]), np.zeros(2), slopes, 2.0).tolist() == [0, 0]
    assert _find_reach(np.array([0, 0, 1e-9]), np.array([INF, 0]), slopes, 2.0) == pytest.approx([0, 1e-9])
    # a known size stays apart
    assert _find_reach(np.array([0, 5e-5, 1e-9]), np.zeros(2), slopes, 0.5) == pytest.approx([2.5e-5, 5e-5])
    found = _spread_sizes(np.array([0, 0, 1e-9]), np.zeros(2), slopes, np.zeros((2, 3)), 2.0)
    assert found == pytest.approx([2e-9, 1e-9, 1e-9])


class Linear:
    """Phi = M qdd + c - B u."""

    def __init__(self, M: Array) -> None:
        self.M, self.B, self.c = M, np.array([[1.0, 0, -2], [0.5, -2, 0]]), np.array([4.0, -5])

    def __call__(self, _: str, **given: Array) -> dict[str, Array]:
        assert not given["q"].any()
        assert not given["qd"].any()
        return {"Phi": given["qdd"] @ self.M.T + self.c - given["u"] @ self.B.T}


def test_inputs_and_other_forces_accelerate_a_tree_at_rest() -> None:
    """M^-1 (|c| + |B| limits), at the most; none where M has no inverse."""
    M, limits = np.array([[2.0, -1], [-1, 3]]), np.array([10.0, 1, 3])
    forces = np.array([4 + 10 + 6.0, 5 + 5 + 2.0])
    found = _find_acceleration(limits, 2, cast(Any, Linear(M)))
    assert found == pytest.approx((np.abs(np.linalg.inv(M)) @ forces).max())
    assert _find_acceleration(limits, 2, cast(Any, Linear(np.ones((2, 2))))) == 0.0


def resting(limit: float, horizon: float = 2.0, **changes: Any) -> tuple[Trajectory, Problem, Peer]:
    plant = double_integrator()
    bounds = Bounds((FREE_RANGE,), (FREE_RANGE,), ((-limit / 2, limit),))
    problem = replace(push(3), horizon=horizon, bounds=bounds, **changes)
    return complete(rest(problem, SCHEME, plant), problem, plant), problem, plant


def test_a_tree_at_rest_moves_as_far_as_tiny_inputs_let_it() -> None:
    """By a T^2, a T and a, if that is less than 1e-4; as it is elsewhere."""
    motion, problem, plant = resting(2e-5)
    found = _size_moving(motion, problem, plant)
    assert found.q == pytest.approx(np.full((4, 1), 8e-5))
    assert found.qd == pytest.approx(np.full((4, 1), 4e-5))
    assert found.point_q == pytest.approx(np.full((3, 2, 1), 8e-5))
    assert found.point_qd == pytest.approx(np.full((3, 2, 1), 4e-5))
    assert found.point_qdd == pytest.approx(np.full((3, 2, 1), 2e-5))
    assert found.u.tolist() == motion.u.tolist()
    assert size_added(motion, problem, plant).q == pytest.approx(found.q)
    for limit, horizon in ((2.6e-5, 2.0), (1e-4, 1.0), (0.0, 1.0), (INF, 1.0)):
        given = resting(limit, horizon)
        assert _size_moving(*given) is given[0]
    assert _size_moving(*resting(0.9e-4, 1.0)).qd == pytest.approx(np.full((4, 1), 0.9e-4))
    for part in ("q", "qd", "u", "point_q", "point_qdd"):
        moving = replace(motion, **{part: getattr(motion, part) + 1.0})
        assert _size_moving(moving, problem, plant) is moving


@pytest.mark.parametrize("changes", [{"dependent": (0,)}, {"driven": (0,)}])
def test_loops_and_driven_joints_are_no_trees(changes: dict[str, Any]) -> None:
    motion, problem, plant = resting(2e-5)
    manifest = plant.manifest.model_copy(update=changes)
    other = SimpleNamespace(manifest=manifest, describe=plant.describe)
    assert _size_moving(motion, problem, cast(Any, other)) is motion


STATES = (
    State("x", "v", start=(0.0, 0.0), end=(1.5, 1.5)),
    State("v", "f/2", start=(0.0, 0.0), end=(0.0, 0.0)),
)


def test_states_and_controls_that_are_guessed_as_0_get_their_sizes() -> None:
    """1.5 within 2 s: a velocity of 0.75, and a force of twice its rate; what is known stays."""
    motion, problem, plant = resting(INF, states=STATES, controls=(Control("f"),))
    found = size_added(motion, problem, plant)
    assert found.states[:, 0] == pytest.approx(motion.states[:, 0])
    assert found.states[:, 1] == pytest.approx([0.75] * 4)
    assert found.point_states[..., 1] == pytest.approx(np.full((3, 2), 0.75))
    assert found.controls == pytest.approx(np.full((3, 1), 0.75))
    # closed bounds are a size, and need none
    closed = (STATES[0], replace(STATES[1], bounds=(-6.0, 3.0)))
    motion, problem, plant = resting(INF, states=closed, controls=(Control("f"),))
    found = size_added(motion, problem, plant)
    assert found.states.tolist() == motion.states.tolist()
    assert found.controls == pytest.approx(np.full((3, 1), 6.0))
    # of a half-open one the limit is none
    motion, problem, plant = resting(
        INF, states=(STATES[0], replace(STATES[1], bounds=(-6.0, INF))), controls=(Control("f"),)
    )
    assert size_added(motion, problem, plant).states[:, 1] == pytest.approx([0.75] * 4)
    guessed = tuple(replace(state, guess=2.0) for state in STATES)
    motion, problem, plant = resting(INF, states=guessed, controls=(Control("f", guess=1.0),))
    assert size_added(motion, problem, plant) is motion


def test_a_budget_of_squares_sizes_a_control() -> None:
    """8 within 2 s, by the curvature 2 of f^2."""
    motion, problem, plant = resting(INF, states=(State("b", "f**2", end=(8.0, 8.0)),), controls=(Control("f"),))
    assert size_added(motion, problem, plant).controls == pytest.approx(np.full((3, 1), 2.0))


def test_stated_sizes_are_put_where_a_guess_is_0() -> None:
    """A start of 2 that the guess leaves at 0."""
    motion, problem, plant = resting(INF, states=(State("s", "0", end=(-2.0, 4.0)),))
    assert not motion.states.any()
    assert (size_added(motion, problem, plant).states == 4.0).all()
    tiny = replace(motion, states=motion.states + 0.9e-9)
    assert (size_added(tiny, replace(problem, states=(State("s", "0"),)), plant).states == 0.0).all()
    small = replace(motion, states=motion.states + 1.1e-9)
    assert size_added(small, replace(problem, states=(State("s", "0"),)), plant) is small


def test_sizes_are_put_into_their_columns() -> None:
    """Of states first, at mesh points and between them; then of controls."""
    motion = resting(INF, states=STATES, controls=(Control("f"), Control("g")))[0]
    found = _put(motion, np.array([1, 3]), np.array([5.0, 6, 7, 8]))
    assert found.states[:, 1].tolist() == [6] * 4
    assert found.states[:, 0].tolist() == motion.states[:, 0].tolist()
    assert found.point_states[..., 1].tolist() == [[6, 6]] * 3
    assert found.controls.tolist() == [[0, 8]] * 3
    assert not motion.states[:, 1].any()


def test_expressions_have_their_largest_slopes_and_curvatures() -> None:
    """Of x y^3 + t y along x = 0 .. 1.5, y = 2: by y 12 x + t, and 12 x; by x 8; by a number that is not read, 0."""
    states = (State("x", "1", guess=(0.0, 1.5)), State("y", "1", guess=2.0), State("z", "1", guess=1.0))
    motion, problem, plant = resting(INF, states=states)
    parts = list_parts(motion, plant)
    found = _differentiate("x*y**3 + t*y", ["x", "y", "z"], parts, problem, plant)
    assert found == pytest.approx(np.array([[8, 12 * 1.5 + 2, 0], [0, 12 * 1.5, 0]]))
    assert _differentiate("t", ["x"], parts, problem, plant).tolist() == [[0.0], [0.0]]
