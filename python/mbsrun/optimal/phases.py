"""Problems in phases in Python: values and names, with the keys and the checks of a problem file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import casadi as ca
import numpy as np

from mbsgen.documents import Data
from mbsrun.external import load_on_demand
from mbsrun.ocp.cases.cases import AnyCase, Case, Outcome
from mbsrun.ocp.cases.programs import Programs
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.guessing.recorded_phases import find_phased_guess
from mbsrun.ocp.methods import choose
from mbsrun.ocp.problem.phases import Link, PhasedProblem, Plants, equip_phases
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.searching.refinement import refine_phases
from mbsrun.ocp.showing.files import shift_phases
from mbsrun.ocp.showing.phase_summary import list_phased_shortcomings, summarise_phases
from mbsrun.ocp.solution.phases import (
    Guess,
    LinkValues,
    PartialGuess,
    PhasedSolution,
    list_phased_misfits,
    pick_guess,
    read_phased_guess,
    read_phased_solution,
    write_phased_solution,
)
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.phases import resimulate_phases, solve_phases
from mbsrun.ocp.solving.runs import Watch
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phase_checks import check_phases
from mbsrun.ocp.statement.phases import state_phases
from mbsrun.optimal import display
from mbsrun.optimal.continuation import Continued, Stop, follow
from mbsrun.optimal.derivatives import Derivatives, differentiate_solution
from mbsrun.optimal.describing import describe_problem
from mbsrun.optimal.display import Page, Picture
from mbsrun.optimal.expressions import Expressions, Stretch, check_stretch
from mbsrun.optimal.guessing import GuessLike, read_motion
from mbsrun.optimal.many import Family, Over, Show, SolvedMany, Way, solve_family
from mbsrun.optimal.naming import Numbered, Source
from mbsrun.optimal.plain import make_plain, merge
from mbsrun.optimal.progress import show_progress
from mbsrun.optimal.quantities import Quantities
from mbsrun.optimal.result import Solved, Unsolved, import_pandas
from mbsrun.quantities import list_quantities
from mbsrun.recordings import references
from mbsrun.results import UnknownNameError


def load(path: Path) -> Plant:
    """Load a model."""
    return load_on_demand(path)


@dataclass(frozen=True, eq=False, repr=False)
class SolvedPhases:
    """A solution in phases: `solution["stance"]` is the solution of a phase, whose times follow the phases before."""

    solution: PhasedSolution
    plants: Plants
    is_solved: bool = field(default=True, init=False)

    @property
    def status(self) -> str:
        """Return the solver's word."""
        return self.solution.run.status

    @property
    def cost(self) -> float:
        """Return the whole cost."""
        return self.solution.cost

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the phases."""
        return self.solution.names

    @property
    def durations(self) -> MappingProxyType[str, float]:
        """Return the duration of each phase."""
        return MappingProxyType(dict(zip(self.names, self.solution.durations, strict=True)))

    @property
    def unknowns(self) -> MappingProxyType[str, float]:
        """Return the numbers that the solver chose, by name."""
        names = [unknown.name for unknown in self.solution.unknowns]
        return MappingProxyType(dict(zip(names, self.solution.unknown_values, strict=True)))

    @property
    def links(self) -> tuple[LinkValues, ...]:
        """Return the numbers of the links, such as impulses."""
        return self.solution.values

    @property
    def shortcomings(self) -> list[str]:
        """List the shortcomings of the solution; none in a good one."""
        return list_phased_shortcomings(self.solution)

    def __getitem__(self, phase: str) -> Solved:
        """Return the solution of a phase. Raises UnknownNameError."""
        if phase not in self.names:
            raise UnknownNameError(f"the solution has no phase {phase!r}; there are {', '.join(self.names)}")
        return self._phases[self.names.index(phase)]

    def save(self, path: str | Path) -> None:
        """Write the file that `PhasedControl.load` and `mbsrun solve --guess` read."""
        write_phased_solution(self.solution, Path(path))

    def to_frame(self) -> Any:
        """Return all phases in sequence as a pandas frame, indexed by time; the first column is the phase's name.

        What a phase does not have is not a number there. Raises MissingPackageError without pandas.
        """
        pandas, phases = import_pandas(), [self[name] for name in self.names]
        sizes = [phase.t.size for phase in phases]
        columns: dict[str, Any] = {"phase": np.repeat(self.names, sizes)}
        for name in dict.fromkeys(name for phase in phases for name in phase.names if name != "t"):
            parts = (phase[name] if name in phase.names else np.full(phase.t.size, np.nan) for phase in phases)
            columns[name] = np.concatenate([*parts])
        return pandas.DataFrame(columns, index=pandas.Index(np.concatenate([x.t for x in phases]), name="t"))

    def plot(self) -> Picture:
        """Plot coordinates, velocities and inputs of all phases over time."""
        from mbsrun.ocp.showing.phase_pictures import make_phased_trajectories

        return Picture(make_phased_trajectories(self.solution, self._shifted, self.plants))

    def draw(self) -> Picture:
        """Draw the mechanisms of all phases on their way."""
        from mbsrun.ocp.showing.phase_pictures import make_phased_mechanism

        return Picture(make_phased_mechanism(self.solution, self._shifted, self.plants))

    def animate(self) -> Page:
        """Return a page that plays all phases. Raises ProblemError where they do not follow each other."""
        from mbsrun.ocp.showing.phase_pictures import make_animations

        pages = make_animations(self.solution, self._shifted, self.plants)
        if len(pages) != 1:
            finding = "the phases do not follow each other"
            raise ProblemError(self.solution.name, [("animate", finding, "animate each phase, as solution[name]")])
        return Page(next(iter(pages.values())))

    def __repr__(self) -> str:
        return "\n".join([display.write_text("solved", summarise_phases(self.solution)), *self.shortcomings])

    def _repr_html_(self) -> str:
        return display.write_table("solved", summarise_phases(self.solution), tuple(self.shortcomings))

    @cached_property
    def _shifted(self) -> list[Any]:
        return shift_phases(self.solution)

    @cached_property
    def _phases(self) -> list[Solved]:
        return [Solved(own, plant) for own, plant in zip(self._shifted, self.plants.phases, strict=True)]


PhasedGuess = SolvedPhases | Guess | Mapping[str, GuessLike] | str | Path


@dataclass(frozen=True, eq=False, repr=False)
class PhasedControl(Numbered):
    """A problem in phases and its models. It does not change: `with_...` returns a changed copy."""

    value: PhasedProblem
    plants: Plants
    data: Mapping[str, Data]  # as a problem file holds it
    folder: Path  # that files of the problem are relative to
    expressions: Mapping[str, Expressions] = field(default_factory=dict)  # in CasADi, by phase
    programs: Programs = field(default_factory=Programs)

    @property
    def name(self) -> str:
        """Return the name, which pictures and files show."""
        return self.value.name

    def with_changes(self, **changes: Any) -> PhasedControl:
        """Return a copy with other values of some keys, as `OptimalControl.with_changes` does; lists are replaced."""
        return self._restate(merge(self.data, make_plain(self.name, changes)))

    def with_phase(self, name: str, **changes: Any) -> PhasedControl:
        """Return a copy with other values of some keys of a phase. Raises ProblemError."""
        self._find(name)
        phases = self.data.get("phases")
        parts = [part if isinstance(part, dict) else {} for part in phases] if isinstance(phases, list) else []
        if not parts:
            return self.with_changes(**changes)
        plain = make_plain(self.name, changes)
        changed: list[Data] = [merge(part, plain) if part.get("name") == name else part for part in parts]
        return self._restate({**self.data, "phases": changed})

    def with_cost(
        self, phase: str, expression: Any, weight: Any = 1.0, *, at: Stretch = "path", name: str = ""
    ) -> PhasedControl:
        """Return a copy with another term of the cost of a phase, an expression in symbols of `quantities(phase)`.

        Inputs of the phase cost nothing beside it unless its `cost.inputs` gives a weight. Raises ProblemError.
        """
        check_stretch(at, self.name)
        own = self._expressions_of(phase).with_cost(expression, weight, at, name, self.name)
        return self._restate(self.data, {**self.expressions, phase: own})

    def with_constraint(
        self,
        phase: str,
        expression: Any,
        lower: Any = -math.inf,
        upper: Any = math.inf,
        *,
        at: Literal["start", "path", "end"] = "path",
        name: str = "",
    ) -> PhasedControl:
        """Return a copy with another constraint of a phase: lower <= expression <= upper for each entry.

        The expression is in symbols of `quantities(phase)`. Raises ProblemError.
        """
        own = self._expressions_of(phase).with_constraint(expression, lower, upper, at, name, self.name)
        return self._restate(self.data, {**self.expressions, phase: own})

    def quantities(self, phase: str, symbols: type[Any] = ca.SX) -> Quantities:
        """Return the quantities of a phase as CasADi symbols by name, as `OptimalControl.quantities` does."""
        k = self._find(phase)
        own, manifest = self.value.phases[k].problem, self.plants.phases[k].manifest
        constants = [name for name, _ in self.value.constants]
        numbers = (*constants, *references.list_names(own.references))
        known = list_quantities(manifest, own.added)
        return Quantities(manifest, known, numbers, self._find_model(phase), dict(own.parameters), symbols)

    def with_constants(self, **constants: Any) -> PhasedControl:
        """Return a copy with other values of constants."""
        return self.with_changes(constants=constants)

    def with_solver(self, method: str, **settings: Any) -> PhasedControl:
        """Return a copy for another NLP method, with its tolerance, max_iterations and options."""
        return self._restate({**self.data, "solver": {"method": method, **make_plain(self.name, settings)}})

    def _restate(self, data: Mapping[str, Data], expressions: Mapping[str, Expressions] | None = None) -> PhasedControl:
        made = make_phases(data, self.name, self.folder, self.expressions if expressions is None else expressions)
        return replace(made, programs=self.programs)

    def _find(self, phase: str) -> int:
        """Return the number of a phase. Raises ProblemError."""
        known = [own.name for own in self.value.phases]
        if phase not in known:
            raise ProblemError(self.name, [("phases", f"there is no phase {phase!r}", f"there are {', '.join(known)}")])
        return known.index(phase)

    def _expressions_of(self, phase: str) -> Expressions:
        self._find(phase)
        return self.expressions.get(phase, Expressions())

    def _find_model(self, phase: str) -> Path | None:
        """Return the model file of a phase: its own, or the one of all phases."""
        phases = self.data.get("phases")
        parts: list[Mapping[str, Data]] = [
            part for part in (phases if isinstance(phases, list) else []) if isinstance(part, dict)
        ]
        own = next((part for part in parts if part.get("name") == phase and "model" in part), self.data)
        model = own.get("model")
        return self.folder / model if isinstance(model, str) else None

    def solve(
        self,
        *,
        watch: Watch | bool = False,
        guess: PhasedGuess | None = None,
        check: bool = True,
    ) -> SolvedPhases | Unsolved:
        """Solve the problem; re-simulate every phase, and refine its grid if asked, unless `check` is False.

        `guess` may be guesses of phases by their names, each as `OptimalControl.solve` takes one; other phases are
        guessed as the problem says. A folder stands for a table NAME.csv of each phase. See `OptimalControl.solve`.
        """
        with show_progress() if watch is True else nullcontext(watch or None) as shown:
            outcome = solve_phases(self.value, self.plants, shown, self._find_guess(guess), self.programs.find)
            if isinstance(outcome, Failure):
                return Unsolved(outcome)
            plants = equip_phases(self.value, self.plants)
            if check:
                outcome = resimulate_phases(outcome, plants)
                if any(phase.problem.refine is not None for phase in self.value.phases):
                    outcome = refine_phases(outcome, plants, watch=shown)
        return SolvedPhases(outcome, plants)

    def solve_many(
        self,
        over: Over,
        *,
        guesses: Sequence[PhasedGuess | None] | None = None,
        threads: int = 1,
        neighbours: bool = False,
        watch: Show | None = None,
        check: bool = True,
    ) -> SolvedMany:
        """Solve the problem for many values of its keys, as `OptimalControl.solve_many` does.

        A key of a phase is `phases[0].horizon`, by its place in the list.
        """
        return solve_family(self.family, over, guesses, Way(threads, neighbours, check), watch)

    @property
    def family(self) -> Family:
        """Return how the problem becomes cases with other values of its keys."""

        def state(copy: PhasedControl, guess: PhasedGuess | None, check: bool) -> Case:
            return Case(copy.value, copy._find_guess(guess), check)

        def read(case: AnyCase, outcome: Outcome) -> SolvedPhases | Unsolved:
            if isinstance(outcome, Failure):
                return Unsolved(outcome)
            return SolvedPhases(outcome, equip_phases(case.problem, self.plants))

        return Family(self.name, self.data, self.plants, self._restate, state, read, self.programs)

    def continue_to(
        self, name: str, value: float, *, guess: PhasedGuess | None = None, watch: Callable[[Stop], None] | None = None
    ) -> Continued:
        """Solve the problem, and go on to another value of a number, from each solution to the next.

        `watch` sees every solve on the way. Raises ProblemError for a name that is no number.
        """
        return follow(self, name, value, guess, watch)

    def with_numbers(self, numbers: Mapping[str, float]) -> PhasedControl:
        """Return a copy with other values of numbers, by the names of `numbers`. Raises ProblemError."""
        return self._restate(self._source.put(numbers), self.expressions)

    def derivatives(self, solution: SolvedPhases | Unsolved, by: Sequence[str] | None = None) -> Derivatives:
        """Return how a solution of this problem moves with its numbers, as `OptimalControl.derivatives` does."""
        return differentiate_solution(self._source, solution.solution, self.plants, by, self.programs.find)

    @property
    def _source(self) -> Source:
        designs = {
            f"parameters.{p.name}": plant.parameters[p.name]
            for plant in self.plants.every
            for p in plant.manifest.design
        }

        def state(data: Mapping[str, Data]) -> PhasedProblem:
            return self._restate(data, self.expressions).value

        return Source(self.name, self.data, designs, state)

    def load(self, path: str | Path) -> SolvedPhases:
        """Read a solution of this problem's models from a file. Raises InputError for a file that is not one."""
        names = tuple(phase.name for phase in self.value.phases)
        read_phased_guess(Path(path), names, tuple(plant.manifest for plant in self.plants.phases))
        return SolvedPhases(read_phased_solution(Path(path)), self.plants)

    def describe(self) -> dict[str, str]:
        """Return the parts of the problem by their names."""
        rows: dict[str, str] = {}
        for phase, plant in zip(self.value.phases, self.plants.phases, strict=True):
            own = describe_problem(phase.problem, plant.manifest)
            own.pop("solver")
            rows |= {f"{phase.name}: {key}": text for key, text in own.items()}
        for link in self.value.links:
            rows[f"{link.source} to {link.target}"] = _describe_link(link)
        solver = self.value.solver
        called = any(phase.problem.functions for phase in self.value.phases)
        return rows | {"solver": f"{choose(solver, calls_casadi=called)}, tolerance {solver.tolerance:g}"}

    def __repr__(self) -> str:
        return display.write_text(f"problem {self.name}", self.describe())

    def _repr_html_(self) -> str:
        return display.write_table(f"problem {self.name}", self.describe())

    def _find_guess(self, guess: PhasedGuess | None) -> Guess | PartialGuess:
        match guess:
            case SolvedPhases():
                names = tuple(phase.name for phase in self.value.phases)
                manifests = tuple(plant.manifest for plant in equip_phases(self.value, self.plants).phases)
                misfits = [("guess", *misfit) for misfit in list_phased_misfits(guess.solution, names, manifests)]
                if misfits:
                    raise ProblemError(self.name, misfits)
                return pick_guess(guess.solution, names)
            case Guess():
                return guess
            case Mapping():
                return self._find_guesses(guess)
            case None | str() | Path():
                return find_phased_guess(self.value, self.plants, self.folder, None if guess is None else Path(guess))
        remedy = "give a solution of these phases, a file, a folder, or guesses by the names of phases"
        raise ProblemError(self.name, [("guess", f"found a value of type {type(guess).__name__}", remedy)])

    def _find_guesses(self, guesses: Mapping[str, GuessLike]) -> PartialGuess:
        """Return the motions of some phases. Raises ProblemError for a name that no phase has."""
        plants, found = equip_phases(self.value, self.plants).phases, []
        for name, guess in guesses.items():
            k = self._find(name)
            found.append((name, read_motion(guess, self.value.phases[k].problem, plants[k])))
        return PartialGuess(tuple(found))


