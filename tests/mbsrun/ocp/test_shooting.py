"""Multiple shooting: integrators against other hands', optima against collocation's, derivatives, failures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbsrun.ocp.evaluation.backends.condensation import Condensed, build
from mbsrun.ocp.ground import integrators, schemes
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.guessing.guess import interpolate
from mbsrun.ocp.methods import Answer, Instance
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Form, Problem, Representation, Term, cylindrical
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.phases import PhasedSolver, solve_phases
from mbsrun.ocp.solving.resimulation import Constant, integrate, resimulate
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.transcription.transcription import transcribe
from studies.laboratory.optimisation import state_catch
from studies.laboratory.optimisation import state_swing_up as swing_up
from tests.mbsrun.ocp.phases.motions import split
from tests.mbsrun.ocp.plants import FREE_RANGE, cart_pole, pendulum, push, unstable
from tests.mbsrun.ocp.programs import check_derivatives, equations_of, evaluate_rows, functions_of, rich, unroll
from tests.mbsrun.peer import Peer, double_integrator, explicit_functions, residual_function

EXPLICIT = {"representation": Representation.EXP1_O, "integrator": "rk4"}


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    """Newton's method factorises in C."""
    requires("cc")


@pytest.fixture(scope="module")
def plant() -> Peer:
    """The cart and pole, with accelerations too."""
    bare = cart_pole()
    return bare.with_functions(explicit_functions(bare.casadi("impl")))


def shot(problem: Problem, **changes: Any) -> Problem:
    return replace(problem, form=Form.SHOOTING, **changes)


def optimum(problem: Problem, plant: Peer) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    return outcome


# --- integrators ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_polynomials_are_read_exactly_everywhere(family: Family, steps: int) -> None:
    """Accelerations t^(d-2) at the stages: what follows at stages, points and ends is the polynomial's."""
    d = 4
    scheme = schemes.build(family, d)
    method = integrators.build("collocation", scheme, steps)
    z = method.stages.c ** (d - 2)
    assert method.points.c == pytest.approx(scheme.points, abs=1e-15)
    for place in (method.stages, method.points, method.ends):
        assert place.V @ z == pytest.approx(place.c ** (d - 1) / (d - 1), abs=1e-14)
        assert place.P @ z == pytest.approx(place.c**d / (d * (d - 1)), abs=1e-14)
        assert place.W @ z == pytest.approx(place.c ** (d - 2), abs=1e-13)


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_coordinates_of_second_order_are_integrals_of_velocities(family: Family, steps: int) -> None:
    """Accelerations t^(d-1): velocities of degree d and coordinates of degree d + 1 are exact, in between too.

    The method for systems of first order misses the latter at its points, and meets it at the ends of steps.
    """
    d = 4
    scheme = schemes.build(family, d)
    for name, is_exact in ((SECOND_ORDER, True), ("collocation", False)):
        method = integrators.build(name, scheme, steps)
        z = method.stages.c ** (d - 1)
        for place in (method.stages, method.points, method.ends):
            assert place.V @ z == pytest.approx(place.c**d / d, abs=1e-14)
            gap = np.abs(place.P @ z - place.c ** (d + 1) / (d * (d + 1))).max()
            assert bool(gap < 1e-15) is (is_exact or place is method.ends)


@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("name", integrators.INTEGRATORS)
def test_stages_are_at_the_times_of_their_steps(name: str, steps: int) -> None:
    """(i + c) / steps in step i; a constant acceleration moves by t^2 / 2 until each time, whatever the method."""
    scheme = schemes.build(Family.RADAU, 3)
    own = np.array([0.0, 0.5, 0.5, 1.0]) if name == "rk4" else scheme.points
    method = integrators.build(name, scheme, steps)
    assert method.stages.c == pytest.approx(((np.arange(steps)[:, None] + own) / steps).ravel(), abs=1e-15)
    assert method.points.c == pytest.approx(scheme.points, abs=1e-15)
    assert method.ends.c == pytest.approx([0.0, 1.0], abs=1e-15)
    for place in (method.stages, method.points, method.ends):
        assert place.V.sum(axis=1) == pytest.approx(place.c, abs=1e-14)
    for place in (method.points, method.ends):
        if name != "rk4" or place is method.ends:
            assert place.P.sum(axis=1) == pytest.approx(place.c**2 / 2, abs=1e-14)


