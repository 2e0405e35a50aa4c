"""Proofs of optima: minima by hand are proved, other points are not, and a stored point is proved again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from flint import arb

from benchmarks.proofs.__main__ import POINTS, PROBLEMS, RECORD, Row, check_row, read_record, record, write_page
from benchmarks.proofs.intervals import Instructions, UnknownOperationError
from benchmarks.proofs.monotone import find_monotone
from benchmarks.proofs.programs import drop_implied, find_point, write_program
from benchmarks.proofs.proof import Nonlinear, Point, Proof, Rest, System, approach, enclose_cost, level, prove, settle
from benchmarks.proofs.rest import balance, drop_limits, find_rest
from benchmarks.proofs.steps import Matrix, bound_curvature, find_steps
from benchmarks.proofs.vertices import Release, choose_release, find_dependence
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solving.solve import Solver

X = ca.SX.sym("x", 3)
NONE = np.full(3, np.inf)


def state(cost: ca.SX, row: ca.SX, lower: list[float]) -> Nonlinear:
    """State a problem of three variables with one equation and lower bounds."""
    functions = (ca.Function("f", [X], [cost]), ca.Function("g", [X], [row]))
    return Nonlinear(*functions, np.array(lower), NONE, np.zeros(1), np.zeros(1))


def test_a_bounded_minimum_is_proved_and_its_cost_enclosed() -> None:
    """Least distance from (0, 0, -1) on the sphere's cap x'x = 2, z >= 1, x >= 1/2: cost x^2 + y^2 + (z + 1)^2 = 5."""
    program = state(ca.sumsqr(X) + 2 * X[2] + 1 + 0.1 * (X[1] - 1) ** 2, ca.sumsqr(X) - 2, [0.5, -np.inf, 1.0])
    system = System(program)
    point = settle(system, find_point(program, np.array([0.6, 0.9, 1.1])))
    assert point.held.tolist() == [-1, 0, -1]
    near = approach(system, point.x + np.array([1e-7, 1e-7, 1e-7]))
    assert near is not None
    assert near.held.tolist() == [-1, 0, -1]
    assert np.abs(near.x - point.x).max() < 1e-14
    proof = prove(system, point)
    assert proof.reason == ""
    assert proof.radius < 1e-8
    low, high = enclose_cost(system, point, proof.radius)
    y = np.sqrt(0.75)
    assert low <= 5 + 0.1 * (y - 1) ** 2 <= high < low + 1e-10


def test_a_saddle_and_a_point_beside_are_not_proved() -> None:
    """x y on x + y + z = 0 at 0: a zero of the conditions that is no minimum. Beside a minimum there is no zero."""
    free = [-np.inf] * 3
    saddle = System(state(X[0] * X[1] + X[2] ** 2 / 10, ca.sum(X), free))
    signs = (np.zeros(3, dtype=np.int8), np.ones(1, dtype=np.int8))
    found = prove(saddle, Point(np.zeros(3), np.zeros(1), *signs))
    assert found.reason == "the second-order condition was not proved"
    assert found.contraction < 1
    bowl = System(state(ca.sumsqr(X), ca.sum(X), free))
    assert "Krawczyk's test fails" in prove(bowl, Point(np.full(3, 1e-3), np.zeros(1), *signs)).reason
    assert prove(bowl, Point(np.zeros(3), np.zeros(1), *signs)).reason == ""


def test_a_bound_without_a_multiplier_is_not_strictly_complementary() -> None:
    """x^2 + y^2 + z^2 with x >= 0: at 0 the bound holds x, and needs no force."""
    system = System(state(ca.sumsqr(X), ca.sum(X[1:]), [0.0, -np.inf, -np.inf]))
    held, rows = np.array([-1, 0, 0], dtype=np.int8), np.ones(1, dtype=np.int8)
    assert "no strict complementarity" in prove(system, Point(np.zeros(3), np.zeros(1), held, rows)).reason


def test_balls_hold_the_values_and_kinks_are_refused() -> None:
    function = ca.Function("f", [X], [ca.vertcat(ca.sin(X[0]) / X[1], ca.sqrt(X[2]) ** 3)])
    balls = Instructions.of(function).evaluate([[arb(x, 1e-3) for x in (0.3, 1.7, 2.2)]])[0]
    for shift in (-9e-4, 0.0, 9e-4):
        values = function(np.array([0.3, 1.7, 2.2]) + shift).full().ravel()
        assert all(ball.contains(arb(value)) for ball, value in zip(balls, values.tolist(), strict=True))
    with pytest.raises(UnknownOperationError):
        Instructions.of(ca.Function("f", [X], [ca.fabs(X[0])]))


def test_whole_powers_of_balls_around_zero_are_numbers() -> None:
    """Arb's own power of such a ball is none."""
    function = ca.Function("f", [X], [ca.vertcat(X[0] ** 2, X[1] ** 3, X[2] ** -2)])
    squared, cubed, inverse = Instructions.of(function).evaluate([[arb(0, 1e-3), arb(0, 1e-3), arb(2, 1e-3)]])[0]
    for ball, value in ((squared, 1e-6), (cubed, -1e-9), (inverse, 0.25)):
        assert ball.is_finite()
        assert ball.contains(arb(value))


