"""Counts, against hands."""

from __future__ import annotations

from mbsgen.tape.builder import Builder
from mbsgen.tape.counts import count
from mbsgen.tape.types import Sparsity


def test_counts_by_hand():
    """y0 = s c / x + s c, y1 = -x, y2 = sqrt(s c)."""
    b = Builder()
    (x,) = b.vector("x", 1)
    product = b.sin(x) * b.cos(x)
    b.output("y", Sparsity.dense(3), [product / x + product, -x, b.sqrt(product)])
    counts = count(b.build("f"))
    assert counts.arithmetic == 3  # one product, one quotient, one sum
    assert counts.paper == 7  # and sin, cos, sqrt, unary minus
    assert counts.equations == 6  # sin, cos, their product, and three outputs; the quotient is inlined
    assert counts.guards == 0


def test_an_input_given_out_is_no_equation():
    b = Builder()
    x = b.vector("x", 2)
    b.output("y", Sparsity.dense(2), x)
    assert count(b.build("f")).equations == 0


def test_a_sum_of_any_length_is_one_equation():
    """As in the elimination, where all that is subtracted from an entry of M is one."""
    b = Builder()
    x = b.vector("x", 8)
    total = x[0]
    for k in range(1, 7):
        total = total - x[k] * x[k + 1]
    b.output("y", Sparsity.dense(1), [total])
    assert count(b.build("f")).equations == 1
