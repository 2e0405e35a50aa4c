"""The trials of a search: starts of the tasks of a study, by one of two protocols that are never mixed.

The *paper* protocol compares: for each representation one guess, the interpolation without inputs, no
restart; failures and higher minima are counted (Docquier, Bruls, Fisette, section 4.3).

The *robust* protocol looks for the lowest minimum of every task. It cannot show that no minimum is lower; so
`count_finds` counts how many independent starts found the lowest:

    interpolation   each representation, from the interpolation with the inputs of its inverse dynamics
    bumps, noise, waves, branches, turns
                    the first representation, from the random starts of `starts`: independent of each other; more of
                    them where input rates are free, which makes many minima; quaternions take no bumps and no waves
    neighbours      the first representation, from the best motion of each neighbouring target, until nothing is new
    mirror          the first representation, from the image of a lower motion to the opposite target, staying near it
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

import itertools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from mbsrun.ocp.guessing.starts import TURNS, Kind, Variation
from mbsrun.ocp.problem.problem import Inputs
from mbsrun.ocp.searching.attempts import is_higher
from mbsrun.ocp.searching.study import Place, Study
from mbsrun.ocp.solution.record import Attempt, Best, Key, Task

ProtocolName = Literal["paper", "robust"]
MULTISTART = "starts"  # the protocol of a single problem from many starts: see `multistart`

# Starts of the robust protocol for each target: where input rates are free of charge, which makes many minima, and
# where they are not. Of turns: for each joint and number of turns.
COUNTS: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"bumps": (6, 2), "noise": (6, 2), "waves": (8, 3), "branches": (2, 1), "turns": (2, 1)}
)
HOPS = (6, 2)  # likewise, of hops from a motion
ROUNDS = 100  # at most


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
    is_mirrored: bool = False  # its mirror image


Beginning = Interpolation | Varied | Found | Hop


@dataclass(frozen=True)
class Trial:
    """An attempt to make."""

    task: Task
    protocol: str
    part: str
    guess: str  # names the start
    start: Beginning
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
    moves = itertools.chain(
        _list_neighbours(study, best, number),
        _list_mirrored(study, best, number),
        _list_hops(study, best, turned, number),
    )
    near = [trial for trial in moves if trial.key not in tried]
    return near or [trial for trial in _list_exchanges(study, best, number) if trial.key not in tried]


def restate(study: Study, attempt: Attempt) -> Trial:
    """Return the trial of an attempt by the paper's protocol or the robust one, from its names."""
    task, part, guess = attempt.task, attempt.part, attempt.guess
    start: Beginning
    if part in ("neighbours", "mirror", "exchange"):
        place, representation, _ = guess.split(" ")
        i, j = map(int, place.split(","))
        start = _find_start(Task((i, j), task.weights, representation), part)
    elif part == "hops":
        turns, _, *seed, k = guess.rsplit(" ", 2 + len(task.place))
        start = Hop(task, "" if turns == "-" else turns, (*map(int, seed), attempt.round, int(k)))
    elif part in COUNTS:
        named = itertools.chain(*_vary_all(study, task.place, is_rough=task.weights[1] == 0))
        start = Varied(next(variation for name, variation in named if (variation.kind, name) == (part, guess)))
    else:
        start = Interpolation("dynamic" if guess == "dynamic" else "zero")
    return Trial(task, attempt.protocol, part, guess, start, attempt.round)


def list_interpolations(study: Study, protocol: str, part: str, inputs: Inputs) -> list[Trial]:
    """Start every task of a study from the interpolation with some inputs; representations of a task are adjacent."""
    return [
        Trial(Task(place, weights, representation.value), protocol, part, inputs, Interpolation(inputs))
        for weights in study.costs
        for place in study.targets.spread
        for representation in study.representations
    ]


def _list_variations(study: Study) -> list[Trial]:
    """List the random starts: one of each kind at every target, then the next of each, so that any part is spread."""
    scout = study.representations[0].value
    return [
        Trial(Task(place, weights, scout), "robust", variation.kind, name, Varied(variation))
        for weights in study.costs
        for rank in _rank_all(study, is_rough=weights[1] == 0)
        for place, name, variation in rank
    ]


def _rank_all(study: Study, *, is_rough: bool) -> Iterator[list[tuple[Place, str, Variation]]]:
    """Yield the first variation of every kind at all targets, then the second ones, and so on."""
    kinds = {place: _vary_all(study, place, is_rough=is_rough) for place in study.targets.spread}
    for rank in range(max(len(own) for variations in kinds.values() for own in variations)):
        yield [(place, *own[rank]) for place, variations in kinds.items() for own in variations if rank < len(own)]


def _vary_all(study: Study, place: Place, *, is_rough: bool) -> list[list[tuple[str, Variation]]]:
    """Name the variations of a target, in one list for each kind; each part numbers its own."""
    counts = {part: few_or_many[0 if is_rough else 1] for part, few_or_many in COUNTS.items()}
    named: list[list[tuple[str, Variation]]] = []
    kinds: tuple[Kind, ...] = ("noise", "branches")
    if not study.problem.has_quaternions:  # whose velocities a bump would have to be found for
        named.append([(str(k), Variation("bumps", (*place, k))) for k in range(counts["bumps"])])
        kinds = (*kinds, "waves")
    for code, kind in enumerate(kinds):
        named.append([(str(k), Variation(kind, (*place, k, code))) for k in range(counts[kind])])
    for i in study.turning:
        for turns in TURNS:
            seeds = [(*place, k, len(COUNTS), i, turns % 2**32) for k in range(counts["turns"])]
            named.append([(f"{i} {turns:+d} {k}", Variation("turns", s, (i, turns))) for k, s in enumerate(seeds)])
    return named


def _list_neighbours(study: Study, best: Mapping[Task, Best], number: int) -> Iterator[Trial]:
    """Start every target from its neighbours."""
    scout = study.representations[0].value
    for weights in study.costs:
        for place in study.targets.spread:
            for near in study.targets.neighbours(place):
                origin = Task(near, weights, scout)
                if origin in best:
                    yield _start_from(origin, best[origin], Task(place, weights, scout), "neighbours", number)


def _list_mirrored(study: Study, best: Mapping[Task, Best], number: int) -> Iterator[Trial]:
    """Start every target from the image of a lower motion to the opposite one."""
    scout = study.representations[0].value
    for weights in study.costs:
        for place in study.targets.spread if study.mirror else ():
            task, opposite = Task(place, weights, scout), study.targets.opposite(place)
            origin = None if opposite is None else Task(opposite, weights, scout)
            own = best[task].cost if task in best else None
            if origin is not None and origin in best and is_higher(own, best[origin].cost):
                yield _start_from(origin, best[origin], task, "mirror", number)


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
    return Trial(task, "robust", part, name, _find_start(origin, part), number)


def _find_start(origin: Task, part: str) -> Found:
    return Found(origin, is_held=part in ("exchange", "mirror"), is_mirrored=part == "mirror")
