"""Additions of a problem to the mechanism of a closed loop: states, controls, inputs by expressions, and delays.

States of a problem, s' = rate(t, q, qd, qdd, u, s, c), are integrated along the true motion, by the integrator of
re-simulations. Their time t counts from the sample on, as a plan's does. The loop measures them without noise.

Controls c are held from sample to sample, as inputs are; the loop keeps both in one vector (u, c). With controls, or
with inputs u = f(t, q, qd, s, c) that expressions give, mechanism and states move as one system.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.limits import Allowance, LimitError, Limits
from mbsrun.ocp.evaluation.values import GivenValues, Values
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solving.resimulation import Step, integrate
from mbsrun.tracking.trial import Trial

Array = NDArray[np.float64]
Force = Callable[[float], Array]  # inputs u before components of wrenches, by the loop's time

LIMIT = 100_000  # steps of a period


@dataclass(frozen=True)
class Line:
    """An input that acts some periods after it is given."""

    input: int  # index into (u, c)
    periods: int
    history: float  # before the start


def list_lines(problem: Problem, period: float) -> tuple[Line, ...]:
    """List the inputs of a problem that act late; `period` is an interval of the problem."""
    first = {"input": 0, "control": len(problem.bounds.u)}
    return tuple(
        Line(first[delay.kind] + delay.index, round(delay.seconds / period), delay.history or 0.0)
        for delay in problem.delays
    )


def is_whole(problem: Problem) -> bool:
    """Return whether inputs depend on more than the loop gives: mechanism and states then move as one system."""
    return bool(problem.controls or problem.forces)


def list_chosen(problem: Problem) -> list[int]:
    """List the entries of (u, c) that a controller chooses: the ones that no expression gives."""
    given = {force.input for force in problem.forces}
    return [i for i in range(len(problem.bounds.u) + len(problem.controls)) if i not in given]


def is_interval(problem: Problem, period: float) -> bool:
    """Return whether a period is the length of all intervals of a problem."""
    interval = problem.horizon / problem.intervals
    return problem.mesh is None and abs(period - interval) <= 1e-6 * interval


def hold_inputs(u: Array, kernels: Plant) -> Force:
    """Return inputs (u, c) of which u stays, without wrenches."""
    u = u[: len(kernels.manifest.actuated)]
    held = np.concatenate((u, np.zeros(len(kernels.manifest.inputs) - len(u))))
    return lambda _: held


@dataclass(frozen=True)
class _Acting:
    """Inputs as the re-simulation reads them."""

    force: Force
    controls: Array  # (k,)
    given: GivenValues
    inputs: int
    sample: float  # the loop's time, of which a plan is at 0
    begun: float  # the loop's time at which the integration begins
    horizon: float
    values: Values

    def read(self, time: Array, q: Array, qd: Array, states: Array) -> dict[str, Array]:
        """Return the parts of a motion."""
        t = self.begun + time
        u, w = np.split(self.force(float(t[0, 0]))[None], [self.inputs], axis=1)
        t = t - self.sample
        none, horizon = np.zeros((1, 0)), np.full_like(t, self.horizon)
        parts = {"q": q, "qd": qd, "u": u, "w": w, "states": states}
        return self.given(parts | {"t": t, "T": horizon, "controls": self.controls[None], "unknowns": none})

    def place(self, _time: Array, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return the states: no joint is driven."""
        return q, qd

    def rates(self, parts: dict[str, Array]) -> Array:
        """Return the rates of the added states."""
        return self.values(parts)


class AddedStates:
    """The states that a problem adds."""

    def __init__(self, problem: Problem, kernels: Plant, seconds: float) -> None:
        """Take the kernels of the mechanism that moves; `seconds` limit the processor time of a period."""
        self._problem = replace(problem, integrals=())
        self._kernels, self._limits = kernels, Limits(LIMIT, seconds)
        self.names = tuple(state.name for state in problem.states)
        self.bounds: Sequence[tuple[float, float]] = tuple(state.bounds for state in problem.states)
        self.is_whole = is_whole(problem)

    def move_to(self, kernels: Plant) -> AddedStates:
        """Return the same states of another mechanism."""
        return AddedStates(self._problem, kernels, self._limits.seconds)

    def carry(
        self,
        state: tuple[Array, Array, Array],
        force: Force,
        sample: float,
        times: Array,
        trial: Trial,
        begun: float | None = None,
        controls: Array | None = None,
    ) -> Array | str:
        """Return states (K, nq + n + ns) at the loop's times (K,), the last of which ends; or why there are none.

        `state` is (q, qd, s) at the time `begun`, by default the time `sample`.
        """
        begun = sample if begun is None else begun
        problem = self._follow(trial, sample)
        values = Values([state.rate for state in problem.states], problem, self._kernels)
        given, count = GivenValues(problem, self._kernels), len(self._kernels.manifest.actuated)
        held = np.zeros(0) if controls is None else controls
        acting = _Acting(force, held, given, count, sample, begun, problem.horizon, values)
        start, duration, taken = np.concatenate(state)[None], float(times[-1] - begun), list[Step]()
        try:
            end = integrate(self._kernels, start, acting, duration, Allowance(self._limits), taken=taken)
        except LimitError as error:
            return f"the added states have no end: {error.finding}"
        if end is None or not np.isfinite(end).all():
            return "the motion or a state of the problem has no rate on the way"
        fractions = (times[:-1] - begun) / duration
        steps = np.searchsorted([step.end for step in taken], fractions)
        first, read = np.zeros(1, dtype=np.int64), zip(steps.tolist(), fractions.tolist(), strict=True)
        return np.concatenate([*(taken[k].read(first, np.array([x])) for k, x in read), end])

    def complete(
        self, state: tuple[Array, Array, Array], inputs: Array, sample: float, times: Array, trial: Trial
    ) -> Array:
        """Return inputs (K, m + k) with the ones that expressions give, at K states and times of the loop."""
        problem, (q, qd, states) = self._follow(trial, sample), state
        given, m = GivenValues(problem, self._kernels), len(self._kernels.manifest.actuated)
        t = (times - sample)[:, None]
        parts = {"q": q, "qd": qd, "states": states, "u": inputs[:, :m], "controls": inputs[:, m:], "t": t}
        parts |= {"T": np.full_like(t, problem.horizon), "unknowns": np.zeros((len(t), 0))}
        parts["w"] = np.zeros((len(t), len(self._kernels.manifest.inputs) - m))
        return np.hstack((given(parts)["u"], inputs[:, m:]))

    def _follow(self, trial: Trial, sample: float) -> Problem:
        """Return the problem with its constants at a sample."""
        constants = trial.constants_at(sample)
        known = tuple((name, constants.get(name, value)) for name, value in self._problem.constants)
        return replace(self._problem, constants=known)
