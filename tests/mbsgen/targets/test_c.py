"""Generated C: clean under both compilers, free of state, the same under any hash seed, equal to the tape."""

from __future__ import annotations

import ctypes
import os
import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen import manifest
from mbsgen.formulations import ports
from mbsgen.resources import folder
from mbsgen.roles import Role
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import FLOATS, evaluate
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import LITERALS, Input, Op, Output, Sparsity, Tape
from mbsgen.targets.c.files import write_c
from mbsgen.targets.contract import Family, faces
from mbsgen.targets.unit import Unit
from tests.mbsgen.targets.compilation import STRICT, Requires, run
from tests.sample import family, sample_families, sample_tape, write_sample

FLOATS64 = replace(FLOATS, literal=np.float64)  # unlike Python's floats, they divide by 0 as C does


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sample(tmp_path_factory.mktemp("sample"))


def kernels(sample: Path) -> list[Path]:
    """List the C files of a library: all but the check program."""
    return [sample / name for name in manifest.read(sample / manifest.FILE_NAME).sources]


def sources(sample: Path) -> list[Path]:
    return [*sorted(sample.glob("*.c")), folder("csrc") / "mbs_many.c"]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("optimisation", ["-O0", "-O3"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_compiler_warns(
    compiler: str, optimisation: str, real: str, sample: Path, tmp_path: Path, requires: Requires
) -> None:
    options = [*STRICT, optimisation, f"-DMBS_REAL={real}", f"-I{sample}", "-c", "-o", str(tmp_path / "x.o")]
    for source in sources(sample):
        run(requires(compiler), *options, source)


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_the_headers_are_cpp_too(compiler: str, sample: Path, tmp_path: Path, requires: Requires) -> None:
    program = tmp_path / "program.cpp"
    headers = "".join(f'#include "{name}"\n' for name in ("sample.h", "mbs_many.h", "mbs_check.h"))
    program.write_text(f"{headers}int main() {{ return sample_impl_n_in() != 5; }}\n")
    library = [tmp_path / f"{source.stem}.o" for source in kernels(sample)]
    for source, target in zip(kernels(sample), library, strict=True):
        run(requires("gcc"), "-std=c99", f"-I{sample}", "-c", source, "-o", target)
    strict = ["-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{sample}", f"-I{folder('csrc')}"]
    run(requires(compiler), *strict, program, *library, "-lm", "-o", tmp_path / "program")
    run(tmp_path / "program")


def test_kernels_keep_no_state_and_call_nothing_but_libm(sample: Path, tmp_path: Path, requires: Requires) -> None:
    """nm: no writable data (b, d, C), nothing undefined but functions of math.h and of the model itself."""
    for source in kernels(sample):
        run(requires("gcc"), "-std=c99", "-O2", "-fno-pic", "-c", source, "-o", tmp_path / f"{source.stem}.o")
        lines = [line.split()[-2:] for line in run(requires("nm"), tmp_path / f"{source.stem}.o").splitlines()]
        assert not [name for kind, name in lines if kind in "bBdDCsS"]
        assert {name for kind, name in lines if kind == "U"} <= {"sin", "cos", "sincos", "sqrt"}


def test_the_text_is_the_same_under_any_hash_seed() -> None:
    script = "from tests.sample import *; print(write_c(Unit('sample', '1', '2', sample_families())).files)"
    texts = {
        subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "PYTHONHASHSEED": seed},
            cwd=Path(__file__).parents[3],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(texts) == 1


def test_the_default_parameters_are_written_to_the_last_bit(tmp_path: Path, requires: Requires) -> None:
    values = {"third": 1 / 3, "tiny": 5e-324, "large": -1.7976931348623157e308}
    b = Builder()
    p = b.vector(ports.PARAMETERS, 3)
    b.output_dense(ports.SETUP, [[x * x] for x in p])
    sample = write_sample(tmp_path, families=(Family(b.build("setup")),), parameters=values)
    run(requires("gcc"), "-std=c99", "-fPIC", "-shared", *kernels(sample), "-lm", "-o", tmp_path / "lib.so")
    found = np.zeros(3)
    ctypes.CDLL(str(tmp_path / "lib.so")).sample_default_parameters(found.ctypes.data_as(ctypes.c_void_p))
    assert found.tolist() == list(values.values())
    assert "#define sample_PARAMETERS 3\n" in (sample / "sample.h").read_text()


@pytest.mark.parametrize("name", ["*/ #error", "évil\n", '"); system("id', "机械臂"])
def test_the_name_of_a_model_is_not_in_its_files(name: str, tmp_path: Path) -> None:
    write_sample(tmp_path, name)
    assert [file for file in tmp_path.glob("*.[ch]") if name in file.read_text() or name in file.name] == []


def test_a_number_beyond_floats_is_refused_by_the_compiler(tmp_path: Path, requires: Requires) -> None:
    tape = Tape(
        Function("impl"), (), (LITERALS.mpf("1e300"),), (), (Output(Port("f", Role.RESULT), Sparsity.dense(1), (0,)),)
    )
    write_sample(tmp_path, families=(Family(tape),))
    options = ["-std=c99", "-Werror", "-c", tmp_path / "sample_impl.c", "-o", tmp_path / "x.o"]
    run(requires("gcc"), *options)
    assert subprocess.run([requires("gcc"), "-DMBS_REAL=float", *options], capture_output=True).returncode != 0


def random_tape(seed: int, size: int) -> Tape:
    """Draw operations that IEEE arithmetic rounds alike everywhere: all but sine and cosine."""
    rng = random.Random(seed)
    literals = tuple(LITERALS.mpf(rng.uniform(-2, 2)) for _ in range(4))
    operations = []
    for value in range(7, 7 + size):
        op = rng.choice([Op.ADD, Op.SUB, Op.MUL, Op.DIV, Op.NEG, Op.SQRT])
        recent = range(max(0, value - 12), value)
        operations.append((op, rng.choice(recent), rng.choice(recent) if op.arity == 2 else -1))
    outputs = tuple(range(7 + size - 8, 7 + size))
    return Tape(
        Function("impl"),
        (Input(Port("x", Role.ARGUMENT), Sparsity.dense(3)),),
        literals,
        tuple(operations),
        (Output(Port("f", Role.RESULT), Sparsity.dense(8), outputs),),
    )


@pytest.mark.parametrize("length", [1000, 25, 1])
@pytest.mark.parametrize("seed", range(8))
def test_c_rounds_as_the_tape_does(seed: int, length: int, tmp_path: Path, requires: Requires) -> None:
    """Without contraction, the same operations in the same order give the same bits, NaN included; in parts as well."""
    tape = random_tape(seed, 150)
    write_sample(tmp_path, families=(Family(tape),), part=length)
    is_divided = "static MBS_APART int mbs_part2(" in (tmp_path / "sample_impl.c").read_text()
    assert is_divided == (length < 1000)
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared"]
    run(requires("gcc"), *flags, tmp_path / "sample_impl.c", "-lm", "-o", tmp_path / "lib.so")
    function = ctypes.CDLL(str(tmp_path / "lib.so")).sample_compute_impl
    x, f = np.random.default_rng(seed).normal(size=3), np.zeros(8)
    pointer = ctypes.POINTER(ctypes.c_double)
    assert function(x.ctypes.data_as(pointer), f.ctypes.data_as(pointer)) == 0
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(f, evaluate(tape, {"x": list(x)}, FLOATS64)["f"])


def test_single_precision_agrees_to_its_rounding(sample: Path, tmp_path: Path, requires: Requires) -> None:
    flags = ["-std=c99", "-O2", "-DMBS_REAL=float", "-fPIC", "-shared"]
    run(requires("gcc"), *flags, sample / "sample_impl.c", "-lm", "-o", tmp_path / "lib.so")
    given = {"x": [0.3, -0.5, 0.8], "y": [1.2, -0.7], "u": [], "z": [0.4], "h": [1.75, 0.7]}
    exact = evaluate(sample_tape(), given)
    arrays = [np.array(v, dtype=np.float32) for v in given.values() if v]
    results = [np.zeros(len(v), dtype=np.float32) for v in exact.values()]
    pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_float)) for a in (*arrays, *results)]
    assert ctypes.CDLL(str(tmp_path / "lib.so")).sample_float_compute_impl(*pointers) == 0
    for found, value in zip(results, exact.values(), strict=True):
        # A dozen operations on numbers of order 1, each rounded to 6e-8.
        np.testing.assert_allclose(found, value, rtol=0, atol=12 * np.finfo(np.float32).eps)


