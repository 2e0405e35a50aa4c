"""Problems of several phases, solved: PhasedProblem and plants -> PhasedSolution or PhasedFailure.

The phases are one program, which a method solves with exact derivatives. A search that does not converge ends in a
failure, which has no trajectories; it names the phases and links whose rows stay violated.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from copy import copy
from dataclasses import replace

import numpy as np

from mbsrun.ocp import methods
from mbsrun.ocp.assembly import find_other_assembly
from mbsrun.ocp.backends.numpy import evaluate
from mbsrun.ocp.backends.prepared import Prepared
from mbsrun.ocp.checks import Finding, ProblemError
from mbsrun.ocp.clashes import Found, Names, describe_point, name_parts, see_solver
from mbsrun.ocp.functions import Array
from mbsrun.ocp.judging import OTHER, Outcome, appeal, examine, tell_both, wants_other
from mbsrun.ocp.methods import METHODS, Order, Start
from mbsrun.ocp.phases.checks import check_phases, name_phase
from mbsrun.ocp.phases.guess import Unreached, adapt_guess, carry_states, guess_phases, solve_links
from mbsrun.ocp.phases.linking import Defined
from mbsrun.ocp.phases.polishing import Equations, polish
from mbsrun.ocp.phases.problem import Phase, PhasedProblem, Plants, equip_phases
from mbsrun.ocp.phases.solution import (
    OWN_GUESS,
    Guess,
    Impulse,
    LinkValues,
    PartialGuess,
    PhasedFailure,
    PhasedSolution,
)
from mbsrun.ocp.phases.transcription import PhasedTranscription, transcribe_phases
from mbsrun.ocp.problem import Loops, Problem, SolverOptions
from mbsrun.ocp.program import Matrix
from mbsrun.ocp.resimulation import resimulate
from mbsrun.ocp.singularities import Cause, find_cause
from mbsrun.ocp.solution import Run, Size
from mbsrun.ocp.solve import (
    OPENED,
    Values,
    Watch,
    call,
    describe_unreachable,
    find_crossed_bounds,
    find_jump,
    find_singular,
    find_wrong_states,
    make_solution,
    measure_excess,
    measure_size,
    report,
    search,
    settle,
)
from mbsrun.ocp.stages.binding import is_compiled
from mbsrun.ocp.state_guess import complete, guess_largest
from mbsrun.ocp.status import (
    ACCEPTABLE,
    BAD_BOUNDS,
    BAD_GUESS,
    ELSEWHERE,
    INVALID,
    JUMPED,
    OPEN,
    SOLVED,
    UNREACHABLE,
    NoNumbersError,
    explain,
)
from mbsrun.ocp.touching import list_relaxed
from mbsrun.ocp.trajectory import Trajectory

BALANCED = 1e-13  # residuals of links, relative to the largest change of a velocity, and absolute below 1


class PhasedSolver:
    """A transcribed problem of phases."""

    def __init__(self, problem: PhasedProblem, plants: Plants) -> None:
        """Transcribe a problem whose loops are settled. Raises ProblemError with every fault of it."""
        check_phases(problem, plants)
        self.problem, self.plants = problem, equip_phases(problem, plants)
        self.transcription: PhasedTranscription = transcribe_phases(problem, self.plants)
        self._options = self._choose_method()
        first, *others = self.plants.every
        self.program = Prepared(self.transcription.program, first, tuple(others))
        self._solvers: list[methods.Solver] = []  # one, once it is made

    def _choose_method(self) -> SolverOptions:
        """Choose the method, where none is given: IPOPT where links read what no stage has, or something is not in C.

        Raises ProblemError where the given method takes stages alone.
        """
        own, solver = self.transcription, self.problem.solver
        parts = [phase.problem for phase in self.problem.phases]
        calls_casadi = own.unstaged.size > 0 or any(
            part.functions or not is_compiled(plant, part.representation.equations.write(part.loops).kernel)
            for part, plant in zip(parts, self.plants.phases, strict=True)
        )
        method = methods.choose(solver, calls_casadi=calls_casadi)
        if METHODS[method].calls_casadi or not own.unstaged.size:
            return replace(solver, method=method)
        finding = f"{method} cannot read inputs at a start, accelerations or forces here"
        found = list(_list_unstaged(own)) or [("links", "")]
        findings = [(place, f"{finding}{text}", "take solver.method: ipopt") for place, text in found]
        raise ProblemError(self.problem.name, findings)

    def solve(self, guess: Guess, watch: Watch | None = None) -> PhasedSolution | PhasedFailure:
        """Solve from a guess on the grids of the phases; `watch` is called in every iteration.

        Contacts by complementarity are relaxed in steps; a step that fails is left out. Where `mbs` has no answer,
        IPOPT is asked, if the options permit it; the run says so.
        """
        first = self._solve_relaxed(guess, watch)
        if isinstance(first, PhasedSolution) or not wants_other(self.problem.solver, first.run):
            return first
        found = tell_both(first, self.with_solver(self.problem.solver.with_method(OTHER))._solve_relaxed(guess, watch))
        return replace(found, solver=self.problem.solver) if isinstance(found, PhasedSolution) else found

    def with_solver(self, solver: SolverOptions) -> PhasedSolver:
        """Return a solver of the same program by other options."""
        other = copy(self)
        other.problem = replace(self.problem, solver=solver)
        other._options, other._solvers = other._choose_method(), []
        return other

    def _solve_relaxed(self, guess: Guess, watch: Watch | None) -> PhasedSolution | PhasedFailure:
        usual = guess  # its sizes: an answer to a looser problem has none
        for phases in [*list_relaxed([phase.problem for phase in self.problem.phases])][:-1]:
            found = self._relax(phases)._solve(guess, watch, usual)
            if isinstance(found, PhasedSolution):
                known = zip((unknown.name for unknown in found.unknowns), found.unknown_values, strict=True)
                guess = Guess(tuple(phase.trajectory for phase in found.phases), tuple(known))
        return self._solve(guess, watch, usual)

    def _relax(self, phases: list[Problem]) -> PhasedSolver:
        """Return a solver of the same program for other ranges of constraints."""
        relaxed = copy(self)
        changed = zip(self.problem.phases, phases, strict=True)
        relaxed.problem = replace(self.problem, phases=tuple(replace(phase, problem=own) for phase, own in changed))
        return relaxed

    def _solve(self, guess: Guess, watch: Watch | None, usual: Guess) -> PhasedSolution | PhasedFailure:
        problem = self.problem
        for phase, plant in zip(problem.phases, self.plants.phases, strict=True):
            if crossed := find_crossed_bounds(phase.problem, plant.manifest):
                finding = f"phase {phase.name}: {crossed}"
                return PhasedFailure(problem, Run(BAD_BOUNDS, 0, 0.0, 0.0), finding, "give bounds that leave room")
        guess = self._complete(guess)
        x = self.transcription.pack(problem, guess)
        if not np.isfinite(x).all():
            finding = "the guess has numbers that are not finite"
            return PhasedFailure(problem, Run(BAD_GUESS, 0, 0.0, 0.0), finding, "take another guess")
        own = self.transcription
        defined = tuple(Defined(own.see(part.variables), own.see_rows(part.rows)) for part in own.defined)
        try:
            x = solve_links(x, defined, self._evaluate, self._differentiate)
        except NoNumbersError as lack:
            finding = f"the guess has no numbers: {lack}"
            return PhasedFailure(problem, Run(BAD_GUESS, 0, 0.0, 0.0), finding, "take another guess")
        scales = own.find_scales(own.pack(problem, self._complete(usual)), own.variable_bounds(problem))
        outcome = search(x, lambda x: self._call(self._find_method(), x, watch, scales))
        outcome = appeal(self.program, outcome, problem.solver, problem.weight)
        run, found = outcome.run, outcome.x
        if run.status not in (SOLVED, ACCEPTABLE) or not np.isfinite(found).all():
            has_model = any(plant.manifest.coordinates for plant in self.plants.phases)
            finding, remedy = explain(run.status, run.iterations, has_model=has_model)
            if named := self._find_cause(run, guess, found):
                finding = named.finding if run.status == INVALID else f"{finding}; {named.finding}"
                return PhasedFailure(problem, run, finding, named.remedy, named.place)
            clashing = self._name_violated(found)
            finding = f"{finding}: {clashing}" if clashing else finding
            if lost := self._find_singular(run, found):
                return PhasedFailure(problem, run, f"{finding}; {lost}", f"take loops: multipliers, or {remedy}")
            return PhasedFailure(problem, run, finding, remedy)
        try:
            run, found = self._balance_impacts(run, found)
            run, cause = examine(self.program, replace(outcome, run=run, x=found), problem.solver, problem.weight)
            solution = self._read(run, found)
        except NoNumbersError as lack:
            finding, remedy = explain(INVALID, run.iterations)
            return PhasedFailure(problem, replace(run, status=INVALID), f"{finding}, at the end: {lack}", remedy)
        for part in solution.phases:
            gap, most = part.violation.closure or 0.0, max(OPENED, problem.solver.tolerance)
            if gap > most:  # before other constraints, which open loops violate, too
                finding, remedy = explain(OPEN, run.iterations)
                finding = f"phase {part.problem.name}: {finding}, by {gap:.1e} of {most:.1e}"
                return PhasedFailure(problem, replace(run, status=OPEN), finding, remedy)
        if cause:
            finding, remedy = explain(run.status, run.iterations)
            return PhasedFailure(problem, run, f"{finding}, {cause}", remedy)
        for part, plant in zip(solution.phases, self.plants.phases, strict=True):
            for status, find in ((JUMPED, find_jump), (ELSEWHERE, find_other_assembly)):
                if cause := find(part, plant):
                    finding, remedy = explain(status, run.iterations)
                    finding = f"phase {part.problem.name}: {finding}; {cause}"
                    return PhasedFailure(problem, replace(run, status=status), finding, remedy)
        return solution

    def _find_cause(self, run: Run, guess: Guess, x: Array) -> Cause | None:
        """Find an expression of the first phase by which a search failed."""
        own, every = self.transcription, None
        try:
            every = self.program.numpy.complete(x) if np.isfinite(x).all() else None
        except ValueError:
            every = None
        ends = [None] * len(own.phases) if every is None else own.split(every)
        for phase, plant, motion, part, end in zip(
            self.problem.phases, self.plants.phases, guess.trajectories, own.phases, ends, strict=False
        ):
            ended = None if end is None else part.unpack(end)
            if cause := find_cause(phase.problem, plant, run, motion, ended):
                return replace(
                    cause, finding=f"phase {phase.name}: {cause.finding}", place=f"phase {phase.name}: {cause.place}"
                )
        return None

    def _find_singular(self, run: Run, x: Array) -> str:
        """Name the first phase whose reduced form does not determine the motion at which a search ended."""
        if not np.isfinite(x).all() or all(p.problem.loops is not Loops.REDUCED for p in self.problem.phases):
            return ""
        try:
            phases = self._read(run, x).phases
        except NoNumbersError:
            return ""
        for part, plant in zip(phases, self.plants.phases, strict=True):
            if lost := find_singular(part, plant):
                return f"phase {part.problem.name}: {lost}"
        return ""

    def _balance_impacts(self, run: Run, x: Array) -> tuple[Run, Array]:
        """Solve all equations to rounding where impulses do not balance the momentum to it; the run counts the time."""
        own, problem = self.transcription, self.problem
        impacts = [rows.impact for rows in own.links if rows.impact is not None]
        if not impacts:
            return run, x
        ranges = own.constraint_bounds(problem), own.variable_bounds(problem)
        g, first = self._evaluate(x), int(own.see_rows(np.array(own.offsets[-1].rows)))
        equal = ranges[0][0][first:] == ranges[0][1][first:]
        largest = max(np.abs(x[own.see(impact.changes)]).max() for impact in impacts)
        if np.abs((g - ranges[0][0])[first:][equal]).max() <= BALANCED * max(1.0, largest):
            return run, x
        begin, cpu_begin = time.perf_counter(), time.process_time()
        equations = Equations(self._evaluate, self._differentiate, *ranges)
        x = polish(x, equations, max(problem.solver.tolerance, equations.measure(x, g)))
        seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
        return replace(run, seconds=run.seconds + seconds, cpu_seconds=run.cpu_seconds + cpu_seconds), x

    def _complete(self, guess: Guess) -> Guess:
        """Guess the states, controls and unknowns that phases add."""
        known, largest = dict(guess.unknowns), dict[str, float]()
        given = zip(guess.trajectories, self.problem.phases, self.plants.phases, strict=True)
        completed: list[Trajectory] = []
        for k, (motion, phase, plant) in enumerate(given):
            values = [known.get(unknown.name, unknown.guess) for unknown in phase.problem.unknowns]
            own = carry_states(self.problem, k, completed, self.plants)
            motion = complete(replace(motion, unknowns=np.array(values)), own, plant)
            completed.append(motion)
            found = guess_largest(motion, phase.problem, plant).unknowns.tolist()
            for unknown, value in zip(phase.problem.unknowns, found, strict=True):
                if unknown.largest and unknown.name not in known:  # of phases that share it, the largest of all
                    largest[unknown.name] = max(value, largest.get(unknown.name, value))
        return Guess(tuple(completed), (*guess.unknowns, *largest.items()))

    def _evaluate(self, x: Array) -> Array:
        parameters = self.transcription.parameters(self.problem)
        return evaluate(self.program.numpy.constraint, x, parameters)

    def _differentiate(self, x: Array) -> Matrix:
        found = self.program.numpy.jacobian(x, self.transcription.parameters(self.problem))
        if not np.isfinite(found.data).all():
            raise NoNumbersError("a derivative of a row is not a finite number, or a kernel fails")
        return found

    def _find_method(self) -> methods.Solver:
        """Return the method, which solvers of relaxed problems share."""
        if not self._solvers:
            self._solvers.append(self._make_method())
        return self._solvers[0]

    def _make_method(self) -> methods.Solver:
        options = self._options
        scaling = options.objective_scaling or 1 / self.problem.weight
        settings = dict(options.options)
        order = Order(self.program, options.tolerance, options.max_iterations, scaling, settings, options.threads)
        return METHODS[methods.choose(options)].make(order)

    def _call(self, solver: methods.Solver, x: Array, watch: Watch | None, scales: Array) -> Outcome:
        own, problem = self.transcription, self.problem
        bounds = (*own.variable_bounds(problem), *own.constraint_bounds(problem))
        told = None if watch is None else report(watch)
        start = Start(x, own.parameters(problem), *bounds, told, scales)
        outcome = call(solver, start)
        return replace(outcome, run=replace(outcome.run, method=methods.choose(self._options)))

    def _name_violated(self, x: Array) -> str:
        """Describe the rows that stay violated, the worst first, and the bounds and ranges at their limits."""
        own, problem = self.transcription, self.problem
        if not np.isfinite(x).all():
            return ""
        variables, rows, inner = dict[int, str](), dict[int, str](), set[int]()
        for part, offset, phase, plant in zip(
            own.phases, own.offsets, problem.phases, self.plants.phases, strict=False
        ):
            names, text = name_parts(part, plant.manifest), f"phase {phase.name}: "
            variables |= {offset.variables + i: text + found for i, found in names.variables.items()}
            rows |= {offset.rows + row: text + found for row, found in names.rows.items()}
            inner |= {offset.rows + row for row in names.inner}
        rows |= {row: text for found, text in own.texts for row in found.tolist()}
        bounds, row_bounds = own.variable_bounds(problem), own.constraint_bounds(problem)
        try:
            found = Found(x, bounds, self._evaluate(x), row_bounds)
        except NoNumbersError:
            return ""
        return describe_point(found, see_solver(Names(variables, rows, frozenset(inner)), own.program))

    # --- the solution ---

    def _read(self, run: Run, x: Array) -> PhasedSolution:
        problem, own, functions = self.problem, self.transcription, self.program.numpy
        parameters = own.parameters(problem)
        every = functions.complete(x)
        g, terms = self._evaluate(x), evaluate(functions.terms, x, parameters)
        solutions = []
        for k, (values, rows) in enumerate(zip(own.split(every), own.split_rows(g), strict=False)):
            first, last = own.offsets[k], own.offsets[k + 1]
            cost = terms[first.weights : last.weights]
            size = _measure_part(own, k)
            numbers = Values(values[own.phases[k].program.kept], rows, cost, values)
            phase = problem.phases[k]
            named = replace(phase.problem, name=phase.name, solver=problem.solver)
            solutions.append(make_solution(named, self.plants.phases[k].manifest, own.phases[k], run, size, numbers))
        bounds = own.constraint_bounds(problem)
        links = own.split_rows(g)[-1], *(own.split_rows(bound)[-1] for bound in bounds)
        return PhasedSolution(
            name=problem.name,
            names=tuple(phase.name for phase in problem.phases),
            phases=tuple(solutions),
            links=problem.links,
            values=tuple(self._read_link(i, every, terms, *links) for i in range(len(problem.links))),
            run=run,
            size=measure_size(self.program),
            constants=problem.constants,
            unknowns=problem.every_unknown,
            unknown_values=tuple(every[own.unknowns].tolist()),
            solver=problem.solver,
        )

    def _read_link(self, i: int, x: Array, terms: Array, g: Array, lower: Array, upper: Array) -> LinkValues:
        link, rows = self.problem.links[i], self.transcription.links[i]
        own = np.concatenate((rows.repeats, np.arange(*rows.extent))) - self.transcription.offsets[-1].rows
        violation = measure_excess(g[own], lower[own], upper[own])
        priced = zip(link.cost, terms[rows.costs].tolist(), strict=True)
        cost = tuple((term.title, term.weight * value) for term, value in priced)
        if link.impact is None or rows.impact is None:
            return LinkValues(link.source, link.target, violation, terms=cost)
        impulses = []
        for contact, variables in zip(link.impact.contacts, rows.impact.impulses, strict=True):
            along = dict(zip(contact.axes, x[variables].tolist(), strict=True))
            impulses.append(Impulse(contact.sensor, (along.get(0, 0.0), along.get(1, 0.0), along.get(2, 0.0))))
        return LinkValues(
            link.source,
            link.target,
            violation,
            tuple(impulses),
            tuple(x[rows.impact.changes].tolist()),
            tuple(x[rows.impact.multipliers].tolist()),
            cost,
        )


def _list_unstaged(own: PhasedTranscription) -> Iterator[tuple[str, str]]:
    """Name the parts of links that keep a program from falling into stages, with their expressions."""
    for i, rows in enumerate(own.links):
        parts = ("conditions", rows.link.conditions, rows.conditions), ("cost", rows.link.cost, -1 - rows.costs)
        for key, given, numbers in parts:
            for k in np.flatnonzero(np.isin(numbers, own.unstaged)).tolist():
                yield f"links[{i}].{key}[{k}].expression", f": {given[k].expression}"
        if np.isin(np.setdiff1d(np.arange(*rows.extent), rows.conditions), own.unstaged).any():
            yield f"links[{i}]", ""


def _measure_part(own: PhasedTranscription, k: int) -> Size:
    """Return the size of a phase's own program, without nonzeros, which the whole counts."""
    program = own.phases[k].program
    return Size(program.kept.size, program.kept_rows.size, 0, 0)


