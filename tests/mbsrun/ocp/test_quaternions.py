"""Problems of bodies with quaternions: the known optima of a sphere, and conditions that keep them well posed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbsgen.errors import InputError
from mbsgen.expressions import evaluate
from mbsgen.model.construction import body, frame, free, make_model
from mbsgen.model.writer import write_model
from mbsrun import Mechanism
from mbsrun.external import load_on_demand
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.evaluation.backends.condensation import build as build_functions
from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import KernelResult
from mbsrun.ocp.ground.schemes import Family, build
from mbsrun.ocp.guessing.guess import bump, find_pose, interpolate, make_guess, rest
from mbsrun.ocp.methods.ipopt import pair
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import Bounds, Constraint, Cost, End, Form, Problem, Representation, Term
from mbsrun.ocp.showing.pictures import animate, plot_trajectories
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution, read_guess, write_solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.transcription import transcribe
from mbsrun.quaternions import find_rates
from mbsrun.simulation.drive import ARRAYS
from tests.mbsrun.ocp.phases.motions import split

MODELS = Path(__file__).parents[3] / "models"
FUNCTIONS = ("impl", "semi_res", "exp1", "exp2", "rates", "frames", "sensors", "motion")
MASS, INERTIA = 3.0, 2.0
AXIS, ANGLE, T, N = np.array([2.0, 1.0, 2.0]) / 3, 2.5, 2.0, 8
FREE = (-np.inf, np.inf)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a sphere that flies, with forces and moments along its axes, and no gravity."""
    sphere = body("ball", free(actuated=True), mass=MASS, inertia=(INERTIA,) * 3)
    file = tmp_path_factory.mktemp("sphere") / "sphere.yaml"
    model = make_model("sphere", [sphere], gravity=(0, 0, 0), frames=[frame("nose", "ball", position=(1, 0, 0))])
    file.write_text(write_model(model), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def sphere(file: Path) -> Mechanism:
    return Mechanism(find_folder(file, Extent(FUNCTIONS)))


def test_the_formula_of_rates_is_the_kernel(sphere: Mechanism) -> None:
    """For quaternions of any length."""
    rng = np.random.default_rng(2)
    q, qd = rng.normal(size=7), rng.normal(size=6)
    places, turn = range(3), range(3, 7)
    formula = formulas.turn([(turn, range(3, 6))], [(turn, places)], (7, 0), KernelResult("", (), ""))
    numbers = {f"q{i}": x for i, x in enumerate(q)} | {f"v{i}": x for i, x in enumerate(qd)}
    found = [np.asarray(evaluate(x, numbers, ARRAYS)).item() for x in formula.expressions]
    expected = sphere("rates", q=q, qd=qd)["rate"].ravel()
    assert found == pytest.approx([*expected[3:], *expected[:3]], rel=1e-14)


def attitude(axis: np.ndarray, angle: float) -> tuple[float, ...]:
    return (*(axis * np.sin(angle / 2)), np.cos(angle / 2))


def fly(place: tuple[float, ...], quaternion: tuple[float, ...]) -> Problem:
    """From rest at the origin to rest at a pose, with the least integral of squared inputs."""
    return Problem(
        name="fly",
        horizon=T,
        intervals=N,
        family=Family.RADAU,
        degree=4,
        cost=Cost(1.0),
        start_q=(0, 0, 0, 0, 0, 0, 1),
        start_qd=(0.0,) * 6,
        bounds=Bounds((FREE,) * 7, (FREE,) * 6, (FREE,) * 6),
        end=End(coordinates=tuple(enumerate((*place, *quaternion))), velocity_zero=True),
    )


TURN = fly((0, 0, 0), attitude(AXIS, ANGLE))
LEAST = 12 * (INERTIA * ANGLE) ** 2 / T**3 * N**2 / (N**2 - 1)


def optimum(problem: Problem, plant: Mechanism) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


@pytest.mark.parametrize("representation", Representation)
def test_a_turn_costs_what_a_double_integrator_does(sphere: Mechanism, representation: Representation) -> None:
    """A sphere turns about one axis, I theta'' = u: 12 (I theta)^2 / T^3 at least, by N constant u N^2/(N^2 - 1) of it.

    That factor is the least of h |u|^2 with h sum u = 0 and h^2 sum (N - k - 1/2) u_k = I theta.
    """
    solution = resimulate(optimum(replace(TURN, representation=representation), sphere), sphere)
    assert solution.cost.total == pytest.approx(LEAST, rel=1e-9)
    turns = Rotation.from_quat(solution.trajectory.q[:, 3:]).as_rotvec()
    assert turns == pytest.approx(np.outer(turns @ AXIS, AXIS), abs=1e-6)
    check, lengths = solution.resimulation, solution.violation.lengths
    assert check is not None
    assert check.is_accurate
    assert lengths is not None
    assert 0 < lengths < 1e-5


def test_legendre_points_keep_the_length(sphere: Mechanism) -> None:
    """Gauss's methods keep quadratic invariants: at mesh points the length is 1, to the solver's tolerance."""
    solution = optimum(replace(TURN, family=Family.LEGENDRE, degree=2), sphere)
    assert np.linalg.norm(solution.trajectory.q[:, 3:], axis=1) == pytest.approx(1, abs=1e-9)
    assert np.abs(np.linalg.norm(solution.trajectory.point_q[..., 3:], axis=2) - 1).max() > 1e-6


def test_either_sign_of_a_quaternion_is_the_same_end(sphere: Mechanism) -> None:
    """The far way is not taken because of a sign; a built program takes another attitude."""
    solver = Solver(TURN, sphere)
    away = fly((0, 0, 0), attitude(AXIS, ANGLE + 2 * np.pi))
    for problem, angle in ((away, ANGLE), (fly((0, 0, 0), attitude(AXIS, 1.0)), 1.0)):
        guess = make_guess(problem, sphere, solver.transcription.scheme)
        solution = solver.solve(problem, guess)
        assert isinstance(solution, Solution)
        assert solution.cost.total == pytest.approx(LEAST * (angle / ANGLE) ** 2, rel=1e-9)


def test_a_flight_costs_what_it_would_without_the_turn(sphere: Mechanism) -> None:
    """Forces are along the axes of the turning body, so the optimal ones are constant nowhere: up to N^-2."""
    problem = fly((1.0, -2.0, 0.5), attitude(AXIS, ANGLE))
    costs = [optimum(replace(problem, representation=Representation[r]), sphere).cost.total for r in ("IMPL", "EXP2_O")]
    assert costs[1] == pytest.approx(costs[0], rel=1e-8)
    assert costs[0] == pytest.approx(LEAST + 12 * MASS**2 * (1 + 4 + 0.25) / T**3, rel=2 / N**2)


def test_a_free_attitude_at_the_start_has_length_1(sphere: Mechanism) -> None:
    """From an attitude that is free the cheapest turn is none."""
    problem = replace(TURN, free_start=(3, 4, 5, 6))
    solution = optimum(problem, sphere)
    assert solution.cost.total == pytest.approx(0, abs=1e-9)
    q = solution.trajectory.q[0, 3:]
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-9)
    assert abs(q @ attitude(AXIS, ANGLE)) == pytest.approx(1, abs=1e-7)


