"""Contacts: static forces, the friction that a motion needs, a program of CasADi's Opti, and faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import null_space

from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.contacts import find_held
from mbsrun.ocp.problem.problem import End, Problem
from mbsrun.ocp.showing.summary import summarise
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.statement.surplus import leave_out_surplus
from mbsrun.ocp.transcription.clashes import name_rows
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.legs import LEG, SQUAT

# A foot of 1 kg that slides freely, and a trunk of 4 kg that two drives move along x and z on it.
HOPPER = """
name: hopper
gravity: [0, 0, -10]
bodies:
  - {name: rail, joint: {name: foot_x, type: prismatic, axis: x, actuated: false}, mass: 0}
  - {name: foot, parent: rail, joint: {name: foot_z, type: prismatic, axis: z, actuated: false}, mass: 1}
  - {name: slide, parent: foot, joint: {name: dx, type: prismatic, axis: x}, mass: 0}
  - {name: trunk, parent: slide, joint: {name: dz, type: prismatic, axis: z}, mass: 4}
frames:
  - {name: sole, body: foot}
  - {name: head, body: trunk}
wrenches:
  - {name: sole, body: foot, force: input}
"""
PROBLEM = """
model: hopper.yaml
horizon: 0.5
intervals: 10
scheme: radau
degree: 3
"""
START = "start: {pose: {foot_x: 0.2, dz: 0.5}}\n"
STAND = "contacts: [{sensor: sole, axes: xz, friction: 0.5}]\ncost: {inputs: 1}\n"
LEAN = STAND.replace("0.5", "0.3") + "end: {pose: {dx: %s}, velocity: zero}\n"


def read(folder: Path, text: str, model: str = HOPPER) -> tuple[Problem, Plant]:
    (folder / "hopper.yaml").write_text(model)
    (folder / "hopper.ocp.yaml").write_text(PROBLEM + ("" if "start:" in text else START) + text)
    return read_problem(folder / "hopper.ocp.yaml", load)


def found(problem: Problem, plant: Plant) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return resimulate(outcome, plant)


def test_a_leg_that_stands_carries_its_weight(tmp_path: Path) -> None:
    """It stays at rest with 50 N under the foot and 40 N in the drive, by any method; the foot does not move."""
    problem, plant = read(tmp_path, STAND + "end: {pose: {dz: 0.5}, velocity: zero}\nguess: {motion: rest}\n")
    for method in ("ipopt", "mbs"):
        solution = found(problem.with_solver(method), plant)
        motion = solution.trajectory
        # the trunk may sink and rise again: less effort, but the mean of the forces over the time is the weight
        weights = np.tile(schemes.build(problem.family, problem.degree).weights, 10) / 10
        assert weights @ motion.point_w[..., 2].ravel() == pytest.approx(50.0, abs=1e-6)
        assert np.abs(motion.point_w[..., :2]).max() < 1e-6
        assert motion.q[:, :2] == pytest.approx(np.tile([0.2, 0.0], (11, 1)), abs=1e-12)
        check = solution.resimulation
        assert check is not None
        assert check.is_accurate
        assert check.slip is not None
        assert check.slip < 1e-12
        assert check.slip_along is not None
        assert check.slip_along < 1e-9
        assert "of a contact at all points" in summarise(solution)["slip"]


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_friction_limits_a_motion_as_in_another_program(tmp_path: Path, method: str) -> None:
    """The trunk moves 0.2 m aside: 4 x'' and 4 (z'' + 10) are the drives' forces, and 4 |x''| <= 0.3 (4 z'' + 50)."""
    problem, plant = read(tmp_path, LEAN % 0.2)
    solution = found(problem.with_solver(method), plant)
    scheme, h, N = schemes.build(problem.family, problem.degree), 0.05, 10
    opti = ca.Opti()
    x, own, u = opti.variable(4, N + 1), [opti.variable(4, 3) for _ in range(N)], opti.variable(2, N)
    for k in range(N):
        nodes = ca.horzcat(x[:, k], own[k])
        rate = ca.vertcat(own[k][2:, :], ca.repmat(ca.vertcat(u[0, k] / 4, u[1, k] / 4 - 10), 1, 3))
        for j in range(3):
            opti.subject_to(nodes @ ca.DM(scheme.D[j]) == h * rate[:, j])
        opti.subject_to(x[:, k + 1] == own[k][:, 2])
        normal = u[1, k] + 10
        opti.subject_to(normal >= 0)
        opti.subject_to(opti.bounded(-0.3 * normal, u[0, k], 0.3 * normal))
    opti.subject_to(x[:, 0] == ca.DM([0, 0.5, 0, 0]))
    opti.subject_to(x[0, N] == 0.2)
    opti.subject_to(x[2:, N] == 0)
    opti.minimize(h * ca.sumsqr(u))
    opti.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10})
    peer = opti.solve()
    assert solution.cost.total == pytest.approx(float(peer.value(opti.f)), rel=1e-7)
    across, up = solution.trajectory.point_w[..., 0], solution.trajectory.point_w[..., 2]
    assert (np.abs(across) <= 0.3 * up + 1e-6).all()
    assert (np.abs(across) >= 0.3 * up - 1e-4).any()  # it binds
    assert across[:, 0] == pytest.approx(peer.value(u)[0], abs=1e-3)


