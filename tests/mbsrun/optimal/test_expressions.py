"""Expressions in CasADi: the same numbers in both backends, the same optima as texts, and exact derivatives."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbsrun
from mbsgen.expressions import parse
from mbsrun.controllers.making import make
from mbsrun.jets import compose_dependences, depend
from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.evaluation.backends import numpy as in_numpy
from mbsrun.ocp.evaluation.backends.evaluations import FormulaEvaluation
from mbsrun.ocp.ground.functions import Formula, Input, SymbolicCall
from mbsrun.ocp.problem.phases import Plants, list_one
from mbsrun.ocp.problem.problem import Form, Problem, Representation
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.transcription.transcription import transcribe
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.quantities import make_functions
from mbsrun.optimal.result import Solved
from mbsrun.results import UnknownNameError

MODEL = Path(__file__).parents[3] / "models" / "cart_pole.yaml"
TEXTS = {
    "cost": {
        "inputs": 1,
        "running": [{"expression": "w*(x_mass - 0.5)**2*q_pole + u_cart*qd_cart*t", "weight": 3}],
        "terminal": [{"expression": "z_mass*T", "weight": 2}],
    },
    "constraints": [
        {"expression": "vx_mass", "range": [-3, 3]},
        {"expression": "qdd_cart*q_pole", "range": [-60, 50]},
        {"expression": "qd_cart + qd_pole", "range": [0, 0], "at": "start"},
    ],
}


@pytest.fixture(scope="module")
def swing() -> OptimalControl:
    return mbsrun.problem(
        MODEL,
        horizon={"guess": 2, "range": [1, 2]},
        intervals=20,
        degree=3,
        bounds={"inputs": [-20, 20]},
        start={"pose": {}, "velocity": {"cart": None, "pole": None}},
        end={"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"},
        constants={"w": 2.0},
        cost={"inputs": 1},
    )


@pytest.fixture(scope="module")
def written(swing: OptimalControl) -> OptimalControl:
    """The problem with the expressions of TEXTS in CasADi."""
    s = swing.quantities()
    return (
        swing.with_cost(s.w * (s.x_mass - 0.5) ** 2 * s.q_pole + s.u_cart * s.qd_cart * s.t, 3)
        .with_cost(s.z_mass * s["T"], 2, at="end")
        .with_constraint(ca.vertcat(s.vx_mass, s.qdd_cart * s.q_pole), [-3, -60], (3, 50))
        .with_constraint(s.qd_cart + s.qd_pole, 0, 0, at="start")
    )


def compare(problem: Problem, plant: Any, rng: np.random.Generator) -> None:
    """Compare all functions of both backends at a random point, to rounding."""
    transcription = transcribe(problem, plant)
    ours, theirs = (backend.build(transcription.program, plant) for backend in (in_numpy, condensation))
    x, p = rng.uniform(0.5, 1, theirs.variables), transcription.parameters(problem)
    lam = rng.uniform(-1, 1, theirs.constraints)
    for name, found, expected in (
        ("terms", ours.terms(x, p), theirs.terms(x, p).full().ravel()),
        ("gradient", ours.gradient(x, p), theirs.gradient(x, p)[1].full().ravel()),
        ("constraint", ours.constraint(x, p), theirs.constraint(x, p).full().ravel()),
        ("jacobian", ours.jacobian(x, p).toarray(), theirs.jacobian(x, p).full()),
        ("hessian", ours.hessian(x, p, 0.7, lam).toarray(), theirs.hessian(x, p, 0.7, lam).full()),
    ):
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max(), name


def test_both_backends_make_the_same_functions(written: OptimalControl, rng: np.random.Generator) -> None:
    compare(replace(written.value, intervals=2), written.plant, rng)
    ode = replace(written.value, intervals=2, representation=Representation.EXP1_O)
    compare(ode, written.plant, rng)


def test_expressions_in_casadi_and_texts_have_one_optimum(swing: OptimalControl, written: OptimalControl) -> None:
    """The steps of the solver are the same, so costs agree to rounding."""
    found, expected = written.solve(check=False), swing.with_changes(**TEXTS).with_solver("ipopt").solve(check=False)
    assert isinstance(found, Solved)
    assert abs(found.cost - expected.cost) <= 1e-9 * abs(expected.cost)
    assert len(found.terms) == 4
    repeated = written.with_constants(w=2.5).solve(check=False, guess=found)  # a parameter of the same program
    assert repeated.cost > found.cost


def test_results_of_functions_of_the_model_are_expressions(swing: OptimalControl) -> None:
    """The energy along the solution is the kernel's; a bound on it holds, and is active."""
    s = swing.quantities()
    energy = s.function("energy")
    assert energy["momentum"].shape == (3, 1)
    whole = energy["kinetic"] + energy["potential"]
    found = swing.with_constraint(whole, upper=1.55).solve(check=False)
    q, qd = (part.reshape(-1, 2) for part in (found.trajectory.point_q, found.trajectory.point_qd))
    kernel = swing.plant("energy", q=q, qd=qd)
    assert abs((kernel["kinetic"] + kernel["potential"]).max() - 1.55) <= 1e-6
    M = s.function("semi")["M"]
    assert ca.symvar(M)[0].name() == "q_pole"
    assert abs(float(ca.Function("M", [s.q], [M])([0, 0])[0, 1]) - 0.15) <= 1e-15  # m l
    with pytest.raises(ProblemError, match="make the problem of the model's file"):
        mbsrun.problem(swing.plant, horizon=1).quantities().function("energy")


