"""Derivatives of solutions: by differences of solves, by CasADi, by closed forms; and where there are none."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbsrun
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, NOT_CONVERGED, SMOOTH, SPLIT, STUCK
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.continuation import TURNING
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.derivatives import PARTS, NoDerivativeError
from mbsrun.optimal.phases import PhasedControl, SolvedPhases
from mbsrun.optimal.result import NotSolvedError, Solved

MODELS = Path(__file__).parents[3] / "models"
TIGHT = {"tolerance": 1e-13}  # of solves whose differences are taken
SLIDE: dict[str, Any] = {  # the least effort that moves a mass: u is linear in time
    "horizon": 1,
    "intervals": 20,
    "degree": 3,
    "states": {"x": {"rate": "v", "start": 0, "end": 1}, "v": {"rate": "a", "start": 0, "end": 0}},
    "controls": {"a": {}},
    "cost": {"running": [{"expression": "a**2", "weight": 1}]},
    "start": None,
    "solver": TIGHT,
}


def slide(**changes: Any) -> OptimalControl:
    made = mbsrun.problem(None, name="slide", **{key: x for key, x in SLIDE.items() if x is not None})
    return made.with_changes(**changes) if changes else made


def solve(problem: OptimalControl) -> Solved:
    found = problem.solve(check=False)
    assert isinstance(found, Solved)
    return found


def flatten(motions: tuple[Trajectory, ...]) -> Array:
    return np.concatenate([getattr(motion, name).ravel() for motion in motions for name in PARTS])


def find_motions(found: Solved | SolvedPhases) -> tuple[Trajectory, ...]:
    solutions = (found.solution,) if isinstance(found, Solved) else found.solution.phases
    return tuple(own.trajectory for own in solutions)


CASES = {
    "cart_pole_balance": ("constants.lean", "cost.running[1].weight", "horizon", "start.velocity.cart"),
    "planar_arm_fastest": ("end.sensors.hand.y", "bounds.inputs.elbow.lower", "start.pose.shoulder"),
    "track/cart_pole": ("bounds.inputs.lower", "cost.running[0].weight"),
    "design/lifting_arm": ("start.pose.shoulder", "end.sensors.hand.z"),
    "spatial/ball_crank_turn": ("start.pose.crank", "horizon"),
    "muscles/lift": ("constants.lag", "states.deltoid.start"),
    "legged/walker": ("bounds.coordinates.knee.lower",),
    "modes/crate_push": ("phases[1].end.pose.crate", "phases[2].horizon"),
    "modes/hopper_jump": ("phases[1].horizon.range.lower",),
}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_differences_of_solves(name: str) -> None:
    """Of motion, times and cost, to 1e-6 of the largest entry: by differences of order four, of solves anew."""
    problem = mbsrun.read_problem(MODELS / f"{name}.ocp.yaml").with_changes(solver=TIGHT)
    found = problem.solve(check=False)
    assert isinstance(found, Solved | SolvedPhases)
    derivatives = problem.derivatives(found, CASES[name])
    assert derivatives.status == SMOOTH
    for number in derivatives.answer.numbers:
        moved, h, costs, motions = derivatives.by(number.name), 3e-4 * (abs(number.value) or 1.0), [], []
        for k in (-2, -1, 1, 2):
            again = restate(problem, number.name, number.value + k * h).solve(check=False, guess=found)  # type: ignore[arg-type]
            assert isinstance(again, Solved | SolvedPhases)
            costs.append(again.cost)
            motions.append(flatten(find_motions(again)))
        expected = (8 * (motions[2] - motions[1]) - (motions[3] - motions[0])) / (12 * h)
        cost = (8 * (costs[2] - costs[1]) - (costs[3] - costs[0])) / (12 * h)
        assert moved.cost == pytest.approx(cost, rel=1e-6, abs=1e-8 * abs(found.cost))
        own = flatten(moved.phases)
        assert np.abs(own - expected).max() <= 1e-6 * np.abs(expected).max()


def restate(problem: OptimalControl | PhasedControl, name: str, value: float) -> OptimalControl | PhasedControl:
    return problem.with_numbers({name: value})


def test_closed_forms_of_the_least_effort() -> None:
    """Cost 12 d^2 / T^3 and u(t) = d (6 / T^2 - 12 t / T^3), up to the steps of u: by d, T and the weight."""
    problem = slide()
    derivatives = problem.derivatives(solve(problem), ["states.x.end", "horizon", "cost.running[0].weight"])
    steps = 1 / (1 - 1 / 20**2)  # of an input in 20 steps
    assert dict(derivatives.cost) == pytest.approx(
        {"states.x.end": 24 * steps, "horizon": -36 * steps, "cost.running[0].weight": 12 * steps}, rel=1e-9
    )
    middle = (np.arange(20) + 0.5) / 20
    assert derivatives.by("states.x.end").trajectory.controls[:, 0] == pytest.approx(
        (6 - 12 * middle) * steps, rel=1e-8
    )
    assert np.abs(derivatives.by("cost.running[0].weight").trajectory.controls).max() < 1e-9
    assert derivatives.by("horizon").horizon == pytest.approx(1.0)


def test_the_adjoint_is_the_transpose() -> None:
    """One adjoint has the derivatives of a sum by all numbers; each is the sum of a forward derivative."""
    problem = mbsrun.read_problem(MODELS / "track" / "cart_pole.ocp.yaml").with_changes(solver=TIGHT)
    assert isinstance(problem, OptimalControl)
    found = solve(problem)
    derivatives = problem.derivatives(found)
    rng = np.random.default_rng(1)
    weights = {name: rng.standard_normal(getattr(found.trajectory, name).shape) for name in ("q", "qd", "u", "t")}
    pulled = derivatives.pull(weights)
    assert len(pulled) == len(derivatives.names) > 10
    for name, value in pulled.items():
        moved = derivatives.by(name).trajectory
        expected = sum(float((weights[key] * getattr(moved, key)).sum()) for key in weights)
        assert value == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_casadi_has_the_same_derivatives() -> None:
    """Van der Pol's oscillator with a bounded input, transcribed in CasADi, whose `nlpsol` has derivatives."""
    N, d, T = 20, 3, 5.0
    problem = mbsrun.problem(
        None,
        name="oscillator",
        horizon=T,
        intervals=N,
        degree=d,
        constants={"mu": 1.0, "most": 0.8},
        states={"x": {"rate": "v", "start": 1}, "v": {"rate": "mu*(1 - x**2)*v - x + u", "start": 0}},
        controls={"u": {"range": [-0.3, "most"]}},
        cost={"running": [{"expression": "x**2 + v**2 + u**2", "weight": 1}]},
        solver=TIGHT,
    ).with_changes(start=None)
    names = ["constants.mu", "constants.most", "states.x.start"]
    derivatives = problem.derivatives(solve(problem), names)
    assert derivatives.status == SMOOTH
    assert derivatives.active > 3
    sensitivity, cost = differentiate_by_casadi(N, d, T)
    for k, name in enumerate(names):
        assert derivatives.cost[name] == pytest.approx(cost[k], rel=1e-7)
        assert derivatives.by(name).trajectory.controls[:, 0] == pytest.approx(sensitivity[:, k], rel=1e-6, abs=1e-7)


