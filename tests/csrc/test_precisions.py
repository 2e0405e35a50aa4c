"""Hand-written C in both precisions: no two functions have one name in object files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from mbsgen import resources
from tests.mbsgen.targets.programs import run

CSRC = resources.folder("csrc")
# Numbers of any precision.
SHARED = ("cone", "explicit", "least", "many", "radau", "rollout", "solids", "stepping", "variational")


def list_symbols(out: Path, sources: Sequence[Path], *flags: str) -> set[str]:
    """Compile files, and list what their objects define for others."""
    out.mkdir()
    folders = [f"-I{CSRC / part}" for part in (".", "stages", "program")]
    done = run("cc", "-std=c99", "-O0", *flags, *folders, "-c", *sources, cwd=out)
    assert done.returncode == 0, done.stderr
    listed = run("nm", "--defined-only", "--extern-only", *sorted(out.glob("*.o")), cwd=out).stdout.splitlines()
    return {parts[2] for line in listed if len(parts := line.split()) == 3}


@pytest.mark.parametrize("part", ["stages", "program"])
def test_the_solver_in_single_precision_has_names_of_its_own(part: str, tmp_path: Path) -> None:
    """Static libraries of both precisions in one program: a linker takes the first function of a name."""
    sources = sorted((CSRC / part).glob("*.c"))
    doubles = list_symbols(tmp_path / "double", sources)
    floats = list_symbols(tmp_path / "float", sources, "-DMBS_STAGES_FLOAT")
    assert floats == {f"{name}_float" for name in doubles}


@pytest.mark.parametrize("width", ["", "8"])
def test_shared_files_in_single_precision_have_names_of_their_own(
    tmp_path: Path, width: str, requires: Callable[[str], str]
) -> None:
    """Files that take numbers of any precision; in lanes the number of states is in the name, too."""
    requires("gcc")  # for vectors
    names = ("many", "rollout") if width else SHARED
    sources = [CSRC / f"mbs_{name}.c" for name in names]
    lanes = [f"-DMBS_STATES={width}"] if width else []
    doubles = list_symbols(tmp_path / "double", sources, *lanes)
    floats = list_symbols(tmp_path / "float", sources, *lanes, "-DMBS_REAL=float")
    assert doubles & floats == set()
    assert {name.replace("_float", "") for name in floats} == doubles


def test_every_shared_file_with_numbers_of_any_precision_is_listed() -> None:
    """A new file whose functions take `casadi_real` or `mbs_real` needs other names in single precision."""
    number = re.compile(r"\b(casadi_real|MBS_REAL|mbs_real)\b")
    headers = {path.stem: path.with_suffix(".h").read_text("utf-8") for path in CSRC.glob("mbs_*.c")}
    found = {name.removeprefix("mbs_") for name, text in headers.items() if number.search(text)}
    assert found - {"check"} == set(SHARED)  # checks have names of their folder
