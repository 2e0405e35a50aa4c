"""Stages in C: compiled without a warning, they give what the interpreter gives, with first and second derivatives."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.procedure.procedure import as_procedure, interpret
from mbsgen.targets.contract import Family
from mbsgen.targets.parts import LENGTH
from tests.mbsgen.procedure.compiled import STRICT, Library, write
from tests.mbsgen.procedure.examples import CLOSED, EXAMPLES, FAMILIES, OPEN, POINT, SINGULAR, complete


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(tuple(FAMILIES.values()), tmp_path_factory.mktemp("stages"))


@pytest.mark.parametrize("name", EXAMPLES)
def test_c_gives_what_the_interpreter_gives(name: str, library: Library) -> None:
    """To 1e3 roundings of the largest result, for the function, its Jacobian, its adjoint, and second derivatives."""
    for function in map(as_procedure, FAMILIES[name].functions):
        point = complete(function, name)
        status, found = library.call(function, point)
        assert status == 0
        expected = interpret(function, point).results
        for result, values in found.items():
            scale = max(1.0, *map(abs, expected[result]))
            np.testing.assert_allclose(values, expected[result], rtol=0, atol=1e3 * 2**-52 * scale)


@pytest.mark.parametrize(
    ("name", "change", "status"),
    [
        ("solve tree", {"x": [-4.0, 1.1, 1.4]}, SINGULAR),
        ("solve symmetric", {"x": [0.0, 0.0, 0.0]}, SINGULAR),
        ("solve general", {"x": [0.0, 0.0, 0.0]}, SINGULAR),
        ("solve general", {"x": [float("nan"), 0.0, 0.0]}, SINGULAR),
        ("saddle point", {"J": [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]}, SINGULAR),
        ("repeat", {"x": [1.0, 1.0, 0.0]}, 5),
        ("newton", {"lengths": [1.0, 1.0, 1.0, 9.0]}, OPEN),
        ("newton", {"start": [float("nan"), 0.0]}, OPEN),
    ],
)
def test_a_failure_gives_the_status_and_writes_nothing(
    name: str, change: dict[str, list[float]], status: int, library: Library
) -> None:
    """As the interpreter computes, also of derivatives."""
    for function in map(as_procedure, FAMILIES[name].functions):
        point = complete(function, name) | change
        found, results = library.call(function, point)
        assert (found, interpret(function, point).status) == (status, status)
        assert all(np.all(values == 5.0) for values in results.values())


def test_results_that_nobody_wants_may_be_left_out(library: Library) -> None:
    """Of two results, the one that a later stage reads is computed, though it is not wanted."""
    procedure = EXAMPLES["solve general"].procedure
    expected = interpret(procedure, POINT).results["y"]
    x, y = np.array(POINT["x"]), np.zeros(2)
    function = library._library["toy_compute_solve_general"]
    assert function(x.ctypes.data_as(ctypes.c_void_p), y.ctypes.data_as(ctypes.c_void_p), None) == 0
    np.testing.assert_allclose(y, expected, rtol=1e-14)


def test_a_four_bar_turns_through(library: Library) -> None:
    """A whole turn of the crank, each solution the start of the next: the loop stays closed to 1e-14."""
    procedure = EXAMPLES["newton"].procedure
    a, b, c, d = CLOSED["lengths"]
    y = CLOSED["start"]
    for q in np.linspace(0.8, 0.8 + 2 * np.pi, 73):
        status, found = library.call(procedure, {**CLOSED, "q": [q], "start": list(y)})
        y = list(found["angles"])
        gap = a * np.exp(1j * q) + b * np.exp(1j * y[0]) - c * np.exp(1j * y[1]) - d
        assert status == 0
        assert abs(gap) < 1e-14
    np.testing.assert_allclose(y, library.call(procedure, {**CLOSED, "start": list(y)})[1]["angles"], atol=1e-14)


@pytest.mark.parametrize("real", ["double", "float"])
def test_compilers_and_sanitizers_find_no_fault(real: str, tmp_path: Path, requires: Callable[[str], str]) -> None:
    """Clang's warnings; then kernels run at zeros, where some fail; in single precision, in parts of three lines."""
    families = tuple(Family(FAMILIES[name].functions[0]) for name in EXAMPLES if name != "straight")
    sources = write(families, tmp_path, 3 if real == "float" else LENGTH)
    calls = []
    for function in (as_procedure(family.value) for family in families):
        sizes = [w.sparsity.nnz for w in (*function.inputs, *function.outputs)]
        places = [f"x + {sum(sizes[:k])}" for k in range(len(sizes))]
        calls.append(f"    sum += toy_compute_{function.name}({', '.join(places)});")
    (tmp_path / "main.c").write_text(MAIN.replace("CALLS", "\n".join(calls)))
    files = [tmp_path / "main.c", *(tmp_path / file for file in sources.sources)]
    options = (*STRICT, f"-DMBS_REAL={real}", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    subprocess.run([requires("clang"), *options, *files, "-lm", "-o", tmp_path / "run"], check=True)
    subprocess.run([tmp_path / "run"], check=True)


MAIN = """
#include "toy.h"

int main(void)
{
    static mbs_real x[100];
    int sum = 0;
CALLS
    return sum == 0;
}
"""
