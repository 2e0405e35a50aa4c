"""The question of a search: one problem for a grid of targets, several costs and several representations."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

from pydantic import TypeAdapter

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.linear import MUMPS
from mbsrun.ocp.problem.problem import Point, Problem, Representation, SolverName, cylindrical
from mbsrun.ocp.solution.record import Task

SAME = 1e-12  # rad: azimuths

Place = tuple[int, int]
Weights = tuple[float, float]


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

    def opposite(self, place: Place) -> Place | None:
        """Return the place at the opposite azimuth, if it is taken and another one."""
        (i, j), last = place, len(self.azimuths) - 1
        is_there = abs(self.azimuths[i] + self.azimuths[last - i]) <= SAME and (last - i, j) in self.places
        return (last - i, j) if is_there and last - i != i else None

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
    linear_solver: str = MUMPS  # of IPOPT, for all protocols except searches for optima, which take the fastest
    mirror: tuple[int, ...] = ()  # signs of coordinates in mirror images of motions, see `find_mirror`; (): none
    method: SolverName = "ipopt"  # of the robust protocol, and of searches from many starts

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
