"""Generated Matlab runs in GNU Octave, and computes the tape's values."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.reader import ModelWarning, read_model
from mbsgen.model.tree import Kind
from mbsgen.pipeline import Options, build_parametric, make, read_tree, write_families
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Sparsity, Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.matlab import FOLDER, MATLAB, write_matlab
from mbsgen.targets.names import mangle
from mbsgen.targets.unit import Unit
from tests.mbsgen.targets.every_function import functions_tape
from tests.sample import PARAMETERS, sample_families

MODELS = Path(__file__).parents[3] / "models"
LONGEST_NAME = 63  # what `namelengthmax` gives in Matlab
Array = NDArray[np.float64]
Octave = Callable[[str], list[str]]


@pytest.fixture
def octave(tmp_path: Path, requires: Callable[[str], str]) -> Octave:
    """Run a script where the functions lie; give the lines that it prints."""
    tool = requires("octave-cli")

    def run(script: str) -> list[str]:
        options = ["--no-gui", "--norc", "--no-history", "--quiet", "--path", str(tmp_path / FOLDER)]
        done = subprocess.run([tool, *options, "--eval", script], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert not done.stderr
        return done.stdout.splitlines()

    return run


def write(families: Sequence[Family], folder: Path, prefix: str = "model") -> dict[str, str]:
    files = write_matlab(Unit(prefix, "1.2.3", "0123abcd", tuple(families)))
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return files


def full(pattern: Sparsity, values: Sequence[float]) -> Array:
    matrix = np.zeros((pattern.rows, pattern.cols))
    for (r, c), value in zip(pattern.entries, values, strict=True):
        matrix[r, c] = value
    return matrix


def literal(matrix: Array) -> str:
    return f"reshape([{' '.join(map(repr, matrix.T.ravel().tolist()))}], {matrix.shape[0]}, {matrix.shape[1]})"


def call(tape: Tape, at: Mapping[str, Sequence[float]], prefix: str = "model") -> str:
    """Write a call that prints the shape and the entries of each result in a line."""
    given = ", ".join(literal(full(i.sparsity, at[i.name])) for i in tape.inputs)
    results = ", ".join(o.name for o in tape.outputs)
    shown = (f"printf('%d %d', size({o.name})); printf(' %.17g', {o.name}); printf('\\n');" for o in tape.outputs)
    return f"[{results}] = {prefix}_{tape.name}({given}); " + " ".join(shown)


@pytest.mark.parametrize("model", ["sample", "arm", "arm at run time"])
def test_octave_computes_what_the_tape_tells(model: str, tmp_path: Path, octave: Octave) -> None:
    """Every kernel, as full matrices; the seeds of the sample's adjoint have a sparse pattern."""
    if model == "sample":
        families, own = sample_families(), {"p": list(PARAMETERS.values())}
    else:
        description = read_model(MODELS / "arm_pendulum.yaml")
        tree = read_tree(description) if model == "arm" else build_parametric(description)
        families, own = write_families(tree), {"p": [p.value for p in tree.parameters if p.kind is Kind.RUNTIME]}
    if own["p"]:
        own |= evaluate(families[0].value, own)
    write(families, tmp_path)
    tapes = [tape for family in families for tape in family.tapes]
    rng = np.random.default_rng(1)
    at = [{i.name: own.get(i.name) or rng.uniform(-1.5, 1.5, i.sparsity.nnz).tolist() for i in t.inputs} for t in tapes]
    lines = iter(octave("\n".join(map(call, tapes, at))))
    for tape, arguments in zip(tapes, at, strict=True):
        for name, values in evaluate(tape, arguments).items():
            expected = full(tape.output(name).sparsity, values)
            rows, cols, *found = map(float, next(lines).split())
            assert (rows, cols) == expected.shape
            scale = max(1.0, np.abs(expected).max(initial=0))
            assert found == pytest.approx(expected.T.ravel().tolist(), rel=0, abs=1e-13 * scale)
    assert next(lines, None) is None


@pytest.mark.parametrize("x", [0.7, -0.3])
def test_every_function_is_called_by_its_name(x: float, tmp_path: Path, octave: Octave) -> None:
    tape, at = functions_tape(), {"x": [abs(x), x]}
    write([Family(tape)], tmp_path)
    found = list(map(float, octave(call(tape, at))[0].split()[2:]))
    assert found == pytest.approx(evaluate(tape, at)["f"], rel=1e-15)


