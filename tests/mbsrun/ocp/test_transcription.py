"""Laws of direct collocation; sizes of Table 3 of Docquier, Bruls, Fisette."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbsrun.ocp.evaluation.backends.condensation import build
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.methods.ipopt import pair
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Form, Problem, Representation
from mbsrun.ocp.problem.structure import structure
from mbsrun.ocp.transcription.transcription import Transcription, transcribe
from tests.mbsrun.ocp.programs import (
    TABLE_3,
    check_derivatives,
    evaluate_rows,
    evaluate_terms,
    functions_of,
    rich,
    small,
)
from tests.mbsrun.peer import Peer, double_integrator

SCHEMES = [(Family.RADAU, 1), (Family.RADAU, 3), (Family.LEGENDRE, 1), (Family.LEGENDRE, 4)]


def polynomial_motion(
    problem: Problem, transcription: Transcription, rng: np.random.Generator
) -> tuple[Trajectory, np.ndarray]:
    """A motion of degree d in q, hence in the collocation's reach; with the accelerations at T."""
    d = problem.degree
    c = rng.uniform(-0.5, 0.5, (d + 1, len(problem.start_q)))
    t, point_t = problem.grid.times(problem.horizon, transcription.scheme.points)

    def values(t: np.ndarray, order: int) -> np.ndarray:
        derivative = np.polynomial.polynomial.polyder(c, order, axis=0) if order <= d else np.zeros((1, c.shape[1]))
        return np.moveaxis(np.polynomial.polynomial.polyval(t, derivative), 0, -1)

    u = rng.uniform(-1, 1, (problem.intervals, len(problem.bounds.u)))
    motion = Trajectory(t, values(t, 0), values(t, 1), u, point_t, *(values(point_t, k) for k in range(3)))
    return motion, values(np.array(problem.horizon), 2)


@pytest.mark.parametrize(("representation", "sizes"), TABLE_3.items())
def test_sizes_of_table_3(
    arm: Peer, reach: Problem, representation: Representation, sizes: tuple[int, int, int, int]
) -> None:
    """Sizes and nonzeros of all six representations.

    All is as printed, but the Hessians of the algebraic ones: the paper has 39021 and 35021. At every point the
    dynamics have 15 + 30 + 21 entries in (q, qd) above the diagonal, and 30 with z or 20 with u; 796 are of the cost
    and 10 of the sensor; an ODE has the dynamics at x_N too, 86 of which 6 are the sensor's: 39206, 35206 and 35286.
    What is printed for the algebraic ones is less by 185, with z and with u alike, so the coupling with these is whole;
    by parts it is neither whole points (66 entries in (q, qd) each, 400 of them), nor inputs (4 at a time), nor the
    sensor. All of these are even in number, and 185 is odd: of the blocks above the diagonal only q with q (15) and qd
    with qd (21) could make it so, and no whole number of both and of (q, qd), 30, sums up to 185, which 3 does not
    divide. Nothing of this program has 185 entries, and its ODE, made of the same parts, is as printed. Of the same
    program without these kernels CasADi finds our three numbers, 3.6 as well as 3.8.
    """
    program = functions_of(replace(reach, representation=representation), arm)
    nonzeros = (program.jacobian.nnz_out(0), program.hessian.nnz_out(0))
    assert (program.variables, program.constraints, *nonzeros) == sizes


def integral(problem: Problem, representation: Representation) -> Problem:
    bounds = Bounds(problem.bounds.q, ((-7.0, np.inf), *problem.bounds.qd[1:]), problem.bounds.u)
    return replace(problem, representation=representation, form=Form.INTEGRAL, free_start=(), bounds=bounds)


