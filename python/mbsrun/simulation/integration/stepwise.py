"""Motions by an explicit method's steps in Python, from event to event: courses whose equations no C function has.

An event is where a guard falls below 0. Steps from the start of the step in which it lies find it to rounding.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.events import Course
from mbsrun.simulation.integration.steps import count_steps, find_longest
from mbsrun.simulation.integration.tableaus import Pair
from mbsrun.simulation.motion import Chunk, Dense, Halt, HaltError, Settings

Array = NDArray[np.float64]

STEPS = 64  # yielded at a time
LOOKS = np.array([0.25, 0.5, 0.75, 1.0])  # parts of a step, for numbers that fall below 0 and rise again within it
ROUNDED = 1e-9  # of a fixed step: what the sum of all before it is rounded to
DIPS = 40  # halvings of a part of a step, to where a guard is least
DEEP = 1e-11  # m: a distance that falls less below 0 has not fallen
CLOSEST = 4 * np.finfo(float).eps


class Locked(Protocol):
    """A mode, in which no joint may be able to move."""

    @property
    def is_locked(self) -> bool:
        """Return whether no joint can move."""
        ...


M = TypeVar("M", bound=Locked)
G = TypeVar("G")


class Stepwise(Course, Generic[M, G]):
    """A motion in modes M, while guards G are not negative."""

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings) -> None:
        super().__init__(settings)
        formulation = dynamics.formulation
        own = Formulation.SEMI if formulation.evaluated.is_direct else formulation
        self.dynamics, self.pair = replace(dynamics, formulation=own), pair
        tableau = pair.tableau
        self.A, self.b, self.c = (np.array(x, dtype=np.float64) for x in (tableau.A, tableau.b, tableau.c))
        self.E = np.array(pair.E, dtype=np.float64)
        self.mode: M | None = None
        self.length = 0.0  # of the next step; 0: not known
        self.fired: tuple[G, ...] = ()  # guards at the last event,
        self.guards: tuple[G, ...] = ()  # and the ones that fired since the last chunk

    @abstractmethod
    def move(self, piece: Piece, mode: M, t: Array, x: Array) -> Array:
        """Return the rates of states (K, nq + n)."""

    @abstractmethod
    def list_guards(self, mode: M) -> list[G]:
        """List what must not fall below 0 while a mode lasts."""

    @abstractmethod
    def measure(self, piece: Piece, mode: M, guards: list[G], t: Array, x: Array) -> Array:
        """Return the guards at states, (K, guards)."""

    @abstractmethod
    def release(self, piece: Piece, mode: M, time: float, x: Array) -> None:
        """Note what the guards that fired no longer hold, at a state (nq + n,)."""

    @abstractmethod
    def gather(self, piece: Piece, mode: M, times: list[float], states: list[Array]) -> Chunk:
        """Bundle steps with the motion within them."""

    def interpolate(self, piece: Piece, mode: M, t: Array, x: Array) -> Dense:
        """Return the motion within steps from states at times: by steps from where each of them begins."""

        def dense(at: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
            ends = self.step(piece, mode, t[step], x[step], at - t[step])[0]
            q, qd = np.split(ends, [self.dynamics.places], axis=1)
            return q, qd

        return dense

    def finish(self, _mode: M, x: Array) -> Array:
        """Put states back on the equations of a mode."""
        return x

    def step(self, piece: Piece, mode: M, t: Array, x: Array, h: Array) -> tuple[Array, Array]:
        """Take steps of lengths (K,) from states at times (K,); return their ends and the stages."""
        stages = np.zeros((len(self.b), *x.shape))
        if mode.is_locked:
            return x.copy(), stages
        for i, row in enumerate(self.A):
            y = x + h[:, None] * np.tensordot(row[:i], stages[:i], 1) if i else x
            stages[i] = self.move(piece, mode, t + self.c[i] * h, y)
        return self.finish(mode, x + h[:, None] * np.tensordot(self.b, stages, 1)), stages

    def run(self, piece: Piece, q: Array, qd: Array, allowance: Allowance) -> Iterator[Chunk]:
        """Integrate until an event or the end of the piece; the chunk of an event at once has one state."""
        assert self.mode is not None, "a mode was found"
        mode, guards = self.mode, self.list_guards(self.mode)
        count = 0 if len(self.E) else count_steps(piece, self.settings.step)
        longest = find_longest(self.settings.duration, piece, self.dynamics.course)
        fixed = (piece.end - piece.start) / count if count else 0.0
        time, x = piece.start, np.concatenate((q, qd))
        times, states = [time], [x]
        is_event = False
        while time < piece.end and not is_event:
            allowance.spend()
            allowance.note(0)
            left = piece.end - time
            h = fixed or min(self.length or min(left, 1e-3), left, longest)
            try:
                h, ends = self.advance(piece, mode, time, x, h, fixed=bool(fixed))
                y, found = ends[-1], self.look(piece, mode, guards, time, x, h, ends)
            except KernelError:  # as of points far inside each other, which have no distance
                self.length = h / 4
                if fixed or self.length < 1e-14 * max(1.0, time):
                    if len(times) > 1:
                        yield self.gather(piece, mode, times, states)
                    raise
                continue
            is_event = found is not None
            if found is not None:
                h, y = found
            is_last = h >= left * (1 - (ROUNDED if fixed else 1e-14))
            time = piece.end if is_last and not is_event else time + h
            self.dynamics.effort.steps += 1
            x = y
            if time > times[-1]:
                times.append(time)
                states.append(x)
            else:  # an event at once
                states[-1] = x
            if len(times) > STEPS or is_event or time >= piece.end:
                chunk = self.gather(piece, mode, times, states)
                self.guards = (*self.guards, *self.fired) if is_event else self.guards
                yield chunk
                times, states = [time], [x]

    def advance(self, piece: Piece, mode: M, time: float, x: Array, h: float, *, fixed: bool) -> tuple[float, Array]:
        """Take a step, as long as the tolerance allows; return its length, and the states after its parts (LOOKS)."""
        effort, count = self.dynamics.effort, len(LOOKS)
        while True:
            y, stages = self.step(piece, mode, np.full(count, time), np.repeat(x[None], count, axis=0), h * LOOKS)
            if fixed:
                return h, y
            error = self.estimate(h, x, y[-1], stages[:, -1], piece, mode, time)
            factor = 0.25 if not np.isfinite(error) else 10.0 if error == 0 else 0.9 * error ** (-1 / self.pair.order)
            self.length = h * min(10.0, max(0.2, factor))
            if error <= 1:
                return h, y
            effort.rejected = (effort.rejected or 0) + 1
            h = self.length
            if h < 1e-14 * max(1.0, time):
                finding = "the step has become too short to advance the time"
                raise HaltError(Halt(time, None, finding, "loosen the tolerance, or look for a singularity there"))

    def estimate(self, h: float, x: Array, y: Array, stages: Array, piece: Piece, mode: M, time: float) -> float:
        """Return the error of a step relative to the tolerances."""
        if self.E.shape[1] > len(stages):
            last = self.move(piece, mode, np.array([time + h]), y[None])
            stages = np.vstack((stages, last))
        scale = self.settings.atol + self.settings.rtol * np.maximum(np.abs(x), np.abs(y))
        squares = [float(((row @ stages / scale) ** 2).sum()) for row in self.E]
        if len(squares) == 1:
            return h * float(np.sqrt(squares[0] / len(x)))
        if squares[0] == 0:
            return 0.0
        return h * squares[0] / float(np.sqrt((squares[0] + 0.01 * squares[1]) * len(x)))

    def look(
        self, piece: Piece, mode: M, guards: list[G], time: float, x: Array, h: float, ends: Array
    ) -> tuple[float, Array] | None:
        """Find the first event in a step, by the states after its parts; return the length up to it, and the state.

        Between two parts, a guard may have fallen below 0 and risen again: its rates at both show that.
        """
        if not guards:
            return None
        parts = h * LOOKS
        values = self.measure(piece, mode, guards, time + parts, ends)
        below = np.flatnonzero((values < 0).any(axis=1))
        first = int(below[0]) if below.size else len(parts)
        dip = self.find_dip(piece, mode, guards, time, x, parts[:first], ends[:first])
        if dip is not None:
            low, high, fallen = dip
        elif below.size:
            low, high, fallen = parts[first - 1] if first else 0.0, parts[first], values[first]
        else:
            return None
        falls = [(self.locate(piece, mode, guards[j], time, x, low, high), j) for j in np.flatnonzero(fallen < 0)]
        length, _ = min(falls)
        state = self.step(piece, mode, np.array([time]), x[None], np.array([length]))[0][0]
        at = self.measure(piece, mode, guards, np.array([time + length]), state[None])[0]
        near = [j for end, j in falls if end <= length * (1 + 1e-12) or at[j] <= 0]
        self.fired = tuple(guards[j] for j in near)
        self.release(piece, mode, time + length, state)
        return length, state

    def find_dip(
        self, piece: Piece, mode: M, guards: list[G], time: float, x: Array, parts: Array, ends: Array
    ) -> tuple[float, float, Array] | None:
        """Find the first of some parts of a step within which a guard falls below 0 and rises again.

        Returns the lengths of the step up to where that part begins and to where the guard is below 0, and all guards.
        """
        rates = self.descend(guards, np.vstack((x[None], ends)))
        starts = np.array([0.0, *parts])
        for k in range(len(parts)):
            for j in np.flatnonzero((rates[k] < 0) & (rates[k + 1] > 0)):
                low, high = float(starts[k]), float(starts[k + 1])
                for _ in range(DIPS):  # bisection: towards where the guard is least
                    middle = (low + high) / 2
                    state = self.step(piece, mode, np.array([time]), x[None], np.array([middle]))[0]
                    found = self.measure(piece, mode, guards, np.array([time + middle]), state)[0]
                    if found[j] < -DEEP:
                        return float(starts[k]), middle, found
                    rate = self.descend(guards, state)[0, j]
                    if found[j] > 2 * (high - low) * abs(rate):  # too far above 0 to reach it
                        break
                    low, high = (middle, high) if rate < 0 else (low, middle)
        return None

    def descend(self, guards: list[G], x: Array) -> Array:
        """Return the rates of guards at states (K, nq + n), shape (K, guards); 0 where they are not known."""
        return np.zeros((len(x), len(guards)))

    def locate(self, piece: Piece, mode: M, guard: G, time: float, x: Array, low: float, high: float) -> float:
        """Return the length of the step to where a guard is 0: it is below 0 after `high`."""

        def value(h: float) -> float:
            end = self.step(piece, mode, np.array([time]), x[None], np.array([h]))[0] if h else x[None]
            return float(self.measure(piece, mode, [guard], np.array([time + h]), end)[0, 0])

        if low == 0 and value(0.0) <= 0:  # it has just risen from 0
            for _ in range(40):
                middle = high / 2
                if value(middle) > 0:
                    low = middle
                    break
                high = middle
            else:
                return high
        from scipy.optimize import brentq  # here, and late: it takes long to load

        return float(brentq(value, low, high, xtol=CLOSEST * high, rtol=CLOSEST, maxiter=100))
