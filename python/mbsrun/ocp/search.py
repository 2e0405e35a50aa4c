"""Solve a problem for a grid of targets, by one of two protocols that are never mixed.

The *paper* protocol is that of a comparison: for each representation one guess, the interpolation without inputs, no
restart; what fails or ends in a higher minimum is counted (Docquier, Bruls, Fisette, section 4.3).

The *robust* protocol does what it takes to solve every task in its best minimum:

    interpolation   each representation, from the interpolation with the inputs of its inverse dynamics
    bumps           the first representation, from interpolations with smooth random bumps, which break symmetries too;
                    more of them where input rates are free, which makes many minima
    neighbours      the first representation, from the best motion of each neighbouring target, until nothing is new
    exchange        each representation that is in a higher minimum, from the best motion of another

Every attempt is recorded with its effort; what is in the record is not tried again.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.ocp import schemes, solution
from mbsrun.ocp.guess import Pose, adapt, balance, bump, find_pose, interpolate
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Inputs, Point, Problem, Representation, cylindrical
from mbsrun.ocp.record import SAME, Attempt, Record, Task
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.trajectory import Trajectory

Protocol = Literal["paper", "robust"]
Place = tuple[int, int]
Weights = tuple[float, float]

BUMPS = 6  # for each target, where input rates are free
FEW_BUMPS = 2  # where they are not
ROUNDS = 5  # of neighbours and exchange, at most


@dataclass(frozen=True)
class Targets:
    """Places on a cylinder about the base's z axis: indices into azimuths and heights, and which are taken."""

    radius: float  # m
    azimuths: tuple[float, ...]  # rad
    heights: tuple[float, ...]  # m
    every: tuple[int, int] = (1, 1)  # how many indices on the next place is

    @property
    def places(self) -> tuple[Place, ...]:
        """List the places taken."""
        i, j = range(0, len(self.azimuths), self.every[0]), range(0, len(self.heights), self.every[1])
        return tuple((a, b) for a in i for b in j)

    def neighbours(self, place: Place) -> Iterator[Place]:
        """List the places next to one."""
        (i, j), (a, b), known = place, self.every, set(self.places)
        yield from (near for near in ((i - a, j), (i + a, j), (i, j - b), (i, j + b)) if near in known)

    def position(self, place: Place) -> Point:
        """Give the position of a place."""
        return cylindrical(self.radius, self.azimuths[place[0]], self.heights[place[1]])


@dataclass(frozen=True)
class Study:
    """What is to be solved: one problem for every target, cost and representation."""

    problem: Problem
    sensor: str
    targets: Targets
    costs: tuple[Weights, ...]
    representations: tuple[Representation, ...]
    bumped: tuple[int, ...]  # coordinates that bumps move


def identify(study: Study, manifest: Manifest) -> str:
    """Name what the attempts in a record have in common: grid and problem, but for target, weights, representation."""
    problem = replace(
        study.problem.with_target(study.sensor, (0.0, 0.0, 0.0)),
        cost=replace(study.problem.cost, inputs=0.0, input_rates=0.0),
        representation=Representation.IMPL,
    )
    targets = study.targets
    text = repr((manifest.model_hash, problem, targets.radius, targets.azimuths, targets.heights))
    return hashlib.sha256(text.encode()).hexdigest()


class OutOfTimeError(Exception):
    """Raised when the time that a search was given is over."""


Watch = Callable[[Attempt, bool], None]  # the attempt, and whether it is the best of its task so far