def differentiate_by_casadi(N: int, d: int, T: float) -> tuple[Array, Array]:
    """Return the derivatives of inputs (N, 3) and of the cost (3,) by mu, the largest input and the start."""
    h, tau = T / N, np.array([0, *ca.collocation_points(d, "radau")])
    basis = [np.poly1d(np.poly(np.delete(tau, j)) / np.prod(tau[j] - np.delete(tau, j))) for j in range(d + 1)]
    slope = np.array([[basis[j].deriv()(tau[i]) for j in range(d + 1)] for i in range(d + 1)])
    p, X, U = ca.MX.sym("p", 3), ca.MX.sym("X", 2, N * d + 1), ca.MX.sym("U", N)
    weights = np.array([basis[j].integ()(1) for j in range(d + 1)])
    g, f = [X[:, 0] - ca.vertcat(p[2], 0)], 0
    for k in range(N):
        at = X[:, k * d : (k + 1) * d + 1]
        for i in range(1, d + 1):
            x, v = at[0, i], at[1, i]
            rate = ca.vertcat(v, p[0] * (1 - x**2) * v - x + U[k])
            g.append(ca.mtimes(at, ca.DM(slope[i])) - h * rate)
            f += h * weights[i] * (x**2 + v**2 + U[k] ** 2)
    w, g = ca.vertcat(ca.vec(X), U), ca.vertcat(*g, U + 0.3, p[1] - U)
    problem = {"x": w, "p": p, "f": f, "g": g}
    ipopt = {"tol": 1e-13, "print_level": 0, "sb": "yes", "bound_relax_factor": 0}
    options = {"print_time": False, "ipopt": ipopt, "min_lam": 1e-9}  # smaller multipliers are of inactive rows
    solver = ca.nlpsol("oscillator", "ipopt", problem, options)
    unbounded = {"lbx": -math.inf, "ubx": math.inf, "lbg": 0, "p": [1.0, 0.8, 1.0]}
    rows = int(g.shape[0]) - 2 * N
    known = {**unbounded, "ubg": [*[0] * rows, *[math.inf] * (2 * N)]}
    found = solver(**known)
    whole = solver.factory("derivative", solver.name_in(), ["jac:x:p", "jac:f:p"])
    derivative = whole(**known, x0=found["x"], lam_x0=found["lam_x"], lam_g0=found["lam_g"])
    return derivative["jac_x_p"].full()[-N:], derivative["jac_f_p"].full().ravel()


