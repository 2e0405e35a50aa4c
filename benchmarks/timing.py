"""Times candidates in turn, many rounds of all of them, on one core: what the machine does meanwhile hits all alike."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.candidates import Array, Call, pointers

SAMPLE_NS = 300_000.0  # what a round gives one candidate


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


@dataclass(frozen=True)
class Sizes:
    """Dimensions of a mechanism's arguments."""

    joints: int
    driven: int


def draw_states(sizes: Sizes, states: int, seed: int = 1) -> dict[str, Array]:
    """Draw states: an array (states, size) for each input by name."""
    rng = np.random.default_rng(seed)
    n, m = sizes.joints, sizes.driven
    return {
        "q": rng.uniform(-np.pi, np.pi, (states, n)),
        "qd": rng.uniform(-3, 3, (states, n)),
        "qdd": rng.uniform(-10, 10, (states, n)),
        "u": rng.uniform(-20, 20, (states, m)),
        "adj_Phi": rng.uniform(-1, 1, (states, n)),
        "adj_qdd": rng.uniform(-1, 1, (states, n)),
    }


class Stopwatch:
    """The timing loop, bound to calls."""

    def __init__(self, library: Path) -> None:
        self._time = ctypes.CDLL(str(library)).mbs_time_kernel
        self._time.restype = ctypes.c_double
        self._time.argtypes = (ctypes.c_void_p, ctypes.c_longlong)

    def measure(self, call: Call, passes: int) -> float:
        """Go through the call's states `passes` times; give nanoseconds per call. Raises ArithmeticError."""
        steps = np.array([x.shape[1] for x in call.inputs], dtype=np.int64)
        inputs, results = pointers(call.inputs), pointers(call.results)
        pool = _Pool(
            len(call.inputs[0]),
            len(call.inputs),
            ctypes.addressof(inputs),
            steps.ctypes.data,
            ctypes.addressof(results),
            call.iw.ctypes.data,
            call.w.ctypes.data,
            call.address.value,
        )
        time = float(self._time(ctypes.addressof(pool), passes))
        if time < 0:
            raise ArithmeticError(f"{call.candidate.author}, {call.candidate.way}: failed in one of the states")
        return time


def measure_rounds(stopwatch: Stopwatch, calls: Sequence[Call], rounds: int) -> Iterator[NDArray[np.float64]]:
    """Time all calls once per round, in an order that changes: yields the nanoseconds of each, in the order given."""
    passes = [max(1, round(SAMPLE_NS / (stopwatch.measure(c, 1) * len(c.inputs[0])))) for c in calls]
    rng = np.random.default_rng(0)
    for _ in range(rounds):
        times = np.zeros(len(calls))
        for i in rng.permutation(len(calls)):
            times[i] = stopwatch.measure(calls[i], passes[i])
        yield times


def find_disagreements(calls: Mapping[str, Sequence[Call]], state: int, tolerance: float = 1e-9) -> list[str]:
    """Compare the results of each function with those of its first call; relative to the largest entry of a result."""
    faults = []
    for function, (first, *others) in calls.items():
        reference = first.evaluate(state)
        for other in others:
            for name, value in other.evaluate(state).items():
                expected = reference.get(name)
                if expected is None or not value.size:
                    continue
                error = float(np.abs(value - expected).max() / max(1.0, float(np.abs(expected).max())))
                if not error <= tolerance:
                    whose = f"{other.candidate.author}, {other.candidate.way}"
                    faults.append(f"{function}: {name} of {whose}: off by {error:.1e}")
    return faults


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on one of the cores that it may use; all of them again afterwards."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
