"""A controller in C, written by `mbsrun controller`: solves to a tolerance, or steps of Newton's method in real time.

In real time a sample makes a fixed number of steps: `prepare` moves the plan ahead and does all the work that needs no
measurement, `feedback` makes the step for the measured state. See csrc/stages/mbs_stages.h. Steps have no line search,
so a step can go wrong. A sample whose plan has diverged, or violates its constraints too much, solves instead.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import FILE_NAME
from mbsrun.controllers.fields import BEFORE, GIVEN, START_STATES
from mbsrun.controllers.folder import Data, Manifest
from mbsrun.controllers.loading import Controller, Step
from mbsrun.controllers.writing import BARRIER
from mbsrun.ocp.ground.trajectory import average_inputs
from mbsrun.ocp.problem.problem import Problem
from mbsrun.tracking.added import list_chosen
from mbsrun.tracking.controller import Decision

Array = NDArray[np.float64]

ROUNDED = 1e-6  # of a number of periods in an interval
PREPARED, STEPPED = "prepared", "stepped"


@dataclass(frozen=True)
class Stepping:
    """Control in real time: `steps` of Newton's method in a sample.

    They solve for a barrier parameter of `barrier` beside the cost of the controller's own optimum. A larger one is
    steadier, and less exact. A sample solves where its plan has diverged, or its violation is larger than `rescue`.
    """

    steps: int
    barrier: float = BARRIER
    rescue: float = math.inf


class MisfitError(MbsError):
    """A controller that does not fit a problem or a rate."""


class CompiledController:
    """Calls a controller's C: `stepping` in real time, or None for solves to the tolerance."""

    def __init__(
        self, controller: Controller, problem: Problem, period: float, stepping: Stepping | None = None
    ) -> None:
        """Take a loaded controller. Raises MisfitError where it is another problem's, or the rate does not fit."""
        manifest = controller.manifest
        misfits = list_misfits(manifest, problem)
        if misfits:
            remedy = "write it again for this problem by `mbsrun controller`"
            raise MisfitError(f"{controller.folder / FILE_NAME}: {'; '.join(misfits)}; {remedy}")
        self._interval = controller.period
        misfit = find_wrong_rate(self._interval, period, remembers=remembers(manifest))
        if misfit is not None:
            raise MisfitError(f"{controller.folder / FILE_NAME}: {'; '.join(misfit)}")
        self._controller, self._period, self._stepping = controller, period, stepping
        if stepping is not None and manifest.cost != 0:  # the first plan then is one that steps go on from
            controller.options.mu_target = stepping.barrier * manifest.scale * abs(manifest.cost)
        self._constants = _place_constants(manifest.data)
        self._chosen, self._inputs = list_chosen(problem), len(problem.bounds.u) + len(problem.controls)
        self._held = count_held(manifest, problem)
        self._begun, self._time = 0.0, 0.0  # of the plan, and of the sample
        self._has_plan = False
        self._violation = 0.0
        self._states: Array = np.zeros(0)
        self._velocities = _list_velocities(manifest, problem)
        self._is_lost = False  # the plan has diverged, or has no step

    def prepare(self, time: float, constants: Mapping[str, float]) -> None:
        """Move the plan ahead by the intervals that have passed; linearise, where the sample only makes steps."""
        for name, value in constants.items():
            self._controller.data["constants"][self._constants[name]] = value
        self._time = time
        if not self._has_plan:
            return
        passed = math.floor((time - self._begun) / self._interval + ROUNDED)
        for _ in range(passed):
            self._take(self._controller.prepare(shift=True))
        self._begun += passed * self._interval
        if not passed and self._stepping is not None:
            self._take(self._controller.prepare())

    def measure(self, states: Array) -> None:
        """Take the states that the problem adds."""
        self._states = states

    def note(self, time: float, inputs: Array) -> None:
        """Write down the inputs that are given now, on which the next plan follows; it has later ones itself."""
        if GIVEN in self._controller.data and abs(time - self._begun) < self._interval / 2:
            self._controller.data[GIVEN][:] = inputs[self._chosen]

    def feedback(self, q: Array, qd: Array) -> Decision:
        """Solve, or make steps, from a state. The first plan is solved for in any case."""
        before, stepping = clock.process_time(), self._stepping
        if stepping is None or not self._has_plan:
            return self._solve(q, qd, before)
        state = np.concatenate((q, qd[self._velocities], self._states, np.zeros(self._held)))
        if self._is_lost or not self._violation <= stepping.rescue:
            return self._rescue(state, before)
        inputs, step = self._controller.feedback(state)
        for _ in range(stepping.steps - 1):
            if step.status == STEPPED:
                self._take(self._controller.prepare())
                if self._is_lost:
                    return self._rescue(state, before)
                inputs, step = self._controller.feedback(state)
        seconds = clock.process_time() - before
        is_solved = step.status == STEPPED
        return Decision(
            self._expand(inputs) if is_solved else self.planned(self._time), step.status, is_solved, stepping.steps,
            seconds, step.violation,
        )  # fmt: skip

    def planned(self, time: float) -> Array:
        """Return the plan's mean inputs over the period from a time on; the ones that act late are given earlier."""
        plan, elapsed = self._controller.plan(), time - self._begun
        times, t = np.array([elapsed, elapsed + self._period]), plan.times - plan.times[0]
        found = np.asarray(average_inputs(t, plan.inputs, times)[0])
        for i, delay in enumerate(self._controller.manifest.delays):
            found[i] = average_inputs(t, plan.inputs, times + delay * self._interval)[0, i]
        return self._expand(found)

    def _expand(self, chosen: Array) -> Array:
        """Return inputs and controls of which a controller gives the chosen ones."""
        every = np.zeros(self._inputs)
        every[self._chosen] = chosen
        return every

    def _take(self, step: Step) -> None:
        self._violation, self._is_lost = step.violation, step.status != PREPARED

    def _rescue(self, state: Array, before: float) -> Decision:
        """Solve anew where steps went wrong."""
        inputs, result = self._controller.rescue(state)
        seconds = clock.process_time() - before
        self._is_lost = not result.is_solved
        inputs = self._expand(inputs) if result.is_solved else self.planned(self._time)
        return Decision(inputs, result.status, result.is_solved, result.iterations, seconds, self._violation, True)

    def _solve(self, q: Array, qd: Array, before: float) -> Decision:
        data = self._controller.data
        data["start_q"][:], data["start_qd"][:] = q, qd[self._velocities]
        if START_STATES in data:
            data[START_STATES][: self._states.size] = self._states
        result = self._controller.solve(warm=self._has_plan)
        seconds = clock.process_time() - before
        self._has_plan = self._has_plan or result.is_solved
        inputs = self.planned(self._time)
        return Decision(inputs, result.status, result.is_solved, result.iterations, seconds, result.violation)


