"""The result of a solve: a solution or a failure; and the file of a solution.

A file is JSON, with every digit of every number. It holds the problem, the solver's run and the trajectory. The same
solve writes the same file, except for the times.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import TypeAdapter, ValidationError

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.status import ACCEPTABLE
from mbsrun.ocp.ground.trajectory import OPTIONAL, Array, Trajectory
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.problem.problem import Problem, Range
from mbsrun.ocp.solution.record import SAME

F = TypeVar("F")

FORMAT: Literal["mbsrun solution 1"] = "mbsrun solution 1"
OTHER_KINDS: Mapping[str, tuple[str, str]] = {  # findings and remedies for files of the other kind, by their formats
    FORMAT: ("it is a solution without phases", "give a solution of a problem in phases"),
    "mbsrun phases 1": ("it is a solution in phases", "give a solution of a problem without phases"),
}
SOLUTION, TRAJECTORIES, MECHANISM = "solution.json", "trajectories.png", "mechanism.png"  # files of a folder
TABLE, ANIMATION = "solution.csv", "animation.html"
MESH = "mesh.png"  # of a refinement
DISTRIBUTION, STARTS = "starts.png", "starts.sqlite"  # of a search from many starts


@dataclass(frozen=True)
class Run:
    """The run of a solver."""

    status: str  # the solver's word; UNREACHABLE, BAD_BOUNDS or BAD_GUESS where it was not asked
    iterations: int
    seconds: float  # from the call to the answer, without compiling and laying out what later solves have as well
    seconds_evaluating: float  # of them, for functions and derivatives; the rest is linear algebra and the solver's own
    cpu_seconds: float = 0.0  # the same, of processor time, which other programs do not lengthen
    cpu_seconds_evaluating: float = 0.0
    method: str = ""  # of the solver, where it was asked
    decrease: float | None = None  # what the cost could still fall by, to first order, by the judge; None: unknown
    reach: float | None = None  # the same for its gradient alone, without constraints
    gap: float | None = None  # of a convex program: its cost above the minimum, at most
    instead: str = ""  # which method was asked first, and how that ended

    @property
    def cpu_seconds_solving(self) -> float:
        """Return the processor time of linear algebra and of the solver itself."""
        return max(0.0, self.cpu_seconds - self.cpu_seconds_evaluating)  # two clocks may differ by their steps


@dataclass(frozen=True)
class Size:
    """The size of the nonlinear program."""

    variables: int
    constraints: int
    jacobian_nonzeros: int
    hessian_nonzeros: int  # of the upper triangle


@dataclass(frozen=True)
class CostTerms:
    """The cost at the solution, by term, weights included: inputs, their rates, and the problem's expressions."""

    terms: tuple[tuple[str, float], ...]

    @property
    def inputs(self) -> float:
        """Return the weighted integral of |u|^2."""
        return self.terms[0][1]

    @property
    def input_rates(self) -> float:
        """Return the weighted sum of the squared rates."""
        return self.terms[1][1]

    @property
    def total(self) -> float:
        """Sum the terms."""
        return sum(value for _, value in self.terms)


@dataclass(frozen=True)
class Violation:
    """The largest violations of constraints and bounds, computed anew from the trajectory."""

    constraints: float
    bounds: float
    lengths: float | None = None  # of quaternions, from 1; they do not change the motion. None: there are none
    closure: float | None = None  # the largest gap of closed loops at mesh and collocation points [m, 1]
    closure_rate: float | None = None  # the largest rate at which they open there [m/s, 1/s]
    complementarity: float | None = None  # the largest product of force and distance, or friction and slip [N m, W]


@dataclass(frozen=True)
class Round:
    """A solve on one grid of a refinement."""

    change: str  # from the grid before, in words; empty: the first
    degree: int
    times: tuple[float, ...]  # of the mesh points [s]; of the guess, where no solution was found
    variables: int
    status: str
    iterations: int
    cpu_seconds: float
    cost: float | None  # None: no solution
    defects: tuple[float, ...]  # of the intervals; empty: unknown

    @property
    def defect(self) -> float | None:
        """Return the largest defect."""
        return max(self.defects, default=None)


@dataclass(frozen=True)
class Rounds:
    """All solves of a refinement."""

    accuracy: float  # that was asked for
    rounds: tuple[Round, ...]
    finding: str  # why it ended


@dataclass(frozen=True)
class Margin:
    """The place of a re-simulated motion at which a bound or a constraint of the path is nearest to its violation."""

    name: str  # in the words of the problem
    value: float
    range: Range
    time: float  # [s]
    interval: int  # from 0
    tolerated: float  # the violation from which on it counts

    def describe(self) -> str:
        """Describe the violation, as in `x is 1.2 at 0.5 s, 0.2 above its limit 1`."""
        is_low = self.value < self.range[0]
        limit = self.range[0] if is_low else self.range[1]
        name = self.name.removeprefix("the bounds of ").removeprefix("constraint ")
        place = f"{name} is {self.value:.6g} at {self.time:.4g} s"
        return f"{place}, {self.violation:.2g} {'below' if is_low else 'above'} its limit {limit:.6g}"

    @property
    def violation(self) -> float:
        """Return by how much the value leaves its range; negative: it stays as far inside."""
        return max(self.range[0] - self.value, self.value - self.range[1])

    @property
    def is_kept(self) -> bool:
        """Return whether a violation, if there is one, is tolerated."""
        return self.violation <= self.tolerated