@dataclass(frozen=True)
class _Extension:
    """The expressions of a phase, which its data do not hold."""

    expressions: Expressions

    @property
    def reads(self) -> frozenset[str]:
        """Return the names that the expressions read."""
        return self.expressions.reads

    def extend(self, problem: Problem, data: Data) -> Problem:
        """Add the expressions."""
        cost = data.get("cost") if isinstance(data, dict) else None
        return self.expressions.extend(problem, prices_inputs=isinstance(cost, dict) and bool(cost.get("inputs")))


def make_phases(
    data: Mapping[str, Data], name: str, folder: Path, expressions: Mapping[str, Expressions] = MappingProxyType({})
) -> PhasedControl:
    """Make a problem in phases of its data, and of expressions in CasADi by phase. Raises ProblemError, InputError."""
    extensions = {phase: _Extension(own) for phase, own in expressions.items()}
    value, plants = state_phases(data, name, folder, load, extensions)
    if expressions:
        check_phases(value, plants)
    return PhasedControl(value, plants, data, folder, MappingProxyType({**expressions}))


def _describe_link(link: Link) -> str:
    """Describe the transfer of states, an impact, and conditions."""
    parts = [f"{name} = {text}" for name, text in (*link.map, *link.velocities) if text is not None]
    if link.impact is not None:
        contacts = ", ".join(contact.sensor for contact in link.impact.contacts)
        parts.append(f"impact of {contacts}, restitution {link.impact.restitution:g}")
    parts += [condition.expression for condition in link.conditions]
    parts += [f"cost {term.weight:g} * {term.expression}" for term in link.cost]
    return "; ".join(parts) or "the state goes on"
