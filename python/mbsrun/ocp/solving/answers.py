"""The numbers at which a search ended -> a solution: its motion, its cost, what is violated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.closure import Closure
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import CostTerms, Run, Size, Solution, Violation
from mbsrun.ocp.transcription.transcription import Transcription
from mbsrun.quaternions import measure_lengths


@dataclass(frozen=True)
class Ended:
    """The numbers of a program at the end of a search."""

    x: Array
    g: Array
    terms: Array  # of the cost, without their weights
    completed: Array  # all variables


def measure_size(program: Prepared) -> Size:
    """Return the size of a program, as a method sees it."""
    data = program.data
    return Size(data.kept.size, data.kept_rows.size, *program.numpy.count_nonzeros())


def make_solution(
    problem: Problem, manifest: Manifest, transcription: Transcription, run: Run, size: Size, values: Ended
) -> Solution:
    """Read a solution off the numbers of a program."""
    trajectory, terms = transcription.unpack(values.completed), values.terms * problem.cost.weights
    return Solution(
        problem=problem,
        model=manifest.model,
        model_hash=manifest.model_hash,
        coordinates=manifest.positions,
        inputs=tuple(manifest.coordinates[i].name for i in manifest.actuated),
        run=run,
        size=size,
        cost=CostTerms(tuple(zip(problem.cost.names, terms.tolist(), strict=True))),
        violation=Violation(
            measure_excess(values.g, *transcription.constraint_bounds(problem)),
            measure_excess(values.x, *transcription.variable_bounds(problem)),
            _measure_lengths(trajectory, manifest),
            *_measure_closure(trajectory, transcription.find_loops(trajectory.unknowns)),
            _measure_complementarity(problem, transcription, values.g),
        ),
        trajectory=trajectory,
        equations=manifest.equations,
        multipliers=transcription.read_multipliers(values.completed, trajectory),
        driven=tuple(manifest.coordinates[i].name for i in manifest.driven),
        driving=transcription.read_driving(values.completed),
        mechanism=manifest.mechanism,
    )


def measure_excess(values: Array, lower: Array, upper: Array) -> float:
    """Return by how much values leave their bounds: the largest."""
    return float(np.maximum(lower - values, values - upper).max(initial=0.0))


def _measure_complementarity(problem: Problem, transcription: Transcription, g: Array) -> float | None:
    """Return the largest product of complementary numbers, at all points; None without such contacts."""
    rows = [
        row for row, part in zip(transcription.rows.constraints, problem.constraints, strict=True) if part.is_relaxed
    ]
    return float(g[np.concatenate(rows)].max()) if rows else None


def _measure_lengths(trajectory: Trajectory, manifest: Manifest) -> float | None:
    """Return how far from 1 a quaternion's length comes, at mesh and collocation points."""
    if not manifest.quaternions:
        return None
    lengths = (measure_lengths(q, manifest) for q in (trajectory.q, trajectory.point_q))
    return max(float(np.abs(length - 1).max()) for length in lengths)


def _measure_closure(trajectory: Trajectory, closure: Closure | None) -> tuple[float | None, float | None]:
    """Return the largest gap of loops, and the largest rate, at mesh and collocation points."""
    if closure is None:
        return None, None
    states = ((trajectory.q, trajectory.qd), (trajectory.point_q, trajectory.point_qd))
    return max(closure.measure(q) for q, _ in states), max(closure.measure_rates(*state) for state in states)
