"""Costs: a matrix for each weight, and functions where a term is not quadratic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Block, Matrix
from mbsrun.ocp.transcription.layout import Entries, Layout
from mbsrun.ocp.transcription.writing.sheet import Sheet


def write_cost(sheet: Sheet) -> tuple[tuple[Matrix, ...], tuple[Block, ...]]:
    """Return the quadratic terms, a matrix for each weight, and the others."""
    shape, layout = sheet.shape, sheet.layout
    running, terminal = len(shape.running), len(shape.terminal)
    weights, blocks = sheet.h[:, None] * sheet.scheme.weights, []
    if running:
        places = sheet.points
        rows = np.broadcast_to(2 + np.arange(running)[:, None], (running, places.s.size))
        block = sheet.apply(shape.running, places, rows, places.interval, weights.ravel())
        blocks.append(replace(block, factor=layout.horizon))
    if terminal:
        rows = 2 + running + np.arange(terminal)[:, None]
        blocks.append(sheet.apply(shape.terminal, sheet.last, rows, sheet.last.interval))
    nothing = sparse.csc_array((layout.size, layout.size))
    others = (nothing,) * (running + terminal)
    controls = [layout.extras.controls[:, [i]] for i in shape.priced_controls]
    if layout.horizon is None:
        inputs = (_input_cost(layout, sheet.h, weights), _rate_cost(layout.inputs, sheet.h, layout.size))
        rates = (_rate_cost(control, sheet.h, layout.size) for control in controls)
        return (*inputs, *others, *rates), tuple(blocks)
    for row, control in enumerate(controls, 2 + running + terminal):
        blocks += _rate_costs(control, layout.horizon, sheet.h, row)
    own = _input_costs(layout, layout.horizon, sheet.h, weights)
    return (nothing, nothing, *others, *(nothing for _ in controls)), (*own, *blocks)


def _input_cost(layout: Layout, h: Array, weights: Array) -> Matrix:
    """Return the Hessian of the integral of |u|^2; weights (N, S) are of values at the points."""
    H = Entries()
    H.put(layout.inputs, layout.inputs, 2 * h[:, None])
    if layout.point_inputs.size:
        H.put(layout.point_inputs, layout.point_inputs, 2 * weights[:, :, None])
    return H.matrix((layout.size, layout.size))


def _rate_cost(inputs: Indices, h: Array, size: int) -> Matrix:
    """Return the Hessian of the sum over the N - 1 steps of h |(u_(k+1) - u_k) / h|^2; inputs are (N, m)."""
    H, step = Entries(), find_steps(h)[:, None]
    before, after = inputs[:-1], inputs[1:]
    for row in (before, after):
        for col in (before, after):
            H.put(row, col, 2 / step if row is col else -2 / step)
    return H.matrix((size, size))


def _rate_costs(inputs: Indices, horizon: int, h: Array, row: int) -> list[Block]:
    """Return the same sum as a function of the inputs and the horizon, as the term `row` of the cost."""
    N, m = inputs.shape
    if N == 1 or not m:
        return []
    columns = (inputs[:-1].T, inputs[1:].T, np.full((1, N - 1), horizon))
    rows, scale = np.full((1, N - 1), row), (1 / N) / find_steps(h)
    return [Block(formulas.square_rates(m, N), columns, rows, np.arange(N - 1), scale=scale)]


def _input_costs(layout: Layout, horizon: int, h: Array, weights: Array) -> list[Block]:
    """Return the same two terms as functions of the inputs and the horizon, of which h and the weights are parts."""
    (N, S, polynomials), m = layout.point_inputs.shape, layout.inputs.shape[1]
    if polynomials:
        rows, interval = np.zeros((1, N * S), dtype=np.int64), np.repeat(np.arange(N), S)
        columns = (layout.point_inputs.reshape(N * S, polynomials).T,)
        function = formulas.square_inputs(polynomials)
        return [Block(function, columns, rows, interval, scale=weights.ravel(), factor=horizon)]
    if not m:
        return []
    rows, interval = np.zeros((1, N), dtype=np.int64), np.arange(N)
    inputs = Block(formulas.square_inputs(m), (layout.inputs.T,), rows, interval, scale=h, factor=horizon)
    return [inputs, *_rate_costs(layout.inputs, horizon, h, 1)]


def find_steps(h: Array) -> Array:
    """Return the distances, (N - 1,), of the midpoints of intervals."""
    return (h[:-1] + h[1:]) / 2