def test_derivatives_are_laid_out_as_casadi_counts() -> None:
    """Blocks over all inputs, those without derivative too; `out_` inputs and missing blocks have empty patterns."""
    value, jac, adj1, jac_adj1 = faces(sample_families()[1], "sample")
    inputs, results = ["x", "y", "u", "z", "h"], ["f", "g"]
    assert [s.name for s in value.inputs] == inputs
    assert [s.name for s in jac.inputs] == [*inputs, "out_f", "out_g"]
    assert [s.name for s in jac.outputs] == [f"jac_{o}_{i}" for o in results for i in inputs]
    assert [s.name for s in adj1.inputs] == [*inputs, "out_f", "out_g", "adj_f", "adj_g"]
    assert [s.name for s in adj1.outputs] == [f"adj_{i}" for i in inputs]
    assert [s.name for s in jac_adj1.inputs] == [*(s.name for s in adj1.inputs), *(f"out_adj_{i}" for i in inputs)]
    blocks = [f"jac_adj_{i}_{s.name}" for i in inputs for s in adj1.inputs]
    assert [s.name for s in jac_adj1.outputs] == blocks
    for face in (jac, adj1, jac_adj1):
        for slot in (*face.inputs, *face.outputs):
            if slot.name.startswith("out_") or slot.name.endswith("_h") or "_out_" in slot.name:
                assert slot.sparsity.nnz == 0
    assert [s.differentiable for s in value.inputs] == [True, True, True, True, False]


def test_the_manifest_lists_what_the_tapes_take_and_give() -> None:
    own = sample_families()[1]
    kernels = {k.name: k for k in write_c(Unit("sample", "1", "2", (own,))).kernels}
    assert list(kernels) == ["impl", "jac_impl", "adj1_impl", "jac_adj1_impl"]
    for tape in (own.value, own.jac, own.adj1, own.jac_adj1):
        assert tape is not None
        kernel = kernels[tape.name]
        assert [a.name for a in kernel.inputs] == [i.name for i in tape.inputs]
        assert [(a.name, a.nnz) for a in kernel.outputs] == [(o.name, o.sparsity.nnz) for o in tape.outputs]
    assert kernels["jac_adj1_impl"].symbol == "jac_adj1_sample_impl"
    assert kernels["jac_adj1_impl"].function == "sample_compute_jac_adj1_impl"
    assert next(a for a in kernels["impl"].outputs if a.name == "g").row == (0, 1, 1)
    assert [a.name for a in kernels["impl"].inputs if not a.differentiable] == ["h"]


def test_a_tape_that_casadi_has_no_place_for_is_our_mistake() -> None:
    own = family(sample_tape())
    assert own.jac is not None
    first, *others = own.jac.outputs
    stray = replace(own.jac, outputs=(replace(first, port=replace(first.port, name="jac_f_w")), *others))
    with pytest.raises(AssertionError, match="no place for"):
        faces(replace(own, jac=stray), "sample")
