"""Random quadratic problems in stages, feasible by construction or contradictory in known rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.csrc.stages import INFINITE, Array, Quadratic

Rng = np.random.Generator


def spread(rng: Rng, rows: int, columns: int) -> Array:
    numbers: Array = rng.standard_normal((rows, columns)) / np.sqrt(max(columns, 1))
    return numbers


def random_sizes(rng: Rng, stages: int, most: int = 5) -> list[tuple[int, int, int, int]]:
    """States, stage variables, and fewer equalities than these can meet."""
    sizes = []
    for k in range(stages):
        nx, nv = int(rng.integers(1, most + 1)), int(rng.integers(0 if k == stages - 1 else 1, most + 1))
        sizes.append((nx, nv, int(rng.integers(0, nv + 1)), 0))
    return sizes


def random_problem(
    rng: Rng,
    sizes: list[tuple[int, int, int, int]],
    *,
    bounds: float = 0.0,
    width: float = 1.0,
    first: bool = True,
    flat: float = 0.0,
    share: float = 1.0,
) -> Quadratic:
    """A convex problem for which a random point is feasible.

    `bounds` is the part of the variables that has them, on either side, at most `width` from the point; `first` fixes
    the first state; `flat` is the part of the directions without curvature;
    the cost is bounded below all the same. `share` is the part of the entries of matrices that may be nonzero, the
    same entries in stages of the same sizes.
    """
    point = [rng.standard_normal(nx + nv) for nx, nv, _, _ in sizes]
    nexts = [size[0] for size in sizes[1:]] + [0]
    H, q, F, b, E, e, G = [], [], [], [], [], [], []
    least, most = [], []
    for (nx, nv, ne, ng), after, w, ahead in zip(sizes, nexts, point, [*point[1:], np.zeros(0)], strict=True):
        n = nx + nv
        masks = np.random.default_rng([nx, nv, ne, ng, after])
        keep = [masks.random((rows, n)) < share for rows in (n, after, ne, ng)]
        root = spread(rng, n, n) * (rng.random(n)[:, None] >= flat) * keep[0]
        H.append(root.T @ root + (0.1 if flat == 0 else 0.0) * np.eye(n))
        q.append(rng.standard_normal(n) if flat == 0 else root.T @ rng.standard_normal(n))
        F.append(0.9 * spread(rng, after, n) * keep[1])
        b.append(ahead[:after] - F[-1] @ w)
        E.append(spread(rng, ne, n) * keep[2])
        e.append(-E[-1] @ w)
        G.append(spread(rng, ng, n) * keep[3])
        sides = rng.integers(0, 3, ng)
        least.append(np.where(sides == 1, -INFINITE, G[-1] @ w - width * rng.random(ng)))
        most.append(np.where(sides == 2, INFINITE, G[-1] @ w + width * rng.random(ng)))
    w = np.concatenate(point)
    sides = np.where(rng.random(len(w)) < bounds, rng.integers(1, 4, len(w)), 0)
    lower = np.where(sides & 1, w - width * rng.random(len(w)), -INFINITE)
    upper = np.where(sides & 2, w + width * rng.random(len(w)), INFINITE)
    if first:
        lower[: sizes[0][0]] = upper[: sizes[0][0]] = point[0][: sizes[0][0]]
    return Quadratic(
        sizes, H, q, F, b, E, e, G, lower, upper, np.concatenate(least), np.concatenate(most), np.zeros(len(w))
    )


def dense_solution(p: Quadratic) -> tuple[Array, Array, bool]:
    """Solve the optimality conditions as one dense system; say whether the multipliers are unique."""
    P, q, A, lower, _ = (a if isinstance(a, np.ndarray) else a.toarray() for a in p.matrices)
    fixed = np.flatnonzero(p.lower == p.upper)
    unit = np.eye(len(q))[fixed]
    J = np.vstack([A, unit])
    right = np.concatenate([-q, lower, p.lower[fixed]])
    K = np.block([[P, J.T], [J, np.zeros((len(J), len(J)))]])
    rank = int(np.linalg.matrix_rank(J, tol=1e-9))
    solution = np.linalg.lstsq(K, right, rcond=1e-13)[0] if rank < len(J) else np.linalg.solve(K, right)
    return solution[: len(q)], solution[len(q) : len(q) + len(A)], rank == len(J)


def in_units(problem: Quadratic, units: list[Array]) -> Quadratic:
    """The same problem in variables w / units."""
    ahead = [u[: len(b)] for u, b in zip([*units[1:], np.zeros(0)], problem.b, strict=True)]
    every = np.concatenate(units)
    return replace(
        problem,
        H=[u[:, None] * a * u for u, a in zip(units, problem.H, strict=True)],
        q=[u * a for u, a in zip(units, problem.q, strict=True)],
        F=[a * u / n[:, None] for u, a, n in zip(units, problem.F, ahead, strict=True)],
        b=[a / n for a, n in zip(problem.b, ahead, strict=True)],
        E=[a * u for u, a in zip(units, problem.E, strict=True)],
        G=[a * u for u, a in zip(units, problem.G, strict=True)],
        lower=np.where(problem.lower > -1e19, problem.lower / every, problem.lower),
        upper=np.where(problem.upper < 1e19, problem.upper / every, problem.upper),
    )


SIZES = [(3, 6, 5, 2)] * 5 + [(2, 4, 3, 2)] * 3 + [(3, 2, 2, 1)]
INNER = [4] * 5 + [2] * 3 + [1]


def condensed(problem: Quadratic, inner: list[int] = INNER, *, sparse: bool = True) -> Quadratic:
    return replace(problem, inner=inner, sparse=sparse)
