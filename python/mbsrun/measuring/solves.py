"""Optimal control: processor time of a solve against the defect, by collocation, grid and representation.

The defect is the largest error of an interval by re-simulation. First, for each kind and degree of points, the first
representation is solved on finer and finer grids until the defect is small enough. Then all representations are solved
on the fastest of these grids. Inputs are constant over an interval, so a finer grid also has a lower cost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import read_document
from mbsgen.errors import Fault, InputError, MbsError
from mbsgen.manifest import Manifest
from mbsrun.closure import Closure, has_loops
from mbsrun.external import Mechanism, load
from mbsrun.measuring.mechanisms import list_ranges
from mbsrun.measuring.points import SolvePoint
from mbsrun.measuring.store import Store
from mbsrun.measuring.timing import sum_up
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Form, Problem, Representation
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.quaternions import neutral

Array = NDArray[np.float64]

HORIZON = 1.0  # s
REACH = 0.5  # rad, and a fifth of it in m: how far the actuated joints go


@dataclass(frozen=True)
class SolveScope:
    """The amount of measurement."""

    families: tuple[Family, ...] = (Family.RADAU, Family.LEGENDRE)
    degrees: tuple[int, ...] = (2, 3, 4, 5)
    intervals: tuple[int, ...] = (5, 10, 20, 40, 80)
    representations: tuple[Representation, ...] = tuple(Representation)
    repeats: int = 3  # of the representations' comparison
    is_whole: bool = False  # solve on finer grids than the accuracy needs, too
    seconds: float = math.inf  # no solve begins later


QUICK = SolveScope((Family.RADAU,), (3,), (5, 10), (Representation.IMPL, Representation.EXP2_O), 1)
FRONTS = SolveScope(is_whole=True, seconds=30.0)


@dataclass(frozen=True)
class Case:
    """A problem and its mechanism."""

    problem: Problem
    mechanism: Mechanism


def state_reach(mechanism: Mechanism) -> Case:
    """State a problem for any mechanism: its actuated joints move a little way, from rest to rest, with least effort.

    What is passive goes along. With closed loops, it starts in the assembled pose, and goes as far as the loops allow.
    Raises MbsError where nothing is actuated.
    """
    manifest = mechanism.manifest
    if not can_reach(manifest):
        raise MbsError(f"{manifest.model}: no joint of one coordinate is actuated, so there is no reach to optimise")
    ranges, n = list_ranges(manifest), len(manifest.coordinates)
    start = np.array(manifest.pose) if has_loops(manifest) else np.clip(neutral(manifest), *np.array(ranges).T)
    goals = _find_goals(mechanism, start)
    free = (-math.inf, math.inf)
    problem = Problem(
        name=f"{manifest.model}_reach",
        horizon=HORIZON,
        intervals=20,
        family=Family.RADAU,
        degree=4,
        cost=Cost(inputs=1.0),
        start_q=tuple(start.tolist()),
        start_qd=(0.0,) * n,
        bounds=Bounds(tuple(ranges), (free,) * n, (free,) * len(manifest.actuated)),
        end=End(
            coordinates=tuple(goals.items()),
            velocities=tuple((_find_velocity(manifest, i), 0.0) for i in goals),
        ),
    )
    return Case(problem, mechanism)


def find_problems(model: Path) -> list[Path]:
    """List the problem files beside a model that name it, without phases."""
    found = []
    for path in sorted(model.parent.glob("*.ocp.yaml")):
        try:
            data = read_document(path).data
        except InputError:
            continue
        if isinstance(data, dict) and data.get("model") == model.name and "phases" not in data:
            found.append(path)
    return found


def read_case(mechanism: Mechanism, file: Path) -> Case:
    """Read a problem to measure on. Raises InputError for a file with faults, or for a problem of another model."""
    found, plant = read_problem(file, load)
    if plant.manifest.model_hash != mechanism.manifest.model_hash:
        fault = f"its model is {plant.manifest.model}, not {mechanism.manifest.model} as given"
        raise InputError([Fault(str(file), 0, "model", fault, "give the problem's model")])
    return Case(found, mechanism)


def can_reach(manifest: Manifest) -> bool:
    """Return whether a joint of one coordinate is actuated: reaches do not turn quaternions."""
    return any(manifest.coordinates[i].name in manifest.positions for i in manifest.actuated)


def measure_solves(
    case: Case, accuracy: float, scope: SolveScope, store: Store[SolvePoint], report: Callable[[str, int, int], None]
) -> list[SolvePoint]:
    """Solve on grids, then in all representations; earlier solves are read from the store."""
    points: list[SolvePoint] = []
    kinds = [(family, degree) for family in scope.families for degree in scope.degrees]
    total, begin = len(kinds) + len(scope.representations), time.monotonic()
    first = scope.representations[0]
    for done, (family, degree) in enumerate(kinds):
        for intervals in scope.intervals:
            if time.monotonic() - begin > scope.seconds:
                break
            report(f"{family.value}, degree {degree}, {intervals} intervals", done, total)
            problem = replace(
                case.problem, family=family, degree=degree, intervals=intervals, mesh=None, representation=first
            )
            points.append(measure_solve(case, problem, 1, store))
            if not scope.is_whole and points[-1].defect is not None and points[-1].defect <= accuracy:
                break
    good = [p for p in points if p.seconds and p.defect is not None and p.defect <= accuracy]
    if not good:
        return points
    best = min(good, key=lambda p: p.seconds.shortest if p.seconds else math.inf)
    for done, representation in enumerate(scope.representations, len(kinds)):
        report(representation.value, done, total)
        problem = replace(
            case.problem,
            family=Family(best.family),
            degree=best.degree,
            intervals=best.intervals,
            representation=representation,
            form=Form.STANDARD if representation.is_ode else case.problem.form,
        )
        points.append(measure_solve(case, problem, scope.repeats, store))
    return list({(p.representation, p.family, p.degree, p.intervals): p for p in points}.values())


def measure_solve(case: Case, problem: Problem, repeats: int, store: Store[SolvePoint]) -> SolvePoint:
    """Return a solve from the store, or solve a problem of the case's mechanism `repeats` times and keep the result."""
    manifest, values = case.mechanism.manifest, dict(case.mechanism.parameters)
    facts = ("solves", manifest.generator, manifest.model_hash, values, problem, repeats)
    (point,) = store.find_or_measure(facts, lambda: [_solve(case.mechanism, problem, repeats)])
    return point


