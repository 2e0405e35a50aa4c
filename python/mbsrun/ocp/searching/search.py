"""Carry out the trials of a study: executors make attempts, a record keeps them, and a protocol goes on in rounds."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from mbsgen.errors import MbsError
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.searching.study import Study
from mbsrun.ocp.searching.trials import Found, Hop, ProtocolName, Trial, plan_round, restate
from mbsrun.ocp.solution.record import SAME, Attempt, Key, Record, Task


@dataclass(frozen=True, eq=False)
class Job:
    """A trial, with the motion that it starts from where that is one that was found."""

    study: Study
    trial: Trial
    motion: Trajectory | None


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of a trial."""

    attempt: Attempt
    motion: Trajectory | None
    environment: str  # versions, machine, hash of the generated code and options of the solver, as JSON


class Executor(Protocol):
    """Makes attempts: in this process, or in many."""

    def carry_out(self, orders: Iterable[Job]) -> Iterator[Outcome]:
        """Carry out orders, and yield their outcomes as they come; take no order long before its turn."""


LOST = "Start_Not_Reproduced"  # the status of an attempt from a motion that was not restored and cannot be found again


class OutOfTimeError(Exception):
    """Raised when the time that a search was given is over."""


class LostMotionError(MbsError):
    """Raised where the attempt that found a motion ends elsewhere when it is made again."""


Watch = Callable[[Attempt, bool], None]  # the attempt, and whether it is the best of its task so far


class Search:
    """Carries a study out; this process alone writes to the record."""

    def __init__(
        self,
        study: Study,
        executor: Executor,
        record: Record,
        watch: Watch | None = None,
        seconds: float = float("inf"),
    ) -> None:
        """Begin; after `seconds` no further attempt begins, and OutOfTimeError is raised when those under way end."""
        self.study, self.executor, self.record, self.watch = study, executor, record, watch
        self.end = time.monotonic() + seconds
        self._lost: dict[tuple[Key, str], str] = {}  # by attempt and turns: why its motion is not found again

    def run(self, protocol: ProtocolName, plan: Callable[[int, int], None] | None = None) -> None:
        """Follow a protocol; call `plan` for every round, with its number of trials and the number of those done."""
        for number in itertools.count():
            before = {attempt.key for attempt in self.record.attempts() if attempt.round < number}
            best, turned = self.record.best(protocol, number), self.record.best_turned(protocol, number)
            trials = plan_round(self.study, protocol, number, best, before, turned)
            if not trials:
                return
            self.try_all(trials, plan)

    def try_all(self, trials: Sequence[Trial], plan: Callable[[int, int], None] | None = None) -> None:
        """Make the attempts that are not in the record."""
        left = [trial for trial in trials if not self.record.find(trial.key)]
        if plan is not None:
            plan(len(trials), len(trials) - len(left))
        for outcome in self.executor.carry_out(self._order(left)):
            is_best = self.record.add(outcome.attempt, outcome.motion, outcome.environment)
            if self.watch is not None:
                self.watch(outcome.attempt, is_best)
        if not all(self.record.find(trial.key) for trial in left):
            raise OutOfTimeError

    def _order(self, trials: Sequence[Trial]) -> Iterator[Job]:
        """List the jobs of trials while there is time."""
        for trial in trials:
            if time.monotonic() > self.end:
                return
            try:
                yield self._prepare(trial)
            except LostMotionError:
                self.record.add(_give_up(trial), None)

    def _prepare(self, trial: Trial) -> Job:
        """Return the job of a trial, with the motion that it starts from."""
        start, motion = trial.start, None
        if isinstance(start, Found):
            motion = self.find_motion(start.origin, trial.protocol, trial.round)
        elif isinstance(start, Hop):
            motion = self.find_motion(start.origin, trial.protocol, trial.round, start.turns)
        return Job(self.study, trial, motion)

    def find_motion(self, task: Task, protocol: str, before: int | None = None, turns: str = "") -> Trajectory | None:
        """Return the motion of the best of a task; solve again for a motion that was not restored.

        Raises LostMotionError where that ends elsewhere, as it may after a change of the solver.
        """
        found = self.record.best_motion(task, protocol, before, turns)
        attempt = self.record.best_attempt(task, protocol, before, turns) if found is None else None
        if attempt is None or attempt.cost is None:
            return found
        if (attempt.key, turns) in self._lost:
            raise LostMotionError(self._lost[attempt.key, turns])
        try:
            (outcome,) = self.executor.carry_out([self._prepare(restate(self.study, attempt))])
            again, motion = outcome.attempt, outcome.motion
            if motion is None or again.cost is None or abs(again.cost - attempt.cost) > SAME * abs(attempt.cost):
                raise LostMotionError(
                    f"target {task.place[0]},{task.place[1]} in {task.representation}: {attempt.part} {attempt.guess} "
                    f"ends in {again.cost or again.status} here, and ended in {attempt.cost} in the attempt that was "
                    "restored; begin a new record without restored attempts"
                )
        except LostMotionError as error:
            self._lost[attempt.key, turns] = str(error)
            raise
        self.record.put_motion(attempt, motion)
        return motion


def _give_up(trial: Trial) -> Attempt:
    """Return the attempt of a trial that cannot start, so that it counts as tried."""
    return Attempt(trial.task, trial.protocol, trial.part, trial.guess, trial.round, LOST, 0, 0.0, 0.0, None)


@dataclass(frozen=True)
class Progress:
    """The progress of a protocol."""

    round: int
    trials: int  # of that round
    done: int
    is_through: bool  # nothing is left to try


def find_progress(study: Study, record: Record, protocol: ProtocolName = "robust") -> Progress:
    """Find the first round of which something is left to try; where nothing is, the last."""
    attempts = list(record.attempts())
    done = {attempt.key for attempt in attempts}
    last = Progress(0, 0, 0, is_through=True)
    for number in itertools.count():
        before = {attempt.key for attempt in attempts if attempt.round < number}
        best, turned = record.best(protocol, number), record.best_turned(protocol, number)
        trials = plan_round(study, protocol, number, best, before, turned)
        if not trials:
            return last
        last = Progress(number, len(trials), sum(trial.key in done for trial in trials), is_through=True)
        if last.done < last.trials:
            return replace(last, is_through=False)
    raise AssertionError("rounds end")
