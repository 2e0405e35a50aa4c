"""Optimal control of closed loops: both forms against minimal coordinates, against each other and against CasADi."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.formulations.reductions import Reductions
from mbsgen.pipeline import Options, make
from mbsgen.roles import Role
from mbsrun.closure import CLOSED, Closure
from mbsrun.external import load_on_demand
from mbsrun.ocp import methods
from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.evaluation.backends.numpy import build
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.status import JUMPED, OPEN, SOLVED
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Cost,
    End,
    Form,
    Loops,
    Problem,
    Representation,
    SolverOptions,
    Term,
)
from mbsrun.ocp.problem.structure import structure
from mbsrun.ocp.solution.phases import Guess, PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Solution, read_solution, write_solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.preparation import settle
from mbsrun.ocp.solving.resimulation import Constant, accelerations, integrate, resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.closed_plants import FIVE_BAR_POSE, G, five_bar, pendulum_of_rods
from tests.mbsrun.ocp.phases.motions import cut, split
from tests.mbsrun.ocp.plants import FREE_RANGE, mechanism
from tests.mbsrun.ocp.programs import check_derivatives, unroll
from tests.mbsrun.peer import Peer

MODELS = Path(__file__).parents[3] / "models"
FORMS = [
    (Loops.MULTIPLIERS, Representation.IMPL),
    (Loops.MULTIPLIERS, Representation.EXP1_O),
    (Loops.MULTIPLIERS, Representation.EXP2_A),
    (Loops.REDUCED, Representation.IMPL),
    (Loops.REDUCED, Representation.EXP1_O),
    (Loops.REDUCED, Representation.EXP1_A),
]


@cache
def arms() -> Peer:
    return five_bar()


@cache
def rods() -> Peer:
    return pendulum_of_rods()


def reach(loops: Loops | None = None, representation: Representation = Representation.IMPL, N: int = 8) -> Problem:
    """Move the hand of the five-bar to a side and up, from rest to rest."""
    q = Closure(arms()).close(np.array(FIVE_BAR_POSE), (0, 2))
    hand = arms()("sensors", q=q[None])["position"].ravel()
    x, y, z = hand + np.array([0.1, 0.08, 0.0])
    return Problem(
        name="reach",
        horizon=0.8,
        intervals=N,
        family=Family.RADAU,
        degree=3,
        representation=representation,
        loops=loops,
        cost=Cost(1.0),
        start_q=tuple(q.tolist()),
        start_qd=(0.0,) * 4,
        bounds=Bounds((FREE_RANGE,) * 4, (FREE_RANGE,) * 4, (FREE_RANGE,) * 2),
        end=End(sensors=(("hand", (float(x), float(y), float(z))),), velocity_zero=True),
    )


@cache
def solved(loops: Loops, representation: Representation, N: int = 8) -> Solution:
    found = solve(reach(loops, representation, N), arms())
    assert isinstance(found, Solution)
    return found


def rich(loops: Loops, representation: Representation, family: Family, *, free: bool) -> Problem:
    """Ask for everything that a problem can ask for."""
    return replace(
        reach(loops, representation, 2),
        family=family,
        degree=2,
        horizon_range=(0.4, 1.0) if free else None,
        free_start=(0, 1, 3, 5, 6, 7) if free else (),
        cost=Cost(3.0, 0.5, (Term("(q_left_elbow - a)**2 + u_left*qd_left", 2.0),), (Term("T**2 + qdd_right", 4.0),)),
        end=End(
            coordinates=((1, -0.5),),
            velocities=((0, 0.5),),
            accelerations=((2, 1.5),),
        ),
        constraints=(
            Constraint("x_hand**2 + a*t", (-1.0, 2.0)),
            Constraint("vx_hand" if free else "q_right_elbow", (0.0, 2.0), "end"),
        ),
        constants=(("a", 0.3),),
    )


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize(("loops", "representation"), [FORMS[0], FORMS[2], FORMS[3], FORMS[4]])
def test_derivatives_are_casadis_of_the_same_program(loops: Loops, representation: Representation, free: bool) -> None:
    check_derivatives(rich(loops, representation, Family.RADAU, free=free), arms())


@pytest.mark.parametrize("loops", Loops)
def test_the_functions_in_numpy_are_the_ones_in_casadi(loops: Loops) -> None:
    problem = rich(loops, Representation.IMPL, Family.RADAU, free=True)
    transcription = transcribe(problem, arms())
    ours, theirs = build(transcription.program, arms()), condensation.build(transcription.program, arms())
    rng = np.random.default_rng(3)
    x, p = rng.uniform(0.5, 1, theirs.variables), transcription.parameters(problem)
    lam = rng.uniform(-1, 1, theirs.constraints)
    assert ours.constraint(x, p) == pytest.approx(theirs.constraint(x, p).full().ravel(), rel=1e-12, abs=1e-12)
    for found, expected in (
        (ours.jacobian(x, p), theirs.jacobian(x, p)),
        (ours.hessian(x, p, 0.7, lam), theirs.hessian(x, p, 0.7, lam)),
    ):
        assert found.toarray() == pytest.approx(ca.DM(expected).full(), rel=1e-11, abs=1e-11)


@pytest.mark.parametrize(("loops", "representation"), FORMS)
def test_all_forms_find_one_optimum_and_keep_the_loops_closed(loops: Loops, representation: Representation) -> None:
    """On one mesh, costs differ by the error of the discretisation, some h^5; loops are closed to rounding."""
    found = solved(loops, representation)
    assert found.cost.total == pytest.approx(solved(*FORMS[0]).cost.total, rel=1e-5)
    assert found.violation.closure is not None
    assert found.violation.closure < 1e-10
    assert found.violation.closure_rate is not None
    assert found.violation.closure_rate < 1e-9


@pytest.mark.parametrize(("loops", "representation"), [FORMS[0], FORMS[1], FORMS[3]])
def test_a_solution_holds_the_forces_of_its_loops(loops: Loops, representation: Representation, tmp_path: Path) -> None:
    """They are the ones of the explicit dynamics; with multipliers, up to the error of the discretisation."""
    found = solved(loops, representation)
    assert found.equations == ("loop.x", "loop.y")
    assert found.multipliers is not None
    motion = found.trajectory
    (N, d, n), forces = motion.point_q.shape, found.multipliers
    state = {name: x.reshape(N * d, n) for name, x in (("q", motion.point_q), ("qd", motion.point_qd))}
    expected = arms()("exp1", **state, u=np.repeat(motion.u, d, axis=0))["lam"].reshape(forces.shape)
    exact = loops is Loops.REDUCED
    assert np.abs(forces - expected).max() < (1e-6 if exact else 0.05) * np.abs(expected).max()
    write_solution(found, tmp_path / "solution.json")
    again = read_solution(tmp_path / "solution.json")
    assert (again.multipliers == forces).all()
    write_table(found, arms(), tmp_path / "solution.csv")
    header, *rows = (tmp_path / "solution.csv").read_text(encoding="utf-8").splitlines()
    place = header.split(",").index("lam[loop.x] [N]")
    assert float(rows[1].split(",")[place]) == forces[0, 0, 0]


def test_legendre_points_close_the_loops_at_mesh_points_too() -> None:
    problem = replace(reach(Loops.REDUCED), family=Family.LEGENDRE)
    found = solve(problem, arms())
    assert isinstance(found, Solution)
    assert found.cost.total == pytest.approx(solved(*FORMS[0]).cost.total, rel=1e-4)
    assert Closure(arms()).measure(found.trajectory.q) < 1e-10


DISCRETISATIONS: dict[str, dict[str, Any]] = {
    "integral": {"form": Form.INTEGRAL},
    "integral, slopes": {"form": Form.INTEGRAL, "representation": Representation.EXP1_O},
    "integral, explicit": {"form": Form.INTEGRAL, "representation": Representation.EXP1_A},
    "shooting": {"form": Form.SHOOTING},
    "shooting, explicit": {"form": Form.SHOOTING, "representation": Representation.EXP1_O},
}
METHODS: dict[str, dict[str, Any]] = {
    "two steps": {"form": Form.SHOOTING, "steps": 2},
    "rk4": {"form": Form.SHOOTING, "representation": Representation.EXP1_O, "integrator": "rk4", "steps": 3},
    "legendre": {"form": Form.SHOOTING, "family": Family.LEGENDRE},
    "integral, legendre": {"form": Form.INTEGRAL, "family": Family.LEGENDRE},
    "second order": {"form": Form.INTEGRAL, "integrator": SECOND_ORDER},
}


@pytest.mark.parametrize("name", DISCRETISATIONS)
def test_integral_form_and_shooting_are_collocation(name: str) -> None:
    """Nothing but the unknowns differs: the same optimum, to the tolerance of the solver."""
    found = solve(replace(reach(Loops.REDUCED), **DISCRETISATIONS[name]), arms())
    expected = solved(Loops.REDUCED, Representation.IMPL)
    assert isinstance(found, Solution)
    assert found.cost.total == pytest.approx(expected.cost.total, rel=1e-9)
    assert found.trajectory.point_q == pytest.approx(expected.trajectory.point_q, abs=1e-7)
    assert found.trajectory.point_qd == pytest.approx(expected.trajectory.point_qd, abs=1e-6)
    assert found.trajectory.point_qdd == pytest.approx(expected.trajectory.point_qdd, abs=1e-4)
    _check_closure(found)


@pytest.mark.parametrize("name", METHODS)
def test_other_methods_keep_loops_closed_wherever_they_are_read(name: str) -> None:
    """Points that are no stages, and ends that are no points; costs differ by the error of the discretisation."""
    found = solve(replace(reach(Loops.REDUCED), **METHODS[name]), arms())
    assert isinstance(found, Solution)
    assert found.cost.total == pytest.approx(solved(Loops.REDUCED, Representation.IMPL).cost.total, rel=5e-5)
    _check_closure(found)


def _check_closure(found: Solution) -> None:
    check = resimulate(found, arms()).resimulation
    assert check is not None
    for gap in (found.violation.closure, found.violation.closure_rate, check.closure):
        assert gap is not None
        assert gap <= 1e-10


def test_bounds_of_dependent_states_hold_where_these_are_no_variables() -> None:
    """Of a velocity within intervals; shooting and collocation agree."""
    fastest = float(np.abs(solved(Loops.REDUCED, Representation.IMPL).trajectory.point_qd[:, :, 1]).max())
    limits = (-0.8 * fastest, 0.8 * fastest)
    bounds = Bounds((FREE_RANGE,) * 4, (FREE_RANGE, limits, *(FREE_RANGE,) * 2), (FREE_RANGE,) * 2)
    costs = []
    for form in Form:
        found = solve(replace(reach(Loops.REDUCED), bounds=bounds, form=form), arms())
        assert isinstance(found, Solution)
        assert np.abs(found.trajectory.point_qd[:, :, 1]).max() <= limits[1] + 1e-7
        costs.append(found.cost.total)
    assert costs == pytest.approx([costs[0]] * 3, rel=1e-8)
    assert costs[0] > 1.001 * solved(Loops.REDUCED, Representation.IMPL).cost.total


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("name", [*DISCRETISATIONS, "rk4", "legendre"])
def test_derivatives_without_states_at_points_are_casadis(name: str, free: bool) -> None:
    """Near a guess, where Newton's method ends; CasADi differentiates its iterations."""
    changes = {**DISCRETISATIONS, **METHODS}[name]
    problem = rich(Loops.REDUCED, changes.get("representation", Representation.IMPL), Family.RADAU, free=free)
    problem = replace(problem, horizon=0.2, horizon_range=(0.1, 0.4) if free else None, **changes)
    guess = make_guess(problem, arms(), schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory)
    near = transcribe(problem, arms()).pack(replace(guess, qd=0.2 * guess.qd, point_qd=0.2 * guess.point_qd))
    if problem.form is Form.SHOOTING:
        check_derivatives(problem, arms(), unroll, more=50, near=near)
    else:
        check_derivatives(problem, arms(), near=near)


