"""Estimation: rows A x = b + noise of several recordings -> x, its covariance, and what the rows leave open.

Each row of a time, a torque, has its own standard deviation: a given one, or the residuals' own, with which the rows
are weighted again until it stays (feasible generalised least squares). Rows are compressed by QR once: a block for
each part of a recording and each torque. So weights, and parts that are left out, cost nothing.

With the loss of Huber (Annals of Math. Statistics 35, 1964), residuals beyond 1.345 standard deviations count
linearly; these deviations are 1.4826 times the median of the residuals' sizes, and the covariance is the first one of
Huber's "Robust Statistics" (1981, eq. 6.5), as statsmodels has it under the name H1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from mbsrun.identification.structure import select_columns

Array = NDArray[np.float64]

DETERMINED = 1e-8  # of a column's length, weighted: less cannot be determined apart by these recordings
ROUNDS = 30  # of weights
SETTLED = 1e-6  # change of standard deviations at which they end, relative
HUBER, MEDIAN = 1.345, 1.4826  # in standard deviations; of the median of normal sizes
LEAST = 1e-9  # of a torque's root mean square: smaller deviations are rounding
CORRELATED = 4.0  # standard deviations of a correlation of white noise, beyond which it counts


@dataclass(frozen=True, eq=False)
class Part:
    """The rows of a part of a recording."""

    recording: int
    A: Array  # (K, torques, unknowns)
    b: Array  # (K, torques)


@dataclass(frozen=True, eq=False)
class Estimate:
    """The numbers that explain rows the best."""

    x: Array  # (unknowns,); 0 where the rows do not determine them
    covariance: Array  # (unknowns, unknowns); 0 there
    determined: tuple[int, ...]  # the unknowns that the rows determine
    sigma: Array  # standard deviations of torques, (torques,)
    correlation: Array  # of a torque's residual with the next one's, (torques,)
    freedom: int  # rows less unknowns


@dataclass(frozen=True, eq=False)
class Compressed:
    """Parts, each torque's rows as a triangle of A and b with the same sums of squares."""

    R: Array  # (parts, torques, unknowns + 1, unknowns + 1)
    counts: Array  # (parts, torques)

    def select(self, kept: Sequence[int]) -> Compressed:
        """Return some of the parts."""
        return Compressed(self.R[list(kept)], self.counts[list(kept)])

    def measure(self, x: Array) -> Array:
        """Return the sums of squared residuals, (parts, torques)."""
        r = self.R[..., :-1] @ x - self.R[..., -1]
        return np.asarray((r**2).sum(axis=-1))


def compress(parts: Sequence[Part], weights: Sequence[Array] | None = None) -> Compressed:
    """Compress rows, each multiplied by a weight, (K, torques) for each part."""
    R, counts = [], []
    for k, part in enumerate(parts):
        rows = np.concatenate((part.A, part.b[:, :, None]), axis=2)
        if weights is not None:
            rows = rows * weights[k][:, :, None]
        R.append([_triangle(rows[:, j]) for j in range(rows.shape[1])])
        counts.append([len(rows)] * rows.shape[1])
    return Compressed(np.array(R), np.array(counts, dtype=float))


def _triangle(rows: Array) -> Array:
    size = rows.shape[1]
    R: Array = np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > size else rows
    return np.vstack((R, np.zeros((size - len(R), size))))


def estimate(parts: Sequence[Part], given: Mapping[int, float], loss: str = "squares") -> Estimate:
    """Estimate all unknowns of some parts; `given` are known standard deviations, by torque."""
    compressed = compress(parts)
    found = solve_weighted(compressed, given)
    if loss == "huber":
        return _estimate_robustly(parts, given, found)
    return _finish(parts, found)


def solve_weighted(compressed: Compressed, given: Mapping[int, float]) -> Estimate:
    """Solve with weights that are found from the residuals, as if noise were white."""
    scale = _find_scales(compressed)
    sigma = np.array([given.get(j, 1.0) for j in range(len(scale))])
    own = [j for j in range(len(scale)) if j not in given]
    x, covariance, determined = solve(compressed.R, sigma)
    for _ in range(ROUNDS if own else 0):
        before = sigma.copy()
        sigma[own] = np.maximum(_find_deviations(compressed, x, len(determined)), LEAST * scale)[own]
        x, covariance, determined = solve(compressed.R, sigma)
        if np.abs(sigma / before - 1).max() < SETTLED:
            break
    freedom = int(compressed.counts.sum()) - len(determined)
    return Estimate(x, covariance, determined, sigma, np.zeros(len(scale)), freedom)


def _find_scales(compressed: Compressed) -> Array:
    """Return the root mean square of the right-hand side of each torque, or of the largest of them."""
    own = np.sqrt((compressed.R[..., -1] ** 2).sum(axis=(0, 2)) / compressed.counts.sum(axis=0))
    largest = float(own.max())
    return np.asarray(np.maximum(own, LEAST * largest if largest > 0 else 1.0))


def _find_deviations(compressed: Compressed, x: Array, determined: int) -> Array:
    squares, counts = compressed.measure(x).sum(axis=0), compressed.counts.sum(axis=0)
    return np.asarray(np.sqrt(squares / np.maximum(counts * (1 - determined / counts.sum()), 1e-12)))


