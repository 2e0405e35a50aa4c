"""Expressions of untrusted files: Python's grammar for a few operations, bounded, and never run."""

from __future__ import annotations

import math
import operator
import random
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mbsgen.expressions import (
    CONSTANTS,
    FLOATS,
    FUNCTIONS,
    Algebra,
    Call,
    Constant,
    Expression,
    ExpressionError,
    Name,
    Negation,
    Number,
    Operation,
    Power,
    Program,
    evaluate,
    fold,
    is_free_name,
    names,
    parse,
    spell,
    write,
)

VALUES = {"a": 2.0, "b": 3.0, "l1": 0.3}

WORTH = {  # by hand
    "1e3": 1000.0,
    ".5": 0.5,
    "l1/2": 0.15,
    "a + b*2": 8.0,
    "(a + b)*2": 10.0,
    "a - b - 1": -2.0,
    "a - (b - 1)": 0.0,
    "12/b/a": 2.0,
    "12/(b/a)": 8.0,
    "-a**2": -4.0,
    "(-a)**2": 4.0,
    "a**-2": 0.25,
    "a**0.5": math.sqrt(2),
    "-a**1.5": -math.sqrt(8),
    "a**(2/3)": 2 ** (2 / 3),
    "l1**-0.25": 0.3**-0.25,
    "a**3.0": 8.0,
    "(a - 2)**0.5": 0.0,
    "--a": 2.0,
    "+a": 2.0,
    "-pi/2": -math.pi / 2,
    "sin(pi/6)": 0.5,
    "cos(0) + tan(0)": 1.0,
    "asin(1) + acos(1) + atan(0)": math.pi / 2,
    "atan2(1, -1)": 3 * math.pi / 4,
    "sqrt(16)": 4.0,
    "exp(log(7))": 7.0,
    "tanh(0)": 0.0,
    "abs(-a)": 2.0,
    "max(a, -b)": 2.0,
    "min(a, -b)": -3.0,
    "step(0, b)": 0.5,
    "step(a*log(b), a)": 0.75,
    "step(-1e9, 1e-9)": 0.0,
    "softplus(0, a)": 2 * math.log(2),
    "softplus(b*log(7), b)": 3 * math.log(8),
    "softplus(1e9, 1e-9)": 1e9,
    "softplus(-1e9, 1e-9)": 0.0,
    "smoothmax(a, a, b)": 2.0,
    "smoothmax(0, a*log(b), a)": 1.5 * math.log(3),
    "smoothmax(1e9, -1e9, 1e-9)": 1e9,
    "bezier(a, 0, 0, 5, 10, 10, 20, 0.5)": 4.0,
    "bezier(-a, 0, b, 5, 10, 10, 20, 0.5)": 3.0,
    "(\n a\t+ b)": 5.0,
}


@pytest.mark.parametrize(("text", "value"), WORTH.items(), ids=WORTH)
def test_values_are_those_of_arithmetic(text: str, value: float) -> None:
    assert evaluate(parse(text), VALUES, FLOATS) == pytest.approx(value, rel=4e-16, abs=0)


REFUSED = {  # piece of the finding
    "": "empty",
    " \n": "empty",
    "1 +": "not an expression",
    "1 2": "not an expression",
    "a b": "not an expression",
    "(1": "not an expression",
    "010": "not an expression",
    "lambda": "not an expression",
    "1_000": "joins a number to a word",
    "0x10": "joins a number to a word",
    "1j": "joins a number to a word",
    "2a": "joins a number to a word",
    "a^2": "has no meaning",
    "a.real": "has no meaning",
    "a[0]": "has no meaning",
    "a < b": "has no meaning",
    "'a'": "has no meaning",
    "a; b": "has no meaning",
    "a := 1": "has no meaning",
    "a, b": "has no meaning",
    "a % b": "has no meaning",
    "a // b": "has no meaning",
    "a @ b": "has no meaning",
    "~a": "has no meaning",
    "not a": "has no meaning",
    "a and b": "has no meaning",
    "a if b else l1": "has no meaning",
    "lambda: 1": "has no meaning",
    "{}": "has no meaning",
    "True": "has no meaning",
    "None": "has no meaning",
    "θ": "has no meaning",
    "ﬁ": "has no meaning",
    "sin(*a)": "has no meaning",
    "sin(**a)": "has no meaning",
    "(a)(b)": "unknown function",
    "(a + b)(l1)": "has no meaning",
    "print(1)": "unknown function",
    "eval(a)": "unknown function",
    "__import__('os').system('true')": "has no meaning",
    "__import__(os)": "unknown function",
    "().__class__": "has no meaning",
    "pi()": "unknown function",
    "sin()": "sin of 0 arguments",
    "sin(a, b)": "sin of 2 arguments",
    "atan2(a)": "atan2 of 1 arguments",
    "a**b": "exponent",
    "a**16.5": "exponent",
    "a**(1/0)": "no value",
    "a**1e300": "exponent",
    "a**17": "exponent",
    "a**-17": "exponent",
    "9**9**9**9": "exponent",
    "((a**16)**16)**16": "degree 4096",
    "1e999": "beyond the largest double",
    "1e-999": "below the smallest double",
    "1" * 65: "a number of 65 characters",
    "a" * 12_001: "12001 characters",
    "(" * 250 + "a" + ")" * 249: "not an expression",
    "-" * 50 + "a": "nested deeper",
    "+".join("a" * 2001): "4001 terms",
    "%".join("a" * 1500): "has no meaning",
}


