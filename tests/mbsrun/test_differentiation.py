"""Derivatives of expressions: against second-order jets and differences, and the functions that have none."""

from __future__ import annotations

import numpy as np
import pytest

from mbsgen.expressions import FLOATS, FUNCTIONS, Expression, Name, Number, evaluate, parse
from mbsrun.differentiation import MAX_TERMS, DerivativeError, differentiate, differentiate_by
from mbsrun.jets import make_jets, vary
from mbsrun.simulation.drive import ARRAYS

KINKS = ("abs", "max", "min")
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
        expression = differentiate_by(expression, "t")


def test_all_functions_are_differentiated_or_have_a_kink() -> None:
    for name, count in FUNCTIONS.items():
        text = f"{name}({', '.join(['t', *'abcdefg'][:count])})"
        if name in KINKS:
            with pytest.raises(DerivativeError, match=rf"{name}\(.*\) has a kink, where it has no derivative"):
                differentiate_by(parse(text), "t")
            assert differentiate_by(parse(text), "z") == Number(0)
        elif name == "bezier":
            with pytest.raises(DerivativeError, match=r"bezier\(.*\) is not differentiated here"):
                differentiate_by(parse(text), "t")
        else:
            assert differentiate_by(parse(text), "t") != Number(0)


def test_a_derivative_has_a_bounded_size() -> None:
    text = "t"
    for _ in range(12):
        text = f"sin({text})*t"
    first = differentiate_by(parse(text), "t")
    with pytest.raises(DerivativeError, match=f"a derivative has [0-9]+ terms, of {MAX_TERMS} at most"):
        differentiate_by(first, "t")


RATED = [
    *(f"{name}(0.3*x + 0.1*y)" for name, count in FUNCTIONS.items() if count == 1 and name not in KINKS),
    *(f"{name}(x*y, 0.4 + y)" for name, count in FUNCTIONS.items() if count == 2 and name not in KINKS),
    "a*x - (y - 2*x)/(x*y) + 3",
    "-x**3 + y**-2 - pi",
    "a/(1 + x**2)*a",
]


@pytest.mark.parametrize("text", RATED)
def test_a_rate_is_the_limit_of_differences(text: str) -> None:
    at, speed, step = {"a": 1.7, "x": 0.8, "y": 1.3}, {"x": 0.6, "y": -1.1}, 1e-6
    rate = differentiate(parse(text), {name: Name(f"{name}d") for name in speed})
    found = evaluate(rate, at | {f"{name}d": value for name, value in speed.items()}, FLOATS)
    ahead, behind = (
        evaluate(parse(text), at | {name: at[name] + s * speed[name] for name in speed}, FLOATS) for s in (step, -step)
    )
    assert found == pytest.approx((ahead - behind) / (2 * step), rel=1e-7, abs=1e-9)


def test_constants_do_not_change() -> None:
    assert evaluate(differentiate(parse("sin(a)**2/b"), {"x": Name("xd")}), {}, FLOATS) == 0.0


@pytest.mark.parametrize("function", KINKS)
def test_a_kink_has_no_rate(function: str) -> None:
    with pytest.raises(DerivativeError, match=f"{function}.* has a kink"):
        differentiate(parse(f"{function}(x, 1)" if FUNCTIONS[function] == 2 else f"{function}(x)"), {"x": Name("xd")})
