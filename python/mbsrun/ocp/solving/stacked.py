"""Judge many points of one program at once, by the multipliers of their solver; see `optimality`.

The bounds are the ones of `optimality.judge`, taken over arrays. A point that these bounds do not decide is left to the
judge of single points, so verdicts are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.evaluation.backends.stacked import Values
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.solving.optimality import LOOSE, PRODUCT, SAME, VANISHING, Judgement

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of variables, ranges of rows and usual sizes of variables, (cases, size) each."""

    lower: Array
    upper: Array
    g_lower: Array
    g_upper: Array
    scales: Array


class StackedJudge:
    """A judge of the points of a program whose Jacobian has a pattern."""

    def __init__(self, pattern: Matrix) -> None:
        """Take the pattern: rows that read one variable alone are bounds of it."""
        self._rows = pattern.shape[0]
        self.row = pattern.indices.astype(np.int64)
        self.column = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        self._alone = np.flatnonzero((np.bincount(self.row, minlength=self._rows) == 1)[self.row])
        is_kept = np.ones(self._rows, dtype=bool)
        is_kept[self.row[self._alone]] = False
        self._kept = np.flatnonzero(is_kept)
        self._chosen = np.flatnonzero(is_kept[self.row])
        self._columns = pattern.shape[1]

    @cached_property
    def _rounds(self) -> list[Indices]:
        """Split rows of one variable so that no two of a part have the same one."""
        left, found = np.arange(self._alone.size), list[Indices]()
        while left.size:
            _, first = np.unique(self.column[self._alone[left]], return_index=True)
            found.append(left[first])
            left = np.delete(left, first)
        return found

    @cached_property
    def _by_row(self) -> sparse.csr_array:
        return _sum_by(self.row, self._rows)

    @cached_property
    def _by_column(self) -> sparse.csr_array:
        return _sum_by(self.column[self._chosen], self._columns)

    def judge(
        self, x: Array, values: Values, limits: Limits, multipliers: Array, tolerance: float, weights: Array
    ) -> list[Judgement | None]:
        """Judge points for costs whose largest weights are given, (cases,); None where single ones have to decide."""
        is_decided = np.ones(len(x), dtype=bool)
        for part in (values.gradient, values.rows, values.slopes, multipliers):
            is_decided &= np.isfinite(part).all(axis=1)
        with np.errstate(all="ignore"):
            found = self._judge(x, values, limits, multipliers, tolerance, weights)
        is_decided &= found[4] & (found[0] <= found[1])
        same, numbers = max(SAME, LOOSE * tolerance), zip(*(part.tolist() for part in found[:4]), strict=True)
        return [
            Judgement(own[0], own[1], own[2], own[3], same, is_sure=True) if good else None
            for good, own in zip(is_decided.tolist(), numbers, strict=True)
        ]

    def _judge(
        self, x: Array, values: Values, limits: Limits, multipliers: Array, tolerance: float, weights: Array
    ) -> tuple[Array, Array, Array, Array, Mask]:
        s, g, data = limits.scales, values.rows, values.slopes
        is_scaled = bool((s != 1).any())
        if is_scaled:
            data = data * s[:, self.column]
        x, c, bounds = x / s, values.gradient * s, (limits.lower / s, limits.upper / s)
        ranges = limits.g_lower, limits.g_upper
        size, fixed, equal = np.maximum(1.0, np.abs(x)), bounds[0] == bounds[1], ranges[0] == ranges[1]
        below, above = (np.where(fixed, 0.0, distance) for distance in (x - bounds[0], bounds[1] - x))
        row_below, row_above = (np.where(equal, 0.0, distance) for distance in (g - ranges[0], ranges[1] - g))
        reach = _multiply(self._by_row, np.abs(data) * size[:, self.column])
        has_alone = self._bound_by_rows(data, below, above, row_below, row_above)
        kept = self._kept
        sides = _count_sides(below, above, size) + 2 * np.count_nonzero((row_below + row_above)[:, kept] > 0, axis=1)
        unit = np.where(self._find_sized(s) & (reach > 0), 0.0, 1.0) if is_scaled else np.ones(g.shape)
        excess = _measure_excess(g, ranges) / np.maximum(unit, reach), _measure_excess(x, bounds) / size
        violation = np.maximum(*(part.max(axis=1, initial=0.0) for part in excess))
        below, above = np.clip(below, 0.0, size), np.clip(above, 0.0, size)
        row_below, row_above = (np.clip(part, 0.0, reach)[:, kept] for part in (row_below, row_above))
        y = multipliers[:, kept]
        every = multipliers[:, self.row[self._chosen]]
        z = c + _multiply(self._by_column, data[:, self._chosen] * every)
        decrease = _dot(np.maximum(z, 0.0), below) + _dot(np.maximum(-z, 0.0), above)
        decrease = decrease + _dot(np.maximum(-y, 0.0), row_below) + _dot(np.maximum(y, 0.0), row_above)
        whole, left = _dot(np.abs(c), size), tolerance * weights
        allowed = max(SAME, LOOSE * tolerance) * whole + PRODUCT * left * sides
        vanishes = np.abs(c).max(axis=1, initial=0.0) <= VANISHING * left
        allowed = allowed + np.where(vanishes, left * size.sum(axis=1), 0.0)
        return np.minimum(whole, decrease), allowed, whole, violation, has_alone

    def _bound_by_rows(self, data: Array, below: Array, above: Array, row_below: Array, row_above: Array) -> Mask:
        """Bound variables by rows that read one alone; return the cases where all of these rows have a slope."""
        row, at, value = self.row[self._alone], self.column[self._alone], data[:, self._alone]
        falls = np.where(value > 0, row_below[:, row], row_above[:, row]) / np.abs(value)
        rises = np.where(value > 0, row_above[:, row], row_below[:, row]) / np.abs(value)
        for part in self._rounds:  # no variable comes twice in a round
            below[:, at[part]] = np.minimum(below[:, at[part]], falls[:, part])
            above[:, at[part]] = np.minimum(above[:, at[part]], rises[:, part])
        return np.asarray((value != 0).all(axis=1))

    def _find_sized(self, scales: Array) -> Mask:
        """Return the rows that read a variable of an unusual size."""
        sized = (scales != 1).astype(np.float64)
        return np.asarray(_multiply(self._by_row, sized[:, self.column]) > 0)


def _sum_by(places: Indices, size: int) -> sparse.csr_array:
    """Return the matrix that sums numbers by their places."""
    return sparse.csr_array((np.ones(places.size), (places, np.arange(places.size))), shape=(size, places.size))


def _multiply(matrix: sparse.csr_array, rows: Array) -> Array:
    return np.ascontiguousarray(np.asarray(matrix @ rows.T).T)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _count_sides(below: Array, above: Array, size: Array) -> Array:
    """Count the bounds of variables that may move, each by the part of its distance that lies in the region."""
    moves = np.clip(below, 0.0, size) + np.clip(above, 0.0, size) > 0
    shares = [size / np.maximum(distance, size) for distance in (below, above)]
    return np.asarray(sum(np.where(moves, share, 0.0).sum(axis=1) for share in shares))


def _measure_excess(values: Array, limits: tuple[Array, Array]) -> Array:
    return np.maximum(0.0, np.maximum(limits[0] - values, values - limits[1]))