@pytest.mark.parametrize("mesh", [None, (0.1, 0.4, 0.2, 0.3)])
@pytest.mark.parametrize(("integrator", "steps"), [("collocation", 1), ("collocation", 3), ("rk4", 2)])
def test_costs_read_the_time_of_each_point(integrator: str, steps: int, mesh: tuple[float, ...] | None) -> None:
    """A push over 1 m in 1 s for the integral of t u^2: four constant inputs with two conditions, in closed form."""
    cost = Cost(running=(Term("t*u_slide**2", 1.0),))
    problem = shot(
        push(4), integrator=integrator, steps=steps, representation=Representation.EXP1_O, mesh=mesh, cost=cost
    )
    times = np.concatenate([[0.0], np.cumsum(mesh or (0.25,) * 4)])
    weights, h = np.diff(times**2) / 2, np.diff(times)
    moved = np.stack([h, h * (1 - (times[1:] + times[:-1]) / 2)])  # the velocity and the place at the end
    multipliers = np.linalg.solve(moved / weights @ moved.T, [0.0, 1.0])
    outcome = optimum(problem, double_integrator())
    assert outcome.trajectory.u[:, 0] == pytest.approx(moved.T @ multipliers / weights, rel=1e-6)
    assert outcome.cost.total == pytest.approx(multipliers @ [0.0, 1.0], rel=1e-8)


