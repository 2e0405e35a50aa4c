"""C functions in CasADi's contract: compiled in variants of precision and flags, described, loaded and called.

    int f(const real **arg, real **res, long long *iw, real *w, int mem)

`arg` points to dense inputs, `res` to the nonzeros of each result, column by column. The status 0 means success.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mbsrun.library import Compiler, find_compiler

Array = NDArray[np.float64]
Numbers = NDArray[np.floating[Any]]
Precision = Literal["float64", "float32", "double-double"]
STORED: Mapping[Precision, str] = {"float64": "float64", "float32": "float32", "double-double": "float64"}

POINTERS = 64  # spare room in lists of arguments: a function may need more entries than it has arguments
_INTEGERS = ctypes.POINTER(ctypes.c_longlong)


@dataclass(frozen=True)
class Variant:
    """Precision and compiler flags of C code."""

    precision: Precision = "float64"
    level: Literal["-O0", "-O1", "-O2", "-O3"] = "-O3"
    contract: bool = True  # a product and a sum become one operation, with one rounding
    libm: bool = False  # sines of the C library

    @property
    def label(self) -> str:
        """Return the flags that vary, as text."""
        return self.level + ("" if self.contract else " no fma") + (" libm" if self.libm else "")

    def compiler(self, *extra: str) -> Compiler:
        """Return the compiler with the flags of this variant, which override CFLAGS."""
        base = find_compiler(os.environ)
        flags = [self.level, f"-ffp-contract={'fast' if self.contract else 'off'}", *extra]
        flags += ["-DMBS_REAL=float"] if self.precision == "float32" else []
        flags += ["-DMBS_LIBM"] if self.libm else []
        return replace(base, flags=(*base.flags, *flags))


@dataclass(frozen=True)
class Block:
    """A result: a matrix with the places of its nonzeros, (row, column), column by column."""

    name: str
    rows: int
    cols: int
    places: tuple[tuple[int, int], ...]

    def scatter(self, nonzeros: Numbers) -> Array:
        """Return the dense matrix; `nonzeros` may have spare entries at its end."""
        whole = np.zeros((self.rows, self.cols))
        whole[self._indices] = nonzeros[: len(self.places)]
        return whole

    @cached_property
    def _indices(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        rows, cols = np.array(self.places, dtype=np.intp).reshape(-1, 2).T
        return rows, cols


@dataclass(frozen=True)
class Face:
    """Inputs and results of a function, and the sizes of its work space."""

    inputs: tuple[str, ...]
    results: tuple[Block, ...]
    sz_iw: int = 0  # integers
    sz_w: int = 0  # numbers


@dataclass(frozen=True)
class Function:
    """A function in a shared library."""

    library: Path
    symbol: str
    face: Face


def dense(name: str, rows: int, cols: int) -> Block:
    """Return a result without structural zeros."""
    return Block(name, rows, cols, tuple((r, c) for c in range(cols) for r in range(rows)))


def find_function(library: Path, symbol: str) -> Function:
    """Describe a function with the help of the descriptive functions of its library."""
    opened = ctypes.CDLL(str(library))

    def call(what: str, kind: Any, *place: int) -> Any:
        function = opened[f"{symbol}_{what}"]
        function.restype, function.argtypes = kind, [ctypes.c_longlong] * len(place)
        return function(*place)

    names = [call("name_in", ctypes.c_char_p, i).decode() for i in range(call("n_in", ctypes.c_longlong))]
    results = [
        _read_block(call("name_out", ctypes.c_char_p, i).decode(), call("sparsity_out", _INTEGERS, i))
        for i in range(call("n_out", ctypes.c_longlong))
    ]
    sizes = [ctypes.c_longlong() for _ in range(4)]  # sz_arg, sz_res, sz_iw, sz_w
    opened[f"{symbol}_work"](*map(ctypes.byref, sizes))
    return Function(library, symbol, Face(tuple(names), tuple(results), sizes[2].value, sizes[3].value))


def _read_block(name: str, pattern: Any) -> Block:
    """Read a pattern of CasADi's contract: rows, columns, then 1 for a dense matrix, or column pointers and rows."""
    rows, cols = pattern[0], pattern[1]
    if pattern[2]:
        return dense(name, rows, cols)
    pointers = pattern[2 : 3 + cols]
    places = [(pattern[3 + cols + k], c) for c in range(cols) for k in range(pointers[c], pointers[c + 1])]
    return Block(name, rows, cols, tuple(places))


class Code:
    """A loaded function, with its work space."""

    def __init__(self, function: Function, precision: Precision = "float64", blank: float = np.nan) -> None:
        """Load a function; results of a call contain `blank` before it."""
        self.function, self.precision, self.blank = function, precision, blank
        self.inputs, self.results = function.face.inputs, function.face.results
        self._library = ctypes.CDLL(str(function.library))
        self._stored = STORED[precision]  # the type of an array's entries
        self.iw = np.zeros(function.face.sz_iw + 1, dtype=np.int64)
        self.w = np.zeros(function.face.sz_w + 1, dtype=self._stored)

    @cached_property
    def address(self) -> int:
        """Return the address of the machine code."""
        return ctypes.cast(self._library[self.function.symbol], ctypes.c_void_p).value or 0

    def lay(self, states: Mapping[str, Array]) -> list[Numbers]:
        """Return the inputs for states, arrays (K, size) by name, in the precision of the function.

        An input without a name there is 0: second parts of numbers, and results, which CasADi passes to derivatives
        that do not read them.
        """
        zeros = np.zeros((len(states["q"]), max(x.shape[1] for x in states.values())))
        return [np.ascontiguousarray(states.get(name, zeros), dtype=self._stored) for name in self.inputs]

    def make_results(self) -> list[Numbers]:
        """Return arrays for the nonzeros of the results."""
        return [np.full(max(1, len(x.places)), self.blank, dtype=self._stored) for x in self.results]

    def call(self, inputs: Sequence[Numbers]) -> tuple[NDArray[np.int64], list[dict[str, Array]]]:
        """Return the status of each state and its results, dense matrices by name; none where the status is not 0."""
        call = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 4, ctypes.c_int)(self.address)
        found = self.make_results()
        res = point_to(found)
        statuses, results = np.zeros(len(inputs[0]), dtype=np.int64), []
        for k in range(len(statuses)):
            arg = point_to([x[k:] for x in inputs])
            statuses[k] = call(arg, res, self.iw.ctypes.data, self.w.ctypes.data, 0)
            blocks = zip(self.results, found, strict=True)
            results.append({} if statuses[k] else {block.name: block.scatter(values) for block, values in blocks})
        return statuses, results


def point_to(arrays: Sequence[Numbers]) -> ctypes.Array[ctypes.c_void_p]:
    """Return a C array of pointers to arrays, with spare room at its end."""
    return (ctypes.c_void_p * (len(arrays) + POINTERS))(*(x.ctypes.data for x in arrays))