@cache
def _swing(N: int) -> Problem:
    """Swing the point of the pendulum up by 120 degrees, past the height at which x does not determine y."""
    end = 2 * np.pi / 3
    return Problem(
        name="swing",
        horizon=1.0,
        intervals=N,
        family=Family.RADAU,
        degree=4,
        cost=Cost(1.0),
        start_q=(0.0, -1.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds((FREE_RANGE,) * 2, (FREE_RANGE,) * 2, (FREE_RANGE,)),
        end=End(coordinates=((1, -float(np.cos(end))),), velocity_zero=True),
    )


def test_multipliers_pass_where_no_choice_of_coordinates_is_independent() -> None:
    """The same swing in the angle from below, theta'' = -g sin theta + u cos theta, has the same cost."""
    q, qd, qdd, u = symbols = tuple(ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    angle = mechanism(("q",), qdd + G * ca.sin(q) - u * ca.cos(q) + 0 * qd, symbols)
    minimal = replace(
        _swing(20),
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), (FREE_RANGE,)),
        end=End(coordinates=((0, 2 * float(np.pi) / 3),), velocity_zero=True),
    )
    expected, found = solve(minimal, angle), solve(_swing(20), rods())
    assert isinstance(expected, Solution)
    assert isinstance(found, Solution)
    assert found.problem.loops is Loops.MULTIPLIERS
    assert found.cost.total == pytest.approx(expected.cost.total, rel=1e-6)
    theta = np.arctan2(found.trajectory.q[:, 0], -found.trajectory.q[:, 1])
    assert np.abs(theta) == pytest.approx(np.abs(expected.trajectory.q[:, 0]), abs=1e-4)


