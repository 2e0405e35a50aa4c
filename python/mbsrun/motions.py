"""Simulations of many starts: arrays of states and parameters -> a motion for each, with a separate status.

Explicit steps of a fixed length of trees run in lanes, in threads. Adaptive explicit steps, of closed loops too, run in
one loop in C over the starts, in threads. All else runs start by start. Each motion is the one that `simulate` gives:
where lanes compute it, to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsrun.binding import ArgumentError, check_numbers
from mbsrun.closure import OpenError
from mbsrun.external import Mechanism
from mbsrun.kernel import KernelError, is_count
from mbsrun.limits import Allowance, Limits
from mbsrun.quaternions import measure_lengths
from mbsrun.rollouts import Course as Given
from mbsrun.rollouts import March, read_parameters
from mbsrun.simulation.closing import check_closed
from mbsrun.simulation.course import Course, check_course, is_constrained, place_driven, stand
from mbsrun.simulation.drive import Drive, DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.explicit import Plant
from mbsrun.simulation.integration.method import Family
from mbsrun.simulation.integration.methods import METHODS, complete_settings
from mbsrun.simulation.integration.steps import count_steps, place_steps
from mbsrun.simulation.integration.tableaus import FIXED
from mbsrun.simulation.motion import Halt, HaltError, Settings
from mbsrun.simulation.outputs import SAME, Outputs, find_stride, list_times
from mbsrun.simulation.simulate import check_inputs, check_settings, check_start

Array = NDArray[np.float64]
Show = Callable[[int], None]

STORED = 100  # states that are kept of each motion, about, unless another distance of outputs is asked for
GROUP = 1024  # starts whose motions are made in lanes together
MOST = 100_000  # steps of a motion in C alone; one that takes more is made again with its limit of seconds
BLOCK = 4096  # steps with inputs that vary which are made at once
_PLANT = "plant"  # what explicit methods keep from start to start


@dataclass(frozen=True, eq=False, repr=False)
class Motions:
    """N motions at common times; from the time on at which one ends early, its states are not a number."""

    settings: Settings
    t: Array  # (K,), s
    q: Array  # (N, K, nq)
    qd: Array  # (N, K, n)
    ends: tuple[Array, Array, Array]  # the last states: times (N,), q (N, nq), qd (N, n)
    halts: tuple[Halt | None, ...]  # why a motion ends early
    kernels: Mechanism = field(repr=False)
    parameters: Mapping[str, Array] = field(default_factory=dict)  # other values than the kernels', (N,) or (1,)

    @property
    def is_complete(self) -> NDArray[np.bool_]:
        """Return which motions reach the end, (N,)."""
        return np.array([halt is None for halt in self.halts], dtype=np.bool_)

    def measure_energy(self) -> Array:
        """Return kinetic plus potential energy [J] at the start and in the last state, (N, 2)."""
        states = ((self.q[:, 0], self.qd[:, 0]), self.ends[1:])
        given = read_parameters(self.kernels, self.kernels.describe("energy"), self.parameters)
        own: dict[str, Any] = {
            x.argument.name: np.broadcast_to(x.values[:, 0, 0], (len(self), x.values.shape[3])) for x in given
        }
        found = [self.kernels.attempt("energy", q=q, qd=qd, **own)[0] for q, qd in states]
        return np.stack([(x["kinetic"] + x["potential"])[:, 0] for x in found], axis=1)

    def __len__(self) -> int:
        return len(self.halts)

    def __repr__(self) -> str:
        """Return what was simulated, and how many motions end early."""
        early = len(self) - int(self.is_complete.sum())
        what = f"{self.kernels.manifest.model}, {len(self)} motions of {self.settings.duration:.6g} s"
        return f"Motions({what} by {self.settings.method}, {self.t.size} states each, {early} end early)"


def simulate_many(
    mechanism: Mechanism,
    drive: Drive,
    q: ArrayLike,
    qd: ArrayLike,
    settings: Settings,
    *,
    parameters: Mapping[str, ArrayLike] | None = None,
    threads: int = 1,
    show: Show = lambda _: None,
    course: Course | None = None,
) -> Motions:
    """Integrate a motion from each start under the inputs of `drive`; call `show` with the number of finished ones.

    q, qd: starts at time 0, (N, nq) and (N, n), or one for all. parameters: run-time and differentiated ones by name, a
    number for all or (N,). Driven joints move along `course`; without one they stand. No bit of a motion depends on the
    number of threads, and a feedback must not have a memory. A start with which no motion begins is a halt at time 0.
    Raises ValueError and ArgumentError for arguments that do not fit, DriveError for inputs without a value.
    """
    check_settings(mechanism, drive, settings)
    settings = complete_settings(settings, is_closed=is_constrained(mechanism.manifest))
    starts = _spread(mechanism, q, qd, parameters or {})
    if not is_count(threads):
        raise ArgumentError(f"threads: {threads}; give a whole number, 1 or more")
    if threads > 1 and METHODS[settings.method].stability is None:
        raise ArgumentError(f"threads: {settings.method} takes one")
    followed = _Following(mechanism, drive, settings, course, starts)
    if followed.fits_lanes:
        return followed.gather(followed.make_abreast(threads, show))
    if followed.fits_series:
        return followed.gather(followed.make_series(threads, show))
    return followed.gather(followed.make_singly(range(len(starts)), threads, show))


@dataclass(frozen=True, eq=False)
class _Starts:
    """N starts: states, and the parameters that differ from the mechanism's."""

    q: Array  # (N, nq)
    qd: Array  # (N, n)
    parameters: Mapping[str, Array]  # (N,), or (1,) for all

    def __len__(self) -> int:
        return len(self.q)

    def list_parameters(self, k: int) -> dict[str, float]:
        """Return the parameters of a start."""
        return {name: float(column[k if column.size > 1 else 0]) for name, column in self.parameters.items()}

    def choose(self, part: slice | list[int]) -> _Starts:
        """Return some of the starts."""
        some = {name: x[part] if x.size > 1 else x for name, x in self.parameters.items()}
        return _Starts(self.q[part], self.qd[part], some)


