"""Poses from inverse kinematics, and the motion towards them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import REACHED, adapt, balance, find_pose, interpolate, make_guess, rest
from mbsrun.ocp.problem.problem import Bounds, End, GuessOptions, Problem, cylindrical
from tests.mbsrun.peer import Peer


@pytest.mark.parametrize("azimuth", np.linspace(-np.pi / 2, np.pi / 2, 5))
@pytest.mark.parametrize("height", [-0.1, 0.0, 0.1])
def test_every_target_of_the_paper_has_an_upright_pose(
    arm: Peer, reach: Problem, azimuth: float, height: float
) -> None:
    """On the paper's cylinder the hand is at the target and horizontal, the pendulum upright, all within the limits."""
    target = cylindrical(0.63, azimuth, height)
    pose = find_pose(reach.with_target("hand", target), arm)
    assert pose.is_reached
    assert pose.is_upright
    frames = arm("frames", q=pose.q)
    assert frames["p"][:, 6] == pytest.approx(target, abs=REACHED)
    for frame in (3, 5):  # the hand's and the pendulum's z axes
        assert frames["R"][:, 3 * frame + 2] == pytest.approx([0, 0, 1], abs=REACHED)
    lower, upper = np.array(reach.bounds.q).T
    assert ((lower <= pose.q) & (pose.q <= upper)).all()


def test_a_target_out_of_reach_is_told_with_its_distance(arm: Peer, reach: Problem) -> None:
    """The arm is 0.7 m long: a point 1.5 m away stays 0.8 m away."""
    pose = find_pose(reach.with_target("hand", (1.5, 0.0, 0.0)), arm)
    assert not pose.is_reached
    assert pose.distance == pytest.approx(0.8, abs=1e-4)


def test_a_target_that_only_a_tilted_hand_reaches_is_reached(arm: Peer, reach: Problem) -> None:
    """0.69 m away, 0.6 rad below the horizon: with the hand horizontal its joint were 0.61 m away; the arm is 0.6 m."""
    target = (0.69 * np.cos(0.6), 0.0, -0.69 * np.sin(0.6))
    pose = find_pose(reach.with_target("hand", target), arm)
    assert pose.is_reached
    assert np.abs(pose.q[1:4].sum()) > 0.1  # the hand's slope


def test_coordinates_are_targets_too(arm: Peer, reach: Problem) -> None:
    """A pose asked for by coordinates is found, and the others stay where they start."""
    pose = find_pose(replace(reach, end=End(coordinates=((0, 0.5), (2, -1.0))), guess=GuessOptions()), arm)
    expected = np.array(reach.start_q)
    expected[[0, 2]] = 0.5, -1.0
    assert pose.q == pytest.approx(expected, abs=1e-6)


def test_a_coordinate_that_is_held_stays(arm: Peer, reach: Problem) -> None:
    """Bounds that leave no room: q1 is held at 0, so the target at pi/2 is out of reach."""
    held = replace(reach, bounds=Bounds(((0.0, 0.0), *reach.bounds.q[1:]), reach.bounds.qd, reach.bounds.u))
    pose = find_pose(held, arm)
    assert pose.q[0] == 0
    assert not pose.is_reached


def test_the_search_is_always_the_same(arm: Peer, reach: Problem) -> None:
    far = replace(reach.with_target("hand", (0.2, 0.0, 0.0)), guess=GuessOptions())
    assert np.array_equal(find_pose(far, arm).q, find_pose(far, arm).q)


def test_the_motion_is_smooth_and_rests_at_both_ends(reach: Problem) -> None:
    """Velocities and accelerations are the derivatives of the coordinates, by central differences to their order."""
    q = np.array(reach.start_q) + np.array([1.0, -0.5, 0.3, 0.2, 0.1, -0.1])
    motion = interpolate(reach, schemes.build(Family.RADAU, 4), q)
    assert motion.q[0] == pytest.approx(reach.start_q, abs=1e-15)
    assert motion.q[-1] == pytest.approx(q, abs=1e-15)
    for end in (0, -1):
        assert np.abs(motion.qd[end]).max() < 1e-15
    assert np.abs(motion.point_qdd[-1, -1]).max() < 1e-14
    h = motion.t[1]
    assert motion.qd[1:-1] == pytest.approx((motion.q[2:] - motion.q[:-2]) / (2 * h), abs=2 * h**2 * 4)
    assert motion.point_q[:, -1] == pytest.approx(motion.q[1:], abs=1e-15)
    assert (motion.u == 0).all()


def test_the_motion_leaves_with_the_velocity_of_the_start(reach: Problem) -> None:
    start_qd = (0.5, -0.2, 0.1, 0.0, 0.3, -0.4)
    motion = interpolate(replace(reach, start_qd=start_qd), schemes.build(Family.RADAU, 4), np.zeros(6))
    assert motion.q[[0, -1]] == pytest.approx(np.array([reach.start_q, np.zeros(6)]), abs=1e-15)
    assert motion.qd[[0, -1]] == pytest.approx(np.array([start_qd, np.zeros(6)]), abs=1e-14)


