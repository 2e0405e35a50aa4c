"""Stages in Python: what the interpreter gives, over floats and 50 digits; exceptions where stages fail."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from types import ModuleType, SimpleNamespace

import casadi
import mpmath
import numpy as np
import pytest

from mbsgen.procedure.procedure import evaluate, interpret
from mbsgen.tape.interpreter import DIGITS, FLOATS
from mbsgen.targets.python.module import write_python
from mbsgen.targets.unit import Unit
from tests.mbsgen.procedure.examples import CLOSED, EXAMPLES, FAMILIES, POINT, complete, convert


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """Import the kernels of all examples."""
    file: Path = tmp_path_factory.mktemp("stages") / "toy.py"
    file.write_text(write_python(Unit("toy", "0", "0", tuple(FAMILIES.values())))["toy.py"])
    spec = importlib.util.spec_from_file_location("toy", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", EXAMPLES)
def test_python_gives_what_the_interpreter_gives(name: str, kernels: ModuleType) -> None:
    """To 1e2 roundings, in floats and in 50 digits: the function, its Jacobian, its adjoint, second derivatives."""
    with mpmath.workdps(50):
        fifty = SimpleNamespace(eps=DIGITS.epsilon, **{x: getattr(mpmath.mp, x) for x in ("sin", "cos", "sqrt")})
        for function in FAMILIES[name].functions:
            for numbers, functions, rounding in ((FLOATS, math, 2.0**-52), (DIGITS, fifty, 1e-48)):
                point = convert(complete(function, name), numbers)
                given = {i.name: point[i.name] for i in function.inputs}
                found = getattr(kernels, function.name)(**given, functions=functions)
                expected = evaluate(function, given, numbers)
                assert found.keys() == expected.keys()
                for result, values in expected.items():
                    largest = max(1, *map(abs, values))
                    differences = [abs(a - b) for a, b in zip(found[result], values, strict=True)]
                    assert max(differences) <= 1e2 * rounding * largest


@pytest.mark.parametrize(
    ("name", "change", "finding"),
    [
        ("solve tree", {"x": [-4.0, 1.1, 1.4]}, r"a pivot of A is lost in rounding \(status 7\)"),
        ("solve general", {"x": [0.0, 0.0, 0.0]}, r"a pivot of A is lost in rounding \(status 7\)"),
        ("newton", {"lengths": [1.0, 1.0, 1.0, 9.0]}, r"the iteration closure does not converge \(status 3\)"),
        ("repeat", {"x": [1.0, 1.0, 0.0]}, "the pivot of joint 5 is lost in rounding"),
    ],
)
def test_what_fails_raises(name: str, change: dict[str, list[float]], finding: str, kernels: ModuleType) -> None:
    """ZeroDivisionError, with the status that C returns."""
    procedure = EXAMPLES[name].procedure
    assert interpret(procedure, EXAMPLES[name].point | change).status
    with pytest.raises(ZeroDivisionError, match=finding):
        getattr(kernels, procedure.name)(**EXAMPLES[name].point | change)


def test_maps_take_symbols(kernels: ModuleType) -> None:
    """No number is compared there; an iteration has to compare, and is refused by CasADi."""
    x = casadi.SX.sym("x", 3)
    z = casadi.vertcat(*kernels.repeat(casadi.vertsplit(x), functions=casadi)["z"])
    found = casadi.Function("z", [x], [z])(POINT["x"])
    np.testing.assert_allclose(np.array(found)[:, 0], evaluate(EXAMPLES["repeat"].procedure, POINT)["z"], rtol=1e-15)
    with pytest.raises(Exception, match="SX"):
        kernels.four_bar([casadi.SX.sym("q")], CLOSED["lengths"], CLOSED["start"], functions=casadi)