class Search:
    """Carries a study out."""

    def __init__(
        self, study: Study, plant: Plant, record: Record, watch: Watch | None = None, seconds: float = float("inf")
    ) -> None:
        """Begin; after `seconds` the next attempt raises OutOfTimeError."""
        self.study, self.plant, self.record, self.watch = study, plant, record, watch
        self.scheme = schemes.build(study.problem.family, study.problem.degree)
        self.end = time.monotonic() + seconds
        self._solvers: dict[Representation, Solver] = {}
        self._poses: dict[Place, Pose] = {}

    def run(self, protocol: Protocol) -> None:
        """Follow a protocol for every cost."""
        for weights in self.study.costs:
            if protocol == "paper":
                self._interpolate(weights, "paper", "zero")
            else:
                self._search(weights)

    def _search(self, weights: Weights) -> None:
        self._interpolate(weights, "interpolation", "dynamic")
        self._bump(weights, BUMPS if weights[1] == 0 else FEW_BUMPS)
        for _ in range(ROUNDS):
            self._visit_neighbours(weights)
            if not self._exchange(weights):
                return

    def _interpolate(self, weights: Weights, part: str, inputs: Inputs) -> None:
        for representation in self.study.representations:
            for place in self.study.targets.places:

                def guess(problem: Problem, place: Place = place) -> Trajectory | None:
                    return self._move(problem, place, inputs)

                self._attempt(place, weights, representation, part, inputs, guess)

    def _bump(self, weights: Weights, times: int) -> None:
        scout = self.study.representations[0]
        for place in self.study.targets.places:
            for k in range(times):

                def guess(problem: Problem, place: Place = place, k: int = k) -> Trajectory | None:
                    motion = self._move(problem, place, "zero")
                    if motion is None:
                        return None
                    rng = np.random.default_rng((*place, k))
                    return balance(bump(motion, self.study.bumped, rng), problem, self.plant, "dynamic")

                self._attempt(place, weights, scout, "bumps", str(k), guess)

    def _visit_neighbours(self, weights: Weights) -> None:
        """Start every target from its neighbours, again and again, until no neighbour has a motion not yet tried."""
        scout, targets = self.study.representations[0], self.study.targets
        is_new = True
        while is_new:
            is_new = False
            for place in targets.places:
                for near in targets.neighbours(place):
                    is_new |= self._start_from(Task(near, weights, scout.value), place, scout, "neighbours")

    def _exchange(self, weights: Weights) -> bool:
        """Start what is in a higher minimum from what is in the lowest; tell whether anything was tried."""
        is_new = False
        for place in self.study.targets.places:
            tasks = [Task(place, weights, r.value) for r in self.study.representations]
            costs = {task: cost for task in tasks if (cost := self.record.best_cost(task)) is not None}
            if not costs:
                continue
            lowest = min(costs, key=lambda task: costs[task])
            for representation, task in zip(self.study.representations, tasks, strict=True):
                if is_higher(costs.get(task), costs[lowest]):
                    is_new |= self._start_from(lowest, place, representation, "exchange")
        return is_new

    def _start_from(self, origin: Task, place: Place, representation: Representation, part: str) -> bool:
        """Start from the best motion of another task; tell whether that is new."""
        cost = self.record.best_cost(origin)
        if cost is None:
            return False
        name = f"{origin.place[0]},{origin.place[1]} {origin.representation} {cost:.9g}"

        def guess(problem: Problem) -> Trajectory | None:
            motion = self.record.best_motion(origin)
            return None if motion is None else adapt(motion, problem, self.scheme)

        return self._attempt(place, origin.weights, representation, part, name, guess)

    def _move(self, problem: Problem, place: Place, inputs: Inputs) -> Trajectory | None:
        if place not in self._poses:
            self._poses[place] = find_pose(problem, self.plant)
        pose = self._poses[place]
        if not pose.is_reached:
            return None
        return balance(interpolate(problem, self.scheme, pose.q), problem, self.plant, inputs)

    def _attempt(
        self,
        place: Place,
        weights: Weights,
        representation: Representation,
        part: str,
        name: str,
        guess: Callable[[Problem], Trajectory | None],
    ) -> bool:
        """Solve, unless that was tried; tell whether it was not."""
        task = Task(place, weights, representation.value)
        if self.record.find(task, part, name):
            return False
        if time.monotonic() > self.end:
            raise OutOfTimeError
        problem = replace(
            self.study.problem.with_target(self.study.sensor, self.study.targets.position(place)),
            cost=replace(self.study.problem.cost, inputs=weights[0], input_rates=weights[1]),
            representation=representation,
        )
        motion = guess(problem)
        if motion is None:
            self._keep(Attempt(task, part, name, solution.UNREACHABLE, 0, 0.0, 0.0, None), None)
            return True
        if representation not in self._solvers:
            self._solvers[representation] = Solver(problem, self.plant)
        outcome = self._solvers[representation].solve(problem, motion)
        run = outcome.run
        solved = outcome if isinstance(outcome, Solution) and not outcome.is_only_acceptable else None
        effort = (run.status, run.iterations, run.cpu_seconds, run.cpu_seconds_evaluating)
        cost = None if solved is None else solved.cost.total
        self._keep(Attempt(task, part, name, *effort, cost), None if solved is None else solved.trajectory)
        return True

    def _keep(self, attempt: Attempt, motion: Trajectory | None) -> None:
        is_best = self.record.add(attempt, motion)
        if self.watch is not None:
            self.watch(attempt, is_best)