# --- neighbours ---


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_sided_derivatives_are_differences_to_that_side(sign: float) -> None:
    """At a weakly active bound; the program is quadratic, so its solution is straight on either side for a while."""
    free = solve(slide())
    problem = slide(controls={"a": {"range": [None, float(free["a"].max())]}})
    found = solve(problem)
    derivatives = problem.derivatives(found, ["states.x.end", "controls.a.range.upper"])
    assert derivatives.status == CHANGING
    for number in derivatives.answer.numbers:
        one, two = (solve(problem.with_numbers({number.name: number.value + k * sign * 1e-2})) for k in (1, 2))
        expected = (two.trajectory.controls - one.trajectory.controls) / 1e-2
        moved = derivatives.one_sided({number.name: sign}).trajectory.controls
        assert moved == pytest.approx(expected, abs=1e-5)


def test_predictions_of_a_quadratic_program_are_exact() -> None:
    """Limits become active and inactive on the way; the tangent alone is far off."""
    problem = slide(controls={"a": {"range": [-5.2, 5.2]}})
    found = solve(problem)
    derivatives = problem.derivatives(found, ["states.x.end", "controls.a.range.upper"])
    for change, changes in (
        ({"states.x.end": 0.1}, 2),
        ({"states.x.end": -0.3}, 4),
        ({"controls.a.range.upper": 1}, 2),
    ):
        values = {x.name: x.value + change.get(x.name, 0.0) for x in derivatives.answer.numbers}
        expected = solve(problem.with_numbers(values)).trajectory.controls - found.trajectory.controls
        predicted = derivatives.predict(change)
        assert predicted.changes == changes
        assert predicted.trajectory.controls == pytest.approx(expected, abs=1e-8)
        tangent = derivatives.predict(change, active_set=False).trajectory.controls
        assert np.abs(tangent - expected).max() > 0.1


def test_a_way_along_a_number_ends_in_the_solution_there() -> None:
    """A pole is swung up farther; the way has the optimum of a solve from the way's end, and shows every step."""
    problem = mbsrun.read_problem(MODELS / "cart_pole_swing_up.ocp.yaml")
    assert isinstance(problem, OptimalControl)
    shown: list[float] = []
    found = problem.continue_to("end.pose.cart", 1.6, watch=lambda stop: shown.append(stop.value))
    assert found.is_reached
    assert found.value == 1.6
    assert shown == [stop.value for stop in found.stops]
    assert shown[0] == 1.0
    assert all(stop.defect < 1e-6 for stop in found.stops if stop.is_taken)
    again = problem.with_numbers({"end.pose.cart": 1.6}).solve(guess=found.solution, check=False)
    assert found.solution.cost == pytest.approx(again.cost, rel=1e-7)


