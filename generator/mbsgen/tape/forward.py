"""Forward differentiation: Tape of f -> Tape of its Jacobian, equation by equation.

For v = op(a, b): dv = d op/da da + d op/db db, with da, db the sparse gradients of the operands (Griewank, Walther,
2008, ch. 3). Only structural nonzeros are propagated.
"""

from __future__ import annotations

from collections.abc import Sequence

from mbsgen.roles import Order
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.partials import partials
from mbsgen.tape.ports import derivative_port
from mbsgen.tape.replay import declare_inputs, replay, replay_guards
from mbsgen.tape.types import Input, Output, Tape
from mbsgen.tape.writer import Ref

Gradient = dict[int, Scalar]  # nonzero derivatives of one value, by column: the position among all input nonzeros


def jacobian(tape: Tape, wrt: Sequence[str]) -> Tape:
    """Differentiate every output of `tape` by the dense columns `wrt`, forward.

    Outputs: `jac_<out>_<in>`, shape (numel(out), numel(in)), structural nonzeros only, in compressed-column order.
    """
    builder = Builder()
    values = replay(tape, builder, declare_inputs(tape, builder))
    replay_guards(tape, builder, values)
    gradients = propagate(tape, builder, values, wrt)
    for output in tape.outputs:
        for source in (tape.input(i) for i in wrt):
            write_block(builder, tape, output, source, gradients)
    return builder.build(tape.function.to(Order.JACOBIAN))


def propagate(tape: Tape, builder: Builder, values: Sequence[Scalar], wrt: Sequence[str]) -> list[Gradient]:
    """Compute the nonzero derivatives of every value of a replayed tape by the nonzeros of the inputs `wrt`."""
    one = builder.number(1.0)
    given: list[Gradient] = []
    for i in tape.inputs:
        first = len(given)
        given.extend({first + k: one} if i.name in wrt else {} for k in range(i.sparsity.nnz))
    return carry(tape, builder, values, given)


def carry(tape: Tape, builder: Builder, values: Sequence[Scalar], given: Sequence[Gradient]) -> list[Gradient]:
    """Compute the nonzero derivatives of every value of a replayed tape from the derivatives of its input nonzeros."""
    gradients: list[_Refs] = [{column: x.ref for column, x in own.items()} for own in given]
    gradients += ({} for _ in tape.literals)
    for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
        first, second = gradients[a], gradients[b] if b >= 0 else _NOTHING
        if not first and not second:
            gradients.append({})
            continue
        slopes = partials(builder, op, values[a], values[b] if b >= 0 else None, values[value])
        gradients.append(_combine(builder, slopes, (first, second)))
    return [{column: Scalar(builder, ref) for column, ref in own.items()} for own in gradients]


_Refs = dict[int, Ref]  # a gradient by references
_NOTHING: _Refs = {}


def _combine(builder: Builder, slopes: Sequence[Scalar], gradients: Sequence[_Refs]) -> _Refs:
    add, mul = builder.add, builder.mul
    total: _Refs = {}
    has_zeros = False
    for slope, gradient in zip(slopes, gradients, strict=False):
        factor = slope.ref
        for column, derivative in gradient.items():
            found = mul(factor, derivative)
            if column in total:
                found = add(total[column], found)
            total[column] = found
            has_zeros = has_zeros or not found
    return {column: ref for column, ref in total.items() if ref} if has_zeros else total


def write_block(
    builder: Builder,
    tape: Tape,
    given: Output,
    source: Input,
    gradients: Sequence[Gradient],
) -> None:
    """Declare the derivative of the output `given` by the input `source`."""
    first, numel_in = _first_column(tape, source.name), source.sparsity.rows * source.sparsity.cols
    places = [r + c * source.sparsity.rows for r, c in source.sparsity.entries]
    entries = {}
    for (r, c), value in zip(given.sparsity.entries, given.values, strict=True):
        row = r + c * given.sparsity.rows
        for column, derivative in gradients[value].items():
            if first <= column < first + source.sparsity.nnz:
                entries[row, places[column - first]] = derivative
    numel = given.sparsity.rows * given.sparsity.cols
    builder.output_nonzeros(derivative_port(given.port, source.port), numel, numel_in, entries)


def _first_column(tape: Tape, name: str) -> int:
    first = 0
    for i in tape.inputs:
        if i.name == name:
            return first
        first += i.sparsity.nnz
    raise KeyError(name)
