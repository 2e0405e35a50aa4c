"""Numbers of a Tree: doubles exactly, the irrational to 60 digits, zeros where they are."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sympy import Expr, Float, Integer, Rational, Symbol

from mbsgen.expressions import ExpressionError, evaluate, parse
from mbsgen.model.symbols import check_powers, exact, round_number, symbolic, to_double, total

X, K = Symbol("x"), Symbol("k")
ALGEBRA = symbolic({K: exact(0.3)})


def read(text: str) -> Expr:
    return evaluate(parse(text), {"x": X, "k": K}, ALGEBRA)


@given(st.floats(allow_nan=False, allow_infinity=False))
@settings(derandomize=True, deadline=None)
def test_a_double_stays_what_it_is(value: float) -> None:
    assert to_double(exact(value)) == value
    assert round_number(exact(value)) == exact(value)


@pytest.mark.parametrize(
    "text", ["0", "-0.0", "x - x", "0*x", "pi - pi", "cos(pi/2)", "sin(pi)", "x*cos(-pi/2)", "tan(pi)"]
)
def test_zeros_are_structural(text: str) -> None:
    assert read(text) is Integer(0)


@pytest.mark.parametrize("text", ["1e-300", "exp(-200)", "sin(1e-60)", "sqrt(1e-200)", "1e-60*pi", "cos(pi/2 + 1e-45)"])
def test_small_numbers_are_no_zeros(text: str) -> None:
    assert read(text) != 0


@pytest.mark.parametrize(
    "text", ["cos(0)", "sin(pi/2)", "sqrt(4) - 1", "cos(pi/5)**2 + sin(pi/5)**2", "atan2(1, 1)*4/pi"]
)
def test_ones_that_multiply_nothing_are_found(text: str) -> None:
    assert to_double(read(text)) == 1
    assert read(f"x*({text}) - x") is Integer(0)


def test_literals_are_their_doubles() -> None:
    assert read("0.1") == Rational(3602879701896397, 36028797018963968)
    assert read("x/3") == X / 3


def test_irrational_numbers_have_60_digits() -> None:
    digits = "3.14159265358979323846264338327950288419716939937510582097494"
    assert isinstance(read("pi"), Float)
    assert str(read("pi")) == digits


def test_functions_of_constants_are_numbers_and_of_symbols_symbolic() -> None:
    assert to_double(read("cos(k)")) == pytest.approx(0.955336489125606, rel=1e-15)
    assert str(read("k*x + sqrt(x) + tan(x)")) == "k*x + sqrt(x) + sin(x)/cos(x)"
    assert str(read("exp(x) + tanh(2*x)*abs(x) + atan2(x, 1)")) == "exp(x) + tanh(2*x)*Abs(x) + atan2(x, 1)"


@pytest.mark.parametrize("text", ["sqrt(2*sqrt(x))", "exp(0.3*log(x))", "1 + tanh(x)/exp(0.3*log(x))"])
def test_powers_that_code_does_not_compute_are_refused(text: str) -> None:
    """SymPy writes both as powers of x."""
    with pytest.raises(ExpressionError, match="neither whole nor a square root"):
        check_powers(read(text))


def test_powers_that_code_computes_are_not() -> None:
    check_powers(read("sqrt(x)**3/x + 1/sqrt(1 + x**2) + exp(2*log(x)) + exp(x*log(x))"))


@pytest.mark.parametrize(
    "text",
    ["1/0", "1/(x - x)", "x/cos(pi/2)", "tan(pi/2)", "sqrt(-1)", "log(0)", "acos(2)", "exp(800)", "exp(exp(exp(9)))"],
)
def test_what_has_no_value_is_refused(text: str) -> None:
    with pytest.raises(ExpressionError, match="has no value"):
        read(text)


def test_sums_drop_what_cancels_and_keep_the_rest() -> None:
    third = exact(1.0) / 3
    root = read("sqrt(2)")
    assert total([root * X, third, -root * X]) == third
    assert total([X, X]) == 2 * X


@pytest.mark.parametrize(
    ("text", "finding"), [("1e308*10", "beyond the largest"), ("1e-300*1e-300", "below the smallest")]
)
def test_numbers_that_no_double_is_near_are_told(text: str, finding: str) -> None:
    with pytest.raises(ExpressionError, match=finding):
        to_double(read(text))
