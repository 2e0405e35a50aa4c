"""Solving: closed forms, the paper's task, IPOPT's own derivative test, and what fails."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mbsrun.external import load
from mbsrun.ocp.evaluation.backends.casadi import Functions
from mbsrun.ocp.evaluation.backends.condensation import build
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.status import BAD_BOUNDS, BAD_GUESS, UNREACHABLE
from mbsrun.ocp.guessing.guess import interpolate
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.methods.ipopt import pair
from mbsrun.ocp.problem.phases import list_one
from mbsrun.ocp.problem.problem import Bounds, Constraint, Cost, End, Problem, SolverOptions, Term, cylindrical
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.runs import Progress
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.plants import FREE_RANGE, mechanism, push
from tests.mbsrun.peer import Peer, double_integrator, pose_functions, residual_function
from tests.shipped import FOLDER


@pytest.mark.parametrize(
    ("family", "degree"), [(Family.RADAU, 2), (Family.RADAU, 4), (Family.LEGENDRE, 2), (Family.LEGENDRE, 3)]
)
def test_double_integrator_with_piecewise_constant_input(family: Family, degree: int) -> None:
    """u_k = 12 (1/2 - t_k) / (1 - 1/N^2) at the middles t_k, cost 12 / (1 - 1/N^2): least squares under two moments.

    Degree 2 and above integrate a constant acceleration exactly, so the optimum is free of discretisation.
    """
    N = 8
    outcome = solve(push(N, family, degree), double_integrator())
    assert isinstance(outcome, Solution)
    middles = (np.arange(N) + 0.5) / N
    assert outcome.trajectory.u[:, 0] == pytest.approx(12 * (0.5 - middles) / (1 - 1 / N**2), abs=1e-7)
    assert outcome.cost.total == pytest.approx(12 / (1 - 1 / N**2), rel=1e-9)


def test_double_integrator_tends_to_the_continuous_optimum() -> None:
    """12 J for u(t) = 6 - 12 t, from below 12 / (1 - 1/N^2): the control grid's error falls with 1/N^2."""
    errors = []
    for N in (4, 8, 16):
        outcome = solve(push(N), double_integrator())
        assert isinstance(outcome, Solution)
        errors.append(outcome.cost.total - 12)
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2, 2], abs=0.1)


def test_rates_are_penalised_without_end_terms() -> None:
    """With the weight of the rates alone: the least sum of N - 1 squared differences under two moments of u.

    The moments are sum h u_k = 0 and sum h u_k (T - t_k) = 1, t_k the middles; found by its optimality conditions.
    """
    N = 8
    h = 1 / N
    outcome = solve(replace(push(N), cost=Cost(0.0, 1.0)), double_integrator())
    assert isinstance(outcome, Solution)
    C = h * np.stack((np.ones(N), 1 - (np.arange(N) + 0.5) * h))
    differences = np.diff(np.eye(N), axis=0)
    K = np.block([[2 / h * differences.T @ differences, C.T], [C, np.zeros((2, 2))]])
    u = np.linalg.solve(K, np.concatenate((np.zeros(N), [0.0, 1.0])))[:N]
    assert outcome.trajectory.u[:, 0] == pytest.approx(u, abs=1e-7)
    assert outcome.cost.input_rates == pytest.approx((np.diff(u) ** 2).sum() / h, rel=1e-9)
    assert outcome.cost.inputs == 0


def test_bounds_of_inputs_hold() -> None:
    """|u| <= 4.5 makes the push bang-like: within its bounds, and dearer than without."""
    bounded = replace(push(16), bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((-4.5, 4.5),)))
    outcome = solve(bounded, double_integrator())
    assert isinstance(outcome, Solution)
    assert np.abs(outcome.trajectory.u).max() == pytest.approx(4.5, abs=1e-6)
    assert outcome.cost.total > 12 / (1 - 1 / 16**2) + 1e-3


# --- the paper's task ----------------------------------------------------------------------------------------------


