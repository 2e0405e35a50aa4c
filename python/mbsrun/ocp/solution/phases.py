"""The result of a solve of several phases: a solution of each, the impulses of links, and shared unknowns; its file.

A file is JSON, as the file of a solution is, with a list of solutions, one for each phase.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.status import ACCEPTABLE
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.phases import Link, Phase, PhasedProblem
from mbsrun.ocp.problem.problem import SolverOptions, Unknown
from mbsrun.ocp.solution.solution import Run, Size, Solution, Starts, join_parts, list_misfits, read_file

FORMAT: Literal["mbsrun phases 1"] = "mbsrun phases 1"


@dataclass(frozen=True)
class Impulse:
    """The impulse that the ground gives to a contact, in axes of the base [N s]."""

    sensor: str
    components: tuple[float, float, float]


@dataclass(frozen=True)
class LinkValues:
    """The numbers of a link."""

    source: str
    target: str
    violation: float  # of its rows, the largest
    impulses: tuple[Impulse, ...] = ()
    changes: tuple[float, ...] = ()  # of the velocities, at an impact
    multipliers: tuple[float, ...] = ()  # the impulses of closed loops
    terms: tuple[tuple[str, float], ...] = ()  # of the cost: name, value times weight
    stops: tuple[tuple[str, float], ...] = ()  # the impulses of stops in the directions of joints [N s or N m s]


@dataclass(frozen=True)
class Followed:
    """How the simulation of a model, from event to event, goes through the modes of phases in a row."""

    phases: tuple[str, ...]  # their names
    error: float | None  # of coordinates and velocities amid each phase and at the end; None: it does not get there
    finding: str = ""  # where its modes or events differ from the ones of the phases; empty: nowhere

    def describe(self) -> str:
        """Describe it in a line."""
        if self.finding:
            return f"differs: {self.finding}"
        return f"as in the phases, from event to event; states differ by {self.error:.1e} at most"


@dataclass(frozen=True, eq=False, repr=False)
class PhasedSolution:
    """A motion in phases that meets all constraints and, by the solver's word, cannot be made cheaper nearby."""

    name: str
    names: tuple[str, ...]  # of the phases
    phases: tuple[Solution, ...]
    links: tuple[Link, ...]
    values: tuple[LinkValues, ...]  # of the links
    run: Run
    size: Size
    constants: tuple[tuple[str, float], ...] = ()
    unknowns: tuple[Unknown, ...] = ()
    unknown_values: tuple[float, ...] = ()
    solver: SolverOptions = field(default_factory=SolverOptions)
    search: Starts | None = None  # the outcomes of all starts, of a search from many
    sensitivities: tuple[tuple[str, float], ...] = ()  # of the cost, by differentiated parameters of the models
    followed: tuple[Followed, ...] = ()  # of phases with modes

    def __repr__(self) -> str:
        """Return the phases, the solver's word and the cost."""
        return f"PhasedSolution({self.name}: {', '.join(self.names)}: {self.run.status}, cost {self.cost:.10g})"

    @property
    def problem(self) -> PhasedProblem:
        """Return the problem."""
        phases = tuple(Phase(name, own.problem) for name, own in zip(self.names, self.phases, strict=True))
        return PhasedProblem(self.name, phases, self.links, self.constants, self.unknowns, self.solver)

    @property
    def cost(self) -> float:
        """Sum the costs of the phases and links."""
        links = sum(value for link in self.values for _, value in link.terms)
        return sum(phase.cost.total for phase in self.phases) + links

    @property
    def durations(self) -> tuple[float, ...]:
        """Return the duration of each phase [s]."""
        return tuple(float(phase.trajectory.t[-1]) for phase in self.phases)

    @property
    def starts(self) -> tuple[float, ...]:
        """Return the time at which each phase starts: where the phase ends that an earlier link leads from, or 0."""
        found: list[float] = []
        for k, name in enumerate(self.names):
            before = [self.names.index(link.source) for link in self.links if link.target == name]
            earlier = [i for i in before if i < k]
            found.append(found[earlier[0]] + self.durations[earlier[0]] if earlier else 0.0)
        return tuple(found)

    @property
    def is_only_acceptable(self) -> bool:
        """Return whether the solver stopped short of its tolerance."""
        return self.run.status == ACCEPTABLE

    @property
    def single(self) -> Solution:
        """Return the solution of a problem without phases."""
        (own,) = self.phases
        return replace(own, run=self.run, starts=self.search, sensitivities=self.sensitivities)

    @property
    def guess(self) -> Guess:
        """Return what it found as a guess of another solve."""
        known = zip((unknown.name for unknown in self.unknowns), self.unknown_values, strict=True)
        return Guess(tuple(phase.trajectory for phase in self.phases), tuple(known))

    def with_solver(self, solver: SolverOptions) -> PhasedSolution:
        """Return the solution of the same problem with other options."""
        phases = (replace(phase, problem=replace(phase.problem, solver=solver)) for phase in self.phases)
        return replace(self, phases=tuple(phases), solver=solver)

    def find(self, name: str) -> Solution:
        """Return the solution of a phase."""
        return self.phases[self.names.index(name)]


