"""The findings of a search: the lowest costs, how often they were found, and the effort of each part of a protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.guessing.starts import describe_turns
from mbsrun.ocp.searching.study import Place, Study, Weights
from mbsrun.ocp.solution.record import SAME, Attempt, Task

INDEPENDENT = ("interpolation", "bumps", "noise", "waves", "branches")  # parts whose starts do not depend on each other


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
