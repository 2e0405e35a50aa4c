"""Friction by the load of joints by hand: patterns of modes, loads of given reactions, rest, and words of refusals."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation.integration.bearings import Bearings, LoadError, State, _find_radius, _find_roots
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.motion import Mode

Array = NDArray[np.float64]
FORWARD, BACKWARD, FREE, STICKS = int(Mode.FORWARD), int(Mode.BACKWARD), int(Mode.FREE), int(Mode.STICKS)


class Inertia:
    """A stand-in of dynamics that factorises given mass matrices."""

    def factorise(self, M: Array, free: NDArray[np.intp]) -> Array:
        return np.linalg.cholesky(M[:, free[:, None], free])


def bear(
    coefficient: list[float],
    static: list[float],
    owner: list[int],
    torques: list[tuple[float, float]] | None = None,
    stribeck: list[float] | None = None,
) -> Bearings:
    """Make bearings of joints a, b, ..., in which all joints have dry friction, with given owners."""
    n = len(coefficient)
    torques, stribeck = torques or [(0.0, 0.0)] * n, stribeck or [0.0] * n
    names = [SimpleNamespace(name=name) for name in "abcdefgh"[:n]]
    dry, none = np.ones(n, dtype=bool), np.zeros(n)
    joints = Joints(
        SimpleNamespace(coordinates=names), tuple(range(n)), none - np.inf, none + np.inf, none, dry,  # type: ignore[arg-type]
        np.array([x[0] for x in torques]), np.array([x[1] for x in torques]), np.array(stribeck),
        np.zeros(n, dtype=int), ~dry,
    )  # fmt: skip
    frames, parts = np.array(owner, dtype=np.intp), np.zeros((len(owner), 3, 3))
    dynamics: Any = Inertia()
    return Bearings(dynamics, joints, np.array(coefficient), np.array(static), frames, frames, parts, parts)


def state(M: Any, f: Any, r: Any, B: Any = None) -> State:
    """One state, with forces r of bearings, which accelerations change by B."""
    mass, force, loads = np.array(M, dtype=float), np.array(f, dtype=float), np.array(r, dtype=float)
    by = np.zeros((*loads.shape, len(force))) if B is None else np.array(B, dtype=float)
    return State(mass[None], force[None], loads[None], by[None])


def test_patterns_list_what_sticks_what_slides_and_whose_load_rubs() -> None:
    """Joint b has no coefficient: it slides without a load. Each sliding joint sums its own bearings."""
    found = bear([0.2, 0.0, 0.1, 0.3], [0.2, 0.0, 0.4, 0.3], [0, 0, 2, 3]).read(
        np.array([FORWARD, BACKWARD, 0, STICKS])
    )
    assert (found.ways.tolist(), found.held.tolist(), found.free.tolist()) == ([1, -1, 0, 0], [3], [0, 1, 2])
    assert (found.sliding.tolist(), found.rows.tolist(), found.sums.tolist()) == ([0], [0, 1], [[1.0, 1.0]])
    found = bear([0.2, 0.0, 0.1, 0.3], [0.2, 0.0, 0.4, 0.3], [3, 0, 2, 3]).read(np.array([1, 1, -1, -1]))
    assert (found.sliding.tolist(), found.rows.tolist()) == ([0, 2, 3], [0, 1, 2, 3])
    assert found.sums.tolist() == [[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 1]]
    assert not found.held.size


def test_coefficients_fall_from_static_to_sliding_over_the_stribeck_speed() -> None:
    found = bear([0.2, 0.3], [0.5, 0.6], [0, 1], stribeck=[0.5, 0.0])
    assert found.rub(np.array([[0.5, 9.0], [-1.0, 0.0]])) == pytest.approx(
        np.array([[0.2 + 0.3 * np.exp(-1), 0.3], [0.2 + 0.3 * np.exp(-4), 0.3]])
    )
    assert found.starting.tolist() == [0.5, 0.3]
    assert np.asarray(found.lay().fall).tolist() == [0.3, 0.0]


@pytest.mark.parametrize("way", [1, -1])
def test_a_sliding_joint_is_braked_by_the_load_that_its_own_acceleration_causes(way: int) -> None:
    """N = |r + B qdd| = sqrt(9 + (1 + 2 qdd)^2), and 2 qdd = 4 - way (0.5 + 0.25 N); by the formula of a quadratic."""
    bearings = bear([0.25], [0.25], [0], [(0.5, 0.5)])
    given = state([[2.0]], [4.0], [[0, 3.0, 1.0]], [[[0.0], [0.0], [2.0]]])
    (rub,) = bearings.solve(given, bearings.read(np.array([way])), np.array([[0.5]]), np.array([[0.25]]))
    base, slope = (4 - way * 0.5) / 2, -way * 0.25 / 2
    c, d = 1 + 2 * base, 2 * slope
    N = (c * d + np.sqrt((c * d) ** 2 + (1 - d * d) * (9 + c * c))) / (1 - d * d)
    assert rub.loads[0, 0] == pytest.approx(N, rel=1e-13)
    assert rub.qdd[0, 0] == pytest.approx(base + slope * N, rel=1e-13)
    assert rub.lam[0, 0] == pytest.approx(-way * (0.5 + 0.25 * N), rel=1e-13)


def test_a_joint_that_sticks_is_held_by_what_the_others_leave() -> None:
    """Joint b sticks, so qdd_b = 0, and a has (f - rub)/M_aa; the force on b is M_ba qdd_a - f_b."""
    bearings = bear([0.5, 0.5], [0.5, 0.5], [0, 1])
    given = state([[2.0, 1.0], [1.0, 3.0]], [8.0, 5.0], [[0, 4.0, 0], [0, 0, 7.0]])
    (rub,) = bearings.solve(given, bearings.read(np.array([1, STICKS])), np.zeros((1, 2)), np.full((1, 2), 0.5))
    assert rub.qdd[0].tolist() == pytest.approx([3.0, 0.0])
    assert rub.lam[0].tolist() == pytest.approx([-2.0, 3.0 - 5.0])
    assert rub.loads[0].tolist() == pytest.approx([4.0, 7.0])


def test_free_joints_have_no_friction_and_all_bearings_of_a_joint_add_up() -> None:
    bearings = bear([0.5], [0.5], [0, 0])
    given = state([[2.0]], [8.0], [[0, 3.0, 4.0], [0, 0, 7.0]])
    (free,) = bearings.solve(given, bearings.read(np.array([FREE])), np.zeros((1, 1)), np.full((1, 1), 0.5))
    assert (free.qdd[0, 0], free.lam[0, 0], free.loads[0, 0]) == pytest.approx((4.0, 0.0, 12.0))
    (rub,) = bearings.solve(given, bearings.read(np.array([1])), np.zeros((1, 1)), np.full((1, 1), 0.5))
    assert rub.qdd[0, 0] == pytest.approx((8 - 6) / 2)


def test_several_states_have_one_solution_each() -> None:
    bearings = bear([0.25], [0.25], [0])
    both = [state([[2.0]], [f], [[0, 3.0, 1.0]], [[[0.0], [0.0], [b]]]) for f, b in ((4.0, 2.0), (-1.0, 0.5))]
    many = State(*(np.concatenate(x) for x in zip(*(vars(x).values() for x in both), strict=True)))
    (rub,) = bearings.solve(many, bearings.read(np.array([1])), np.zeros((2, 1)), np.full((2, 1), 0.25))
    for k, one in enumerate(both):
        (alone,) = bearings.solve(one, bearings.read(np.array([1])), np.zeros((1, 1)), np.full((1, 1), 0.25))
        assert rub.qdd[k] == pytest.approx(alone.qdd[0], rel=1e-14)
        assert rub.loads[k] == pytest.approx(alone.loads[0], rel=1e-14)


def test_the_first_state_of_a_paradox_is_the_one_that_counts() -> None:
    """N = |c + D N| with D = -1.5, c = 3: N = 1.2 and 6 as c/(1 - D), -c/(1 + D). The state before it has one."""
    bearings = bear([1.5], [1.5], [0])
    calm = state([[1.0]], [0.0], [[0, 3.0, 0.0]])
    wild = state([[1.0]], [0.0], [[0, 3.0, 0.0]], [[[0.0], [1.0], [0.0]]])
    many = State(*(np.concatenate(x) for x in zip(*(vars(x).values() for x in (calm, wild, calm)), strict=True)))
    found = bearings.solve(many, bearings.read(np.array([1])), np.zeros((3, 1)), np.full((3, 1), 1.5))
    assert sorted(float(x.loads[0, 0]) for x in found) == pytest.approx([1.2, 6.0])
    assert sorted(float(x.qdd[0, 0]) for x in found) == pytest.approx([-9.0, -1.8])
    with pytest.raises(LoadError, match=r"^2 motions obey the friction by the load of joints a: Painleve"):
        bearings.slide(wild, np.array([[1.0]]), bearings.read(np.array([1])))
    assert len(bearings.solve(wild, bearings.read(np.array([-1])), np.zeros((1, 1)), np.full((1, 1), 1.5))) == 0
    with pytest.raises(LoadError, match=r"^no motion obeys the friction by the load of joints a: Painleve"):
        bearings.slide(wild, np.array([[-1.0]]), bearings.read(np.array([-1])))
    assert bearings.slide(calm, np.array([[1.0]]), bearings.read(np.array([1]))).loads[0, 0] == 3.0


def test_refusals_name_the_joints_that_rub_by_their_load() -> None:
    """However small the coefficient; others with constant friction have no part."""
    bearings = bear([0.5, 0.0, 0.1], [0.5, 0.0, 0.1], [0, 2])
    assert "joints a, c: Painleve" in str(bearings._deny(0))
    assert "joints c is not known to rounding" in str(bearings.doubt(np.array([2])))
    many = state(np.eye(3), np.zeros(3), [[0, 1.0, 0], [0, 1.0, 0]], 9 * np.ones((2, 3, 3)))
    with pytest.raises(LoadError, match="joints a, c is not known: their loads depend on it too much"):
        bearings.solve(many, bearings.read(np.array([1, 1, 1])), np.zeros((1, 3)), np.array([[0.5, 0.0, 0.1]]))


# --- rest -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("force", "released", "mode"),
    [(4.9, False, STICKS), (5.1, False, FORWARD), (4.1, True, FORWARD), (3.9, True, STICKS), (0.0, False, STICKS)],
)
def test_a_joint_at_rest_starts_to_slide_above_its_static_friction(
    sign: int, force: float, released: bool, mode: int
) -> None:
    """Static 0.5 and sliding 0.4 of a load of 10 N; one that is let go slides where the sliding friction is less."""
    bearings = bear([0.4], [0.5], [0])
    given = state([[2.0]], [sign * force], [[0, 10.0, 0]])
    modes, rub = bearings.settle(given, np.zeros(1), {0: sign} if released else {})
    assert modes.tolist() == [mode if mode == STICKS else sign * mode]
    assert rub.qdd[0, 0] == pytest.approx(0.0 if mode == STICKS else sign * (force - 4.0) / 2, abs=1e-14)
    assert rub.lam[0, 0] == pytest.approx(-sign * (force if mode == STICKS else 4.0), abs=1e-14)


def test_a_joint_with_a_stribeck_speed_starts_to_slide_with_its_static_friction() -> None:
    """And one whose torque falls at once with the smaller torque."""
    bearings = bear([0.4], [0.5], [0], stribeck=[0.1])
    modes, rub = bearings.settle(state([[2.0]], [6.0], [[0, 10.0, 0]]), np.zeros(1), {})
    assert (modes.tolist(), rub.qdd[0, 0]) == ([1], pytest.approx(0.5))
    bearings = bear([0.0], [0.0], [0], [(2.0, 3.0)])
    modes, rub = bearings.settle(state([[2.0]], [3.1], [[0, 10.0, 0]]), np.zeros(1), {})
    assert (modes.tolist(), rub.qdd[0, 0]) == ([1], pytest.approx(0.55))


def test_joints_that_move_keep_their_way_and_others_are_tried() -> None:
    """Joint a slides backward; b rests, and is pushed by the inertia that couples them."""
    bearings = bear([0.1, 0.2], [0.1, 0.2], [0, 1])
    given = state([[2.0, 1.0], [1.0, 2.0]], [6.0, 0.0], [[0, 10.0, 0], [0, 10.0, 0]])
    modes, rub = bearings.settle(given, np.array([-0.5, 0.0]), {})
    assert modes.tolist() == [BACKWARD, BACKWARD]
    assert rub.qdd[0] == pytest.approx(np.linalg.solve([[2.0, 1], [1, 2]], [6.0 + 1.0, 2.0]))
    modes, rub = bearings.settle(state([[2.0, 1], [1, 2]], [1.0, 0.0], given.r[0]), np.array([-0.5, 0.0]), {})
    assert modes.tolist() == [BACKWARD, STICKS]
    assert rub.qdd[0] == pytest.approx([1.0, 0.0])


def test_a_push_at_the_bound_is_one_motion() -> None:
    """It sticks or begins to slide: both have no acceleration, and are one motion; so is a push within rounding."""
    bearings = bear([0.5], [0.5], [0])
    for force in (5.0, 5.0 * (1 + 1e-12), 5.0 * (1 - 1e-12)):
        _, rub = bearings.settle(state([[2.0]], [force], [[0, 10.0, 0]]), np.zeros(1), {})
        assert abs(rub.qdd[0, 0]) < 1e-9


def test_six_joints_at_rest_are_tried_and_seven_refused() -> None:
    for n in (6, 7):
        bearings = bear([0.4] * n, [0.5] * n, list(range(n)))
        given = state(np.eye(n), np.zeros(n), [[0, 10.0, 0]] * n)
        if n == 6:
            assert bearings.settle(given, np.zeros(n), {})[0].tolist() == [STICKS] * n
        else:
            with pytest.raises(LoadError, match=r"more than six joints .* at rest at once: a, b, c, d, e, f, g$"):
                bearings.settle(given, np.zeros(n), {})


# --- loads ----------------------------------------------------------------------------------------------------------


def test_spectral_radii_are_the_largest_eigenvalues() -> None:
    S = np.array([[[0.0, 4.0], [1.0, 0.0]], [[0.5, 0.0], [0.0, 0.25]], [[np.nan, 0.0], [0.0, 1.0]]])
    assert _find_radius(S)[:2].tolist() == pytest.approx([2.0, 0.5])
    assert np.isnan(_find_radius(S)[2])
    assert _find_radius(np.array([[[3.0]], [[np.nan]]]))[0] == 3.0


def test_roots_of_bearings_that_are_no_line_solve_their_equation() -> None:
    """N = |c + D N|: two roots where the right side less N falls below 0, and none where it does not."""
    c, D = np.array([[0.0, 0.0, 4.0]]), np.array([[0.0, 0.9, -0.9]])
    found = _find_roots(c, D)
    # 0.62 N^2 - 7.2 N + 16 = 0
    assert sorted(found) == pytest.approx(sorted(np.roots([0.62, -7.2, 16.0])), rel=1e-12)
    assert _find_roots(c, np.array([[0.0, 1.2, -0.1]])) == []
    two = _find_roots(np.array([[0, 0, 1.0], [0, 0, 2.0]]), np.array([[0, 0, -1.0], [0, 0, -2.0]]))
    assert sorted(two) == pytest.approx([0.75, 1.5])  # N = 3 |1 - N|
