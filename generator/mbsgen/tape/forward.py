"""Forward differentiation: Tape of f -> Tape of its Jacobian, equation by equation.

For v = op(a, b): dv = d op/da da + d op/db db, with da, db the sparse gradients of the operands (Griewank, Walther,
2008, ch. 3). Only structural nonzeros are propagated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

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


def propagate(tape: Tape, builder: Builder, values: Sequence[Scalar], wrt: Sequence[str]) -> Gradients:
    """Compute the nonzero derivatives of every value of a replayed tape by the nonzeros of the inputs `wrt`."""
    one = builder.number(1.0)
    given: list[Gradient] = []
    for i in tape.inputs:
        first = len(given)
        given.extend({first + k: one} if i.name in wrt else {} for k in range(i.sparsity.nnz))
    return carry(tape, builder, values, given)


def carry(tape: Tape, builder: Builder, values: Sequence[Scalar], given: Sequence[Gradient]) -> Gradients:
    """Compute the nonzero derivatives of every value of a replayed tape from the derivatives of its input nonzeros."""
    gradients: list[_Refs] = [{column: x.ref for column, x in own.items()} for own in given]
    gradients += ({} for _ in tape.literals)
    for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
        first, second = gradients[a], gradients[b] if b >= 0 else _NOTHING
        if not first and not second:
            gradients.append({})
            continue
        slopes = partials(builder, op, values[a], values[b] if b >= 0 else None, values[value])
        found = _scale(builder, slopes[0].ref, first)
        if second:
            found = _add(builder, found, slopes[1].ref, second)
        gradients.append(found)
    return Gradients(builder, gradients)


_Refs = dict[int, Ref]  # a gradient by references
_NOTHING: _Refs = {}


class Gradients(Sequence[Gradient]):
    """The gradients of all values; few are read."""

    def __init__(self, builder: Builder, refs: Sequence[_Refs]) -> None:
        self._builder, self._refs = builder, refs

    def __len__(self) -> int:
        return len(self._refs)

    @overload
    def __getitem__(self, value: int) -> Gradient: ...
    @overload
    def __getitem__(self, value: slice) -> list[Gradient]: ...
    def __getitem__(self, value: int | slice) -> Gradient | list[Gradient]:
        if isinstance(value, slice):
            return [self[k] for k in range(*value.indices(len(self)))]
        return {column: Scalar(self._builder, ref) for column, ref in self._refs[value].items()}


def _scale(builder: Builder, slope: Ref, gradient: _Refs) -> _Refs:
    mul = builder.mul
    return {column: mul(slope, derivative) for column, derivative in gradient.items()}


def _add(builder: Builder, total: _Refs, slope: Ref, gradient: _Refs) -> _Refs:
    """Add a multiple of a gradient, and leave out what cancels."""
    add, mul, cancels = builder.add, builder.mul, False
    for column, derivative in gradient.items():
        found = mul(slope, derivative)
        if column in total:
            found = add(total[column], found)
            cancels = cancels or not found
        total[column] = found
    return {column: ref for column, ref in total.items() if ref} if cancels else total


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