@dataclass(frozen=True, repr=False)
class Margins:
    """The bounds and constraints of the path along a re-simulated motion, between the points of the grid too."""

    each: tuple[Margin, ...]
    intervals: tuple[float, ...]  # the largest violation of each interval over the tolerated one; 0: none

    def __repr__(self) -> str:
        """Return how many there are, and the worst one."""
        return f"Margins({len(self.each)} bounds and constraints; the worst: {self.worst})"

    @property
    def worst(self) -> Margin | None:
        """Return the margin whose violation is the largest one over what is tolerated; None: nothing is bounded."""
        return max(self.each, key=lambda margin: margin.violation / margin.tolerated, default=None)

    @property
    def violated(self) -> tuple[Margin, ...]:
        """Return the margins whose violation counts, the worst first."""
        found = [margin for margin in self.each if not margin.is_kept]
        return tuple(sorted(found, key=lambda margin: -margin.violation / margin.tolerated))


@dataclass(frozen=True)
class Resimulation:
    """The distance of the trajectory from the true motion under its inputs, by a tight integrator."""

    defect: float | None  # the largest difference at an interval's end, from its start; None: the integrator gave up
    defect_interval: int | None  # where it is, from 0
    open_loop_error: float | None  # the largest difference at the end, from the start or the last of `lost`
    is_accurate: bool  # whether the check finished, and the defect is within the accuracy that the problem asks for
    closure: float | None = None  # the largest gap of closed loops along the motion from its start [m, 1]
    slip: float | None = None  # the farthest that a contact moves, at the points of the solution [m]
    slip_along: float | None = None  # the same along the motion from its start, under the forces found
    unfinished: str = ""  # the limit of time or steps that ended the check, if one did
    defects: tuple[float, ...] = ()  # of all intervals; empty where the integrator gave up
    margins: Margins | None = None  # from every interval's start; None where the integrator gave up
    lost: tuple[float, ...] = ()  # times [s] at which the motion from the horizon's start was put back on the solution


@dataclass(frozen=True)
class Start:
    """The outcome of one start."""

    number: int
    kind: str
    status: str
    iterations: int
    cpu_seconds: float
    cost: float | None  # None: no solution
    turns: str  # whole turns of joints without limits, as `starts.count_turns` names them


@dataclass(frozen=True)
class Minimum:
    """A cost that starts found."""

    cost: float
    turns: str
    found: int  # times


@dataclass(frozen=True)
class Starts:
    """The outcomes of all starts."""

    seed: int
    asked: int
    results: tuple[Start, ...]  # of the starts that were made, independent of each other
    hops: tuple[Start, ...] = ()  # of solves that started from the best of them, and from their own results

    @property
    def best(self) -> Start | None:
        """Return the first start or hop that found the lowest cost; None where none found a solution."""
        every = enumerate((*self.results, *self.hops))
        solved = [(start.cost, k, start) for k, start in every if start.cost is not None]
        return min(solved)[2] if solved else None

    @property
    def minima(self) -> tuple[Minimum, ...]:
        """List the costs that starts found, the lowest first; costs of equal turns that differ by rounding are one."""
        found: list[Minimum] = []
        for start in sorted(self.results, key=lambda s: (s.turns, s.cost or 0.0)):
            if start.cost is None:
                continue
            last = found[-1] if found else None
            if last and last.turns == start.turns and start.cost <= last.cost + SAME * abs(last.cost):
                found[-1] = replace(last, found=last.found + 1)
            else:
                found.append(Minimum(start.cost, start.turns, 1))
        return tuple(sorted(found, key=lambda minimum: minimum.cost))

    @property
    def times(self) -> int:
        """Count the independent starts that found the lowest cost."""
        least = self.minima[0] if self.minima else None
        best = self.best
        if least is None or best is None or best.cost is None or best.cost < least.cost - SAME * abs(least.cost):
            return 0
        return least.found


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """A motion that meets the constraints and, by the solver's word, cannot be made cheaper nearby."""

    problem: Problem
    model: str
    model_hash: str
    coordinates: tuple[str, ...]  # the entries of q
    inputs: tuple[str, ...]
    run: Run
    size: Size
    cost: CostTerms
    violation: Violation
    trajectory: Trajectory
    resimulation: Resimulation | None = None
    starts: Starts | None = None  # of the search that found it, if it was one
    refinement: Rounds | None = None  # the solves that led to its grid, if it was refined
    equations: tuple[str, ...] = ()  # of closed loops
    sensitivities: tuple[tuple[str, float], ...] = ()  # of the cost, by differentiated parameters of the model
    multipliers: Array | None = None  # (N, d, m): the forces on these equations at the points of the trajectory
    driven: tuple[str, ...] = ()  # joints whose motion the problem gives
    driving: Array | None = None  # (N, d, joints): the forces that these take at the points of the trajectory
    mechanism: str = ""  # the hash of the mechanism, whatever was generated of it; empty in older files

    def __repr__(self) -> str:
        """Return the problem, the solver's word and the cost."""
        size = f"{self.problem.intervals} intervals, {self.trajectory.t[-1]:.6g} s"
        return f"Solution({self.problem.name}: {self.run.status}, cost {self.cost.total:.10g}, {size})"

    @property
    def parameters(self) -> dict[str, float]:
        """Return the parameters of the model that the problem gives and the numbers that were found, by name."""
        found = zip((unknown.name for unknown in self.problem.unknowns), self.trajectory.unknowns.tolist(), strict=True)
        return dict(self.problem.parameters) | dict(found)

    @property
    def is_only_acceptable(self) -> bool:
        """Return whether the solver stopped short of its tolerance."""
        return self.run.status == ACCEPTABLE