def test_curvature_of_permitted_steps_is_bounded_from_below() -> None:
    """d'Hd = 2 x^2 + 3 y^2 - z^2 with z = x / 2: the least for |d| = 1 is 1.75 / 1.25, in the direction of x and z."""
    H, A = Matrix(np.diag([2.0, 3.0, -1.0])), Matrix(np.array([[0.5, 0.0, -1.0]]))
    steps = find_steps(H, A)
    assert steps is not None
    exact = 1.75 / 1.25
    assert exact / 3 < bound_curvature(H, steps, np.full(3, 1e-12)) <= exact
    assert bound_curvature(H, steps, np.full(3, 1.0)) == 0
    assert find_steps(Matrix(np.diag([2.0, 3.0, -9.0])), A) is None


def test_a_minimum_whose_hessian_is_hidden_by_rounding_is_proved() -> None:
    """Of 1e-9 y^2 on 1e6 (x + z) = 1e12 y, in units in which H + w A'A has no digits of H."""
    free = [-np.inf] * 3
    program = state(1e-9 * X[1] ** 2 + ca.sumsqr(X[::2]), 1e6 * (X[0] + X[2] - 1e6 * X[1]), free)
    point = Point(np.zeros(3), np.zeros(1), np.zeros(3, dtype=np.int8), np.ones(1, dtype=np.int8))
    assert prove(System(program), point).reason == ""


@pytest.mark.parametrize(("row", "reason"), [(X[0] - X[1], ""), (X[2] - X[1], "the rest in the last interval")])
def test_a_rest_is_proved_where_its_rows_give_it(row: ca.SX, reason: str) -> None:
    """x is the same number as y by the row x = y, and by no other."""
    numbers = (np.array([k]) for k in (0, 1, 0))
    program = replace(state(ca.sumsqr(X), row, [-np.inf] * 3), rest=Rest(*numbers))
    point = level(program, Point(np.array([1e-14, 0.0, 0.0]), np.zeros(1), np.zeros(3, np.int8), np.ones(1, np.int8)))
    assert point.x[0] == 0
    assert prove(System(program), point).reason.startswith(reason)


def test_limits_in_a_last_interval_at_rest_are_dropped() -> None:
    """The arm's coordinates are bounded at its end, and not at other nodes of the last interval."""
    problem, plant = PROBLEMS["arm_lower_corner_smooth"].read()
    solver = Solver(problem, plant)
    data, layout = solver.program.data, solver.transcription.layout
    assert find_rest(problem, data, layout) is None  # a constant has a derivative of some 1e-15
    balanced = replace(data, A=balance(data.A, layout))
    assert abs(balanced.A - data.A).max() < 1e-14
    rest = find_rest(problem, balanced, layout)
    assert rest is not None
    assert len(rest.rows) == len(rest.variables) == 12 + 12 + 3 * 18
    moving = replace(problem, end=replace(problem.end, acceleration_zero=False))
    assert find_rest(moving, balanced, layout) is None
    bounds = solver.transcription.variable_bounds(problem)
    none = ca.Function("none", [ca.SX.sym("x")], [0])
    upper = drop_limits(Nonlinear(none, none, *bounds, np.zeros(0), np.zeros(0)), rest).upper
    assert np.isinf(upper[layout.points[-1, :-1, 5]]).all()
    assert np.isfinite(upper[layout.points[-1, -1, 5]])
    assert np.isfinite(upper[layout.points[-2, :-1, 5]]).all()


def test_a_bound_that_an_equation_implies_is_dropped() -> None:
    program = state(ca.sumsqr(X), X[0] - X[1], [0.5, 0.5, 0.5])
    assert drop_implied(program).lower.tolist().count(-np.inf) == 1


def test_a_stored_point_is_proved_again() -> None:
    """The quickest of the classics, from its file."""
    row = check_row("brachistochrone", POINTS / "brachistochrone.npz")
    assert row.proof.reason == ""
    assert row.proof.radius <= 1e-8


