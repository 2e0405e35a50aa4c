"""Derivatives of expressions: against second-order jets, and the functions that have none."""

from __future__ import annotations

import numpy as np
import pytest

from mbsgen.expressions import FUNCTIONS, Expression, ExpressionError, Number, evaluate, parse
from mbsrun.differentiation import MAX_TERMS, differentiate
from mbsrun.jets import make_jets, vary
from mbsrun.simulation.drive import ARRAYS

TEXTS = (
    "3",
    "t",
    "-t + 2*t - (1 - t)",
    "(t + 1)/(2 + t**2)",
    "t**3 - t**-2 + (1 + t)**0 + t**1",
    "sin(2*t)*cos(t)",
    "tan(t/2)",
    "asin(t/3) + acos(t/4)",
    "atan(t**2)",
    "sqrt(1 + t)",
    "exp(-t**2)",
    "log(2 + t)",
    "tanh(3*t)",
    "atan2(sin(t), 1 + t)",
    "step(t - 0.4, 0.3)",
    "step(0.3, 0.2 + t)",
    "softplus(t - 0.5, 0.3)",
    "softplus(t, 0.1 + t**2)",
    "pi*t + a*t + max(a, 1)*t + abs(a)",
    "sin(cos(exp(t/3)))",
)


@pytest.mark.parametrize("text", TEXTS)
def test_derivatives_are_those_of_jets(text: str) -> None:
    """Jets carry value and two derivatives through each operation, by other formulas."""
    t = np.linspace(0.1, 0.9, 9)
    algebra = make_jets(1)
    jet = evaluate(parse(text), {"t": vary(t, 0, 1), "a": algebra.number(0.7)}, algebra)
    expression: Expression = parse(text)
    for wanted in (jet.f, jet.g[..., 0], jet.H[..., 0, 0]):
        found = evaluate(expression, {"t": t, "a": np.array([0.7])}, ARRAYS)
        assert np.broadcast_to(found, t.shape) == pytest.approx(np.broadcast_to(wanted, t.shape), rel=1e-11, abs=1e-11)
        expression = differentiate(expression, "t")


def test_all_functions_are_differentiated_or_have_a_kink() -> None:
    for name, count in FUNCTIONS.items():
        text = f"{name}({', '.join(['t', 'a'][:count])})"
        if name in ("abs", "max", "min"):
            with pytest.raises(ExpressionError, match="has a kink, so it is not twice differentiable"):
                differentiate(parse(text), "t")
            assert differentiate(parse(text), "b") == Number(0)
        else:
            assert differentiate(parse(text), "t") != Number(0)


def test_a_derivative_has_a_bounded_size() -> None:
    text = "t"
    for _ in range(12):
        text = f"sin({text})*t"
    first = differentiate(parse(text), "t")
    with pytest.raises(ExpressionError, match=f"a derivative has [0-9]+ terms, of {MAX_TERMS} at most"):
        differentiate(first, "t")