@pytest.mark.parametrize(("intervals", "status"), [(12, JUMPED), (20, "Maximum_Iterations_Exceeded")])
def test_a_reduced_form_that_jumps_is_no_solution(intervals: int, status: str) -> None:
    """Past the horizontal, a coarse grid leads from the lower half of the circle to the upper one at once."""
    problem = replace(_swing(intervals), loops=Loops.REDUCED, solver=SolverOptions(max_iterations=120, method="ipopt"))
    found = solve(problem, rods())
    assert isinstance(found, Failure)
    assert found.run.status == status
    assert "the independent joints x do not determine the others" in found.finding
    assert found.remedy.startswith("take loops: multipliers")


@pytest.mark.parametrize(
    ("intervals", "status", "phase"), [(12, JUMPED, "second"), (16, "Maximum_Iterations_Exceeded", "first")]
)
def test_phases_whose_reduced_form_jumps_are_no_solution(intervals: int, status: str, phase: str) -> None:
    options = SolverOptions(max_iterations=120, method="ipopt")
    problem = replace(split(replace(_swing(intervals), loops=Loops.REDUCED)), solver=options)
    found = solve_phases(problem, Plants((rods(), rods())))
    assert isinstance(found, Failure)
    assert found.run.status == status
    assert f"phase {phase}: " in found.finding
    assert "the independent joints x do not determine the others" in found.finding
    assert found.remedy.startswith("take loops: multipliers")


