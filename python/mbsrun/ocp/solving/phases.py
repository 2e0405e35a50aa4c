"""Problems of phases, solved: PhasedProblem and plants -> PhasedSolution or Failure.

The phases are one program, which a method solves with exact derivatives. It is built once for all problems of one
structure. A search that does not converge ends in a failure, which has no trajectories; it names the phases and links
whose rows stay violated. A problem without phases is a list of one phase without a name: see `ocp.solving.solve`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbsrun.ocp import methods
from mbsrun.ocp.evaluation.backends.numpy import evaluate
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.stages.binding import is_compiled
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.ground.status import (
    ACCEPTABLE,
    BAD_BOUNDS,
    BAD_GUESS,
    ELSEWHERE,
    INFEASIBLE,
    INVALID,
    JUMPED,
    NOT_OPTIMAL,
    OPEN,
    SOLVED,
    UNREACHABLE,
    NoNumbersError,
    explain,
)
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.phases import Unreached, adapt_guess, carry_states, guess_phases, solve_links
from mbsrun.ocp.guessing.sizes import size_added
from mbsrun.ocp.guessing.state_guess import complete, guess_largest
from mbsrun.ocp.methods import METHODS, Assignment, Instance, Near
from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants, equip_phases
from mbsrun.ocp.problem.problem import Loops, Problem, SolverOptions
from mbsrun.ocp.problem.structure import structure
from mbsrun.ocp.problem.touching import list_relaxed
from mbsrun.ocp.solution.phases import OWN_GUESS, Guess, Impulse, LinkValues, PartialGuess, PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Run, Size
from mbsrun.ocp.solving.answers import Ended, make_solution, measure_excess, measure_size
from mbsrun.ocp.solving.assembly import find_other_assembly
from mbsrun.ocp.solving.branches import find_jump, find_singular
from mbsrun.ocp.solving.following import follow_modes
from mbsrun.ocp.solving.judging import OTHER, Outcome, appeal, examine, tell_both, wants_other
from mbsrun.ocp.solving.margins import find_wrong_start
from mbsrun.ocp.solving.polishing import Equations, polish
from mbsrun.ocp.solving.preparation import describe_unreachable, find_crossed_bounds, find_wrong_states, settle
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.runs import Watch, call, join, report, search
from mbsrun.ocp.solving.singularities import Cause, find_cause, find_in_links
from mbsrun.ocp.statement.checks import Line, ProblemError
from mbsrun.ocp.statement.phase_checks import check_phases, name_phase
from mbsrun.ocp.statement.surplus import free_targets
from mbsrun.ocp.transcription.clashes import Found, Names, describe, describe_point, name_parts, see_solver
from mbsrun.ocp.transcription.linking import Defined
from mbsrun.ocp.transcription.phases import PhasedTranscription, transcribe_phases
from mbsrun.ocp.transcription.scales import scale_cost

OPENED = 1e-8  # the largest gap of loops in a solution [m, 1], unless the tolerance is larger
SIZABLE = 1e-6  # of the cost: where small changes may lower it by more, a solve goes on
LOOSE = 1e-4  # the same with a larger tolerance than the default
SHARPER = 1e-4  # of the tolerance: what it goes on with
BALANCED = 1e-13  # residuals of links, relative to the largest change of a velocity, and absolute below 1


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A solved problem, from which solves of problems nearby start: from its motions and all of its multipliers."""

    guess: Guess  # its motions
    x: Array
    near: Near  # with multipliers of the cost itself, as no method scales it
    scales: Array | None  # usual sizes of x
    cost_scale: float


Note = Callable[[Neighbour], None]


