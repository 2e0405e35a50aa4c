"""Intervals of unequal length: times, closed forms, re-simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbsrun.ocp.ground.grid import Grid, divide
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Form, Problem, Term
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import FREE_RANGE, pendulum
from tests.mbsrun.peer import double_integrator


def test_equal_lengths_are_no_fractions() -> None:
    """The program of equal intervals is the paper's, however they are given."""
    assert divide(np.full(3, 0.1)) is None
    assert divide(np.array([1.0, 3.0])) == (0.25, 0.75)


@pytest.mark.parametrize("fractions", [None, (0.5, 0.125, 0.375)])
def test_times_of_points(fractions: tuple[float, ...] | None) -> None:
    """Point j of interval k is at t_k + c_j h_k; over the horizon, at that over T."""
    grid, points = Grid(3, fractions), np.array([0.25, 1.0])
    t, point_t = grid.times(6.0, points)
    assert t == pytest.approx([0, 2, 4, 6] if fractions is None else [0, 3, 3.75, 6])
    assert point_t == pytest.approx(t[:-1, None] + np.diff(t)[:, None] * points)
    assert grid.places(points) == pytest.approx(point_t / 6)
    assert grid.lengths(6.0) == pytest.approx(np.diff(t))


@pytest.mark.parametrize("form", [Form.STANDARD, Form.INTEGRAL])
def test_a_switch_on_the_mesh_costs_nothing(form: Form) -> None:
    """A mass of 1 kg from v = 1 to rest 1 m on, |u| <= 4: it accelerates for t_1 = (sqrt(18) - 2) / 8, brakes for
    t_1 + 1/4. Two intervals of these lengths have that optimum; two equal ones cannot.
    """
    first = (np.sqrt(18) - 2) / 8
    T = 2 * first + 0.25
    problem = Problem(
        name="fastest push",
        horizon=1.5 * T if form is Form.STANDARD else T,
        intervals=2,
        family=Family.RADAU,
        degree=2,
        cost=Cost(terminal=(Term("T", 1.0),)) if form is Form.STANDARD else Cost(inputs=1.0),
        start_q=(0.0,),
        start_qd=(1.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((-4.0 - 1e-7, 4.0 + 1e-7),)),
        end=End(coordinates=((0, 1.0),), velocity_zero=True),
        form=form,
        horizon_range=(0.1, 10.0) if form is Form.STANDARD else None,
        mesh=(first / T, 1 - first / T),
    )
    solution = solve(problem, double_integrator())
    assert isinstance(solution, Solution)
    assert solution.trajectory.t == pytest.approx([0, first, T], abs=1e-6)
    assert solution.trajectory.u[:, 0] == pytest.approx([4.0, -4.0], abs=1e-5)
    if form is Form.STANDARD:
        equal = solve(replace(problem, mesh=None), double_integrator())
        assert isinstance(equal, Solution)
        assert equal.cost.total > solution.cost.total + 1e-3


def test_a_swing_on_a_graded_mesh_is_integrated() -> None:
    """Against DOP853; the defect is found in the longest interval, and is the one of a single interval."""
    motion = solve_ivp(lambda _, y: [y[1], 0.5 - np.sin(y[0])], (0, 2), [1.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13)
    problem = Problem(
        name="swing",
        horizon=2.0,
        intervals=5,
        family=Family.RADAU,
        degree=4,
        cost=Cost(1.0),
        start_q=(1.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((0.5, 0.5),)),
        end=End(),
        mesh=(0.1, 0.15, 0.25, 0.3, 0.2),
    )
    solution = solve(problem, pendulum())
    assert isinstance(solution, Solution)
    checked = resimulate(solution, pendulum()).resimulation
    assert checked is not None
    assert checked.defect is not None
    trajectory = solution.trajectory
    error = np.abs([trajectory.q[-1, 0], trajectory.qd[-1, 0]] - motion.y[:, -1]).max()
    assert error < 1e-6
    assert checked.defect_interval == 3
    assert checked.open_loop_error == pytest.approx(error, rel=1e-3)
    begin = [trajectory.q[3, 0], trajectory.qd[3, 0]]
    own = solve_ivp(lambda _, y: [y[1], 0.5 - np.sin(y[0])], (0, 0.6), begin, "DOP853", rtol=1e-13, atol=1e-13)
    ends = np.abs(own.y[:, -1] - [trajectory.q[4, 0], trajectory.qd[4, 0]]).max()
    assert checked.defect == pytest.approx(ends, rel=1e-3)