def test_optimum_of_the_papers_task(reached: Solution) -> None:
    """2.8881463e7, as an independent rebuild found, in no more iterations than its 34."""
    assert reached.run.status == "Solve_Succeeded"
    assert reached.cost.total == pytest.approx(2.8881463e7, rel=1e-7)
    assert reached.run.iterations <= 34
    assert (reached.size.variables, reached.size.constraints, reached.size.jacobian_nonzeros) == (8812, 8427, 72435)
    assert 0 < reached.run.seconds_evaluating < reached.run.seconds


def test_the_papers_task_ends_as_asked(arm: Peer, reach: Problem, reached: Solution) -> None:
    """At T the hand is at the target, all is at rest, and the inputs balance gravity (eqs. 23-25)."""
    trajectory = reached.trajectory
    hand = arm("sensors", q=trajectory.q[-1])["position"][:, 0]
    assert hand == pytest.approx(dict(reach.end.sensors)["hand"], abs=1e-7)
    assert np.abs(trajectory.qd[-1]).max() < 1e-7
    zero = np.zeros(6)
    assert np.abs(arm("impl", q=trajectory.q[-1], qd=zero, qdd=zero, u=trajectory.u[-1])["Phi"]).max() < 1e-6
    assert trajectory.q[0] == pytest.approx(reach.start_q, abs=1e-7)


def test_violations_are_those_of_the_trajectory(arm: Peer, reach: Problem, reached: Solution) -> None:
    """Recomputed from the arrays alone: the dynamics at all points, and the limits (IPOPT relaxes them by 1e-8)."""
    trajectory = reached.trajectory
    u = np.repeat(trajectory.u[:, None], reach.degree, axis=1)
    q, qd, qdd = trajectory.point_q, trajectory.point_qd, trajectory.point_qdd
    Phi = arm("impl", q=q.reshape(-1, 6), qd=qd.reshape(-1, 6), qdd=qdd.reshape(-1, 6), u=u.reshape(-1, 4))["Phi"]
    assert np.abs(Phi).max() <= reached.violation.constraints + 1e-12 < 1e-7
    lower, upper = np.array(reach.bounds.q).T
    outside = max(np.maximum(lower - q, q - upper).max(), np.maximum(lower - trajectory.q, trajectory.q - upper).max())
    assert reached.violation.bounds == pytest.approx(max(outside, 0), abs=1e-15)
    assert reached.violation.bounds < 1e-7


def test_the_mirrored_target_has_the_mirrored_motion(arm: Peer, reach: Problem, reached: Solution) -> None:
    """The arm is symmetric about its plane: phi = -pi/2 costs the same, with q1 and q5 reversed."""
    mirrored = solve(reach.with_target("hand", (0.0, -0.63, -0.1)), arm)
    assert isinstance(mirrored, Solution)
    assert mirrored.cost.total == pytest.approx(reached.cost.total, rel=1e-9)
    sign = np.array([-1, 1, 1, 1, -1, 1])
    assert mirrored.trajectory.q == pytest.approx(reached.trajectory.q * sign, abs=1e-5)


def test_a_solver_serves_other_targets_starts_and_weights(arm: Peer, reach: Problem) -> None:
    """One program, three problems; each ends as with a separate solver."""
    near = reach.with_target("hand", cylindrical(0.65, 0.01, 0.0))
    coarse = replace(near, intervals=6, degree=3)
    solver = Solver(coarse, arm)
    problems = (
        coarse,
        replace(coarse.with_target("hand", cylindrical(0.64, 0.0, 0.01)), cost=Cost(2.0, 10.0)),
        replace(coarse, start_qd=(0.02, 0.0, 0.0, 0.0, 0.0, 0.0)),
    )
    for problem in problems:
        guess = interpolate(problem, solver.transcription.scheme, np.array(problem.start_q))
        shared, own = solver.solve(problem, guess), Solver(problem, arm).solve(problem, guess)
        assert isinstance(shared, Solution)
        assert isinstance(own, Solution)
        assert np.array_equal(shared.trajectory.u, own.trajectory.u)
        assert shared.problem == problem


def test_a_solver_refuses_a_problem_of_another_structure(arm: Peer, reach: Problem) -> None:
    solver = Solver(replace(reach, intervals=4), arm)
    guess = interpolate(reach, schemes.build(Family.RADAU, 4), np.array(reach.start_q))
    with pytest.raises(ValueError, match="differs in structure"):
        solver.solve(reach, guess)


