"""Tapes of sums and products, and whether two of them compute the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import mul

import numpy as np

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Op, Tape


def write(size: int, results: Callable[[Sequence[Scalar]], Sequence[Scalar]]) -> Tape:
    builder = Builder()
    x = builder.vector("x", size)
    builder.output_dense("y", [[y] for y in results(x)])
    return builder.build("sums")


def random_tape(seed: int) -> Tape:
    """Write sums of products of few numbers, so that much is common."""
    rng, builder = np.random.default_rng(seed), Builder()
    values = [*builder.vector("x", 5), builder.number(2.0)]
    for _ in range(120):
        a, b = (values[i] for i in rng.integers(max(0, len(values) - 12), len(values), 2))
        values.append([a + b, a - b, a * b, a * values[int(rng.integers(5))]][rng.integers(4)])
    builder.guard(values[-1] * values[-1] + values[0] * values[0], values[1] * values[1], 1.0, 1)
    builder.output_dense("y", [[x] for x in values[-20:]])
    return builder.build("random")


def random_brackets(seed: int) -> Tape:
    """Write sums that share brackets, with literals, parameters, functions, labels and outputs of both signs."""
    rng, builder = np.random.default_rng(seed), Builder()
    x, p = builder.vector("x", 6), builder.vector(Port("p", Role.PARAMETER), 3)
    values = [*x, *p, *(builder.number(k) for k in (2.0, 0.5, -3.0, 1.5, -0.25))]
    if seed % 4 == 0:
        values += [builder.sqrt(-x[0]), builder.apply(Op.EXP, -x[1])]
    if seed % 2:
        values += [builder.sin(x[2]), builder.cos(x[2]), x[0] / x[3], builder.apply(Op.TANH, x[1] - x[0])]

    def multiply(number: int) -> Scalar:
        return reduce(mul, [values[int(rng.integers(len(values)))] for _ in range(number)])

    brackets = [(multiply(1), multiply(1), bool(rng.integers(2))) for _ in range(6)]
    sums: list[Scalar] = []
    for _ in range(int(rng.integers(8, 40))):
        total = builder.zero
        for _ in range(int(rng.integers(1, 4))):
            (first, second, adds), factor = brackets[int(rng.integers(6))], multiply(1 + int(rng.integers(3)))
            total = total + factor * first if rng.integers(2) else total - factor * first
            total = total + factor * second if adds else total - factor * second
        total = total + multiply(3) if rng.integers(3) == 0 else total
        sums += [] if total.is_literal else [total]
        values += [total] if rng.integers(3) == 0 and not total.is_literal else []
        values += [multiply(2)] if rng.integers(4) == 0 else []
    for k, total in enumerate(sums[:3], 1):
        if rng.integers(2):
            builder.guard(total * total + x[0] * x[0], (total if k % 2 else -total) * x[1], 1.0, k)
    builder.label(sums, [f"n{k}" for k in range(len(sums))])
    builder.output_dense("y", [[y if rng.integers(2) else -y] for y in sums[1:] or [x[0]]])
    return builder.build("brackets")


def random_signs(seed: int) -> Tape:
    """Write sums that share brackets, and functions of both signs of them, also of labelled and guarded values."""
    rng, builder = np.random.default_rng(seed), Builder()
    x, p = builder.vector("x", 5), builder.vector(Port("p", Role.PARAMETER), 2)
    values = [*x, *p, *(builder.number(k) for k in (2.0, -3.0, 0.25))]

    def draw() -> Scalar:
        value = values[int(rng.integers(len(values)))]
        return value if rng.integers(2) else -value

    def apply(a: Scalar) -> Scalar:
        op = (Op.SQRT, Op.EXP, Op.ATAN2, Op.TANH)[int(rng.integers(4))]
        pair = (a, (draw(), -a, builder.zero)[int(rng.integers(3))])
        return builder.apply(op, *(pair[:1] if op is not Op.ATAN2 else pair if rng.integers(2) else pair[::-1]))

    brackets, shown = [(draw(), draw()) for _ in range(4)], list[Scalar]()
    for _ in range(int(rng.integers(8, 24))):
        (first, second), factor = brackets[int(rng.integers(4))], draw() * draw()
        total = factor * first + draw() * draw() + factor * second
        if not total.is_literal:
            values += [apply(total if rng.integers(2) else -total), total][: int(rng.integers(3))]
            shown += [total, values[-1]][: int(rng.integers(3))]
    builder.label(shown, [f"n{k}" for k in range(len(shown))])
    builder.label([-y for y in shown], [f"m{k}" for k in range(len(shown))])
    builder.guard(shown[-1] * shown[-1] + x[0] * x[0], -shown[-1] * x[1], 1.0, 1)
    builder.output_dense("y", [[y if rng.integers(2) else -y] for y in shown[:-1]])
    return builder.build("signs")


def assert_same(tape: Tape, shared: Tape) -> None:
    size = tape.inputs[0].sparsity.nnz
    given = {"x": [DIGITS.literal(float(x)) for x in np.random.default_rng(1).uniform(-1, 1, size)]}
    expected, found = (evaluate(x, given, DIGITS)["y"] for x in (tape, shared))
    for a, b in zip(expected, found, strict=True):
        assert abs(a - b) <= 1e-40 * max(1, abs(a))
    assert len(shared.guards) == len(tape.guards)
    assert all(op in Op for op, _, _ in shared.operations)