@pytest.mark.parametrize("form", Form)
def test_ipopt_finds_no_fault_in_the_derivatives(
    arm: Peer, reach: Problem, form: Form, capfd: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    """IPOPT compares first and second derivatives with its own differences."""
    problem = rich(reach, Representation.IMPL, Family.RADAU, form is Form.STANDARD)
    problem = replace(problem, intervals=2, degree=1, form=form)
    test: dict[str, str | float] = {"derivative_test": "second-order", "derivative_test_perturbation": 1e-7}
    test["derivative_test_tol"] = 5e-3
    if form is Form.SHOOTING:  # at states from which Newton's method finds the next: IPOPT tests up to 10 away from x0
        problem, test["point_perturbation_radius"] = replace(problem, horizon=0.2), 0.0
    transcription = transcribe(problem, arm)
    program = build(transcription.program, arm)
    x, p = ca.MX.sym("x", program.variables), ca.MX.sym("p", program.parameters)
    nlp = {"x": x, "p": p, "f": program.objective(x, p), "g": program.constraint(x, p)}
    functions = {"grad_f": program.gradient, "jac_g": pair(program.jacobian), "hess_lag": program.hessian}
    settings = {**functions, "ipopt": {**test, "max_iter": 0}, "print_time": False}
    solver = ca.nlpsol("check", "ipopt", nlp, {**settings, "no_nlp_grad": True, "calc_lam_p": False})
    solver(x0=rng.uniform(0.5, 1, program.variables), p=transcription.parameters(problem))
    assert "No errors detected by derivative checker." in capfd.readouterr().out


INTEGRAL = [(r, f) for r in (Representation.IMPL, Representation.EXP2_A) for f in (Family.RADAU, Family.LEGENDRE)]


@pytest.mark.parametrize(("representation", "family"), INTEGRAL)
def test_derivatives_of_the_integral_form(
    arm: Peer, reach: Problem, representation: Representation, family: Family
) -> None:
    """Against CasADi's, which differentiates through the integrals."""
    check_derivatives(integral(rich(reach, representation, family, False), representation), arm)


@pytest.mark.parametrize(
    ("representation", "family", "mesh", "integrator"),
    [
        *((*both, None, "collocation") for both in INTEGRAL),
        (*INTEGRAL[0], (0.2, 0.5, 0.3), "collocation"),
        (*INTEGRAL[0], (0.2, 0.5, 0.3), SECOND_ORDER),
        (*INTEGRAL[1], None, SECOND_ORDER),
    ],
)
def test_the_integral_form_is_the_standard_form_solved(
    arm: Peer,
    reach: Problem,
    representation: Representation,
    family: Family,
    mesh: tuple[float, ...] | None,
    integrator: str,
    rng: np.random.Generator,
) -> None:
    """States at the points from accelerations: put into the standard form they satisfy it, and all else is equal."""
    problem = replace(
        integral(rich(reach, representation, family, False), representation), mesh=mesh, integrator=integrator
    )
    standard = replace(problem, form=Form.STANDARD)
    ours, theirs = transcribe(problem, arm), transcribe(standard, arm)
    x = rng.uniform(0.5, 1, ours.layout.size)
    y = theirs.pack(ours.unpack(x))
    assert ours.pack(ours.unpack(x)) == pytest.approx(x, abs=1e-14)
    g = evaluate_rows(ours, arm, problem, x)
    expected = evaluate_rows(theirs, arm, standard, y)
    assert np.abs(expected[theirs.rows.states]).max() < 1e-12
    for name in ("start", "dynamics", "continuity", "sensors", "acceleration", "accelerations", "sensor_velocities"):
        assert g[getattr(ours.rows, name)] == pytest.approx(expected[getattr(theirs.rows, name)], abs=1e-11), name
    for row, other in zip(ours.rows.constraints, theirs.rows.constraints, strict=True):
        assert g[row] == pytest.approx(expected[other], abs=1e-11)
    expected_costs = evaluate_terms(theirs, arm, standard, y)
    assert evaluate_terms(ours, arm, problem, x) == pytest.approx(expected_costs, rel=1e-12)


SLOPES = [
    (Representation.EXP1_O, Family.RADAU, False, None),
    (Representation.EXP2_O, Family.LEGENDRE, True, (0.2, 0.5, 0.3)),
    (Representation.IMPL, Family.RADAU, True, None),
]


@pytest.mark.parametrize(("representation", "family", "free", "mesh"), SLOPES)
def test_derivatives_with_slopes_equal_casadis(
    arm: Peer,
    reach: Problem,
    representation: Representation,
    family: Family,
    free: bool,
    mesh: tuple[float, ...] | None,
) -> None:
    """The integral form of an ODE, and over a horizon that is free."""
    problem = replace(rich(reach, representation, family, free), form=Form.INTEGRAL, mesh=mesh)
    check_derivatives(problem, arm)


@pytest.mark.parametrize(("representation", "family", "free", "mesh"), SLOPES)
def test_slopes_are_the_standard_form_solved(
    arm: Peer,
    reach: Problem,
    representation: Representation,
    family: Family,
    free: bool,
    mesh: tuple[float, ...] | None,
    rng: np.random.Generator,
) -> None:
    """Where slopes are the rates that accelerations ask for, all rows and terms are the standard form's."""
    problem = replace(rich(reach, representation, family, free), form=Form.INTEGRAL, mesh=mesh)
    standard = replace(problem, form=Form.STANDARD)
    ours, theirs = transcribe(problem, arm), transcribe(standard, arm)
    x = rng.uniform(0.5, 1, ours.layout.size)
    y = theirs.pack(ours.unpack(x))
    assert ours.pack(ours.unpack(x))[ours.layout.slopes] == pytest.approx(x[ours.layout.slopes], abs=1e-12)
    g = evaluate_rows(ours, arm, problem, x)
    expected = evaluate_rows(theirs, arm, standard, y)
    names = ("start", "continuity", "sensors", "velocities", "sensor_velocities", "states")
    for name in (*names, *(() if representation.is_ode else ("dynamics",))):
        found = g[getattr(ours.rows, name)]
        if name == "states" and not representation.is_ode:  # accelerations were read off the slopes
            found = found[:, :, :6]
            assert found == pytest.approx(expected[theirs.rows.states[:, :, :6]], abs=1e-11)
        elif name != "dynamics":
            assert found == pytest.approx(expected[getattr(theirs.rows, name)], abs=1e-11), name
    terms = evaluate_terms(ours, arm, problem, x), evaluate_terms(theirs, arm, standard, y)
    if representation.is_ode:
        assert terms[0] == pytest.approx(terms[1], rel=1e-11)


@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_bounds_hold_at_points_that_are_no_variables(
    arm: Peer, reach: Problem, family: Family, rng: np.random.Generator
) -> None:
    """A row for each state with a bound at each point that is no mesh point, with its bounds."""
    problem = integral(small(reach, family, 3), Representation.IMPL)
    transcription = transcribe(problem, arm)
    rows = transcription.rows.inner
    bounded = [1, 2, 3, 4, 5, 6]
    inner = 2 if family is Family.RADAU else 3
    assert rows.shape == (3, inner, 6)
    x = rng.uniform(-1, 1, transcription.layout.size)
    motion = transcription.unpack(x)
    states = np.concatenate((motion.point_q, motion.point_qd), axis=2)[:, :inner, bounded]
    g = evaluate_rows(transcription, arm, problem, x)
    assert g[rows] == pytest.approx(states, abs=1e-13)
    lower, upper = transcription.constraint_bounds(problem)
    assert (lower[rows] == np.array([*reach.bounds.q[1:], (-7.0, np.inf)])[:, 0]).all()
    assert (upper[rows] == np.array([*reach.bounds.q[1:], (-7.0, np.inf)])[:, 1]).all()


def test_sizes_of_the_integral_form(arm: Peer, reach: Problem) -> None:
    """100 (12 + 4 * 6 + 4) + 12 variables; 100 (4 * 6 + 12) + 27 constraints and 5 bounded states at 3 inner points."""
    program = functions_of(replace(reach, form=Form.INTEGRAL), arm)
    assert (program.variables, program.constraints) == (4012, 3627 + 100 * 3 * 5)


CONFLICTS = {
    "second order over a free horizon": (
        {"form": Form.INTEGRAL, "horizon_range": (1.0, 3.0), "integrator": SECOND_ORDER},
        "integrator: second-order collocation in the integral form does not go with a horizon that is free",
    ),
    "second order over unequal intervals": (
        {"form": Form.SHOOTING, "intervals": 2, "mesh": (0.25, 0.75), "integrator": SECOND_ORDER},
        "integrator: .* intervals of unequal length",
    ),
    "second order of an ODE": (
        {"form": Form.INTEGRAL, "representation": Representation.EXP1_O, "integrator": SECOND_ORDER},
        "integrator: .* accelerations that are no variables, as in EXP1-O",
    ),
    "shooting of an algebraic equation": (
        {"form": Form.SHOOTING, "representation": Representation.EXP2_A},
        "representation: EXP2-A",
    ),
    "rk4 of a residual": ({"form": Form.SHOOTING, "integrator": "rk4"}, "integrator: rk4"),
    "steps of collocation": ({"steps": 2}, "steps: collocation with 2 steps is for shooting"),
    "rk4 without shooting": ({"integrator": "rk4"}, "integrator: rk4 with 1 steps is for shooting"),
}


@pytest.mark.parametrize(("change", "finding"), CONFLICTS.values(), ids=CONFLICTS.keys())
def test_what_does_not_go_together_is_refused(arm: Peer, reach: Problem, change: dict[str, Any], finding: str) -> None:
    with pytest.raises(ValueError, match=finding):
        transcribe(replace(reach, **change), arm)


MESH = (0.2, 0.5, 0.3)
RICH = [
    (Representation.IMPL, Family.RADAU, False),
    (Representation.IMPL, Family.LEGENDRE, True),
    (Representation.SEMI, Family.RADAU, True),
    (Representation.EXP1_O, Family.LEGENDRE, False),
    (Representation.EXP2_O, Family.RADAU, True),
    (Representation.EXP1_A, Family.LEGENDRE, True),
]
MESHES = [(*RICH[i], MESH) for i in (0, 1, 4)]


@pytest.mark.parametrize(("representation", "family", "free", "mesh"), [*((*r, None) for r in RICH), MESHES[2]])
def test_derivatives_of_everything_equal_casadis(
    arm: Peer,
    reach: Problem,
    representation: Representation,
    family: Family,
    free: bool,
    mesh: tuple[float, ...] | None,
) -> None:
    """Gradient, Jacobian and Hessian at a random point, with no more nonzeros than CasADi finds."""
    check_derivatives(replace(rich(reach, representation, family, free), mesh=mesh), arm)


@pytest.mark.parametrize(("family", "free"), [(Family.RADAU, False), (Family.LEGENDRE, True)])
def test_derivatives_of_second_order_equal_casadis(arm: Peer, reach: Problem, family: Family, free: bool) -> None:
    """With a horizon that is free, the integrals of velocities are multiplied by it; at Legendre points, to the end."""
    problem = rich(reach, Representation.EXP1_O, family, free)
    check_derivatives(replace(problem, integrator=SECOND_ORDER, mesh=MESH), arm)


def test_rows_of_second_order_integrate_velocities(arm: Peer, reach: Problem, rng: np.random.Generator) -> None:
    """q_kj - q_k minus the integral of the velocities' polynomial, for a free horizon; at the interval's end too."""
    problem = replace(rich(reach, Representation.IMPL, Family.LEGENDRE, True), integrator=SECOND_ORDER, mesh=MESH)
    transcription = transcribe(problem, arm)
    x = rng.uniform(0.5, 1, transcription.layout.size)
    motion = transcription.unpack(x)
    g = evaluate_rows(transcription, arm, problem, x)
    nodes, h = np.concatenate(([0.0], transcription.scheme.points)), np.diff(motion.t)
    for k in range(3):
        for i in range(6):
            v = np.polynomial.Polynomial.fit(nodes, [motion.qd[k, i], *motion.point_qd[k, :, i]], 2, domain=[]).integ()
            for j, c in enumerate(transcription.scheme.points):
                expected = motion.point_q[k, j, i] - motion.q[k, i] - h[k] * (v(c) - v(0))
                assert g[transcription.rows.states[k, j, i]] == pytest.approx(expected, abs=1e-12)
            expected = motion.q[k + 1, i] - motion.q[k, i] - h[k] * (v(1) - v(0))
            assert g[transcription.rows.continuity[k, i]] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("representation", "family", "free", "fractions"), [*((*r, None) for r in RICH), *MESHES])