def test_ipopt_finds_no_fault_in_the_derivatives(sphere: Mechanism, capfd: pytest.CaptureFixture[str]) -> None:
    """IPOPT compares first and second derivatives with its own differences."""
    problem = replace(
        fly((1.0, -2.0, 0.5), attitude(AXIS, ANGLE)),
        intervals=2,
        degree=1,
        representation=Representation.EXP1_O,
        horizon_range=(1.0, 3.0),
        free_start=(3, 4, 5, 6, 8),
        cost=Cost(1.0, 0.5, (Term("q_ball_qx*qd_ball_rx + u_ball_z*qdd_ball_rz", 2.0),), (Term("vx_nose", 1.0),)),
        end=replace(TURN.end, sensors=(("nose", (0.1, 0.2, 0.3)),), sensor_velocities=(("nose", (0.1, 0.0, 0.0)),)),
        constraints=(Constraint("q_ball_qw**2", (0.0, 0.5)),),
    )
    transcription = transcribe(problem, sphere)
    program = build_functions(transcription.program, sphere)
    x, p = ca.MX.sym("x", program.variables), ca.MX.sym("p", program.parameters)
    nlp = {"x": x, "p": p, "f": program.objective(x, p), "g": program.constraint(x, p)}
    functions = {"grad_f": program.gradient, "jac_g": pair(program.jacobian), "hess_lag": program.hessian}
    test = {"derivative_test": "second-order", "derivative_test_perturbation": 1e-7, "derivative_test_tol": 5e-3}
    options = {**functions, "ipopt": {**test, "point_perturbation_radius": 0.0, "max_iter": 0}, "print_time": False}
    start = np.random.default_rng(1).uniform(0.5, 1, program.variables)
    ca.nlpsol("check", "ipopt", nlp, options)(x0=start, p=transcription.parameters(problem))
    assert "No errors detected by derivative checker." in capfd.readouterr().out