def rk4(plant: Peer, x: np.ndarray, u: np.ndarray, length: float, steps: int) -> np.ndarray:
    """The textbook's loop, on states (q, qd)."""
    h = length / steps

    def rate(x: np.ndarray) -> np.ndarray:
        q, qd = np.split(x, 2)
        return np.concatenate((qd, plant("exp1", q=q, qd=qd, u=u)["qdd"]))

    for _ in range(steps):
        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        k4 = rate(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def test_rows_of_rk4_are_the_textbooks(plant: Peer) -> None:
    """x_(k+1) - F(x_k, u_k) at random variables; in between, states follow the continuous extension."""
    problem = shot(swing_up(5, 4), horizon=0.2, **EXPLICIT, steps=3)
    transcription = transcribe(problem, plant)
    rng = np.random.default_rng(0)
    functions = build(transcription.program, plant)
    x = rng.uniform(-1, 1, functions.variables)
    motion = transcription.unpack(functions.complete(x))
    g = evaluate_rows(transcription, plant, problem, x)
    states = np.concatenate((motion.q, motion.qd), axis=1)
    gaps = [states[k + 1] - rk4(plant, states[k], motion.u[k], 0.04, 3) for k in range(5)]
    first = int(np.flatnonzero(np.isin(transcription.program.kept_rows, transcription.rows.continuity[0, 0]))[0])
    assert g[first : first + 20] == pytest.approx(np.ravel(gaps), abs=1e-13)
    exact = integrate(plant, states[:1], Constant(motion.u[:1]), float(motion.point_t[0, 1]))
    assert exact is not None
    between = np.concatenate((motion.point_q[0, 1], motion.point_qd[0, 1]))
    assert between == pytest.approx(exact[0], abs=1e-5)


# --- derivatives ---------------------------------------------------------------------------------------------------


def test_derivatives_of_shooting_equal_casadis(arm: Peer, reach: Problem) -> None:
    """Of everything that a problem can ask for, by RK4; CasADi differentiates each of its stages instead."""
    problem = rich(reach, Representation.EXP1_O, Family.RADAU, False)
    check_derivatives(shot(problem, horizon=0.15, **EXPLICIT), arm, unroll)


@pytest.mark.parametrize(
    ("changes", "mesh"),
    [
        ({"horizon_range": (0.1, 0.2), **EXPLICIT}, None),
        ({**EXPLICIT, "steps": 2}, (0.2, 0.5, 0.3)),
    ],
    ids=["free", "unequal"],
)
def test_derivatives_with_slopes_equal_casadis(
    arm: Peer, reach: Problem, changes: dict[str, Any], mesh: tuple[float, ...] | None
) -> None:
    """Over a horizon that is free, which all intervals share, and over intervals that differ in length alone."""
    problem = rich(reach, Representation.EXP1_O, Family.RADAU, False)
    start = {"horizon": 0.15, "mesh": mesh, **changes}
    check_derivatives(shot(problem, **start), arm, unroll)


@pytest.mark.parametrize(
    "changes",
    [{}, {"representation": Representation.EXP1_O}, {**EXPLICIT, "steps": 2}, {"mesh": (0.3, 0.1, 0.2, 0.15, 0.25)}],
    ids=["IMPL", "EXP1-O", "rk4", "unequal"],
)
def test_the_fastest_push_is_found_by_shooting(changes: dict[str, Any]) -> None:
    """A mass of 1 kg over 1 m from v = 1 to rest, |u| <= 4, with a free horizon: the same optimum as by collocation."""
    bounds = Bounds((FREE_RANGE,), (FREE_RANGE,), ((-4.0, 4.0),))
    problem = replace(
        push(5), start_qd=(1.0,), bounds=bounds, cost=Cost(terminal=(Term("T", 1.0),)), horizon_range=(0.1, 5.0)
    )
    mass = double_integrator()
    standard = optimum(replace(problem, mesh=changes.get("mesh")), mass)
    found = optimum(shot(problem, **changes), mass)
    assert found.cost.total == pytest.approx(standard.cost.total, rel=1e-7)
    assert found.trajectory.q == pytest.approx(standard.trajectory.q, abs=1e-6)
    assert found.trajectory.point_qdd == pytest.approx(standard.trajectory.point_qdd, abs=1e-4)


def test_derivatives_through_newtons_method_equal_casadis(plant: Peer) -> None:
    """By the implicit function theorem, two steps in an interval; CasADi differentiates each iteration."""
    problem = replace(swing_up(3, 2), cost=Cost(1.0, running=(Term("sin(q_pole)*qdd_cart", 0.5),)))
    check_derivatives(shot(problem, steps=2), plant, unroll)
    free = replace(problem, representation=Representation.EXP1_O, horizon_range=(0.1, 3.0), mesh=(0.2, 0.5, 0.3))
    check_derivatives(shot(free), plant, unroll, more=15)  # the cart's velocity moves the cart alone


def test_kept_slopes_lead_to_where_newtons_method_leads(plant: Peer) -> None:
    """Over long intervals, with several solutions; groups together, as all wait for the last."""
    program = functions_of(shot(swing_up(4, 3), horizon=1.6), plant)
    assert isinstance(program, Condensed)
    equations, groups = equations_of(program), program.inner.parts[0].groups
    rng, found = np.random.default_rng(3), 0
    nothing = np.zeros(program.parameters)
    for _ in range(40):
        v = np.zeros(equations.variables)
        v[program.program.kept] = rng.uniform(-4, 4, program.variables)
        for _ in range(30):
            r, J = equations.constraint(v, nothing), equations.jacobian(v, nothing)
            unknowns = groups.unknowns.ravel()
            step = np.linalg.solve(J.full()[:, unknowns], r.full().ravel())
            v[unknowns] -= step
            if np.abs(step).max() < 1e-12 * (1 + np.abs(v[unknowns]).max()):
                z = program.inner.parts[0].solve(v[groups.knowns])
                assert z == pytest.approx(v[groups.unknowns], rel=1e-9, abs=1e-9)
                found += 1
                break
    assert found >= 20


# --- what is remembered --------------------------------------------------------------------------------------------


def evaluate(program: Any, x: np.ndarray, names: Sequence[str]) -> dict[str, bytes]:
    """Call some functions of a program, in this order, for the cost's weights and multipliers of 1."""
    p, multipliers = np.ones(program.parameters), (1.0, np.ones(program.constraints))
    return {
        name: b"".join(
            np.array(result.nonzeros()).tobytes()
            for result in getattr(program, name).call([x, p, *(multipliers * (name == "hessian"))])
        )
        for name in names
    }


FUNCTIONS = ("objective", "gradient", "constraint", "jacobian", "hessian")


@pytest.mark.parametrize("changes", [{}, EXPLICIT], ids=["newton", "rk4"])
def test_no_order_of_calls_meets_what_was_found_elsewhere(plant: Peer, changes: dict[str, Any]) -> None:
    """The very bytes of a program that is asked once, in any order, at places in turn that differ in one bit."""
    problem = shot(replace(swing_up(4, 2), cost=Cost(1.0, running=(Term("qdd_cart**2", 0.5),))), **changes)

    def make() -> Any:
        return functions_of(problem, plant)

    asked = make()
    x = np.random.default_rng(0).uniform(0.5, 1, asked.variables)
    nearly = x.copy()
    nearly[7] = np.nextafter(x[7], 2)
    other = x[::-1].copy()
    expected = {name: [evaluate(make(), at, [name])[name] for at in (x, nearly, other)] for name in FUNCTIONS}
    assert expected["constraint"][0] != expected["constraint"][1]
    for order in (FUNCTIONS, FUNCTIONS[::-1], ("hessian", "jacobian", "hessian", "constraint")):
        for k, at in ((0, x), (1, nearly), (0, x), (2, other), (1, nearly)):
            assert evaluate(asked, at, order) == {name: expected[name][k] for name in order}


def test_threads_take_turns(plant: Peer) -> None:
    """One program, called by four threads at different places, gives each the same as alone."""
    program = functions_of(shot(swing_up(4, 2)), plant)
    places = np.random.default_rng(1).uniform(0.5, 1, (4, program.variables))
    expected = [evaluate(program, at, FUNCTIONS) for at in places]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            assert list(pool.map(lambda at: evaluate(program, at, FUNCTIONS), places)) == expected


# --- optima --------------------------------------------------------------------------------------------------------


def test_shooting_by_the_schemes_own_method_is_collocation(arm: Peer, reach: Problem) -> None:
    """Nothing but the unknowns differs: 10 (12 + 4) + 12 of them, and the same optimum from the same guess."""
    near = replace(reach.with_target("hand", cylindrical(0.65, 0.05, 0.0)), intervals=10, degree=3)
    expected, found = optimum(near, arm), optimum(shot(near), arm)
    assert found.size.variables == 172
    assert found.cost.total == pytest.approx(expected.cost.total, rel=1e-9)
    assert found.trajectory.point_q == pytest.approx(expected.trajectory.point_q, abs=1e-8)
    assert found.trajectory.point_qdd == pytest.approx(expected.trajectory.point_qdd, abs=1e-6)


@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_bounds_and_running_costs_are_those_of_collocation(plant: Peer, family: Family) -> None:
    """Held and summed at the points, though these are no variables; the cart's bound is active there."""
    problem = replace(swing_up(20, 3), family=family, cost=Cost(1.0, running=(Term("qdd_cart**2", 0.01),)))
    problem = replace(problem, bounds=replace(problem.bounds, q=((-0.2, 1.05), problem.bounds.q[1])))
    expected = optimum(problem, plant)
    found = solve(shot(problem), plant, guess=expected.trajectory)
    assert isinstance(found, Solution)
    assert found.cost.total == pytest.approx(expected.cost.total, rel=1e-8)
    assert found.trajectory.point_q == pytest.approx(expected.trajectory.point_q, abs=1e-6)
    assert found.trajectory.point_q[..., 0].max() == pytest.approx(1.05, abs=1e-6)


ORDERS = {
    "Radau 1": ({"family": Family.RADAU, "degree": 1}, 1),
    "Radau 2": ({"family": Family.RADAU, "degree": 2}, 3),
    "Radau 3": ({"family": Family.RADAU, "degree": 3}, 5),
    "Legendre 1": ({"family": Family.LEGENDRE, "degree": 1}, 2),
    "Legendre 2": ({"family": Family.LEGENDRE, "degree": 2}, 4),
    "rk4": (EXPLICIT, 4),
}


@pytest.mark.parametrize(("changes", "order"), ORDERS.values(), ids=ORDERS.keys())
def test_orders_of_the_optimum_at_a_fixed_control_grid(changes: dict[str, Any], order: int) -> None:
    """A pendulum is lifted by 2 rad with the least effort: four inputs, more and more steps between them."""
    bare = pendulum()
    plant = bare.with_functions(explicit_functions(bare.casadi("impl")))
    lift = Problem(
        name="lift",
        horizon=2.0,
        intervals=4,
        family=Family.LEGENDRE,
        degree=6,
        cost=Cost(1.0),
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), (FREE_RANGE,)),
        end=End(coordinates=((0, 2.0),), velocity_zero=True),
    )
    exact = optimum(shot(lift, steps=2), plant).cost.total
    errors = [optimum(shot(lift, steps=steps, **changes), plant).cost.total - exact for steps in (4, 8)]
    assert np.log2(abs(errors[0] / errors[1])) == pytest.approx(order, abs=0.2)