def test_everything_means_what_it_says(
    arm: Peer,
    reach: Problem,
    representation: Representation,
    family: Family,
    free: bool,
    fractions: tuple[float, ...] | None,
    rng: np.random.Generator,
) -> None:
    """Terms of the cost and rows of constraints, computed from the trajectory without the program."""
    problem = replace(rich(reach, representation, family, free), mesh=fractions)
    transcription = transcribe(problem, arm)
    rows, scheme, N = transcription.rows, transcription.scheme, problem.intervals
    x = rng.uniform(0.5, 1, transcription.layout.size)
    motion = transcription.unpack(x)
    T = motion.t[-1]
    assert (x[-1] if free else problem.horizon) == T
    q, qd, u = motion.point_q, motion.point_qd, np.repeat(motion.u[:, None], problem.degree, axis=1)
    hand, last_hand = (arm("sensors", q=a.reshape(-1, 6))["position"][:, :, 0] for a in (q, motion.q))
    last = {"q": motion.q[-1], "qd": motion.qd[-1]}
    if representation.is_ode:
        qdd = arm("exp1", q=q.reshape(-1, 6), qd=qd.reshape(-1, 6), u=u.reshape(-1, 4))["qdd"].reshape(q.shape)
        end_qdd = arm("exp1", **last, u=motion.u[-1])["qdd"]
        start_qdd = arm("exp1", q=motion.q[0], qd=motion.qd[0], u=motion.u[0])["qdd"]
    else:
        qdd = motion.point_qdd
        end_qdd, start_qdd = scheme.end_of_points @ qdd[-1], scheme.start_of_points @ qdd[0]
    h = np.diff(motion.t)
    assert h == pytest.approx(T * np.array(fractions or [1 / N] * N), rel=1e-14)
    apart = (h[1:] + h[:-1]) / 2

    def integral(values: np.ndarray) -> float:
        return float(h @ (values.reshape(N, -1) @ scheme.weights))

    costs = evaluate_terms(transcription, arm, problem, x)
    assert costs == pytest.approx(
        [
            3.0 * float(h @ (motion.u**2).sum(axis=1)),
            0.5 * float((np.diff(motion.u, axis=0) ** 2).sum(axis=1) @ (1 / apart)),
            2.0 * integral((q[..., 1] - 0.3) ** 2 + u[..., 0] * qd[..., 0]),
            0.25 * integral(motion.point_t * np.sin(q[..., 2]) + T * hand[:, 1].reshape(N, -1)),
            0.125 * T,
            0.125 * T,
            4.0 * (T**2 + last_hand[-1, 2] * motion.q[-1, 4]),
            0.1 * end_qdd[1] ** 2,
        ],
        rel=1e-12,
    )
    p = transcription.parameters(problem)
    functions = build(transcription.program, arm)
    assert float(functions.objective(x, p)) == pytest.approx(sum(costs), rel=1e-12)
    g = functions.constraint(x, p).full().ravel()
    close = {"rel": 1e-9, "abs": 1e-9}
    path = hand[:, 0] ** 2 - 0.7 * motion.point_t.ravel()
    mesh = last_hand[:, 0] ** 2 - 0.7 * motion.t
    after = mesh if family is Family.LEGENDRE else mesh[:1]
    assert g[rows.constraints[0]] == pytest.approx(np.concatenate((path, after)), **close)
    assert g[rows.constraints[1]] == pytest.approx((qdd[..., 0] - u[..., 0]).ravel(), **close)
    assert g[rows.constraints[2]] == pytest.approx([start_qdd[2] + motion.q[0, 0]], **close)
    v = arm("motion", **last)["v"]
    assert g[rows.constraints[3]] == pytest.approx([v[0, 0] - 0.3 * T], **close)
    assert g[rows.sensor_velocities[0]] == pytest.approx(v[:, 1], **close)
    assert g[rows.velocities] == pytest.approx(motion.qd[-1, [1, 2]], **close)
    assert g[rows.accelerations] == pytest.approx(end_qdd[[0, 5]], **close)