class PhasedSolver:
    """A transcribed problem of phases, to be solved for any starts, targets, bounds and weights."""

    def __init__(self, problem: PhasedProblem, plants: Plants, *, is_judged: bool = True) -> None:
        """Transcribe a problem. Raises ProblemError with every fault of it.

        Where answers are not judged, the word of the method counts, as of one sample of a loop.
        """
        self._is_judged = is_judged
        self._choice: tuple[tuple[SolverOptions, float], SolverOptions] | None = None
        check_phases(problem, plants)
        self.plants = equip_phases(problem, plants)
        _check_states(problem, self.plants)
        self.problem = settle_phases(problem, self.plants)
        check_phases(self.problem, self.plants)
        self.transcription: PhasedTranscription = transcribe_phases(self.problem, self.plants)
        if self.transcription.unstaged.size:
            self.choose_method(self.problem)
        first, *others = self.plants.every
        self.program = Prepared(self.transcription.program, first, tuple(others))
        self._solvers: dict[SolverOptions, methods.Solver] = {}
        self._stacks: dict[tuple[SolverOptions, int], methods.StackSolver] = {}

    def solve(
        self,
        problem: PhasedProblem,
        guess: Guess,
        watch: Watch | None = None,
        usual: Guess | None = None,
        note: Note | None = None,
    ) -> PhasedSolution | Failure:
        """Solve a problem of the same structure from a guess on its grids; `watch` is called in every iteration.

        `usual` holds motions of usual sizes, by default the guess: an answer to a looser problem is none. `note` gets a
        solution from which neighbours may start.

        A guess in which the solver finds nothing to improve may be a saddle or a maximum as well, so it is moved a
        little and solved again. A judge refuses answers whose cost can still fall. Where `mbs` has no answer, IPOPT is
        asked, if the options permit it; the run says so.
        Raises ProblemError for a problem with faults, ValueError for one of another structure.
        """
        usual = guess if usual is None else usual
        first = self._solve(problem, guess, watch, usual, note)
        if isinstance(first, PhasedSolution) or not wants_other(problem.solver, first.run):
            return first
        found = tell_both(first, self._solve(problem.with_solver(OTHER), guess, watch, usual))
        return found.with_solver(problem.solver) if isinstance(found, PhasedSolution) else found

    def solve_near(
        self, problem: PhasedProblem, own: Neighbour, most_iterations: int, note: Note | None = None
    ) -> PhasedSolution | None:
        """Solve a problem of the same structure from a neighbour's solution; None where that does not succeed soon.

        The first step of Newton's method is the tangential prediction. Scales are the neighbour's. `note` gets the
        solution as a neighbour. Raises ProblemError, or ValueError, as `solve` does.
        """
        numbered = self.number_near(problem, own, most_iterations)
        if numbered is None:
            return None
        problem, start = numbered
        near = own.near.scale(self.scale(problem, own.cost_scale))
        return self.finish_near(problem, self._call(problem, replace(start, near=near)), own, note)

    def number_near(
        self, problem: PhasedProblem, own: Neighbour, most_iterations: int
    ) -> tuple[PhasedProblem, Instance] | None:
        """Return a checked problem, and its numbers beside the start near a solution; None where bounds cross."""
        problem = self.check(problem)
        if self._find_crossed(problem) is not None:
            return None
        freed, numbers = self._free_targets(problem, own.guess), self.transcription
        start = Instance(
            own.x,
            numbers.parameters(problem),
            *numbers.variable_bounds(freed),
            *numbers.constraint_bounds(freed),
            scales=own.scales,
            cost_scale=own.cost_scale,
            most_iterations=most_iterations,
        )
        return problem, start

    def finish_near(
        self, problem: PhasedProblem, outcome: Outcome, own: Neighbour, note: Note | None = None
    ) -> PhasedSolution | None:
        """Return the solution at which a start near `own` ended; None where there is none."""
        if outcome.run.status != SOLVED or not np.isfinite(outcome.x).all():
            return None
        found = self._answer(problem, outcome)
        if isinstance(found, Failure):
            return None
        if note is not None and outcome.near is not None:
            near = outcome.near.scale(1 / self.scale(problem, own.cost_scale))
            note(replace(own, guess=found.guess, x=outcome.x, near=near))
        return self._sharpen(problem, outcome, found)

    def scale(self, problem: PhasedProblem, cost_scale: float) -> float:
        """Return the factor of the cost as the method sees it."""
        return cost_scale * (self.choose_method(problem).objective_scaling or 1.0)

    def make_stacks(self, problem: PhasedProblem, threads: int) -> methods.StackSolver | None:
        """Return what solves many problems of one structure and method at once; None where the method cannot."""
        options = replace(self.choose_method(problem), objective_scaling=None)
        make, key = METHODS[methods.choose(options)].make_many, (options, threads)
        if make is None or options.threads > 1 or dict(options.options).get("max_wall_time"):
            return None
        if key not in self._stacks:
            settings = dict(options.options)
            order = Assignment(self.program, options.tolerance, options.max_iterations, 1.0, settings, 1)
            self._stacks[key] = make(order, threads)
        return self._stacks[key]

    def read(self, problem: PhasedProblem, run: Run, x: Array) -> PhasedSolution:
        """Return the solution at a point that was judged. Raises NoNumbersError."""
        return self._read(problem, run, x)

    def needs_sharpening(self, problem: PhasedProblem, run: Run, cost: float, cost_scale: float) -> bool:
        """Return whether small changes may lower a cost by a sizable part of it."""
        options = problem.solver
        loose = options.tolerance > SolverOptions.tolerance  # `mbs` does not go on with it
        if run.status not in ((SOLVED, ACCEPTABLE) if loose else (SOLVED,)) or not run.decrease or not self._is_judged:
            return False
        worth = (1 / options.objective_scaling if options.objective_scaling else problem.weight) / cost_scale
        return abs(cost) > options.tolerance * worth and run.decrease > (LOOSE if loose else SIZABLE) * abs(cost)

    def _find_crossed(self, problem: PhasedProblem) -> Failure | None:
        """Return a failure where bounds cross."""
        for phase, plant in zip(problem.phases, self.plants.phases, strict=True):
            if crossed := find_crossed_bounds(phase.problem, plant.manifest):
                run = Run(BAD_BOUNDS, 0, 0.0, 0.0)
                return Failure(problem, run, f"{phase.title}{crossed}", "give bounds that leave room")
        return None

    def _solve(
        self, problem: PhasedProblem, guess: Guess, watch: Watch | None, usual: Guess, note: Note | None = None
    ) -> PhasedSolution | Failure:
        """Solve by one method."""
        problem = self.check(problem)
        if crossed := self._find_crossed(problem):
            return crossed
        known = self._complete(problem, guess)
        try:
            start = self._begin(problem, known, known if usual is guess else self._complete(problem, usual), watch)
        except NoNumbersError as lack:
            return Failure(problem, Run(BAD_GUESS, 0, 0.0, 0.0), str(lack), "take another guess")
        outcome = search(start.x, lambda x: self._call(problem, replace(start, x=x)))
        outcome = appeal(self.program, outcome, problem.solver, problem.weight)
        if outcome.run.status not in (SOLVED, ACCEPTABLE) or not np.isfinite(outcome.x).all():
            return self._explain(problem, outcome, known)
        found = self._answer(problem, outcome)
        if isinstance(found, PhasedSolution):
            if note is not None and outcome.near is not None:
                near = outcome.near.scale(1 / self.scale(problem, start.cost_scale))
                note(Neighbour(found.guess, outcome.x, near, start.scales, start.cost_scale))
            return self._sharpen(problem, outcome, found)
        return self._insist(problem, outcome, found) if found.run.status == NOT_OPTIMAL else found

    def _insist(self, problem: PhasedProblem, outcome: Outcome, found: Failure) -> PhasedSolution | Failure:
        """Go on with a smaller tolerance where the judge finds that an answer is not optimal.

        A method's tolerance is absolute, and small beside a large weight; the judge compares with the cost's slopes.
        """
        again = self._call(_sharpened(problem), replace(outcome.start, x=outcome.x))
        again = appeal(self.program, again, problem.solver, problem.weight)
        if again.run.status not in (SOLVED, ACCEPTABLE) or not np.isfinite(again.x).all():
            return found
        better = self._answer(problem, again)
        return replace(better, run=join(found.run, better.run)) if isinstance(better, PhasedSolution) else found

    def _sharpen(self, problem: PhasedProblem, outcome: Outcome, found: PhasedSolution) -> PhasedSolution:
        """Go on with a smaller tolerance where small changes may lower the cost by a sizable part of it.

        The tolerance is for a cost over its largest weight, and a cost may be small beside that. Where the solve
        comes to another minimum, the first one stays.
        """
        options, run = problem.solver, found.run
        if not self.needs_sharpening(problem, run, found.cost, outcome.start.cost_scale) or run.decrease is None:
            return found
        finer = _sharpened(problem)
        again = self._call(finer, replace(outcome.start, x=outcome.x))
        if again.run.status != SOLVED or not np.isfinite(again.x).all():
            return found
        better = self._answer(finer, again)
        if isinstance(better, Failure) or better.run.decrease is None or better.run.decrease >= run.decrease:
            return found
        if not 0 <= found.cost - better.cost <= 2 * run.decrease:  # another minimum
            return found
        return replace(better.with_solver(options), run=join(run, better.run))

    def check(self, problem: PhasedProblem) -> PhasedProblem:
        """Return a problem with the loops that were settled. Raises ProblemError, or ValueError for another structure.

        Bounds that cross are a failure of the solve, and no fault.
        """
        pairs = zip(problem.phases, self.problem.phases, strict=True)
        problem = replace(problem, phases=tuple(own.with_loops(settled.problem.loops) for own, settled in pairs))
        check_phases(problem, self.plants)
        _check_states(problem, self.plants)
        same = zip(problem.phases, self.transcription.phases, strict=True)
        if problem.links != self.problem.links or any(structure(x.problem) != own.structure for x, own in same):
            raise ValueError(f"{problem.name} differs in structure from the transcribed problem; make a Solver for it")
        return problem

    def _begin(self, problem: PhasedProblem, guess: Guess, usual: Guess, watch: Watch | None) -> Instance:
        """Return the numbers of the program, from a complete guess. Raises NoNumbersError where they are none."""
        own, x = self.transcription, self.pack(problem, guess)
        freed = self._free_targets(problem, guess)
        bounds = own.variable_bounds(freed)
        sized = self._size_added(problem, usual)
        is_packed = sized is guess and not own.defined  # what links define is no part of usual sizes
        parameters = own.parameters(problem)
        scales = own.find_scales(x if is_packed else own.pack(problem, sized), bounds)
        if (scales != 1).any():
            scales = own.size_inputs(scales, x, self.program.numpy.jacobian(x, parameters), bounds)
        told = None if watch is None else report(watch)
        start = Instance(x, parameters, *bounds, *own.constraint_bounds(freed), told, scales)
        return replace(start, cost_scale=self._scale_cost(problem, start, scales))

    def _scale_cost(self, problem: PhasedProblem, start: Instance, scales: Array) -> float:
        """Return the factor of the cost beside the one of its weights: by its slopes in scaled variables.

        They count at the guess, and where variables that are guessed as 0 have their sizes.
        """
        if problem.solver.objective_scaling or (scales == 1).all():
            return 1.0
        places = start.x, np.clip(np.where(start.x == 0, scales, start.x), start.lower, start.upper)
        slopes = [self.program.numpy.gradient(x, start.parameters) * scales / problem.weight for x in places]
        return scale_cost(max(float(np.abs(slope[np.isfinite(slope)]).max(initial=0.0)) for slope in slopes))

    def _size_added(self, problem: PhasedProblem, usual: Guess) -> Guess:
        """Return motions of usual sizes; the same ones where all states have a size."""
        parts = zip(usual.trajectories, problem.phases, self.plants.phases, strict=True)
        sized = tuple(size_added(motion, phase.problem, plant) for motion, phase, plant in parts)
        same = all(a is b for a, b in zip(sized, usual.trajectories, strict=True))
        return usual if same else replace(usual, trajectories=sized)

    def resume(self, problem: PhasedProblem, guess: Guess) -> Outcome:
        """Run the method from a guess, such as a solution, without a judge: for its multipliers.

        Raises ProblemError, ValueError for a problem of another structure, NoNumbersError.
        """
        problem = self.check(problem)
        known = self._complete(problem, guess)
        return self._call(problem, self._begin(problem, known, known, None))

    def run(self, problem: PhasedProblem, start: Instance) -> Outcome:
        """Run the method from numbers of the program, without a judge and without a second try."""
        return self._call(problem, start)

    def number(self, problem: PhasedProblem, guess: Guess) -> Instance:
        """Return the numbers of the program for a problem of the same structure, with a complete guess on its grids."""
        problem = self.check(problem)
        return self._begin(problem, guess, guess, None)

    def complete(self, problem: PhasedProblem, guess: Guess) -> Guess:
        """Return a guess with the states, controls and unknowns that it lacks."""
        return self._complete(problem, guess)

    def fill(self, problem: PhasedProblem, guess: Guess) -> Array:
        """Put a guess into the variables, with the states, controls and unknowns that it lacks."""
        return self.pack(problem, self._complete(problem, guess))

    def pack(self, problem: PhasedProblem, guess: Guess) -> Array:
        """Put a complete guess into the variables; links give theirs. Raises NoNumbersError where there are none."""
        own, parameters = self.transcription, self.transcription.parameters(problem)
        x = own.pack(problem, guess)
        if not np.isfinite(x).all():
            raise NoNumbersError("the guess has numbers that are not finite")
        defined = tuple(Defined(own.see(part.variables), own.see_rows(part.rows)) for part in own.defined)
        try:
            return solve_links(
                x, defined, lambda x: self._evaluate(x, parameters), lambda x: self._differentiate(x, parameters)
            )
        except NoNumbersError as lack:
            raise NoNumbersError(f"the guess has no numbers: {lack}") from None

    def _free_targets(self, problem: PhasedProblem, guess: Guess) -> PhasedProblem:
        """Free targets of sensors that follow from others as driven joints stand."""
        given = zip(problem.phases, self.plants.phases, guess.trajectories, strict=True)
        phases = (replace(x, problem=free_targets(x.problem, plant, motion.q[-1])) for x, plant, motion in given)
        return replace(problem, phases=tuple(phases))

    # --- the method ---

    def _call(self, problem: PhasedProblem, start: Instance) -> Outcome:
        """Run the method from a point."""
        chosen = self.choose_method(problem)
        options = replace(chosen, objective_scaling=start.cost_scale * (chosen.objective_scaling or 1.0))
        outcome = call(self._find_method(options), start)
        return replace(outcome, run=replace(outcome.run, method=methods.choose(options)))

    def _find_method(self, options: SolverOptions) -> methods.Solver:
        """Return the method with its options, made once for all problems that have the same."""
        if options not in self._solvers:
            settings, scaling = dict(options.options), options.objective_scaling or 1.0
            order = Assignment(
                self.program, options.tolerance, options.max_iterations, scaling, settings, options.threads
            )
            self._solvers[options] = METHODS[methods.choose(options)].make(order)
        return self._solvers[options]

    def choose_method(self, problem: PhasedProblem) -> SolverOptions:
        """Choose the method, where none is given: IPOPT where links read what no stage has, or something is not in C.

        Raises ProblemError where the given method takes stages alone, or has one thread where several are asked for.
        """
        asked = problem.solver, problem.weight
        if self._choice is None or self._choice[0] != asked:  # all else that it depends on belongs to the structure
            self._choice = asked, self._choose_method(problem)
        return self._choice[1]

    def _choose_method(self, problem: PhasedProblem) -> SolverOptions:
        unstaged = self.transcription.unstaged
        options = choose_method(problem, self.plants, is_staged=not unstaged.size)
        if unstaged.size and not METHODS[methods.choose(options)].calls_casadi:
            finding = f"{options.method} cannot read inputs at a start, accelerations or forces here"
            found = list(_list_unstaged(self.transcription)) or [("links", "")]
            findings = [(place, f"{finding}{text}", "take solver.method: ipopt") for place, text in found]
            raise ProblemError(problem.name, findings)
        return replace(options, objective_scaling=options.objective_scaling or 1 / problem.weight)

    # --- a failure ---

    def _explain(self, problem: PhasedProblem, outcome: Outcome, guess: Guess) -> Failure:
        """Explain why a search has no answer."""
        run, x = outcome.run, outcome.x
        has_model = any(plant.manifest.coordinates for plant in self.plants.phases)
        finding, remedy = explain(run.status, run.iterations, has_model=has_model)
        if named := self._find_cause(problem, run, guess, x):
            finding = named.finding if run.status == INVALID else f"{finding}; {named.finding}"
            return Failure(problem, run, finding, named.remedy, named.place)
        clashing = self._describe(problem, outcome)
        finding = f"{finding}: {clashing}" if clashing else finding
        if lost := self._find_singular(problem, run, x):
            return Failure(problem, run, f"{finding}; {lost}", f"take loops: multipliers, or {remedy}")
        return Failure(problem, run, finding, remedy)

    def _find_cause(self, problem: PhasedProblem, run: Run, guess: Guess, x: Array) -> Cause | None:
        """Find an expression of a phase or a link by which a search failed."""
        ends = self._read_ends(x)
        for phase, plant, motion, end in zip(problem.phases, self.plants.phases, guess.trajectories, ends, strict=True):
            if cause := find_cause(phase.problem, plant, run, motion, end):
                return replace(cause, finding=f"{phase.title}{cause.finding}", place=f"{phase.title}{cause.place}")
        if run.status == INVALID:
            last = [end for end in ends if end is not None]
            for motions, title in ((guess.trajectories, "the guess"), (last, "the motion where the search ended")):
                if motions and (cause := find_in_links(problem, self.plants, motions, title)):
                    return cause
        return None

    def _read_ends(self, x: Array) -> list[Trajectory] | list[None]:
        """Return the motions at which a search ended; None where its numbers are no motions."""
        try:
            if np.isfinite(x).all():
                return self.transcription.unpack(self.program.numpy.complete(x))
        except ValueError:
            pass
        return [None] * len(self.plants.phases)

    def _describe(self, problem: PhasedProblem, outcome: Outcome) -> str:
        """Describe what clashes: the violated rows and what is at its limits, or rows that cross before any search."""
        own, run, x = self.transcription, outcome.run, outcome.x
        names = self._name_parts(problem)
        if run.status not in INFEASIBLE or not run.iterations or not np.isfinite(x).all():
            return describe(outcome.clash, names)
        try:
            g = self._evaluate(x, outcome.start.parameters)
        except NoNumbersError:
            return describe(outcome.clash, names)
        found = Found(x, own.variable_bounds(problem), g, own.constraint_bounds(problem))
        return describe_point(found, see_solver(names, own.program))

    def _name_parts(self, problem: PhasedProblem) -> Names:
        """Describe all variables and rows."""
        own = self.transcription
        variables, rows, inner = dict[int, str](), dict[int, str](), set[int]()
        for part, offset, phase, plant in zip(
            own.phases, own.offsets, problem.phases, self.plants.phases, strict=False
        ):
            names = name_parts(part, plant.manifest)
            variables |= {offset.variables + i: phase.title + found for i, found in names.variables.items()}
            rows |= {offset.rows + row: phase.title + found for row, found in names.rows.items()}
            inner |= {offset.rows + row for row in names.inner}
        rows |= {row: text for found, text in own.texts for row in found.tolist()}
        return Names(variables, rows, frozenset(inner))

    def _find_singular(self, problem: PhasedProblem, run: Run, x: Array) -> str:
        """Name the first phase whose reduced form does not determine the motion at which a search ended."""
        if not np.isfinite(x).all() or all(phase.problem.loops is not Loops.REDUCED for phase in problem.phases):
            return ""
        try:
            found = self._read(problem, run, x).phases
        except NoNumbersError:
            return ""
        for phase, part, plant in zip(problem.phases, found, self.plants.phases, strict=True):
            if lost := find_singular(part, plant):
                return f"{phase.title}{lost}"
        return ""

    # --- the answer ---

    def _answer(self, problem: PhasedProblem, outcome: Outcome) -> PhasedSolution | Failure:
        """Read the solution off a point that a method calls solved; a failure where it is none."""
        run, cause = outcome.run, ""
        try:
            run, x = self._balance_impacts(problem, outcome)
            g = self._evaluate(x, outcome.start.parameters)
            if self._is_judged:
                judged = replace(outcome, run=run, x=x)
                run, cause = examine(self.program, judged, problem.solver, problem.weight, g)
            solution = self._read(problem, run, x, g)
        except NoNumbersError as lack:
            finding, remedy = explain(INVALID, run.iterations)
            return Failure(problem, replace(run, status=INVALID), f"{finding}, at the end: {lack}", remedy)
        most = max(OPENED, problem.solver.tolerance)
        for phase, part in zip(problem.phases, solution.phases, strict=True):
            gap = part.violation.closure or 0.0
            if gap > most:  # before other constraints, which open loops violate, too
                finding, remedy = explain(OPEN, run.iterations)
                finding = f"{phase.title}{finding}, by {gap:.1e} of {most:.1e}"
                return Failure(problem, replace(run, status=OPEN), finding, remedy)
        if cause:
            finding, remedy = explain(run.status, run.iterations)
            return Failure(problem, run, f"{finding}, {cause}", remedy)
        for phase, part, plant in zip(problem.phases, solution.phases, self.plants.phases, strict=True):
            for status, find in ((JUMPED, find_jump), (ELSEWHERE, find_other_assembly)):
                if cause := find(part, plant):
                    finding, remedy = explain(status, run.iterations)
                    finding = f"{phase.title}{finding}; {cause}"
                    return Failure(problem, replace(run, status=status), finding, remedy)
        return solution

    def _balance_impacts(self, problem: PhasedProblem, outcome: Outcome) -> tuple[Run, Array]:
        """Solve all equations to rounding where impulses do not balance the momentum to it; the run counts the time."""
        own, run, x, p = self.transcription, outcome.run, outcome.x, outcome.start.parameters
        impacts = [rows.impact for rows in own.links if rows.impact is not None]
        if not impacts:
            return run, x
        ranges = own.constraint_bounds(problem), own.variable_bounds(problem)
        g, first = self._evaluate(x, p), int(own.see_rows(np.array(own.offsets[-1].rows)))
        equal = ranges[0][0][first:] == ranges[0][1][first:]
        largest = max(np.abs(x[own.see(impact.changes)]).max() for impact in impacts)
        if np.abs((g - ranges[0][0])[first:][equal]).max() <= BALANCED * max(1.0, largest):
            return run, x
        begin, cpu_begin = time.perf_counter(), time.process_time()
        equations = Equations(lambda x: self._evaluate(x, p), lambda x: self._differentiate(x, p), *ranges)
        x = polish(x, equations, max(problem.solver.tolerance, equations.measure(x, g)))
        seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
        return replace(run, seconds=run.seconds + seconds, cpu_seconds=run.cpu_seconds + cpu_seconds), x

    def _complete(self, problem: PhasedProblem, guess: Guess) -> Guess:
        """Guess the states, controls and unknowns that phases add; unknowns of motions count where others lack."""
        known, largest = dict(guess.unknowns), dict[str, float]()
        for motion, phase in zip(guess.trajectories, problem.phases, strict=True):
            names = [unknown.name for unknown in phase.problem.unknowns]
            given = motion.unknowns.tolist() if motion.unknowns.size == len(names) else []
            known = dict(zip(names, given, strict=False)) | known
        parts = zip(guess.trajectories, problem.phases, self.plants.phases, strict=True)
        completed: list[Trajectory] = []
        for k, (motion, phase, plant) in enumerate(parts):
            values = [known.get(unknown.name, unknown.guess) for unknown in phase.problem.unknowns]
            own = carry_states(problem, k, completed, self.plants)
            motion = complete(replace(motion, unknowns=np.array(values)), own, plant)
            completed.append(motion)
            found = guess_largest(motion, phase.problem, plant).unknowns.tolist()
            for unknown, value in zip(phase.problem.unknowns, found, strict=True):
                if unknown.largest and unknown.name not in known:  # of phases that share it, the largest of all
                    largest[unknown.name] = max(value, largest.get(unknown.name, value))
        return Guess(tuple(completed), (*known.items(), *largest.items()))

    def _evaluate(self, x: Array, parameters: Array) -> Array:
        try:
            return evaluate(self.program.numpy.constraint, x, parameters)
        except NoNumbersError:
            self.program.numpy.complete(x)  # where condensed equations are the cause, it names them
            raise

    def _differentiate(self, x: Array, parameters: Array) -> Matrix:
        found = self.program.numpy.jacobian(x, parameters)
        if not np.isfinite(found.data).all():
            raise NoNumbersError("a derivative of a row is not a finite number, or a kernel fails")
        return found

    def _read(self, problem: PhasedProblem, run: Run, x: Array, g: Array | None = None) -> PhasedSolution:
        """Read the motions that a search ended at; g are its rows, if known. Raises NoNumbersError without numbers."""
        own, functions = self.transcription, self.program.numpy
        parameters = own.parameters(problem)
        every = functions.complete(x)
        g = self._evaluate(x, parameters) if g is None else g
        terms = evaluate(functions.terms, x, parameters)
        solutions = []
        for k, (values, rows) in enumerate(zip(own.split(every), own.split_rows(g), strict=False)):
            first, last = own.offsets[k], own.offsets[k + 1]
            cost = terms[first.weights : last.weights]
            numbers = Ended(values[own.phases[k].program.kept], rows, cost, values)
            phase, part = problem.phases[k], self._size if problem.is_single else _measure_part(own, k)
            named = _name_problem(phase.problem, phase.name or problem.name, problem.solver)
            solutions.append(make_solution(named, self.plants.phases[k].manifest, own.phases[k], run, part, numbers))
        links = [own.split_rows(x)[-1] for x in (g, *own.constraint_bounds(problem))] if problem.links else []
        return PhasedSolution(
            name=problem.name,
            names=tuple(phase.name for phase in problem.phases),
            phases=tuple(solutions),
            links=problem.links,
            values=tuple(self._read_link(problem, i, every, terms, *links) for i in range(len(problem.links))),
            run=run,
            size=self._size,
            constants=problem.constants,
            unknowns=problem.every_unknown,
            unknown_values=tuple(every[own.unknowns].tolist()),
            solver=problem.solver,
        )

    @cached_property
    def _size(self) -> Size:
        """Return the size of the program, which all problems of one structure share."""
        return measure_size(self.program)

    def _read_link(
        self, problem: PhasedProblem, i: int, x: Array, terms: Array, g: Array, lower: Array, upper: Array
    ) -> LinkValues:
        link, rows = problem.links[i], self.transcription.links[i]
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
            tuple(zip((x.joint for x in link.impact.blows), x[rows.impact.blows].tolist(), strict=True)),
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


