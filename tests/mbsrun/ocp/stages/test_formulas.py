"""Formulas in C: values and derivatives against 50-digit differences, patterns against dependence, kinks and poles."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cffi
import numpy as np
import pytest
from mpmath import MPContext

from mbsgen import resources
from mbsgen.expressions import FUNCTIONS, PRIMITIVES, Algebra, Expression, ExpressionError, evaluate, parse
from mbsrun.jets import depend, make_dependences
from mbsrun.ocp.evaluation.stages.formulas import patterns, write
from mbsrun.ocp.evaluation.stages.tables import Derivative
from mbsrun.ocp.ground.functions import Array, Formula, Input

# Every function and operator, of entries of two inputs, a parameter and a number of data.
TEXTS = (
    "cos(sin(sin(x0)) + y0)",  # angles that are sines
    "sin(x0) + cos(x0*y0) - tan(x1/2)",
    "asin(x0/2)*acos(y1/2)*atan(x1 + p0)",
    "atan2(x0 - 2, y0*x1)/sqrt(x1**2 + d0)",
    "exp(-x0*y1)*log(1 + x1**2)*tanh(y0)",
    "abs(x0 - y0)*abs(y1)",
    "max(x0 - y0, x1*y1)*min(x0*y1, d0)",
    "step(x0*y0, p0**2 + 1)*softplus(x1 - y0, 1/8) + smoothmax(x0*y0, x1, 1/8)",
    "bezier(x0 + y0, -1, d0, 1/2, p0, 3, y1, 3/4)",
    "(x0 + 2*y0)**-3 + x1**16 - -y1**1 + x0**0",
    "3*x0 - pi*p0",
    "p0*d0",
    "x0 - x0",
)
POINTS = ("x0*y0/3", "x1", "1/7", "2", "1/2", "9", "1/3", "3/4")  # the first arguments of functions
SHIFTED = tuple(f"{name}({', '.join(POINTS[:count])})" for name, count in FUNCTIONS.items())


def make(texts: Sequence[str]) -> Formula:
    """Make a formula of inputs x and y, both (2,), a parameter p0 and a number of data d0."""
    inputs, p, d = (Input("x", 2), Input("y", 2)), Input("p", 1), Input("d", 1)
    known = {f"{part.kind}{i}": (part.kind, i) for part in (*inputs, p, d) for i in range(part.size)}
    return Formula(tuple(map(parse, texts)), known, inputs, p, d)


@dataclass(frozen=True)
class Library:
    """A formula and its derivatives, compiled."""

    formula: Formula
    ffi: cffi.FFI
    lib: object
    real: str

    def call(self, derivative: Derivative, arguments: Sequence[Array | None]) -> tuple[int, Array]:
        """Return the status and the result."""
        sizes = (len(self.formula.expressions), *(pattern.row.size for pattern in patterns(self.formula)))
        size = dict(zip(Derivative, sizes, strict=True))[derivative]
        dtype = np.dtype(np.float32 if self.real == "float" else np.float64)
        given = [None if a is None else np.array(a, dtype=dtype) for a in arguments]
        result = np.full(size, np.nan, dtype=dtype)
        cast = self.ffi.cast
        pointers = [self.ffi.NULL if a is None else cast(f"{self.real} *", a.ctypes.data) for a in given]
        arg = self.ffi.new(f"{self.real} *[]", pointers)
        res = self.ffi.new(f"{self.real} *[]", [cast(f"{self.real} *", result.ctypes.data)])
        status = getattr(self.lib, f"f_{derivative.value}")(arg, res, self.ffi.NULL, self.ffi.NULL, 0)
        return status, result.astype(np.float64)


def load(folder: Path, formula: Formula, compiler: str, real: str = "double") -> Library:
    """Compile the three functions of a formula without a warning."""
    sources = []
    for derivative in Derivative:
        source = folder / f"{derivative.value}.c"
        source.write_text(write(formula, f"f_{derivative.value}", derivative), encoding="utf-8")
        sources.append(str(source))
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-DMBS_REAL={real}", "-fPIC", "-shared"]
    library = folder / f"formula_{real}.so"
    subprocess.run([compiler, *flags, f"-I{resources.folder('csrc')}", *sources, "-o", str(library), "-lm"], check=True)
    ffi = cffi.FFI()
    for derivative in Derivative:
        ffi.cdef(f"int f_{derivative.value}({real} **arg, {real} **res, long long *iw, {real} *w, int mem);")
    return Library(formula, ffi, ffi.dlopen(str(library)), real)


# --- the oracle: 50 digits, and central differences of them --------------------------------------------------------

_MP = MPContext()
_MP.dps = 50
_STEP = _MP.mpf(10) ** -12  # differences of second order: errors of 1e-24, and digits lost in them 1e-26
_ORACLE = Algebra(
    number=_MP.mpf,
    constants={"pi": +_MP.pi},
    negate=lambda a: -a,
    operations={
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
    },
    power=lambda a, k: a**k,
    functions={name: {"abs": abs, "max": max}.get(name) or getattr(_MP, name) for name in PRIMITIVES},
)


def compute(formula: Formula, arguments: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return values, Jacobian and Hessians, by the inputs stacked."""
    point = [_MP.mpf(float(x)) for part in arguments for x in part]
    starts = np.cumsum([0, *(part.size for part in formula.arguments)])
    place = {part.kind: int(start) for part, start in zip(formula.arguments, starts, strict=False)}
    n = sum(part.size for part in formula.inputs)

    def value(expression: Expression, moves: Mapping[int, int]) -> object:
        moved = [x + moves.get(i, 0) * _STEP for i, x in enumerate(point)]
        return evaluate(expression, {k: moved[place[kind] + i] for k, (kind, i) in formula.names.items()}, _ORACLE)

    def slope(f: Callable[[dict[int, int]], object], i: int, moves: Mapping[int, int]) -> object:
        up, down = ({**moves, i: moves.get(i, 0) + way} for way in (1, -1))
        return (f(up) - f(down)) / (2 * _STEP)  # type: ignore[operator]

    values, jacobian, hessians = [], [], []
    for expression in formula.expressions:

        def f(moves: Mapping[int, int], e: Expression = expression) -> object:
            return value(e, moves)

        values.append(float(f({})))  # type: ignore[arg-type]
        jacobian.append([float(slope(f, i, {})) for i in range(n)])  # type: ignore[arg-type]
        second = [[slope(lambda m, j=j: slope(f, j, m), i, {}) for j in range(n)] for i in range(n)]  # type: ignore[misc]
        hessians.append([[float(x) for x in row] for row in second])  # type: ignore[arg-type]
    return np.array(values), np.array(jacobian), np.array(hessians)


