"""Many small systems of linear equations at once, factorised in C: see csrc/mbs_dense.h.

NumPy's batches call LAPACK for each system, which takes three times as long for some twenty unknowns.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbsgen import resources
from mbsrun.binding import declare
from mbsrun.library import compile_library, find_compiler, once_per_compiler

if TYPE_CHECKING:
    import cffi

Array = NDArray[np.float64]

_CDEF = """
long long mbs_factorise(long long systems, long long n, double *matrix, long long *pivot);
void mbs_solve(long long systems, long long n, const double *factors, const long long *pivot, long long k, double *b);
void mbs_solve_transposed(long long systems, long long n, const double *factors, const long long *pivot, double *b);
"""


class Factors:
    """Factorised matrices; solutions with a singular one are not numbers."""

    def __init__(self, matrices: Array) -> None:
        """Factorise (G, n, n). Raises CompileError where the C cannot be compiled."""
        self._factors = np.array(matrices, dtype=np.float64, order="C")
        self._shape = self._factors.shape[:2]
        self._pivots = np.empty(self._shape, dtype=np.int64)
        ffi, library = _load()
        self._held = (
            ffi.from_buffer("double[]", self._factors.data),
            ffi.from_buffer("long long[]", self._pivots.data),
        )
        library.mbs_factorise(*self._shape, *self._held)

    def solve(self, b: Array) -> Array:
        """Return A^-1 b of each, (G, n, k)."""
        ffi, library = _load()
        x = np.array(b, dtype=np.float64, order="C")
        library.mbs_solve(*self._shape, *self._held, x.shape[2], ffi.from_buffer("double[]", x.data))
        return x

    def solve_transposed(self, b: Array) -> Array:
        """Return A^-T b of each, (G, n)."""
        ffi, library = _load()
        x = np.array(b, dtype=np.float64, order="C")
        library.mbs_solve_transposed(*self._shape, *self._held, ffi.from_buffer("double[]", x.data))
        return x


@once_per_compiler
def _load() -> tuple[cffi.FFI, Any]:
    ffi, sources = declare(_CDEF), resources.folder("csrc")
    return ffi, ffi.dlopen(str(compile_library(sources, "mbs_dense", ["mbs_dense.c"], find_compiler(os.environ))))