def _name_problem(own: Problem, name: str, solver: SolverOptions) -> Problem:
    """Return a problem with a name and options; the same one where it has them."""
    if (own.name, own.solver) == (name, solver):
        return own
    return replace(own, name=name, solver=solver)


def _measure_part(own: PhasedTranscription, k: int) -> Size:
    """Return the size of a phase's own program, without nonzeros, which the whole counts."""
    program = own.phases[k].program
    return Size(program.kept.size, program.kept_rows.size, 0, 0)


def choose_method(problem: PhasedProblem, plants: Plants, *, is_staged: bool = True) -> SolverOptions:
    """Return the solver's options with their method, by default `mbs` where everything is in C and falls into stages.

    Raises ProblemError where that has one thread, and the problem asks for more.
    """
    parts = [phase.problem for phase in problem.phases]
    calls_casadi = not is_staged or any(
        part.functions or not is_compiled(plant, part.representation.equations.write(part.loops).kernel)
        for part, plant in zip(parts, plants.phases, strict=True)
    )
    options = methods.settle(problem.solver, calls_casadi=calls_casadi)
    if options.threads > 1 and not METHODS[methods.choose(options)].has_threads:
        finding = f"found {options.threads}, but {options.method} has one thread, and kernels are not all in C"
        raise ProblemError(problem.name, [("solver.threads", finding, "leave it out")])
    return options


