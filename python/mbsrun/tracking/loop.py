"""The closed loop: at each sample k, at the time t_k = k h,

    measured = state + noise,    planned from = the measured state, or its prediction at t_k + delay h
    u_(k + delay) = controller(planned from),    state(t_(k+1)) = plant(state(t_k), u_k + noise)

The loop is synchronous: the plant waits for the controller, and computing times are recorded, not acted on. A delay of
whole periods stands for the time that the computation takes; with prediction, the controller plans from the state in
which its inputs will act, by its own model and the inputs that are on their way (Findeisen, Allgoewer, "Computational
delay in nonlinear model predictive control", IFAC Proceedings 37 (2004)).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.expressions import ExpressionError
from mbsrun.external import Mechanism
from mbsrun.ocp.problem.problem import Bounds
from mbsrun.quaternions import normalise
from mbsrun.simulation.drive import hold_steps
from mbsrun.simulation.motion import Halt
from mbsrun.simulation.simulate import simulate
from mbsrun.tracking.added import hold_inputs
from mbsrun.tracking.controller import Controller, Decision, Remembering
from mbsrun.tracking.plant import Plant
from mbsrun.tracking.trial import Fallback, Trial

Array = NDArray[np.float64]

State = tuple[Array, Array, Array]  # coordinates, velocities, and states that a problem adds

INSIDE = 1e-6  # how far from a bound a state beyond it is put, relative to 1 + |state|
UNPREDICTED = "No_Prediction"  # the status of a sample at which the model has no motion to the end of the delay


class NoPlanError(MbsError):
    """A controller that finds no plan from the start."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample of the loop, and the period after it."""

    time: float
    q: Array  # the true state
    qd: Array
    measured_q: Array
    measured_qd: Array
    states: Array  # (ns,): that the problem adds
    decision: Decision
    preparing: float  # s of processor time, before the measurement
    u: Array  # (m + k,): inputs, then controls that the problem adds, as asked for in this period, delay included
    acting: Array  # (m + k,): and as they acted, with noise; both with inputs by expressions as they begin
    is_moved: bool  # the measured state was beyond a bound, and the controller got a state within it


@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """The samples of a loop, and the true motion at K times."""

    trial: Trial
    first: Decision  # the plan from the start, which is made before the loop begins
    samples: tuple[Sample, ...]
    t: Array  # (K,)
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    states: Array  # (K, ns): that the problem adds
    u: Array  # (K, m + k): inputs and controls that were asked for
    drift: float | None  # J: the largest drift of the energy in a period; None: it is not known
    lossy: int  # periods whose drift is larger than it should be
    halt: Halt | None

    def __repr__(self) -> str:
        """Return the length of the loop, and how it ended."""
        end = "complete" if self.halt is None else f"incomplete: {self.halt}"
        return f"Track({self.t[-1]:.6g} s, {len(self.samples)} samples, {self.failures} without a new plan, {end})"

    @property
    def failures(self) -> int:
        """Count the samples without a new plan."""
        return sum(not sample.decision.is_solved for sample in self.samples)

    @property
    def is_complete(self) -> bool:
        """Return whether the end was reached."""
        return self.halt is None


def track(
    trial: Trial,
    bounds: Bounds,
    plant: Plant,
    controller: Controller,
    model: Mechanism | None = None,
    show: Callable[[Sample], None] = lambda _: None,
) -> Track:
    """Run a trial; call `show` with each sample.

    `bounds` are the controller's; `model` is the controller's mechanism, needed for predictions. A failure on the way
    is no exception: `halt` of the track then describes why it ends early. Raises NoPlanError where the controller
    finds no plan from the start, ExpressionError where an expression has no value there.
    """
    loop = _Loop(trial, bounds, plant, controller, model)
    for k in range(trial.samples):
        try:
            show(loop.step(k))
        except (KeyboardInterrupt, ExpressionError) as error:
            if not loop.samples:
                raise
            loop.halt = Halt(k * trial.period, None, *_explain(error))
        if loop.halt is not None:
            break
    return loop.finish()


def _explain(error: KeyboardInterrupt | ExpressionError) -> tuple[str, str]:
    """Return finding and remedy of a loop that cannot go on."""
    if isinstance(error, ExpressionError):
        return error.finding, error.remedy
    return "the user stopped it", "run it again for the whole"