def test_a_regular_guess_chooses_the_reduced_form() -> None:
    problem = reach()
    guess = make_guess(problem, arms(), schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory)
    assert settle(problem, arms(), guess).loops is Loops.REDUCED
    explicit = replace(problem, representation=Representation.EXP2_O)
    assert settle(explicit, arms(), guess).loops is Loops.MULTIPLIERS


def test_guesses_are_closed_and_their_inputs_make_the_motion() -> None:
    problem = reach()
    guess = make_guess(problem, arms(), schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory)
    closure = Closure(arms())
    assert closure.measure(guess.point_q) < 1e-12
    assert closure.measure_rates(guess.point_q, guess.point_qd) < 1e-12
    flat = [x.reshape(-1, x.shape[-1]) for x in (guess.point_q, guess.point_qd, guess.point_qdd)]
    opening = closure.jacobian(flat[0]) @ flat[2][:, :, None] + closure.bias(flat[0], flat[1])[:, :, None]
    assert np.abs(opening).max() < 1e-11
    fine = replace(problem, intervals=100, degree=1)
    guess = make_guess(fine, arms(), schemes.build(fine.family, fine.degree))
    assert isinstance(guess, Trajectory)
    found = accelerations(arms(), guess.point_q[:, 0], guess.point_qd[:, 0], guess.u)
    assert found == pytest.approx(guess.point_qdd[:, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("loops", "representation", "free"), [(*FORMS[0], True), (*FORMS[1], False), (*FORMS[3], False), (*FORMS[3], True)]
)
def test_constraints_are_independent_at_a_solution(loops: Loops, representation: Representation, free: bool) -> None:
    """LICQ: the Jacobian of all equations, with fixed variables out, has full row rank."""
    problem = reach(loops, representation, 3)
    if free:
        problem = replace(problem, free_start=(0, 1, 3, 5, 7))
    found = solve(replace(problem, end=replace(problem.end, sensors=(), coordinates=((1, -1.2),))), arms())
    assert isinstance(found, Solution)
    transcription = transcribe(found.problem, arms())
    functions = condensation.build(transcription.program, arms())
    x = transcription.pack(found.trajectory)
    J = ca.DM(functions.jacobian(x, transcription.parameters(found.problem))).full()
    lower, upper = transcription.constraint_bounds(found.problem)
    J = J[np.isfinite(lower) & (lower == upper)]
    values = np.linalg.svd(J / np.linalg.norm(J, axis=1)[:, None], compute_uv=False)
    assert values[-1] > 1e-5


@pytest.mark.parametrize(
    ("free", "places", "rates"), [((0, 1, 3), 0.0, np.inf), ((4, 5, 7), np.inf, 0.0), ((0, 1, 3, 4, 5, 7), 0.0, 0.0)]
)
def test_a_start_closes_where_it_is_not_given_whole(free: tuple[int, ...], places: float, rates: float) -> None:
    """Two rows close the coordinates and two the velocities; given ones need none, as they are closed."""
    problem = replace(reach(Loops.MULTIPLIERS), free_start=free)
    transcription = transcribe(problem, arms())
    lower, upper = transcription.constraint_bounds(problem)
    rows = transcription.rows.start_closure
    assert upper[rows].tolist() == [places] * 2 + [rates] * 2
    assert (lower[rows] == -upper[rows]).all()


@pytest.mark.parametrize("loops", Loops)
def test_a_free_start_is_closed(loops: Loops) -> None:
    """The right shoulder is given; the left one and all else are found, at the least cost."""
    problem = replace(reach(loops), free_start=(0, 1, 3))
    found, held = solve(problem, arms()), solved(loops, Representation.IMPL)
    assert isinstance(found, Solution)
    assert found.trajectory.q[0, 2] == pytest.approx(problem.start_q[2], abs=1e-9)
    assert abs(found.trajectory.q[0, 0] - problem.start_q[0]) > 1e-3
    assert Closure(arms()).measure(found.trajectory.q) < 1e-10
    assert found.cost.total < held.cost.total


def test_dependent_velocities_are_variables_where_they_are_read() -> None:
    """Below the speed that the motion has without bounds, the cost rises a little; both forms agree."""
    free = solved(Loops.REDUCED, Representation.IMPL)
    fastest = float(np.abs(free.trajectory.point_qd[:, :, 1]).max())
    bounds = Bounds(
        (FREE_RANGE,) * 4, (FREE_RANGE, (-0.8 * fastest, 0.8 * fastest), *(FREE_RANGE,) * 2), (FREE_RANGE,) * 2
    )
    costs = []
    for loops in Loops:
        found = solve(replace(reach(loops), bounds=bounds), arms())
        assert isinstance(found, Solution)
        assert np.abs(found.trajectory.point_qd[:, :, 1]).max() <= 0.8 * fastest + 1e-7
        costs.append(found.cost.total)
    assert costs[0] == pytest.approx(costs[1], rel=1e-4)
    assert costs[0] > free.cost.total


# --- re-simulation ---------------------------------------------------------------------------------------------------


def test_accelerations_of_closed_loops_are_the_kernels() -> None:
    rng = np.random.default_rng(4)
    q, qd, u = rng.uniform(-1, 1, (3, 4)), rng.uniform(-1, 1, (3, 4)), rng.uniform(-1, 1, (3, 2))
    assert accelerations(arms(), q, qd, u) == pytest.approx(arms()("exp1", q=q, qd=qd, u=u)["qdd"], rel=1e-9)


def test_a_free_swing_stays_on_its_circle_and_keeps_its_energy() -> None:
    """Two seconds of the pendulum of rods, released level: x^2 + y^2 = 1 to rounding; energy to 1e-11."""
    gaps: list[float] = []
    ends = integrate(rods(), np.array([[1.0, 0.0, 0.0, 0.0]]), Constant(np.zeros((1, 1))), 2.0, gaps=gaps)
    assert ends is not None
    x, y, vx, vy = ends[0]
    assert x**2 + y**2 == pytest.approx(1.0, abs=1e-14)
    assert (vx**2 + vy**2) / 2 + G * y == pytest.approx(0.0, abs=1e-11)
    assert 0 < max(gaps) < 1e-12


@pytest.mark.parametrize("loops", Loops)
def test_the_defect_falls_with_the_order_of_the_method(loops: Loops) -> None:
    """Radau of degree 3 has order 5, a defect h^6: half the step, 1/64 of it; a factor of 20 shows order 4 at least."""
    defects = []
    for N in (4, 8):
        motion = solved(loops, Representation.IMPL, N).trajectory
        states = np.concatenate((motion.q, motion.qd), axis=1)
        ends = integrate(arms(), states[:-1], Constant(motion.u), float(motion.t[1]))
        assert ends is not None
        defects.append(np.abs(ends - states[1:]).max())
    assert defects[1] < defects[0] / 20


def test_the_re_simulation_shows_that_loops_stay_closed() -> None:
    check = resimulate(solved(Loops.REDUCED, Representation.IMPL, 4), arms()).resimulation
    assert check is not None
    assert check.closure is not None
    assert 0 < check.closure <= CLOSED


def test_a_solve_that_leaves_loops_open_is_no_solution() -> None:
    """A solver that accepts the guess at once ends with the gap of the guess."""
    found = solve_from_open_loops(
        SolverOptions(method="ipopt", options=(("acceptable_tol", 1e20), ("acceptable_iter", 1)))
    )
    assert isinstance(found, Failure)
    assert found.run.status == OPEN
    assert "loops stay open" in found.finding


def test_ipopt_is_asked_after_a_solve_that_leaves_loops_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here `mbs` calls every guess a solution."""
    hasty = replace(methods.METHODS["mbs"], make=lambda _: lambda start: methods.Answer(start.x, SOLVED, 1))
    monkeypatch.setattr("mbsrun.ocp.solving.phases.METHODS", {**methods.METHODS, "mbs": hasty})
    found = solve_from_open_loops(SolverOptions(method="mbs", fallback=True))
    assert isinstance(found, Solution), found.finding
    assert found.run.method == "ipopt"
    assert "loops stay open" in found.run.instead
    assert found.cost.total == pytest.approx(solved(Loops.MULTIPLIERS, Representation.IMPL).cost.total, rel=1e-6)


def solve_from_open_loops(solver: SolverOptions) -> Solution | Failure:
    """Solve from a guess whose loops are open by 5 cm."""
    problem = replace(reach(Loops.MULTIPLIERS), solver=solver)
    guess = make_guess(problem, arms(), schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory)
    return solve(problem, arms(), guess=replace(guess, point_q=guess.point_q + 0.05))


# --- what is refused --------------------------------------------------------------------------------------------------


CONFLICTS: dict[str, tuple[Callable[[], Problem], str]] = {
    "legendre": (lambda: replace(reach(Loops.MULTIPLIERS), family=Family.LEGENDRE), "no mesh points"),
    "shooting": (lambda: replace(reach(Loops.MULTIPLIERS), form=Form.SHOOTING), "shooting form has no multipliers"),
    "integral": (lambda: replace(reach(Loops.MULTIPLIERS), form=Form.INTEGRAL), "integral form has no multipliers"),
    "only reduced": (
        lambda: replace(reach(None, Representation.EXP2_O), form=Form.SHOOTING),
        "form: EXP2-O has no reduced form; take representation: IMPL or EXP1-O, or form: standard",
    ),
    "second order": (
        lambda: replace(reach(Loops.MULTIPLIERS), integrator=SECOND_ORDER),
        "corrections of the rates of coordinates, which second-order collocation does not have",
    ),
    "no reduced form": (lambda: reach(Loops.REDUCED, Representation.EXP2_O), "has no reduced form"),
    "acceleration": (
        lambda: replace(reach(Loops.REDUCED), end=End(accelerations=((1, 0.0),))),
        "the acceleration of left_elbow",
    ),
    "open start": (lambda: replace(reach(), start_q=FIVE_BAR_POSE), "the loop loop stays open by"),
    "opening start": (lambda: replace(reach(), start_qd=(1.0, 0.0, 0.0, 0.0)), "the loops open at"),
    "end": (
        lambda: replace(reach(), end=End(coordinates=((0, 2.0), (1, -1.0), (2, 1.0)))),
        "right follows from the others",
    ),
    "free start": (lambda: replace(reach(), free_start=(0,)), "right_elbow follows from the others"),
}


def test_second_order_integrates_independent_velocities() -> None:
    """On unequal intervals, at Legendre points, whose ends are no points; the optimum is the first order's."""
    mesh = (0.1, 0.15, 0.25, 0.2, 0.3)
    first = replace(reach(Loops.REDUCED, N=5), family=Family.LEGENDRE, degree=5, mesh=mesh)
    second = replace(first, integrator=SECOND_ORDER)
    costs = []
    for problem in (first, second):
        found = solve(problem, arms())
        assert isinstance(found, Solution)
        costs.append(found.cost.total)
    assert costs[1] == pytest.approx(costs[0], rel=1e-6)
    t, motion, independent = found.trajectory.t, found.trajectory, list(Closure(arms()).independent)
    qd = np.concatenate((motion.qd[:-1, None], motion.point_qd), axis=1)[:, :, independent]
    scheme = schemes.build(Family.LEGENDRE, 5)
    moved = np.diff(t)[:, None, None] * (scheme.integrate(np.append(scheme.points, 1.0)) @ qd)
    reached = np.concatenate((motion.point_q, motion.q[1:, None]), axis=1)[:, :, independent]
    assert reached == pytest.approx(motion.q[:-1, None, independent] + moved, abs=1e-8)


@pytest.mark.parametrize("name", CONFLICTS)
def test_what_loops_contradict_is_refused(name: str) -> None:
    make, finding = CONFLICTS[name]
    with pytest.raises(ProblemError, match=finding):
        solve(make(), arms())


def test_a_motion_through_singular_poses_is_refused_where_it_needs_multipliers() -> None:
    with pytest.raises(ProblemError, match="shooting form has no multipliers of loops"):
        solve(replace(_swing(20), form=Form.SHOOTING), rods())


def test_a_form_of_loops_needs_loops() -> None:
    q, qd, qdd, u = symbols = tuple(ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    plant = mechanism(("q",), qdd - u + 0 * q * qd, symbols)
    one = replace(
        _swing(4),
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), (FREE_RANGE,)),
        end=End(),
    )
    with pytest.raises(ProblemError, match="no closed loops"):
        solve(replace(one, loops=Loops.REDUCED), plant)
    assert structure(settle(one, plant)).loops is None


