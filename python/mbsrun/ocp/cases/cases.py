"""Many problems of the same models: cases -> outcomes, with one program for each structure.

A case is solved from its own guess and knows nothing of the others: neither their order nor the number of threads or
processes changes a result. A case that has no solution, or that its kernels contradict, fails alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from mbsrun.ocp.cases.placing import Placing, crosses, find_placing
from mbsrun.ocp.cases.programs import Programs
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.status import BAD_PROBLEM
from mbsrun.ocp.problem.phases import PhasedProblem, Plants, equip_phases
from mbsrun.ocp.searching.refinement import refine_phases
from mbsrun.ocp.solution.phases import Guess, PartialGuess, PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Run
from mbsrun.ocp.solving.nearby import Late, NearAnswer, NearStart, solve_all_near
from mbsrun.ocp.solving.phases import (
    Neighbour,
    Note,
    PhasedSolver,
    prepare_near,
    resimulate_phases,
    solve_phases,
)
from mbsrun.ocp.statement.checks import ProblemError

Outcome = PhasedSolution | Failure
Found = Outcome | Late  # which is read when somebody asks for it


@dataclass(frozen=True, eq=False)
class Case:
    """A problem and what it starts from."""

    problem: PhasedProblem
    guess: Guess | PartialGuess | None = None  # None: the one that the problem describes
    is_checked: bool = True  # its solution is re-simulated, and refined if the problem asks for that


@dataclass(frozen=True, eq=False)
class Form:
    """Stated cases of one kind, and their numbers (cases, n)."""

    cases: tuple[Case, ...]
    numbers: Array


@dataclass(frozen=True, eq=False)
class LateCase:
    """A case that is stated when somebody needs more than its numbers; see `placing`."""

    form: Form
    numbers: Array  # (n,)
    state: Callable[[], Case]
    is_checked: bool

    @cached_property
    def case(self) -> Case:
        """Return the stated case. Raises ProblemError."""
        return self.state()

    @property
    def problem(self) -> PhasedProblem:
        """Return its problem. Raises ProblemError."""
        return self.case.problem

    @property
    def guess(self) -> Guess | PartialGuess | None:
        """Return what it starts from. Raises ProblemError."""
        return self.case.guess


AnyCase = Case | LateCase


@dataclass(frozen=True, eq=False)
class Try:
    """A case, and the solution that it starts from."""

    case: AnyCase
    own: Neighbour
    most_iterations: int


@dataclass(frozen=True, eq=False)
class Near:
    """The solution of a start from neighbours, and itself as a start of others."""

    found: Found
    neighbour: Neighbour | None


def read(found: Found) -> Outcome:
    """Return an outcome with its motions."""
    return found.solution if isinstance(found, Late) else found


@dataclass(frozen=True, eq=False)
class CaseSolver:
    """Solves cases of some models, one after the other."""

    plants: Plants
    programs: Programs = field(default_factory=Programs)
    placings: dict[int, tuple[Form, Placing | None]] = field(default_factory=dict)  # by the identity of their form

    def solve(self, case: AnyCase, note: Note | None = None) -> Outcome:
        """Solve a case; its faults are a failure, too. `note` gets a solution from which neighbours may start."""
        problem = case.form.cases[0].problem if isinstance(case, LateCase) else case.problem
        try:
            problem = case.problem
            found = solve_phases(problem, self.plants, None, case.guess, self.programs.find, note)
            return read(self._check(case, found))
        except ProblemError as error:
            place, finding, remedy = error.findings[0]
            return Failure(problem, Run(BAD_PROBLEM, 0, 0.0, 0.0), finding, remedy, place)

    def solve_near(self, tries: Sequence[Try], threads: int = 1) -> list[Near | None]:
        """Solve cases from neighbours' solutions; None where that does not succeed soon."""
        found: list[Near | None] = [None] * len(tries)
        groups: dict[int, tuple[PhasedSolver, list[int], list[NearStart]]] = {}
        ready = self._place_all(tries)
        for k, one in enumerate(tries):
            known = ready[k] if k in ready else self._prepare(one)
            if known is not None:
                _, numbers, starts = groups.setdefault(id(known[0]), (known[0], [], []))
                numbers.append(k)
                starts.append(known[1])
        for solver, numbers, starts in groups.values():
            for k, answer in zip(numbers, self._try(solver, starts, threads), strict=True):
                if answer is not None:
                    found[k] = Near(self._check(tries[k].case, answer.found), answer.neighbour)
        return found

    def _prepare(self, one: Try) -> tuple[PhasedSolver, NearStart] | None:
        """State a case for a start from a neighbour; None where that is no use."""
        try:
            ready = prepare_near(one.case.problem, self.plants, one.own, self.programs.find)
        except ProblemError:
            return None
        if isinstance(ready, Failure):
            return None
        return ready.solver, NearStart(ready.problem, one.own, one.most_iterations)

    def _place_all(self, tries: Sequence[Try]) -> dict[int, tuple[PhasedSolver, NearStart]]:
        """Place the numbers of cases that are not stated, as far as that goes; by the numbers of their tries."""
        forms: dict[int, tuple[Form, list[int], list[LateCase]]] = {}
        for k, one in enumerate(tries):
            if isinstance(one.case, LateCase):
                _, numbers, cases = forms.setdefault(id(one.case.form), (one.case.form, [], []))
                numbers.append(k)
                cases.append(one.case)
        found = dict[int, tuple[PhasedSolver, NearStart]]()
        for form, numbers, cases in forms.values():
            own = [tries[k].own for k in numbers]
            placing = self._find_placing(form, own[0])
            if placing is None:
                continue
            most = [tries[k].most_iterations for k in numbers]
            placed = placing.place(np.stack([case.numbers for case in cases]), own, most)
            for k, case, instance in zip(numbers, cases, placed, strict=True):
                if not crosses(instance):
                    state = partial(getattr, case, "problem")
                    found[k] = (
                        placing.solver,
                        NearStart(placing.problem, tries[k].own, tries[k].most_iterations, instance, state),
                    )
        return found

    def _find_placing(self, form: Form, own: Neighbour) -> Placing | None:
        """Find where the numbers of a form are, once."""
        if id(form) not in self.placings:
            problems = [case.problem for case in form.cases]
            try:
                placing = find_placing(problems, form.numbers, own, self.plants, self.programs.find)
            except ProblemError:
                placing = None
            self.placings[id(form)] = form, placing
        return self.placings[id(form)][1]

    def _try(self, solver: PhasedSolver, starts: Sequence[NearStart], threads: int) -> list[NearAnswer | None]:
        """Solve problems of one structure from neighbours; one with faults ends none of the others."""
        try:
            return solve_all_near(solver, starts, threads)
        except ProblemError:
            if len(starts) == 1:
                return [None]
            return [self._try(solver, [start], threads)[0] for start in starts]

    def _check(self, case: AnyCase, found: Found) -> Found:
        """Re-simulate a solution, and refine it if the problem asks for that, where the case is checked."""
        if isinstance(found, Failure) or not case.is_checked:
            return found
        found = read(found)
        assert isinstance(found, PhasedSolution), "it was judged"
        plants = equip_phases(case.problem, self.plants)
        found = resimulate_phases(found, plants)
        asks = any(phase.problem.refine is not None for phase in case.problem.phases)
        return refine_phases(found, plants) if asks else found


def solve_cases(
    cases: Sequence[AnyCase], plants: Plants, threads: int, programs: Programs | None = None
) -> Iterator[tuple[int, Outcome]]:
    """Solve cases, several at a time; yield the number and the outcome of each as it ends.

    One thread may have programs that were made before; each of several makes new ones. Cases that have not begun are
    dropped where the caller ends the iteration.
    """
    if threads == 1:
        solver = CaseSolver(plants, programs or Programs())
        yield from ((i, solver.solve(case)) for i, case in enumerate(cases))
        return
    own = threading.local()

    def begin() -> None:
        own.solver = CaseSolver(plants)

    with ThreadPoolExecutor(threads, initializer=begin) as pool:
        under_way = {pool.submit(lambda case: own.solver.solve(case), case): i for i, case in enumerate(cases)}
        try:
            for future in as_completed(under_way):
                yield under_way[future], future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
