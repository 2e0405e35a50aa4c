"""Functions of force laws: every operation that is written as a call, in value and two derivatives, and its target."""

from __future__ import annotations

import ctypes
import math
import runpy
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi
import mpmath
import numpy as np
import pytest
import sympy
from sympy import Expr, Float, Rational, Symbol

from mbsgen.derivatives.kernels import differentiate
from mbsgen.errors import TapeError
from mbsgen.expressions import PRIMITIVES
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.lowering import lower
from mbsgen.tape.types import EVEN, FUNCTIONS, ODD, Op, Sparsity, Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.python.module import write_python
from mbsgen.targets.unit import Unit
from tests.mbsgen.targets.compilation import name_in
from tests.sample import write_sample

X = (0.37, -0.61)


def smooth(op: Op, x: Scalar, y: Scalar) -> Scalar:
    """Apply a function to what lies in its domain: a slope and a curvature in both inputs."""
    b = x.builder
    inner = x + b.number(0.3) * (x * y)
    if op in (Op.LOG, Op.SQRT):
        inner = inner * inner + b.number(0.5)
    return b.apply(op, inner, y - b.number(0.2) * x) if op.arity == 2 else b.apply(op, inner)


def tape_of(*ops: Op) -> Tape:
    b = Builder()
    x, y = b.vector("x", 2)
    b.output("f", Sparsity.dense(len(ops)), [smooth(op, x, y) for op in ops])
    return b.build("impl")


def nonzeros(tape: Tape, output: str, arguments: dict[str, list]) -> dict[tuple[int, int], mpmath.mpf]:
    """Evaluate a matrix in 50 digits, by rows and columns."""
    values = evaluate(tape, arguments, DIGITS)[output]
    return dict(zip(tape.output(output).sparsity.entries, values, strict=True))


def differ(f: Callable[..., list], at: list, order: tuple[int, ...]) -> list:
    """Differentiate by central differences of step 1e-12, in 50 digits: the error is near 1e-24."""
    if not order:
        return f(at)
    ends = []
    for sign in (1, -1):
        moved = list(at)
        moved[order[0]] += sign * DIGITS.literal(1e-12)
        ends.append(differ(f, moved, order[1:]))
    return [(a - b) / (2 * DIGITS.literal(1e-12)) for a, b in zip(*ends, strict=True)]


@pytest.mark.parametrize("op", FUNCTIONS)
def test_derivatives_of_every_function_in_fifty_digits(op: Op):
    """First and second derivatives of f(x, y) against differences; |x| and its sign away from 0."""
    tape = tape_of(op)
    made = differentiate(tape, ("x",))
    at = [DIGITS.literal(x) for x in X]
    first = dict(
        zip(made.jac.outputs[0].sparsity.entries, evaluate(made.jac, {"x": at}, DIGITS)["jac_f_x"], strict=True)
    )
    seeded = evaluate(made.jac_adj1, {"x": at, "adj_f": [DIGITS.literal(1)]}, DIGITS)["jac_adj_x_x"]
    second = dict(zip(made.jac_adj1.output("jac_adj_x_x").sparsity.entries, seeded, strict=True))
    for i in range(2):
        (exact,) = differ(lambda x: evaluate(tape, {"x": x}, DIGITS)["f"], at, (i,))
        assert abs(first.get((0, i), 0) - exact) < 1e-22 * (1 + abs(exact))
        for j in range(2):
            (exact,) = differ(lambda x: evaluate(tape, {"x": x}, DIGITS)["f"], at, (i, j))
            assert abs(second.get((i, j), 0) - exact) < 1e-20 * (1 + abs(exact))


def test_the_derivative_of_an_absolute_value_is_its_sign_and_zero_at_zero():
    b = Builder()
    (x,) = b.vector("x", 1)
    b.output("f", Sparsity.dense(1), [b.apply(Op.ABS, x)])
    made = differentiate(b.build("f"), ("x",))
    for value, slope in ((-2.5, -1), (0.0, 0), (0.1, 1)):
        assert evaluate(made.jac, {"x": [value]})["jac_f_x"] == [slope]
    assert made.jac_adj1.output("jac_adj_x_x").sparsity.nnz == 0