FILE = """\
model: five_bar.yaml
horizon: 0.8
intervals: 8
scheme: radau
degree: 3
cost: {{inputs: 1}}
start: {start}
end: {end}
"""


def _read(folder: Path, start: str, end: str = "{velocity: zero}") -> Problem:
    path = folder / "reach.ocp.yaml"
    path.write_text(FILE.format(start=start, end=end), "utf-8")
    return read_problem(path, lambda _: arms())[0]


STARTS = {
    "{pose: {left: 2.2, right: 0.9}, velocity: {left: 1.5}}": ((0, 2.2), (2, 0.9)),
    "{pose: {left: 2.2, left_elbow: -1.3}}": ((0, 2.2), (1, -1.3)),
    "{pose: {left: 2.0}}": ((0, 2.0), (2, FIVE_BAR_POSE[2])),
}


@pytest.mark.parametrize("start", STARTS)
def test_a_start_is_completed_by_closing(tmp_path: Path, start: str) -> None:
    """Given coordinates keep their values, independent ones the assembled pose's, and the loops give all others."""
    problem, closure = _read(tmp_path, start), Closure(arms())
    q, qd = np.array(problem.start_q), np.array(problem.start_qd)
    assert closure.is_closed(q)
    assert closure.measure_rates(q[None], qd[None]) < 1e-12
    assert qd[0] == (pytest.approx(1.5) if "velocity" in start else 0)
    for i, value in STARTS[start]:
        assert q[i] == pytest.approx(value, abs=1e-15)
    assert problem.free_start == ()


