"""Counting without writing: as many flops as in the tape written with the zeros, except for signs."""

from __future__ import annotations

import numpy as np

from mbsgen.formulations import ports
from mbsgen.tape.builder import Builder
from mbsgen.tape.counts import count
from mbsgen.tape.passes import hoist
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Tape
from mbsgen.tape.zeros import count_without


def write() -> Tape:
    """Write a tape that has each way of becoming 0, and each of becoming a copy."""
    b = Builder()
    (p, r, s), (x, y) = b.vector(ports.PARAMETERS, 3), b.vector("x", 2)
    product = p * x + y
    turned = b.sin(r * x) * y + s * (x + y)
    b.output_dense(
        "z", [[product * turned], [b.sqrt(p * p) * x / (y + b.number(2.0))], [b.sin(s * y) * (x - (p + r) * y)]]
    )
    return b.build("f")


def written_without(tape: Tape, zeros: tuple[bool, ...]) -> int:
    """Write a tape with entries of `p` 0, and count it without operations on `p` alone."""
    b = Builder()
    p, x = b.vector(ports.PARAMETERS, 3), b.vector("x", 2)
    left = [b.zero if zero else entry for zero, entry in zip(zeros, p, strict=True)]
    values = replay(tape, b, {"p": left, "x": x})
    for o in tape.outputs:
        b.output(o.port, o.sparsity, [values[v] for v in o.values])
    (kernel,) = hoist([b.build("f")], ports.PARAMETERS, ports.SETUP)[1]
    return count(kernel).paper


def test_counts_are_those_of_the_tapes_that_would_be_written() -> None:
    tape = write()
    every = [tuple(bool(k >> i & 1) for i in range(3)) for k in range(8)]
    found = count_without(tape, "p", np.array(every))
    assert list(found) == [written_without(tape, zeros) for zeros in every]
    assert len(set(found)) > 4
