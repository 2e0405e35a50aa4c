"""The functions of tables of stages, as C evaluates them, in the variables of the program that they were made of.

With w = (known, l), the known variables of the tables being variables X of the program, and l variables of the tables
alone, whose equations are r(known, l) = 0:

    dw/dX = M,  with  dl/dX = -r_l^-1 r_known M_known
    d2 L/dX2 = M' (L + mu r)_ww M,   L_l + r_l' mu = 0
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.evaluation.stages.binding import Evaluator, fill
from mbsrun.ocp.evaluation.stages.tables import Nonzeros, StageProgram
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Program


@dataclass(frozen=True)
class Difference:
    """The largest differences between tables and their program, relative to the largest entry of each."""

    values: float
    slopes: float
    curvatures: float


@dataclass(frozen=True)
class _Whole:
    """The results of all stages, in vectors and matrices of the whole."""

    cost: float
    gradient: Array
    e: Array
    d: Array
    g: Array
    de: sparse.csc_array
    dd: sparse.csc_array
    dg: sparse.csc_array


def compare(
    evaluator: Evaluator, program: Program, plant: Plant, x: Array, p: Array, rng: np.random.Generator
) -> Difference:
    """Compare values, first and second derivatives at x, all variables of the program."""
    data, oracle = evaluator.tables.data, NumpyProgram(replace(program, solved=()), plant)
    w = fill(evaluator, x)
    found, n = evaluate(evaluator, w), w.size
    known, lifted = data.variables >= 0, data.lifted
    M = sparse.csr_array(
        (np.ones(int(known.sum())), (np.flatnonzero(known), data.variables[known])), shape=(n, x.size)
    ).tolil()
    r = found.de.tocsr()[data.lifted_rows].tocsc()
    if lifted.size:
        others = sparse.csc_array(r @ M.tocsc())
        M[lifted] = -spsolve(r[:, lifted].tocsc(), others.tocsc())
    M = M.tocsc()
    g, J = oracle.constraint(x, p), oracle.jacobian(x, p).tocsr()
    next_states = _select_next_states(data)
    units = np.array([program.A[[i], [data.variables[j]]][0] if i >= 0 else 1.0 for i, j in _pair(data, next_states)])
    wanted, got, slopes, turned = [], [], [], []
    for rows, value, slope, scale in (
        (data.rows_e, found.e, found.de, np.ones(data.rows_e.size)),
        (data.rows_g, found.g, found.dg, np.ones(data.rows_g.size)),
        (data.rows_d, w[next_states] - found.d, _pick(next_states, n) - found.dd, units),
    ):
        kept = rows >= 0
        wanted.append(g[rows[kept]])
        got.append(scale[kept] * value[kept])
        slopes.append(J[rows[kept]])
        turned.append(sparse.diags_array(scale[kept]) @ sparse.csr_array(slope)[np.flatnonzero(kept)] @ M)
        assert np.abs(value[~kept]).max(initial=0.0) < 1e-9, "copies and lifted variables are consistent"
    cost = oracle.objective(x, p)
    values = _measure(np.concatenate([*got, [found.cost]]), np.concatenate([*wanted, [cost]]))
    gradient = _measure(M.T @ found.gradient, oracle.gradient(x, p))
    J_found, J_wanted = sparse.vstack(turned), sparse.vstack(slopes)
    sigma, lam = 0.7, rng.uniform(-1, 1, program.constraints)
    placed = np.concatenate([rows[rows >= 0] for rows in (data.rows_e, data.rows_g, data.rows_d)])
    outside = np.setdiff1d(np.arange(program.constraints), placed)
    lam[outside] = 0.0
    upper = oracle.hessian(x, p, sigma, lam)
    H_wanted = (upper + sparse.triu(upper, 1).T).toarray()
    ye, yd, yg = (np.where(rows >= 0, lam[rows], 0.0) for rows in (data.rows_e, data.rows_d, data.rows_g))
    yd = -units * yd
    if lifted.size:
        by_w = sigma * found.gradient + found.de.T @ ye + found.dd.T @ yd + found.dg.T @ yg
        by_w -= _pick(next_states, n).T @ yd
        ye[data.lifted_rows] = -spsolve(r[:, lifted].T.tocsc(), by_w[lifted])
    H = hessian(evaluator, w, sigma, ye, yd, yg)
    H_found = (M.T @ H @ M).toarray()
    return Difference(
        values,
        max(gradient, _measure(J_found.toarray(), J_wanted.toarray())),
        _measure(H_found, H_wanted),
    )


def evaluate(evaluator: Evaluator, w: Array) -> _Whole:
    """Evaluate all stages."""
    data, first = evaluator.tables.data, 0
    values, gradients, matrices = [], [], []
    for k, number in enumerate(data.kind_of_stage):
        kind = data.kinds[number]
        n = kind.nx + kind.nv
        xv = np.ascontiguousarray(w[first : first + n])
        value, slopes = evaluator.values(k, xv), evaluator.jacobians(k, xv)
        assert value is not None
        assert slopes is not None
        values.append(value)
        gradients.append(slopes[0])
        pairs = zip((kind.de, kind.dd, kind.dg), slopes[1:], strict=True)
        matrices.append([_matrix(pattern, data) for pattern, data in pairs])
        first += n
    f, e, d, g = zip(*values, strict=True)
    de, dd, dg = (sparse.block_diag(parts, format="csc") for parts in zip(*matrices, strict=True))
    return _Whole(sum(f), np.concatenate(gradients), *map(np.concatenate, (e, d, g)), de, dd, dg)


def hessian(evaluator: Evaluator, w: Array, sigma: float, ye: Array, yd: Array, yg: Array) -> sparse.csc_array:
    """Evaluate the Hessians of all stages."""
    data, first, at, parts = evaluator.tables.data, 0, np.zeros(3, dtype=np.int64), []
    for k, number in enumerate(data.kind_of_stage):
        kind = data.kinds[number]
        n, rows = kind.nx + kind.nv, np.array(evaluator.rows(k))
        y = np.concatenate([v[a : a + count] for v, a, count in zip((ye, yd, yg), at, rows, strict=True)])
        found = evaluator.hessian(k, np.ascontiguousarray(w[first : first + n]), sigma, y)
        assert found is not None
        assert (kind.hessian.row >= kind.hessian.col).all()
        lower = _matrix(kind.hessian, found)
        parts.append(lower + sparse.tril(lower, -1).T)
        first, at = first + n, at + rows
    return sparse.block_diag(parts, format="csc")


def _matrix(pattern: Nonzeros, data: Array) -> sparse.csc_array:
    return sparse.coo_array((data, (pattern.row, pattern.col)), shape=pattern.shape).tocsc()


def _select_next_states(data: StageProgram) -> Array:
    """Return the variables that rows of the dynamics aim at."""
    first, found = 0, []
    for k, number in enumerate(data.kind_of_stage):
        kind = data.kinds[number]
        if k:
            found.append(first + np.arange(kind.nx))
        first += kind.nx + kind.nv
    return np.concatenate(found)


def _pair(data: StageProgram, next_states: Array) -> zip[tuple[int, int]]:
    """Pair the rows of the dynamics with the states that they give, by a coefficient of the program's matrix."""
    return zip(data.rows_d.tolist(), next_states.tolist(), strict=True)


def _pick(chosen: Array, size: int) -> sparse.csc_array:
    return sparse.coo_array((np.ones(chosen.size), (np.arange(chosen.size), chosen)), shape=(chosen.size, size)).tocsc()


def _measure(found: Array, wanted: Array) -> float:
    return float(np.abs(found - wanted).max(initial=0.0) / (1 + np.abs(wanted).max(initial=0.0)))