def _spread(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, parameters: Mapping[str, ArrayLike]) -> _Starts:
    """Bring starts and parameters to one number of states. Raises ArgumentError."""
    manifest = mechanism.manifest
    sizes = {"q": len(manifest.positions), "qd": len(manifest.coordinates)}
    check_numbers(q=q, qd=qd, **parameters)
    states = {"q": np.atleast_2d(np.asarray(q, dtype=float)), "qd": np.atleast_2d(np.asarray(qd, dtype=float))}
    for name, size in sizes.items():
        if states[name].shape[1:] != (size,):
            raise ArgumentError(f"{name}: shape {np.shape(q if name == 'q' else qd)} given, (states, {size}) expected")
    unknown = [name for name in parameters if name not in mechanism.parameters]
    if unknown:
        known = ", ".join(mechanism.parameters) or "none"
        raise ArgumentError(f"no run-time parameter {', '.join(unknown)}; there are {known}")
    columns = {name: np.atleast_1d(np.asarray(x, dtype=float)) for name, x in parameters.items()}
    wrong = [name for name, x in columns.items() if x.ndim > 1 or not np.isfinite(x).all()]
    if wrong:
        raise ArgumentError(f"{', '.join(wrong)}: give a finite number, or one for each start")
    counts = {len(x) for x in (*states.values(), *columns.values())} - {1}
    if len(counts) > 1:
        raise ArgumentError(f"arrays are of {sorted(counts)} starts; give all the same number, or one for all")
    count = counts.pop() if counts else 1
    if not count:
        raise ArgumentError("arrays are of no starts; give one start at least")
    found = {name: np.ascontiguousarray(np.broadcast_to(x, (count, x.shape[1]))) for name, x in states.items()}
    return _Starts(found["q"], found["qd"], columns)


@dataclass(frozen=True, eq=False)
class _Path:
    """One motion: the states that are kept, the last one with its time, and why it ends early."""

    t: Array  # (k,)
    states: Array  # (k, nq + n)
    time: float
    last: Array  # (nq + n,)
    halt: Halt | None