def list_misfits(manifest: Manifest, problem: Problem, constants: Iterable[str] = ()) -> list[str]:
    """List the ways in which a controller is not one of a problem; `constants` of it change in the loop."""
    found = []
    sizes = len(manifest.states), len(manifest.inputs), manifest.intervals
    measured = len(problem.start_q) + len(_list_velocities(manifest, problem)) + len(problem.states)
    expected = measured + count_held(manifest, problem), len(list_chosen(problem)), problem.intervals
    if sizes != expected:
        words = "states, inputs and intervals"
        found.append(f"{manifest.prefix} is of another problem: {_list(sizes)} {words}, and not {_list(expected)}")
    if manifest.horizon is None:
        found.append(f"{manifest.prefix} chooses its horizon, and a loop needs intervals of a fixed length")
    known = _place_constants(manifest.data)
    found += [
        f"{manifest.prefix} has no constant {name}, which the loop updates" for name in constants if name not in known
    ]
    return found


def count_held(manifest: Manifest, problem: Problem) -> int:
    """Count the last states of a controller that are unknown numbers of its problem: nothing measures them."""
    unknown = {x.name for x in problem.unknowns}
    return sum(state.name in unknown for state in manifest.states)


def _list_velocities(manifest: Manifest, problem: Problem) -> list[int]:
    """Number the velocities that a controller reads: all, or with closed loops the independent ones."""
    names, wanted = (
        [entry.name for data in manifest.data if data.name == name for entry in data.entries]
        for name in ("start_q", "start_qd")
    )
    every = len(problem.start_qd)
    is_part = len(wanted) < every == len(names) and set(wanted) <= set(names)
    return [names.index(name) for name in wanted] if is_part else [*range(every)]


def _list(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers))


def remembers(manifest: Manifest) -> bool:
    """Return whether a controller remembers inputs, period by period."""
    return any(field.name == BEFORE for field in manifest.data)


def find_wrong_rate(interval: float, period: float, *, remembers: bool = False) -> tuple[str, str] | None:
    """Return finding and remedy for a period that is no part of an interval of the plan, or not all of it."""
    count = interval / period
    if remembers and abs(count - 1) > ROUNDED:
        finding = f"the controller remembers inputs by intervals of {interval:g} s, and a period has {period:g} s"
        return finding, f"give a rate of {1 / interval:g} Hz"
    if abs(count - round(count)) <= ROUNDED * count:
        return None
    finding = f"the controller's intervals of {interval:g} s are no multiple of the period of {period:g} s"
    return finding, f"give a rate of {1 / interval:g} Hz, or a multiple"


def _place_constants(data: tuple[Data, ...]) -> Mapping[str, int]:
    """Return the place of each constant of the problem's expressions."""
    return {entry.name: i for field in data if field.name == "constants" for i, entry in enumerate(field.entries)}