def test_calls_of_functions_are_expressions(swing: OptimalControl, rng: np.random.Generator) -> None:
    """The residual of the equations of motion, called by the expression, is 0 at the optimum."""
    s = swing.quantities(ca.MX)
    residual = swing.plant.casadi("impl")(s.q, s.qd, s.qdd, s.u)
    table = ca.interpolant("table", "bspline", [[-1.0, 0.0, 1.0, 2.0, 3.0]], [0.0, 1.0, 0.5, 2.0, 1.0])
    called = swing.with_constraint(residual, -1, 1).with_cost(table(s.q_cart) * s.u_cart**2, 1)
    compare(replace(called.value, intervals=2), swing.plant, rng)


def test_a_function_of_several_numbers_is_differentiated_twice(rng: np.random.Generator) -> None:
    """NumPy's derivatives of f(g(x)), which SX composes itself; the pattern has no entry that is always 0."""
    a, b, x = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("x", 3)
    (function,) = make_functions("f", ca.sin(a) * b + b, "p")
    arguments = (parse("x0*x1"), parse("x2**2 + 3"))
    call = SymbolicCall("f", function.code, arguments if function.reads == ("a", "b") else arguments[::-1])
    names = {f"x{i}": ("x", i) for i in range(3)}
    formula = Formula((parse("2*f + x0"),), names, (Input("x", 3),), calls=(call,))
    evaluation = FormulaEvaluation(formula, None, 4)  # type: ignore[arg-type]  # no kernel is called
    composed = 2 * (ca.sin(x[0] * x[1]) * (x[2] ** 2 + 3) + x[2] ** 2 + 3) + x[0]
    H, g = ca.hessian(composed, x)
    expected = ca.Function("f", [x], [composed, g, H])
    points = rng.uniform(-1, 1, (4, 3))
    w = np.ones((4, 1))
    (jacobian,), (hessian,) = evaluation.jacobian([points]), evaluation.hessian([points], w)
    (rows,) = evaluation.hessian_patterns
    for k, point in enumerate(points):
        f, slope, curvature = (np.asarray(part.full()) for part in expected(point))
        assert abs(evaluation.value([points])[k, 0] - f[0, 0]) <= 1e-14
        assert np.abs(jacobian[k] - slope.ravel()).max() <= 1e-14
        assert np.abs(hessian[k] - curvature[rows.row, rows.col]).max() <= 1e-13
    unread = compose_dependences(np.array([True, False]), np.zeros((2, 2), dtype=bool), [depend(0, 3), depend(1, 3)])
    assert unread.g.tolist() == [True, False, False]
    assert not unread.H.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p, _: p.with_cost(ca.SX.sym("nix")), 'reads: unknown name "nix"; take symbols of `quantities'),
        (lambda p, _: p.with_cost(ca.SX(3)), "the expression reads no quantity"),
        (lambda p, _: p.with_cost(3), "cost_1: found a value of type int; give an expression"),
        (lambda p, _: p.with_cost(ca.SX.sym("q", 2)[0], name="f"), None),
        (lambda p, _: p.with_cost(ca.MX.sym("q", 2)[0]), "the expression reads vectors"),
        (lambda p, s: p.with_cost(s.q), "cost: an expression of 2 entries; give a scalar"),
        (lambda p, s: p.with_cost(s.t, "heavy"), "the weight is 'heavy'; give a number"),
        (lambda p, s: p.with_cost(s.t, at="start"), "at 'start'; give 'path' or 'end'"),
        (lambda p, _: p.with_cost("q_pol"), "did you mean"),
        (lambda p, _: p.with_constraint("q_pole", 0, "q"), 'unknown name "q"'),
        (lambda p, s: p.with_constraint(s.q, [1, 2, 3]), r"2 entries, with the limits \[1, 2, 3\] and inf"),
        (lambda p, s: p.with_constraint(s.t, at="never"), "constraints.*at"),
        (lambda p, s: p.with_cost(s.t, name="q_cart"), 'functions.0..name: found "q_cart"; give a name'),
        (lambda p, s: p.with_cost(s.t, name="f").with_cost(s.T, name="f"), 'functions.1..name: found "f"'),
        (lambda p, s: p.with_cost(s.t).with_solver("mbs"), "mbs writes a problem in C, and an expression of CasADi"),
    ],
)
def test_wrong_expressions_are_refused(swing: OptimalControl, change: Any, message: str | None) -> None:
    with pytest.raises(ProblemError, match=message):
        change(swing, swing.quantities())


