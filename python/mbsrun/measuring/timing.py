"""C functions in CasADi's contract, in single and double precision: compiled in variants, called, and timed from C."""

from __future__ import annotations

import ctypes
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mbsgen import resources
from mbsrun.library import Compiler, compile_library, find_compiler
from mbsrun.measuring.points import Cost

Array = NDArray[np.float64]
Numbers = NDArray[np.floating[Any]]
Precision = Literal["float64", "float32"]

SAMPLE_NS = 300_000.0  # what a round gives one function
POINTERS = 64  # room in lists of arguments: a function may ask for more than it has arguments
_INTEGERS = ctypes.POINTER(ctypes.c_longlong)
_TIMING = ("timing/mbs_timing.c", "timing/mbs_timing.h", "mbs_batch.h", "mbs_abi.h")


@dataclass(frozen=True)
class Variant:
    """How C is compiled."""

    precision: Precision = "float64"
    level: Literal["-O0", "-O1", "-O2", "-O3"] = "-O3"
    contract: bool = True  # a product and a sum become one operation, with one rounding
    libm: bool = False  # sines of the C library

    @property
    def label(self) -> str:
        """Say what varies."""
        return self.level + ("" if self.contract else " no fma") + (" libm" if self.libm else "")

    @property
    def number(self) -> np.dtype[Any]:
        """Give the type of its numbers."""
        return np.dtype(self.precision)

    def compiler(self, *extra: str) -> Compiler:
        """Give the compiler with this variant's flags, which win over those of CFLAGS."""
        base = find_compiler(os.environ)
        flags = [self.level, f"-ffp-contract={'fast' if self.contract else 'off'}", *extra]
        flags += ["-DMBS_REAL=float"] if self.precision == "float32" else []
        flags += ["-DMBS_LIBM"] if self.libm else []
        return replace(base, flags=(*base.flags, *flags))


@dataclass(frozen=True)
class Block:
    """A result: a matrix of which nonzeros are passed, column by column."""

    name: str
    rows: int
    cols: int
    places: tuple[NDArray[np.intp], NDArray[np.intp]]  # rows and columns of the nonzeros

    def spread(self, nonzeros: Numbers) -> Array:
        """Give the whole matrix."""
        whole = np.zeros((self.rows, self.cols))
        whole[self.places] = nonzeros[: len(self.places[0])]
        return whole


class Code:
    """A function of a library."""

    def __init__(self, library: Path, symbol: str, variant: Variant) -> None:
        """Load a library, and read what it tells of the function's arguments."""
        self.symbol, self.variant = symbol, variant
        self._library = ctypes.CDLL(str(library))
        self.inputs = tuple(
            self._ask("name_in", ctypes.c_char_p, i).decode() for i in range(self._ask("n_in", ctypes.c_longlong))
        )
        self.results = tuple(
            _read_block(self._ask("name_out", ctypes.c_char_p, i).decode(), self._ask("sparsity_out", _INTEGERS, i))
            for i in range(self._ask("n_out", ctypes.c_longlong))
        )
        sizes = [ctypes.c_longlong() for _ in range(4)]  # sz_arg, sz_res, sz_iw, sz_w
        self._library[f"{symbol}_work"](*map(ctypes.byref, sizes))
        self.iw = np.zeros(sizes[2].value + 1, dtype=np.int64)
        self.w = np.zeros(sizes[3].value + 1, dtype=variant.number)

    @cached_property
    def address(self) -> ctypes.c_void_p:
        """Give where the machine code is."""
        return ctypes.cast(self._library[self.symbol], ctypes.c_void_p)

    def lay(self, states: Mapping[str, Array]) -> list[Numbers]:
        """Round states, arrays (K, size) by name, to the variant's numbers; what has no name there is not looked at."""
        count = len(states["q"])
        unused = np.zeros((count, 1))
        return [np.ascontiguousarray(states.get(name, unused), dtype=self.variant.number) for name in self.inputs]

    def call(self, inputs: Sequence[Numbers]) -> tuple[NDArray[np.int64], list[dict[str, Array]]]:
        """Compute all states laid out; give the status of each, and results as whole matrices: none where it fails."""
        function = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 4, ctypes.c_int)(self.address.value or 0)
        found = [np.full(max(1, len(x.places[0])), np.nan, dtype=self.variant.number) for x in self.results]
        res = _point_to(found)
        statuses, results = np.zeros(len(inputs[0]), dtype=np.int64), []
        for k in range(len(statuses)):
            arg = _point_to([x[k:] for x in inputs])
            statuses[k] = function(arg, res, self.iw.ctypes.data, self.w.ctypes.data, 0)
            blocks = zip(self.results, found, strict=True)
            results.append({} if statuses[k] else {block.name: block.spread(values) for block, values in blocks})
        return statuses, results

    def _ask(self, what: str, kind: Any, *place: int) -> Any:
        function = self._library[f"{self.symbol}_{what}"]
        function.restype, function.argtypes = kind, [ctypes.c_longlong] * len(place)
        return function(*place)


