"""Explicit Runge-Kutta methods with steps of a fixed length h, for y = (q, qd) and y' = f(t, y):

    k_i = f(t + c_i h, y + h sum_j A_ij k_j),    y(t + h) = y + h sum_i b_i k_i

Hairer, Norsett, Wanner, "Solving ordinary differential equations I", chapter II. The steps are taken in C, see
csrc/mbs_simulate.h; under inputs that follow the state, in Python.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError, Kernels, Place, find_place
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics, SingularError, find_mass_matrix
from mbsrun.simulation.memory import Memory, load_functions
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
            halt = describe_singularity(error, times[k])
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
    return describe_singularity(find_place(kernels.manifest, status), float(time))


def describe_singularity(place: Place | KernelError | SingularError, time: float) -> Halt:
    """Describe accelerations that cannot be computed."""
    remedy = "start elsewhere, or keep away from this configuration"
    if isinstance(place, SingularError) or place.loop is None:
        return Halt(time, place.joint, SINGULAR, remedy)
    return Halt(time, None, DEPENDENT, remedy, loop=place.loop)


DEPENDENT = "the accelerations cannot be computed here: its equations depend on others, at a singular pose"
SINGULAR = "the accelerations cannot be computed here: the mass matrix is singular, or has lost its digits"


class _Plant:
    """A formulation as the C functions take it, with the memory that they use."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.ffi, self.lib = load_functions(_CDEF, "mbs_simulate.c")
        n, kernels, forces = dynamics.size, dynamics.kernels, dynamics.forces_count
        evaluated = dynamics.formulation.evaluated
        arrays = {
            "q": np.zeros(dynamics.places),
            "qd": np.zeros(n),
            "qdd": np.zeros(n),  # the accelerations at which a residual is evaluated
            "v": np.zeros(forces + kernels.manifest.open_entries + 1),
        }
        memory = self.memory = Memory(self.ffi, kernels, arrays)
        p: Any = self.ffi.new("mbs_plant *")
        self.plant = p
        p.n, p.nq, p.m = n, dynamics.places, len(arrays["v"]) - 1
        p.q, p.qd, p.v = (memory.pointer(name) for name in ("q", "qd", "v"))
        p.qdd, p.matrix = memory.add("found", n), memory.add("matrix", n * n)
        rate = memory.bind(evaluated.function)
        p.rate, p.rate_arg, p.rate_res = memory.lay(rate, {rate.outputs[0].argument.name: "found"})
        if kernels.manifest.configuration:
            p.qt = memory.add("qt", dynamics.places)
            p.change, p.change_arg, p.change_res = memory.lay(memory.bind("rates"), {"rate": "qt"})
        if evaluated.mass is not None:
            mass = memory.bind(evaluated.mass)
            M = find_mass_matrix(mass.kernel)
            p.M, p.entries, p.place = memory.add("M", M.nnz), M.nnz, memory.place(mass, M)
            p.mass, p.mass_arg, p.mass_res = memory.lay(mass, {M.name: "M"})

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
