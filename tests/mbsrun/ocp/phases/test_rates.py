"""Time derivatives of expressions against differences."""

from __future__ import annotations

import pytest

from mbsgen.expressions import FLOATS, FUNCTIONS, ExpressionError, Name, evaluate, parse
from mbsrun.ocp.phases.rates import differentiate

KINKS = ("abs", "max", "min")
TEXTS = [
    *(f"{name}(0.3*x + 0.1*y)" for name, count in FUNCTIONS.items() if count == 1 and name not in KINKS),
    *(f"{name}(x*y, 0.4 + y)" for name, count in FUNCTIONS.items() if count == 2 and name not in KINKS),
    "a*x - (y - 2*x)/(x*y) + 3",
    "-x**3 + y**-2 - pi",
    "a/(1 + x**2)*a",
]


@pytest.mark.parametrize("text", TEXTS)
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
def test_a_kink_is_refused(function: str) -> None:
    with pytest.raises(ExpressionError, match=f"{function} has no rate in a map"):
        differentiate(parse(f"{function}(x, 1)" if FUNCTIONS[function] == 2 else f"{function}(x)"), {"x": Name("xd")})
