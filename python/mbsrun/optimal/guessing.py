"""Guesses in Python: a solution, a file, a trajectory, a pandas frame, or arrays by name -> a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.recorded import find_guess, recall
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.recalling import make_recording
from mbsrun.optimal.result import Solved

GuessLike = Solved | Trajectory | Mapping[str, Any] | str | Path  # or a frame


def read_motion(guess: GuessLike, problem: Problem, plant: Plant) -> Trajectory:
    """Return the motion of a guess. Raises InputError for a file or arrays that hold none of this mechanism."""
    match guess:
        case Solved():
            return _begin(guess.trajectory)
        case Trajectory():
            return _begin(_check(guess, problem))
        case str() | Path():
            return find_guess(Path(guess), problem, plant)
    return recall(make_recording(guess, problem, plant.manifest), problem, plant)


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
