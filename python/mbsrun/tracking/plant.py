"""The plant of a closed loop: its true state, which the simulation moves from sample to sample, and measurements.

    q, qd  ->  simulate under inputs that are constant, in pieces between kicks and the ends of pushes  ->  q, qd

The package `simulation` takes the steps, with its methods, tolerances and limits. An adaptive method keeps the error of
each step below its tolerance; the drift of the energy checks all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import find_closure
from mbsrun.external import Mechanism
from mbsrun.ocp.problem.problem import Problem
from mbsrun.quaternions import list_quaternions, normalise
from mbsrun.simulation.drive import Drive, control, hold
from mbsrun.simulation.motion import Halt
from mbsrun.simulation.simulate import simulate
from mbsrun.tracking.added import AddedStates, Line, is_whole, list_lines
from mbsrun.tracking.trial import Trial

Array = NDArray[np.float64]

RATES = "see the rates under states of the problem"
WHOLE = "see the rates under states of the problem, and its forces"
FINE = 10  # states that are kept of a period
MEASURED, DRIVEN = 0, 1  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Stretch:
    """The motion in one period: K states, from its start on; the last is the next period's first, before kicks."""

    t: Array  # (K,)
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    states: Array  # (K, ns): that a problem adds
    drift: float | None  # J, of the energy: the sum of all pieces; None: inputs follow the state, and it is unknown
    is_kept: bool  # the drift is as small as `simulation` expects of every piece
    halt: Halt | None