def test_bounds_of_everything(arm: Peer, reach: Problem) -> None:
    """A free horizon and a free start keep to their ranges, constraints to theirs."""
    problem = rich(reach, Representation.IMPL, Family.RADAU, True)
    transcription = transcribe(problem, arm)
    rows, layout = transcription.rows, transcription.layout
    lower, upper = transcription.variable_bounds(problem)
    assert (lower[layout.horizon], upper[layout.horizon]) == (1.0, 3.0)
    lower, upper = transcription.constraint_bounds(problem)
    assert np.isneginf(lower[rows.start[[1, 8]]]).all()
    assert np.isposinf(upper[rows.start[[1, 8]]]).all()
    assert (
        list(lower[rows.start[[0, 2]]]) == list(upper[rows.start[[0, 2]]]) == [problem.start_q[0], problem.start_q[2]]
    )
    assert set(zip(lower[rows.constraints[0]], upper[rows.constraints[0]], strict=True)) == {(-1.0, 2.0)}
    assert set(upper[rows.constraints[3]]) == {np.inf}
    assert list(lower[rows.velocities]) == list(upper[rows.velocities]) == [0.5, -0.5]
    assert list(lower[rows.sensor_velocities[0]]) == [0.1, 0.0, -0.1]


def test_constants_are_parameters(arm: Peer, reach: Problem, rng: np.random.Generator) -> None:
    """Constants, weights and ranges belong to a solve; a program knows only what is asked for."""
    problem = rich(reach, Representation.EXP1_A, Family.RADAU, True)
    other = replace(
        problem,
        constants=(("a", 1.0), ("b", 0.0)),
        horizon=1.5,
        horizon_range=(1.2, 2.0),
        constraints=tuple(replace(c, range=(0.0, 0.0)) for c in problem.constraints),
        cost=replace(problem.cost, inputs=0.0, running=tuple(replace(t, weight=0.0) for t in problem.cost.running)),
    )
    assert structure(other) == structure(problem)
    assert structure(replace(problem, horizon_range=None)) != structure(problem)
    assert structure(replace(problem, constraints=problem.constraints[1:])) != structure(problem)
    transcription = transcribe(problem, arm)
    x = rng.uniform(0.5, 1, transcription.layout.size)
    functions = build(transcription.program, arm)
    f, g = functions.objective, functions.constraint
    first, second = (transcription.parameters(p) for p in (problem, other))
    difference = (g(x, second) - g(x, first)).full().ravel()
    t = transcription.unpack(x).point_t.ravel()
    assert difference[transcription.rows.constraints[0]][: t.size] == pytest.approx(0.7 * t, abs=1e-12)
    assert float(f(x, second)) != float(f(x, first))


