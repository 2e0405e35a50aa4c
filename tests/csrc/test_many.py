"""Many states in C: lanes against single states, at every width, in arrays of exactly their size, under sanitizers."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from mbsgen import resources

HERE, CSRC = Path(__file__).parent, resources.folder("csrc")
FLAGS = (
    "-std=gnu99",
    "-g",
    "-O1",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
    "-Wall",
    "-Wextra",
    "-Werror",
)


@pytest.mark.parametrize(
    ("compiler", "real", "width", "inputs", "results"),
    [
        *(("gcc", "double", width, *sizes) for width in (2, 4, 8) for sizes in ((1, 1), (3, 6), (17, 9))),
        ("gcc", "float", 16, 5, 18),
        ("gcc", "float", 4, 4, 4),
        *(("clang", "double", width, 3, 17) for width in (2, 8)),
    ],
)
def test_lanes_give_what_single_states_give(
    compiler: str, real: str, width: int, inputs: int, results: int, tmp_path: Path
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"needs {compiler}")
    sizes = [f"-DMBS_REAL={real}", f"-DINPUTS={inputs}", f"-DRESULTS={results}", f"-DWIDTH={width}", f"-I{CSRC}"]
    kernel, many = HERE / "many_kernel.c", CSRC / "mbs_many.c"
    sources = {"one": (kernel, ()), "several": (kernel, (f"-DMBS_STATES={width}",)), "main": (HERE / "many_main.c", ())}
    sources |= {"loop": (many, ()), "lanes": (many, (f"-DMBS_STATES={width}",))}
    objects = []
    for name, (source, more) in sources.items():
        objects.append(tmp_path / f"{name}.o")
        subprocess.run([compiler, *FLAGS, *sizes, *more, "-c", source, "-o", objects[-1]], check=True)
    subprocess.run([compiler, *FLAGS, *objects, "-lm", "-o", tmp_path / "program"], check=True)
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "0\n", "")