def test_the_watch_sees_every_iteration() -> None:
    """The first is the guess, the last the optimum; with the true cost, however the objective is scaled."""
    seen: list[Progress] = []
    problem = replace(push(8), solver=SolverOptions(objective_scaling=1e-3))
    outcome = solve(problem, double_integrator(), seen.append)
    assert isinstance(outcome, Solution)
    assert [progress.iteration for progress in seen] == list(range(outcome.run.iterations + 1))
    assert seen[-1].cost == pytest.approx(outcome.cost.total, rel=1e-6)
    assert seen[-1].violation == pytest.approx(outcome.violation.constraints, abs=1e-12)


def test_what_a_watch_raises_comes_out() -> None:
    """CasADi turns exceptions of callbacks into warnings; the watch's own comes back to its caller."""

    def grumble(progress: Progress) -> None:
        raise RuntimeError(f"enough at {progress.iteration}")

    with pytest.raises(RuntimeError, match="enough at 0"):
        solve(push(8), double_integrator(), grumble)


# --- guesses -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", ["rest", "interpolation"])
@pytest.mark.parametrize("inputs", ["zero", "static", "dynamic"])
def test_every_guess_leads_to_the_optimum(arm: Peer, reach: Problem, motion: str, inputs: str) -> None:
    """A small step aside has one minimum."""
    near = replace(reach.with_target("hand", cylindrical(0.65, 0.05, 0.0)), intervals=10, degree=3)
    chosen = replace(near, guess=replace(near.guess, motion=motion, inputs=inputs))
    outcome, usual = solve(chosen, arm), solve(near, arm)
    assert isinstance(outcome, Solution)
    assert isinstance(usual, Solution)
    assert outcome.cost.total == pytest.approx(usual.cost.total, rel=1e-7)


def test_a_solution_of_another_grid_is_a_guess(arm: Peer, reach: Problem, reached: Solution) -> None:
    """Half the intervals and another degree, from the optimum: fewer iterations than from afar."""
    coarse = replace(reach, intervals=50, degree=3)
    far, near = solve(coarse, arm), solve(coarse, arm, guess=reached.trajectory)
    assert isinstance(far, Solution)
    assert isinstance(near, Solution)
    assert near.cost.total == pytest.approx(far.cost.total, rel=1e-8)
    assert near.run.iterations < far.run.iterations


# --- derivatives as IPOPT sees them --------------------------------------------------------------------------------


def check_derivatives(program: Functions, p: np.ndarray, x0: np.ndarray, **scaled: ca.Function) -> None:
    """Have IPOPT compare the derivatives with differences; it prints what it finds."""
    x, weights = ca.MX.sym("x", program.variables), ca.MX.sym("p", 2)
    nlp = {"x": x, "p": weights, "f": program.objective(x, weights), "g": program.constraint(x, weights)}
    functions = {"grad_f": program.gradient, "jac_g": pair(program.jacobian), "hess_lag": program.hessian, **scaled}
    test = {"derivative_test": "second-order", "derivative_test_perturbation": 1e-7, "derivative_test_tol": 5e-3}
    solver = ca.nlpsol("check", "ipopt", nlp, {**functions, "ipopt": {**test, "max_iter": 0}, "print_time": False})
    solver(x0=x0, p=p, lbg=0, ubg=0)


@pytest.fixture
def tiny(arm: Peer, reach: Problem) -> tuple[Functions, np.ndarray, np.ndarray]:
    """The arm and its hand on two intervals, with weights and a point."""
    end = replace(reach.end, velocity_zero=False, acceleration_zero=False)
    problem = replace(reach, intervals=2, degree=1, cost=Cost(1.0, 1.0), end=end)
    transcription = transcribe(problem, arm)
    x0 = np.random.default_rng(3).uniform(-0.5, 0.5, transcription.layout.size)
    return build(transcription.program, arm), transcription.parameters(problem), x0