def solve_phases(
    problem: PhasedProblem,
    plants: Plants,
    watch: Watch | None = None,
    guess: Guess | PartialGuess | None = None,
) -> PhasedSolution | PhasedFailure:
    """Solve a problem of phases from a guess, by default the one that it describes; a guess may be on any grids.

    Raises ProblemError with every fault of the problem.
    """
    ready = prepare_phases(problem, plants, guess)
    if isinstance(ready, PhasedFailure):
        return ready
    solver, start = ready
    return solver.solve(start, watch)


def prepare_phases(
    problem: PhasedProblem, plants: Plants, guess: Guess | PartialGuess | None = None
) -> tuple[PhasedSolver, Guess] | PhasedFailure:
    """Return the solver of a problem, and its guess on the grids of the phases; a failure where there is no guess."""
    check_phases(problem, plants)
    plants = equip_phases(problem, plants)
    _check_states(problem, plants)
    start = (
        adapt_guess(problem, guess) if isinstance(guess, Guess) else guess_phases(problem, plants, guess or OWN_GUESS)
    )
    if isinstance(start, Unreached):
        finding, remedy = describe_unreachable(start.pose)
        finding = f"phase {problem.phases[start.phase].name}: {finding}"
        return PhasedFailure(problem, Run(UNREACHABLE, 0, 0.0, 0.0), finding, remedy)
    return PhasedSolver(replace(problem, phases=_settle(problem, plants, start)), plants), start


