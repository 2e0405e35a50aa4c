"""Explicit Runge-Kutta methods with steps of a fixed length h, for y = (q, qd) and y' = f(t, y):

    k_i = f(t + c_i h, y + h sum_j A_ij k_j),    y(t + h) = y + h sum_i b_i k_i

Hairer, Norsett, Wanner, "Solving ordinary differential equations I", chapter II. The steps are taken in C, see
csrc/mbs_simulate.h; under inputs that follow the state, in Python.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

from mbsgen import resources
from mbsrun.binding import Entry, bind
from mbsrun.kernel import KernelError, Kernels
from mbsrun.library import compile_library, find_compiler
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics, SingularError, find_mass_matrix
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings

Array = NDArray[np.float64]

STEPS = 4096  # taken in C at a time
PYTHON_STEPS = 256  # and in Python
RUNAWAY = -1  # the C functions' status of a state that is not finite

_CDEF = """
typedef int (*mbs_kernel)(const double **arg, double **res, long long *iw, double *w, int mem);
typedef struct {
    long long n, nq, m;
    double *q, *qd, *v, *qdd;
    mbs_kernel rate; const double **rate_arg; double **rate_res;
    mbs_kernel mass; const double **mass_arg; double **mass_res;
    const double *M; long long entries; const long long *place; double *matrix;
    mbs_kernel change; const double **change_arg; double **change_res; const double *qt;
} mbs_plant;
long long mbs_simulate_rk(const mbs_plant *plant, long long stages, const double *A, const double *b, double h,
                          long long steps, const double *v, long long v_step, double *states, double *work,
                          int *status);
"""


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method."""

    A: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]

    @property
    def c(self) -> Array:
        """Return the times of the stages within a step."""
        return np.asarray(np.array(self.A).sum(axis=1))


