"""Impacts against closed forms, and against Pinocchio's impulse dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsgen.manifest import Coordinate, Frame, Wrench
from mbsgen.pipeline import read_tree
from mbsrun.external import load_on_demand
from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.guessing.phases import solve_links
from mbsrun.ocp.problem.phases import Impact, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Bounds, Contact, Cost, End, GuessOptions, Loops, Problem, Term
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.transcription.impacts import ImpactRows
from mbsrun.ocp.transcription.phases import transcribe_phases
from tests.mbsrun.ocp.closed_plants import pendulum_of_rods
from tests.mbsrun.ocp.plants import FREE_RANGE
from tests.mbsrun.peer import FREE, Peer, pose_functions
from tests.random_trees import Pinocchio

G = 9.81
DROPPED = """
model: ball.yaml
scheme: radau
degree: 3
intervals: 2
horizon: {guess: 0.4, range: [0.01, 2]}
COST
phases:
  - name: fall
    start: {pose: {height: 1}, velocity: {way: WAY}}
    end: {pose: {height: 0}}
  - name: rise
    end: {velocity: {height: 0}}
links:
  - from: fall
    to: rise
    impact: {model: ball_hit.yaml, contacts: [CONTACT], restitution: 0.8}
"""
BALL = """
name: ball
gravity: [0, 0, -9.81]
parameters:
  m: {value: 0.5, kind: differentiated}
bodies:
  - {name: slide, joint: {name: way, type: prismatic, axis: x, actuated: false}}
  - {name: ball, parent: slide, joint: {name: height, type: prismatic, axis: z, actuated: false}, mass: m}
frames:
  - {name: tip, body: ball}
