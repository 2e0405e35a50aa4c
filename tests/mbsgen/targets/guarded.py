"""A tape with two guards."""

from __future__ import annotations

from mbsgen.tape.builder import Builder
from mbsgen.tape.types import Tape

TOLERANCE = 8.0  # of both guards, in roundings


def guarded_tape() -> Tape:
    """Write f = (x0/y0, x1/(y0 y1)), as elimination would: y0 is the pivot of joint 2, y0 y1, beside y2, of joint 3."""
    b = Builder()
    x, y = b.vector("x", 2), b.vector("y", 3)
    second = y[0] * y[1]
    b.output_dense("f", [[x[0] / y[0]], [x[1] / second]])
    b.guard(y[0], b.number(1.0), TOLERANCE, 2)
    b.guard(second, y[2], TOLERANCE, 3)
    return b.build("impl")