# --- a whole solve --------------------------------------------------------------------------------------------------

Make = Callable[[PhasedProblem, Plants], PhasedSolver]


@dataclass(frozen=True, eq=False)
class Ready:
    """A problem whose open choices are made, its solver, and its guess on the grids of the phases."""

    solver: PhasedSolver
    problem: PhasedProblem
    guess: Guess

    def solve(self, watch: Watch | None = None, note: Note | None = None) -> PhasedSolution | Failure:
        """Solve; contacts by complementarity are relaxed in steps, and a step that fails is left out."""
        guess = self.guess
        for phases in [*list_relaxed([phase.problem for phase in self.problem.phases])][:-1]:
            changed = zip(self.problem.phases, phases, strict=True)
            relaxed = replace(self.problem, phases=tuple(replace(phase, problem=own) for phase, own in changed))
            found = self.solver.solve(relaxed, guess, watch, self.guess)
            if isinstance(found, PhasedSolution):
                guess = found.guess
        return self.solver.solve(self.problem, guess, watch, self.guess, note)


def solve_phases(
    problem: PhasedProblem,
    plants: Plants,
    watch: Watch | None = None,
    guess: Guess | PartialGuess | None = None,
    make: Make = PhasedSolver,
    note: Note | None = None,
) -> PhasedSolution | Failure:
    """Solve a problem of phases from a guess, by default the one that it describes; a guess may be on any grids.

    `make` may return an earlier solver of the same structure. `note` gets a solution from which neighbours may start.
    Raises ProblemError with every fault of the problem.
    """
    ready = prepare_phases(problem, plants, guess, make)
    return ready if isinstance(ready, Failure) else ready.solve(watch, note)