@dataclass(frozen=True, repr=False)
class Failure:
    """A solve that gave no solution."""

    problem: Problem | PhasedProblem
    run: Run
    finding: str
    remedy: str
    place: str = ""  # the part of the problem that is at fault, where one is known

    def __repr__(self) -> str:
        """Return the status, the finding and the remedy."""
        return f"Failure({self.problem.name}: {self.run.status}: {self.finding}; {self.remedy})"


@dataclass(frozen=True, eq=False)
class _File:
    format: Literal["mbsrun solution 1"]
    solution: Solution


@cache
def _adapter() -> TypeAdapter[_File]:
    """Return what reads and writes files, built at its first use: that takes long."""
    return TypeAdapter(_File)


def write_solution(solution: Solution, path: Path) -> None:
    """Write a solution to a file."""
    path.write_text(dump_solution(solution), encoding="utf-8")


def dump_solution(solution: Solution) -> str:
    """Return the text of a solution's file, one line for each of its parts."""
    parts = _adapter().dump_python(_File(FORMAT, solution), mode="json")["solution"]
    trajectory = {k: x for k, x in parts.pop("trajectory").items() if k not in OPTIONAL or _has_numbers(x)}
    if not solution.equations:
        del parts["equations"], parts["multipliers"]
    if not solution.driven:
        del parts["driven"], parts["driving"]
    lines = [f'  "{key}": {json.dumps(value, ensure_ascii=False)}' for key, value in parts.items()]
    arrays = [f'   "{key}": {json.dumps(value)}' for key, value in trajectory.items()]
    lines.append('  "trajectory": {\n' + ",\n".join(arrays) + "\n  }")
    return join_parts(FORMAT, lines)


def join_parts(form: str, lines: Sequence[str]) -> str:
    """Return the text of a file with the parts of a solution, one line for each."""
    return f'{{\n "format": "{form}",\n "solution": {{\n' + ",\n".join(lines) + "\n }\n}\n"


def _has_numbers(values: list[Any]) -> bool:
    """Return whether a nested list holds a number."""
    while values and isinstance(values[0], list):
        values = values[0]
    return bool(values)


def read_solution(path: Path) -> Solution:
    """Read a solution back. Raises InputError for a file that is not one."""
    return read_file(_adapter(), path, "solve the problem again").solution


def read_file(adapter: TypeAdapter[F], path: Path, remedy: str) -> F:
    """Read a file of a solution. Raises InputError for one of another kind."""
    try:
        return adapter.validate_json(path.read_bytes())
    except OSError as error:
        raise InputError([Fault(str(path), 0, "", f"cannot be read: {error.strerror}", "check the path")]) from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        found = first["input"]
        if place == "format" and isinstance(found, str) and found in OTHER_KINDS:
            raise InputError([Fault(str(path), 0, "", *OTHER_KINDS[found])]) from None
        raise InputError([Fault(str(path), 0, place, first["msg"], remedy)]) from None


def read_guess(path: Path, manifest: Manifest) -> Trajectory:
    """Read the motion of a solution, to start another from. Raises InputError for one of another mechanism."""
    solution = read_solution(path)
    for finding in list_misfits(solution, manifest):
        raise InputError([Fault(str(path), 0, "", finding, "give a solution for this mechanism")])
    return solution.trajectory


def list_misfits(solution: Solution, manifest: Manifest) -> Iterator[str]:
    """List the differences of the names in a solution and in a mechanism."""
    inputs = tuple(manifest.coordinates[i].name for i in manifest.actuated)
    for kind, found, wanted in (
        ("coordinates", solution.coordinates, manifest.positions),
        ("inputs", solution.inputs, inputs),
    ):
        if found != wanted:
            yield f"its {kind} are {', '.join(found)}; {manifest.model} has {', '.join(wanted)}"