class _Loop:
    """Holds the plant's state, and the inputs that are on their way."""

    def __init__(
        self, trial: Trial, bounds: Bounds, plant: Plant, controller: Controller, model: Mechanism | None
    ) -> None:
        self.trial, self.plant, self.controller, self.model = trial, plant, controller, model
        added = () if plant.added is None else plant.added.bounds
        self.lower, self.upper = (np.array(side) for side in zip(*bounds.q, *bounds.qd, *added, strict=True))
        self.q, self.qd, self.states = trial.start_q, trial.start_qd, trial.start_states
        self.lines = {line.input: deque([line.history] * line.periods) for line in plant.lines}
        self.samples: list[Sample] = []
        self.stretches = [(np.zeros(1), self.q[None], self.qd[None], self.states[None])]
        self.drift, self.lossy, self.halt = 0.0, 0, None  # type: tuple[float | None, int, Halt | None]
        controller.prepare(0.0, trial.constants_at(0.0))
        self.first, _ = self._ask(self.q, self.qd, self.states)
        if not self.first.is_solved:
            raise NoPlanError(
                f"the controller finds no plan from the start ({self.first.status}); "
                "solve the problem by `mbsrun solve`, and mend it until that succeeds"
            )
        self.pending = deque(controller.planned(k * trial.period) for k in range(trial.delay))
        for k, inputs in enumerate(self.pending):
            self._note(k * trial.period, inputs)
        self.last = controller.planned(0.0)

    def step(self, k: int) -> Sample:
        """Take sample k, and move the plant through the period after it."""
        trial, start = self.trial, k * self.trial.period
        ahead = start + trial.delay * trial.period * trial.predicts
        before = time.process_time()
        self.controller.prepare(ahead, trial.constants_at(ahead))
        preparing = time.process_time() - before
        measured = self.plant.measure(k, self.q, self.qd)
        decision, is_moved = self._decide(ahead, measured)
        u = decision.inputs
        if not decision.is_solved and trial.fallback is Fallback.HOLD:
            u = self.pending[-1] if self.pending else self.last
        self._note(ahead, u)
        self.pending.append(u)
        self.last = self.pending.popleft()
        asked = self._send(self.last)
        here, times = (self.q[None], self.qd[None], self.states[None]), np.array([start])
        acting = self.plant.complete(*here, start, times, self.plant.disturb(k, asked))[0]
        asked = self.plant.complete(*here, start, times, asked)[0]
        sample = Sample(start, self.q, self.qd, *measured, self.states, decision, preparing, asked, acting, is_moved)
        if not decision.is_solved and trial.fallback is Fallback.STOP:
            self.halt = Halt(start, None, f"the controller found no plan ({decision.status})", "see the fallback")
        else:
            self._advance(start, min(start + trial.period, trial.duration), acting)
        self.samples.append(sample)
        return sample

    def finish(self) -> Track:
        """Gather the track."""
        t, q, qd, states = (np.concatenate(part) for part in zip(*self.stretches, strict=True))
        period = (t / self.trial.period * (1 - 1e-12)).astype(int)
        u = np.array([sample.u for sample in self.samples])[period]
        for k in np.unique(period).tolist() if self.plant.is_whole else ():
            x, sample = period == k, self.samples[k]
            u[x] = self.plant.complete(q[x], qd[x], states[x], sample.time, t[x], sample.u)
        motion = (t, q, qd, states, u)
        return Track(self.trial, self.first, tuple(self.samples), *motion, self.drift, self.lossy, self.halt)

    def _decide(self, ahead: float, measured: tuple[Array, Array]) -> tuple[Decision, bool]:
        """Plan from a measured state, or from its prediction."""
        state: State | None = (*measured, self.states)
        if self.pending and self.trial.predicts:
            state = self._predict(ahead, *measured, self.states)
        if state is None:
            return Decision(self.controller.planned(ahead), UNPREDICTED, False, 0, 0.0, np.nan), False
        return self._ask(*state)

    def _ask(self, q: Array, qd: Array, states: Array) -> tuple[Decision, bool]:
        """Ask the controller for a plan from a state, or from the nearest one that it takes."""
        q, qd, states, is_moved = self._move_inside(q, qd, states)
        if isinstance(self.controller, Remembering):
            self.controller.measure(states)
        return self.controller.feedback(q, qd), is_moved

    def _note(self, time: float, inputs: Array) -> None:
        if isinstance(self.controller, Remembering):
            self.controller.note(time, inputs)

    def _send(self, inputs: Array) -> Array:
        """Send inputs to the actuators, some of which act late; return the inputs that act now."""
        acting = inputs.copy()
        for i, line in self.lines.items():
            line.append(inputs[i])
            acting[i] = line.popleft()
        return acting

    def _predict(self, ahead: float, q: Array, qd: Array, states: Array) -> State | None:
        """Return the state at the end of the delay by the controller's model; None where the motion stops before."""
        assert self.model is not None, "a delay with prediction needs the model"
        count, coming = len(self.pending), np.array(self.pending)
        for i, line in self.lines.items():
            coming[:, i] = [*line, *coming[:, i]][:count]
        times = self.trial.period * np.arange(count + 1)
        if self.plant.added is None:
            settings = replace(self.trial.integration, duration=float(times[-1]))
            motion = simulate(self.model, hold_steps(times, coming), q, qd, settings)
            return (motion.q[-1], motion.qd[-1], states) if motion.is_complete else None
        added, state = self.plant.added.move_to(self.model), (q, qd, states)
        for first, u in zip(ahead - times[:0:-1], coming, strict=True):
            end = np.array([first + self.trial.period])
            controls = u[len(self.model.manifest.actuated) :]
            found = added.carry(state, hold_inputs(u, self.model), float(first), end, self.trial, controls=controls)
            if isinstance(found, str):
                return None
            reached, driven, further = np.split(found[-1], [q.size, q.size + qd.size])
            state = normalise(reached, self.model.manifest), driven, further
        return state

    def _move_inside(self, q: Array, qd: Array, states: Array) -> tuple[Array, Array, Array, bool]:
        """Put entries of a state that are beyond the controller's bounds just inside: plans begin within them."""
        state = np.concatenate((q, qd, states))
        margin = INSIDE * (1 + np.abs(state))
        is_low, is_high = state < self.lower, state > self.upper
        inside = np.where(is_low, self.lower + margin, np.where(is_high, self.upper - margin, state))
        q, qd, states = np.split(inside, [q.size, q.size + qd.size])
        return q, qd, states, bool((is_low | is_high).any())

    def _advance(self, start: float, end: float, acting: Array) -> None:
        stretch = self.plant.advance(self.q, self.qd, self.states, start, end, acting)
        self.stretches.append((stretch.t[1:], stretch.q[1:], stretch.qd[1:], stretch.states[1:]))
        self.q, self.qd, self.states = stretch.q[-1], stretch.qd[-1], stretch.states[-1]
        self.drift = None if self.drift is None or stretch.drift is None else max(self.drift, abs(stretch.drift))
        self.lossy += not stretch.is_kept
        self.halt = stretch.halt