def test_the_page_lists_proofs_and_reasons() -> None:
    proved, failed = Proof(1e-13, 1e-8, np.inf, 0.1, 1e-4), Proof(1e-9, 2.0, 0.0, 0.0, 0.0, "a reason")
    page = write_page([Row("a_b", 10, proved, 2.5, 1e-9), Row("c", 0, failed, np.nan, np.nan)])
    assert "1 of 2 problems are proved." in page
    assert "| a b | 10 | 1e-13 | no bounds | 1e-04 | 2.5 | 1e-09 |" in page
    assert "- c: a reason" in page


def test_a_new_row_replaces_its_old_one(tmp_path: Path) -> None:
    """Rows of other problems keep their figures, to the last digit, and infinite ones."""
    proof = Proof(1e-13, 1 / 3, np.inf, 0.1, 1e-4)
    old, other = Row("rayleigh", 10, proof, 2.5, 0.125), Row("alp_rider", 3, proof, 1.5, 1e-9)
    assert record([old, other], tmp_path / "rows.json") == [other, old]
    assert record([replace(old, cost=3.5)], tmp_path / "rows.json") == [other, replace(old, cost=3.5)]


def test_the_page_has_the_recorded_rows() -> None:
    assert write_page(read_record(RECORD)) == (POINTS.parent / "proofs.md").read_text("utf-8")


def test_points_belong_to_problems() -> None:
    stored = {path.stem for path in POINTS.glob("*.npz")}
    assert "brachistochrone" in stored
    assert stored <= set(PROBLEMS)


def test_a_dependence_of_rows_is_found() -> None:
    """The third row is the sum of the others, apart from its length; two rows alone are independent."""
    A = Matrix(np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0], [10.0, 30.0, 30.0]]))
    y = find_dependence(A)
    assert y is not None
    assert np.allclose(y / y[2], [-10, -10, 1])
    assert find_dependence(Matrix(A[:2])) is None
    assert find_dependence(Matrix(np.zeros((1, 2)))) is not None


def test_the_bound_whose_multiplier_vanishes_first_is_released() -> None:
    """Multipliers 3 and 2 fall at the rates 1 and 1; in the other direction, the one of 1 blocks at once."""
    signs, multipliers = np.array([1, -1, 1, 0], dtype=np.int8), np.array([3.0, -2.0, 1.0, 9.0])
    release = choose_release(signs, multipliers, np.array([-1.0, 1.0, 1.0, -50.0]))
    assert release == Release(1, 2.0)
    assert choose_release(signs, multipliers, np.array([0.0, 0.0, 0.0, 1.0])) is None


def test_a_corner_with_a_bound_too_many_is_proved() -> None:
    """Least x + y with x + y + z = 1, x >= 0, y >= 1e-9, z <= 1 - 1e-9: three bounds hold two numbers."""
    program = state(X[0] + X[1], ca.sum(X) - 1, [0.0, 1e-9, -np.inf])
    program = replace(program, upper=np.array([np.inf, np.inf, 1 - 1e-9]))
    system = System(program)
    held, rows = np.array([-1, -1, 1], dtype=np.int8), np.ones(1, dtype=np.int8)
    point = settle(system, Point(np.array([0.0, 1e-9, 1 - 1e-9]), np.array([-1.0]), held, rows))
    assert np.count_nonzero(point.held) == 2
    assert point.x.sum() == 1


def test_limits_between_the_ends_of_a_state_that_only_falls_are_dropped() -> None:
    """The rocket burns fuel from 1 to 0.6. With a thrust of both signs, or an end that is free, limits stay."""
    problem, plant = PROBLEMS["goddard_rocket"].read()
    for changed, count in ((problem, 1), (_turn(problem), 0), (_loosen(problem), 0)):
        solver = Solver(changed, plant)
        data = solver.program.data
        even = write_program(changed, solver, replace(data, A=balance(data.A, solver.transcription.layout)))
        found = list(find_monotone(even, solver.transcription, data))
        assert len(found) == count
        assert not list(find_monotone(write_program(changed, solver, data), solver.transcription, data))
    mass = solver.transcription.layout.extras.point_states[:, :, 2]
    assert np.isfinite(even.lower[mass]).all()


def _turn(problem: Problem) -> Problem:
    """Permit a thrust of both signs."""
    (thrust,) = problem.controls
    return replace(problem, controls=(replace(thrust, bounds=(-1.0, 3.5)),))


def _loosen(problem: Problem) -> Problem:
    """Free the mass at the end."""
    *others, mass = problem.states
    return replace(problem, states=(*others, replace(mass, end=(-np.inf, np.inf))))
