"""Tapes of sums and products, and whether two of them compute the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.interpreter import DIGITS, evaluate
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


def assert_same(tape: Tape, shared: Tape) -> None:
    size = tape.inputs[0].sparsity.nnz
    given = {"x": [DIGITS.literal(float(x)) for x in np.random.default_rng(1).uniform(-1, 1, size)]}
    expected, found = (evaluate(x, given, DIGITS)["y"] for x in (tape, shared))
    for a, b in zip(expected, found, strict=True):
        assert abs(a - b) <= 1e-40 * max(1, abs(a))
    assert len(shared.guards) == len(tape.guards)
    assert all(op in Op for op, _, _ in shared.operations)
