"""Guesses in Python: a solution, a file, a trajectory, a pandas frame, or arrays by name -> a motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.recorded import find_guess, recall
from mbsrun.ocp.guessing.state_guess import complete, guess_largest
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import list_misfits
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.recalling import make_recording, read_unknowns
from mbsrun.optimal.result import Solved

GuessLike = Solved | Trajectory | Mapping[str, Any] | str | Path  # or a frame


def read_motion(guess: GuessLike, problem: Problem, plant: Plant) -> Trajectory:
    """Return the motion of a guess. Raises InputError for a file or arrays that hold none of this mechanism."""
    match guess:
        case Solved():
            _refuse(problem, (("guess", finding) for finding in list_misfits(guess.solution, plant.manifest)))
            return _begin(guess.trajectory)
        case Trajectory():
            _refuse(problem, _list_wrong_sizes(guess, plant))
            return _begin(_check(guess, problem))
        case str() | Path():
            return find_guess(Path(guess), problem, plant)
    if not isinstance(guess, Mapping) and (isinstance(guess, Sequence) or not hasattr(guess, "index")):
        remedy = "give a solution, a file, a trajectory, a pandas frame, or arrays by name"
        raise ProblemError(problem.name, [("guess", f"found a value of type {type(guess).__name__}", remedy)])
    motion = recall(make_recording(guess, problem, plant.manifest), problem, plant)
    given = read_unknowns(guess, problem)
    if not given:
        return motion
    unknowns = np.array([given.get(place, unknown.guess) for place, unknown in enumerate(problem.unknowns)])
    return guess_largest(complete(replace(motion, unknowns=unknowns), problem, plant), problem, plant)


def _refuse(problem: Problem, findings: Iterable[tuple[str, str]]) -> None:
    """Raise ProblemError where a motion is another mechanism's."""
    faults = [(where, finding, "give a motion of this mechanism") for where, finding in findings]
    if faults:
        raise ProblemError(problem.name, faults)


def _list_wrong_sizes(motion: Trajectory, plant: Plant) -> Iterator[tuple[str, str]]:
    """List the arrays of a motion that have other widths than this mechanism's."""
    manifest = plant.manifest
    widths = {"q": len(manifest.positions), "qd": len(manifest.coordinates), "u": len(manifest.actuated)}
    for name, width in widths.items():
        shape = getattr(motion, name).shape
        if shape[-1] != width:
            yield f"guess.{name}", f"shape {shape}; {manifest.model} has {width} columns of it"


def _check(motion: Trajectory, problem: Problem) -> Trajectory:
    """Raise ProblemError with the first number of each array that is not finite."""
    findings = []
    for part in fields(motion):
        values = getattr(motion, part.name)
        for place in np.argwhere(~np.isfinite(values))[:1].tolist():
            where = ", ".join(map(str, place))
            findings.append((f"guess.{part.name}[{where}]", f"found {values[tuple(place)]}", "give a finite number"))
    if findings:
        raise ProblemError(problem.name, findings)
    return motion


def _begin(motion: Trajectory) -> Trajectory:
    """Return a motion with times since its start: phases have times since the start of the first one."""
    return replace(motion, t=motion.t - motion.t[0], point_t=motion.point_t - motion.t[0])
