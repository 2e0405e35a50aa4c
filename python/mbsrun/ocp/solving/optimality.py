"""Judge a point of a program by first derivatives alone, whoever found it: by how much could its cost still fall?

Within a region |d_i| <= D_i about the point x, the linearised program

    minimise c'd  such that  J d = 0 in equations,  g + J d within its ranges,  x + d within its bounds

has a minimum -chi with chi >= 0, and chi = 0 exactly where multipliers of the right signs exist (Yuan, "Conditions for
convergence of trust region algorithms", Mathematical Programming 31 (1985); Conn, Gould, Toint, "Trust-region methods",
SIAM 2000, section 12.1). Nothing has to be called active: a bound at a distance admits a step of this distance. Rows
may depend on each other. Any multipliers y of the rows bound chi from above, by weak duality: with z = c + J'y,

    chi <= sum over variables of  max(z, 0) below + max(-z, 0) above
         + sum over rows of       max(-y, 0) below + max(y, 0) above,

where below and above are distances, at most D. So multipliers of the solver, good or bad, never make a point look
better than it is. Where they prove nothing, better ones follow from least squares, weighted by the distances as in
affine scaling (Dikin, Soviet Mathematics Doklady 8 (1967)), and at last from linear programming. In a convex program,
the cost is above its minimum by chi at most if the minimum lies in the region: chi bounds the gap of duality.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.program import Matrix

SAME = 1e-6  # what the cost may still fall by, over what its gradient alone would let it fall
LOOSE = 100.0  # the same over the solver's tolerance, where that is looser
PRODUCT = 1.0  # of a distance and a multiplier, over the tolerance: the largest that methods call 0
VANISHING = 100.0  # the largest entry of a gradient that is no measure, over the tolerance
ROUNDS = 4  # of least squares
LEAST = 1e-12  # a distance, over the size of the region, below which a variable is taken to stay
REGULAR = 1e-12  # on the diagonal of dependent rows
LARGEST = 20_000  # variables of a program that linear programming decides, where nothing else does
SECONDS = 5.0  # for it

Pair = tuple[Array, Array]  # lower and upper limits


@dataclass(frozen=True, eq=False)
class Slopes:
    """The entries of a Jacobian, column by column: most points need its products alone, which no matrix hastens."""

    data: Array
    row: Indices
    column: Indices
    shape: tuple[int, int]

    @property
    def matrix(self) -> Matrix:
        """Return the matrix."""
        begin = np.searchsorted(self.column, np.arange(self.shape[1] + 1))
        return sparse.csc_array((self.data, self.row, begin), shape=self.shape)

    def multiply(self, y: Array) -> Array:
        """Return J'y."""
        return np.asarray(np.bincount(self.column, self.data * y[self.row], self.shape[1]), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Point:
    """A program about a point, with the distances to bounds and to ranges; nothing that is violated has to return."""

    c: Array  # gradient of the cost
    slopes: Slopes  # Jacobian of the rows that read several variables; others are bounds of their variable
    rows: Indices  # their numbers
    size: Array  # D, of variables over their usual sizes
    below: Array  # how far each variable may fall, and rise
    above: Array
    row_below: Array  # of rows: likewise; 0 in equations
    row_above: Array
    violation: float  # the largest, of a row over its change in the region, of a bound over D
    sides: float  # limits of variables and rows; of limits beyond the region, the part D / distance

    @cached_property
    def J(self) -> Matrix:
        """Return the Jacobian as a matrix."""
        return self.slopes.matrix

    @property
    def reach(self) -> float:
        """Return by how much the cost could fall in the region without any constraint."""
        return float(np.abs(self.c) @ self.size)


@dataclass(frozen=True)
class Judgement:
    """The judgement of a point: what its cost could still fall by, to first order, and what is allowed."""

    decrease: float  # at most
    allowed: float
    reach: float  # of the gradient alone, to compare with
    violation: float
    allowed_violation: float
    is_sure: bool  # whether a step reaches the decrease, or the decrease is allowed

    @property
    def is_optimal(self) -> bool:
        """Return whether the decrease is within the allowed one."""
        return self.decrease <= self.allowed

    @property
    def is_feasible(self) -> bool:
        """Return whether the violation is within the allowed one."""
        return self.violation <= self.allowed_violation

    @property
    def ratio(self) -> float:
        """Return the decrease over the gradient's reach."""
        return self.decrease / self.reach if self.reach else 0.0


def judge(point: Point, tolerance: float, weight: float, multipliers: Array | None = None) -> Judgement:
    """Judge a point that a method with a tolerance found, for a cost whose largest weight is given.

    A gradient that vanishes, as where a cost of squares is 0, is no measure: there, derivatives of the Lagrangian as
    small as the tolerance are rounding. An interior point leaves a multiplier at each limit, near or far: the tolerance
    over the distance.
    """
    same, left = max(SAME, LOOSE * tolerance), tolerance * weight
    allowed = same * point.reach + PRODUCT * left * point.sides
    if np.abs(point.c).max(initial=0.0) <= VANISHING * left:
        allowed += left * float(point.size.sum())
    decrease, is_sure = bound(point, allowed, multipliers)
    return Judgement(decrease, allowed, point.reach, point.violation, same, is_sure or decrease <= allowed)


def linearise(
    x: Array, g: Array, c: Array, J: Matrix, bounds: Pair, ranges: Pair, scales: Array | float = 1.0
) -> Point:
    """Make a point of a program of its values and first derivatives, in variables over their usual sizes."""
    s = np.broadcast_to(scales, x.shape)
    is_scaled = bool((s != 1).any())
    x, c, bounds = x / s, c * s, (bounds[0] / s, bounds[1] / s)
    pattern = _PATTERNS.find(lambda: _find_pattern(J), J.indices, J.indptr)
    row, column = pattern.row, pattern.column
    data = J.data * s[column] if is_scaled else J.data
    size, fixed, equal = np.maximum(1.0, np.abs(x)), bounds[0] == bounds[1], ranges[0] == ranges[1]
    below, above = (np.where(fixed, 0.0, distance) for distance in (x - bounds[0], bounds[1] - x))
    row_below, row_above = (np.where(equal, 0.0, distance) for distance in (g - ranges[0], ranges[1] - g))
    reach = np.bincount(row, weights=np.abs(data) * size[column], minlength=g.size)
    only = pattern.alone[data[pattern.alone] != 0]
    alone, at, value = row[only], column[only], data[only]
    falls = np.where(value > 0, row_below[alone], row_above[alone]) / np.abs(value)
    rises = np.where(value > 0, row_above[alone], row_below[alone]) / np.abs(value)
    np.minimum.at(below, at, falls)
    np.minimum.at(above, at, rises)
    rest = pattern.rest if only.size == pattern.alone.size else _leave_out(row, column, alone, g.size)
    kept = rest.kept
    sides = _count_sides(below, above, size) + 2 * np.count_nonzero((row_below + row_above)[kept] > 0)
    unit = np.ones(g.size)
    if is_scaled:  # rows in unusual sizes have the one of their terms
        has_sizes = np.bincount(row, weights=(s != 1)[column], minlength=g.size) > 0
        unit[has_sizes & (reach > 0)] = 0.0
    excess = (_measure_excess(g, ranges) / np.maximum(unit, reach), _measure_excess(x, bounds) / size)
    return Point(
        c,
        Slopes(data[rest.chosen], rest.row, rest.column, (kept.size, J.shape[1])),
        kept,
        size,
        np.clip(below, 0.0, size),
        np.clip(above, 0.0, size),
        np.clip(row_below, 0.0, reach)[kept],
        np.clip(row_above, 0.0, reach)[kept],
        max(float(part.max(initial=0.0)) for part in excess),
        sides,
    )


@dataclass(frozen=True, eq=False)
class _Rest:
    """Rows of a matrix that are kept, and the entries of these."""

    kept: Indices
    chosen: Indices  # of all entries
    row: Indices  # of chosen entries, among the kept ones
    column: Indices


@dataclass(frozen=True, eq=False)
class _Pattern:
    """The places of a matrix's entries."""

    row: Indices
    column: Indices
    alone: Indices  # entries that are the only ones of their rows
    rest: _Rest  # the other rows


_PATTERNS: Memory[_Pattern] = Memory()


def _find_pattern(J: Matrix) -> _Pattern:
    row, column = J.indices.astype(np.int64), np.repeat(np.arange(J.shape[1]), np.diff(J.indptr))
    alone = np.flatnonzero((np.bincount(row, minlength=J.shape[0]) == 1)[row])
    return _Pattern(row, column, alone, _leave_out(row, column, row[alone], J.shape[0]))


def _leave_out(row: Indices, column: Indices, out: Indices, count: int) -> _Rest:
    """Leave some of a matrix's rows out, whose entries have these places."""
    is_kept = np.ones(count, dtype=bool)
    is_kept[out] = False
    chosen = np.flatnonzero(is_kept[row])
    return _Rest(np.flatnonzero(is_kept), chosen, (np.cumsum(is_kept) - 1)[row[chosen]], column[chosen])


def _count_sides(below: Array, above: Array, size: Array) -> float:
    """Count the bounds of variables that may move, each by the part of its distance that lies in the region."""
    moves = np.clip(below, 0.0, size) + np.clip(above, 0.0, size) > 0
    shares = (size / np.maximum(distance, size) for distance in (below, above))
    return float(sum(share[moves].sum() for share in shares))


def _measure_excess(values: Array, limits: Pair) -> Array:
    return np.maximum(0.0, np.maximum(limits[0] - values, values - limits[1]))


# --- chi ------------------------------------------------------------------------------------------------------------


def bound(point: Point, allowed: float, multipliers: Array | None = None) -> tuple[float, bool]:
    """Bound chi from above, until it is within what is allowed; return whether the bound is chi itself, too.

    `multipliers` of all rows are a first guess.
    """
    least = point.reach
    if multipliers is not None and np.isfinite(multipliers).all():
        least = min(least, _sum_products(point, multipliers[point.rows]))
    if least <= allowed:
        return least, False
    for found in _improve(point):
        least = min(least, found)
        if least <= allowed:
            return least, False
    exact = _solve(point) if point.c.size <= LARGEST else None
    return (least, False) if exact is None else (exact, True)


def _sum_products(point: Point, y: Array) -> float:
    """Return the bound of chi that multipliers of the rows give."""
    z = point.c + point.slopes.multiply(y)
    own = np.maximum(z, 0.0) @ point.below + np.maximum(-z, 0.0) @ point.above
    return float(own + np.maximum(-y, 0.0) @ point.row_below + np.maximum(y, 0.0) @ point.row_above)


def _improve(point: Point) -> Iterator[float]:
    """Yield bounds of chi by weighted least squares of c + J'y = 0, a slack for each row that is no equation.

    Weights are the nearer distance, and then the distance in the direction that lowers the cost.
    """
    from scipy.sparse.linalg import splu  # here, and late: it takes long to load

    ranged = np.flatnonzero(point.row_below + point.row_above > 0)
    rows, count = point.J.shape[0], ranged.size
    slacks = sparse.csc_array((-np.ones(count), (ranged, np.arange(count))), shape=(rows, count))
    A = Matrix(sparse.hstack([point.J, slacks]))
    c = np.concatenate([point.c, np.zeros(count)])
    below = np.concatenate([point.below, point.row_below[ranged]])
    above = np.concatenate([point.above, point.row_above[ranged]])
    least = LEAST * np.concatenate([point.size, np.maximum(1.0, np.maximum(below, above)[point.c.size :])])
    weights = np.minimum(below, above)
    for _ in range(ROUNDS):
        weights = np.maximum(weights, least)
        weighted = Matrix(A * weights)
        norms = np.sqrt((weighted**2).sum(axis=1))
        scales = 1 / np.where(norms > 0, norms, 1.0)
        scaled = Matrix(sparse.diags_array(scales) @ weighted)
        whole = [[sparse.eye_array(c.size), scaled.T], [scaled, -REGULAR * sparse.eye_array(rows)]]
        try:
            factors = splu(Matrix(sparse.block_array(whole)))
        except RuntimeError:  # a pivot is zero
            return
        y = -scales * np.asarray(factors.solve(np.concatenate([weights * c, np.zeros(rows)])))[c.size :]
        yield _sum_products(point, y)
        weights = np.where(c + y @ A > 0, below, above)


def _solve(point: Point) -> float | None:
    """Return chi by linear programming; None where that does not end in time."""
    from scipy.optimize import Bounds, LinearConstraint, milp  # here, and late: it takes long to load

    size = float(np.abs(point.c).max(initial=0.0)) or 1.0  # HiGHS takes small costs for none
    found = milp(
        point.c / size,
        bounds=Bounds(-point.below, point.above),
        constraints=LinearConstraint(point.J, -point.row_below, point.row_above),
        options={"time_limit": SECONDS},
    )
    return max(0.0, -size * float(found.fun)) if found.status == 0 else None