def test_a_turning_point_is_noticed() -> None:
    """Bratu's equation x'' + k exp(x) = 0, x(0) = x(1) = 0 has no solution beyond k = 3.513830719 (literature)."""
    states = {
        "x": {"rate": "v", "start": 0, "end": 0},
        "v": {"rate": "-k*exp(x)", "start": [None, None], "end": [None, None]},
    }
    found = slide(constants={"k": 1.0}, states=states).continue_to("constants.k", 5.0)
    assert found.status == TURNING
    assert found.turning == pytest.approx(3.513830719, abs=1e-4)
    assert "turn back" in repr(found)
    failed = slide(controls={"a": {"range": [-1, 1]}}).continue_to("states.x.end", 2.0)
    assert not failed.is_reached
    with pytest.raises(ProblemError, match="give a finite one"):
        slide().continue_to("states.x.end", math.inf)


# --- functions of programs that learn ---


def test_a_layer_has_the_values_and_the_derivatives_of_solves() -> None:
    """Of a batch, in NumPy, JAX and PyTorch: a loss, and its gradient by differences of order four."""
    jax, torch = pytest.importorskip("jax"), pytest.importorskip("torch")
    problem = mbsrun.read_problem(MODELS / "track" / "cart_pole.ocp.yaml").with_changes(solver=TIGHT)
    assert isinstance(problem, OptimalControl)
    layer = problem.differentiable(["start.pose.pole", "cost.running[0].weight"], ["u", "cost"])
    assert layer.names == ("start.pose.pole", "cost.running[0].weight")
    values = np.stack([layer.values, layer.values * [1.1, 0.9]])
    found = layer(values)
    assert found["u"].shape == (2, *layer.shapes["u"])
    there = problem.with_numbers(dict(zip(layer.names, values[1].tolist(), strict=True)))
    other = there.solve(check=False, guess=solve(problem))
    assert isinstance(other, Solved)
    assert found["cost"][1] == pytest.approx(other.cost, rel=1e-9)
    assert found["u"][1] == pytest.approx(other.trajectory.u, abs=1e-6)

    def loss(found: Any) -> Any:
        return (found["u"][..., 0, 0] ** 2).sum() + found["cost"].sum()

    expected = np.zeros_like(values)
    for index in np.ndindex(*values.shape):
        h = 1e-3 * values[index]
        moved = [values.copy() for _ in range(4)]
        for k, d in enumerate((-2, -1, 1, 2)):
            moved[k][index] += d * h
        a, b, c, d = (float(loss(layer(x))) for x in moved)
        expected[index] = (8 * (c - b) - (d - a)) / (12 * h)
    with jax.enable_x64(True):
        function = layer.jax()
        own = jax.jit(jax.grad(lambda x: loss(function(x))))(jax.numpy.asarray(values))
        each = jax.vmap(jax.grad(lambda x: loss(function(x))))(jax.numpy.asarray(values))
    assert np.asarray(own) == pytest.approx(expected, rel=1e-5)
    assert np.asarray(each) == pytest.approx(expected, rel=1e-5)
    tensor = torch.tensor(values, requires_grad=True)
    loss(layer.torch()(tensor)).backward()
    assert tensor.grad.numpy() == pytest.approx(expected, rel=1e-5)


def test_a_layer_has_no_numbers_where_there_are_none() -> None:
    """A start that no input of the range brings to its end, and a bound that is about to act; bad questions."""
    most = float(solve(slide())["a"].max())
    layer = slide(controls={"a": {"range": [None, 5.0]}}).differentiable(
        ["states.x.end", "controls.a.range.upper"], ["controls", "cost"]
    )
    found = layer([[1.0, 5.0], [9.0, 1.0], [1.0, most]])
    assert np.isfinite(found["cost"]).tolist() == [True, False, True]
    weights = {"controls": np.ones((3, 20, 1))}
    assert np.isnan(layer.pull([[1.0, 5.0], [9.0, 1.0], [1.0, most]], weights)).all(axis=1).tolist() == [
        False,
        True,
        True,
    ]
    assert layer.find_status(np.array([1.0, most])) == CHANGING
    assert layer.find_status(np.array([9.0, 1.0])) == "Infeasible_Problem_Detected"
    with pytest.raises(ProblemError, match=r"the shape \(3,\); give \(\.\.\., 2\)"):
        layer([1, 2, 3])
    with pytest.raises(ProblemError, match="no part of a motion"):
        slide().differentiable(["states.x.end"], ["force"])
    products = slide(constants={"b": 2, "c": 0.5}, states={"x": {"end": "b*c"}})
    with pytest.raises(ProblemError, match="do not follow them in straight lines"):
        products.differentiable(["constants.b", "constants.c"])