@pytest.mark.parametrize("op", [op for op in FUNCTIONS if op.arity == 1])
def test_signs_are_taken_out_of_odd_and_even_functions_only(op: Op):
    """f(-x) beside f(x): one call where f is odd or even, and two where it is neither."""
    x = abs(X[0])
    b = Builder()
    (a,) = b.vector("x", 1)
    b.output("f", Sparsity.dense(2), [b.apply(op, a), b.apply(op, -a)])
    tape = b.build("f")
    assert count(tape).of(op) == (1 if op in ODD or op in EVEN else 2)
    if op not in (Op.LOG, Op.SQRT):
        exact = [DIGITS.functions[op](DIGITS.literal(s * x)) for s in (1, -1)]
        assert evaluate(tape, {"x": [DIGITS.literal(x)]}, DIGITS)["f"] == exact


@pytest.mark.parametrize("op", [op for op in FUNCTIONS if op.arity == 1])
def test_functions_of_literals_are_folded_to_sixty_digits(op: Op):
    b = Builder()
    f = b.apply(op, b.number(0.37))
    b.output("f", Sparsity.dense(1), [f])
    tape = b.build("f")
    assert not tape.operations
    assert abs(tape.literals[0] - DIGITS.functions[op](DIGITS.literal(0.37))) < 1e-48


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1), (0, -1), (-1, 0)])
@pytest.mark.parametrize("fold", [True, False])
def test_the_angle_of_a_point_knows_its_quadrant(signs: tuple[int, int], fold: bool):
    """atan2 of inputs, of literals, and of one of each; the structural zero is an operand like another."""
    b = Builder(fold=fold)
    y, x = ([b.zero, part, -part][s] for s, part in zip(signs, b.vector("x", 2), strict=True))
    ny, nx = (b.number(float(s) * v) for s, v in zip(signs, (0.5, 0.7), strict=True))
    b.output("f", Sparsity.dense(3), [b.apply(Op.ATAN2, y, x), b.apply(Op.ATAN2, ny, nx), b.apply(Op.ATAN2, y, nx)])
    exact = math.atan2(signs[0] * 0.5, signs[1] * 0.7)
    assert evaluate(b.build("f"), {"x": [0.5, 0.7]})["f"] == pytest.approx([exact] * 3, rel=1e-15)


@pytest.mark.parametrize(
    ("op", "value"), [(Op.LOG, 0.0), (Op.LOG, -1.0), (Op.SQRT, -2.0), (Op.ASIN, 1.5), (Op.ACOS, -1.5), (Op.EXP, 1e9)]
)
def test_a_function_of_a_literal_outside_its_domain_is_refused(op: Op, value: float):
    b = Builder()
    with pytest.raises(TapeError, match=f"{op.value[0]}.* (has no value|range)"):
        b.apply(op, b.number(value))


def test_functions_of_force_laws_are_counted_apart():
    counts = count(tape_of(*FUNCTIONS)).flops
    assert counts.other == len(FUNCTIONS) - 3  # all but sqrt, sin and cos
    assert (
        counts.paper
        == count(tape_of(*FUNCTIONS)).paper
        == sum((counts.add, counts.mul, counts.div, counts.neg, counts.sqrt, counts.trig))
    )


# -- from SymPy -----------------------------------------------------------------------------------------------------

A, B = Symbol("q", real=True), Symbol("a")
NAMES = {name: count for name, count in PRIMITIVES.items() if name != "max"}  # which is written by abs
SYMPY = {name: getattr(sympy, {"abs": "Abs"}.get(name, name)) for name in NAMES}


@dataclass(frozen=True)
class Law:
    expression: Expr

    def at(self, a: float, b: float) -> float:
        builder = Builder()
        x = builder.vector("x", 2)
        builder.output("f", Sparsity.dense(1), [lower(self.expression, builder, dict(zip((A, B), x, strict=True)))])
        return float(evaluate(builder.build("f"), {"x": [DIGITS.literal(a), DIGITS.literal(b)]}, DIGITS)["f"][0])


@pytest.mark.parametrize("name", NAMES)
def test_every_function_of_a_model_file_can_be_lowered(name: str):
    given = [A, B][: NAMES[name]]
    found = Law(3 * SYMPY[name](*given) ** 2 - A).at(0.4, 0.9)
    exact = abs(0.4) if name == "abs" else getattr(math, name)(*(0.4, 0.9)[: NAMES[name]])
    assert found == pytest.approx(3 * exact**2 - 0.4, rel=1e-15)