def test_a_cone_of_friction(tmp_path: Path) -> None:
    """In space the force across stays within the cone, to 1 mN, and reaches it."""
    model = HOPPER.replace("name: slide, parent: foot", "name: beam, parent: foot", 1)
    model = model.replace(
        "  - {name: trunk, parent: slide,",
        "  - {name: slide, parent: beam, joint: {name: dy, type: prismatic, axis: y}, mass: 0}\n"
        "  - {name: trunk, parent: slide,",
    )
    model = model.replace(
        "  - {name: foot, parent: rail,",
        "  - {name: bar, parent: rail, joint: {name: foot_y, type: prismatic, axis: y, actuated: false}, mass: 0}\n"
        "  - {name: foot, parent: bar,",
    )
    text = "contacts: [{sensor: sole, friction: 0.5}]\ncost: {inputs: 1}\n"
    text += "end: {pose: {dx: 0.3, dy: 0.1}, velocity: zero}\n"
    problem, plant = read(tmp_path, text, model)
    forces = found(problem, plant).trajectory.point_w
    excess = np.hypot(forces[..., 0], forces[..., 1]) - 0.5 * forces[..., 2]
    assert excess.max() < 1.1e-3
    assert excess.max() > -1e-3


BAD = """
contacts:
  - {sensor: shoe, wrench: sole, axes: xz}
  - {sensor: sole, wrench: hand, axes: xy}
  - {sensor: sole, axes: xz, friction: 0.5}
wrenches: {sole: {force: [0, 0, 1]}}
cost: {inputs: 1}
"""


def test_every_fault_of_contacts_is_reported(tmp_path: Path) -> None:
    """Faults come with file, line, place and a remedy; Gauss points and a wrench elsewhere are refused."""
    with pytest.raises(InputError) as error:
        read(tmp_path, BAD)
    faults = {(fault.path, fault.finding): fault.line for fault in error.value.faults}
    assert faults["contacts[0].sensor", "the model has no sensor shoe"] == 10
    assert faults["contacts[1].wrench", "the model has no open wrench hand with a force"] == 11
    assert ("contacts[1].normal", "the point is not held along its normal") in faults
    assert ("contacts[2].wrench", "the force along x is given by an expression, and holds the point") in faults
    assert any(path == "contacts" and "two contacts" in finding for path, finding in faults)
    (tmp_path / "hopper.ocp.yaml").write_text(PROBLEM.replace("radau", "legendre") + START + STAND)
    with pytest.raises(InputError, match="contacts: the points of legendre are no mesh points"):
        read_problem(tmp_path / "hopper.ocp.yaml", load)
    problem, plant = read(tmp_path, STAND.replace("sensor: sole", "sensor: head, wrench: sole"))
    with pytest.raises(ProblemError, match="the force of sole does not act at head"):
        solve(problem, plant)
    problem, plant = read(tmp_path, STAND)
    with pytest.raises(ProblemError, match=r"sole moves at the start, at 0\.1 m/s"):
        solve(replace(problem, start_qd=(0.1, 0.0, 0.0, 0.0)), plant)


def test_every_row_has_a_name(tmp_path: Path) -> None:
    """A clash is named by rows: with states, forces by expressions, contacts and friction too."""
    text = STAND + "forces: {dx: -e}\nstates: {e: {rate: u_dz, start: 0, end: 1}}\n"
    problem, plant = read(tmp_path, text.replace("cost", "start: {pose: {foot_x: null, dz: 0.5}}\ncost", 1))
    transcription = transcribe(problem, plant)
    known = name_rows(transcription, plant.manifest)
    assert sorted(known) == list(range(transcription.program.constraints))
    words = " ".join(known.values())
    for name in (
        "start: e",
        "end: e",
        "forces by expressions",
        "contacts in interval 3",
        "start: the contacts",
        "friction",
    ):
        assert name in words