def test_a_guess_turns_about_one_axis(sphere: Mechanism) -> None:
    """Its velocities make its coordinates: at fine points the polynomials' slopes are the rates."""
    problem = replace(fly((1.0, -2.0, 0.5), attitude(-AXIS, 6.0)), start_qd=(0.4, -0.2, 0.1, 0.5, 1.0, -0.7))
    scheme = build(Family.RADAU, 6)
    motion = make_guess(problem, sphere, scheme)
    assert motion.q[0] == pytest.approx(problem.start_q)
    assert motion.qd[0] == pytest.approx(problem.start_qd)
    assert motion.qd[-1] == pytest.approx(np.zeros(6), abs=1e-12)
    assert abs(motion.q[-1, 3:] @ attitude(-AXIS, 6.0)) == pytest.approx(1)
    assert np.linalg.norm(motion.point_q[..., 3:], axis=2) == pytest.approx(1)
    for values, slopes in (
        (
            (motion.q, motion.point_q),
            find_rates(sphere, *(x.reshape(-1, x.shape[-1]) for x in (motion.point_q, motion.point_qd))),
        ),
        ((motion.qd, motion.point_qd), motion.point_qdd.reshape(-1, 6)),
    ):
        nodes = np.concatenate((values[0][:-1, None], values[1]), axis=1)
        found = np.einsum("jr,krn->kjn", scheme.D, nodes) * N / T
        assert found.reshape(slopes.shape) == pytest.approx(slopes, abs=1e-4)
    straight = interpolate(replace(problem, start_qd=(0.0,) * 6), scheme, motion.q[-1], sphere)
    turns = Rotation.from_quat(straight.q[:, 3:]).as_rotvec()
    assert np.cross(turns, AXIS) == pytest.approx(np.zeros_like(turns), abs=1e-12)
    with pytest.raises(ValueError, match="give the plant"):
        interpolate(problem, scheme, motion.q[-1])


def test_a_pose_that_a_sensor_wants_has_quaternions_of_length_1(sphere: Mechanism) -> None:
    """Also half a turn away, where no direction is shorter."""
    bounds = replace(TURN.bounds, q=(*((0.0, 0.0),) * 3, *(FREE,) * 4))
    pose = find_pose(replace(TURN, bounds=bounds, end=End(sensors=(("nose", (-1.0, 0.0, 0.0)),))), sphere)
    assert pose.is_reached
    assert np.linalg.norm(pose.q[3:]) == pytest.approx(1)


STATEMENT = """\
model: sphere.yaml
constants: {half: 0.25}
horizon: 2
intervals: 8
scheme: radau
degree: 2
cost: {inputs: 1, running: [{expression: qd_ball_rx**2}]}
start:
  pose: {ball.qx: 3, ball.qw: 4}
  velocity: {ball.rx: 0.5}
bounds:
  coordinates: {ball.qz: [-0.5, 0.5]}
end:
  pose: {ball.x: 1, ball.qx: sin(half), ball.qy: 0, ball.qz: 0, ball.qw: -cos(half)}
  velocity: {ball.ry: 0}
"""


