"""A step of Newton's method onto the equations of a program: variables near a solution -> nearby ones that solve them.

    minimise |D^-1 dx|  subject to  J dx = -g,    so  dx = -D^2 J' (J D^2 J')^-1 g,    D = diag(max(1, |x|))

with the equations g(x) = 0 alone, and their Jacobian J (Nocedal, Wright, "Numerical optimization", 2006, section 11.1).
Variables at a bound stay there, and so do variables of many rows, such as durations, which would fill J D^2 J'.

A method ends with residuals below its tolerance, and the step has their size. So an optimum within the tolerance
remains one, and the residuals fall to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.solving.answers import measure_excess

AT_BOUND = 1e-6  # relative, and absolute below 1: nearer to a bound, a variable stays
DAMPING = 1e-13  # of the largest diagonal entry: equations may depend on each other
MANY = 60  # rows of a variable that stays

Bounds = tuple[Array, Array]


@dataclass(frozen=True)
class Equations:
    """The rows of a program, their slopes, and the ranges of rows and variables."""

    evaluate: Callable[[Array], Array]
    differentiate: Callable[[Array], Matrix]
    rows: Bounds
    variables: Bounds

    def measure(self, x: Array, g: Array) -> float:
        """Return the largest violation of rows and bounds."""
        return max(measure_excess(g, *self.rows), measure_excess(x, *self.variables))


def polish(x: Array, own: Equations, most: float) -> Array:
    """Return variables whose largest residual of equations is less, with no violation above `most`, or x itself."""
    equal = np.flatnonzero(own.rows[0] == own.rows[1])
    g = own.evaluate(x)
    step = _find_step(x, (g - own.rows[0])[equal], sparse.csc_array(own.differentiate(x).tocsr()[equal]), own.variables)
    moved = np.clip(x + step, *own.variables)
    there = own.evaluate(moved)
    before, after = (np.abs(rows - own.rows[0])[equal].max(initial=0.0) for rows in (g, there))
    return moved if after < before and own.measure(moved, there) <= most else x


def _find_step(x: Array, residual: Array, J: Matrix, bounds: Bounds) -> Array:
    """Return the shortest step in scaled variables that solves the linear equations; 0 where they are singular."""
    scales = np.maximum(1.0, np.abs(x))
    held = np.minimum(x - bounds[0], bounds[1] - x) < AT_BOUND * scales
    held |= np.diff(J.indptr) > MANY
    from scipy.sparse.linalg import splu  # here, and late: it takes long to load

    scaled = sparse.csr_array(J @ sparse.diags_array(np.where(held, 0.0, scales)))
    normal = sparse.csc_array(scaled @ scaled.T)
    damping = DAMPING * normal.diagonal().max(initial=0.0) * sparse.eye_array(residual.size)
    try:
        solved = splu(sparse.csc_matrix(normal + damping)).solve(residual)
    except RuntimeError:  # exactly singular
        return np.zeros(x.size)
    return np.asarray(-scales * (scaled.T @ solved))