VARIANTS = [
    *((Representation.IMPL, *scheme) for scheme in SCHEMES),
    *((r, Family.LEGENDRE, 3) for r in Representation if r is not Representation.IMPL),
]


@pytest.mark.parametrize(("representation", "family", "degree"), VARIANTS)
def test_derivatives_equal_casadis_of_the_same_program(
    arm: Peer, reach: Problem, representation: Representation, family: Family, degree: int, rng: np.random.Generator
) -> None:
    """nlpsol's own functions, made by differentiating the map, have the same pattern, and values to rounding.

    Rounding is multiplied by the condition of M where it is solved with, some 1e4 for the arm.
    """
    rounding = 1e-10 if representation.is_explicit else 1e-14
    problem = replace(small(reach, family, degree), representation=representation)
    transcription = transcribe(problem, arm)
    program = build(transcription.program, arm)
    x, p = ca.MX.sym("x", program.variables), ca.MX.sym("p", 2)
    nlp = {"x": x, "p": p, "f": program.objective(x, p), "g": program.constraint(x, p)}
    whole = ca.nlpsol("whole", "ipopt", nlp, {"ipopt.print_level": 0})
    at = rng.uniform(-1, 1, program.variables), transcription.parameters(problem)
    multipliers = (0.7, rng.uniform(-1, 1, program.constraints))
    for name, ours, arguments in (
        ("nlp_grad_f", program.gradient, at),
        ("nlp_jac_g", program.jacobian, at),
        ("nlp_hess_l", program.hessian, (*at, *multipliers)),
    ):
        theirs = whole.get_function(name)
        expected, found = (f.call([ca.DM(a) for a in arguments])[-1] for f in (theirs, ours))
        assert found.sparsity() == expected.sparsity(), name
        scale = np.abs(expected.full()).max()
        assert np.abs((found - expected).full()).max() <= rounding * scale, name


