"""The CUDA C of every kernel is compiled for GPUs by NVIDIA's compilers, and the emulation finds no fault in it."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

import mbsrun.cuda.images
from mbsgen.output import write_folder
from mbsgen.pipeline import Options, make
from mbsrun import load
from mbsrun.cli import cli
from mbsrun.cuda.images import DOUBLE_ALONE, write_source
from mbsrun.cuda.nvrtc import CudaError, Nvrtc, Resources, find_nvrtc, read_resources

MODELS = Path(__file__).parents[3] / "models"


def find_compiler() -> Nvrtc:
    try:
        return find_nvrtc()
    except CudaError as fault:
        pytest.skip(str(fault))


@pytest.mark.parametrize(
    ("model", "options"),
    [
        ("four_bar", Options(functions=("exp1", "close", "project"))),
        ("satellite", Options(functions=("impl",), derivatives=1)),
        ("cart_pole", Options(runtime=True, functions=("exp1", "condition"), targets=("double-double", "bounds"))),
    ],
)
def test_every_kernel_compiles(model: str, options: Options, tmp_path: Path) -> None:
    """For two architectures and both precisions, without a warning; functions in double-double in one."""
    compiler = find_compiler()
    write_folder(make(MODELS / f"{model}.yaml", options).files, tmp_path / "folder")
    kernels = load(tmp_path / "folder")
    for kernel in kernels.manifest.kernels:
        source = write_source(kernels, kernel)
        for real, architecture in (("double", "sm_90"), ("float", "sm_80")):
            if real == "float" and DOUBLE_ALONE in source.files:
                continue
            code, log = compiler.compile(source.file, source.files, architecture, [f"MBS_REAL={real}"])
            assert code.startswith(b"\x7fELF")
            assert "warning" not in log, log
            assert 0 < read_resources(log, source.function).registers <= 255


def test_what_does_not_compile_is_told() -> None:
    with pytest.raises(CudaError, match=r"(?s)NVRTC cannot compile x.cu for sm_90:.*x.cu\(1\): error"):
        find_compiler().compile("x.cu", {"x.cu": b"int f() { return y; }"}, "sm_90")
    with pytest.raises(CudaError, match="says nothing of g"):
        read_resources("", "g")


def test_code_is_found_in_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    find_compiler()
    kernels = load(MODELS / "double_pendulum.yaml")
    source = write_source(kernels, kernels.describe("impl"))
    first = source.find("sm_90", "float32", sparse=False)
    assert source.compile("sm_90", "float32")[1].spilled == 0

    class Fails:
        version = find_nvrtc().version

    monkeypatch.setattr(mbsrun.cuda.images, "find_nvrtc", Fails)
    assert source.find("sm_90", "float32", sparse=False) == first


def test_nvcc_compiles_the_files_of_a_folder(tmp_path: Path) -> None:
    """As they are, without a warning."""
    nvcc = shutil.which("nvcc")
    if nvcc is None:
        pytest.skip("needs nvcc")
    product = make(MODELS / "four_bar.yaml", Options(functions=("exp1", "close"), derivatives=1, targets=("cuda",)))
    write_folder({**product.files, **product.packages}, tmp_path / "folder")
    for name in ("four_bar_jac_exp1", "four_bar_close"):
        command = [nvcc, "-arch=sm_90", "-cubin", "-Werror", "all-warnings", f"{name}.cu", "-o", f"{name}.cubin"]
        done = subprocess.run(command, cwd=tmp_path / "folder", capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")


def test_resources_are_read_from_the_log() -> None:
    log = """ptxas info    : Function properties for other
ptxas         .     8 bytes stack frame, 9 bytes spill stores, 9 bytes spill loads
ptxas info    : Function properties for f_many
ptxas         .     64 bytes stack frame, 16 bytes spill stores, 24 bytes spill loads
ptxas info    : Used 122 registers, used 0 barriers, 64 bytes cumulative stack size"""
    assert read_resources(log, "f_many") == Resources(122, 64, 16)


def test_the_command_shows_registers_and_writes_code(tmp_path: Path) -> None:
    find_compiler()
    model, out = str(MODELS / "double_pendulum.yaml"), tmp_path / "code"
    options = ("--functions", "impl,exp1", "--derivatives", "0")
    done = CliRunner().invoke(cli, ["cuda", model, *options, "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert re.search(r"impl +\d+ +\d+ +0\b", done.output)
    assert sorted(file.name for file in out.iterdir()) == ["exp1.sm_90.float64.cubin", "impl.sm_90.float64.cubin"]
    single = CliRunner().invoke(cli, ["cuda", model, *options, "--float32", "--arch", "sm_80", "-o", str(out)])
    assert single.exit_code == 0
    assert (out / "impl.sm_80.float32.cubin").stat().st_size > 1000
    wrong = CliRunner().invoke(cli, ["cuda", model, "--arch", "H100"])
    assert wrong.exit_code == 2
    assert "'H100' is no architecture; give one such as sm_80 or sm_90" in wrong.output