def read_leg(folder: Path, text: str = SQUAT) -> tuple[Problem, Plant]:
    (folder / "leg.yaml").write_text(LEG)
    (folder / "squat.ocp.yaml").write_text(text)
    return read_problem(folder / "squat.ocp.yaml", load)


def test_a_foot_is_held_in_the_re_simulation(tmp_path: Path) -> None:
    """The forces that hold it follow from the motion, so the defect is the error of the collocation, of its order."""
    problem, plant = read_leg(tmp_path)
    coarse, fine = (found(replace(problem, intervals=N), plant).resimulation for N in (6, 12))
    assert coarse is not None
    assert fine is not None
    for check in (coarse, fine):
        assert check.slip_along is not None
        assert check.slip_along < 1e-10
    assert coarse.defect is not None
    assert fine.defect is not None
    assert fine.defect < coarse.defect / 8
    assert fine.open_loop_error is not None
    assert fine.open_loop_error < 1e-4


def test_a_foot_stays_where_it_is_at_all_mesh_points(tmp_path: Path) -> None:
    """Its place is held there to rounding, on any mesh, and its velocity vanishes there."""
    problem, plant = read_leg(tmp_path)
    for N, degree in ((3, 2), (4, 3)):
        motion = found(replace(problem, intervals=N, degree=degree), plant).trajectory
        feet = plant("sensors", q=motion.q)["position"][:, :, 0]
        assert feet == pytest.approx(np.tile(feet[0], (N + 1, 1)), abs=1e-12)
        assert np.abs(plant("motion", q=motion.q, qd=motion.qd)["v"]).max() < 1e-9


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_conditions_that_contacts_imply_are_left_out(tmp_path: Path, method: str) -> None:
    """A whole end at rest has two velocities and two coordinates too many: the motion is that without them."""
    problem, plant = read_leg(tmp_path, SQUAT.replace("velocity: zero", "velocity: {hip: 0, knee: 0}"))
    problem = replace(problem, intervals=10).with_solver(method)
    least = found(problem, plant)
    pose = tuple(enumerate(least.trajectory.q[-1].tolist()))
    for end in (
        End(coordinates=problem.end.coordinates, velocity_zero=True),
        End(coordinates=pose, velocity_zero=True),
    ):
        whole = found(replace(problem, end=end), plant)
        assert len(whole.problem.end.velocities) == 2
        assert len(whole.problem.end.coordinates) == 2
        assert whole.trajectory.q[-1] == pytest.approx(np.array([value for _, value in pose]), abs=1e-8)
        assert whole.trajectory.qd[-1] == pytest.approx(np.zeros(4), abs=1e-8)
        assert whole.cost.total == pytest.approx(least.cost.total, rel=1e-8)
        assert whole.run.iterations <= least.run.iterations + 3


def test_an_end_that_contradicts_contacts_is_refused(tmp_path: Path) -> None:
    """A hip and a knee that move, and a trunk that does not; a trunk at a height that the leg does not have there."""
    problem, plant = read_leg(tmp_path)
    fast = End(coordinates=problem.end.coordinates, velocities=((0, 0.0), (1, 0.0), (2, 1.0), (3, 0.0)))
    with pytest.raises(ProblemError, match=r"end.velocities: the contacts imply values that differ .* by 0\.\d+ 1/s"):
        solve(replace(problem, end=fast), plant)
    high = End(coordinates=((0, 0.1), (1, 0.2), (2, 0.8), (3, -1.6)), velocity_zero=True)
    with pytest.raises(ProblemError, match=r"end.coordinates: the contacts imply values that differ"):
        solve(replace(problem, end=high), plant)


def test_accelerations_of_the_end_that_contradict_contacts_are_refused(tmp_path: Path) -> None:
    """A hip that speeds up alone; accelerations 0 of an end that may move. At rest, two of four follow from two."""
    problem, plant = read_leg(tmp_path)
    pose = problem.end.coordinates
    fast = End(coordinates=pose, velocity_zero=True, accelerations=((0, 0.0), (1, 0.0), (2, 1.0), (3, 0.0)))
    with pytest.raises(ProblemError, match=r"end.accelerations: the contacts imply values that differ .* 1/s²"):
        solve(replace(problem, end=fast), plant)
    with pytest.raises(ProblemError, match=r"end.accelerations: .* which are not all given; give the velocities"):
        solve(replace(problem, end=End(coordinates=pose, acceleration_zero=True)), plant)
    rest = replace(problem, end=End(coordinates=pose, velocity_zero=True, acceleration_zero=True))
    assert len(leave_out_surplus(rest, plant, find_end(problem, plant)).end.accelerations) == 2


