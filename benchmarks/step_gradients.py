"""Steps of many states in lanes, with their gradients, from C: which learning and optimal control require.

A step is one of semi-implicit Euler's method or of the classical Runge-Kutta method. Its gradient is the product of a
row of weights with the step's derivatives by q, qd and u: kernels compute accelerations and their adjoint in lanes
(`cpp/steps.c`). Values are compared with `mbsrun.rollout`, gradients with differences.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mbsrun
from mbsgen import resources
from mbsgen.pipeline import Options, generate
from mbsgen.roles import Order, name_kernel
from mbsrun import Mechanism, many
from mbsrun.binding import Entry
from mbsrun.library import compile_library, find_compiler

Numbers = NDArray[np.float64]
STATES, H = 2048, 1e-3
METHODS = ("semi-implicit Euler", "RK4")
FUNCTION = "exp2"
STATE = ("q", "qd", "u")
SHIFT = 1e-6  # of differences


class _Kernel(ctypes.Structure):
    _fields_ = (
        ("f", ctypes.c_void_p),
        ("n_in", ctypes.c_longlong),
        ("n_out", ctypes.c_longlong),
        ("given", ctypes.c_longlong * 4),
        ("found", ctypes.c_longlong * 3),
    )


class _Plan(ctypes.Structure):
    _fields_ = (
        ("accelerate", _Kernel),
        ("adjoint", _Kernel),
        ("n", ctypes.c_longlong),
        ("m", ctypes.c_longlong),
        ("h", ctypes.c_double),
    )


@dataclass(frozen=True)
class Steps:
    """Millions of steps a second of one core, with lanes of a width."""

    method: str
    width: int
    alone: float
    with_gradient: float


class Stepper:
    """Steps of a tree in lanes."""

    def __init__(self, mechanism: Mechanism, width: int) -> None:
        """Compile for `width` states at once."""
        adjoint = name_kernel(FUNCTION, Order.ADJOINT)
        several = [mechanism.load_several(name, width) for name in (FUNCTION, adjoint)]
        compiler = many.for_states(find_compiler(os.environ), width)
        self._kept = several
        folder = Path(__file__).parent / "cpp"
        library = compile_library(folder, "steps", ["steps.c"], compiler, resources.folder("csrc"))
        self._take: Any = ctypes.CDLL(str(library)).take_steps
        self.n = len(mechanism.manifest.coordinates)
        first, second = (
            _describe(mechanism.bind(name), found.function)
            for name, found in zip((FUNCTION, adjoint), several, strict=True)
            if found is not None
        )
        self.m = len(mechanism.manifest.inputs)
        self._plan = _Plan(first, second, self.n, self.m, H)

    def take(self, method: str, given: Sequence[Numbers], after: Numbers, slopes: Numbers | None) -> None:
        """Take a step in each state: rows of q and qd, of u, and of weights of q and qd after it.

        Writes q and qd after it, and the gradient by q, qd and u, if asked. Raises ArithmeticError where it fails.
        """
        x = given[0]
        places = [ctypes.c_void_p(a.ctypes.data) for a in (*given, after)]
        last = None if slopes is None else ctypes.c_void_p(slopes.ctypes.data)
        is_rk4 = int(method == "RK4")
        if self._take(ctypes.byref(self._plan), is_rk4, ctypes.c_longlong(len(x)), *places, last):
            raise ArithmeticError("a kernel fails in one of the states")


def _describe(entry: Entry, function: int) -> _Kernel:
    given = {port.argument.name: port.position for port in entry.inputs}
    found = {port.argument.by or "": port.position for port in entry.outputs}
    places = [*(given[name] for name in STATE), given.get("adj_qdd", 0)]
    ends = [found.get(name, next(iter(found.values()))) for name in STATE]
    return _Kernel(function, entry.n_in, entry.n_out, (ctypes.c_longlong * 4)(*places), (ctypes.c_longlong * 3)(*ends))


def measure_steps(model: Path, repeats: int) -> Iterator[Steps]:
    """Measure each method with all widths of lanes from 4 on that this processor has."""
    with TemporaryDirectory() as folder:
        generate(model, Path(folder) / "model", Options(functions=(FUNCTION,), derivatives=2))
        mechanism = mbsrun.load(Path(folder) / "model")
        widest = many.find_width(find_compiler(os.environ))
        for width in (width for width in (8, 4) if width <= widest):
            stepper = Stepper(mechanism, width)
            for method in METHODS:
                check(mechanism, stepper, method)
                yield Steps(method, width, *measure(stepper, method, repeats))


def draw(stepper: Stepper, states: int) -> tuple[Numbers, Numbers, Numbers]:
    """Draw states, inputs and weights."""
    rng = np.random.default_rng(0)
    x, weights = rng.uniform(0.1, 0.6, (2, states, 2 * stepper.n))
    return x, rng.uniform(0.1, 0.6, (states, stepper.m)), weights


def measure(stepper: Stepper, method: str, repeats: int) -> tuple[float, float]:
    """Return millions of steps a second of processor time, without and with the gradient."""
    given = draw(stepper, STATES)
    after, slopes = np.zeros_like(given[0]), np.zeros((STATES, 2 * stepper.n + stepper.m))
    rates = []
    for found in (None, slopes):
        least = float("inf")
        for _ in range(repeats):
            begin = time.process_time_ns()
            stepper.take(method, given, after, found)
            least = min(least, time.process_time_ns() - begin)
        rates.append(1e3 * STATES / least)
    return rates[0], rates[1]


def check(mechanism: Mechanism, stepper: Stepper, method: str) -> None:
    """Raise AssertionError for steps that differ from `mbsrun.rollout`, and gradients that differ from differences."""
    x, u, weights = draw(stepper, 16)
    after, slopes = np.zeros_like(x), np.zeros((16, 2 * stepper.n + stepper.m))
    stepper.take(method, (x, u, weights), after, slopes)
    if method == "RK4":
        q, qd = np.hsplit(x, 2)
        found = mbsrun.rollout(mechanism, q, qd, step=H, steps=1, inputs={"u": u})
        np.testing.assert_allclose(after, np.hstack([found.q[:, -1], found.qd[:, -1]]), rtol=1e-12, atol=1e-13)
    whole = np.hstack([x, u])
    for k in range(whole.shape[1]):
        ends = []
        for sign in (1, -1):
            moved = whole.copy()
            moved[:, k] += sign * SHIFT
            parts = [np.ascontiguousarray(a) for a in np.split(moved, [2 * stepper.n], axis=1)]
            stepper.take(method, (*parts, weights), after, None)
            ends.append((weights * after).sum(1))
        np.testing.assert_allclose(slopes[:, k], (ends[0] - ends[1]) / (2 * SHIFT), rtol=1e-6, atol=1e-7)