"""
OPEN = "wrenches:\n  - {name: tip, body: ball, force: input}\n"


@pytest.fixture
def drop(requires: Callable[[str], str], tmp_path: Path) -> Callable[[str, str], PhasedSolution | Failure]:
    """Drop a ball that moves along x as well, onto a contact."""
    requires("cc")
    (tmp_path / "ball.yaml").write_text(BALL)
    (tmp_path / "ball_hit.yaml").write_text(BALL + OPEN)

    def solve(way: str, contact: str, more: str = "", terminal: str = "{expression: T}") -> PhasedSolution | Failure:
        file, cost = tmp_path / "drop.ocp.yaml", f"cost: {{terminal: [{terminal}]}}"
        file.write_text(DROPPED.replace("WAY", way).replace("CONTACT", contact).replace("COST", cost) + more)
        return solve_phases(*read_phased_problem(file, load_on_demand))

    return solve


METHODS = ("ipopt", "mbs")


@pytest.mark.parametrize("method", METHODS)
def test_a_ball_bounces(drop: Callable[..., PhasedSolution], method: str) -> None:
    """From 1 m, with restitution 0.8, it rises to 0.64 m; its friction stops it along x."""
    found = drop("0.5", "tip", f"solver: {{method: {method}}}")
    fall, speed = np.sqrt(2 / G), np.sqrt(2 * G)
    assert found.durations == pytest.approx([fall, 0.8 * fall], rel=1e-8)
    rise = found.phases[1].trajectory
    assert rise.q[-1] == pytest.approx([0.5 * fall, 0.64], rel=1e-8)
    assert rise.qd[0] == pytest.approx([0.0, 0.8 * speed], abs=1e-8)
    (link,) = found.values
    assert link.impulses[0].components == pytest.approx([-0.25, 0.0, 0.5 * 1.8 * speed], rel=1e-8, abs=1e-12)
    assert link.violation < 1e-12


def test_an_impulse_has_a_price(drop: Callable[..., PhasedSolution]) -> None:
    """Expressions of a link read impulses: the price of both, and a condition that holds anyway."""
    more = "    cost: [{expression: jx_tip**2 + jz_tip**2, weight: 2}]\n"
    more += "    conditions: [{expression: jz_tip + jx_tip, range: [0, null]}]\n"
    found = drop("0.5", "tip", more)
    (link,) = found.values
    assert dict(link.terms) == pytest.approx({"jx_tip**2 + jz_tip**2": 2 * (0.25**2 + 0.9**2 * 2 * G)}, rel=1e-8)
    assert found.cost == pytest.approx(sum(phase.cost.total for phase in found.phases) + link.terms[0][1], rel=1e-12)


def test_a_ball_slides_where_a_contact_holds_its_normal_alone(drop: Callable[[str, str], PhasedSolution]) -> None:
    found = drop("0.5", "{sensor: tip, axes: z}")
    assert found.phases[1].trajectory.qd[0, 0] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("way", ["0.5", "-0.5"])
def test_friction_stops_a_ball_that_comes_from_either_side(drop: Callable[..., PhasedSolution], way: str) -> None:
    """The impulse across is 0.25 / (0.9 sqrt(2 g)) = 0.0627 of the normal one: 0.064 is enough."""
    found = drop(way, "{sensor: tip, friction: 0.064}")
    assert isinstance(found, PhasedSolution), found.finding
    across, _, normal = found.values[0].impulses[0].components
    assert across / normal == pytest.approx(-float(way) * 0.5 / (0.9 * np.sqrt(2 * G)), rel=1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_friction_that_cannot_stop_a_ball_is_named(drop: Callable[..., Failure], method: str) -> None:
    """The impulse across, 0.25 N s, would be more than 0.01 times the normal one: no motion, and the link is named."""
    failure = drop("0.5", "{sensor: tip, friction: 0.01}", f"solver: {{method: {method}}}")
    assert isinstance(failure, Failure)
    assert "link fall to rise: friction at tip" in failure.finding


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("mass", ["parameters: {m: 0.7}", "unknowns: {m: {range: [0.7, 0.9], guess: 0.8}}"])
def test_parameters_and_unknowns_reach_the_model_of_an_impact(
    drop: Callable[..., PhasedSolution], mass: str, method: str
) -> None:
    """The impulse of a ball of 0.7 kg; of the unknown mass, since the cost grows with it."""
    found = drop(
        "0",
        "tip",
        f"{mass}\nsolver: {{method: {method}}}",
        "{expression: T}" if mass.startswith("p") else "{expression: T + m}",
    )
    mass_found = 0.7 if mass.startswith("p") else found.unknown_values[0]
    assert mass_found == pytest.approx(0.7, abs=1e-7)
    impulse = found.values[0].impulses[0].components[2]
    assert impulse == pytest.approx(mass_found * 1.8 * np.sqrt(2 * G), rel=1e-8)
    assert found.phases[1].trajectory.unknowns == pytest.approx(found.phases[0].trajectory.unknowns, abs=1e-12)


def rod(*, is_held: bool) -> Peer:
    """A rod of 0.7 kg that swings about y, its centre of mass 0.3 m below; its tip, 0.6 m below, may be held."""
    q, qd, qdd, u, w = (ca.SX.sym(name, size) for name, size in (("q", 1), ("qd", 1), ("qdd", 1), ("u", 0), ("w", 3)))
    tip = ca.vertcat(-0.6 * ca.sin(q), 0, -0.6 * ca.cos(q))
    Phi = ROD * qdd + 0.7 * G * 0.3 * ca.sin(q) + 0 * qd
    given = {"q": q, "qd": qd, "qdd": qdd, "u": u} | ({"w": w} if is_held else {})
    if is_held:
        Phi -= ca.jacobian(tip, q).T @ w
    impl = ca.Function("peer_impl", [*given.values()], [Phi], [*given], ["Phi"])
    R = ca.horzcat(ca.SX.eye(3), ca.SX.eye(3))
    wrench = Wrench(name="tip", frame=0, in_base=True, force=True, moment=False)
    return Peer(
        "rod",
        {"impl": impl, **pose_functions(q, tip, ca.horzcat(ca.SX.zeros(3), tip), R)},
        [Coordinate(name="angle", motion="revolute", actuated=False, **FREE)],
        [Frame(name="rod", parent=-1, sensor=False), Frame(name="tip", parent=0, sensor=True)],
        wrenches=(wrench,) if is_held else (),
    )


ROD = 0.02 + 0.7 * 0.09  # its moment of inertia about the hinge


def test_a_pendulum_hits_a_wall() -> None:
    """By energy: 1 - cos of the angle that it swings back to is e^2 times 1 - cos of the one that it comes from."""
    down = Problem(
        name="down",
        horizon=0.4,
        horizon_range=(0.1, 2.0),
        intervals=12,
        family=Family.RADAU,
        degree=5,
        cost=Cost(terminal=(Term("T", 1.0),)),
        start_q=(-1.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ()),
        end=End(coordinates=((0, 0.0),)),
        guess=GuessOptions(inputs="zero"),
    )
    rest = GuessOptions(motion="rest", inputs="zero")
    back = replace(down, free_start=(0, 1), end=End(velocity_zero=True), guess=rest)
    wall = Impact((Contact("tip", "tip", (0,), 0),), 0.5)
    problem = PhasedProblem("swing", (Phase("down", down), Phase("back", back)), (Link("down", "back", impact=wall),))
    free = rod(is_held=False)
    found = solve_phases(problem, Plants((free, free), (rod(is_held=True),)))
    assert isinstance(found, PhasedSolution), found.finding
    angle = found.phases[1].trajectory.q[-1, 0]
    assert abs(angle) == pytest.approx(np.arccos(1 - 0.25 * (1 - np.cos(1.0))), rel=1e-9)
    (impulse,) = found.values[0].impulses
    speed = np.sqrt(2 * 0.7 * G * 0.3 * (1 - np.cos(1.0)) / ROD)
    assert impulse.components == pytest.approx((1.5 * speed * ROD / 0.6, 0.0, 0.0), rel=1e-8)  # free along y and z


BIPED = """
name: biped
gravity: [0, 0, -9.81]
bodies:
  - {name: x, joint: {type: prismatic, axis: x, actuated: false}}
  - {name: z, parent: x, joint: {type: prismatic, axis: z, actuated: false}}
  - {name: trunk, parent: z, joint: {type: revolute, axis: y, actuated: false}, mass: 8, com: [0.02, 0, 0.2],
     inertia: [0.2, 0.3, 0.1]}
  - {name: thigh1, parent: trunk, joint: {type: revolute, axis: y}, mass: 2, com: [0, 0, -0.15],
     inertia: [0.02, 0.03, 0.01]}
  - {name: shank1, parent: thigh1, joint: {type: revolute, axis: y, position: [0, 0, -0.4]}, mass: 1,
     com: [0, 0, -0.2], inertia: [0.01, 0.02, 0.01]}
  - {name: thigh2, parent: trunk, joint: {type: revolute, axis: y}, mass: 2, com: [0, 0, -0.15],
     inertia: [0.02, 0.03, 0.01]}
  - {name: shank2, parent: thigh2, joint: {type: revolute, axis: y, position: [0, 0, -0.4]}, mass: 1,
     com: [0, 0, -0.2], inertia: [0.01, 0.02, 0.01]}
