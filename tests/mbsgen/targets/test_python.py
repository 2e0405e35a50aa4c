"""Generated Python computes the tape's values, to the last bit, over any numbers."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import itertools
import keyword
import math
import random
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi
import mpmath
import numpy as np
import pytest
import sympy

from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind
from mbsgen.pipeline import build_parametric, read_tree, write_families
from mbsgen.procedure import elimination
from mbsgen.request import Request
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DIGITS, FLOATS, evaluate, find_failure
from mbsgen.tape.types import FUNCTIONS, Op, Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.python.module import write_python
from mbsgen.targets.python.stages import list_functions
from mbsgen.targets.unit import Unit
from tests.mbsgen.targets.every_function import functions_tape
from tests.sample import PARAMETERS, sample_families

MODELS = Path(__file__).parents[3] / "models"
SIGN = {Op.SIGN: lambda x: float((x > 0) - (x < 0))}  # `math` has none
MATH = replace(FLOATS, functions={op: getattr(math, op.value[0]) for op in FUNCTIONS if op is not Op.SIGN} | SIGN)


def load(families: Sequence[Family], folder: Path) -> ModuleType:
    """Write a module and import it."""
    file = folder / "kernels.py"
    file.write_text(write_python(Unit("kernels", "1.2.3", "0123abcd", tuple(families)))["kernels.py"], encoding="utf-8")
    spec = importlib.util.spec_from_file_location("kernels", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Case:
    """The kernels of a model, as tapes and as Python."""

    families: tuple[Family, ...]
    parameters: tuple[float, ...]
    kernels: ModuleType

    @property
    def tapes(self) -> tuple[Tape, ...]:
        return tuple(tape for family in self.families for tape in family.tapes)

    def draw(self, tape: Tape, seed: int) -> dict[str, list[float]]:
        """Draw the nonzeros of every input, away from 0; parameters have their values, for masses are positive."""
        rng = random.Random(seed)
        at = {i.name: [rng.uniform(0.2, 1.5) * rng.choice((1, -1)) for _ in i.sparsity.row] for i in tape.inputs}
        own = {"p": list(self.parameters)}
        if self.parameters:
            own |= evaluate(self.families[0].value, own)
        return {name: own.get(name, values) for name, values in at.items()}


@pytest.fixture(scope="module", params=["sample", "arm", "arm at run time"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    if request.param == "sample":
        families, parameters = sample_families(), tuple(PARAMETERS.values())
    else:
        description = read_model(MODELS / "arm_pendulum.yaml")
        tree = read_tree(description) if request.param == "arm" else build_parametric(description)
        families = write_families(tree)
        parameters = tuple(p.value for p in tree.parameters if p.kind is Kind.RUNTIME)
    return Case(families, parameters, load(families, tmp_path_factory.mktemp("module")))


def given_out(tape: Tape, values: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out the results without a nonzero: a kernel does not give them."""
    return {o.name: values[o.name] for o in tape.outputs if o.values}


def test_floats_are_those_of_the_tape_to_the_last_bit(case: Case) -> None:
    """Lists compare equal only where every double does."""
    for tape in case.tapes:
        for seed in range(5):
            at = case.draw(tape, seed)
            assert getattr(case.kernels, tape.name)(**at) == given_out(tape, evaluate(tape, at, MATH))


def test_arrays_go_along_a_batch(case: Case) -> None:
    for tape in case.tapes:
        batch = [case.draw(tape, seed) for seed in range(3)]
        stacked = {name: np.array([at[name] for at in batch]).T for name in batch[0]}
        found = getattr(case.kernels, tape.name)(**stacked, functions=np)
        for k, at in enumerate(batch):
            for name, values in given_out(tape, evaluate(tape, at)).items():
                column = [np.broadcast_to(v, 3)[k] for v in found[name]]
                assert column == pytest.approx(values, rel=1e-12, abs=1e-12)


def test_mpmath_keeps_its_digits(case: Case) -> None:
    """To 50 digits with the literals that are written, which are doubles."""
    doubles = replace(DIGITS, literal=lambda x: DIGITS.literal(float(x)))
    for tape in (family.value for family in case.families):
        at = case.draw(tape, 3)
        expected = evaluate(tape, {name: list(map(DIGITS.literal, v)) for name, v in at.items()}, doubles)
        with mpmath.workdps(50):
            arguments = {name: list(map(mpmath.mpf, v)) for name, v in at.items()}
            found = getattr(case.kernels, tape.name)(**arguments, functions=mpmath)
            for name, values in given_out(tape, expected).items():
                differences = [abs(a - mpmath.mpf(b)) for a, b in zip(found[name], values, strict=True)]
                assert max(differences) <= mpmath.mpf(10) ** -42


