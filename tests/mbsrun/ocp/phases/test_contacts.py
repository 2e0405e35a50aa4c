"""Phases whose contacts stand and lift off: a hopper of two masses, a foot of 1 kg and a trunk of 5 kg above it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mbsgen.manifest import Coordinate, Frame, Wrench
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.phases import Condition, Impact, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Bounds, Contact, Cost, End, GuessOptions, Problem, Term, WrenchComponent
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.transcription.phases import transcribe_phases
from tests.mbsrun.ocp.phases.motions import free_start
from tests.mbsrun.ocp.plants import FREE_RANGE
from tests.mbsrun.peer import FREE, Peer, pose_functions

FOOT, TRUNK, G = 1.0, 5.0, 9.81
SOLE = Contact("sole", "sole", (2,))
NONE = tuple(WrenchComponent("sole", axis, "0") for axis in range(3))


@pytest.fixture(scope="module")
def hopper() -> Peer:
    """The height of the foot, and the length of the leg, along which a motor pushes."""
    q, qd, qdd = (ca.SX.sym(name, 2) for name in ("q", "qd", "qdd"))
    u, w = ca.SX.sym("u"), ca.SX.sym("w", 3)
    trunk = TRUNK * (qdd[0] + qdd[1] + G)
    Phi = ca.vertcat(FOOT * (qdd[0] + G) + trunk - w[2], trunk - u) + 0 * qd
    sole = ca.vertcat(0, 0, q[0])
    impl = ca.Function("peer_impl", [q, qd, qdd, u, w], [Phi], ["q", "qd", "qdd", "u", "w"], ["Phi"])
    p, R = ca.horzcat(sole, sole + ca.vertcat(0, 0, q[1]), sole), ca.horzcat(*[ca.SX.eye(3)] * 3)
    frames = [Frame(name=name, parent=i - 1, sensor=False) for i, name in enumerate(("foot", "trunk"))]
    return Peer(
        "hopper",
        {"impl": impl, **pose_functions(q, sole, p, R)},
        [Coordinate(name=n, motion="prismatic", actuated=n == "leg", **FREE) for n in ("foot", "leg")],
        [*frames, Frame(name="sole", parent=0, sensor=True)],
        wrenches=(Wrench(name="sole", frame=0, in_base=True, force=True, moment=False),),
    )


def hop() -> PhasedProblem:
    """Push off, fly, and come to rest on the foot again; the leg leaves the ground at 1 m/s."""
    flight = Problem(
        name="flight",
        horizon=0.2,
        horizon_range=(0.05, 1.0),
        intervals=5,
        family=Family.RADAU,
        degree=3,
        cost=Cost(1e-3, 0.0, (), (Term("T", 1.0),)),
        start_q=(0.0, 0.4),
        start_qd=(0.0, 0.0),
        bounds=Bounds((FREE_RANGE, (0.3, 0.6)), (FREE_RANGE,) * 2, (FREE_RANGE,)),
        end=End(coordinates=((0, 0.0),)),
        wrenches=NONE,
        guess=GuessOptions(motion="rest"),
    )
    stance = replace(flight, wrenches=NONE[:2], contacts=(SOLE,), end=End())
    land = replace(stance, end=End(coordinates=((1, 0.45),), velocity_zero=True))
    leap = Condition("end_qd_leg", (1.0, np.inf))
    phases = {"push": stance, "flight": free_start(flight), "land": free_start(land)}
    links = (Link("push", "flight", conditions=(leap,)), Link("flight", "land", impact=Impact((SOLE,))))
    return PhasedProblem("hop", tuple(Phase(name, own) for name, own in phases.items()), links)


def optimum(problem: PhasedProblem, hopper: Peer) -> PhasedSolution:
    found = solve_phases(problem, Plants((hopper,) * 3))
    assert isinstance(found, PhasedSolution), found.finding
    return found


def test_a_foot_strikes_the_ground_and_stands(hopper: Peer) -> None:
    """Its impulse is its own momentum: the trunk's leg carries none. Nobody pulls; all comes to rest."""
    found = optimum(hop(), hopper)
    _, flight, land = (phase.trajectory for phase in found.phases)
    down = flight.qd[-1, 0]
    assert down < -0.1
    assert found.values[1].impulses[0].components == pytest.approx((0.0, 0.0, -FOOT * down), abs=1e-9)
    assert land.qd[0] == pytest.approx([0.0, flight.qd[-1].sum()], abs=1e-9)  # the trunk's own velocity stays
    assert np.abs(land.qd[:, 0]).max() < 1e-8
    assert min(phase.trajectory.point_w[..., 2].min() for phase in found.phases) > -1e-6
    centre = (FOOT * flight.q[:, 0] + TRUNK * flight.q.sum(axis=1)) / (FOOT + TRUNK)
    rise = (FOOT * flight.qd[0, 0] + TRUNK * flight.qd[0].sum()) / (FOOT + TRUNK)
    assert centre == pytest.approx(centre[0] + rise * flight.t - G * flight.t**2 / 2, abs=1e-7)


def test_a_contact_that_nothing_holds_before_begins_at_rest(hopper: Peer) -> None:
    """Without an impact, the foot touches the ground with no velocity; with one, the row would be one too many."""
    problem = hop()
    soft = replace(problem, links=(problem.links[0], Link("flight", "land")))
    plants = Plants((hopper,) * 3)
    assert [transcribe_phases(each, plants).closed[2].size for each in (problem, soft)] == [1, 0]
    found = optimum(soft, hopper)
    assert found.phases[1].trajectory.qd[-1, 0] == pytest.approx(0.0, abs=1e-8)
    assert found.cost > optimum(problem, hopper).cost


def test_a_link_that_changes_velocities_leaves_no_contact_standing(hopper: Peer) -> None:
    """A foot that stood, and that a link sets in motion, needs a condition; one that keeps its velocity needs none."""
    problem, plants = hop(), Plants((hopper,) * 2)
    push, land = problem.phases[0], problem.phases[2]
    for link, free in (
        (Link("push", "land"), 1),
        (Link("push", "land", map=(("foot", "2*foot - 0.1"),)), 1),
        (Link("push", "land", map=(("foot", "leg"), ("leg", "foot"))), 0),
        (Link("push", "land", velocities=(("foot", "foot - 1"),)), 0),
        (Link("push", "land", velocities=(("foot", None),)), 0),
    ):
        whole = PhasedProblem("step", (push, land), (link,))
        assert transcribe_phases(whole, plants).closed[1].size == free, link


def test_a_foot_that_rebounds_is_not_held(hopper: Peer) -> None:
    """After an impact with restitution it leaves the ground; so the phase after cannot hold it."""
    problem = hop()
    impact = Impact((SOLE,), restitution=0.5)
    thrown = replace(problem, links=(problem.links[0], Link("flight", "land", impact=impact)))
    with pytest.raises(ProblemError, match=r"links\[1\].impact.restitution: sole rebounds, and phase land holds it"):
        solve_phases(thrown, Plants((hopper,) * 3))
