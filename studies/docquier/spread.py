"""Scatter of the iterations of one task, by repeats with data that differ by rounding alone.

Where a record has no repeats, targets at opposite azimuths take their place, if the mechanism is its own mirror image:
their programs are mirror images, and differ by rounding alone.

Interior-point iterations depend on every bit: two targets 1e-16 apart may take 87 and 104. So a difference of two
medians has a meaning only beyond this scatter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.ocp.searching.study import Targets, Weights
from mbsrun.ocp.solution.record import Attempt, Task

DIFFER = 0.1  # share of pairs whose iterations must differ; where rounding is mirrored too, pairs show no scatter
MIRRORED = 1e-6  # relative difference of costs up to which a pair of optima is one optimum and its mirror image


@dataclass(frozen=True)
class Spread:
    """The scatter of the iterations of one set in one representation."""

    weights: Weights
    representation: str
    tasks: int  # that were repeated
    solves: int  # of all of them together, the first of each included
    deviation: float  # standard deviation of the logarithm of a task's iterations, pooled over the tasks
    widest: float  # the largest ratio of the most to the fewest iterations of one task
    apart: int  # tasks whose repeats ended in different minima


def measure(first: Iterable[Attempt], repeats: Iterable[Attempt], same: float) -> tuple[Spread, ...]:
    """Measure the scatter of tasks solved at least twice; costs within `same` of each other are one minimum."""
    by_task: dict[Task, list[Attempt]] = {}
    for attempt in repeats:
        by_task.setdefault(attempt.task, []).append(attempt)
    for attempt in first:
        if attempt.task in by_task:
            by_task[attempt.task].append(attempt)
    solved = {task: [a for a in found if a.cost is not None] for task, found in by_task.items()}
    groups: dict[tuple[Weights, str], list[list[Attempt]]] = {}
    for task, found in solved.items():
        if len(found) > 1:
            groups.setdefault((task.weights, task.representation), []).append(found)
    return tuple(_pool(*key, tasks, same) for key, tasks in groups.items())


def pair_mirrored(attempts: Sequence[Attempt], targets: Targets) -> list[Attempt]:
    """Return the attempts at the lower azimuths, named as their mirror images, for costs in which many pairs differ.

    There are none where the costs of pairs differ by more than rounding: the mechanism is not its own mirror image.
    """
    azimuths = np.array(targets.azimuths)
    if not np.allclose(azimuths, -azimuths[::-1], atol=1e-12):
        return []
    known = {a.task: a for a in attempts}
    images: list[Attempt] = []
    gaps: list[float] = []
    changes: dict[Weights, list[bool]] = {}
    for a in attempts:
        i, j = a.task.place
        task = replace(a.task, place=(azimuths.size - 1 - i, j))
        image = known.get(task)
        if azimuths[i] < -1e-12 and image is not None and a.cost is not None and image.cost is not None:
            images.append(replace(a, task=task))
            gaps.append(abs(a.cost - image.cost) / abs(image.cost))
            changes.setdefault(task.weights, []).append(a.iterations != image.iterations)
    is_mirrored = bool(gaps) and float(np.median(gaps)) < MIRRORED
    return [a for a in images if is_mirrored and float(np.mean(changes[a.task.weights])) >= DIFFER]


def _pool(weights: Weights, representation: str, tasks: Sequence[Sequence[Attempt]], same: float) -> Spread:
    counts = [np.array([max(a.iterations, 1) for a in found], dtype=float) for found in tasks]
    squares = sum(float(((np.log(c) - np.log(c).mean()) ** 2).sum()) for c in counts)
    freedom = sum(len(c) - 1 for c in counts)
    costs = [[a.cost for a in found if a.cost is not None] for found in tasks]
    return Spread(
        weights,
        representation,
        tasks=len(tasks),
        solves=sum(map(len, counts)),
        deviation=math.sqrt(squares / freedom),
        widest=max(float(c.max() / c.min()) for c in counts),
        apart=sum(max(c) > min(c) + same * abs(min(c)) for c in costs),
    )