def list_solution(solution: Solution) -> PhasedSolution:
    """Return the solution of a problem without phases as a list of one, which has no name."""
    problem, values = solution.problem, tuple(solution.trajectory.unknowns.tolist())
    return PhasedSolution(
        name=problem.name,
        names=("",),
        phases=(solution,),
        links=(),
        values=(),
        run=solution.run,
        size=solution.size,
        unknowns=problem.unknowns,
        unknown_values=values,
        solver=problem.solver,
        search=solution.starts,
        sensitivities=solution.sensitivities,
    )


@dataclass(frozen=True)
class Guess:
    """A trajectory for each phase, and values of unknowns by name."""

    trajectories: tuple[Trajectory, ...]
    unknowns: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class PartialGuess:
    """Trajectories of some phases, by name, and values of unknowns; a problem guesses the other phases by itself."""

    trajectories: tuple[tuple[str, Trajectory], ...] = ()
    unknowns: tuple[tuple[str, float], ...] = ()


OWN_GUESS = PartialGuess()


@dataclass(frozen=True, eq=False)
class _File:
    format: Literal["mbsrun phases 1"]
    solution: PhasedSolution


@cache
def _adapter() -> TypeAdapter[_File]:
    """Return what reads and writes files, built at its first use: that takes long."""
    return TypeAdapter(_File)


def write_phased_solution(solution: PhasedSolution, path: Path) -> None:
    """Write a solution to a file."""
    path.write_text(dump_phased_solution(solution), encoding="utf-8")


def dump_phased_solution(solution: PhasedSolution) -> str:
    """Return the text of a solution's file, one line for each of its parts."""
    parts = _adapter().dump_python(_File(FORMAT, solution), mode="json")["solution"]
    phases = parts.pop("phases")
    for key in ("sensitivities", "followed"):
        if not getattr(solution, key):
            del parts[key]
    lines = [f'  "{key}": {json.dumps(value, ensure_ascii=False)}' for key, value in parts.items()]
    inner = [
        "   {\n"
        + ",\n".join(f'    "{key}": {json.dumps(x, ensure_ascii=False)}' for key, x in phase.items())
        + "\n   }"
        for phase in phases
    ]
    lines.append('  "phases": [\n' + ",\n".join(inner) + "\n  ]")
    return join_parts(FORMAT, lines)


def read_phased_solution(path: Path) -> PhasedSolution:
    """Read a solution back. Raises InputError for a file that is not one."""
    return read_file(_adapter(), path, "solve the problem of phases again").solution


def read_phased_guess(path: Path, names: tuple[str, ...], manifests: tuple[Manifest, ...]) -> Guess:
    """Read the motions of a solution, to start from. Raises InputError for other phases or mechanisms."""
    solution = read_phased_solution(path)
    faults = [Fault(str(path), 0, "", *misfit) for misfit in list_phased_misfits(solution, names, manifests)]
    if faults:
        raise InputError(faults)
    return pick_guess(solution, names)


def pick_guess(solution: PhasedSolution, names: tuple[str, ...]) -> Guess:
    """Return the motions of phases, to start from."""
    return replace(solution.guess, trajectories=tuple(solution.find(name).trajectory for name in names))


def list_phased_misfits(
    solution: PhasedSolution, names: tuple[str, ...], manifests: tuple[Manifest, ...]
) -> Iterator[tuple[str, str]]:
    """List what keeps a solution from being a guess for phases of these mechanisms, each with a remedy."""
    for name, manifest in zip(names, manifests, strict=True):
        if name not in solution.names:
            finding = f"it has the phases {', '.join(solution.names)}, and none of the name {name}"
            yield finding, "give a solution with the same phases"
            continue
        for misfit in list_misfits(solution.find(name), manifest):
            yield f"phase {name}: {misfit}", "give a solution for these mechanisms"