def test_a_null_frees_what_follows_from_it(tmp_path: Path) -> None:
    problem = _read(tmp_path, "{pose: {left: null, right: 0.9}}")
    assert problem.free_start == (0, 1, 3, 5, 7)


def test_a_guess_of_what_loops_give_at_the_start_is_named_so(tmp_path: Path) -> None:
    """The file gives `left`; the loop gives the elbow, which no value at the start could free."""
    given, found = "has a value at the start; leave it out, or free it", "the loops give this coordinate at the start"
    with pytest.raises(InputError) as error:
        _read(tmp_path, "{pose: {left: 2.3, right: 1.0}}\nguess: {start: {left: 2, left_elbow: -1}}")
    assert f"guess.start.left: this coordinate {given}" in str(error.value)
    assert f"guess.start.left_elbow: {found}; leave it out; the model's assembly chooses" in str(error.value)


def test_targets_that_follow_from_others_are_dropped_or_refused(tmp_path: Path) -> None:
    closure = Closure(arms())
    q = closure.close(np.array([2.3, -1.3, 1.0, 1.3]), (0, 2))
    end = f"{{pose: {{left: 2.3, right: 1.0, left_elbow: {q[1]:.9f}}}}}"
    assert [i for i, _ in _read(tmp_path, "{pose: {}}", end).end.coordinates] == [0, 2]
    with pytest.raises(InputError, match=r"left_elbow = -1, but the loops put it at -1\.\d+, 0\.\d+ away"):
        _read(tmp_path, "{pose: {}}", "{pose: {left: 2.3, right: 1.0, left_elbow: -1}}")