# --- what came of it -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Summary:
    """What a part of a protocol did for one cost and one representation."""

    weights: Weights
    representation: str
    part: str
    attempts: int
    solved: int
    higher: int  # solved, but in a higher minimum than the best that any attempt found
    iterations: tuple[float, float, float]  # of what was solved: the least, the median, the most
    cpu_seconds: float  # of all attempts
    cpu_median: float  # of what was solved


def is_higher(cost: float | None, lowest: float) -> bool:
    """Tell whether a cost is missing, or above the lowest by more than rounding."""
    return cost is None or cost > lowest + SAME * abs(lowest)


def list_open_tasks(study: Study, attempts: Sequence[Attempt]) -> list[Task]:
    """List the tasks of a study that are not solved, or in a higher minimum than another representation or guess."""
    lowest, best = find_lowest(attempts), dict[Task, float]()
    for attempt in attempts:
        if attempt.cost is not None:
            best[attempt.task] = min(attempt.cost, best.get(attempt.task, attempt.cost))
    tasks = [
        Task(place, weights, representation.value)
        for weights in study.costs
        for representation in study.representations
        for place in study.targets.places
    ]
    return [task for task in tasks if task not in best or is_higher(best[task], lowest[task.place, task.weights])]


def find_lowest(attempts: Sequence[Attempt]) -> dict[tuple[Place, Weights], float]:
    """Give the lowest cost that any attempt, in any representation, found for each target and cost."""
    lowest: dict[tuple[Place, Weights], float] = {}
    for attempt in attempts:
        key = (attempt.task.place, attempt.task.weights)
        if attempt.cost is not None:
            lowest[key] = min(attempt.cost, lowest.get(key, attempt.cost))
    return lowest


def summarise(attempts: Sequence[Attempt]) -> list[Summary]:
    """Sum up every part; the part "result" tells what all of the robust protocol's together reached."""
    lowest = find_lowest(attempts)
    groups: dict[tuple[Weights, str, str], list[Attempt]] = {}
    results: dict[tuple[Weights, str, str], dict[Place, Attempt]] = {}
    for attempt in attempts:
        task = attempt.task
        groups.setdefault((task.weights, task.representation, attempt.part), []).append(attempt)
        if attempt.part != "paper":
            best = results.setdefault((task.weights, task.representation, "result"), {})
            held = best.get(task.place)
            if held is None or (attempt.cost is not None and (held.cost is None or attempt.cost < held.cost)):
                best[task.place] = attempt
    groups |= {key: list(best.values()) for key, best in results.items()}
    return [_sum_up(*key, group, lowest) for key, group in groups.items()]


def _sum_up(
    weights: Weights,
    representation: str,
    part: str,
    group: Sequence[Attempt],
    lowest: dict[tuple[Place, Weights], float],
) -> Summary:
    solved = [attempt for attempt in group if attempt.cost is not None]
    iterations = [attempt.iterations for attempt in solved] or [0]
    return Summary(
        weights=weights,
        representation=representation,
        part=part,
        attempts=len(group),
        solved=len(solved),
        higher=sum(is_higher(a.cost, lowest[a.task.place, a.task.weights]) for a in solved),
        iterations=(float(min(iterations)), float(np.median(iterations)), float(max(iterations))),
        cpu_seconds=sum(attempt.cpu_seconds for attempt in group),
        cpu_median=float(np.median([attempt.cpu_seconds for attempt in solved] or [0.0])),
    )
