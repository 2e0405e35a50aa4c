"""Motions of many states at once: starts, inputs and parameters in arrays -> fixed steps in C, in lanes and threads.

For sampling, learning, identification: thousands of short motions of one tree. A single motion with outputs, tolerances
or closed loops is a simulation.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mbsgen import resources
from mbsgen.manifest import Argument, Kernel
from mbsgen.roles import QUICKEST, Role
from mbsrun import many
from mbsrun.binding import ArgumentError, Array, Entry, Status, check_numbers, declare, open_library
from mbsrun.external import Mechanism
from mbsrun.kernel import Kernels, is_count
from mbsrun.library import compile_library, find_compiler, once_per_compiler
from mbsrun.simulation.integration.tableaus import FIXED, Tableau

if TYPE_CHECKING:
    import cffi

_DECLARED = """
typedef struct {{ const double *first; long long step, pace, stage_pace, numbers, place, rates_place; }} mbs_course;
typedef struct {{ void *f; long long n_in, n_out, q, qd; }} mbs_function;
typedef struct {{
    mbs_function accelerations, rates;
    long long nq, n, quaternions;
    const long long *quaternion;
    long long courses;
    const mbs_course *course;
    long long stages;
    const double *A, *b;
    double h;
    long long steps, every;
}} mbs_motion;
size_t mbs_room_of_rollout{0}(const mbs_motion *motion);
void mbs_rollout{0}(const mbs_motion *motion, long long begin, long long end, double *kept, void *room, int *status);
"""


@dataclass(frozen=True)
class Rollouts:
    """Motions side by side; where a status is not 0, from some time on a motion is not a number."""

    t: Array  # (samples,), s
    q: Array  # (states, samples, nq)
    qd: Array  # (states, samples, n)
    status: Status  # (states,), as of kernels: 0, or the joint at which the motion's kernel fails

    def __repr__(self) -> str:
        """Return how many motions there are, and how many end early."""
        failed = np.count_nonzero(self.status)
        return f"Rollouts({self.q.shape[0]} motions of {self.t[-1]:g} s, {self.t.size} samples, {failed} end early)"


@dataclass(frozen=True)
class Course:
    """Numbers of one argument: (states or 1, steps or 1, stages or 1, numbers)."""

    argument: Argument
    values: Array


def rollout(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    *,
    step: float,
    steps: int,
    inputs: Mapping[str, ArrayLike] | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    every: int = 1,
    method: str = "rk4",
    threads: int = 1,
) -> Rollouts:
    """Move many states of a tree by fixed steps; keep each `every`th state, from the start on.

    q, qd: starts, shapes (states, nq) and (states, n), or one for all. inputs: arguments of the accelerations, as `u`:
    (m,) for all, (states, m) for each, or (states or 1, steps, m) for each step, in which they are constant.
    parameters: run-time and differentiated ones by name, a number for all or an array (states,). step in s. Raises
    ArgumentError.
    """
    function = _choose_function(mechanism)
    kernel = mechanism.describe(function)
    _check(mechanism, kernel, step, steps, every, method, threads)
    check_numbers(q=q, qd=qd)
    starts = [np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, qd)]
    for title, named in (("inputs", inputs), ("parameters", parameters)):
        if not (named is None or isinstance(named, Mapping)):
            raise ArgumentError(f"{title}: a value of type {type(named).__name__}; give arrays by name")
        check_numbers(**(named or {}))
    given = [_read_course(kernel, name, array, steps) for name, array in (inputs or {}).items()]
    given += read_parameters(mechanism, kernel, parameters or {})
    sizes = (len(mechanism.manifest.positions), len(mechanism.manifest.coordinates))
    states = _count_states([*(x.shape[0] for x in starts), *(course.values.shape[0] for course in given)])
    for name, start, size in zip(("q", "qd"), starts, sizes, strict=True):
        if start.shape[1:] != (size,) or start.ndim > 2:
            raise ArgumentError(f"{name}: shape {start.shape} given, ({size},) or (states, {size}) expected")
    kept = np.full((states, 1 + steps // every, sum(sizes)), np.nan)
    kept[:, 0] = np.hstack([np.broadcast_to(start, (states, start.shape[1])) for start in starts])
    motion = March(mechanism, function, given, FIXED[method], (step, steps, every), mechanism.manifest.quaternions)
    status = motion.move(kept, threads)
    t = np.asarray(step * every * np.arange(kept.shape[1]), dtype=np.float64)
    return Rollouts(t, kept[..., : sizes[0]], kept[..., sizes[0] :], status)


def _choose_function(mechanism: Mechanism) -> str:
    kernel = mechanism.manifest.find(QUICKEST)
    if kernel is None:
        raise ArgumentError(f"{mechanism.manifest.model} has no accelerations; generate {QUICKEST}")
    return kernel.name


def _check(
    mechanism: Mechanism, kernel: Kernel, step: float, steps: int, every: int, method: str, threads: int
) -> None:
    """Raise ArgumentError with all faults of the settings."""
    manifest, faults = mechanism.manifest, []
    if manifest.loops or manifest.driven:
        faults.append("closed loops and driven joints move by `mbsrun simulate` alone")
    if not (np.isfinite(step) and step > 0):
        faults.append(f"step: {step} s; give a positive number")
    counts = {"steps": steps, "every": every, "threads": threads}
    faults += [f"{name}: {x}; give a whole number, 1 or more" for name, x in counts.items() if not is_count(x)]
    if method not in FIXED:
        faults.append(f"method: {method!r}; there are {', '.join(FIXED)}")
    if faults:
        raise ArgumentError("\n".join(f"rollout of {manifest.model} by {kernel.name}: {fault}" for fault in faults))


def _read_course(kernel: Kernel, name: str, array: ArrayLike, steps: int) -> Course:
    """Read an input: (numbers,), (states, numbers), or (states or 1, steps, numbers)."""
    taken = {
        a.name: a for a in kernel.inputs if a.role not in (Role.COORDINATE, Role.VELOCITY, Role.SETUP, Role.DESIGN)
    }
    if name not in taken:
        raise ArgumentError(f"{kernel.name} has no input {name!r}; there are {', '.join(taken) or 'none'}")
    values, size = np.asarray(array, dtype=float), taken[name].nnz
    laid = values if values.ndim == 3 else np.atleast_2d(values)[:, None, :]
    if values.ndim > 3 or laid.shape[2] != size or (values.ndim == 3 and laid.shape[1] != steps):
        shapes = f"({size},), (states, {size}) or (states, {steps}, {size})"
        raise ArgumentError(f"{name}: shape {values.shape} given, {shapes} expected")
    return Course(taken[name], np.ascontiguousarray(laid[:, :, None]))


def read_parameters(mechanism: Kernels, kernel: Kernel, changes: Mapping[str, ArrayLike]) -> list[Course]:
    """Compute the inputs that come from parameters, for each state where one differs."""
    known = dict(mechanism.parameters)
    unknown = [name for name in changes if name not in known]
    if unknown:
        raise ArgumentError(f"no parameter {', '.join(unknown)}; there are {', '.join(known) or 'none'}")
    columns = {name: np.atleast_1d(np.asarray(changes.get(name, value), dtype=float)) for name, value in known.items()}
    wrong = [name for name, column in columns.items() if column.ndim > 1 or not np.isfinite(column).all()]
    if wrong:
        raise ArgumentError(f"{', '.join(wrong)}: give a finite number, or one for each state")
    manifest, found = mechanism.manifest, []
    for argument in kernel.inputs:
        if argument.role is Role.DESIGN:
            found.append(Course(argument, _stack([columns[p.name] for p in manifest.design])[:, None, None]))
        if argument.role is Role.SETUP and manifest.setup is not None:
            rows = _stack([columns[p.name] for p in manifest.parameters])
            given: dict[str, Any] = {manifest.setup.inputs[0].name: rows}
            results, _ = mechanism.attempt(manifest.setup.name, **given)
            found.append(Course(argument, np.ascontiguousarray(results[argument.name][:, None, None])))
    return found


def _stack(columns: Sequence[Array]) -> Array:
    states = _count_states([column.size for column in columns])
    return np.stack([np.broadcast_to(column, (states,)) for column in columns], axis=1)


def _count_states(sizes: Sequence[int]) -> int:
    """Return the number of states; arrays with one state serve all."""
    different = {size for size in sizes if size != 1}
    if len(different) > 1:
        raise ArgumentError(f"arrays are of {sorted(different)} states; give all the same number, or one for all")
    return different.pop() if different else 1


class March:
    """Steps of many states, laid out for C: times[1] steps of length times[0] [s], of which each times[2]-th is kept.

    `unit` are the quaternions that are scaled to length 1 after each step, by their first coordinates.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        function: str,
        courses: Sequence[Course],
        tableau: Tableau,
        times: tuple[float, int, int],
        unit: Sequence[int],
    ) -> None:
        self.mechanism, self.function = mechanism.find_holder(function), function
        self.has_rates = bool(mechanism.manifest.configuration)
        self.courses, self.tableau, self.times, self.unit = courses, tableau, times, unit

    def move(self, kept: Array, threads: int) -> Status:
        """Fill in the motions (states, 1 + samples, nq + n) after the first; return statuses as of kernels.

        Beside one that fails, each is moved once more, alone.
        """
        status = np.zeros(kept.shape[0], dtype=np.int32)
        work = kept.shape[0] * self.times[1]
        names = (self.function, *(("rates",) if self.has_rates else ()))
        loops = [self.mechanism.choose_loop(name, work) for name in names]
        one, several = [self.mechanism.bind(name).function for name in names], [found for _, found in loops]
        width = loops[0][0].width
        if all(several) and kept.shape[0] >= width:
            self._run(
                [found.function for found in several if found], width, kept, status, range(kept.shape[0]), threads
            )
        else:
            self._run(one, 1, kept, status, range(kept.shape[0]), threads)
            return status
        for state in np.flatnonzero(status):
            kept[state, 1:] = np.nan
            self._run(one, 1, kept, status, range(state, state + 1), 1)
        return status

    def _run(
        self, functions: Sequence[Any], width: int, kept: Array, status: Status, states: range, threads: int
    ) -> None:
        ffi, library = _load(width)
        motion, alive = self._describe(ffi, functions)
        end = many.end_name(width)
        size = getattr(library, f"mbs_room_of_rollout{end}")(motion)
        numbers, told = ffi.cast("double *", kept.ctypes.data), ffi.cast("int *", status.ctypes.data)

        def work(part: range) -> None:
            room = ffi.new("char[]", size)
            getattr(library, f"mbs_rollout{end}")(motion, part.start, part.stop, numbers, room, told)

        many.share(work, states, width, threads)
        del alive

    def _describe(self, ffi: cffi.FFI, functions: Sequence[Any]) -> tuple[Any, list[Any]]:
        """Describe the motion, and return what must outlive the calls."""
        manifest = self.mechanism.manifest
        laid: Any = ffi.new("mbs_motion *")
        places = [_lay_function(ffi, laid.accelerations, self.mechanism.bind(self.function), functions[0])]
        if self.has_rates:
            places.append(_lay_function(ffi, laid.rates, self.mechanism.bind("rates"), functions[1]))
        courses: Any = ffi.new("mbs_course[]", max(1, len(self.courses)))
        for item, course in zip(courses, self.courses, strict=False):
            states, steps, stages, size = course.values.shape
            item.first, item.numbers = ffi.cast("double *", course.values.ctypes.data), size
            item.step, item.pace = (size * stages * steps if states > 1 else 0), (size * stages if steps > 1 else 0)
            item.stage_pace = size if stages > 1 else 0
            item.place, item.rates_place = (*(place.get(course.argument.name, -1) for place in places), -1)[:2]
        A, b = (np.array(x, dtype=float) for x in (self.tableau.A, self.tableau.b))
        quaternions = np.array(self.unit, dtype=np.int64)
        laid.nq, laid.n = len(manifest.positions), len(manifest.coordinates)
        laid.quaternions, laid.quaternion = quaternions.size, ffi.cast("long long *", quaternions.ctypes.data)
        laid.courses, laid.course, laid.stages = len(self.courses), courses, b.size
        laid.A, laid.b = (ffi.cast("double *", x.ctypes.data) for x in (A, b))
        laid.h, laid.steps, laid.every = self.times
        return laid, [courses, A, b, quaternions]


def _lay_function(ffi: cffi.FFI, laid: Any, entry: Entry, function: Any) -> dict[str, int]:
    """Describe a kernel; return which arguments its inputs are, by name."""
    roles = {port.argument.role: port.position for port in entry.inputs}
    laid.f, laid.n_in, laid.n_out = ffi.cast("void *", function), entry.n_in, entry.n_out
    laid.q, laid.qd = roles[Role.COORDINATE], roles[Role.VELOCITY]
    return {port.argument.name: port.position for port in entry.inputs}


@once_per_compiler
def _load(width: int) -> tuple[cffi.FFI, Any]:
    """Compile and load mbs_rollout.c for `width` states at once."""
    compiler = many.for_states(find_compiler(os.environ), width)
    library = compile_library(resources.folder("csrc"), "mbs_rollout", ["mbs_rollout.c"], compiler)
    ffi = declare(_DECLARED.format(many.end_name(width)))
    return ffi, open_library(ffi, library)