def test_a_callback_cannot_be_stored(swing: OptimalControl) -> None:
    class Plain(ca.Callback):  # type: ignore[misc]
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("plain", {"enable_fd": True})

    plain = Plain()
    with pytest.raises(ProblemError, match=r"CasADi cannot store or differentiate the expression: .*write it without"):
        swing.with_cost(plain(swing.quantities(ca.MX).t))


def test_symbols_have_names(swing: OptimalControl) -> None:
    s = swing.quantities()
    assert [x.name() for x in ca.symvar(s.position("mass"))] == ["x_mass", "y_mass", "z_mass"]
    assert [x.name() for x in ca.symvar(s.velocity("mass"))] == ["vx_mass", "vy_mass", "vz_mass"]
    assert s.u.shape == (1, 1)
    assert len(s) == len(list(s)) == 28
    with pytest.raises(UnknownNameError, match=r'the problem has no quantity "q_pol"; did you mean q_pole\?'):
        s["q_pol"]
    assert not hasattr(s, "q_pol")


def test_files_hold_no_code(written: OptimalControl, tmp_path: Path) -> None:
    """A file may come from anywhere, and a function's code names libraries to load: so none is written, nor read."""
    written.solve(check=False).save(tmp_path / "s.json")
    text = (tmp_path / "s.json").read_text()
    stored = json.loads(text)["solution"]["problem"]["functions"]
    assert [sorted(part) for part in stored] == [["name", "reads", "text"]] * 5
    planted = text.replace('"name": "cost_1", "reads"', '"code": "jhpnn", "name": "cost_1", "reads"')
    assert planted != text
    (tmp_path / "planted.json").write_text(planted)
    problem = written.load(tmp_path / "planted.json").solution.problem
    assert {function.code for function in problem.functions} == {""}
    with pytest.raises(ProblemError, match=r'functions\[0\].code: "cost_1" has no code, which files do not hold'):
        transcribe_checked(problem, written)


def transcribe_checked(problem: Problem, control: OptimalControl) -> None:
    control.programs.find(list_one(problem), Plants((control.plant,)))


def test_controllers_take_no_expressions_in_casadi(written: OptimalControl) -> None:
    with pytest.raises(ProblemError, match="a controller is C, and the problem has expressions of CasADi"):
        make(written.value, written.plant, MODEL)  # type: ignore[arg-type]


def test_shooting_calls_expressions(swing: OptimalControl, rng: np.random.Generator) -> None:
    s = swing.quantities()
    value = swing.with_changes(horizon=2).with_cost(ca.log1p(ca.exp(s.q_pole * s.u_cart / 9))).value
    compare(replace(value, form=Form.SHOOTING, intervals=2, horizon=0.2), swing.plant, rng)


def test_states_and_controls_of_a_problem_are_quantities() -> None:
    """x' = u - x from 0 to 1 with the least integral of u^2: x = sinh(t)/sinh(1) by Euler and Lagrange."""
    leaky = mbsrun.problem(
        None,
        name="leaky",
        horizon=1,
        intervals=40,
        states={"x": {"rate": "u - x", "start": 0, "end": 1}},
        controls={"u": {"guess": 0.5}},
        cost={"input_rates": 0},
    )
    s = leaky.quantities()
    found = leaky.with_cost(s.u**2).solve()
    assert "x' = u - x" in repr(leaky)
    assert found.cost == pytest.approx(np.exp(1) / np.sinh(1), rel=1e-3)  # u is constant over an interval
    assert np.abs(found["x"] - np.sinh(found.t) / np.sinh(1)).max() <= 1e-3
    assert np.abs(found["u"] - np.exp(found.t) / np.sinh(1)).max() <= 0.05


def test_unknowns_are_quantities() -> None:
    """The mass of a spring is chosen, by an expression in CasADi and by a text."""
    arm = mbsrun.read_problem(MODEL.parent / "design" / "lifting_arm.ocp.yaml")
    (unknown, *_) = arm.value.unknowns
    priced = arm.with_cost(arm.quantities()[unknown.name], 0.5, at="end").solve(check=False)
    written = arm.with_cost(unknown.name, 0.5, at="end").with_solver("ipopt").solve(check=False)
    assert priced.unknowns == written.unknowns
    assert priced.cost == pytest.approx(written.cost, rel=1e-12)
