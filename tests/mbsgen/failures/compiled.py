"""Tapes as C, called through ctypes."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family
from tests.mbsgen.failures.mechanisms import Array
from tests.mbsgen.targets.compilation import STRICT, name_in, run
from tests.sample import write_sample

LARGE = 3_000  # operations


class Compiled:
    """The kernels of some tapes, in double or in single precision."""

    def __init__(self, folder: Path, compiler: str, tapes: Sequence[Tape], *, real: str = "double") -> None:
        folder = write_sample(folder, families=tuple(map(Family, tapes)))
        library = folder / "lib.so"
        sources = [folder / f"sample_{tape.name}.c" for tape in tapes]
        level = "-O2" if max(len(tape.operations) for tape in tapes) < LARGE else "-O0"  # a tenth of the time
        flags = [*STRICT, level, f"-DMBS_REAL={real}", "-fPIC", "-shared"]
        run(compiler, *flags, *sources, "-lm", "-o", library)
        self._library, self._real = ctypes.CDLL(str(library)), real
        self._number = {"double": np.dtype(np.float64), "float": np.dtype(np.float32)}[real]

    def __call__(self, tape: Tape, state: Mapping[str, Array]) -> tuple[int, dict[str, Array]]:
        """Return a kernel's status and results; where it fails, these keep their old values, which are not numbers."""
        given = [np.array(state[i.name], dtype=self._number) for i in tape.inputs]
        results = {o.name: np.full(o.sparsity.nnz, np.nan, dtype=self._number) for o in tape.outputs}
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*given, *results.values())]
        status = self._library[name_in(self._real, f"sample_compute_{tape.name}")](*pointers)
        return status, {name: x.astype(float) for name, x in results.items()}
