"""The results of the paper's protocol, as tables, figures and judges need them.

A set of tasks has one cost. The first set of the paper has no smoothing, the second a price on the rates of the inputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.searching.attempts import find_lowest
from mbsrun.ocp.searching.study import Place, Study, Weights
from mbsrun.ocp.solution.record import SAME, Attempt, Task
from studies.docquier.growth import Growth
from studies.docquier.spread import Spread

Array = NDArray[np.float64]

ROBUST = "robust"  # the protocol
FIGURES = ("cost", "iterations", "cpu", "cpu per iteration", "evaluation per iteration")


@dataclass(frozen=True)
class Effort:
    """Operations of a formulation, from the report of the generator; parameters at run time."""

    flops: int  # by the paper's convention
    equations: int


@dataclass(frozen=True, eq=False)
class Results:
    """All attempts of a study, with motions, operations and scatter."""

    study: Study
    attempts: tuple[Attempt, ...]
    motions: tuple[tuple[Weights, Trajectory], ...]  # to the target of Fig. 8, by cost
    efforts: tuple[tuple[str, Effort], ...]  # by formulation
    growth: tuple[Growth, ...]
    shooting: tuple[tuple[str, tuple[Attempt, ...]], ...] = ()  # of the study's problem, by transcription
    spreads: tuple[Spread, ...] = ()  # of iterations, by perturbed repeats
    same: float = SAME  # relative difference of costs within which two minima count as one

    @cached_property
    def lowest(self) -> dict[tuple[Place, Weights], float]:
        """Return the lowest cost of the solves that started from the interpolation, as the paper's did.

        The robust protocol goes through some targets further than through others, so its costs would compare unequally.
        """
        return find_lowest([a for a in self.attempts if a.protocol != ROBUST])

    @cached_property
    def known(self) -> dict[tuple[Place, Weights], float]:
        """Return the lowest cost of all attempts of all protocols."""
        return find_lowest(self.attempts)

    @property
    def representations(self) -> tuple[str, ...]:
        """Name the representations that the study compares."""
        return tuple(r.value for r in self.study.representations)

    @property
    def rough(self) -> Weights | None:
        """Return the cost without smoothing."""
        return next((w for w in self.study.costs if w[1] == 0), None)

    @property
    def smooth(self) -> Weights | None:
        """Return the cost with smoothing."""
        return next((w for w in self.study.costs if w[1] > 0), None)

    def pick(self, weights: Weights, representation: str, protocol: str = "paper") -> list[Attempt]:
        """List the attempts of a set; of the paper's protocol at the places that are compared."""
        return self._sets.get((protocol, weights, representation), [])

    @cached_property
    def _sets(self) -> dict[tuple[str, Weights, str], list[Attempt]]:
        sets: dict[tuple[str, Weights, str], list[Attempt]] = {}
        for a in self.attempts:
            if a.protocol != "paper" or a.task.place in self.compared.get(a.task.weights, ()):
                sets.setdefault((a.protocol, a.task.weights, a.task.representation), []).append(a)
        return sets

    @cached_property
    def compared(self) -> dict[Weights, set[Place]]:
        """Return the places that the paper's protocol has finished in all representations, by cost."""
        tried = {(a.task.weights, a.task.place, a.task.representation) for a in self.attempts if a.protocol == "paper"}
        return {
            weights: {
                place
                for place in self.study.targets.places
                if all((weights, place, name) in tried for name in self.representations)
            }
            for weights in self.study.costs
        }

    def is_measured(self, weights: Weights | None, *names: str) -> bool:
        """Return whether a set has solutions in each of some representations, for half of the targets or more."""
        if weights is None:
            return False
        solved = [sum(a.cost is not None for a in self.pick(weights, name)) for name in names]
        return bool(min(solved, default=0)) and 2 * min(solved) >= len(self.study.targets.places)

    def values(self, weights: Weights, representation: str, figure: str) -> Array:
        """Return a figure of all solved attempts of the paper's protocol."""
        solved = [a for a in self.pick(weights, representation) if a.cost is not None]
        return np.array([read_figure(a, figure) for a in solved])

    def higher(self, weights: Weights, representation: str) -> list[Place]:
        """List the places where a representation ended in a higher minimum than the lowest from the interpolation."""
        return [
            a.task.place
            for a in self.pick(weights, representation)
            if a.cost is not None and self.is_higher(a.cost, self.lowest[a.task.place, weights])
        ]

    def is_higher(self, cost: float, lowest: float) -> bool:
        """Return whether a cost is above the lowest by more than the threshold of one minimum."""
        return cost > lowest + self.same * abs(lowest)

    def with_same(self, same: float) -> Results:
        """Return the same results with another threshold of one minimum."""
        return replace(self, same=same)

    def resample(self, source: np.random.Generator) -> Results:
        """Return results whose iterations are drawn from their spread; times change in proportion."""
        sizes = {(s.weights, s.representation): s.deviation for s in self.spreads}

        def draw(a: Attempt) -> Attempt:
            deviation = sizes.get((a.task.weights, a.task.representation), 0.0)
            if a.protocol != "paper" or deviation == 0.0:
                return a
            iterations = max(round(a.iterations * float(np.exp(source.normal(0.0, deviation)))), 1)
            factor = iterations / max(a.iterations, 1)
            times = (a.cpu_seconds * factor, a.cpu_seconds_evaluating * factor)
            return replace(a, iterations=iterations, cpu_seconds=times[0], cpu_seconds_evaluating=times[1])

        return replace(self, attempts=tuple(map(draw, self.attempts)))

    def size(self, representation: str) -> tuple[int, int, int, int] | None:
        """Return variables, constraints and nonzeros of a solved program."""
        for a in self.attempts:
            if a.task.representation == representation and a.variables is not None:
                return (a.variables, a.constraints or 0, a.jacobian_nonzeros or 0, a.hessian_nonzeros or 0)
        return None


def read_figure(attempt: Attempt, figure: str) -> float:
    """Read one number of an attempt that was solved."""
    if figure == "cost":
        assert attempt.cost is not None, "called for solved attempts only"
        return attempt.cost
    if figure == "iterations":
        return float(attempt.iterations)
    if figure == "cpu":
        return attempt.cpu_seconds
    seconds = attempt.cpu_seconds if figure == "cpu per iteration" else attempt.cpu_seconds_evaluating
    return 1e3 * seconds / max(attempt.iterations, 1)


def find_outliers(values: Array) -> Array:
    """Return the values beyond the whiskers of a box plot: more than 1.5 boxes away from the box."""
    if not values.size:
        return values
    lower, upper = np.percentile(values, (25, 75))
    reach = 1.5 * (upper - lower)
    return np.asarray(values[(values < lower - reach) | (values > upper + reach)])


def find_shown_task(study: Study, weights: Weights) -> Task:
    """Find the task of Fig. 8: the last azimuth and the lowest height, in the first representation."""
    place = max(study.targets.places, key=lambda p: (study.targets.azimuths[p[0]], -study.targets.heights[p[1]]))
    return Task(place, weights, study.representations[0].value)


def is_dae_of_explicit(representation: str) -> bool:
    """Return whether accelerations are variables of an explicit form: EXP1-A, EXP2-A."""
    kind = Representation(representation)
    return kind.is_explicit and not kind.is_ode
