"""Factors of a sparse symmetric indefinite matrix, K = L D L', by `csrc/kkt`, with the signs of its eigenvalues.

The matrix is scaled first, S K S, so that the largest entry of each row is about 1 (Ruiz, "A scaling algorithm to
equilibrate both rows and columns norms in matrices", RAL-TR-2001-034). Solutions are refined with K itself.
"""

from __future__ import annotations

import ctypes
from functools import cache
from weakref import finalize

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.linear import compile_own
from mbsrun.ocp.ground.program import Matrix

ROUNDS = 4  # of scaling
ZERO = 1e-14  # a pivot that is none, where entries are about 1
THRESHOLD = 1e-2  # least ratio of a pivot to its column
REFINEMENTS = 3
SMALL = 1e-15  # of a residual, over the right side: nothing is left to refine
SINGULAR = -7  # the library's word

_Ints = ctypes.POINTER(ctypes.c_int)
_Doubles = ctypes.POINTER(ctypes.c_double)


class _Settings(ctypes.Structure):
    """The structure `ipopt_settings` of mbs_ipopt.h."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("one_based", "keep_on", "least_front")),
        ("spare_room", ctypes.c_double),
        *((name, ctypes.c_int) for name in ("ordering", "print_level", "scaling")),
        *((name, ctypes.c_double) for name in ("zero", "threshold")),
        *((name, ctypes.c_int) for name in ("diagnostics", "errors", "warnings")),
        ("parallel_from", ctypes.c_long),
        ("blas3", ctypes.c_int),
        ("parallel_solve_from", ctypes.c_long),
        ("multifrontal_solve", ctypes.c_int),
        ("consistency", ctypes.c_double),
        ("spare", ctypes.c_int * 5),
        ("spare_numbers", ctypes.c_double * 10),
    )


class _Report(ctypes.Structure):
    """The structure `ipopt_report` of mbs_ipopt.h."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("flag", "flag68", "flag77", "duplicates", "rank")),
        *((name, ctypes.c_int) for name in ("outside", "no_diagonal", "depth", "front", "delayed")),
        *((name, ctypes.c_long) for name in ("entries", "products")),
        *((name, ctypes.c_int) for name in ["negative", "fronts", "pairs", "ordering", "status", "widest"]),
        ("spare", ctypes.c_int * 4),
        ("spare_numbers", ctypes.c_double * 10),
    )


@cache
def _load() -> ctypes.CDLL:
    return ctypes.CDLL(str(compile_own()))