@pytest.mark.parametrize(("family", "degree"), SCHEMES)
def test_polynomials_of_its_degree_meet_the_collocation(
    arm: Peer, reach: Problem, family: Family, degree: int, rng: np.random.Generator
) -> None:
    """q of degree d with its derivatives: states and continuity hold; rows at the end show what they ask."""
    problem = small(reach, family, degree)
    transcription = transcribe(problem, arm)
    motion, acceleration = polynomial_motion(problem, transcription, rng)
    rows = transcription.rows
    g = evaluate_rows(transcription, arm, problem, transcription.pack(motion))
    small_enough = 1e-12
    assert np.abs(g[rows.states]).max() < small_enough
    assert np.abs(g[rows.continuity]).max() < small_enough
    assert g[rows.start] == pytest.approx(np.concatenate((motion.q[0], motion.qd[0])), abs=small_enough)
    assert g[rows.velocity] == pytest.approx(motion.qd[-1], abs=small_enough)
    if family is Family.LEGENDRE or degree == 3:  # Radau's z(T) is z at T; degree 1 has no acceleration
        assert g[rows.acceleration] == pytest.approx(acceleration, abs=1e-10)
    hand = arm("sensors", q=motion.q[-1])["position"][:, 0]
    assert g[rows.sensors[0]] == pytest.approx(hand, abs=small_enough)