frames:
  - {name: foot1, body: shank1, position: [0, 0, -0.41]}
  - {name: foot2, body: shank2, position: [0, 0, -0.41]}
"""
FEET = """
wrenches:
  - {name: foot1, body: shank1, position: [0, 0, -0.41], force: input, moment: input}
  - {name: foot2, body: shank2, position: [0, 0, -0.41], force: input}
"""
TOUCHES = {
    "a foot": ((Contact("foot2", "foot2", (0, 2)),), 0.0),
    "both feet": ((Contact("foot1", "foot1", (0, 2)), Contact("foot2", "foot2", (0, 2))), 0.0),
    "a foot that bounces": ((Contact("foot1", "foot1", (2,)),), 0.6),
}


@pytest.mark.parametrize(("contacts", "restitution"), TOUCHES.values(), ids=TOUCHES.keys())
def test_impulses_equal_pinocchio(
    contacts: tuple[Contact, ...], restitution: float, requires: Callable[[str], str], tmp_path: Path
) -> None:
    """Velocities after the impact, to rounding; and M dv = J' L with Pinocchio's M and J."""
    import pinocchio as pin

    requires("cc")
    (tmp_path / "flight.yaml").write_text(BIPED)
    (tmp_path / "biped.yaml").write_text(BIPED + FEET)
    flight = load_on_demand(tmp_path / "flight.yaml")
    plant, peer = load_on_demand(tmp_path / "biped.yaml"), Pinocchio(read_tree(tmp_path / "biped.yaml"))
    rng = np.random.default_rng(5)
    q, qd = rng.uniform(-0.7, 0.7, 7), rng.uniform(-2, 2, 7)
    impact, x, left = _hit(flight, plant, contacts, restitution, q, qd)
    after, changes, impulses = x[impact.after.qd], x[impact.changes], x[np.concatenate(impact.impulses)]
    J = plant("jac_motion", q=q, qd=qd)["jac_v_qd"]
    sensors = [frame.name for frame in plant.manifest.frames if frame.sensor]
    J = np.concatenate([J[[3 * sensors.index(c.sensor) + axis for axis in c.axes]] for c in contacts])
    theirs = J[:, np.argsort(peer.order)]
    pin.crba(peer.model, peer.data, peer._theirs(q))
    found = pin.impulseDynamics(peer.model, peer.data, peer._theirs(q), peer._theirs(qd), theirs, restitution, 0.0)
    assert after == pytest.approx(np.array(found)[peer.order], abs=1e-11)
    assert np.abs(peer.mass_matrix(q) @ changes - J.T @ impulses).max() < 1e-12
    assert left < 1e-12


def test_loops_stay_closed_at_an_impact() -> None:
    """A point that two rods hold 1 m from the origin, at x = sin a, hits a wall with half restitution along x.

    Of the speed w along the circle, -w/2 is left. The wall gives 1.5 w/cos a, the rods 1.5 w tan a.
    """
    a, w = 0.4, 2.0
    q, qd = np.array([np.sin(a), -np.cos(a)]), w * np.array([np.cos(a), np.sin(a)])
    contact = (Contact("hand", "hand", (0,), 0),)
    impact, x, left = _hit(pendulum_of_rods(), pendulum_of_rods(is_held=True), contact, 0.5, q, qd)
    assert x[impact.after.qd] == pytest.approx(-qd / 2, abs=1e-12)
    assert x[impact.impulses[0]] == pytest.approx([-1.5 * w / np.cos(a)], abs=1e-12)
    assert x[impact.multipliers] == pytest.approx([1.5 * w * np.tan(a)], abs=1e-12)
    assert left < 1e-12


def _hit(
    flight: Plant, plant: Plant, contacts: tuple[Contact, ...], restitution: float, q: np.ndarray, qd: np.ndarray
) -> tuple[ImpactRows, np.ndarray, float]:
    """Solve for an impact; return where its variables are, all variables, and the residual of its rows."""
    m, free = len(plant.manifest.actuated), (FREE_RANGE,) * q.size
    own = Problem(
        name="hit",
        horizon=1.0,
        intervals=1,
        family=Family.RADAU,
        degree=1,
        cost=Cost(1.0),
        start_q=tuple(q.tolist()),
        start_qd=tuple(qd.tolist()),
        bounds=Bounds(free, free, (FREE_RANGE,) * m),
        loops=Loops.MULTIPLIERS if plant.manifest.loops else None,
        end=End(),
    )
    held = Plants((flight,), (plant,))
    problem = PhasedProblem("hit", (Phase("hit", own),), (Link("hit", "hit", impact=Impact(contacts, restitution)),))
    transcription = transcribe_phases(problem, held)
    program = NumpyProgram(transcription.program, flight, (plant,))
    x, p = np.zeros(transcription.program.variables), transcription.parameters(problem)
    x[transcription.phases[0].layout.mesh[-1]] = np.concatenate((q, qd))
    x = solve_links(
        x, transcription.defined, lambda x: program.constraint(x, p), lambda x: program.jacobian(x, p).tocsr()
    )
    impact = transcription.links[0].impact
    assert impact is not None
    defined = np.concatenate([group.rows for group in transcription.defined])
    left = float(np.abs(program.constraint(x, p)[defined]).max())
    return impact, x, left
