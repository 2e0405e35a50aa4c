"""Check the conditions of optimality at a point of a program, first order and second, independent of the solver.

    minimise f(x) such that g(x) = 0 in some rows, between bounds in others, and x between bounds

The point comes with no multipliers: they are the least-squares solution of the first-order conditions

    grad f + J' lam - E z = 0,  z >= 0,

with J of the equations, and one column of E for each bound that is near (Nocedal, Wright, "Numerical optimization",
theorems 12.1 and 12.6). A projection on the null space of J leaves a small problem of nonnegative least squares. The
second-order condition asks for d' H d > 0 for all d with J d = 0 that keep the bounds with z > 0, H the Hessian of the
Lagrangian. With these bounds among the equations A, it holds if H + rho A' A is positive definite (Debreu, 1952), which
the signs of the pivots of a factorisation show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solving.answers import measure_excess
from mbsrun.ocp.solving.solve import Solver

NEAR = 1e-6  # distance from a bound within which the bound may have a multiplier
STRONG = 1e-6  # multipliers from which on a bound counts as an equation, by the cost's largest weight
PENALTY = 1e8  # rho
SHIFT = 1e-13  # on the diagonal of dependent equations


@dataclass(frozen=True, eq=False)
class Point:
    """A point of a program: its derivatives, and the distances to its bounds."""

    gradient: Array
    equations: Matrix  # J: rows of equations
    bounds: Matrix  # one row for each near bound: the gradient of the distance to it
    distances: Array  # to these bounds; negative: beyond
    violation: float  # of equations and bounds, the largest


@dataclass(frozen=True)
class Certificate:
    """The conditions of optimality at a point; the cost is divided by its largest weight."""

    stationarity: float  # the largest entry of grad f + J' lam - E z
    gradient: float  # the largest entry of grad f, to compare with
    violation: float
    complementarity: float  # the largest product of a multiplier and the distance to its bound
    active: int  # bounds with a multiplier
    is_minimum: bool  # the second-order condition holds


def certify(point: Point, hessian: Callable[[Array, Array], Matrix]) -> Certificate:
    """Check a point; `hessian` returns the whole Hessian of the Lagrangian for the multipliers lam and z."""
    lam, z = find_multipliers(point)
    rest = point.gradient + point.equations.T @ lam - point.bounds.T @ z
    chosen = z > STRONG
    held = Matrix(sparse.vstack([point.equations, point.bounds[chosen]]))
    return Certificate(
        stationarity=float(np.abs(rest).max(initial=0.0)),
        gradient=float(np.abs(point.gradient).max(initial=0.0)),
        violation=point.violation,
        complementarity=float(np.abs(z * point.distances).max(initial=0.0)),
        active=int(chosen.sum()),
        is_minimum=is_convex_on(hessian(lam, z), held),
    )


def find_multipliers(point: Point) -> tuple[Array, Array]:
    """Return the multipliers lam and z >= 0 that leave the least of the first-order conditions."""
    from scipy.optimize import nnls  # here, and late: it takes long to load
    from scipy.sparse.linalg import splu

    size, rows = point.gradient.size, point.equations.shape[0]
    bordered = [[sparse.eye_array(size), point.equations.T], [point.equations, -SHIFT * sparse.eye_array(rows)]]
    known = np.zeros((size + rows, 1 + point.bounds.shape[0]))
    known[:size, 0] = point.gradient
    known[:size, 1:] = point.bounds.T.toarray()
    parts: Array = np.asarray(splu(Matrix(sparse.block_array(bordered))).solve(known))
    triangle: Array = np.asarray(np.linalg.qr(parts[:size], mode="r"))
    z: Array = nnls(triangle[:, 1:], triangle[:, 0])[0] if point.bounds.shape[0] else np.zeros(0)
    return parts[size:, 1:] @ z - parts[size:, 0], z


def is_convex_on(hessian: Matrix, equations: Matrix) -> bool:
    """Return whether d' H d > 0 for all d with A d = 0, except d = 0; False where the factorisation needs pivots."""
    from scipy.sparse.linalg import splu  # here, and late: it takes long to load

    penalised = Matrix(hessian + PENALTY * (equations.T @ equations))
    try:
        factors = splu(penalised, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # a pivot is zero
        return False
    return bool(np.array_equal(factors.perm_r, factors.perm_c) and (factors.U.diagonal() > 0).all())


def certify_motion(problem: Problem, solver: Solver, motion: Trajectory) -> Certificate:
    """Check the conditions of optimality of a motion, as a point of the program that `solver` has for the problem."""
    transcription, functions = solver.transcription, solver.program.casadi
    x, p = transcription.pack(motion), transcription.parameters(problem)
    lower, upper = transcription.variable_bounds(problem)
    g_lower, g_upper = transcription.constraint_bounds(problem)
    g, jacobian = functions.constraint(x, p).full().ravel(), Matrix(functions.jacobian(x, p).sparse())
    scale = 1 / max(map(abs, problem.cost.weights))
    is_equation = g_lower == g_upper
    own = _Bounds.find(Matrix(sparse.eye_array(x.size)), x, lower, upper)
    ranged = _Bounds.find(jacobian, g, np.where(is_equation, -np.inf, g_lower), np.where(is_equation, np.inf, g_upper))

    def hessian(lam: Array, z: Array) -> Matrix:
        multipliers = np.zeros(g.size)
        multipliers[is_equation] = lam
        np.subtract.at(multipliers, ranged.rows, ranged.sides * z[own.rows.size :])
        triangle = functions.hessian(x, p, scale, multipliers).sparse()
        return Matrix(triangle + sparse.triu(triangle, 1).T)

    point = Point(
        gradient=scale * functions.gradient(x, p)[1].full().ravel(),
        equations=Matrix(jacobian[is_equation]),
        bounds=Matrix(sparse.vstack([own.gradients, ranged.gradients])),
        distances=np.concatenate([own.distances, ranged.distances]),
        violation=max(measure_excess(g, g_lower, g_upper), measure_excess(x, lower, upper)),
    )
    return certify(point, hessian)


@dataclass(frozen=True, eq=False)
class _Bounds:
    """The bounds of some values that are near: rows, sides (1: lower, -1: upper), distances and their gradients."""

    rows: Indices
    sides: Array
    distances: Array
    gradients: Matrix

    @classmethod
    def find(cls, jacobian: Matrix, values: Array, lower: Array, upper: Array) -> _Bounds:
        below, above = np.flatnonzero(values - lower < NEAR), np.flatnonzero(upper - values < NEAR)
        rows, sides = np.concatenate([below, above]), np.repeat([1.0, -1.0], [below.size, above.size])
        distances = np.concatenate([(values - lower)[below], (upper - values)[above]])
        return cls(rows, sides, distances, Matrix(sparse.diags_array(sides) @ jacobian[rows]))