def test_casadi_computes_the_same(case: Case) -> None:
    for tape in case.tapes:
        at = case.draw(tape, 4)
        symbols, results = write_symbols(case.kernels, tape)
        kernel = casadi.Function("kernel", list(symbols.values()), list(results.values()))
        found = kernel.call([casadi.DM(at[name]) for name in symbols])
        for column, values in zip(found, given_out(tape, evaluate(tape, at)).values(), strict=True):
            assert column.full().ravel() == pytest.approx(np.array(values), rel=0, abs=1e-13 * size_of(values))


def test_casadi_differentiates_it_to_the_generated_jacobian(case: Case) -> None:
    """The peer of the generated derivatives: CasADi's own, of the same equations."""
    blocks = 0
    for family in case.families:
        if family.jac is None:
            continue
        value, at = family.value, case.draw(family.value, 5)
        ours = evaluate(family.jac, at)
        symbols, results = write_symbols(case.kernels, value)
        for (name, result), (source, symbol) in itertools.product(results.items(), symbols.items()):
            theirs = casadi.Function("J", list(symbols.values()), [casadi.jacobian(result, symbol)])
            expected = theirs.call([casadi.DM(at[i]) for i in symbols])[0].full()
            found = [o for o in family.jac.outputs if o.name == f"jac_{name}_{source}"]
            if source == "h" or not expected.size:
                continue
            pattern = value.output(name).sparsity
            full = np.zeros((pattern.rows * pattern.cols, len(at[source])))
            for output in found:
                for (r, c), x in zip(output.sparsity.entries, ours[output.name], strict=True):
                    full[r, c] = x
            rows = [r + c * pattern.rows for r, c in pattern.entries]
            assert np.abs(full[rows] - expected).max() <= 1e-12 * size_of(expected.ravel())
            blocks += 1
    assert blocks


def size_of(values: Iterable[float]) -> float:
    """Return the scale of rounding."""
    return max(1.0, *map(abs, values))


def write_symbols(kernels: ModuleType, tape: Tape) -> tuple[dict[str, casadi.SX], dict[str, casadi.SX]]:
    """Call a kernel with symbols; return the symbols of its inputs, and its results, as columns of nonzeros."""
    symbols = {i.name: casadi.SX.sym(i.name, i.sparsity.nnz) for i in tape.inputs}
    results = getattr(kernels, tape.name)(**symbols, functions=casadi)
    return symbols, {name: casadi.vertcat(*values) for name, values in results.items()}


@pytest.mark.parametrize("x", [0.7, -0.3])
def test_every_function_is_called_by_its_name(x: float, tmp_path: Path) -> None:
    tape = functions_tape()
    kernels = load([Family(tape)], tmp_path)
    at = {"x": [abs(x), x]}
    expected = evaluate(tape, at)["f"]
    assert kernels.impl(**at) == evaluate(tape, at, MATH)
    assert kernels.impl(np.array(at["x"]), functions=np)["f"] == expected
    assert list(map(float, kernels.impl(at["x"], functions=mpmath)["f"])) == pytest.approx(expected, rel=1e-15)
    symbol = casadi.SX.sym("x", 2)
    f = casadi.Function("f", [symbol], [casadi.vertcat(*kernels.impl(symbol, functions=casadi)["f"])])
    assert f(at["x"]).full().ravel().tolist() == pytest.approx(expected, rel=1e-15)


def guarded_tape() -> Tape:
    """Write 1 / (x0 - x1), with a guard of the pivot as joint 1's, and 1 / x0, as joint 2's."""
    b = Builder()
    x = b.vector("x", 2)
    pivot = x[0] - x[1]
    b.guard(pivot, x[0], 100.0, 1)
    b.guard(x[0], b.number(1.0), 4.0, 2)
    b.output_dense("f", [[b.number(1.0) / pivot], [pivot / x[0]]])
    return b.build("exp1")


@pytest.mark.parametrize(
    "x", [[1.0, 0.5], [1.0, 1.0], [1.0, 1 - 1e-14], [0.0, -1.0], [1e-30, -1.0], [-1.0, -3.0], [math.nan, 1.0]]
)
def test_a_lost_pivot_is_an_error_that_names_the_joint(x: list[float], tmp_path: Path) -> None:
    """Before its quotient is computed, which may divide by 0."""
    tape = guarded_tape()
    kernels = load([Family(tape)], tmp_path)
    joint = find_failure(tape, {"x": x})
    if not joint:
        assert kernels.exp1(x) == evaluate(tape, {"x": x})
    else:
        with pytest.raises(ZeroDivisionError, match=f"the pivot of joint {joint} is lost"):
            kernels.exp1(x)