def _solve(mechanism: Mechanism, problem: Problem, repeats: int) -> SolvePoint:
    names = (mechanism.manifest.model, problem.representation.value, problem.family.value)
    grid = (problem.degree, problem.intervals)
    try:
        outcome = solve(problem, mechanism)
    except ProblemError as error:  # loops take some combinations only
        return SolvePoint(*names, *grid, None, None, None, 0, "; ".join(finding for _, finding, _ in error.findings))
    if isinstance(outcome, Failure):
        return SolvePoint(*names, *grid, None, None, None, outcome.run.iterations, outcome.finding)
    check = resimulate(outcome, mechanism).resimulation
    times = [outcome.run.cpu_seconds]
    times += [solve(problem, mechanism).run.cpu_seconds for _ in range(repeats - 1)]
    defect = None if check is None else check.defect
    finding = "" if defect is not None else "the integrator gave up in the re-simulation"
    cost = sum_up(np.array(times))
    return SolvePoint(*names, *grid, cost, defect, outcome.cost.total, outcome.run.iterations, finding)


def _find_goals(mechanism: Mechanism, start: Array) -> dict[int, float]:
    """Return goals of the actuated joints, by entries of q; of joints that are free where loops relate them."""
    manifest = mechanism.manifest
    places = manifest.positions
    names = [manifest.coordinates[i].name for i in manifest.actuated if manifest.coordinates[i].name in places]
    goals = {k: _find_goal(manifest, k, float(start[k])) for k in map(places.index, names)}
    if not has_loops(manifest):
        return goals
    closure = Closure(mechanism)
    moved = {_find_velocity(manifest, k): k for k in goals}
    chosen = [moved[i] for i in closure.choose(start, [*moved])]
    reached = closure.spread(start, chosen, np.array([[goals[k] for k in chosen]]))[0]
    return {k: float(reached[k]) for k in chosen}


def _find_goal(manifest: Manifest, i: int, start: float) -> float:
    """Go up, where there is room, or down."""
    coordinate = manifest.coordinates[_find_velocity(manifest, i)]
    way = REACH if coordinate.motion == "revolute" else REACH / 5
    upper = math.inf if coordinate.upper is None else coordinate.upper
    lower = -math.inf if coordinate.lower is None else coordinate.lower
    if start + way <= upper:
        return start + way
    return max(start - way, (start + lower) / 2) if math.isfinite(lower) else start - way


def _find_velocity(manifest: Manifest, i: int) -> int:
    """Return the entry of qd that belongs to entry i of q."""
    return [c.name for c in manifest.coordinates].index(manifest.positions[i])
