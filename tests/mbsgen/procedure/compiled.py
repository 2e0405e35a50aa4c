"""Procedures in C, compiled and called."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbsgen.procedure.procedure import Procedure
from mbsgen.targets.c.files import Sources, write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.parts import LENGTH
from mbsgen.targets.unit import Unit

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


def write(families: tuple[Family, ...], folder: Path, part: int = LENGTH) -> Sources:
    """Write the C of families to a folder, in parts of `part` lines at least."""
    sources = write_c(Unit("toy", "0", "0", families, part=part))
    for file, text in sources.files.items():
        (folder / file).write_text(text)
    return sources


class Library:
    """The kernels of families, compiled with strict warnings."""

    def __init__(self, families: Sequence[Family], folder: Path) -> None:
        sources = write(tuple(families), folder)
        files = [folder / file for file in sources.sources]
        command: list[str | Path] = ["gcc", *STRICT, "-shared", "-fPIC", *files, "-lm", "-o", folder / "toy.so"]
        subprocess.run(command, check=True)
        self._library = ctypes.CDLL(str(folder / "toy.so"))

    def call(self, function: Procedure, point: dict[str, list[float]]) -> tuple[int, dict[str, np.ndarray]]:
        """Return the status and the results, which are 5 where nothing is written."""
        given = [np.array(point[i.name], float) for i in function.inputs if i.sparsity.nnz]
        results = {o.name: np.full(o.sparsity.nnz, 5.0) for o in function.outputs if o.sparsity.nnz}
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*given, *results.values())]
        return self._library[f"toy_compute_{function.name}"](*pointers), results