ARGUMENTS = [np.array([0.7, -0.4]), np.array([1.3, 0.9]), np.array([0.6]), np.array([2.5])]


@pytest.mark.parametrize("real", ["double", "float"])
def test_values_and_derivatives_agree_with_50_digits(
    real: str, tmp_path: Path, requires: Callable[[str], str], rng: np.random.Generator
) -> None:
    """Every function and operator; 100 eps of the sizes of the entries, which a handful of operations lose."""
    shown = tuple(text.replace("/3,", "/3 + 1,") for text in SHIFTED if not text.startswith(("sqrt", "log")))
    formula = make((*TEXTS, *shown, "sqrt(x0*y0/3)", "log(x0*y0/3)"))
    library, weights = load(tmp_path, formula, requires("cc"), real), rng.uniform(0.5, 1, len(formula.expressions))
    arguments = [a.astype(np.float32).astype(np.float64) for a in ARGUMENTS]
    weights = weights.astype(np.float32).astype(np.float64)
    f, J, H = compute(formula, arguments)
    weighted = np.tensordot(weights, H, 1)
    of_jacobian, of_hessian = patterns(formula)
    eps = 2.0**-23 if real == "float" else 2.0**-52
    for derivative, given, expected in (
        (Derivative.VALUE, arguments, f),
        (Derivative.JACOBIAN, arguments, J[of_jacobian.row, of_jacobian.col]),
        (Derivative.HESSIAN, [*arguments, weights], weighted[of_hessian.row, of_hessian.col]),
    ):
        status, found = library.call(derivative, given)
        assert status == 0
        np.testing.assert_allclose(found, expected, rtol=100 * eps, atol=100 * eps * float(np.abs(expected).max()))
    left_J, left_H = J.copy(), np.tril(weighted)
    left_J[of_jacobian.row, of_jacobian.col] = 0
    left_H[of_hessian.row, of_hessian.col] = 0
    assert np.abs(left_J).max() == 0
    assert np.abs(left_H).max() < 1e-20  # the differences' own error