def test_one_lost_pivot_of_a_batch_is_an_error(tmp_path: Path) -> None:
    kernels = load([Family(guarded_tape())], tmp_path)
    good = np.array([[1.0, 2.0], [0.5, 0.5]])
    assert np.shape(kernels.exp1(good, functions=np)["f"]) == (2, 2)
    with pytest.raises(ZeroDivisionError, match="joint 1"):
        kernels.exp1(np.array([[1.0, 2.0], [0.5, 2.0]]), functions=np)


def test_pivots_of_more_digits_may_be_smaller(tmp_path: Path) -> None:
    kernels = load([Family(guarded_tape())], tmp_path)
    with mpmath.workdps(50):
        assert kernels.exp1([mpmath.mpf(1), 1 - mpmath.mpf(10) ** -30], functions=mpmath)["f"][0] > 1e29


def test_symbols_pass_guards(tmp_path: Path) -> None:
    kernels = load([Family(guarded_tape())], tmp_path)
    x = casadi.SX.sym("x", 2)
    f = casadi.Function("f", [x], [casadi.vertcat(*kernels.exp1(x, functions=casadi)["f"])])
    assert f([1.0, 0.5]).full().ravel().tolist() == [2.0, 0.5]


def test_symbols_of_sympy_pass_guards_and_numbers_do_not(tmp_path: Path) -> None:
    kernels = load([Family(guarded_tape())], tmp_path)
    x = sympy.symbols("x0 x1")
    found = kernels.exp1(x, functions=sympy)["f"]
    numbers = dict(zip(x, (2, sympy.Rational(1, 2)), strict=True))
    assert [float(value.subs(numbers)) for value in found] == pytest.approx([2 / 3, 3 / 4], rel=1e-15)
    with pytest.raises(ZeroDivisionError, match="joint 1"):
        kernels.exp1([sympy.Integer(1), sympy.Integer(1)], functions=sympy)


def test_sympy_has_every_function(tmp_path: Path) -> None:
    """|x| and its sign among them, which no module calls alike."""
    tape = functions_tape()
    x = sympy.symbols("x0 x1", real=True)
    written = load([Family(tape)], tmp_path).impl(x, functions=sympy)["f"]
    found = [float(value.subs(dict(zip(x, (0.3, -0.3), strict=True)))) for value in written]
    assert found == pytest.approx(evaluate(tape, {"x": [0.3, -0.3]})["f"], rel=1e-14)


def test_exp1_of_symbols_has_the_same_numbers(tmp_path: Path) -> None:
    """The accelerations of a model, written over SymPy's symbols: each evaluates to what the tape does."""
    (family,) = write_families(read_tree(MODELS / "double_pendulum.yaml"), Request(functions=("exp1",), derivatives=0))
    names = {i.name: [f"{i.name}{k}" for k in range(i.sparsity.nnz)] for i in family.value.inputs}
    at = {name: [0.3 + 0.4 * k for k in range(len(entries))] for name, entries in names.items()}
    symbols = {name: [sympy.Symbol(text) for text in entries] for name, entries in names.items()}
    written = load([family], tmp_path).exp1(**symbols, functions=sympy)["qdd"]
    values = {symbol: x for name in names for symbol, x in zip(symbols[name], at[name], strict=True)}
    assert all(value.free_symbols for value in written)
    found = [float(value.evalf(30, subs=values)) for value in written]
    assert found == pytest.approx(evaluate(family.value, at)["qdd"], rel=1e-13)


@pytest.mark.parametrize("label", [*keyword.kwlist, "functions", "math", "x", "f", "_check", "__import__"])
def test_labels_that_mean_something_to_python_name_no_variable(label: str, tmp_path: Path) -> None:
    b = Builder()
    x = b.vector("x", 2)
    root = b.sqrt(x[0])
    b.label([root], [label])
    b.output_dense("f", [[root * root * x[1]]])
    kernels = load([Family(b.build("impl"))], tmp_path)
    assert kernels.impl([4.0, 3.0]) == {"f": [12.0]}


def test_modules_have_the_functions_of_linear_systems_and_no_others() -> None:
    """All of the module that solves them here, under separate names."""
    text = list_functions()
    own = [x.name for x in ast.parse(inspect.getsource(elimination)).body if isinstance(x, ast.FunctionDef)]
    named = {name: name if name.startswith("_") else f"_{name}" for name in own}
    assert [x.name for x in ast.parse(text).body if isinstance(x, ast.FunctionDef)] == [*named.values()]
    for name in own:
        if not name.startswith("_"):
            assert not re.search(rf"(?<!\w){name}\(", text)