class _Following:
    """All motions of a call."""

    def __init__(
        self, mechanism: Mechanism, drive: Drive, settings: Settings, course: Course | None, starts: _Starts
    ) -> None:
        self.mechanism, self.drive, self.settings = mechanism, drive, settings
        self.course, self.starts = course, starts
        self.is_closed = is_constrained(mechanism.manifest)
        self.distance = settings.output_step or settings.duration / STORED

    @property
    def fits_lanes(self) -> bool:
        """Return whether steps have a fixed length and call kernels alone."""
        manifest, is_free = self.mechanism.manifest, self.drive.control is None
        is_tree = not (self.is_closed or manifest.switching)
        return is_tree and is_free and self.settings.method in FIXED and self.settings.formulation.evaluated.is_direct

    # --- start by start ---

    def make_singly(self, numbers: Sequence[int], threads: int, show: Show) -> Iterator[tuple[int, _Path]]:
        """Make motions one by one, in threads."""
        lots = [numbers[k::threads] for k in range(threads)]
        done = [0] * threads

        def work(k: int) -> list[tuple[int, _Path]]:
            kept: dict[str, object] = {}
            found = []
            for number in lots[k]:
                found.append((number, self.follow(number, kept)))
                done[k] += 1
                show(sum(done))
            return found

        if threads == 1:
            yield from work(0)
            return
        with ThreadPoolExecutor(threads) as pool:
            for lot in pool.map(work, range(threads)):
                yield from lot

    def follow(self, number: int, kept: dict[str, object]) -> _Path:
        """Make one motion; `kept` holds what explicit methods keep from start to start."""
        own, q, qd = self.starts.list_parameters(number), self.starts.q[number], self.starts.qd[number]
        kernels = self.mechanism.with_parameters(**own) if own else self.mechanism
        course = self.course or stand(q[place_driven(kernels.manifest)])
        try:
            check_start(kernels, q, qd)
            if self.is_closed:
                check_course(kernels.manifest, course, q, qd)
                check_closed(kernels, q, qd)
            _ = kernels.filled  # parameters may have no setup
        except (ValueError, OpenError, KernelError) as error:
            halt = Halt(0.0, None, str(error), "start elsewhere")
            return _Path(np.zeros(1), np.hstack((q, qd))[None], 0.0, np.hstack((q, qd)), halt)
        dynamics = Dynamics(kernels, self.settings.formulation, course)
        if isinstance(plant := kept.get(_PLANT), Plant):
            plant.begin(dynamics)
            dynamics.kept[_PLANT] = plant
        path = self._integrate(dynamics, q, qd)
        kept.update({key: x for key, x in dynamics.kept.items() if key == _PLANT})
        return path

    def _integrate(self, dynamics: Dynamics, q: Array, qd: Array) -> _Path:
        method, settings = METHODS[self.settings.method], self.settings
        integrate = method.closed if self.is_closed else method.integrate
        assert integrate is not None, "the method was checked to take loops"
        allowance, outputs = Allowance(Limits(settings.max_steps, settings.max_seconds)), Outputs(self.distance)
        t, states, time, last, halt = [0.0], [np.hstack((q, qd))], 0.0, (q, qd), None
        pieces = self.drive.play(dynamics.kernels, settings.duration, lambda: last)
        while halt is None and time < settings.duration:
            try:
                piece = next(pieces)
                check_inputs(dynamics.kernels, piece, *last)
                outputs.open()
                for chunk in integrate(dynamics, piece, *last, settings, allowance):
                    finer, chosen = outputs.choose(chunk)
                    t += finer.t[chosen].tolist()
                    states += list(np.hstack((finer.q[chosen], finer.qd[chosen])))
                    time, last = float(chunk.t[-1]), (chunk.q[-1], chunk.qd[-1])
            except HaltError as error:
                halt = error.halt
            except DriveError as error:
                if self.drive.control is None:
                    raise
                halt = Halt(time, None, error.finding, error.remedy)
            if t[-1] != time and halt is None:
                t.append(time)
                states.append(np.hstack(last))
        return _Path(np.array(t), np.array(states), time, np.hstack(last), halt)

    # --- in C, by a tolerance ---

    @property
    def fits_series(self) -> bool:
        """Return whether adaptive steps call kernels alone."""
        method, manifest = METHODS[self.settings.method], self.mechanism.manifest
        is_explicit = method.stability is not None and method.family is Family.ADAPTIVE
        is_smooth = not (manifest.switching or manifest.driven) and self.drive.control is None
        return is_explicit and is_smooth and all(piece.is_constant for piece in self._list_pieces())

    def _list_pieces(self) -> list[Piece]:
        return list(
            self.drive.play(self.mechanism, self.settings.duration, lambda: (self.starts.q[0], self.starts.qd[0]))
        )

    def make_series(self, threads: int, show: Show) -> Iterator[tuple[int, _Path]]:
        """Make motions in C, start by start. One that ends early is made again by itself, for its time and reason."""
        count = len(self.starts)
        kept: list[dict[str, object]] = [{} for _ in range(threads)]
        good = np.flatnonzero(self._find_good(self.starts))
        first = int(good[0]) if good.size else 0
        paths = [self.follow(first, own) for own in kept[: 1 if count < threads else threads]]  # makes the plants
        plants = [own[_PLANT] for own in kept if isinstance(own.get(_PLANT), Plant)]
        show(0)
        if not plants:
            yield from self.make_singly(range(count), 1, show)
            return
        yield first, paths[0]
        for begin in range(0, count, GROUP):
            chosen = [k for k in range(begin, min(begin + GROUP, count)) if k != first]
            t, states, is_good = self._run_series(chosen, [x for x in plants if isinstance(x, Plant)])
            for k, found, is_whole in zip(chosen, states, is_good, strict=True):
                yield (k, _Path(t, found, float(t[-1]), found[-1], None) if is_whole else self.follow(k, kept[0]))
            show(min(begin + GROUP, count))

    def _run_series(self, chosen: Sequence[int], plants: Sequence[Plant]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Move starts through all pieces; return the times (K,), the states (N, K, nq + n), and which are good."""
        starts = self.starts.choose(list(chosen))
        states, t = [np.hstack((starts.q, starts.qd))[:, None]], [np.zeros(1)]
        lengths, is_good = np.zeros(len(starts)), self._find_good(starts)
        if self.is_closed:
            is_good &= np.array([self._is_closed(k) for k in chosen], dtype=np.bool_)
        given = {name: self._give(name, own, starts) for name, own in plants[0].memory.filled.items()}
        for piece in self._list_pieces():
            times = list_times(self.distance, piece.start, piece.end)
            kept = np.full((len(starts), 1 + len(times), states[0].shape[2]), np.nan)
            kept[:, 0], status = states[-1][:, -1], np.zeros(len(starts), dtype=np.int32)

            def work(
                k: int, piece: Piece = piece, times: Array = times, kept: Array = kept, status: Any = status
            ) -> None:
                ends = [len(status) * j // len(plants) for j in (k, k + 1)]
                near, most = SAME * self.distance, self.settings.max_steps
                plants[k].run_series(piece, times, near, given, kept, lengths, status, range(*ends), min(most, MOST))

            with ThreadPoolExecutor(len(plants)) as pool:
                list(pool.map(work, range(len(plants))))
            is_good &= status == 0
            states.append(kept[:, 1:])
            t.append(times)
        found = np.concatenate(states, axis=1)
        return np.concatenate(t), found, is_good & np.isfinite(found).all(axis=(1, 2))

    def _give(self, name: str, own: Mapping[str, Array], starts: _Starts) -> dict[str, Array]:
        """Compute the inputs of a kernel that come from parameters: a row for each start, or one."""
        if not own:
            return {}
        holder = self.mechanism.find_holder(name)
        found = {
            x.argument.name: x.values[:, 0, 0]
            for x in read_parameters(holder, holder.describe(name), starts.parameters)
        }
        return {key: np.ascontiguousarray(rows) for key, rows in found.items() if key in own}

    def _is_closed(self, number: int) -> bool:
        """Return whether the loops are closed at a start."""
        try:
            kernels = self.mechanism.with_parameters(**self.starts.list_parameters(number))
            check_closed(kernels, self.starts.q[number], self.starts.qd[number])
        except (OpenError, KernelError):
            return False
        return True

    # --- abreast ---

    def make_abreast(self, threads: int, show: Show) -> Iterator[tuple[int, _Path]]:
        """Make motions in lanes. One that ends early is made again by itself, for its time and reason."""
        for first in range(0, len(self.starts), GROUP):
            some = self.starts.choose(slice(first, first + GROUP))
            t, states, is_good = self._march(some, threads)
            for k in np.flatnonzero(is_good):
                yield first + int(k), _Path(t, states[k], float(t[-1]), states[k, -1], None)
            yield from self.make_singly([first + int(k) for k in np.flatnonzero(~is_good)], 1, lambda _: None)
            show(min(first + GROUP, len(self.starts)))

    def _march(self, starts: _Starts, threads: int) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Move starts through all pieces; return the times (K,), the states (N, K, nq + n), and which are good."""
        states = [np.hstack((starts.q, starts.qd))[:, None]]
        t, is_good = [np.zeros(1)], self._find_good(starts)
        function = self.settings.formulation.evaluated.function
        fixed = read_parameters(self.mechanism, self.mechanism.describe(function), starts.parameters)
        for piece in self.drive.play(self.mechanism, self.settings.duration, lambda: (starts.q, starts.qd)):
            check_inputs(self.mechanism, piece, starts.q[0], starts.qd[0])
            count = count_steps(piece, self.settings.step)
            h = (piece.end - piece.start) / count
            for first, steps, every in _divide(count, find_stride(self.distance, h)):
                kept = np.full((len(starts), 1 + steps // every, states[-1].shape[2]), np.nan)
                kept[:, 0] = states[-1][:, -1]
                given = [*fixed, *self._sample(function, piece, h, first, steps)]
                march = March(self.mechanism, function, given, FIXED[self.settings.method], (h, steps, every), ())
                is_good &= march.move(kept, threads) == 0
                states.append(kept[:, 1:])
                t.append(place_steps(piece, first + every * (1 + np.arange(steps // every)), count))
        found = np.concatenate(states, axis=1)
        return np.concatenate(t), found, is_good & np.isfinite(found).all(axis=(1, 2))

    def _sample(self, function: str, piece: Piece, h: float, first: int, steps: int) -> Iterator[Given]:
        """Compute the inputs at the stages of some steps; one row where they are constant."""
        nodes = FIXED[self.settings.method].c
        times = np.full((1, 1), piece.start)
        if not piece.is_constant:
            times = piece.start + h * (first + np.arange(steps)[:, None] + nodes)
        values = np.asarray(piece.values(times.ravel()), dtype=np.float64).reshape(1, *times.shape, -1)
        forces = len(self.mechanism.manifest.actuated)
        parts = {"u": values[..., :forces], "w": values[..., forces:]}
        for argument in self.mechanism.describe(function).inputs:
            if argument.name in parts and argument.nnz:
                yield Given(argument, np.ascontiguousarray(parts[argument.name]))

    def _find_good(self, starts: _Starts) -> NDArray[np.bool_]:
        """Return which starts are numbers, and quaternions, (N,)."""
        lengths = measure_lengths(starts.q, self.mechanism.manifest)
        return np.asarray(np.isfinite(np.hstack((starts.q, starts.qd))).all(axis=1) & (lengths != 0).all(axis=1))

    # --- together ---

    def gather(self, paths: Iterator[tuple[int, _Path]]) -> Motions:
        """Lay all motions out at common times: the times of the longest one."""
        found, places = dict(paths), self.starts.q.shape[1]
        t = max((path.t for path in found.values()), key=len, default=np.zeros(1))
        states = np.full((len(self.starts), len(t), places + self.starts.qd.shape[1]), np.nan)
        for k, path in found.items():
            states[k, : len(path.t)] = path.states
        ordered = [found[k] for k in range(len(self.starts))]
        times, last = (
            np.array([x.time for x in ordered]),
            np.array([x.last for x in ordered]).reshape(-1, states.shape[2]),
        )
        halts = tuple(x.halt for x in ordered)
        ends = (times, last[:, :places], last[:, places:])
        q, qd = states[..., :places], states[..., places:]
        return Motions(self.settings, t, q, qd, ends, halts, self.mechanism, self.starts.parameters)


def _divide(count: int, stride: int) -> Iterator[tuple[int, int, int]]:
    """Divide steps into runs: the first step, how many, and how many lie between states that are kept."""
    whole = count // stride * stride
    most = max(1, BLOCK // stride) * stride
    for first in range(0, whole, most):
        yield first, min(most, whole - first), stride
    if whole < count:
        yield whole, count - whole, count - whole