def test_a_line_leads_from_the_guessed_start_to_the_guessed_end(arm: Peer, reach: Problem) -> None:
    """At constant velocity; coordinates without a guess stay, and no pose is searched for the target of the hand."""
    options = GuessOptions(motion="line", inputs="zero", start=((0, 0.3),), end=((0, 1.3), (2, -1.0)))
    motion = make_guess(replace(reach, free_start=(0,), guess=options), arm, schemes.build(Family.RADAU, 4))
    assert isinstance(motion, Trajectory)
    start = np.array([0.3, *reach.start_q[1:]])
    way = np.array([1.0, 0.0, -1.0 - reach.start_q[2], 0.0, 0.0, 0.0])
    assert motion.point_q == pytest.approx(start + motion.point_t[..., None] / reach.horizon * way, abs=1e-14)
    assert motion.point_qd == pytest.approx(np.broadcast_to(way / reach.horizon, motion.point_qd.shape), abs=1e-14)
    assert not np.any(motion.point_qdd)


def test_rest_stays_at_the_start(reach: Problem) -> None:
    """Whatever velocity the problem starts with: a constant motion has none."""
    motion = rest(replace(reach, start_qd=(1.0,) * 6), schemes.build(Family.LEGENDRE, 3))
    assert motion.point_q == pytest.approx(np.broadcast_to(reach.start_q, (100, 3, 6)), abs=1e-15)
    assert not np.any(motion.qd)
    assert not np.any(motion.point_qdd)


def test_inputs_hold_or_move_what_they_can(arm: Peer, reach: Problem) -> None:
    """Residuals of the actuated joints vanish on the mean of every interval: at rest, or in motion."""
    motion = interpolate(reach, schemes.build(Family.RADAU, 4), np.array([1.0, 0.5, -1.0, 0.5, 0.0, 0.0]))
    for inputs, moves in (("static", 0.0), ("dynamic", 1.0)):
        u = balance(motion, reach, arm, inputs).u
        q, qd, qdd = (
            array.reshape(400, 6) for array in (motion.point_q, moves * motion.point_qd, moves * motion.point_qdd)
        )
        Phi = arm("impl", q=q, qd=qd, qdd=qdd, u=np.repeat(u, 4, axis=0))["Phi"]
        assert np.abs(Phi.reshape(100, 4, 6).mean(axis=1)[:, :4]).max() < 1e-12
        assert np.abs(u).max() > 1
    assert not np.any(balance(motion, reach, arm, "zero").u)


def test_inputs_of_a_guess_stay_within_their_bounds(arm: Peer, reach: Problem) -> None:
    weak = replace(reach, bounds=replace(reach.bounds, u=((-2.0, -1.0),) * 4))
    u = balance(interpolate(weak, schemes.build(Family.RADAU, 4), np.zeros(6)), weak, arm, "static").u
    assert (u.min(), u.max()) == (-2.0, -1.0)


@pytest.mark.parametrize(
    ("family", "degree", "N"), [(Family.RADAU, 4, 7), (Family.LEGENDRE, 5, 100), (Family.RADAU, 5, 33)]
)
def test_a_motion_is_read_on_any_grid(arm: Peer, reach: Problem, family: Family, degree: int, N: int) -> None:
    """The interpolation is a polynomial of degree 5: read from a grid of degree 5, it is what that grid would give."""
    pose = np.array([1.0, 0.5, -1.0, 0.5, 0.2, -0.1])
    fine = balance(interpolate(reach, schemes.build(Family.LEGENDRE, 5), pose), reach, arm, "static")
    other = replace(reach, intervals=N)
    scheme = schemes.build(family, degree)
    expected, found = interpolate(other, scheme, pose), adapt(fine, other, scheme)
    for name in ("t", "q", "qd", "point_t", "point_q", "point_qd", "point_qdd"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-10), name
    impulse = fine.u.sum(axis=0) / 100
    assert found.u.sum(axis=0) / N == pytest.approx(impulse, rel=1e-12)


def test_a_motion_is_slowed_down(reach: Problem) -> None:
    """Over twice the time: the same way at half the speed."""
    scheme = schemes.build(Family.RADAU, 5)
    fast = interpolate(reach, scheme, np.zeros(6))
    slow = adapt(fast, replace(reach, horizon=2 * reach.horizon), scheme)
    assert slow.t[-1] == 4
    assert slow.q == pytest.approx(fast.q, abs=1e-12)
    assert slow.qd == pytest.approx(fast.qd / 2, abs=1e-11)
    assert slow.point_qdd == pytest.approx(fast.point_qdd / 4, abs=1e-9)
