"""A problem of several phases, as a value; `statement` reads it from a file.

    minimise    the sum of the phases' costs + w cost(x_from(T), x_to(0)) for every link
    subject to  the constraints of every phase,
                x_to(0) = map(x_from(T)), where an impact may change the velocities first, and
                lower <= condition(x_from(T), x_to(0)) <= upper            for every link

Each phase is a separate problem, with a model, horizon, grid, bounds and cost. A link leads from the end of one
phase to the start of another one, or of the same one, which makes a motion periodic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Contact, Loops, Problem, Range, SolverName, SolverOptions, Term, Unknown


@dataclass(frozen=True)
class Phase:
    """A part of a motion: its name, and its problem, whose solver options are not used."""

    name: str  # empty: the one phase of a problem without phases
    problem: Problem

    @property
    def title(self) -> str:
        """Return how a finding begins that is of this phase."""
        return f"phase {self.name}: " if self.name else ""

    def with_loops(self, loops: Loops | None) -> Phase:
        """Return the phase with a form of its loops, where it leaves that open."""
        if loops is None or self.problem.loops is not None:
            return self
        return replace(self, problem=replace(self.problem, loops=loops))


@dataclass(frozen=True)
class Condition:
    """An expression of the states on both sides of a link that stays within a range."""

    expression: str
    range: Range


Map = tuple[tuple[str, str | None], ...]  # a coordinate, and its value as an expression; None: it is free


@dataclass(frozen=True)
class Blow:
    """A joint that hits a rigid stop, or rests at it, in an impact."""

    index: int  # into qd
    joint: str
    signal: str  # the force of the stop, in the direction of q
    is_lower: bool
    restitution: float = 0.0


@dataclass(frozen=True)
class Impact:
    """An instant at which contacts and stops change the velocities by impulses, and no coordinate changes."""

    contacts: tuple[Contact, ...]
    restitution: float = 0.0  # of velocities along the contacts' normals; across, the contacts stick
    map: Map = ()  # coordinates of the impact's model, where it is not the one of the phase before
    blows: tuple[Blow, ...] = ()  # of joints at stops


@dataclass(frozen=True)
class Link:
    """A tie of the start of a phase to the end of another."""

    source: str  # the phase that ends
    target: str  # the phase that starts
    map: Map = ()  # coordinates of `target` by coordinates of `source`; others keep the values of equal names
    velocities: Map = ()  # velocities, where they are not the time derivatives of `map`
    impact: Impact | None = None
    conditions: tuple[Condition, ...] = ()
    cost: tuple[Term, ...] = ()  # expressions of both sides


@dataclass(frozen=True, repr=False)
class PhasedProblem:
    """Everything that a solve needs, beside the models."""

    name: str
    phases: tuple[Phase, ...]
    links: tuple[Link, ...] = ()
    constants: tuple[tuple[str, float], ...] = ()  # that links read
    unknowns: tuple[Unknown, ...] = ()  # that links read, beside the ones of phases; all share them by name
    solver: SolverOptions = field(default_factory=SolverOptions)

    def __repr__(self) -> str:
        """Return the name and the phases."""
        return f"PhasedProblem({self.name}: {', '.join(phase.name for phase in self.phases)})"

    def find(self, name: str) -> int:
        """Return the number of a phase."""
        return [phase.name for phase in self.phases].index(name)

    @property
    def is_single(self) -> bool:
        """Return whether it is a problem without phases."""
        return len(self.phases) == 1 and not self.phases[0].name

    def with_solver(self, method: SolverName) -> PhasedProblem:
        """Return the same problem for an NLP method; another method drops the options of the former one."""
        return replace(self, solver=self.solver.with_method(method))

    def change(self, change: Callable[[Problem], Problem]) -> PhasedProblem:
        """Return the same problem with other phases."""
        return replace(self, phases=tuple(replace(phase, problem=change(phase.problem)) for phase in self.phases))

    @property
    def every_unknown(self) -> tuple[Unknown, ...]:
        """List the unknowns of links and phases, each name once."""
        found = {unknown.name: unknown for unknown in self.unknowns}
        for phase in self.phases:
            for unknown in phase.problem.unknowns:
                found.setdefault(unknown.name, unknown)
        return tuple(found.values())

    @property
    def weight(self) -> float:
        """Return the largest weight of the costs."""
        own = (abs(w) for phase in self.phases for w in phase.problem.cost.weights)
        return max((*own, *(abs(term.weight) for link in self.links for term in link.cost)), default=0.0)


def list_one(problem: Problem) -> PhasedProblem:
    """Return a problem without phases as a list of one, which has no name."""
    return PhasedProblem(problem.name, (Phase("", problem),), solver=problem.solver)


@dataclass(frozen=True)
class Plants:
    """The kernels of a problem's models."""

    phases: tuple[Plant, ...]  # of each phase
    impacts: tuple[Plant | None, ...] = ()  # of each link; None: no impact, or the model of the phase before

    @property
    def every(self) -> tuple[Plant, ...]:
        """List the plants, each once."""
        found: list[Plant] = []
        for plant in (*self.phases, *self.impacts):
            if plant is not None and not any(plant is other for other in found):
                found.append(plant)
        return tuple(found)

    def number(self, plant: Plant) -> int:
        """Return the number of a plant among all."""
        return next(i for i, other in enumerate(self.every) if other is plant)

    def find_impact(self, link: int, source: int) -> Plant:
        """Return the plant of a link's impact."""
        own = self.impacts[link] if link < len(self.impacts) else None
        return self.phases[source] if own is None else own


def equip_phases(problem: PhasedProblem, plants: Plants) -> Plants:
    """Return the kernels with the parameters of each phase; equal ones stay one plant.

    An impact with a separate model takes the parameters of the phase before it, if it has them.
    """
    known: list[tuple[Plant, tuple[tuple[str, float], ...], Plant]] = []
    guesses = tuple((unknown.name, unknown.guess) for unknown in problem.every_unknown)

    def change(plant: Plant, own: Problem) -> Plant:
        given = tuple((name, value) for name, value in (*guesses, *own.parameters) if name in plant.parameters)
        for other, values, equipped in known:
            if other is plant and values == given:
                return equipped
        changes = {name: value for name, value in given if plant.parameters[name] != value}
        known.append((plant, given, plant.with_parameters(**changes) if changes else plant))
        return known[-1][2]

    phases = tuple(change(plant, phase.problem) for plant, phase in zip(plants.phases, problem.phases, strict=True))
    sources = [problem.phases[problem.find(link.source)].problem for link in problem.links]
    impacts = zip(plants.impacts, sources, strict=False)
    return Plants(phases, tuple(None if plant is None else change(plant, own) for plant, own in impacts))
