"""Counts, against hands."""

from __future__ import annotations

from mbsgen.tape.builder import Builder
from mbsgen.tape.counts import count, equation_values
from mbsgen.tape.types import Sparsity


def test_counts_by_hand():
    """y0 = s c / x, y1 = -x, y2 = sqrt(s c): s, c and s c are used twice or given out."""
    b = Builder()
    (x,) = b.vector("x", 1)
    product = b.sin(x) * b.cos(x)
    b.output("y", Sparsity.dense(3), [product / x + product, -x, b.sqrt(product)])
    counts = count(b.build("f"))
    assert counts.arithmetic == 3  # one product, one quotient, one sum
    assert counts.paper == 7  # and sin, cos, sqrt, unary minus
    assert counts.equations == 4  # the product, and three outputs; sin, cos and the quotient are inlined


def test_an_input_given_out_is_no_equation():
    b = Builder()
    x = b.vector("x", 2)
    b.output("y", Sparsity.dense(2), x)
    assert equation_values(b.build("f")) == ()