REFUSED = {
    "{pose: {left: 3.1, right: 0}}": "the loop loop stays open by 0.",
    "{pose: {left: 2.2, right: 0.9, left_elbow: -1}}": "left_elbow = -1, but the loops put it at",
    "{pose: [2.2, -1.3, 0.9, 1.3]}": "away; leave it out",
}


@pytest.mark.parametrize("start", REFUSED)
def test_a_start_that_loops_contradict_is_refused_with_the_distance(tmp_path: Path, start: str) -> None:
    with pytest.raises(InputError, match=REFUSED[start]):
        _read(tmp_path, start)


MODEL = """\
name: rods
gravity: [0, -9.81, 0]
parameters: {l: 0.35, load: {value: 1, kind: runtime}}
bodies:
  - name: first
    joint: {name: first, type: revolute, axis: z}
    mass: 1
    com: [0.2, 0, 0]
    inertia: [0, 0.01, 0.01]
  - name: second
    parent: first
    joint: {name: second, type: revolute, axis: z, position: [0.4, 0, 0], actuated: false}
    mass: load
    com: [0.2, 0, 0]
    inertia: [0, 0.01, 0.01]
loops:
  - name: rod
    type: rod
    length: l
    from: {body: base, position: [0.7, 0, 0]}
    to: {body: second, position: [0.4, 0, 0]}
independent: [first]
assembly: {first: 0.5, second: -1}
"""


