"""A state that one control drives in one direction, from a given start to a given end -> the limits that this implies.

With the state's values m_0 .. m_S in an interval of length T / N, and a control u that is constant there, its equations
are D (m_0 .. m_S) = c T u, or c u where T is fixed. Where the rows of D sum to 0 exactly, m_l - m_0 = gamma_l T u. If
gamma grows with l from 0 on, or falls, and u has one sign in all intervals, no value lies beyond the start and the end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.proofs.proof import Indices, Nonlinear
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.transcription.transcription import Transcription

Array = NDArray[np.float64]

LEAST = 1e-6  # of the growth of gamma, by the largest; roundings are far below


def _list_entries(matrix: ca.SX) -> list[Any]:
    """List the nonzeros of a matrix."""
    return list(matrix.nonzeros())


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Rows that are polynomials of second degree: their values and slopes at 0, and their second derivatives."""

    constant: Array
    linear: sparse.csr_array
    products: dict[int, dict[tuple[int, int], float]]  # by row, of two variables

    def slopes(self, row: int) -> dict[int, float]:
        """Return the slopes of a row at 0, by variable, without zeros."""
        part = slice(self.linear.indptr[row], self.linear.indptr[row + 1])
        pairs = zip(self.linear.indices[part].tolist(), self.linear.data[part].tolist(), strict=True)
        return {k: value for k, value in pairs if value}

    @classmethod
    def of(cls, program: Nonlinear, rows: Indices) -> Quadratic | None:
        """Take rows apart; None where they are of another kind."""
        x = ca.SX.sym("x", len(program.lower))
        g = program.constraint.expand()(x)[rows.tolist()]
        jacobian = ca.jacobian(g, x)
        second = ca.jacobian(ca.vertcat(*_list_entries(jacobian)), x)
        if not second.is_constant():
            return None
        function = ca.Function("slopes", [x], [g, jacobian])
        constant, linear = function(np.zeros(len(program.lower)))
        row, column = jacobian.sparsity().get_triplet()
        entries, others = second.sparsity().get_triplet()
        products: dict[int, dict[tuple[int, int], float]] = {}
        for entry, other, value in zip(entries, others, _list_entries(second), strict=True):
            products.setdefault(row[entry], {})[column[entry], other] = float(value)
        return cls(constant.full().ravel(), sparse.csr_array(linear.sparse()), products)


def drop_between(program: Nonlinear, transcription: Transcription, data: Program) -> Nonlinear:
    """Drop the limits of states that move in one direction, from a start to an end; else return the same program."""
    lower, upper = program.lower.copy(), program.upper.copy()
    for places in find_monotone(program, transcription, data):
        lower[places], upper[places] = -np.inf, np.inf
    changed = (lower != program.lower).any() or (upper != program.upper).any()
    return replace(program, lower=lower, upper=upper) if changed else program


def find_monotone(program: Nonlinear, transcription: Transcription, data: Program) -> Iterator[Indices]:
    """Find the variables, of each state that moves in one direction, whose limits its start and its end imply."""
    extras, rows, horizon = transcription.layout.extras, transcription.rows.extras, transcription.layout.horizon
    if data.stages is None or not (extras.point_states.size and extras.controls.size and rows.end.size):
        return
    fixed = _find_fixed(program, np.append(rows.start, rows.end))
    count = extras.states.shape[1]
    continuity = data.stages.continuity[:, -count:]
    for e in range(count):
        first, last = int(extras.states[0, e]), int(extras.states[-1, e])
        if first not in fixed or last not in fixed:
            continue
        values = np.column_stack([extras.states[:-1, e], extras.point_states[:, :, e]])
        places, ends = np.append(values.ravel(), last), sorted((fixed[first], fixed[last]))
        is_implied = (program.lower[places] <= ends[0]).all() and (program.upper[places] >= ends[1]).all()
        if is_implied and _is_carried(program, continuity[:, e], values[:, -1], extras.states[1:, e]):
            quadratic = Quadratic.of(program, rows.rates[:, :, e].ravel())
            if quadratic is not None and _is_one_way(quadratic, values, extras.controls, program, horizon):
                yield places


def _find_fixed(program: Nonlinear, rows: Indices) -> dict[int, float]:
    """Return the variables that rows set to numbers, with these."""
    quadratic, found = Quadratic.of(program, rows), {}
    if quadratic is not None and not quadratic.products and not quadratic.constant.any():
        for k, row in enumerate(rows.tolist()):
            slopes = quadratic.slopes(k)
            if list(slopes.values()) == [1.0] and program.g_lower[row] == program.g_upper[row]:
                found[next(iter(slopes))] = float(program.g_lower[row])
    return found


def _is_carried(program: Nonlinear, rows: Indices, before: Indices, after: Indices) -> bool:
    """Return whether rows say after - before = 0."""
    quadratic = Quadratic.of(program, rows)
    if quadratic is None or quadratic.products or quadratic.constant.any():
        return False
    if program.g_lower[rows].any() or program.g_upper[rows].any():
        return False
    pairs = zip(before.tolist(), after.tolist(), strict=True)
    return all(quadratic.slopes(k) == {b: -1.0, a: 1.0} for k, (b, a) in enumerate(pairs))


def _is_one_way(
    quadratic: Quadratic, values: Indices, controls: Indices, program: Nonlinear, horizon: int | None
) -> bool:
    """Return whether values (N, 1 + S) of a state grow from place to place in all intervals, or fall in all."""
    if quadratic.constant.any() or (horizon is not None and program.lower[horizon] < 0):
        return False
    directions = set()
    for k, (own, given) in enumerate(zip(values.tolist(), controls.tolist(), strict=True)):
        count = len(own) - 1
        parts = [_split(quadratic, row, own, horizon) for row in range(k * count, (k + 1) * count)]
        drives = {u for _, drive in parts for u in drive}
        if len(drives) != 1 or not drives <= set(given) or any(sum(map(Fraction, D)) for D, _ in parts):
            return False
        (u,) = drives
        D, c = np.array([D for D, _ in parts]), np.array([drive.get(u, 0.0) for _, drive in parts])
        growth = np.diff(np.linalg.solve(D[:, 1:], -c), prepend=0.0)
        sign = np.sign(growth[0]) * (1 if program.lower[u] >= 0 else -1 if program.upper[u] <= 0 else 0)
        if (growth * np.sign(growth[0]) < LEAST * np.abs(growth).max()).any():
            return False
        directions.add(sign)
    return directions in ({1.0}, {-1.0})


def _split(
    quadratic: Quadratic, row: int, own: Sequence[int], horizon: int | None
) -> tuple[list[float], dict[int, float]]:
    """Return the coefficients of a state's values in a row, and of all else: of controls, times T where it is free."""
    slopes = quadratic.slopes(row)
    D = [slopes.pop(place, 0.0) for place in own]
    if horizon is None:
        return D, slopes if not quadratic.products.get(row) else {-1: 1.0}
    products = quadratic.products.get(row, {})
    drives = {u: value for (t, u), value in products.items() if t == horizon}
    mirrored = {(horizon, u): value for u, value in drives.items()} | {
        (u, horizon): value for u, value in drives.items()
    }
    return D, drives if not slopes and mirrored == products else {-1: 1.0}