@pytest.mark.parametrize(("text", "finding"), REFUSED.items(), ids=[repr(text[:30]) for text in REFUSED])
@pytest.mark.filterwarnings("error")  # Python's parser is not to comment on an untrusted text
def test_all_else_is_refused(text: str, finding: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert finding in caught.value.finding
    assert caught.value.remedy


WORTHLESS = [
    "1/0",
    "step(a, b - 3)",
    "a/(b - 3)",
    "0**-1",
    "sqrt(-a)",
    "log(0)",
    "(a - 3)**0.5",
    "(a - 2)**(1/3)",
    "asin(a)",
    "exp(1000)",
    "1e308*10",
    "(1e300)**2",
    "c",
]


@pytest.mark.parametrize("text", WORTHLESS)
def test_what_has_no_value_is_told(text: str) -> None:
    with pytest.raises(ExpressionError):
        evaluate(parse(text), VALUES, FLOATS)


def test_names_are_those_that_need_values() -> None:
    assert names(parse("a*sin(b + pi) - l1**2/atan2(a, -c)")) == {"a", "b", "l1", "c"}


def test_values_may_be_of_any_type() -> None:
    fractions: Algebra[Fraction] = Algebra(
        number=Fraction,
        constants={},
        negate=operator.neg,
        operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
        power=operator.pow,
        functions={},
    )
    assert evaluate(parse("(a + 1)**2/3 - 0.5"), {"a": Fraction(1, 2)}, fractions) == Fraction(1, 4)


def test_a_letter_of_another_alphabet_is_told_apart_from_a_sign() -> None:
    with pytest.raises(ExpressionError) as error:
        parse("2*q_joint_α")
    assert error.value.remedy.startswith("names in expressions have the letters a to z")


def test_equal_parts_of_a_program_are_computed_once() -> None:
    """Products, powers and a function that others define; each expression alone has the same results."""
    products: list[float] = []

    def multiply(x: float, y: float) -> float:
        products.append(x * y)
        return x * y

    counting = replace(FLOATS, operations={**FLOATS.operations, "*": multiply})
    texts = ["a*b + (a*b)**2", "sin(a*b) - (a*b)**3", "min(a*b, b*a)", "a*2.5 - a*-2.5"]
    program = Program([parse(text) for text in texts], counting)
    assert program.evaluate(VALUES) == [evaluate(parse(text), VALUES, FLOATS) for text in texts]
    assert products == [6.0, 6.0, 5.0, -5.0]
    assert program.evaluate({"a": 0.0, "b": 1.0})[0] == 0
    with pytest.raises(ExpressionError, match="unknown name"):
        program.evaluate({"a": 1.0})
    with pytest.raises(ExpressionError, match=r"step\(a, b\) has no value"):
        Program([parse("step(a, b)")], FLOATS).evaluate({"a": 1.0, "b": 0.0})


expressions: st.SearchStrategy[Expression] = st.recursive(
    st.builds(Number, st.floats(min_value=0, max_value=1e300).filter(lambda x: x == 0 or x > 1e-300))
    | st.builds(Name, st.sampled_from(("a", "b", "l1")))
    | st.builds(Constant, st.sampled_from(CONSTANTS)),
    lambda inner: (
        st.builds(Negation, inner)
        | st.builds(Operation, st.sampled_from("+-*/"), inner, inner)
        | st.builds(Power, inner, st.integers(-3, 3))
        | st.sampled_from(sorted(FUNCTIONS)).flatmap(
            lambda f: st.builds(Call, st.just(f), st.tuples(*[inner] * FUNCTIONS[f]))
        )
    ),
    max_leaves=8,
)


@given(expressions)
@settings(derandomize=True, deadline=None)
def test_what_is_written_reads_as_the_same_expression(expression: Expression) -> None:
    try:
        again = parse(write(expression))
    except ExpressionError as error:
        assume("degree" not in error.finding)
        raise
    assert again == expression


@given(st.text(alphabet="ab1.e+-*/()^, _sincopq", max_size=60))
@settings(derandomize=True, deadline=None, max_examples=500)
@pytest.mark.filterwarnings("error")
def test_no_text_brings_anything_but_an_expression_or_a_refusal(text: str) -> None:
    try:
        expression = parse(text)
    except ExpressionError:
        return
    assert parse(write(expression)) == expression


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("90 deg", "90*(pi/180)"),
        ("-30 deg", "-30*(pi/180)"),
        ("sin(a deg) + 2*45  deg", "sin(a*(pi/180)) + 2*45*(pi/180)"),
        ("(a + b) deg/2", "(a + b)*(pi/180)/2"),
        ("1. deg", "1.0*(pi/180)"),
        ("90*deg", "90*deg"),
        ("degree + deg", "degree + deg"),
    ],
)
def test_a_number_may_be_in_degrees(text: str, meant: str) -> None:
    assert parse(text) == parse(meant)