def test_dynamics_hold_at_every_collocation_point(arm: Peer, reach: Problem, rng: np.random.Generator) -> None:
    """The rows of the dynamics are the residual at the points, each with the inputs of its interval."""
    problem = small(reach, Family.RADAU, 4)
    transcription = transcribe(problem, arm)
    motion, _ = polynomial_motion(problem, transcription, rng)
    g = evaluate_rows(transcription, arm, problem, transcription.pack(motion))
    for k in range(problem.intervals):
        for j in range(problem.degree):
            q, qd, qdd = motion.point_q[k, j], motion.point_qd[k, j], motion.point_qdd[k, j]
            Phi = arm("impl", q=q, qd=qd, qdd=qdd, u=motion.u[k])["Phi"]
            assert g[transcription.rows.dynamics[k, j]] == pytest.approx(Phi, rel=1e-14, abs=1e-14)


def test_every_variable_and_every_row_has_one_place(arm: Peer, reach: Problem) -> None:
    transcription = transcribe(small(reach, Family.RADAU, 2), arm)
    layout, rows = transcription.layout, transcription.rows
    variables = (layout.mesh, layout.points, layout.accelerations, layout.inputs)
    assert sorted(np.concatenate([v.ravel() for v in variables])) == list(range(layout.size))
    parts = (rows.start, rows.states, rows.dynamics, rows.continuity, rows.sensors, rows.velocity, rows.acceleration)
    assert sorted(np.concatenate([r.ravel() for r in parts])) == list(range(rows.size))


def test_a_trajectory_survives_packing(arm: Peer, reach: Problem, rng: np.random.Generator) -> None:
    transcription = transcribe(small(reach, Family.LEGENDRE, 3), arm)
    x = rng.uniform(-1, 1, transcription.layout.size)
    assert np.array_equal(transcription.pack(transcription.unpack(x)), x)


def test_cost_is_the_stated_one(arm: Peer, reach: Problem, rng: np.random.Generator) -> None:
    """f = h sum k1 |u_k|^2 + h sum over N - 1 differences of k2 |(u_(k+1) - u_k) / h|^2, at random inputs."""
    problem = replace(small(reach, Family.RADAU, 2), cost=Cost(3.0, 0.5))
    transcription = transcribe(problem, arm)
    x = rng.uniform(-1, 1, transcription.layout.size)
    u, h = transcription.unpack(x).u, problem.horizon / problem.intervals
    rates = (u[1:] - u[:-1]) / h
    expected = 3.0 * h * (u**2).sum() + 0.5 * h * (rates**2).sum()
    functions = build(transcription.program, arm)
    assert float(functions.objective(x, transcription.parameters(problem))) == pytest.approx(expected, rel=1e-14)