def test_members_of_a_batch_do_not_know_each_other() -> None:
    """Neither the order, nor the company, nor the threads of a batch change a bit; each member has a status."""
    numbers = ["states.x.end", "controls.a.range.upper"]
    problem = slide(controls={"a": {"range": [None, 5.0]}})
    values = np.array([[1.0, 5.0], [1.2, 7.0], [9.0, 1.0], [np.nan, 5.0], [0.9, 4.5], [1.2, 7.0], [np.inf, 2.0]])
    alone = [problem.differentiable(numbers, ["controls", "cost"])(row) for row in values]
    for threads, order in ((1, slice(None)), (2, slice(None, None, -1))):
        layer = problem.differentiable(numbers, ["controls", "cost"], threads=threads)
        found = layer(values[order].reshape(7, 1, 2))
        for name in ("controls", "cost"):
            expected = np.stack([one[name] for one in alone])[order]
            np.testing.assert_array_equal(found[name][:, 0], expected)
        infeasible, wrong = "Infeasible_Problem_Detected", "Invalid_Number_Detected"
        expected = np.array([SMOOTH, SMOOTH, infeasible, wrong, SMOOTH, SMOOTH, wrong])[order]
        assert layer.find_statuses(values[order].reshape(7, 1, 2)).ravel().tolist() == expected.tolist()
        slopes = layer.pull(values[order], {"controls": np.ones((7, 20, 1))})
        assert (np.isnan(slopes).all(axis=1) == (expected != SMOOTH)).all()
    with pytest.raises(ProblemError, match="found 0; give a whole number, 1 or more"):
        problem.differentiable(numbers, threads=0)
    with pytest.raises(ProblemError, match="7 vectors; give one, or take find_statuses"):
        layer.find_status(values)


def test_a_member_starts_from_the_prediction_in_the_middle() -> None:
    """Fewer iterations than from the motion alone, to the same optimum; a quadratic program takes one or two."""
    layer = slide().differentiable(["states.x.end"], ["controls", "cost"])
    member = layer.solve(np.array([2.0]))
    assert member.outcome.run.iterations <= 2
    assert float(layer([2.0])["cost"]) == pytest.approx(48 / (1 - 1 / 400), rel=1e-9)
    problem = mbsrun.read_problem(MODELS / "track" / "cart_pole.ocp.yaml")
    assert isinstance(problem, OptimalControl)
    layer = problem.differentiable(["start.pose.pole", "cost.running[0].weight"], ["cost"])
    values = layer.values * [1.1, 0.9]
    there = problem.with_numbers(dict(zip(layer.names, values.tolist(), strict=True)))
    cold = there.solve(check=False, guess=solve(problem))
    assert isinstance(cold, Solved)
    near = layer.solve(values)
    assert near.outcome.run.iterations < cold.solution.run.iterations
    assert float(layer(values)["cost"]) == pytest.approx(cold.cost, rel=1e-6)


def test_misfits_of_a_layer_are_told_at_once() -> None:
    layer = slide().differentiable(["states.x.end"], ["controls", "cost"])
    with pytest.raises(ProblemError, match="values: no array of numbers"):
        layer("a")
    with pytest.raises(ProblemError) as told:
        layer.pull([1.0], {"force": 1.0, "controls": np.ones(20), "cost": "a"})
    for line in (
        "force: no part of a motion that a function may read; give controls, cost",
        "controls: weights of shape (20,); give the shape (20, 1)",
        "cost: no array of numbers; give the shape ()",
    ):
        assert line in str(told.value)


# --- no derivative ---