def test_the_kernels_by_hand_have_the_arguments_of_generated_ones(tmp_path: Path) -> None:
    """Names and order; the model has a run-time parameter that loops do not read."""
    (tmp_path / "rods.yaml").write_text(MODEL, "utf-8")
    by_hand = [kernel for kernel in rods().manifest.kernels if not kernel.name.startswith("jac_")]
    functions = tuple(kernel.name for kernel in by_hand if kernel.name not in ("sensors", "motion"))
    product = make(tmp_path / "rods.yaml", Options(functions=functions, derivatives=0, reductions=Reductions(trials=1)))
    for kernel in by_hand:
        if kernel.name in functions:
            generated = product.manifest.kernel(kernel.name)
            inputs = [a.name for a in generated.inputs if a.role is not Role.SETUP]
            assert inputs == [a.name for a in kernel.inputs], kernel.name
            if kernel.name != "frames":
                assert [a.name for a in generated.outputs] == [a.name for a in kernel.outputs], kernel.name
    alone = make(tmp_path / "rods.yaml", Options(functions=("loop_forces",), derivatives=0)).manifest
    assert [a.name for a in alone.kernel("loop_forces").inputs] == ["q", "lam", "h"]


@pytest.mark.parametrize("loops", Loops)
def test_phases_carry_closed_loops_on(loops: Loops) -> None:
    """The reach in two phases costs what it does in one: no loop is closed twice where a link gives the start."""
    whole = solved(loops, Representation.IMPL)
    found = solve_phases(split(whole.problem), Plants((arms(), arms())), guess=Guess(cut(whole.trajectory)))
    assert isinstance(found, PhasedSolution)
    assert found.cost == pytest.approx(whole.cost.total, rel=1e-8)
    assert found.phases[1].violation.closure == pytest.approx(0.0, abs=CLOSED)


def test_a_guess_is_closed_at_both_ends(tmp_path: Path) -> None:
    """Of a start that is free, and in place of a search for the end: named joints are where they are put."""
    text = (MODELS / "five_bar_reach.ocp.yaml").read_text().replace("right: -1.1397", "right: null")
    (tmp_path / "five_bar.yaml").write_text((MODELS / "five_bar.yaml").read_text())
    path = tmp_path / "p.ocp.yaml"
    path.write_text(text + "guess: {start: {right: -1.0}, end: {left: -2.2, right: -0.6}}\n")
    problem, plant = read_problem(path, load_on_demand)
    motion = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(motion, Trajectory)
    left, right = (plant.manifest.positions.index(name) for name in ("left", "right"))
    assert motion.q[0, [left, right]] == pytest.approx([-2.4621, -1.0], abs=1e-12)
    assert motion.q[-1, [left, right]] == pytest.approx([-2.2, -0.6], abs=1e-6)
    assert Closure(plant).measure(np.concatenate((motion.q, motion.point_q.reshape(-1, 4)))) <= CLOSED
    path.write_text(text + "guess: {start: {right: 0.5, left elbow: 3}}\n")
    with pytest.raises(InputError, match=r"guess\.start.*the loop"):
        read_problem(path, load_on_demand)


def test_null_frees_coordinates_of_the_end(tmp_path: Path) -> None:
    """The same problem as one that leaves them out: of a mapping, of a list, and of all."""
    (tmp_path / "cart_pole.yaml").write_text((MODELS / "cart_pole.yaml").read_text())
    path, found = tmp_path / "p.ocp.yaml", []
    text = "model: cart_pole.yaml\nhorizon: 1\nintervals: 4\nscheme: radau\ndegree: 3\n"
    text += "cost: {inputs: 1}\nstart: {pose: {}}\n"
    ends = ("pose: {cart: 1}, velocity: {cart: 2}", "pose: {cart: 1, pole: null}, velocity: {cart: 2, pole: null}")
    for end in (*ends, "pose: [1, null], velocity: {cart: 2}", "pose: null"):
        path.write_text(f"{text}end: {{{end}}}\n")
        found.append(read_problem(path, load_on_demand)[0].end)
    assert found[0] == found[1] == found[2] == End(coordinates=((0, 1.0),), velocities=((0, 2.0),))
    assert found[3] == End()