@pytest.mark.parametrize("x", [[-0.5, 0.5], [0.5, 1.5], [0.5, -1.5]])
def test_no_result_is_complex(x: list[float], tmp_path: Path, octave: Octave) -> None:
    """A root or logarithm of a negative number, and an angle of a sine beyond 1, are errors."""
    write([Family(functions_tape())], tmp_path)
    assert octave(f"try model_impl({x}), catch disp('refused'); end") == ["refused"]


def guarded_tape() -> Tape:
    """Write 1 / (x0 - x1), with a guard of the pivot as joint 3's."""
    b = Builder()
    x = b.vector("x", 2)
    b.guard(x[0] - x[1], x[0], 100.0, 3)
    b.output_dense("f", [[b.number(1.0) / (x[0] - x[1])]])
    return b.build("exp1")


@pytest.mark.parametrize(
    ("argument", "outcome"),
    [
        ("[1; 0.5]", "2"),
        ("[1 0.5]", "2"),
        ("[1; 1]", "mbsgen:pivot the pivot of joint 3 is lost in rounding"),
        ("[1; 1 - 1e-14]", "mbsgen:pivot the pivot of joint 3 is lost in rounding"),
        ("[NaN; 1]", "mbsgen:pivot the pivot of joint 3 is lost in rounding"),
        ("single([1; 1 - 1e-6])", "mbsgen:pivot the pivot of joint 3 is lost in rounding"),
        ("[1; 2; 3]", "mbsgen:size the size of x is not [2, 1]"),
        ("[]", "mbsgen:size the size of x is not [2, 1]"),
    ],
)
def test_lost_pivots_and_misfits_are_errors(argument: str, outcome: str, tmp_path: Path, octave: Octave) -> None:
    write([Family(guarded_tape())], tmp_path)
    told = f"try printf('%g', model_exp1({argument})); catch e, printf('%s %s', e.identifier, e.message); end"
    assert octave(told) == [outcome]


def test_a_matrix_of_another_shape_is_an_error(tmp_path: Path, octave: Octave) -> None:
    b = Builder()
    x = b.input("x", Sparsity.of(2, 3, [(0, 0), (1, 2)]))
    b.output_dense("f", [[x[0] * x[1]]])
    write([Family(b.build("impl"))], tmp_path)
    good, bad = "disp(model_impl([2 0 0; 0 0 3]));", "try model_impl([2 0; 0 0; 0 3]); catch e, disp(e.identifier); end"
    assert octave(good + bad) == ["6", "mbsgen:size"]


def test_no_keyword_or_function_names_a_variable(tmp_path: Path, octave: Octave) -> None:
    words = {word for word in octave("printf('%s\\n', iskeyword(){:});") if re.match("[A-Za-z]", word)}
    assert [word for word in sorted(words) if not MATLAB.taken.fullmatch(word)] == []
    b = Builder()
    x = b.vector("x", 2)
    roots = [b.sqrt(x[0] + b.number(float(k))) for k in range(5)]
    b.label(roots, ["sqrt", "zeros", "end", "numel", "f"])
    total = sum((root * root * x[1] for root in roots[1:]), roots[0] * roots[0])
    b.output_dense("f", [[total]])
    write([Family(b.build("impl"))], tmp_path)
    assert float(*octave("printf('%.15g', model_impl([4; 3]));")) == pytest.approx(4 + 3 * (5 + 6 + 7 + 8))


def test_names_are_as_short_as_matlab_wants(tmp_path: Path) -> None:
    """The longest model name, and every function that can be generated."""
    prefix = mangle("a" * 64)
    orders = ("", "jac_", "adj1_", "jac_adj1_")
    assert max(len(f"{prefix}_{order}{name}") for order in orders for name in FUNCTIONS) <= LONGEST_NAME
    for path, text in write(sample_families(), tmp_path, prefix).items():
        assert Path(path).name == f"{text.split('] = ')[1].split('(')[0]}.m"
        assert max(map(len, re.findall(r"\w+", text))) <= LONGEST_NAME
        assert max(map(len, text.splitlines())) <= 120


def test_what_iterates_is_left_out_with_a_warning() -> None:
    """A spatial loop is closed by Newton's method; its rates are straight code."""
    options = Options(functions=("close", "close_rates"), derivatives=0, targets=("matlab",))
    with pytest.warns(ModelWarning, match="^matlab: close: left out"):
        product = make(MODELS / "wishbone.yaml", options)
    assert [file for file in product.files if file.startswith(FOLDER)] == [f"{FOLDER}/wishbone_close_rates.m"]
    long = [line for line in product.files["wishbone.h"].splitlines() if len(line) > 125]
    assert [line for line in long if "NAMES_loop" in line] == []