def test_a_weakly_active_bound_has_no_derivative() -> None:
    """A bound that is reached without a force: status and no number; the cost still has its derivative."""
    free = solve(slide())
    most = float(free["a"].max())
    problem = slide(controls={"a": {"range": [None, most]}})
    derivatives = problem.derivatives(solve(problem), ["states.x.end", "controls.a.range.upper"])
    assert derivatives.status == CHANGING
    assert set(derivatives.statuses.values()) == {CHANGING}
    with pytest.raises(NoDerivativeError, match="about to become active"):
        derivatives.by("states.x.end")
    assert np.isnan([*derivatives.pull({"controls": np.ones((20, 1))}).values()]).all()
    assert derivatives.cost["states.x.end"] == pytest.approx(24 / (1 - 1 / 400), rel=1e-6)
    assert "Active_Set_Changes" in repr(derivatives)


def test_a_number_that_leaves_a_weak_limit_alone_has_derivatives() -> None:
    """A bound of 0 on a control that nothing moves is met without a force; the motion has its derivatives."""
    idle = slide(controls={"b": {"range": [0, None]}}, cost={"running": [{"expression": "a**2 + b**2", "weight": 1}]})
    derivatives = idle.derivatives(solve(idle), ["states.x.end", "controls.b.range.lower"])
    assert derivatives.status == CHANGING
    assert derivatives.statuses == {"states.x.end": SMOOTH, "controls.b.range.lower": CHANGING}
    free = slide().derivatives(solve(slide()), ["states.x.end"])
    assert derivatives.cost["states.x.end"] == pytest.approx(free.cost["states.x.end"], rel=1e-8)
    ends = [d.by("states.x.end").phases[0] for d in (derivatives, free)]
    assert ends[0].states == pytest.approx(ends[1].states, abs=1e-8)


def test_a_limit_that_the_end_implies_keeps_derivatives() -> None:
    """A speed of at least 0 that ends at 0, twice: the cost 12 x^2 / T^3 of the push, and its slope."""
    limits = [{"expression": f"{k}*v", "range": [0, None], "at": "end"} for k in (1, 2)]
    problem = slide(constraints=limits)
    derivatives = problem.derivatives(solve(problem), ["states.x.end", "states.v.end", "horizon"])
    free = slide().derivatives(solve(slide()), ["states.x.end", "states.v.end", "horizon"])
    statuses = {"states.x.end": SMOOTH, "states.v.end": CHANGING, "horizon": SMOOTH}
    assert (derivatives.status, derivatives.statuses) == (SMOOTH, statuses)
    for name in ("states.x.end", "horizon"):
        assert flatten(derivatives.by(name).phases) == pytest.approx(flatten(free.by(name).phases), abs=1e-8)
        assert derivatives.cost[name] == pytest.approx(free.cost[name], rel=1e-9)


def test_dependent_constraints_have_no_derivative() -> None:
    twice = [{"expression": "v", "range": [0, 0], "at": "end"}, {"expression": "2*v", "range": [0, 0], "at": "end"}]
    problem = slide(states={"v": {"end": [None, None]}}, constraints=twice)
    derivatives = problem.derivatives(solve(problem), ["states.x.end"])
    assert derivatives.status == DEPENDENT
    assert math.isnan(derivatives.cost["states.x.end"])


def test_a_minimum_that_is_not_strict_has_no_derivative() -> None:
    """Two controls push one mass, and the cost sees their sum alone."""
    problem = slide(
        states={"v": {"rate": "a + b"}},
        controls={"b": {}},
        cost={"running": [{"expression": "(a + b)**2", "weight": 1}]},
    )
    derivatives = problem.derivatives(solve(problem), ["states.x.end"])
    assert derivatives.status in (FLAT, DEPENDENT)
    assert "no derivative" in catch(lambda: derivatives.by("states.x.end"))


def test_one_limit_of_an_equality_has_no_derivative() -> None:
    problem = slide(
        states={"x": {"end": [None, None]}}, constraints=[{"expression": "x", "range": [1, 1], "at": "end"}]
    )
    derivatives = problem.derivatives(solve(problem), ["constraints[0].range.lower", "states.v.end"])
    assert derivatives.statuses == {"constraints[0].range.lower": SPLIT, "states.v.end": SMOOTH}
    assert [*derivatives.explain()] == ["constraints[0].range.lower"]


