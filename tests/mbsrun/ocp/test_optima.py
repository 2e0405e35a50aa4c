"""Problems with optima in closed form, and orders of convergence: free horizons, path constraints, all schemes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Bounds, Constraint, Cost, End, Problem, Representation, Term
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import FREE_RANGE, mechanism, pendulum
from tests.mbsrun.peer import Peer, double_integrator

G = 9.81
FASTEST = Cost(terminal=(Term("T", 1.0),))


def bead() -> Peer:
    """A bead of 1 kg in a vertical plane, under two forces."""
    q, qd, qdd, u = symbols = tuple(ca.SX.sym(name, 2) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("x", "z"), qdd - u + ca.vertcat(0, G) + 0 * (q + qd), symbols)


def optimum(problem: Problem, plant: Peer) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    return outcome


@pytest.mark.parametrize(
    ("representation", "integrator"),
    [(Representation.IMPL, "collocation"), (Representation.EXP1_O, "collocation"), (Representation.IMPL, SECOND_ORDER)],
)
def test_fastest_push_is_full_force_both_ways(representation: Representation, integrator: str) -> None:
    """A mass of 1 kg over 1 m from rest to rest under |u| <= 4: T = 2 sqrt(1/4), by full force, switched half way.

    With an even number of intervals the switch falls on the grid, and the optimum is free of discretisation.
    """
    problem = Problem(
        name="fastest push",
        horizon=2.0,
        intervals=10,
        family=Family.RADAU,
        degree=2,
        cost=FASTEST,
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((-4.0, 4.0),)),
        end=End(coordinates=((0, 1.0),), velocity_zero=True),
        representation=representation,
        integrator=integrator,
        horizon_range=(0.1, 10.0),
    )
    solution = optimum(problem, double_integrator())
    assert solution.cost.total == pytest.approx(1.0, abs=1e-7)
    assert solution.trajectory.t[-1] == pytest.approx(1.0, abs=1e-7)
    assert solution.trajectory.u[:, 0] == pytest.approx([4.0] * 5 + [-4.0] * 5, abs=1e-5)


def brachistochrone(N: int) -> Problem:
    """From rest at 0 to (1, -1/2), along a wire: its force does no work."""
    free = (FREE_RANGE,) * 2
    return Problem(
        name="brachistochrone",
        horizon=1.0,
        intervals=N,
        family=Family.LEGENDRE,
        degree=1,
        cost=FASTEST,
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds(free, free, free),
        end=End(coordinates=((0, 1.0), (1, -0.5))),
        representation=Representation.EXP1_O,
        horizon_range=(0.1, 3.0),
        constraints=(Constraint("u_x*qd_x + u_z*qd_z", (0.0, 0.0)),),
    )


def test_brachistochrone_is_a_cycloid() -> None:
    """x = R (a - sin a), z = -R (1 - cos a), a = t sqrt(g / R): the time is met with order 2 (implicit midpoint)."""
    end = brentq(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - 2.0, 0.1, 6.0)
    R = 0.5 / (1 - np.cos(end))
    T = end * np.sqrt(R / G)
    errors = []
    for N in (10, 20, 40):
        solution = optimum(brachistochrone(N), bead())
        errors.append(solution.cost.total - T)
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2, 2], abs=0.1)
    a = solution.trajectory.t * np.sqrt(G / R)
    cycloid = np.stack((R * (a - np.sin(a)), -R * (1 - np.cos(a))), axis=1)
    assert np.abs(solution.trajectory.q - cycloid).max() < 1e-3


@pytest.mark.parametrize(("integrator", "order"), [("collocation", 4), (SECOND_ORDER, 5)])
@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_orders_within_intervals(family: Family, integrator: str, order: int) -> None:
    """Coordinates at the points err by h^(d + 1); where they are integrals of velocities, by h^(d + 2)."""
    motion = solve_ivp(
        lambda _, y: [y[1], 0.5 - np.sin(y[0])], (0, 2), [1.0, 0.0], "DOP853", dense_output=True, rtol=1e-13, atol=1e-13
    )
    errors = []
    for N in (8, 16):
        problem = Problem(
            name="swing",
            horizon=2.0,
            intervals=N,
            family=family,
            degree=3,
            cost=Cost(1.0),
            start_q=(1.0,),
            start_qd=(0.0,),
            bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((0.5, 0.5),)),
            end=End(),
            integrator=integrator,
        )
        trajectory = optimum(problem, pendulum()).trajectory
        errors.append(np.abs(trajectory.point_q[:, 0, 0] - motion.sol(trajectory.point_t[:, 0])[0]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


ORDERS = [(Family.RADAU, 1, 1), (Family.RADAU, 2, 3), (Family.RADAU, 3, 5), (Family.LEGENDRE, 1, 2)]
ORDERS += [(Family.LEGENDRE, 2, 4), (Family.LEGENDRE, 3, 6)]


@pytest.mark.parametrize(("family", "degree", "order"), ORDERS)
def test_orders_with_inputs_that_are_given(family: Family, degree: int, order: int) -> None:
    """Error at the end of a pendulum's swing: order 2 d - 1 with Radau points, 2 d with Legendre points."""
    motion = solve_ivp(lambda _, y: [y[1], 0.5 - np.sin(y[0])], (0, 2), [1.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13)
    errors = []
    for N in (8, 16):
        problem = Problem(
            name="swing",
            horizon=2.0,
            intervals=N,
            family=family,
            degree=degree,
            cost=Cost(1.0),
            start_q=(1.0,),
            start_qd=(0.0,),
            bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((0.5, 0.5),)),
            end=End(),
        )
        trajectory = optimum(problem, pendulum()).trajectory
        errors.append(np.linalg.norm([trajectory.q[-1, 0], trajectory.qd[-1, 0]] - motion.y[:, -1]))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


def test_a_running_cost_is_integrated_as_exactly_as_the_scheme_can() -> None:
    """A mass that moves at constant speed: the integral of (q + t)^4, a polynomial of degree 4, by 3 Radau points."""
    problem = Problem(
        name="drift",
        horizon=2.0,
        intervals=2,
        family=Family.RADAU,
        degree=3,
        cost=Cost(running=(Term("(q_slide + t)**4", 1.0),)),
        start_q=(0.0,),
        start_qd=(0.5,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((0.0, 0.0),)),
        end=End(),
    )
    assert optimum(problem, double_integrator()).cost.total == pytest.approx(1.5**4 * 2**5 / 5, rel=1e-9)