def test_problem_files_speak_of_quaternions_by_name(sphere: Mechanism, file: Path) -> None:
    """They are scaled to length 1; missing entries of the start are taken from the identity."""
    path = file.with_name("sphere.ocp.yaml")
    path.write_text(STATEMENT, encoding="utf-8")
    problem, _ = read_problem(path, lambda _: sphere)
    assert problem.start_q == pytest.approx((0, 0, 0, 0.6, 0, 0, 0.8))
    assert problem.start_qd == (0, 0, 0, 0.5, 0, 0)
    assert problem.bounds.q[5] == (-0.5, 0.5)
    assert problem.bounds.q[6] == FREE
    indices, values = zip(*problem.end.coordinates, strict=True)
    assert indices == (0, 3, 4, 5, 6)
    assert values == pytest.approx((1, np.sin(0.25), 0, 0, -np.cos(0.25)))
    assert problem.end.velocities == ((4, 0.0),)
    path.write_text(STATEMENT.replace("sin(half)", "2*sin(half)").replace("-cos(half)", "-2*cos(half)"), "utf-8")
    assert dict(read_problem(path, lambda _: sphere)[0].end.coordinates) == pytest.approx(dict(problem.end.coordinates))
    for old, new, fault in (
        ("ball.qx: 3, ball.qw: 4", "ball.qw: 0", "start.pose: the quaternion of ball is 0; give ball.qw too"),
        ("ball.qx: 3", "ball.qx: null", "start.pose: the quaternion of ball is free in part; give null for all four"),
        ("ball.qx: 3", "ball.rx: 3", "start.pose.*: the model has no coordinate"),
        ("{ball.rx: 0.5}", "{ball.qx: 0.5}", "start.velocity.*: the model has no velocity"),
        (", ball.qw: -cos(half)", "", "end.pose.*: only a part of the quaternion of ball; give ball.qw too, or"),
        ("ball.qz: [-0.5, 0.5]", "ball.qx: [2, 3]", "bounds.coordinates: no quaternion of ball has length 1"),
        ("ball.qz: [-0.5, 0.5]", "ball.qx: [0.5, 1]", "end.pose.*: the attitude of ball is out of bounds"),
        (
            "horizon: 2",
            "integrator: second-order\nhorizon: 2",
            "integrator: a quaternion is not the integral",
        ),
    ):
        assert old in STATEMENT
        path.write_text(STATEMENT.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(InputError, match=fault):
            read_problem(path, lambda _: sphere)


@pytest.mark.parametrize("representation", [Representation.IMPL, Representation.EXP1_O])
@pytest.mark.parametrize("form", [Form.INTEGRAL, Form.SHOOTING])
def test_other_forms_have_the_same_optimum(sphere: Mechanism, form: Form, representation: Representation) -> None:
    """With a bound on a quaternion's entry, which is a row at points that are no variables."""
    bounds = replace(TURN.bounds, q=((-5.0, 5.0),) * 6 + ((0.0, 1.1),))
    problem = replace(TURN, representation=representation, bounds=bounds)
    standard, other = (optimum(replace(problem, form=f), sphere) for f in (Form.STANDARD, form))
    assert other.cost.total == pytest.approx(standard.cost.total, rel=1e-8)
    for name in ("q", "qd", "point_q", "point_qd", "point_qdd"):
        found, expected = getattr(other.trajectory, name), getattr(standard.trajectory, name)
        assert found == pytest.approx(expected, abs=1e-5), name


def test_a_part_of_a_quaternion_is_refused(sphere: Mechanism) -> None:
    """At the end it would be no attitude, at the start no length would be given."""
    for key, problem in (
        ("start", replace(TURN, free_start=(6,))),
        ("end", replace(TURN, end=End(coordinates=((4, 0.5), (5, 0.5))))),
    ):
        with pytest.raises(ValueError, match=f"{key}: a part of the quaternion of ball"):
            transcribe(problem, sphere)
    with pytest.raises(ValueError, match="a bump on a quaternion"):
        bump(rest(TURN, build(Family.RADAU, 2), sphere), (3,), np.random.default_rng(0))


def test_the_satellite_turns(requires: Callable[[str], str], tmp_path: Path) -> None:
    """The problem that ships; its file is read back, and its pictures are drawn."""
    requires("cc")
    problem, plant = read_problem(MODELS / "satellite_turn.ocp.yaml", load_on_demand)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    solution = resimulate(outcome, plant)
    assert solution.resimulation is not None
    assert solution.resimulation.is_accurate
    write_solution(solution, tmp_path / "solution.json")
    again = read_guess(tmp_path / "solution.json", plant.manifest)
    assert again.q == pytest.approx(solution.trajectory.q, abs=0)
    plot_trajectories(solution, plant.manifest, tmp_path / "trajectories.png")
    animate(solution, plant, tmp_path / "animation.html")


def test_phases_carry_an_attitude_on(sphere: Mechanism) -> None:
    """The turn in two phases costs what it does in one; the second one's quaternion starts with length 1."""
    problem = split(replace(TURN, representation=Representation.EXP1_O))
    found = solve_phases(problem, Plants((sphere, sphere)))
    assert isinstance(found, PhasedSolution)
    assert found.cost == pytest.approx(LEAST, rel=1e-7)
    ends = found.phases[0].trajectory.q[-1], found.phases[1].trajectory.q[0]
    first, second = (q[3:] / np.linalg.norm(q[3:]) for q in ends)
    assert abs(first @ second) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(ends[1][3:]) == pytest.approx(1.0, abs=1e-9)
