"""Laws of the decisions that the solver for stages makes: when it accepts, softens, restores, stops, limits, scales.

Each program of `laws/` includes one file of the solver, with stand-ins for the functions that it calls, and prints
the laws that it breaks. Numbers are worked out by hand, or by another way in the program.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from mbsgen.resources import folder
from mbsrun.library import find_compiler
from tests.csrc.stages import STRICT

LAWS = sorted((Path(__file__).parent / "laws").glob("*.c"))


@pytest.mark.parametrize("path", LAWS, ids=lambda path: path.stem)
def test_decisions_keep_their_laws(path: Path, compiled: Path, tmp_path: Path) -> None:
    """Files without stand-ins are linked as they are; the linker takes the first of two functions of one name.

    No law reads or writes beyond an array.
    """
    others = [str(each) for each in sorted(compiled.parent.glob("*.o")) if each.stem not in {path.stem, "quadratic"}]
    folders = [folder("csrc"), *(folder("csrc") / name for name in ("stages", "program", "timing"))]
    flags = [*STRICT, "-O0", "-fsanitize=address", *(f"-I{each}" for each in folders)]
    command = [*find_compiler(os.environ).command, *flags, str(path), *others]
    program = tmp_path / path.stem
    subprocess.run([*command, "-Wl,-z,muldefs", "-lm", "-o", str(program)], check=True)
    done = subprocess.run([program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.returncode) == ("", 0)