def prepare_phases(
    problem: PhasedProblem, plants: Plants, guess: Guess | PartialGuess | None = None, make: Make = PhasedSolver
) -> Ready | Failure:
    """Return a problem with its solver and its guess; a failure where a start or a target of a phase cannot be."""
    check_phases(problem, plants)
    plants = equip_phases(problem, plants)
    _check_states(problem, plants)
    if isinstance(guess, Guess):
        return _make_ready(problem, plants, adapt_guess(problem, guess), make)
    start = guess_phases(problem, plants, guess or OWN_GUESS)
    if isinstance(start, Unreached):
        finding, remedy = describe_unreachable(start.pose)
        finding = f"{problem.phases[start.phase].title}{finding}"
        return Failure(problem, Run(UNREACHABLE, 0, 0.0, 0.0), finding, remedy)
    return _make_ready(problem, plants, start, make)


def prepare_near(problem: PhasedProblem, plants: Plants, own: Neighbour, make: Make = PhasedSolver) -> Ready | Failure:
    """Return a problem as `prepare_phases` does, to be solved from a neighbour: it reads poses of its motions alone."""
    check_phases(problem, plants)
    plants = equip_phases(problem, plants)
    _check_states(problem, plants)
    return _make_ready(problem, plants, own.guess, make)


