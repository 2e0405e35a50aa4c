"""Derivatives of a problem's program against differences of its values; and all of its backends against each other.

A central difference along a direction, extrapolated from two steps, errs by the step's fourth power: a wrong entry of a
matrix shows in the leading digits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.evaluation.backends.casadi import Functions
from mbsrun.ocp.evaluation.stages.binding import Evaluator, Tables
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solving.solve import Solver
from tests.mbsrun.ocp.stages.stage_functions import compare

Array = NDArray[np.float64]

STEP = 2e-4
SMOOTH = 2e-6  # relative to the sum of magnitudes
ROUNDING = 1e-8  # between backends
AWAY = 0.02  # how far from the motion derivatives are taken
ATTEMPTS = (
    4  # a kink or a pole may lie within a step, but not everywhere; each takes a shorter step, for steep functions
)


def find_wrong_derivatives(
    functions: Functions, p: Array, bounds: tuple[Array, Array], x: Array, rng: np.random.Generator
) -> list[str]:
    """Compare derivatives near x; return what is wrong at each of several places."""
    found: list[str] = []
    for attempt in range(ATTEMPTS):
        place = x + AWAY * rng.uniform(-1, 1, x.size) * (1 + abs(x))
        found = list(_compare_with_differences(functions, p, bounds, place, STEP / 5**attempt, rng))
        if not found:
            break
    return found


def _compare_with_differences(
    functions: Functions, p: Array, bounds: tuple[Array, Array], x: Array, step: float, rng: np.random.Generator
) -> Iterator[str]:
    along, sigma = rng.uniform(-1, 1, x.size), 0.7
    lam = rng.uniform(-1, 1, functions.constraints)
    lam[~np.isfinite(bounds).any(axis=0)] = 0.0

    def lagrange(x: Array) -> Array:
        """Return the gradient of the Lagrangian."""
        slopes = functions.jacobian(x, p).sparse()
        return np.asarray(sigma * functions.gradient(x, p)[1].full().ravel() + slopes.T @ lam)

    gradient = functions.gradient(x, p)[1].full().ravel()
    J = functions.jacobian(x, p).sparse()
    H = functions.hessian(x, p, sigma, lam).sparse()
    H = H + sparse.triu(H, 1).T
    for name, function, matrix in (
        ("gradient", lambda x: np.array([float(functions.objective(x, p))]), sparse.csr_array(gradient[None])),
        ("Jacobian", lambda x: functions.constraint(x, p).full().ravel(), J),
        ("Hessian", lagrange, H),
    ):
        off = _measure(function, sparse.csr_array(matrix), x, along, step)
        if not off <= SMOOTH:
            yield f"{name} by {off:.1e}"


def _measure(
    function: Callable[[Array], Array], matrix: sparse.csr_array, x: Array, along: Array, step: float
) -> float:
    """Return the largest difference of a product with a direction from the slope along it."""

    def slope(h: float) -> Array:
        return (function(x + h * along) - function(x - h * along)) / (2 * h)

    wanted = (4 * slope(step / 2) - slope(step)) / 3
    found, size = matrix @ along, abs(matrix) @ abs(along)
    return float((abs(found - wanted) / (1 + size)).max(initial=0))


def find_differing_backends(stated: Problem, solver: Solver, x: Array, rng: np.random.Generator) -> list[str]:
    """Compare the functions in NumPy, and the tables of stages in C, with CasADi's."""
    one, other, p = solver.program.casadi, solver.program.numpy, solver.transcription.parameters(stated)
    lam = rng.uniform(-1, 1, one.constraints)
    upper = one.hessian(x, p, 0.7, lam).full()
    pairs = {
        "terms": (one.terms(x, p).full().ravel(), other.terms(x, p)),
        "gradient": (one.gradient(x, p)[1].full().ravel(), other.gradient(x, p)),
        "rows": (one.constraint(x, p).full().ravel(), other.constraint(x, p)),
        "Jacobian": (one.jacobian(x, p).full(), other.jacobian(x, p).toarray()),
        "Hessian": (upper, other.hessian(x, p, 0.7, lam).toarray()),
    }
    found = []
    for name, (first, second) in pairs.items():
        off = float((abs(first - second)).max(initial=0) / (1 + abs(first).max(initial=0)))
        if not off <= ROUNDING:
            found.append(f"NumPy's {name} by {off:.1e}")
    return found


def find_differing_tables(
    stated: Problem, solver: Solver, plant: Plant, x: Array, rng: np.random.Generator
) -> list[str]:
    """Compare the tables of stages in C with the program in NumPy."""
    own = solver.transcription
    program, p = own.program, own.parameters(stated)
    least, most = own.constraint_bounds(stated)
    rows = np.ones(program.constraints, dtype=bool)
    rows[program.kept_rows] = np.isfinite(least) | np.isfinite(most)
    data = build(program, plant, p[: len(program.H)] != 0, rows)
    found = compare(Evaluator(Tables(data, plant), p), program, plant, solver.program.numpy.complete(x), p, rng)
    off = max(found.values, found.slopes, found.curvatures)
    return [] if off <= ROUNDING else [f"tables of stages: {found}"]