def test_rk4_reaches_the_optimum_within_its_order(plant: Peer) -> None:
    """At a fixed control grid: as near to collocation's cost as the errors of its motion allow."""
    fine = optimum(swing_up(20, 6), plant)
    found = solve(shot(swing_up(20, 3), **EXPLICIT, steps=8, accuracy=1e-5), plant, guess=fine.trajectory)
    assert isinstance(found, Solution)
    assert found.cost.total == pytest.approx(fine.cost.total, rel=1e-6)
    check = resimulate(found, plant).resimulation
    assert check is not None
    assert check.is_accurate


def test_collocations_solution_is_a_guess_and_the_other_way_round(plant: Peer) -> None:
    """Few iterations from the optimum of the other."""
    problem = swing_up(20, 4)
    direct, shooting = optimum(problem, plant), optimum(shot(problem, **EXPLICIT, steps=4), plant)
    for target, origin in ((shot(problem, **EXPLICIT, steps=4), direct), (problem, shooting)):
        again = solve(target, plant, guess=origin.trajectory)
        assert isinstance(again, Solution)
        assert again.run.iterations <= 8
        assert again.cost.total == pytest.approx(direct.cost.total, rel=1e-3)


def test_multiple_shooting_bears_growth_by_exp_40() -> None:
    """F = exp(20 * 2), from a guess of zeros: each interval bounds the growth."""
    problem = shot(state_catch(40, 4))
    solver = Solver(problem, unstable(20.0))
    zeros = interpolate(replace(problem, start_q=(0.0,)), solver.transcription.scheme, np.zeros(1))
    outcome = solver.solve(problem, zeros)
    assert isinstance(outcome, Solution)
    assert outcome.run.iterations <= 50