class Factors:
    """The factors of a symmetric matrix, of which the lower triangle is given."""

    def __init__(self, lower: Matrix, zero: float = ZERO) -> None:
        """Factorise. Entries of the lower triangle, each once; pivots up to `zero` are none. Raises CompileError."""
        self.size = lower.shape[0]
        self._whole = sparse.csr_array(mirror(lower))
        self._scales = _find_scales(self._whole)
        entries, diagonal = lower.tocoo(), np.arange(self.size)
        row, col = (np.concatenate((part, diagonal)).astype(np.int64) for part in (entries.row, entries.col))
        scaled_data = entries.data * self._scales[entries.row] * self._scales[entries.col]
        data = np.concatenate((scaled_data, np.zeros(self.size)))
        scaled = sparse.coo_array((data, (row, col)), shape=lower.shape).tocsc()
        start, rows = scaled.indptr.astype(np.int32), scaled.indices.astype(np.int32)
        self._library, self._settings, self._report = _load(), _Settings(), _Report()
        self._library.ma97_default_control_d(ctypes.byref(self._settings))
        self._settings.zero, self._settings.threshold = zero, THRESHOLD
        self._pattern, self._factors = ctypes.c_void_p(), ctypes.c_void_p()
        finalize(self, _release, self._library, self._pattern, self._factors)  # before an interpreter ends, too
        values: Array = np.ascontiguousarray(scaled.data)
        system = _point(start, _Ints), _point(rows, _Ints), _point(values, _Doubles)
        self._library.ma97_analyse_d(
            0, self.size, *system, ctypes.byref(self._pattern), self._by("settings"), self._by("report"), None
        )
        self._library.ma97_factor_d(
            4, *system, self._by("pattern"), self._by("factors"), self._by("settings"), self._by("report"), None
        )
        self.is_singular = self._report.flag != 0
        self.negative = int(self._report.negative)  # eigenvalues

    def solve(self, right: Array) -> Array:
        """Return K^-1 times a vector, or times the columns of a matrix."""
        if not self.size:  # all variables are held
            return right.copy()
        known = right.reshape(self.size, -1)
        found = self._solve(known)
        for _ in range(REFINEMENTS):
            rest = known - self._whole @ found
            if (np.abs(rest).max(axis=0, initial=0.0) <= SMALL * np.abs(known).max(axis=0, initial=0.0)).all():
                break
            found = found + self._solve(rest)
        return found.reshape(right.shape)

    def measure_condition(self) -> float:
        """Return about the condition of the scaled matrix, in the 1-norm; infinite where it is singular."""
        from scipy.sparse.linalg import LinearOperator, onenormest  # here, and late: it takes long to load

        if self.is_singular:
            return np.inf
        if not self.size:
            return 1.0
        scaled = sparse.diags_array(self._scales) @ self._whole @ sparse.diags_array(self._scales)
        shape = (self.size, self.size)
        inverse = LinearOperator(shape, matvec=self._solve_scaled, rmatvec=self._solve_scaled, dtype=np.float64)
        columns: Array = np.asarray(abs(scaled).T @ np.ones(self.size))
        return float(onenormest(inverse) * columns.max(initial=0.0))

    def _solve(self, right: Array) -> Array:
        return np.asarray(self._scales[:, None] * self._solve_scaled(self._scales[:, None] * right))

    def _solve_scaled(self, right: Array) -> Array:
        columns: Array = np.ascontiguousarray(right.reshape(self.size, -1).T, dtype=np.float64).copy()
        self._library.ma97_solve_d(
            0, len(columns), _point(columns, _Doubles), self.size, self._by("pattern"), self._by("factors"),
            self._by("settings"), self._by("report"),
        )  # fmt: skip
        return columns.T.reshape(right.shape)

    def _by(self, name: str) -> object:
        return ctypes.byref(getattr(self, f"_{name}"))


def mirror(triangle: Matrix) -> sparse.csc_array:
    """Return the whole of a symmetric matrix of which a triangle is given."""
    entries = triangle.tocoo()
    off = entries.row != entries.col
    row, col = np.concatenate((entries.row, entries.col[off])), np.concatenate((entries.col, entries.row[off]))
    data = np.concatenate((entries.data, entries.data[off]))
    return sparse.csc_array((data, (row, col)), shape=triangle.shape)


def _release(library: ctypes.CDLL, pattern: ctypes.c_void_p, factors: ctypes.c_void_p) -> None:
    library.ma97_finalise_d(ctypes.byref(pattern), ctypes.byref(factors))


def _point(array: object, kind: object) -> object:
    return array.ctypes.data_as(kind)  # type: ignore[attr-defined]


def _find_scales(whole: sparse.csr_array) -> Array:
    filled = np.flatnonzero(np.diff(whole.indptr))
    row, col = np.repeat(np.arange(whole.shape[0]), np.diff(whole.indptr)), whole.indices
    scales, magnitudes = np.ones(whole.shape[0]), np.abs(whole.data)
    for _ in range(ROUNDS if magnitudes.size else 0):
        largest = np.zeros(scales.size)
        largest[filled] = np.maximum.reduceat(magnitudes * scales[row] * scales[col], whole.indptr[filled])
        scales = scales / np.sqrt(np.where(largest > 0, largest, 1.0))
    return scales
