"""The order of operations: the same tape, with sines and cosines side by side and few values to be kept at a time.

A processor has some dozen registers. What must be kept while other things are computed goes to memory and comes back,
and that is what long kernels spend their time with.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from mbsgen.tape.types import Op, Tape

_TRIGONOMETRIC = (Op.SIN, Op.COS)


def arrange(tape: Tape) -> Tape:
    """Order the operations for a processor: results one after the other where that keeps fewer values at a time.

    What sines and cosines are taken of is computed first, so that all of them can be computed together.
    """
    orders = (range(len(tape.operations)), _follow_results(tape))
    return min((_permute(tape, _gather_angles(tape, order)) for order in orders), key=_count_kept)


def _follow_results(tape: Tape) -> list[int]:
    """Order the operations by the results that need them, in depth: the guards come first, as they are tested."""
    first = tape.first_operation
    depths = _measure(tape)
    roots = [v for g in tape.guards for v in (g.value, g.scale)] + [v for o in tape.outputs for v in o.values]
    done: set[int] = set()
    order: list[int] = []
    for root in roots:
        stack = [(root, False)]
        while stack:
            value, are_operands_done = stack.pop()
            if value < first or value in done:
                continue
            if are_operands_done:
                done.add(value)
                order.append(value - first)
            else:
                op, *operands = tape.operations[value - first]
                stack.append((value, True))  # the deepest operand is taken first
                stack += [(x, False) for x in sorted(operands[: op.arity], key=depths.__getitem__)]
    return order


def _measure(tape: Tape) -> list[int]:
    """Count the operations between each value and the leaves."""
    depths = [0] * tape.first_operation
    for op, *operands in tape.operations:
        depths.append(1 + max(depths[x] for x in operands[: op.arity]))
    return depths


def _gather_angles(tape: Tape, order: range | list[int]) -> list[int]:
    """Move sines and cosines together, and what they are taken of before them; else the order remains.

    There are several such groups where angles depend on sines.
    """
    first = tape.first_operation
    levels = [0] * first  # how many sines, one of the other, a value depends on
    for op, *operands in tape.operations:
        levels.append(max(levels[x] for x in operands[: op.arity]) + (op in _TRIGONOMETRIC))
    last = 1 + max(levels, default=0)
    stages = [last] * len(levels)  # the group that a value is in, or is needed for
    for value in range(len(levels) - 1, first - 1, -1):
        op, *operands = tape.operations[value - first]
        stage = levels[value] if op in _TRIGONOMETRIC else stages[value]
        stages[value] = stage
        for x in operands[: op.arity]:
            stages[x] = min(stages[x], stage)
    return sorted(order, key=lambda k: (stages[first + k], tape.operations[k][0] in _TRIGONOMETRIC))


def _permute(tape: Tape, order: list[int]) -> Tape:
    """Write the operations of these places, and no others, in this order."""
    first = tape.first_operation
    numbers = {value: value for value in range(first)} | {first + k: first + n for n, k in enumerate(order)}
    operations = tuple(
        (op, numbers[a], numbers[b] if b >= 0 else b) for op, a, b in (tape.operations[k] for k in order)
    )
    return replace(
        tape,
        operations=operations,
        outputs=tuple(replace(o, values=tuple(numbers[v] for v in o.values)) for o in tape.outputs),
        guards=tuple(replace(g, value=numbers[g.value], scale=numbers[g.scale]) for g in tape.guards),
        labels={numbers[v]: label for v, label in tape.labels.items() if v in numbers},
    )


def _count_kept(tape: Tape) -> int:
    """Sum up, over the operations, the values that later ones read."""
    first = tape.first_operation
    last = {x: k for k, (op, *operands) in enumerate(tape.operations) for x in operands[: op.arity]}
    ends = Counter(k for x, k in last.items() if x >= first)
    kept = total = 0
    for k in range(len(tape.operations)):
        kept += (first + k in last) - ends[k]
        total += kept
    return total