def _check_states(problem: PhasedProblem, plants: Plants) -> None:
    """Raise ProblemError for starts, ends and contacts that kernels contradict, of all phases."""
    findings = [
        name_phase(phase, finding)
        for phase, plant in zip(problem.phases, plants.phases, strict=True)
        for finding in find_wrong_states(phase.problem, plant)
    ]
    if findings:
        raise ProblemError(problem.name, findings)


def _settle(problem: PhasedProblem, plants: Plants, guess: Guess) -> tuple[Phase, ...]:
    """Settle all phases. Raises ProblemError with every fault of them."""
    settled, findings = [], list[Finding]()
    for phase, plant, motion in zip(problem.phases, plants.phases, guess.trajectories, strict=True):
        try:
            settled.append(Phase(phase.name, settle(phase.problem, plant, motion)))
        except ProblemError as error:
            findings += [name_phase(phase, finding) for finding in error.findings]
    if findings:
        raise ProblemError(problem.name, findings)
    return tuple(settled)


def resimulate_phases(solution: PhasedSolution, plants: Plants) -> PhasedSolution:
    """Integrate the motion of every phase again, under its inputs, from its start."""
    checked = (resimulate(phase, plant) for phase, plant in zip(solution.phases, plants.phases, strict=True))
    return replace(solution, phases=tuple(checked))
