"""The CUDA C of kernels in arrays of exactly their size, under sanitizers; the emulated driver beside NVIDIA's."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from mbsgen.manifest import Argument
from mbsgen.pipeline import Options, generate
from mbsrun import load
from mbsrun.cuda.images import write_source
from mbsrun.kernel import Kernels
from tests.mbsrun.cuda.emulation import HERE

MODELS = Path(__file__).parents[3] / "models"
FLAGS = ("-std=c++17", "-g", "-O1", "-w", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")


def write_main(kernel: str, inputs: list[Argument], outputs: list[Argument], *, sparse: bool) -> Iterator[str]:
    """Write a program that computes 129 states, some of which fail: states side by side, then one after the other."""
    sizes = {a.name: a.nnz if sparse and a in outputs else a.rows * a.cols for a in (*inputs, *outputs)}
    yield "#include <cstdio>\n#include <cmath>\nstatic void run(long long n, bool by_states) {"
    yield "int *status = new int[n]; unsigned failed = 0;"
    for a in (*inputs, *outputs):
        across = 0 if sparse and a in outputs else 1
        down = max(a.cols, 1) if across else 1
        size = sizes[a.name]
        yield f"mbs_real *p_{a.name} = new mbs_real[{size} * n];"
        yield f"for (long long i = 0; i < {size} * n; ++i) p_{a.name}[i] = i % 7 == 3 ? NAN : 0.3 + 0.01 * (i % 11);"
        yield f"mbs_array {a.name} = {{p_{a.name}, by_states ? 1 : {size}, by_states ? {down} * n : {down},"
        yield f"by_states ? {across} * n : {across}}};"
    pointers = ", ".join(f"&{a.name}" for a in (*inputs, *outputs))
    yield f"void *arguments[] = {{&n, {pointers}, &status}};"
    yield f"grid_run({kernel}, (n + 127) / 128, 128, arguments);"
    yield "for (long long i = 0; i < n; ++i) failed += status[i] != 0;"
    yield 'std::printf("%u ", failed); delete[] status;'
    yield from (f"delete[] p_{a.name};" for a in (*inputs, *outputs))
    yield "}\nint main() { for (int k = 0; k < 2; ++k) { run(0, k); run(1, k); run(129, k); } }"


def test_no_thread_beyond_the_states_computes(tmp_path: Path) -> None:
    check_memory("satellite", "exp1", "double", tmp_path / "folder")


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(("model", "name"), [("four_bar", "jac_exp1"), ("four_bar", "close"), ("satellite", "exp1")])
def test_nothing_beside_the_arrays_is_touched(model: str, name: str, real: str, sparse: bool, tmp_path: Path) -> None:
    check_memory(model, name, real, tmp_path / "folder", sparse=sparse)


def check_memory(model: str, name: str, real: str, folder: Path, *, sparse: bool = False) -> None:
    base = name.removeprefix("jac_")
    generate(MODELS / f"{model}.yaml", folder, Options(functions=(base,), derivatives=1))
    kernels: Kernels = load(folder)
    kernel, source = kernels.describe(name), write_source(kernels, kernels.describe(name))
    for file, text in source.files.items():
        (folder / file).write_bytes(text)
    inputs, outputs = [a for a in kernel.inputs if a.nnz], [a for a in kernel.outputs if a.rows * a.cols]
    main = "\n".join(write_main(source.function, inputs, outputs, sparse=sparse))
    (folder / "main.cpp").write_text(f'#include "{HERE / "grid.h"}"\n#include "{source.file}"\n{main}')
    defined = [f"-DMBS_REAL={real}", *(["-DMBS_NONZEROS"] if sparse else [])]
    subprocess.run(["g++", *FLAGS, *defined, "main.cpp", "-o", "main"], cwd=folder, check=True)
    done = subprocess.run([folder / "main"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    counts = list(map(int, done.stdout.split()))  # of failures among 0, 1 and 129 states, twice
    assert counts[0] == counts[3] == 0
    assert min(counts[2], counts[5]) > 0


def test_the_emulated_driver_has_the_functions_of_nvidias() -> None:
    """The compiler refuses a declaration that differs from the one in cuda.h."""
    nvcc = shutil.which("nvcc")
    installed = [Path("/usr/local/cuda/include"), *([Path(nvcc).resolve().parents[1] / "include"] if nvcc else [])]
    folder = next((folder for folder in installed if (folder / "cuda.h").exists()), None)
    if folder is None:
        pytest.skip("needs cuda.h")
    command = ["g++", "-std=c++17", "-fpermissive", "-w", "-fsyntax-only", "-DWITH_CUDA_H", f"-I{folder}"]
    done = subprocess.run([*command, HERE / "fake_driver.cpp"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