def test_a_condition_that_nothing_can_follow_has_no_derivative() -> None:
    """A planar arm whose target has a height: the free final time and all else still have derivatives."""
    problem = mbsrun.read_problem(MODELS / "planar_arm_fastest.ocp.yaml")
    assert isinstance(problem, OptimalControl)
    derivatives = problem.derivatives(solve(problem), ["end.sensors.hand.z", "end.sensors.hand.x"])
    assert [*derivatives.statuses.values()] == [STUCK, SMOOTH]


def test_a_motion_that_is_no_optimum_has_no_derivative() -> None:
    problem = slide()
    found = solve(problem)
    from dataclasses import replace

    moved = replace(found.trajectory, controls=found.trajectory.controls + 1)
    other = Solved(replace(found.solution, trajectory=moved), found.plant)
    assert problem.derivatives(other, ["states.x.end"]).status == NOT_CONVERGED


def test_bad_questions_get_a_sentence() -> None:
    problem = slide(constants={"push": 2}, unknowns={"c": {"guess": 0.5, "range": [0, 1]}})
    problem = problem.with_cost("c**2", at="end")
    found = solve(problem)
    for by, message in (
        (["states.x.edn"], r"states\.x\.edn: it is no number of the problem; did you mean states\.x\.end\?"),
        (["states.x.rate"], "states.x.rate: found 'v', which is no number"),
    ):
        with pytest.raises(ProblemError, match=message):
            problem.derivatives(found, by)
    with pytest.raises(ProblemError, match="it belongs to a problem with other numbers; solve this problem"):
        problem.with_changes(states={"x": {"end": 2}}).derivatives(found)
    derivatives = problem.derivatives(found, ["states.x.end"])
    with pytest.raises(ProblemError, match=r"no such number; did you mean states\.x\.end"):
        derivatives.by("states.x")
    with pytest.raises(ProblemError, match=r"controls: weights of shape \(2,\); give the shape \(20, 1\)"):
        derivatives.pull({"controls": [1, 2]})
    with pytest.raises(ProblemError, match="no part of a motion that a function may read"):
        derivatives.pull({"w": [1, 2]})
    failed = slide(controls={"a": {"range": [-1, 1]}}).solve(check=False)
    assert not failed.is_solved
    with pytest.raises(NotSolvedError, match="slide was not solved"):
        slide().derivatives(failed)


CART = """
name: cart
gravity: [0, 0, 0]
parameters: {m: {value: 2, kind: KIND}}
bodies: [{name: cart, joint: {name: x, type: prismatic, axis: x}, mass: m}]
"""


def make_cart(folder: Path, kind: str) -> OptimalControl:
    model = folder / f"{kind}.yaml"
    model.write_text(CART.replace("KIND", kind))
    end = {"pose": {"x": 1}, "velocity": "zero"}
    return mbsrun.problem(model, horizon=1, intervals=20, end=end, parameters={"m": 3}, solver=TIGHT)


def test_a_mass_scales_the_least_effort(tmp_path: Path) -> None:
    """The cost is proportional to m^2, inputs are to m; so is their derivative, and the motion has none."""
    problem = make_cart(tmp_path, "differentiated")
    found = solve(problem)
    derivatives = problem.derivatives(found, ["parameters.m"])
    assert derivatives.cost["parameters.m"] == pytest.approx(2 * found.cost / 3, rel=1e-9)
    moved = derivatives.by("parameters.m").trajectory
    assert moved.u == pytest.approx(found.trajectory.u / 3, rel=1e-8, abs=1e-9)
    assert np.abs(moved.q).max() < 1e-9
    assert moved.unknowns.size == 0


def test_a_parameter_without_derivatives_is_refused(tmp_path: Path) -> None:
    problem = make_cart(tmp_path, "runtime")
    with pytest.raises(ProblemError, match=r"m is no differentiated parameter .* declare it `kind: diff"):
        problem.derivatives(solve(problem), ["parameters.m"])


def catch(call: Any) -> str:
    with pytest.raises(NoDerivativeError) as caught:
        call()
    return str(caught.value)
