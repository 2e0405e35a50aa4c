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

from mbsgen.expressions import Expression
from mbsrun.closure import find_closure
from mbsrun.external import Mechanism
from mbsrun.quaternions import list_quaternions, normalise
from mbsrun.simulation.drive import Drive, control, hold
from mbsrun.simulation.motion import Halt
from mbsrun.simulation.simulate import simulate
from mbsrun.tracking.trial import Trial

Array = NDArray[np.float64]

FINE = 10  # states that are kept of a period
MEASURED, DRIVEN = 0, 1  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Stretch:
    """The motion in one period: K states, from its start on; the last is the next period's first, before kicks."""

    t: Array  # (K,)
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    drift: float  # J, of the energy: the sum of all pieces
    is_kept: bool  # the drift is as small as `simulation` expects of every piece
    halt: Halt | None


class Plant:
    """A simulated mechanism with disturbances."""

    def __init__(self, kernels: Mechanism, trial: Trial) -> None:
        """Take the kernels of the true mechanism; its masses may differ from the controller's."""
        self.kernels, self.trial = kernels, trial
        self._forces = len(kernels.manifest.actuated)
        self._wrenches = len(kernels.manifest.inputs) - self._forces

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

    def advance(self, q: Array, qd: Array, start: float, end: float, u: Array) -> Stretch:
        """Move from `start` to `end` under inputs u (m,); kicks at `start` act first."""
        times, states = [np.array([start])], [(q[None], qd[None])]
        drift, is_kept, halt = 0.0, True, None
        spacing = (end - start) / FINE
        for first, last in self._cut(start, end):
            qd = self._kick(first, q, qd)
            settings = replace(self.trial.integration, duration=last - first, output_step=min(spacing, last - first))
            motion = simulate(self.kernels, self._drive(first, u), q, qd, settings)
            times.append(first + motion.t[1:])
            states.append((motion.q[1:], motion.qd[1:]))
            q, qd, halt = motion.q[-1], motion.qd[-1], motion.halt
            q = normalise(q, self.kernels.manifest)
            drift += np.inf if motion.energy is None else float(motion.energy.drift[-1])
            is_kept = is_kept and motion.energy is not None and motion.energy.is_kept
            if halt is not None:
                halt = replace(halt, time=first + halt.time)
                break
        all_q, all_qd = (np.concatenate(part) for part in zip(*states, strict=True))
        return Stretch(np.concatenate(times), all_q, all_qd, drift, is_kept, halt)

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
        pushes = [push for push in self.trial.pushes if push.start <= start < push.end]
        if not pushes:
            return hold(np.concatenate((u, np.zeros(self._wrenches))))
        return control(self._law(start, u, [entry for push in pushes for entry in push.entries]))

    def _law(
        self, start: float, u: Array, entries: list[tuple[int, Expression]]
    ) -> Callable[[float, Array, Array], Array]:
        def act(t: float, _q: Array, _qd: Array) -> Array:
            w = np.zeros(self._wrenches)
            for i, expression in entries:
                w[i] += self.trial.evaluate("wrenches", expression, start + t)
            return np.concatenate((u, w))

        return act
