"""Solve a problem for a grid of targets, by one of two protocols that are never mixed.

The *paper* protocol compares: for each representation one guess, the interpolation without inputs, no
restart; failures and higher minima are counted (Docquier, Bruls, Fisette, section 4.3).

The *robust* protocol looks for the lowest minimum of every task. It cannot show that no minimum is lower; so
`count_finds` counts how many independent starts found the lowest:

    interpolation   each representation, from the interpolation with the inputs of its inverse dynamics
    bumps, noise, waves, branches, turns
                    the first representation, from the random starts of `starts`: independent of each other; more of
                    them where input rates are free, which makes many minima; quaternions take no bumps and no waves
    neighbours      the first representation, from the best motion of each neighbouring target, until nothing is new
    hops            the first representation, from its best motions, without whole turns and with, plus random waves;
                    until none of them leads to a lower minimum
    exchange        each representation that is in a higher minimum, from the best motion of another, staying near it

Motions in which joints without limits make whole turns are compared among themselves: rounds start from motions without
turns, and a minimum is higher or lowest among these. `list_turned` sums up the others.

A protocol goes on in rounds. The trials of a round depend on the results of earlier rounds alone: any process can make
them, at once and in any order, and a search that was interrupted ends with the same result. Every attempt is recorded
with its effort; an attempt in the record is not repeated.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, Protocol

import numpy as np
from pydantic import TypeAdapter

from mbsgen.manifest import Manifest
from mbsrun.ocp.linear import MUMPS
from mbsrun.ocp.problem import Inputs, Point, Problem, Representation, cylindrical
from mbsrun.ocp.record import SAME, Attempt, Best, Key, Record, Task
from mbsrun.ocp.starts import TURNS, Kind, Variation, describe_turns
from mbsrun.ocp.trajectory import Trajectory

ProtocolName = Literal["paper", "robust"]
MULTISTART = "starts"  # the protocol of a single problem from many starts: see `multistart`
Place = tuple[int, int]
Weights = tuple[float, float]

# Starts of the robust protocol for each target: where input rates are free of charge, which makes many minima, and
# where they are not. Of turns: for each joint and number of turns.
COUNTS: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"bumps": (6, 2), "noise": (6, 2), "waves": (8, 3), "branches": (2, 1), "turns": (2, 1)}
)
HOPS = (6, 2)  # likewise, of hops from a motion
INDEPENDENT = ("interpolation", "bumps", "noise", "waves", "branches")  # parts whose starts do not depend on each other
ROUNDS = 100  # at most


@dataclass(frozen=True)
class Targets:
    """Places on a cylinder about the base's z axis: indices into azimuths and heights, and which are taken."""

    radius: float  # m
    azimuths: tuple[float, ...]  # rad
    heights: tuple[float, ...]  # m
    every: tuple[int, int] = (1, 1)  # steps between the indices of places

    @property
    def places(self) -> tuple[Place, ...]:
        """List the places taken."""
        i, j = range(0, len(self.azimuths), self.every[0]), range(0, len(self.heights), self.every[1])
        return tuple((a, b) for a in i for b in j)

    def neighbours(self, place: Place) -> Iterator[Place]:
        """List the places next to one."""
        (i, j), (a, b), known = place, self.every, set(self.places)
        yield from (near for near in ((i - a, j), (i + a, j), (i, j - b), (i, j + b)) if near in known)

    @property
    def spread(self) -> tuple[Place, ...]:
        """List the places by ever finer grids: the beginning of the list covers the whole cylinder."""

        def fineness(place: Place) -> int:
            ranks = (k // step for k, step in zip(place, self.every, strict=True))
            return max(-(rank & -rank) if rank else -sys.maxsize for rank in ranks)

        return tuple(sorted(self.places, key=lambda place: (fineness(place), place)))

    def position(self, place: Place) -> Point:
        """Return the position of a place."""
        return cylindrical(self.radius, self.azimuths[place[0]], self.heights[place[1]])


ONE = Targets(0.0, (0.0,), (0.0,))  # one place, which stands for the problem's own target


@dataclass(frozen=True)
class Study:
    """The tasks of a search: one problem for every target, cost and representation."""

    problem: Problem
    sensor: str | None  # that has the targets; None: the problem itself, at the one place of `ONE`
    targets: Targets
    costs: tuple[Weights, ...]
    representations: tuple[Representation, ...]
    bumped: tuple[int, ...]  # coordinates that bumps move
    turning: tuple[int, ...] = ()  # entries of q to which the robust protocol adds whole turns
    linear_solver: str = MUMPS  # of IPOPT, for all protocols except the robust one, which takes the fastest

    def state(self, task: Task) -> Problem:
        """State the problem of a task."""
        problem = self.problem
        if self.sensor is not None:
            problem = problem.with_target(self.sensor, self.targets.position(task.place))
        cost = replace(problem.cost, inputs=task.weights[0], input_rates=task.weights[1])
        return replace(problem, cost=cost, representation=Representation(task.representation))


def identify(study: Study, manifest: Manifest) -> str:
    """Return the name of a study in a record: a hash of mechanism, grid and problem, without the parts that tasks set.

    Defaults and generated code are left out: other versions of this program give the same study the same name.
    """
    question = {"mechanism": manifest.mechanism or manifest.model_hash, **_tell_question(study, exclude_defaults=True)}
    return hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()


def describe(study: Study, manifest: Manifest) -> str:
    """Describe a study for a reader, as JSON: model, grid, and the problem with its options."""
    told = {"model": manifest.model, "mechanism": manifest.mechanism, "sensor": study.sensor, **_tell_question(study)}
    return json.dumps(told, ensure_ascii=False)


def _tell_question(study: Study, *, exclude_defaults: bool = False) -> dict[str, object]:
    targets = study.targets
    problem = TypeAdapter(Problem).dump_python(_strip(study), mode="json", exclude_defaults=exclude_defaults)
    return {"radius": targets.radius, "azimuths": targets.azimuths, "heights": targets.heights, "problem": problem}


def _strip(study: Study) -> Problem:
    """Return the problem without the parts that differ between tasks."""
    problem = replace(study.problem, refine=None)  # starts are solved on the grid as it is
    if study.sensor is not None:
        problem = problem.with_target(study.sensor, (0.0, 0.0, 0.0))
    return replace(problem, cost=replace(problem.cost, inputs=0.0, input_rates=0.0), representation=Representation.IMPL)


# --- trials --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Interpolation:
    """Start from the motion that the problem's guess describes, with these inputs."""

    inputs: Inputs


@dataclass(frozen=True)
class Varied:
    """Start from a random motion; where it is not smooth and the mesh is fine, solve on a coarse mesh first."""

    variation: Variation


@dataclass(frozen=True)
class Hop:
    """Start from the best motion of a task with some whole turns, plus random waves."""

    origin: Task
    turns: str
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Found:
    """Start from the best motion of a task that the protocol found in earlier rounds."""

    origin: Task
    is_held: bool = False  # stay near: the motion is an optimum of this task too


Start = Interpolation | Varied | Found | Hop


@dataclass(frozen=True)
class Trial:
    """An attempt to make."""

    task: Task
    protocol: str
    part: str
    guess: str  # names the start
    start: Start
    round: int = 0
    is_checked: bool = False  # by re-simulation

    @property
    def key(self) -> Key:
        """Return the key of the attempt in the record."""
        return (*self.task.row, self.protocol, self.part, self.guess)


def plan_round(
    study: Study,
    protocol: ProtocolName,
    number: int,
    best: Mapping[Task, Best],
    tried: Collection[Key],
    turned: Mapping[Task, Best] = MappingProxyType({}),
) -> list[Trial]:
    """List the trials of a round of a protocol; there is none after the last round.

    `best` and `turned` are the results of earlier rounds, without whole turns and with; `tried` are the keys of their
    attempts.
    """
    if protocol == "paper":
        return list_interpolations(study, "paper", "paper", "zero") if number == 0 else []
    if number == 0:
        return list_interpolations(study, "robust", "interpolation", "dynamic") + _list_variations(study)
    if number >= ROUNDS:
        return []
    moves = itertools.chain(_list_neighbours(study, best, number), _list_hops(study, best, turned, number))
    near = [trial for trial in moves if trial.key not in tried]
    return near or [trial for trial in _list_exchanges(study, best, number) if trial.key not in tried]


def list_interpolations(study: Study, protocol: str, part: str, inputs: Inputs) -> list[Trial]:
    """Start every task of a study from the interpolation with some inputs; representations of a task are adjacent."""
    return [
        Trial(Task(place, weights, representation.value), protocol, part, inputs, Interpolation(inputs))
        for weights in study.costs
        for place in study.targets.spread
        for representation in study.representations
    ]


def _list_variations(study: Study) -> list[Trial]:
    scout = study.representations[0].value
    return [
        Trial(Task(place, weights, scout), "robust", variation.kind, name, Varied(variation))
        for weights in study.costs
        for place in study.targets.spread
        for name, variation in _vary_all(study, place, is_rough=weights[1] == 0)
    ]


def _vary_all(study: Study, place: Place, *, is_rough: bool) -> Iterator[tuple[str, Variation]]:
    """Name the variations of a target; each part numbers its own."""
    counts = {part: few_or_many[0 if is_rough else 1] for part, few_or_many in COUNTS.items()}
    kinds: tuple[Kind, ...] = ("noise", "branches")
    if not study.problem.has_quaternions:  # whose velocities a bump would have to be found for
        yield from ((str(k), Variation("bumps", (*place, k))) for k in range(counts["bumps"]))
        kinds = (*kinds, "waves")
    for code, kind in enumerate(kinds):
        yield from ((str(k), Variation(kind, (*place, k, code))) for k in range(counts[kind]))
    for i in study.turning:
        for turns in TURNS:
            for k in range(counts["turns"]):
                seed = (*place, k, len(COUNTS), i, turns % 2**32)
                yield f"{i} {turns:+d} {k}", Variation("turns", seed, (i, turns))


def _list_neighbours(study: Study, best: Mapping[Task, Best], number: int) -> Iterator[Trial]:
    """Start every target from its neighbours."""
    scout = study.representations[0].value
    for weights in study.costs:
        for place in study.targets.spread:
            for near in study.targets.neighbours(place):
                origin = Task(near, weights, scout)
                if origin in best:
                    yield _start_from(origin, best[origin], Task(place, weights, scout), "neighbours", number)


def _list_hops(study: Study, best: Mapping[Task, Best], turned: Mapping[Task, Best], number: int) -> Iterator[Trial]:
    """Start every target from waves on its best motions."""
    if study.problem.has_quaternions:
        return
    scout = study.representations[0].value
    for weights in study.costs:
        for place in study.targets.spread:
            task, count = Task(place, weights, scout), HOPS[0 if weights[1] == 0 else 1]
            for found in (best.get(task), turned.get(task)):
                if found is not None:
                    yield from list_hops(task, found, number, place, "robust", count)


def list_hops(task: Task, best: Best, number: int, seed: tuple[int, ...], protocol: str, count: int) -> Iterator[Trial]:
    """List hops from the best motion of a task; a lower one has others."""
    for k in range(count):
        name = f"{best.turns or '-'} {best.cost:.9g} {' '.join(map(str, seed))} {k}"
        start = Hop(task, best.turns, (*seed, number, k))
        yield Trial(task, protocol, "hops", name, start, number)


def _list_exchanges(study: Study, best: Mapping[Task, Best], number: int) -> Iterator[Trial]:
    """Start tasks in a higher minimum from the lowest minimum of their target."""
    for weights in study.costs:
        for place in study.targets.spread:
            tasks = [Task(place, weights, r.value) for r in study.representations]
            costs = {task: best[task].cost for task in tasks if task in best}
            if costs:
                lowest = min(costs, key=lambda task: costs[task])
                for task in tasks:
                    if is_higher(costs.get(task), costs[lowest]):
                        yield _start_from(lowest, best[lowest], task, "exchange", number)


def _start_from(origin: Task, best: Best, task: Task, part: str, number: int) -> Trial:
    name = f"{origin.place[0]},{origin.place[1]} {origin.representation} {best.cost:.9g}"
    return Trial(task, "robust", part, name, Found(origin, is_held=part == "exchange"), number)


# --- trying it -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Order:
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

    def carry_out(self, orders: Iterable[Order]) -> Iterator[Outcome]:
        """Carry out orders, and yield their outcomes as they come; take no order long before its turn."""


class OutOfTimeError(Exception):
    """Raised when the time that a search was given is over."""


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

    def _order(self, trials: Sequence[Trial]) -> Iterator[Order]:
        """Order trials while there is time."""
        for trial in trials:
            if time.monotonic() > self.end:
                return
            start = trial.start
            motion = None
            if isinstance(start, Found):
                motion = self.record.best_motion(start.origin, trial.protocol, trial.round)
            elif isinstance(start, Hop):
                motion = self.record.best_motion(start.origin, trial.protocol, trial.round, start.turns)
            yield Order(self.study, trial, motion)


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


# --- what came of it -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Summary:
    """The summary of a part of a protocol, for one cost and one representation."""

    weights: Weights
    representation: str
    part: str
    attempts: int
    solved: int
    higher: int  # solved, but in a higher minimum than the best that any attempt found
    iterations: tuple[float, float, float]  # of solved attempts: the least, the median, the most
    cpu_seconds: float  # of all attempts
    cpu_median: float  # of solved attempts


def is_higher(cost: float | None, lowest: float) -> bool:
    """Return whether a cost is missing, or above the lowest by more than rounding."""
    return cost is None or cost > lowest + SAME * abs(lowest)


def list_open_tasks(study: Study, attempts: Sequence[Attempt]) -> list[Task]:
    """List the tasks of a study that are not solved, or in a higher minimum than another representation or guess."""
    lowest, best = find_lowest(attempts), dict[Task, float]()
    for attempt in attempts:
        if attempt.cost is not None and not attempt.turns:
            best[attempt.task] = min(attempt.cost, best.get(attempt.task, attempt.cost))
    tasks = [
        Task(place, weights, representation.value)
        for weights in study.costs
        for representation in study.representations
        for place in study.targets.places
    ]
    return [task for task in tasks if task not in best or is_higher(best[task], lowest[task.place, task.weights])]


def find_lowest(attempts: Sequence[Attempt]) -> dict[tuple[Place, Weights], float]:
    """Return the lowest cost without whole turns of each target and cost, of all attempts and representations.

    Where all that was found makes whole turns, it is the lowest of that.
    """
    lowest: dict[tuple[Place, Weights], float] = {}
    turned: dict[tuple[Place, Weights], float] = {}
    for attempt in attempts:
        key, held = (attempt.task.place, attempt.task.weights), turned if attempt.turns else lowest
        if attempt.cost is not None:
            held[key] = min(attempt.cost, held.get(key, attempt.cost))
    return turned | lowest


@dataclass(frozen=True)
class Finds:
    """The number of independent starts that found the lowest cost of a target."""

    place: Place
    weights: Weights
    lowest: float
    found: int
    starts: int


def count_finds(attempts: Sequence[Attempt]) -> list[Finds]:
    """Count the independent starts of the robust protocol, and the starts that found the lowest, by target and cost."""
    starts: dict[tuple[Place, Weights], list[Attempt]] = {}
    for attempt in attempts:
        if attempt.protocol == "robust" and attempt.part in INDEPENDENT:
            starts.setdefault((attempt.task.place, attempt.task.weights), []).append(attempt)
    return [
        Finds(*key, low, sum(not is_higher(a.cost, low) and not a.turns for a in starts[key]), len(starts[key]))
        for key, low in find_lowest(attempts).items()
        if key in starts
    ]


@dataclass(frozen=True)
class Turned:
    """The lowest cost of a target with some whole turns, beside the lowest without."""

    place: Place
    weights: Weights
    turns: str
    cost: float
    lowest: float | None  # without; None: no attempt found any


def list_turned(attempts: Sequence[Attempt]) -> list[Turned]:
    """List the lowest costs of every target and cost with whole turns, by turns."""
    lowest = find_lowest([attempt for attempt in attempts if not attempt.turns])
    found: dict[tuple[Place, Weights, str], float] = {}
    for a in attempts:
        if a.cost is not None and a.turns:
            key = (a.task.place, a.task.weights, a.turns)
            found[key] = min(a.cost, found.get(key, a.cost))
    return [Turned(*key, cost, lowest.get(key[:2])) for key, cost in sorted(found.items())]


def describe_search(attempts: Sequence[Attempt]) -> list[str]:
    """Describe, for each cost, how often the lowest costs known were found, and the results with whole turns."""
    lines, finds, turned = [], count_finds(attempts), list_turned(attempts)
    for weights in dict.fromkeys(find.weights for find in finds):
        own = [find for find in finds if find.weights == weights]
        shares, never = sorted(find.found for find in own), sum(not find.found for find in own)
        starts = sorted(find.starts for find in own)
        lines.append(
            f"cost ({weights[0]:g}, {weights[1]:g}): the lowest cost of a target was found by "
            f"{shares[0]} to {shares[-1]} of {starts[0]} to {starts[-1]} independent starts, "
            f"at {never} of {len(own)} targets by none; lower ones may exist"
        )
        lower = [t for t in turned if t.weights == weights and (t.lowest is None or not is_higher(t.cost, t.lowest))]
        if lower:
            best = min(lower, key=lambda t: t.cost)
            lines.append(
                f"with whole turns lower still at {len({t.place for t in lower})} targets: down to {best.cost:.8g}, "
                f"{describe_turns(best.turns)}, at target {best.place}"
            )
    return lines


def summarise(attempts: Sequence[Attempt]) -> list[Summary]:
    """Sum up every part; the part "result" sums up all parts of the robust protocol."""
    lowest = find_lowest(attempts)
    groups: dict[tuple[Weights, str, str], list[Attempt]] = {}
    results: dict[tuple[Weights, str, str], dict[Place, Attempt]] = {}
    for attempt in attempts:
        task = attempt.task
        groups.setdefault((task.weights, task.representation, attempt.part), []).append(attempt)
        if attempt.protocol == "robust":
            best = results.setdefault((task.weights, task.representation, "result"), {})
            held = best.get(task.place)
            if attempt.turns:
                continue
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
        higher=sum(is_higher(a.cost, lowest[a.task.place, a.task.weights]) for a in solved if not a.turns),
        iterations=(float(min(iterations)), float(np.median(iterations)), float(max(iterations))),
        cpu_seconds=sum(attempt.cpu_seconds for attempt in group),
        cpu_median=float(np.median([attempt.cpu_seconds for attempt in solved] or [0.0])),
    )