def test_bounds_hold_at_mesh_and_collocation_points(arm: Peer, reach: Problem) -> None:
    """Bounds of coordinates and velocities at all N (d + 1) + 1 points where they are unknown, of inputs everywhere."""
    free = (-np.inf, np.inf)
    bounds = Bounds(reach.bounds.q, ((-7.0, 8.0), *(free,) * 5), ((-1.0, 2.0), *(free,) * 3))
    problem = replace(small(reach, Family.RADAU, 4), bounds=bounds)
    transcription = transcribe(problem, arm)
    lower, upper = (transcription.unpack(x) for x in transcription.variable_bounds(problem))
    assert np.isneginf(lower.q[0]).all()
    assert np.isposinf(upper.qd[[0, -1]]).all()
    assert np.isposinf(upper.point_qd[-1, -1]).all()
    for q_lower, q_upper in ((lower.q[1:], upper.q[1:]), (lower.point_q, upper.point_q)):
        assert (q_lower == np.array(reach.bounds.q)[:, 0]).all()
        assert (q_upper == np.array(reach.bounds.q)[:, 1]).all()
    assert (lower.point_qd.reshape(-1, 6)[:-1, 0] == -7).all()
    assert (upper.qd[1:-1, 0] == 8).all()
    assert (lower.u[:, 0] == -1).all()
    assert (upper.u[:, 0] == 2).all()
    assert np.isneginf(lower.point_qdd).all()
    assert np.isposinf(upper.u[:, 1:]).all()


def test_given_values_beyond_their_bounds_keep_these(arm: Peer, reach: Problem) -> None:
    """So a start or an end that contradicts a bound is a contradiction for the solver, too."""
    start = (reach.bounds.q[0][1] + 0.1, *reach.start_q[1:])
    problem = replace(small(reach, Family.RADAU, 4), start_q=start)
    transcription = transcribe(problem, arm)
    lower, upper = (transcription.unpack(x) for x in transcription.variable_bounds(problem))
    assert (lower.q[0, 0], upper.q[0, 0]) == reach.bounds.q[0]
    assert np.isposinf(upper.q[0, 1:]).all()


def test_values_alone_do_not_shape_the_program(reach: Problem) -> None:
    """Start, targets, bounds and weights belong to a solve; the horizon and what is asked for to the program."""
    moved = replace(reach.with_target("hand", (0.0, -0.6, 0.1)), cost=Cost(1.0, 0.0), start_qd=(0.1,) * 6)
    assert structure(moved) == structure(reach)
    assert structure(replace(reach, horizon=3.0)) != structure(reach)
    assert structure(replace(reach, end=replace(reach.end, acceleration_zero=False))) != structure(reach)


def test_ends_in_coordinates(arm: Peer, reach: Problem, rng: np.random.Generator) -> None:
    """A coordinate asked for at the end is a row that shows it."""
    end = End(coordinates=((0, 0.25), (4, -0.5)))
    problem = replace(small(reach, Family.RADAU, 2), end=end)
    transcription = transcribe(problem, arm)
    motion, _ = polynomial_motion(problem, transcription, rng)
    g = evaluate_rows(transcription, arm, problem, transcription.pack(motion))
    assert g[transcription.rows.coordinates] == pytest.approx(motion.q[-1, [0, 4]], abs=1e-14)
    assert list(transcription.constraint_bounds(problem)[0][transcription.rows.coordinates]) == [0.25, -0.5]
    assert transcription.rows.velocity.size == transcription.rows.sensors.size == 0


def test_a_system_without_sensors_at_the_end_has_no_sensor_block() -> None:
    free = ((-np.inf, np.inf),)
    problem = Problem("rest", 1.0, 4, Family.RADAU, 2, Cost(1.0, 0.0), (0.0,), (0.0,), Bounds(free, free, free), End())
    transcription = transcribe(problem, double_integrator())
    assert len(transcription.program.blocks) == 1


def test_accelerations_at_the_end_keep_their_order(arm: Peer, reach: Problem) -> None:
    """All joints have a condition, named from the last to the first: an ODE reads them off its kernel."""
    wanted = tuple((i, float(i)) for i in reversed(range(6)))
    problem = replace(
        small(reach, Family.RADAU, 2), representation=Representation.EXP1_O, end=End(accelerations=wanted)
    )
    transcription = transcribe(problem, arm)
    x = np.random.default_rng(0).uniform(0.5, 1, transcription.program.variables)
    found = evaluate_rows(transcription, arm, problem, x)[transcription.rows.accelerations]
    q, qd = transcription.layout.split(x[transcription.layout.mesh[-1]])
    qdd = arm("exp1", q=q, qd=qd, u=x[transcription.layout.inputs[-1]])["qdd"]
    assert found == pytest.approx(qdd[::-1], rel=1e-12)