def _make_ready(problem: PhasedProblem, plants: Plants, start: Guess, make: Make) -> Ready | Failure:
    """Return a problem with its solver and a guess on its grids, or why a start cannot be."""
    for phase, plant in zip(problem.phases, plants.phases, strict=True):
        if wrong := find_wrong_start(phase.problem, plant):
            run, (finding, place) = Run(INFEASIBLE[0], 0, 0.0, 0.0), wrong
            return Failure(problem, run, f"{phase.title}{finding}", "start within its range", f"{phase.title}{place}")
    settled = settle_phases(problem, plants, start)
    return Ready(make(settled, plants), settled, start)


def _sharpened(problem: PhasedProblem) -> PhasedProblem:
    """Return a problem with a smaller tolerance."""
    return replace(problem, solver=replace(problem.solver, tolerance=SHARPER * problem.solver.tolerance))


def _check_states(problem: PhasedProblem, plants: Plants) -> None:
    """Raise ProblemError for starts, ends and contacts that kernels contradict, of all phases."""
    findings = [
        name_phase(phase, finding)
        for phase, plant in zip(problem.phases, plants.phases, strict=True)
        for finding in find_wrong_states(phase.problem, plant)
    ]
    if findings:
        raise ProblemError(problem.name, findings)


def settle_phases(problem: PhasedProblem, plants: Plants, guess: Guess | None = None) -> PhasedProblem:
    """Settle what phases leave open, along a guess if there is one. Raises ProblemError with every fault of them."""
    settled, findings = [], list[Line]()
    motions = [None] * len(problem.phases) if guess is None else guess.trajectories
    for phase, plant, motion in zip(problem.phases, plants.phases, motions, strict=True):
        try:
            settled.append(Phase(phase.name, settle(phase.problem, plant, motion)))
        except ProblemError as error:
            findings += [name_phase(phase, finding) for finding in error.findings]
    if findings:
        raise ProblemError(problem.name, findings)
    return replace(problem, phases=tuple(settled))


def resimulate_phases(solution: PhasedSolution, plants: Plants) -> PhasedSolution:
    """Integrate the motion of every phase again, under its inputs, from its start; and modes from event to event."""
    checked = (resimulate(phase, plant) for phase, plant in zip(solution.phases, plants.phases, strict=True))
    return replace(solution, phases=tuple(checked), followed=tuple(follow_modes(solution, plants)))