def test_patterns_have_no_entry_that_cannot_be_nonzero() -> None:
    """Patterns lie within what expressions depend on, and in order."""
    formula = make(TEXTS)
    n, algebra = 4, make_dependences(4)
    index = {"x": 0, "y": 2}
    known = {
        name: depend(index[kind] + i, n) if kind in index else algebra.number(1.0)
        for name, (kind, i) in formula.names.items()
    }
    found = [evaluate(e, known, algebra) for e in formula.expressions]
    jacobian, hessian = patterns(formula)
    mask = np.array([d.g for d in found])
    assert mask[jacobian.row, jacobian.col].all()
    assert np.tril(np.any([d.H for d in found], axis=0))[hessian.row, hessian.col].all()
    for pattern in (jacobian, hessian):
        assert (np.diff(pattern.col * pattern.shape[0] + pattern.row) > 0).all()
    assert not (jacobian.row == len(TEXTS) - 1).any()  # x - x


@pytest.fixture(scope="module")
def kinks(tmp_path_factory: pytest.TempPathFactory, requires: Callable[[str], str]) -> Callable[[str], Library]:
    """Compile a formula of one expression."""
    compiler = requires("cc")
    return lambda text: load(tmp_path_factory.mktemp("kinks"), make([text]), compiler)


def test_at_a_kink_the_slope_of_abs_is_0(kinks: Callable[[str], Library]) -> None:
    """|x| at 0, from both sides and at it; its curvature is none."""
    library = kinks("abs(x0)")
    rest = [np.ones(2), np.ones(1), np.ones(1)]
    for x, value, slope in ((-2.0, 2.0, -1.0), (0.0, 0.0, 0.0), (3.0, 3.0, 1.0)):
        point = [np.array([x, 0.0]), *rest]
        assert library.call(Derivative.VALUE, point) == (0, np.array([value]))
        assert library.call(Derivative.JACOBIAN, point) == (0, np.array([slope]))
    assert patterns(library.formula)[1].row.size == 0


def test_what_is_not_finite_is_a_status(kinks: Callable[[str], Library]) -> None:
    """Poles, edges of a domain, overflow, and arguments that are not numbers."""
    library = kinks("sqrt(x0) + exp(y0)")
    ones = [np.ones(1), np.ones(1)]
    for x, y, value, slope in (
        (1.0, 1.0, 0, 0),
        (0.0, 1.0, 0, 1),  # the slope of a root at 0
        (-1.0, 1.0, 1, 1),
        (1.0, 1e3, 1, 1),
        (np.nan, 1.0, 1, 1),
        (np.inf, 1.0, 1, 0),
    ):
        point = [np.array([x, 0.0]), np.array([y, 0.0]), *ones]
        assert library.call(Derivative.VALUE, point)[0] == value
        assert library.call(Derivative.JACOBIAN, point)[0] == slope
        assert library.call(Derivative.HESSIAN, [*point, np.ones(1)])[0] == slope