@pytest.mark.parametrize("text", ["90deg", "deg 90", "90 degrees", "90 deg deg(1)", "90 rad", "deg(90)"])
def test_other_units_are_refused(text: str) -> None:
    with pytest.raises(ExpressionError):
        parse(text)


@pytest.mark.parametrize("joints", ["+-", "*/"])
def test_long_sums_and_products_are_read(joints: str) -> None:
    """4000 characters always pass; the tree stays shallow, and the value is the one of Python's arithmetic."""
    rng = random.Random(3)
    numbers = [f"{rng.uniform(0.5, 2):.3f}" for _ in range(700 if joints == "+-" else 63)]
    text = "a" + "".join(rng.choice(joints) + number for number in numbers)
    assert len(text) <= 4500
    expression = parse(text)
    value = eval(text, {"a": 0.75})  # noqa: S307  # digits and signs that are drawn above
    scale = 1 if joints == "*/" else 2 * len(numbers)
    assert evaluate(expression, {"a": 0.75}, FLOATS) == pytest.approx(value, rel=1e-13, abs=1e-15 * scale)
    again = evaluate(parse(write(expression)), {"a": 0.75}, FLOATS)
    assert again == pytest.approx(value, rel=1e-13, abs=1e-15 * scale)
    assert parse("+".join("a" * 2000)) is not None


def test_short_expressions_are_computed_as_they_are_written() -> None:
    """Halving changes the rounding, so expressions that need none keep their order."""
    assert write(parse("a+b-c+d+a+b+c+d")) == "a + b - c + d + a + b + c + d"


@pytest.mark.parametrize(
    ("text", "folded"),
    [
        ("2*3 + a*sin(0)", "6 + a*0"),
        ("a - (1 - 3)", "a - -2"),
        ("exp(-3.2/0.6)*a**2", f"{math.exp(-3.2 / 0.6)!r}*a**2"),
    ],
)
def test_parts_without_names_are_folded(text: str, folded: str) -> None:
    assert write(fold(parse(text))) == write(parse(folded))


def test_words_are_spelled_in_letters_that_expressions_read() -> None:
    """With _ in place of others; words that become alike have no name, unless one is its own."""
    assert spell(["left hip", "Kurbel_ü", "q1", "x2²"]) == ["left_hip", "Kurbel__", "q1", "x2_"]
    assert spell(["ü", "ö", "a-b", "a_b"]) == [None, None, None, "a_b"]
    assert all(word is None or is_free_name(word) for word in spell(["é", "日本", "joint 1"]))