@pytest.mark.parametrize("power", [*range(-17, 18), *(Rational(k, 2) for k in (-3, 1, 5))])
def test_powers_are_products(power: object):
    """And few of them: 2 log2 n at most, with a root and a division where needed."""
    assert Law(B**power).at(0.0, 1.3) == pytest.approx(1.3 ** float(power), rel=1e-14)
    if power == 16:
        b = Builder()
        x = b.vector("x", 1)
        b.output("f", Sparsity.dense(1), [lower(B**16, b, {B: x[0]})])
        assert count(b.build("f")).of(Op.MUL) == 4


@pytest.mark.parametrize("expression", [B ** Float(0.3), sympy.gamma(B), B * sympy.log(-2), B**A])
def test_what_no_operation_computes_is_refused(expression: Expr):
    with pytest.raises(TapeError, match=r"no operation|no real number"):
        Law(expression).at(0.1, 0.2)


# -- targets --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def family() -> Family:
    tape = tape_of(*FUNCTIONS)
    made = differentiate(tape, ("x",))
    return Family(tape, made.jac, made.adj1, made.jac_adj1)


@pytest.mark.parametrize(
    ("real", "ctype", "digits"), [("double", ctypes.c_double, 1e-14), ("float", ctypes.c_float, 1e-5)]
)
def test_c_calls_the_function_of_the_type(
    real: str, ctype: type, digits: float, family: Family, tmp_path: Path, requires: Callable[[str], str]
):
    write_sample(tmp_path, families=(family,))
    options = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wdouble-promotion", "-Wconversion", "-Werror", "-O1"]
    command = [requires("gcc"), *options, f"-DMBS_REAL={real}", f"-I{tmp_path}", "-shared", "-fPIC"]
    subprocess.run([*command, *sorted(tmp_path.glob("*.c")), "-lm", "-o", tmp_path / "f.so"], check=True)
    library = ctypes.CDLL(str(tmp_path / "f.so"))
    assert family.jac is not None
    for tape in (family.value, family.jac):
        function = library[name_in(real, f"sample_compute_{tape.name}")]
        x = (ctype * 2)(*X)
        (output,) = tape.outputs
        f = (ctype * output.sparsity.nnz)()
        assert function(x, f) == 0
        assert list(f) == pytest.approx(evaluate(tape, {"x": list(X)})[output.name], rel=digits, abs=digits)


def test_c_gives_the_sign_of_zero_and_of_not_a_number(tmp_path: Path, requires: Callable[[str], str]):
    b = Builder()
    (x,) = b.vector("x", 1)
    b.output("f", Sparsity.dense(1), [b.apply(Op.SIGN, x)])
    write_sample(tmp_path, families=(Family(b.build("impl")),))
    command = [requires("gcc"), "-std=c99", "-Werror", f"-I{tmp_path}", "-shared", "-fPIC", tmp_path / "sample_impl.c"]
    subprocess.run([*command, "-o", tmp_path / "f.so"], check=True)
    function = ctypes.CDLL(str(tmp_path / "f.so")).sample_compute_impl

    def sign(value: float) -> float:
        f = (ctypes.c_double * 1)()
        function((ctypes.c_double * 1)(value), f)
        return f[0]

    assert [sign(v) for v in (-3.0, -0.0, 0.0, 1e-300)] == [-1, 0, 0, 1]
    assert math.isnan(sign(math.nan))


@pytest.mark.parametrize("kind", ["math", "numpy", "mpmath", "casadi"])
def test_python_calls_the_functions_of_any_number_type(kind: str, family: Family, tmp_path: Path):
    file = tmp_path / "sample.py"
    file.write_text(write_python(Unit("sample", "1", "2", (family,)))["sample.py"], encoding="utf-8")
    kernels = runpy.run_path(str(file))
    functions = {"math": math, "numpy": np, "mpmath": mpmath, "casadi": casadi}[kind]
    given = {"math": list(X), "numpy": [np.array([x]) for x in X], "mpmath": [mpmath.mpf(x) for x in X]}
    for name, tape in (("impl", family.value), ("jac_impl", family.jac)):
        assert tape is not None
        (output,) = tape.outputs
        if kind == "casadi":
            x = casadi.SX.sym("x", 2)
            column = casadi.vertcat(*kernels[name]([x[0], x[1]], functions=functions)[output.name])
            found = np.array(casadi.Function("f", [x], [column])(X)).ravel()
        else:
            found = np.array(
                [float(np.ravel(v)[0]) for v in kernels[name](given[kind], functions=functions)[output.name]]
            )
        assert found == pytest.approx(evaluate(tape, {"x": list(X)})[output.name], rel=1e-13)