def test_an_argument_that_is_not_given_is_0(kinks: Callable[[str], Library]) -> None:
    """As CasADi's contract has it."""
    status, found = kinks("cos(x0) + y0").call(Derivative.VALUE, [None, None, None, None])
    assert (status, list(found)) == (0, [1.0])


def test_long_formulas_are_written_in_parts(tmp_path: Path, requires: Callable[[str], str]) -> None:
    """Several functions that share values give what one gives."""
    texts = [f"sin({k + 1}*x0)*exp(-y0/{k + 1})*(x1 + y1)**3/(2 + cos(x0 + {k}*y0))" for k in range(24)]
    formula = make(texts)
    assert "mbs_part2" in write(formula, "f", Derivative.HESSIAN)
    library = load(tmp_path, formula, requires("cc"))
    status, found = library.call(Derivative.VALUE, ARGUMENTS)
    x, y = ARGUMENTS[:2]
    k = np.arange(24)
    expected = np.sin((k + 1) * x[0]) * np.exp(-y[0] / (k + 1)) * (x[1] + y[1]) ** 3 / (2 + np.cos(x[0] + k * y[0]))
    assert status == 0
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-15)
    weights = np.linspace(0.5, 1, 24)
    status, curvature = library.call(Derivative.HESSIAN, [*ARGUMENTS, weights])
    slopes = [
        library.call(Derivative.JACOBIAN, [x, y + np.array([way * 1e-5, 0]), *ARGUMENTS[2:]])[1] for way in (1, -1)
    ]
    jacobian, hessian = patterns(formula)
    by_y = np.zeros(4)
    np.add.at(by_y, jacobian.col, weights[jacobian.row] * (slopes[0] - slopes[1]) / 2e-5)
    in_row = hessian.row == 2
    np.testing.assert_allclose(curvature[in_row], by_y[hessian.col[in_row]], rtol=1e-6, atol=1e-6)


def test_the_same_formula_gives_the_same_text() -> None:
    """Bytes do not depend on names, nor on anything but the expressions."""
    first = write(make(TEXTS), "f", Derivative.HESSIAN)
    renamed = make(TEXTS)
    others = {f"n_{name}": place for name, place in sorted(renamed.names.items(), reverse=True)}
    texts = [parse("sin(n_x0)")]
    one = Formula(tuple(texts), others, renamed.inputs, renamed.parameters, renamed.data)
    assert first == write(make(TEXTS), "f", Derivative.HESSIAN)
    assert write(one, "f", Derivative.VALUE) == write(make(["sin(x0)"]), "f", Derivative.VALUE)


@pytest.mark.parametrize("text", ["1/(2 - 2)", "log(-1)*x0", "1/(x0 - x0)", "asin(2)"])
def test_expressions_without_a_value_are_refused(text: str) -> None:
    """Whatever the variables are."""
    with pytest.raises(ExpressionError, match="has no value"):
        write(make([text]), "f", Derivative.VALUE)


def test_numbers_beyond_doubles_are_refused() -> None:
    """A product of constants that overflows."""
    with pytest.raises(ExpressionError, match="beyond the range of a double"):
        write(make(["1e300*1e300*x0"]), "f", Derivative.VALUE)


def test_every_part_of_the_language_is_tested() -> None:
    """All functions and kinds of expressions are in the texts above."""
    seen = {type(part) for text in TEXTS for part in _walk(parse(text))}
    assert seen == set(Expression.__args__)
    assert {name for name in FUNCTIONS if any(f"{name}(" in text for text in TEXTS)} == set(FUNCTIONS)


def _walk(expression: Expression) -> list[Expression]:
    operands = [x for x in vars(expression).values() if isinstance(x, Expression.__args__)]
    operands += getattr(expression, "arguments", ())
    return [expression, *(part for x in operands for part in _walk(x))]
