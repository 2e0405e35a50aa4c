"""Replay a tape into a builder, operation by operation: the common step of passes and differentiation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from mbsgen.manifest import FIRST_LENGTH
from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import PAPER
from mbsgen.tape.types import Op, Tape


def count_varying(tape: Tape, constant: Set[Role]) -> int:
    """Count the operations that are not on constants alone; inputs of the roles `constant` count as constants."""
    is_fixed = find_constants(tape, constant)[tape.first_operation :]
    return sum(op in PAPER and not fixed for (op, _, _), fixed in zip(tape.operations, is_fixed, strict=True))


def declare_inputs(tape: Tape, builder: Builder) -> dict[str, list[Scalar]]:
    """Declare the tape's inputs in the builder, unchanged."""
    return {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs}


def replay(tape: Tape, builder: Builder, inputs: Mapping[str, Sequence[Scalar]]) -> list[Scalar]:
    """Compute every value of `tape` in `builder` from the given nonzeros of its inputs; index by value."""
    refs = [value.ref for value in leaves(tape, builder, inputs)]
    operate = builder.operate
    for op, a, b in tape.operations:
        refs.append(operate(op, refs[a], refs[b] if b >= 0 else 0))
    values = [Scalar(builder, ref) for ref in refs]
    labelled = sorted(tape.labels.items())
    builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
    return values


def leaves(tape: Tape, builder: Builder, inputs: Mapping[str, Sequence[Scalar]]) -> list[Scalar]:
    """List the values that no operation computes: input nonzeros, then literals."""
    given = [value for i in tape.inputs for value in inputs[i.name]]
    return given + [builder.number(x) for x in tape.literals]


def operate(builder: Builder, op: Op, a: Scalar, b: Scalar | None) -> Scalar:
    """Apply one operation in the builder."""
    return Scalar(builder, builder.operate(op, a.ref, 0 if b is None else b.ref))


def replay_lengths(tape: Tape, builder: Builder, values: Sequence[Scalar]) -> None:
    """Guard the same lengths of force elements, where pivots are the caller's."""
    for guard in tape.guards:
        if guard.joint >= FIRST_LENGTH:
            length = -values[guard.value] if guard.negated else values[guard.value]
            builder.guard(length, values[guard.scale], guard.tolerance, guard.joint)


def replay_guards(
    tape: Tape, builder: Builder, values: Sequence[Scalar] | Mapping[int, Scalar], *, only_early: bool = False
) -> None:
    """Guard the same pivots in the builder, or only the divisions by parameters."""
    for guard in tape.guards:
        if guard.early or not only_early:
            pivot = -values[guard.value] if guard.negated else values[guard.value]
            builder.guard(pivot, values[guard.scale], guard.tolerance, guard.joint, early=guard.early)


def find_constants(tape: Tape, roles: Set[Role]) -> Sequence[bool]:
    """Return, for each value, whether it depends on literals and inputs of the given roles alone; a tape remembers."""
    known, key = tape.__dict__, f"constants by {sorted(role.name for role in roles)}"
    if key not in known:
        known[key] = _find_constants(tape, roles)
    found: Sequence[bool] = known[key]
    return found


def _find_constants(tape: Tape, roles: Set[Role]) -> list[bool]:
    found = [i.port.role in roles for i in tape.inputs for _ in range(i.sparsity.nnz)]
    found += [True] * len(tape.literals)
    for _, a, b in tape.operations:
        found.append(found[a] and (b < 0 or found[b]))
    return found