def test_an_unknown_length_does_not_meet_implied_values(tmp_path: Path) -> None:
    """Implied values that move with a length are refused; with an unknown mass, and at rest, they are left out."""
    parameters = "parameters: {l: {value: 0.4, kind: differentiated}, m: {value: 5, kind: differentiated}}\nbodies:"
    model = (
        LEG.replace("bodies:", parameters)
        .replace("mass: 5", "mass: m")
        .replace("[0, 0, -0.4]}\n    m", "[0, 0, -l]}\n    m")
    )
    assert "-l" in model
    for name, guess in (("l", 0.4), ("m", 5.0)):
        (tmp_path / "leg.yaml").write_text(model)
        text = f"unknowns: {{{name}: {{guess: {guess}, range: [{0.9 * guess}, {1.1 * guess}]}}}}\n"
        (tmp_path / "squat.ocp.yaml").write_text(SQUAT + text)
        problem, plant = read_problem(tmp_path / "squat.ocp.yaml", load)
        q = np.array([0.0, 0.0, 0.8, -1.6])
        start = plant("sensors", q=problem.start_q)["position"] - plant("sensors", q=q)["position"]
        q[:2] = start[[0, 2], 0]
        assert len(leave_out_surplus(problem, plant, q).end.velocities) == 2
        whole = replace(problem, end=End(coordinates=tuple(enumerate(q.tolist())), velocity_zero=True))
        if name == "l":
            with pytest.raises(ProblemError, match=r"end.coordinates: .* by the contacts, which change with l; give"):
                leave_out_surplus(whole, plant, q)
        else:
            assert len(leave_out_surplus(whole, plant, q).end.coordinates) == 2


def test_accelerations_of_a_moving_end_follow_from_its_velocities(tmp_path: Path) -> None:
    """J_c qdd = -dJ_c/dt qd: accelerations that meet it are left out, the same without this term are refused."""
    problem, plant = read_leg(tmp_path)
    held, q = find_held(problem, plant.manifest), find_end(problem, plant)
    assert held is not None
    J = held.differentiate(plant, q[None], np.zeros((1, 4)))[0][0]
    qd = null_space(J) @ np.array([0.4, -0.7])
    bent = np.linalg.lstsq(J, -held.differentiate(plant, q[None], qd[None])[1][0])[0]
    assert np.abs(bent).max() > 0.01
    for qdd in (bent, np.zeros(4)):
        pairs = (tuple(enumerate(values.tolist())) for values in (q, qd, qdd))
        moving = replace(problem, end=End(coordinates=next(pairs), velocities=next(pairs), accelerations=next(pairs)))
        if qdd is bent:
            assert len(leave_out_surplus(moving, plant, q).end.accelerations) == 2
        else:
            with pytest.raises(ProblemError, match=r"end.accelerations: the contacts imply values that differ"):
                leave_out_surplus(moving, plant, q)


def find_end(problem: Problem, plant: Plant) -> Array:
    """Return a pose of the end that keeps the contacts."""
    return found(replace(problem, intervals=10), plant).trajectory.q[-1]


def test_velocities_of_contacts_are_differentiated(tmp_path: Path) -> None:
    """J_c qdd + dJ_c/dt qd is the derivative of the velocities along a motion, by differences."""
    problem, plant = read_leg(tmp_path)
    held = find_held(problem, plant.manifest)
    assert held is not None
    q, qd, qdd = np.random.default_rng(3).normal(size=(3, 4))

    def velocity(t: float) -> np.ndarray:
        found = plant("motion", q=q + t * qd + t**2 / 2 * qdd, qd=qd + t * qdd)["v"]
        return np.asarray(found.T.ravel()[held.entries])

    J, bias = held.differentiate(plant, q[None], qd[None])
    h = 1e-5
    assert J[0] @ qd == pytest.approx(velocity(0.0), abs=1e-12)
    assert J[0] @ qdd + bias[0] == pytest.approx((velocity(h) - velocity(-h)) / (2 * h), abs=1e-7)
