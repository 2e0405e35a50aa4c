"""Poses from inverse kinematics, and the motion towards them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mbsrun.ocp import schemes
from mbsrun.ocp.guess import REACHED, find_pose, interpolate
from mbsrun.ocp.problem import Bounds, End, GuessOptions, Problem, cylindrical
from mbsrun.ocp.schemes import Family
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