EULER = Tableau(((0.0,),), (1.0,))
RK4 = Tableau(
    ((0.0, 0.0, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0), (0.0, 0.5, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
)


def integrate(
    tableau: Tableau,
    dynamics: Dynamics,
    piece: Piece,
    q: Array,
    qd: Array,
    settings: Settings,
    allowance: Allowance,
) -> Iterator[Chunk]:
    """Go through a piece by steps of equal length, at most `settings.step`; yield the steps.

    Raises HaltError where a kernel fails, a state is not finite, or the allowance is used up.
    """
    if piece.law is not None:
        yield from _integrate_in_python(dynamics, piece, np.concatenate((q, qd)), tableau, settings.step, allowance)
        return
    if "plant" not in dynamics.kept:
        dynamics.kept["plant"] = _Plant(dynamics)
    plant = dynamics.kept["plant"]
    count = count_steps(piece, settings.step)
    h, c = (piece.end - piece.start) / count, tableau.c
    states = np.concatenate((q, qd))[None]
    first = 0
    while first < count:
        steps = min(STEPS, count - first, max(1, allowance.steps))
        _spend(allowance, steps, place_steps(piece, np.array([first]), count)[0])
        times = place_steps(piece, first + np.arange(steps + 1), count)
        inputs = sample(piece, (times[:-1, None] + h * c).ravel())
        done, status, states = plant.run(states[-1], tableau, h, steps, inputs)
        dynamics.effort.steps += done
        dynamics.effort.evaluations += (done + bool(status)) * len(c)
        if done:
            q, qd = np.split(states[: done + 1], [dynamics.places], axis=1)
            yield Chunk(times[: done + 1], q, qd)
        if status:
            raise HaltError(describe_status(dynamics.kernels, status, times[done], states[done]))
        first += steps


def _integrate_in_python(
    dynamics: Dynamics, piece: Piece, state: Array, tableau: Tableau, step: float, allowance: Allowance
) -> Iterator[Chunk]:
    """Take the steps where inputs follow the state."""
    count, n = count_steps(piece, step), dynamics.places
    h, states, halt = (piece.end - piece.start) / count, [state], None
    times = place_steps(piece, np.arange(count + 1), count)
    for k in range(count):
        try:
            allowance.spend()
            with np.errstate(all="ignore"):
                states.append(_step(dynamics, piece, states[-1], tableau, times[k], h))
        except (LimitError, DriveError) as error:
            halt = Halt(times[k], None, error.finding, error.remedy)
        except (KernelError, SingularError) as error:
            halt = Halt(times[k], error.joint, SINGULAR, "start elsewhere, or keep away from this configuration")
        if not np.isfinite(states[-1]).all():
            states.pop()
            halt = describe_status(dynamics.kernels, RUNAWAY, times[k], states[-1])
        if len(states) > 1 and (halt or k + 1 == count or len(states) > PYTHON_STEPS):
            done = np.array(states)
            dynamics.effort.steps += len(done) - 1
            last = k if halt else k + 1
            yield Chunk(times[last + 1 - len(done) : last + 1], done[:, :n], done[:, n:])
            states = states[-1:]
        if halt:
            raise HaltError(halt)


def _step(dynamics: Dynamics, piece: Piece, state: Array, tableau: Tableau, time: float, h: float) -> Array:
    """Take one step; every stage evaluates the inputs. Raises KernelError and SingularError."""
    rates = np.zeros((len(tableau.b), len(state)))
    for i, (row, c) in enumerate(zip(tableau.A, tableau.c, strict=True)):
        q, qd = np.split(state + h * np.array(row) @ rates, [dynamics.places])
        qdd = dynamics.accelerations(q, qd, piece.at(time + c * h, q, qd))
        rates[i] = np.concatenate((dynamics.rates(q, qd), qdd))
    return np.asarray(state + h * np.array(tableau.b) @ rates)


def _spend(allowance: Allowance, steps: int, time: float) -> None:
    try:
        allowance.spend(steps)
    except LimitError as error:
        raise HaltError(Halt(float(time), None, error.finding, error.remedy)) from None


def count_steps(piece: Piece, step: float) -> int:
    """Count the equal steps of a piece; none is longer than requested, except by rounding."""
    return max(1, int(np.ceil((piece.end - piece.start) / step * (1 - 1e-12))))


def place_steps(piece: Piece, numbers: NDArray[np.intp], count: int) -> Array:
    """Return the times after `numbers` of `count` steps; the last is exactly the piece's end."""
    times = piece.start + (piece.end - piece.start) / count * numbers
    return np.where(numbers == count, piece.end, times)


def sample(piece: Piece, times: Array) -> Array:
    """Return the inputs at times of a piece, (K, m); one row where they are constant."""
    return np.ascontiguousarray(piece.values(times[:1] if piece.is_constant else times))


def describe_status(kernels: Kernels, status: int, time: float, state: Array) -> Halt:
    """Describe a status of the C functions, returned in the step after `time`."""
    names = [c.name for c in kernels.manifest.coordinates]
    if status == RUNAWAY:
        fastest = names[int(np.abs(state[-len(names) :]).argmax())]
        return Halt(
            float(time),
            fastest,
            "the motion diverges: its numbers overflow",
            "take a smaller step or an implicit method",
        )
    joint = names[status - 1] if status <= len(names) else None
    return Halt(float(time), joint, SINGULAR, "start elsewhere, or keep away from this configuration")


SINGULAR = "the accelerations cannot be computed here: the mass matrix is singular, or has lost its digits"


class _Plant:
    """A formulation as the C functions take it, with the memory that they use."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.ffi, self.lib = _load()
        ffi, n = self.ffi, dynamics.size
        kernels, forces = dynamics.kernels, dynamics.forces_count
        evaluated = dynamics.formulation.evaluated
        rate, mass = evaluated.function, evaluated.mass
        rate_entry, mass_entry = _bind(kernels, rate), _bind(kernels, mass) if mass else None
        self.memory: dict[str, Array] = {
            "q": np.zeros(dynamics.places),
            "qd": np.zeros(n),
            "qdd": np.zeros(n),
            "rest": np.zeros(n),
            "v": np.zeros(forces + count_wrench_entries(kernels) + 1),
            "matrix": np.zeros(n * n),
        }
        filled = kernels.filled
        self.memory |= filled
        inputs = {name: self._pointer(name) for name in ("q", "qd", "v", "matrix")}
        inputs |= {"u": inputs["v"], "w": inputs["v"] + forces, "qdd": self._pointer("rest")}
        inputs |= {name: self._pointer(name) for name in filled}
        self.kept: list[Any] = [rate_entry, mass_entry]  # objects that C has pointers to
        p: Any = ffi.new("mbs_plant *")
        self.plant = p
        p.n, p.nq, p.m = n, dynamics.places, len(self.memory["v"]) - 1
        p.q, p.qd, p.v, p.qdd, p.matrix = inputs["q"], inputs["qd"], inputs["v"], self._pointer("qdd"), inputs["matrix"]
        p.rate, p.rate_arg, p.rate_res = self._lay(rate_entry, inputs, rate_entry.outputs[0].argument.name, p.qdd)
        if kernels.manifest.configuration:
            change = _bind(kernels, "rates")
            self.kept.append(change)
            self.memory["qt"] = np.zeros(dynamics.places)
            p.qt = self._pointer("qt")
            p.change, p.change_arg, p.change_res = self._lay(change, inputs, "rate", p.qt)
        if mass_entry is not None:
            M = find_mass_matrix(mass_entry.kernel)
            port = next(x for x in mass_entry.outputs if x.argument == M)
            self.memory["M"] = np.zeros(port.argument.nnz)
            numbers = port.spread()
            place = self.places = np.flatnonzero(numbers >= 0)[np.argsort(numbers[numbers >= 0])].astype(np.int64)
            p.M, p.entries = self._pointer("M"), port.argument.nnz
            p.place = ffi.from_buffer("long long[]", place.data)
            p.mass, p.mass_arg, p.mass_res = self._lay(mass_entry, inputs, port.argument.name, self._pointer("M"))

    def run(self, state: Array, tableau: Tableau, h: float, steps: int, inputs: Array) -> tuple[int, int, Array]:
        """Take steps; inputs (steps * stages, m), or one row for all. Return how many, status, and states by rows."""
        ffi = self.ffi
        states = np.empty((steps + 1, len(state)))
        states[0] = state
        status = ffi.new("int *")
        v, path = ffi.from_buffer("double[]", inputs.data), ffi.from_buffer("double[]", states.data)
        v_step = inputs.shape[1] if len(inputs) > 1 else 0
        A, b = (ffi.new("double[]", list(np.ravel(x))) for x in (tableau.A, tableau.b))
        work = ffi.new("double[]", len(state) * len(tableau.b))
        done = self.lib.mbs_simulate_rk(self.plant, len(tableau.b), A, b, h, steps, v, v_step, path, work, status)
        return done, status[0], states

    def _pointer(self, name: str) -> Any:
        return self.ffi.cast("double *", self.memory[name].ctypes.data)

    def _lay(self, entry: Entry, inputs: Mapping[str, Any], wanted: str, place: Any) -> tuple[Any, Any, Any]:
        """Make the argument lists of a kernel for one of its results."""
        arg, res = self.ffi.new("const double *[]", entry.n_in), self.ffi.new("double *[]", entry.n_out)
        for port in entry.inputs:
            arg[port.position] = inputs[port.argument.name]
        for port in entry.outputs:
            if port.argument.name == wanted:
                res[port.position] = place
        self.kept += [arg, res]
        function = self.ffi.cast("mbs_kernel", int(entry.ffi.cast("intptr_t", entry.function)))
        return function, arg, res


def count_wrench_entries(kernels: Kernels) -> int:
    """Count the entries of w."""
    return sum(3 * wrench.force + 3 * wrench.moment for wrench in kernels.manifest.wrenches)


def _bind(kernels: Kernels, name: str) -> Entry:
    return bind(kernels.compile(name), kernels.manifest.kernel(name))


@cache
def _load() -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    ffi.cdef(_CDEF)
    library: Path = compile_library(
        resources.folder("csrc"), "mbs_simulate", ["mbs_simulate.c"], find_compiler(os.environ)
    )
    return ffi, ffi.dlopen(str(library))