# --- failures ------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
def test_equations_without_a_solution_are_a_failure(capfd: pytest.CaptureFixture[str]) -> None:
    """qdd^2 = u - 1, and u = 0 in the guess: Newton's method ends nowhere; a status says so, and nothing else does."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    broken = double_integrator().with_functions({"impl": residual_function(q, qd, qdd, u, qdd**2 + 1 - u + 0 * q)})
    outcome = solve(shot(push(8)), broken)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == "Invalid_Number_Detected"
    assert capfd.readouterr().err == ""


def stay(start: Instance) -> Answer:
    """Call the guess a solution."""
    return Answer(start.x, "Solve_Succeeded", 3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("phases", [False, True])
def test_a_solution_whose_equations_have_none_is_a_failure(phases: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A method that takes condensed unknowns for its own may end where Newton's method does not find them again."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    broken = double_integrator().with_functions({"impl": residual_function(q, qd, qdd, u, qdd**2 + 1 - u + 0 * q)})
    monkeypatch.setattr(PhasedSolver, "_find_method", lambda *_: stay)
    problem = shot(push(8))
    ended = solve_phases(split(problem), Plants((broken, broken))) if phases else solve(problem, broken)
    assert isinstance(ended, Failure)
    assert ended.run.status == "Invalid_Number_Detected"
    assert ended.run.iterations == 3
    assert "at the end: the equations that are condensed have no solution" in ended.finding


def test_an_end_out_of_reach_is_a_failure(plant: Peer) -> None:
    """0.1 N take 1.3 kg no metre far in 2 s."""
    problem = shot(swing_up(10, 2), **EXPLICIT)
    outcome = solve(replace(problem, bounds=replace(problem.bounds, u=((-0.1, 0.1),))), plant)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == "Infeasible_Problem_Detected"