def test_ipopt_finds_no_fault_in_the_derivatives(
    tiny: tuple[Functions, np.ndarray, np.ndarray], capfd: pytest.CaptureFixture[str]
) -> None:
    check_derivatives(*tiny)
    assert "No errors detected by derivative checker." in capfd.readouterr().out


@pytest.mark.parametrize(("name", "result", "factor"), [("jac_g", 1, 1.1), ("hess_lag", 0, 1.5)])
def test_ipopt_finds_the_fault_in_scaled_derivatives(
    tiny: tuple[Functions, np.ndarray, np.ndarray],
    capfd: pytest.CaptureFixture[str],
    name: str,
    result: int,
    factor: float,
) -> None:
    """So it does use them."""
    program, p, x0 = tiny
    true = {"jac_g": pair(program.jacobian), "hess_lag": program.hessian}[name]
    inputs = true.mx_in()
    results = list(true.call(inputs))
    results[result] *= factor
    scaled = ca.Function(true.name(), inputs, results, true.name_in(), true.name_out())
    check_derivatives(program, p, x0, **{name: scaled})
    assert "Derivative checker detected" in capfd.readouterr().out


# --- failures ------------------------------------------------------------------------------------------------------


def test_a_target_out_of_reach_is_a_failure_at_once(arm: Peer, reach: Problem) -> None:
    outcome = solve(reach.with_target("hand", (1.5, 0.0, 0.0)), arm)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == UNREACHABLE
    assert outcome.run.iterations == 0
    assert "0.8 m" in outcome.finding


def test_bounds_that_cross_are_a_failure_that_names_them(arm: Peer, reach: Problem) -> None:
    bounds = replace(reach.bounds, qd=(*reach.bounds.qd[:2], (1.0, -1.0), *reach.bounds.qd[3:]))
    outcome = Solver(replace(reach, intervals=2), arm).solve(
        replace(reach, intervals=2, bounds=bounds),
        interpolate(replace(reach, intervals=2), schemes.build(Family.RADAU, 4), np.array(reach.start_q)),
    )
    assert isinstance(outcome, Failure)
    assert outcome.run.status == BAD_BOUNDS
    assert "velocity q3 are [1, -1]" in outcome.finding


@pytest.mark.parametrize("bad", [(np.nan, 1.0), (np.inf, np.inf), (-np.inf, -np.inf)])
def test_bounds_that_no_number_keeps_are_a_failure(bad: tuple[float, float]) -> None:
    outcome = solve(replace(push(8), bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), (bad,))), double_integrator())
    assert isinstance(outcome, Failure)
    assert outcome.run.status == BAD_BOUNDS


def test_a_guess_that_is_not_finite_is_a_failure() -> None:
    """F23: what is returned is never the guess; here nothing is."""
    guess = interpolate(push(8), schemes.build(Family.RADAU, 2), np.array([np.nan]))
    outcome = Solver(push(8), double_integrator()).solve(push(8), guess)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == BAD_GUESS


def test_a_stationary_guess_is_not_taken_for_an_optimum() -> None:
    """F23: a cost without lower bound, guessed at its saddle: q(T)^3 from rest; IPOPT alone reports success there."""
    fall = replace(
        push(4),
        cost=Cost(0.0, 0.0, terminal=(Term("q_slide**3", 1.0),)),
        end=End(),
        solver=SolverOptions(max_iterations=60),
    )
    solver = Solver(fall, double_integrator())
    still = interpolate(fall, solver.transcription.scheme, np.zeros(1))
    own, ones = solver.transcription, np.ones(solver.program.data.kept.size)
    bounds = (*own.variable_bounds(fall), *own.constraint_bounds(fall))
    run = solver.whole._call(list_one(fall), Instance(own.pack(still), own.parameters(fall), *bounds, None, ones)).run
    assert (run.status, run.iterations) == ("Solve_Succeeded", 0)
    assert isinstance(solver.solve(fall, still), Failure)


def test_an_optimum_survives_being_moved_a_little() -> None:
    """From the optimum itself: nothing to improve, so it is moved, and found again."""
    solver = Solver(push(8), double_integrator())
    first = solve(push(8), double_integrator())
    assert isinstance(first, Solution)
    again = solver.solve(push(8), first.trajectory)
    assert isinstance(again, Solution)
    assert again.run.iterations > 0
    assert again.cost.total == pytest.approx(first.cost.total, rel=1e-9)