def solve(R: Array, sigma: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Solve compressed rows weighted by 1/sigma: the unknowns, their covariance, and the ones that are determined.

    An unknown whose column depends on earlier ones is left at 0.
    """
    rows = (R / sigma[:, None, None]).reshape(-1, R.shape[-1])
    T = _triangle(rows)
    size = R.shape[-1] - 1
    lengths = np.linalg.norm(T[:, :size], axis=0)
    determined = select_columns(T[:, :size] / np.where(lengths > 0, lengths, np.inf), DETERMINED)
    x, covariance = np.zeros(size), np.zeros((size, size))
    if determined:
        own = _triangle(np.column_stack((T[:, determined] / lengths[determined], T[:, -1])))
        k = len(determined)
        inverse = solve_triangular(own[:k, :k], np.eye(k)) / lengths[determined][:, None]
        x[determined] = inverse @ own[:k, -1]
        covariance[np.ix_(determined, determined)] = inverse @ inverse.T
    return x, covariance, tuple(determined)


def _finish(parts: Sequence[Part], found: Estimate) -> Estimate:
    """Widen the covariance where residuals are correlated in time, as an autoregression of order 1 has it."""
    residuals = [part.A @ found.x - part.b for part in parts]
    rho = correlate(residuals)
    count = sum(len(r) for r in residuals)
    counts = np.where(rho > CORRELATED / np.sqrt(max(count, 2)), np.clip(rho, 0, 0.999), 0.0)
    if not counts.any():
        return Estimate(found.x, found.covariance, found.determined, found.sigma, rho, found.freedom)
    widened = np.sqrt((1 + counts) / (1 - counts))
    determined = list(found.determined)
    bread = found.covariance[np.ix_(determined, determined)]
    compressed = compress(parts).R[..., determined]
    squares = [
        widened[j] ** 2 / found.sigma[j] ** 2 * sum(R.T @ R for R in compressed[:, j]) for j in range(len(widened))
    ]
    covariance = np.zeros_like(found.covariance)
    covariance[np.ix_(determined, determined)] = bread @ sum(squares) @ bread
    return Estimate(found.x, covariance, found.determined, found.sigma, rho, found.freedom)


def correlate(residuals: Sequence[Array]) -> Array:
    """Return the correlation of residuals (K, torques) with the next ones."""
    total = np.sum([(r**2).sum(axis=0) for r in residuals], axis=0)
    next_ones = np.sum([(r[1:] * r[:-1]).sum(axis=0) for r in residuals], axis=0)
    return np.asarray(next_ones / np.where(total > 0, total, np.inf))


def _estimate_robustly(parts: Sequence[Part], given: Mapping[int, float], start: Estimate) -> Estimate:
    x, sigma, determined = start.x, start.sigma, start.determined
    scale = _find_scales(compress(parts))
    residuals = [part.A @ x - part.b for part in parts]
    for _ in range(ROUNDS):
        sizes = np.abs(np.concatenate(residuals))
        before = sigma
        sigma = np.maximum(MEDIAN * np.median(sizes, axis=0), LEAST * scale)
        sigma = np.array([given.get(j, s) for j, s in enumerate(sigma.tolist())])
        weights = [np.sqrt(np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(r), 1e-300))) for r in residuals]
        x, bread, determined = solve(compress(parts, weights).R, sigma)
        residuals = [part.A @ x - part.b for part in parts]
        if np.abs(sigma / before - 1).max() < SETTLED:
            break
    _, bread, determined = solve(compress(parts).R, sigma)
    z = np.concatenate(residuals) / sigma
    inside = np.abs(z) <= HUBER
    rows, slope = z.size, max(float(inside.mean()), 1e-6)
    k = 1 + len(determined) / rows * (1 - slope) / slope
    square = float((np.clip(z, -HUBER, HUBER) ** 2).sum()) / max(rows - len(determined), 1)
    factor = k**2 * square / slope**2
    return Estimate(x, factor * bread, determined, sigma, correlate(residuals), rows - len(determined))


def validate(compressed: Compressed, groups: Sequence[int], given: Mapping[int, float]) -> tuple[Array, Array]:
    """Leave each group of parts out: the root mean square of its residuals, (groups, torques); the same with all parts.

    The first uses an estimate without the group, the second the estimate with it.
    """
    whole = solve_weighted(compressed, given)
    names = list(dict.fromkeys(groups))
    own = np.zeros((len(names), compressed.R.shape[1]))
    out = np.zeros_like(own)
    for k, name in enumerate(names):
        left = [i for i, group in enumerate(groups) if group == name]
        kept = [i for i in range(len(groups)) if i not in left]
        part = compressed.select(left)
        counts = part.counts.sum(axis=0)
        own[k] = np.sqrt(part.measure(whole.x).sum(axis=0) / counts)
        x = solve_weighted(compressed.select(kept), given).x if kept else np.full(len(whole.x), np.nan)
        out[k] = np.sqrt(part.measure(x).sum(axis=0) / counts)
    return out, own