class _Pool(ctypes.Structure):
    """`mbs_pool` of csrc/timing."""

    _fields_ = (
        ("states", ctypes.c_longlong),
        ("n_in", ctypes.c_longlong),
        ("inputs", ctypes.c_void_p),
        ("steps", ctypes.c_void_p),
        ("results", ctypes.c_void_p),
        ("iw", ctypes.c_void_p),
        ("w", ctypes.c_void_p),
        ("kernel", ctypes.c_void_p),
    )


class Watch:
    """A function, bound to states that it can compute, and to the timing loop of its precision."""

    def __init__(self, code: Code, inputs: Sequence[Numbers]) -> None:
        """Take inputs as `Code.lay` gives them."""
        self._inputs, self._code = list(inputs), code
        self._results = [np.zeros(max(1, len(x.places[0])), dtype=code.variant.number) for x in code.results]
        self._steps = np.array([x.shape[1] for x in inputs], dtype=np.int64)
        self._arg, self._res = _point_to(self._inputs), _point_to(self._results)
        self._pool = _Pool(
            len(inputs[0]),
            len(inputs),
            ctypes.addressof(self._arg),
            self._steps.ctypes.data,
            ctypes.addressof(self._res),
            code.iw.ctypes.data,
            code.w.ctypes.data,
            code.address.value,
        )
        self._time = ctypes.CDLL(str(_compile_timing(code.variant.precision))).mbs_time_kernel
        self._time.restype, self._time.argtypes = ctypes.c_double, (ctypes.c_void_p, ctypes.c_longlong)
        self.passes = max(1, round(SAMPLE_NS / (self.measure(1) * len(inputs[0]))))

    def measure(self, passes: int) -> float:
        """Go through the states `passes` times; give nanoseconds per call."""
        ns = float(self._time(ctypes.addressof(self._pool), passes))
        assert ns > 0, "states that fail are not timed"
        return ns


def measure_costs(watches: Sequence[Watch], rounds: int) -> list[Cost]:
    """Time functions in turn, many rounds of all of them in an order that changes, on one core: nanoseconds per call.

    So what the machine does meanwhile hits all alike.
    """
    rng = np.random.default_rng(0)
    times = np.zeros((len(watches), rounds))
    with _one_core():
        for k in range(rounds):
            for i in rng.permutation(len(watches)):
                times[i, k] = watches[i].measure(watches[i].passes)
    return [sum_up(row) for row in times]


def sum_up(rounds: Array) -> Cost:
    """Sum up the times of several rounds."""
    first, median, third = (float(x) for x in np.quantile(rounds, (0.25, 0.5, 0.75)))
    return Cost(float(rounds.min()), median, (third - first) / median, len(rounds))


def _compile_timing(precision: Precision) -> Path:
    with tempfile.TemporaryDirectory() as place:
        for name in _TIMING:  # side by side: what is compiled lies in one folder
            shutil.copy(resources.folder("csrc") / name, place)
        compiler = Variant(precision).compiler("-D_POSIX_C_SOURCE=199309L")
        return compile_library(Path(place), "mbs_timing", ["mbs_timing.c"], compiler)


@contextmanager
def _one_core() -> Iterator[None]:
    """Keep this process on one of the cores that it may use; all of them again afterwards."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _read_block(name: str, pattern: Any) -> Block:
    """Read a pattern of CasADi's contract: rows, columns, then 1 for a dense matrix, or column pointers and rows."""
    rows, cols = pattern[0], pattern[1]
    if pattern[2]:
        every = np.arange(rows * cols)
        return Block(name, rows, cols, (every % max(rows, 1), every // max(rows, 1)))
    pointers = pattern[2 : 3 + cols]
    row = np.array(pattern[3 + cols : 3 + cols + pointers[cols]], dtype=np.intp)
    return Block(name, rows, cols, (row, np.repeat(np.arange(cols), np.diff(pointers))))


def _point_to(arrays: Sequence[Numbers]) -> ctypes.Array[ctypes.c_void_p]:
    return (ctypes.c_void_p * POINTERS)(*(x.ctypes.data for x in arrays))
