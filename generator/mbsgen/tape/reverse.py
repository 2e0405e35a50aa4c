"""Reverse differentiation: Tape of f -> Tape of its adjoint JT lambda, or of its Jacobian, row by row.

In reverse order, for v = op(a, b): a_bar += d op/da v_bar and b_bar += d op/db v_bar (Griewank, Walther, 2008, ch. 3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mbsgen.roles import Order
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.partials import partials
from mbsgen.tape.ports import adjoint_port, derivative_port, seed_port
from mbsgen.tape.replay import declare_inputs, replay, replay_guards
from mbsgen.tape.types import Tape


def adjoint(tape: Tape, wrt: Sequence[str]) -> Tape:
    """Write the adjoint: inputs of `tape`, then `adj_<out>`; outputs `adj_<in>`, dense, for the inputs `wrt`."""
    builder = Builder()
    values = replay(tape, builder, declare_inputs(tape, builder))
    replay_guards(tape, builder, values)
    seeds: dict[int, Scalar] = {}
    for output in tape.outputs:
        for value, seed in zip(output.values, builder.input(seed_port(output.port), output.sparsity), strict=True):
            seeds[value] = seeds[value] + seed if value in seeds else seed
    adjoints = sweep(tape, builder, values, seeds)
    first = 0
    for i in tape.inputs:
        if i.name in wrt:
            found = [adjoints.get(first + k, builder.zero) for k in range(i.sparsity.nnz)]
            builder.output(adjoint_port(i.port), i.sparsity, found)
        first += i.sparsity.nnz
    return builder.build(tape.function.to(Order.ADJOINT))


def jacobian(tape: Tape, wrt: Sequence[str]) -> Tape:
    """Compute the same outputs as `forward.jacobian`, by one reverse sweep for each output nonzero."""
    builder = Builder()
    values = replay(tape, builder, declare_inputs(tape, builder))
    replay_guards(tape, builder, values)
    one = builder.number(1.0)
    for output in tape.outputs:
        rows = {
            r + c * output.sparsity.rows: sweep(tape, builder, values, {value: one})
            for (r, c), value in zip(output.sparsity.entries, output.values, strict=True)
        }
        first = 0
        for i in tape.inputs:
            if i.name in wrt:
                entries = {
                    (row, k): adjoints[first + k]
                    for row, adjoints in rows.items()
                    for k in range(i.sparsity.nnz)
                    if first + k in adjoints
                }
                numel = output.sparsity.rows * output.sparsity.cols
                builder.output_nonzeros(derivative_port(output.port, i.port), numel, i.sparsity.nnz, entries)
            first += i.sparsity.nnz
    return builder.build(tape.function.to(Order.JACOBIAN))


def sweep(tape: Tape, builder: Builder, values: Sequence[Scalar], seeds: Mapping[int, Scalar]) -> dict[int, Scalar]:
    """Propagate adjoints of values back to the inputs of a replayed tape; unreached inputs are left out."""
    adjoints = {value: x.ref for value, x in seeds.items()}
    add, mul, operations = builder.add, builder.mul, tape.operations
    first, end = tape.first_literal, tape.first_operation
    for value in range(max(seeds, default=-1), end - 1, -1):
        own = adjoints.pop(value, 0)
        if not own:
            continue
        op, a, b = operations[value - end]
        slopes = partials(builder, op, values[a], values[b] if b >= 0 else None, values[value])
        for operand, slope in zip((a, b), slopes, strict=False):
            if not first <= operand < end:
                product = mul(own, slope.ref)
                adjoints[operand] = add(adjoints[operand], product) if operand in adjoints else product
    return {value: Scalar(builder, ref) for value, ref in adjoints.items() if value < first and ref}
