"""Time functions in turn, many rounds of all of them in an order that changes, on one core.

So a disturbance by other programs hits all functions alike. The loop over states runs in C (`csrc/timing`).
"""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen import resources
from mbsrun.library import compile_library
from mbsrun.measuring.functions import Code, Numbers, Precision, Variant, point_to
from mbsrun.measuring.points import Cost

Array = NDArray[np.float64]

SAMPLE_NS = 300_000.0  # time of one function in a round
_TIMING = ("timing/mbs_timing.c", "timing/mbs_timing.h", "mbs_many.h", "mbs_abi.h", "mbs_states.h")


class Pool(ctypes.Structure):
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
        """Take inputs from `Code.lay`. Raises ArithmeticError where the function fails in one of the states."""
        self._inputs, self._code = list(inputs), code
        self._results = code.make_results()
        self._steps = np.array([x.shape[1] for x in inputs], dtype=np.int64)
        self._arg, self._res = point_to(self._inputs), point_to(self._results)
        self._pool = Pool(
            len(inputs[0]),
            len(inputs),
            ctypes.addressof(self._arg),
            self._steps.ctypes.data,
            ctypes.addressof(self._res),
            code.iw.ctypes.data,
            code.w.ctypes.data,
            code.address,
        )
        self._time = load_timing(code.precision)
        self.passes = max(1, round(SAMPLE_NS / (self.measure(1) * len(inputs[0]))))

    @property
    def last(self) -> list[Numbers]:
        """Return the nonzeros of the results for the state that was computed last."""
        return self._results

    def measure(self, passes: int) -> float:
        """Pass the states `passes` times; return nanoseconds per call."""
        ns = float(self._time(ctypes.addressof(self._pool), passes))
        if ns < 0:
            raise ArithmeticError(f"{self._code.function.symbol}: it fails in one of the states")
        return ns


def measure_rounds(watches: Sequence[Watch], rounds: int) -> Iterator[Array]:
    """Yield the nanoseconds per call of each function, in the order given, for each round."""
    rng = np.random.default_rng(0)
    with _one_core():
        for _ in range(rounds):
            times = np.zeros(len(watches))
            for i in rng.permutation(len(watches)):
                times[i] = watches[i].measure(watches[i].passes)
            yield times


def measure_costs(watches: Sequence[Watch], rounds: int) -> list[Cost]:
    """Return the nanoseconds per call of each function, summed up over the rounds."""
    return [sum_up(row) for row in np.array(list(measure_rounds(watches, rounds))).T]


def sum_up(rounds: Array) -> Cost:
    """Sum up the times of several rounds."""
    first, median, third = (float(x) for x in np.quantile(rounds, (0.25, 0.5, 0.75)))
    return Cost(float(rounds.min()), median, (third - first) / median, len(rounds))


def load_timing(precision: Precision = "float64") -> Any:
    """Return the timing loop: of the address of a pool and the number of passes, nanoseconds of a call."""
    time = ctypes.CDLL(str(_compile_timing(precision))).mbs_time_kernel
    time.restype, time.argtypes = ctypes.c_double, (ctypes.c_void_p, ctypes.c_longlong)
    return time


def _compile_timing(precision: Precision) -> Path:
    with tempfile.TemporaryDirectory() as place:
        for name in _TIMING:  # the compiled files lie in one folder
            shutil.copy(resources.folder("csrc") / name, place)
        compiler = Variant(precision).compiler("-D_POSIX_C_SOURCE=199309L")
        return compile_library(Path(place), "mbs_timing", ["mbs_timing.c"], compiler)


@contextmanager
def _one_core() -> Iterator[None]:
    """Keep this process on one of its cores, where the system can; afterwards it may use all of them again."""
    if sys.platform != "linux":
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
