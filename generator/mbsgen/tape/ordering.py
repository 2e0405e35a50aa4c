"""The order of operations: the same tape, with sines and cosines side by side and few live values at a time.

A processor has some dozen registers. Values that must be kept while others are computed go to memory and come back;
long kernels spend their time on this. The order in depth follows Sethi, Ullman (1970): the deepest operand first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mbsgen.tape.types import Op, Tape

_TRIGONOMETRIC = (Op.SIN, Op.COS)
Operands = Sequence[tuple[int, int]]  # of each operation; a single one twice


def arrange(tape: Tape) -> Tape:
    """Order the operations for a processor: result after result, if this keeps fewer values live at a time.

    The arguments of sines and cosines are computed first, so that all of these can be computed together.
    """
    operands = [(a, a if b < 0 else b) for _, a, b in tape.operations]
    stages = _find_stages(tape, operands)
    orders = (range(len(operands)), _follow_results(tape, operands))
    gathered = [sorted(order, key=stages.__getitem__) for order in orders]
    return _permute(tape, min(gathered, key=lambda order: _count_kept(tape.first_operation, operands, order)))


def _follow_results(tape: Tape, operands: Operands) -> list[int]:
    """Order the operations by the results that need them, depth first; guards come first, as they are tested first."""
    first = tape.first_operation
    depths = [0] * first  # the operations between each value and the leaves
    for a, b in operands:
        depths.append(1 + max(depths[a], depths[b]))
    roots = [v for g in tape.guards for v in (g.value, g.scale)] + [v for o in tape.outputs for v in o.values]
    done = [False] * len(operands)
    order: list[int] = []
    for root in roots:
        stack = [root - first]
        while stack:
            k = stack[-1]
            if k < 0 or done[k]:
                stack.pop()
                continue
            x, y = operands[k]
            a, b = x - first, y - first
            lacks_b = b >= 0 and not done[b]
            if a >= 0 and not done[a] and (not lacks_b or depths[x] >= depths[y]):
                stack.append(a)  # the deepest operand is taken first
            elif lacks_b:
                stack.append(b)
            else:
                done[k] = True
                order.append(k)
    return order


def _find_stages(tape: Tape, operands: Operands) -> list[int]:
    """Number the operations such that sorting by the number gathers sines, with their arguments before them.

    There are several such groups where angles depend on sines.
    """
    first = tape.first_operation
    are_sines = [op in _TRIGONOMETRIC for op, _, _ in tape.operations]
    levels = [0] * first  # the length of the chain of sines, each an argument of the next, below a value
    for is_sine, (a, b) in zip(are_sines, operands, strict=True):
        x, y = levels[a], levels[b]
        levels.append((x if x > y else y) + is_sine)
    last = 1 + max(levels, default=0)
    groups = [last] * len(levels)  # the group that a value belongs to, or is needed for
    for k in range(len(operands) - 1, -1, -1):
        if are_sines[k]:
            groups[first + k] = levels[first + k]
        own = groups[first + k]
        a, b = operands[k]
        if own < groups[a]:
            groups[a] = own
        if own < groups[b]:
            groups[b] = own
    return [2 * group + is_sine for group, is_sine in zip(groups[first:], are_sines, strict=True)]


def _permute(tape: Tape, order: Sequence[int]) -> Tape:
    """Write the operations with these positions, and no others, in this order."""
    first = tape.first_operation
    numbers = {value: value for value in range(-1, first)} | {first + k: first + n for n, k in enumerate(order)}
    ordered = (tape.operations[k] for k in order)
    return replace(
        tape,
        operations=tuple((op, numbers[a], numbers[b]) for op, a, b in ordered),
        outputs=tuple(replace(o, values=tuple(numbers[v] for v in o.values)) for o in tape.outputs),
        guards=tuple(replace(g, value=numbers[g.value], scale=numbers[g.scale]) for g in tape.guards),
        labels={numbers[v]: label for v, label in tape.labels.items() if v in numbers},
    )


def _count_kept(first: int, operands: Operands, order: Sequence[int]) -> int:
    """Return the sum, over the operations in an order, of the number of values that later operations read."""
    last = [-1] * (first + len(operands))  # the place of the last operation that reads a value
    for place, k in enumerate(order):
        a, b = operands[k]
        last[a] = last[b] = place
    return sum(end - place for place, k in enumerate(order) if (end := last[first + k]) >= 0)