def residual_of_a_mass() -> tuple[ca.SX, tuple[ca.SX, ...]]:
    q, qd, qdd, u = symbols = tuple(ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return qdd - u + 0 * q + 0 * qd, symbols


def test_an_infeasible_problem_is_a_failure() -> None:
    """1 m in 1 s from rest to rest needs |u| >= 4, and rates of the inputs, and |qd| >= 1: with less there is no way.

    The message names conditions that stay violated, and the limits that keep them so.
    """
    weak = Bounds((FREE_RANGE,), (FREE_RANGE,), ((-2.0, 2.0),))
    lazy = Bounds((FREE_RANGE,), (FREE_RANGE,), (FREE_RANGE,), rates=((-1.0, 1.0),))
    slow = Constraint("qd_x", (-np.inf, 0.5))
    own = mechanism(("x",), *residual_of_a_mass())
    for problem, limit in (
        (replace(push(8), bounds=weak), "the bounds of the input x"),
        (replace(push(8), bounds=lazy), "the rate of the input x"),
        (replace(push(8), constraints=(slow,)), "constraint qd_x"),
    ):
        outcome = solve(problem, own)
        assert isinstance(outcome, Failure)
        assert outcome.run.status == "Infeasible_Problem_Detected"
        conditions, limits = outcome.finding.split("; at their limits: ")
        assert "end: x" in conditions
        assert "interval" not in conditions
        assert limit in limits


def test_too_few_iterations_are_a_failure(arm: Peer, reach: Problem) -> None:
    hasty = replace(reach, intervals=5, solver=SolverOptions(max_iterations=2))
    outcome = solve(hasty, arm)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == "Maximum_Iterations_Exceeded"
    assert "2 iterations" in outcome.finding


def test_more_equations_than_unknowns_are_a_failure() -> None:
    """Two conditions at the end and one input."""
    outcome = solve(push(1), double_integrator())
    assert isinstance(outcome, Failure)
    assert outcome.run.status == "Not_Enough_Degrees_Of_Freedom"


def test_a_kernel_that_is_not_finite_at_the_guess_is_a_failure() -> None:
    """sqrt of a negative number: IPOPT stops at the guess, which is no solution."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    p = ca.vertcat(q, 0, 0)
    good = double_integrator()
    bad = Peer(
        "broken",
        {
            "impl": residual_function(q, qd, qdd, u, qdd - u + ca.sqrt(-1 - q**2)),
            **pose_functions(q, p, p, ca.SX.eye(3)),
        },
        good.manifest.coordinates,
        good.manifest.frames[:1],
    )
    outcome = solve(push(8), bad)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == "Invalid_Number_Detected"


def test_a_target_of_one_axis_is_the_condition_at_the_end_that_states_it() -> None:
    """The hand of a planar arm at y = 0.45 m, anywhere along x: by a target, by a constraint, and by both solvers."""
    problem, plant = read_problem(FOLDER / "planar_arm_reach.ocp.yaml", load)
    problem = replace(problem, intervals=12, end=replace(problem.end, sensors=(("hand", (None, 0.45, None)),)))
    stated = replace(
        problem,
        end=replace(problem.end, sensors=()),
        constraints=(*problem.constraints, Constraint("y_hand", (0.45, 0.45), "end")),
    )
    found = []
    for each in (problem, stated, replace(problem, solver=replace(problem.solver, method="mbs"))):
        outcome = solve(each, plant)
        assert isinstance(outcome, Solution)
        found.append(outcome)
    assert [each.cost.total for each in found] == pytest.approx([found[1].cost.total] * 3, rel=1e-6)
    hand = plant("frames", q=found[0].trajectory.q[-1])["p"][:, [f.name for f in plant.manifest.frames].index("hand")]
    assert hand[1:] == pytest.approx([0.45, 0], abs=1e-7)
    assert abs(hand[0] - 0.3) > 0.01  # where the whole target is
