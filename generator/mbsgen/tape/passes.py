"""Passes: functions Tape -> Tape that keep the values of the results and lower their cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_uses
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.replay import declare_inputs, leaves, operate, replay, replay_guards
from mbsgen.tape.types import Guard, Sparsity, Tape


def drop_dead(tape: Tape) -> Tape:
    """Remove the operations that no output needs."""
    builder = Builder(fold=False, number=False)
    values = replay(tape, builder, declare_inputs(tape, builder))
    for output in tape.outputs:
        builder.output(output.port, output.sparsity, [values[v] for v in output.values])
    replay_guards(tape, builder, values)
    return builder.build(tape.function)


def merge(tapes: Sequence[Tape], function: Function) -> Tape:
    """Merge tapes into one, with the inputs of all; shared operations are computed once. Results keep their names."""
    builder = Builder()
    inputs: dict[str, list[Scalar]] = {}
    for given in dict.fromkeys(i for tape in tapes for i in tape.inputs):
        inputs[given.name] = builder.input(given.port, given.sparsity)
    for tape in tapes:
        values = replay(tape, builder, inputs)
        for o in tape.outputs:
            builder.output(o.port, o.sparsity, [values[v] for v in o.values])
        replay_guards(tape, builder, values)
    return builder.build(function)


def set_zero(tape: Tape, role: Role) -> Tape:
    """Replace the inputs of a role by zeros, and take them away."""
    builder = Builder()
    inputs = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs if i.port.role is not role}
    inputs |= {i.name: [builder.zero] * i.sparsity.nnz for i in tape.inputs if i.port.role is role}
    values = replay(tape, builder, inputs)
    for o in tape.outputs:
        found = [values[v] for v in o.values]
        if o.sparsity.is_dense:
            builder.output(o.port, o.sparsity, found)
        else:
            places = dict(zip(o.sparsity.entries, found, strict=True))
            builder.output_nonzeros(o.port, o.sparsity.rows, o.sparsity.cols, places)
    replay_guards(tape, builder, values)
    return builder.build(tape.function)


def keep_results(tape: Tape, names: Collection[str]) -> Tape:
    """Remove all results except some, and the operations that only the removed results need."""
    return drop_dead(replace(tape, outputs=tuple(o for o in tape.outputs if o.name in names)))


def drop_unused_inputs(tape: Tape) -> Tape:
    """Leave out the inputs of which nothing is read."""
    uses, builder = count_uses(tape), Builder(fold=False, number=False)
    read: set[str] = set()
    first = 0
    for i in tape.inputs:
        read |= {i.name for k in range(i.sparsity.nnz) if uses[first + k]}
        first += i.sparsity.nnz
    if len(read) == len(tape.inputs):
        return tape
    inputs = {
        i.name: builder.input(i.port, i.sparsity) if i.name in read else [builder.zero] * i.sparsity.nnz
        for i in tape.inputs
    }
    values = replay(tape, builder, inputs)
    for o in tape.outputs:
        builder.output(o.port, o.sparsity, [values[v] for v in o.values])
    replay_guards(tape, builder, values)
    return builder.build(tape.function)


def hoist(tapes: Sequence[Tape], source: Port, target: Port) -> tuple[Tape, tuple[Tape, ...]]:
    """Move what depends on the input `source` alone out of all tapes into one: the setup.

    Returns the setup tape (input `source`, output `target`), and the tapes with the input `target`, a vector of the
    values that they use, in place of `source`. Each entry has the sign that most of its uses need. Values that several
    tapes use are computed once. Divisions by parameters are guarded in the setup; pivots stay guarded where a kernel
    divides by them, even if they depend on parameters alone.
    """
    setup = Builder()
    sizes = {i.sparsity.nnz for tape in tapes for i in tape.inputs if i.port == source}
    assert len(sizes) <= 1, f"all tapes must have the same input {source.name}"
    given = setup.vector(source, sizes.pop() if sizes else 0)
    split = [_Split.of(tape, source, setup, given) for tape in tapes]
    signs: Counter[int] = Counter()  # of each node of the setup: uses with its sign less uses with the other sign
    for part in split:
        for value in part.frontier:
            ref, weight = part.hoisted[value].ref, len(tapes) + 1 if value in part.exact else 1
            signs[abs(ref)] += weight if ref > 0 else -weight
        part.guard_early(setup)
    entries = {node if signs[node] >= 0 else -node: place for place, node in enumerate(signs)}
    setup.output(target, Sparsity.dense(len(entries)), [Scalar(setup, ref) for ref in entries])
    return setup.build("setup"), tuple(part.rest(entries, target) for part in split)


class _Split:
    """A tape with its values split: values that depend on the parameters alone, and the rest."""

    def __init__(self, tape: Tape, source: Port, hoisted: dict[int, Scalar], frontier: list[int]) -> None:
        self.tape, self.source, self.hoisted, self.frontier = tape, source, hoisted, frontier

    @staticmethod
    def of(tape: Tape, source: Port, setup: Builder, given: Sequence[Scalar]) -> _Split:
        inputs = {i.name: given if i.port == source else [setup.zero] * i.sparsity.nnz for i in tape.inputs}
        hoisted = dict(enumerate(leaves(tape, setup, inputs)))
        place = 0
        for i in tape.inputs:
            for value in range(place, place := place + i.sparsity.nnz):
                if i.port != source:
                    del hoisted[value]
        frontier: dict[int, None] = {}
        for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
            operands = (a, b)[: op.arity]
            if all(x in hoisted for x in operands):
                hoisted[value] = operate(setup, op, hoisted[a], hoisted[b] if op.arity == 2 else None)
            else:
                frontier.update((x, None) for x in operands if x in hoisted)
        frontier.update((x, None) for o in tape.outputs for x in o.values if x in hoisted)
        left = [g for g in tape.guards if not (g.early and g.value in hoisted and g.scale in hoisted)]
        frontier.update((x, None) for g in left for x in (g.value, g.scale) if x in hoisted)
        literals = range(tape.first_literal, tape.first_operation)
        return _Split(tape, source, hoisted, [x for x in frontier if x not in literals and hoisted[x].ref])

    @property
    def exact(self) -> set[int]:
        """Return the values that are stored or tested as they are; other uses can take another sign."""
        return {x for o in self.tape.outputs for x in o.values} | {g.scale for g in self.tape.guards}

    def _is_early(self, guard: Guard) -> bool:
        return guard.early and guard.value in self.hoisted and guard.scale in self.hoisted

    def guard_early(self, setup: Builder) -> None:
        """Guard the divisors of the setup in the setup."""
        for g in filter(self._is_early, self.tape.guards):
            value = self.hoisted[g.value]
            setup.guard(-value if g.negated else value, self.hoisted[g.scale], g.tolerance, g.joint, early=True)

    def rest(self, entries: dict[int, int], target: Port) -> Tape:
        """Write the tape again, reading the hoisted values from `target`."""
        tape, builder = self.tape, Builder()
        inputs = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs if i.port != self.source}
        vector = builder.vector(target, len(entries))
        inputs |= {i.name: [builder.zero] * i.sparsity.nnz for i in tape.inputs if i.port == self.source}
        values = leaves(tape, builder, inputs)
        known = {x: self._entry(x, entries, vector) for x in self.frontier}
        for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
            operands = [known.get(x, values[x]) for x in (a, b)[: op.arity]]
            values.append(
                builder.zero
                if value in self.hoisted
                else operate(builder, op, operands[0], operands[1] if op.arity == 2 else None)
            )
        labelled = [(v, text) for v, text in sorted(tape.labels.items()) if v not in self.hoisted]
        builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
        for o in tape.outputs:
            builder.output(o.port, o.sparsity, [known.get(x, values[x]) for x in o.values])
        for g in (g for g in tape.guards if not self._is_early(g)):
            pivot, scale = (known.get(x, values[x]) for x in (g.value, g.scale))
            builder.guard(-pivot if g.negated else pivot, scale, g.tolerance, g.joint, early=g.early)
        return builder.build(tape.function)

    def _entry(self, value: int, entries: dict[int, int], vector: Sequence[Scalar]) -> Scalar:
        ref = self.hoisted[value].ref
        return vector[entries[ref]] if ref in entries else -vector[entries[-ref]]
