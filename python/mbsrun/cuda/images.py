"""Kernels of a generated folder -> machine code for a GPU, each compiled once and found again in the cache."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from mbsgen import resources
from mbsgen.manifest import Kernel
from mbsrun.cache import COMPILED, find_or_make
from mbsrun.cuda.nvrtc import Resources, find_nvrtc, read_resources
from mbsrun.kernel import Kernels
from mbsrun.library import read_source

PRECISIONS = {"float64": "double", "float32": "float"}  # of arrays, and the C type
DOUBLE_ALONE = "mbs_double_double.h"  # functions that include it are not computed in single precision


@dataclass(frozen=True)
class Source:
    """The CUDA C of a kernel."""

    file: str
    files: Mapping[str, bytes]  # it, and all that it includes
    function: str  # that computes many states
    prefix: str  # of the model

    def compile(self, architecture: str, dtype: str, *, sparse: bool = False) -> tuple[bytes, Resources]:
        """Compile for an architecture such as sm_90; `sparse`: results are nonzeros. Raises CudaError."""
        defined = _define(dtype, sparse)
        code, log = find_nvrtc().compile(self.file, self.files, architecture, defined)
        return code, read_resources(log, self.function)

    def find(self, architecture: str, dtype: str, *, sparse: bool) -> bytes:
        """Return the machine code, from the cache if it was compiled before. Raises CudaError, CacheError."""
        told = repr((sorted(self.files.items()), architecture, _define(dtype, sparse), find_nvrtc().version))
        name = f"{PurePath(self.file).stem}-{hashlib.sha256(told.encode()).hexdigest()[:40]}.cubin"

        def make(building: Path) -> Path:
            made = building / "kernel.cubin"
            made.write_bytes(self.compile(architecture, dtype, sparse=sparse)[0])
            return made

        return find_or_make(PurePath(COMPILED, self.prefix, name), make).read_bytes()


def _define(dtype: str, sparse: bool) -> tuple[str, ...]:
    return (f"MBS_REAL={PRECISIONS[dtype]}", *(("MBS_NONZEROS",) if sparse else ()))


def write_source(kernels: Kernels, kernel: Kernel) -> Source:
    """Write the CUDA C of a kernel of a folder. Raises CompileError where files are missing."""
    from mbsgen.targets.cuda import HEADER, name_file, name_function, read_header, write_kernel

    file = name_file(kernel)
    given = {file: write_kernel(kernels.manifest, kernel).encode(), HEADER: read_header().encode()}
    files = read_source((kernels.folder, resources.folder("csrc")), file, given)
    return Source(file, files, name_function(kernel), kernels.manifest.prefix)