class Plant:
    """A simulated mechanism with disturbances."""

    def __init__(self, kernels: Mechanism, trial: Trial, problem: Problem | None = None) -> None:
        """Take the kernels of the true mechanism; its masses may differ from the controller's.

        `problem` may add states, and inputs that act late.
        """
        self.kernels, self.trial = kernels, trial
        self.added: AddedStates | None = None
        self.lines: tuple[Line, ...] = ()
        if problem is not None:
            self.lines = list_lines(problem, trial.period)
        if problem is not None and (problem.states or is_whole(problem)):
            self.added = AddedStates(problem, kernels, trial.integration.max_seconds)
        self._forces = len(kernels.manifest.actuated)
        self._wrenches = len(kernels.manifest.inputs) - self._forces

    @property
    def is_whole(self) -> bool:
        """Return whether mechanism and states of the problem move as one system."""
        return self.added is not None and self.added.is_whole

    def measure(self, k: int, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return the state as sample k measures it."""
        noise, manifest = self.trial.noise, self.kernels.manifest
        random = np.random.default_rng((noise.seed, k, MEASURED))
        spread = noise.q.copy()
        for quaternion in list_quaternions(manifest):
            spread[quaternion.entries] /= 2  # an angle is twice the change of a quaternion
        q = normalise(q + spread * random.standard_normal(q.size), manifest)
        qd = qd + noise.qd * random.standard_normal(qd.size)
        closure = find_closure(self.kernels)
        if closure is None:
            return q, qd
        (q,), (qd,) = closure.project(q[None], qd[None])
        return q, qd

    def disturb(self, k: int, u: Array) -> Array:
        """Return the inputs that act in period k where `u` is asked for."""
        random = np.random.default_rng((self.trial.noise.seed, k, DRIVEN))
        return u + self.trial.noise.u * random.standard_normal(u.size)

    def complete(self, q: Array, qd: Array, states: Array, start: float, times: Array, u: Array) -> Array:
        """Return inputs (K, m + k) of the period from `start` on, with the ones that expressions give at K states."""
        every = np.tile(u, (len(times), 1))
        if self.added is None or not self.is_whole:
            return every
        return self.added.complete((q, qd, states), every, start, times, self.trial)

    def advance(self, q: Array, qd: Array, states: Array, start: float, end: float, u: Array) -> Stretch:
        """Move from `start` to `end` under inputs and controls (m + k,); kicks at `start` act first."""
        if self.added is not None and self.is_whole:
            return self._advance_whole(self.added, (q, qd, states), start, end, u)
        times, motions, added = [np.array([start])], [(q[None], qd[None])], [states[None]]
        drift, is_kept, halt = 0.0, True, None
        spacing = (end - start) / FINE
        for first, last in self._cut(start, end):
            qd = self._kick(first, q, qd)
            settings = replace(self.trial.integration, duration=last - first, output_step=spacing)
            motion = simulate(self.kernels, self._drive(first, u), q, qd, settings)
            times.append(first + motion.t[1:])
            motions.append((motion.q[1:], motion.qd[1:]))
            added.append(np.repeat(added[-1][-1:], len(motion.t) - 1, axis=0))
            halt = motion.halt
            if self.added is not None and halt is None:
                state = q, qd, added[-2][-1]
                found = self.added.carry(state, self._act(first, u), start, times[-1], self.trial, first)
                halt = Halt(0.0, None, found, RATES) if isinstance(found, str) else None
                added[-1] = added[-1] if isinstance(found, str) else found[:, -len(states) :]
            q, qd = motion.q[-1], motion.qd[-1]
            q = normalise(q, self.kernels.manifest)
            drift += np.inf if motion.energy is None else float(motion.energy.drift[-1])
            is_kept = is_kept and motion.energy is not None and motion.energy.is_kept
            if halt is not None:
                halt = replace(halt, time=first + halt.time)
                break
        all_q, all_qd = (np.concatenate(part) for part in zip(*motions, strict=True))
        return Stretch(np.concatenate(times), all_q, all_qd, np.concatenate(added), drift, is_kept, halt)

    def _advance_whole(
        self, added: AddedStates, state: tuple[Array, Array, Array], start: float, end: float, u: Array
    ) -> Stretch:
        """Move the mechanism together with the states of the problem, on which its inputs depend."""
        q, qd, states = state
        times, rows, halt = [np.array([start])], [np.concatenate(state)[None]], None
        controls = u[self._forces :]
        for first, last in self._cut(start, end):
            qd = self._kick(first, q, qd)
            steps = first + (last - first) * np.arange(1, FINE + 1) / FINE
            force = self._act(first, u[: self._forces])
            found = added.carry((q, qd, states), force, start, steps, self.trial, first, controls)
            if isinstance(found, str):
                halt = Halt(first, None, found, WHOLE)
                break
            times.append(steps)
            rows.append(found)
            q, qd, states = np.split(found[-1], [q.size, q.size + qd.size])
            q = normalise(q, self.kernels.manifest)
        all_q, all_qd, further = np.split(np.concatenate(rows), [q.size, q.size + qd.size], axis=1)
        return Stretch(np.concatenate(times), all_q, all_qd, further, None, True, halt)

    def _cut(self, start: float, end: float) -> Iterator[tuple[float, float]]:
        """Cut a period where something jumps."""
        jumps = [kick.time for kick in self.trial.kicks]
        jumps += [time for push in self.trial.pushes for time in (push.start, push.end)]
        inside = sorted({time for time in jumps if start < time < end})
        knots = [start, *inside, end]
        yield from pairwise(knots)

    def _kick(self, time: float, q: Array, qd: Array) -> Array:
        changes = [change for kick in self.trial.kicks if kick.time == time for change in kick.velocities]
        if not changes:
            return qd
        qd = qd.copy()
        for i, change in changes:
            qd[i] += change
        closure = find_closure(self.kernels)
        return qd if closure is None else closure.project_velocities(q[None], qd[None])[0]

    def _drive(self, start: float, u: Array) -> Drive:
        """Return the inputs from a time on, until the next jump."""
        if not any(push.start <= start < push.end for push in self.trial.pushes):
            return hold(np.concatenate((u, np.zeros(self._wrenches))))
        act = self._act(start, u)
        return control(lambda t, _q, _qd: act(start + t))

    def _act(self, start: float, u: Array) -> Callable[[float], Array]:
        """Return the inputs (u, w) by the loop's time, from a time on until the next jump."""
        pushes = [push for push in self.trial.pushes if push.start <= start < push.end]
        entries = [entry for push in pushes for entry in push.entries]

        def act(t: float) -> Array:
            w = np.zeros(self._wrenches)
            for i, expression in entries:
                w[i] += self.trial.evaluate("wrenches", expression, t)
            return np.concatenate((u, w))

        return act
