"""An NLP method on a transcribed problem: Problem and plant -> Solution or Failure.

The program is built once for all problems of one structure, and the method gets its exact derivatives. A search that
does not converge ends in a Failure, which has no trajectory that could be taken for a
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.closure import Closure, find_closure
from mbsrun.ocp import methods, schemes
from mbsrun.ocp.assembly import find_other_assembly
from mbsrun.ocp.backends.numpy import evaluate
from mbsrun.ocp.backends.prepared import Prepared
from mbsrun.ocp.checks import Finding, ProblemError, check_problem, find_loop_conflicts
from mbsrun.ocp.clashes import Found, describe, describe_point, name_parts, see_solver
from mbsrun.ocp.conditions import find_open_states
from mbsrun.ocp.contacts import find_stray_forces
from mbsrun.ocp.design import equip
from mbsrun.ocp.guess import Pose, adapt, make_guess
from mbsrun.ocp.judging import OTHER, Outcome, appeal, examine, tell_both, wants_other
from mbsrun.ocp.methods import METHODS, Iterate, Order, Start
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Loops, Problem, SolverOptions
from mbsrun.ocp.scales import find_scales
from mbsrun.ocp.singularities import find_cause
from mbsrun.ocp.solution import CostTerms, Failure, Run, Size, Solution, Violation
from mbsrun.ocp.stages.binding import is_compiled
from mbsrun.ocp.state_guess import complete
from mbsrun.ocp.status import (
    ACCEPTABLE,
    BAD_BOUNDS,
    BAD_GUESS,
    ELSEWHERE,
    INFEASIBLE,
    INVALID,
    JUMPED,
    OPEN,
    SOLVED,
    UNREACHABLE,
    NoNumbersError,
    explain,
)
from mbsrun.ocp.structure import structure
from mbsrun.ocp.surplus import free_targets, leave_out_surplus
from mbsrun.ocp.touching import list_steps, set_relaxation
from mbsrun.ocp.trajectory import Trajectory
from mbsrun.ocp.transcription import Transcription, transcribe
from mbsrun.quaternions import measure_lengths

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Progress:
    """The state of a search."""

    iteration: int
    cost: float
    violation: float  # of the constraints, the largest


Watch = Callable[[Progress], None]

OPENED = 1e-8  # the largest gap of loops in a solution [m, 1], unless the tolerance is larger
NUDGE = 1e-2  # relative, and absolute below 1: how far a guess is moved in which nothing could be improved


class Solver:
    """A transcribed problem, to be solved for any start, targets, bounds and weights."""

    def __init__(self, problem: Problem, plant: Plant, *, is_judged: bool = True) -> None:
        """Transcribe a problem. Raises ProblemError with every fault of it.

        Where answers are not judged, the word of the method counts, as of one sample of a loop.
        """
        self._is_judged = is_judged
        check_problem(problem, plant.manifest)
        _check_states(problem, plant)
        self.plant = plant = equip(plant, problem)
        self._loops = settle(problem, plant).loops
        problem = replace(problem, loops=self._loops)
        check_problem(problem, plant.manifest)
        self.transcription = transcribe(problem, plant)
        self.program = Prepared(self.transcription.program, plant)
        self._solvers: dict[SolverOptions, methods.Solver] = {}

    def solve(
        self, problem: Problem, guess: Trajectory, watch: Watch | None = None, usual: Trajectory | None = None
    ) -> Solution | Failure:
        """Solve a problem of the same structure from a guess on its grid; `watch` is called in every iteration.

        `usual` is a motion of usual sizes, by default the guess: an answer to a looser problem is none.

        A guess in which the solver finds nothing to improve may be a saddle or a maximum as well, so it is moved a
        little and solved again. A judge refuses answers whose cost can still fall. Where `mbs` has no answer, IPOPT is
        asked, if the options permit it; the run says so.
        Raises ProblemError for a problem with faults, ValueError for one of another structure.
        """
        usual = guess if usual is None else usual
        first = self._solve(problem, guess, watch, usual)
        if isinstance(first, Solution) or not wants_other(problem.solver, first.run):
            return first
        found = tell_both(first, self._solve(problem.with_solver(OTHER), guess, watch, usual))
        return replace(found, problem=replace(found.problem, solver=problem.solver))

    def _solve(self, problem: Problem, guess: Trajectory, watch: Watch | None, usual: Trajectory) -> Solution | Failure:
        """Solve by one method."""
        problem = replace(problem, loops=problem.loops or self._loops)
        check_problem(problem, self.plant.manifest)
        _check_states(problem, self.plant)
        if structure(problem) != self.transcription.structure:
            raise ValueError(f"{problem.name} differs in structure from the transcribed problem; make a Solver for it")
        crossed = find_crossed_bounds(problem, self.plant.manifest)
        if crossed:
            return Failure(problem, Run(BAD_BOUNDS, 0, 0.0, 0.0), crossed, "give bounds that leave room")
        guess = complete(guess, problem, self.plant)
        x = self.transcription.pack(guess)
        if not np.isfinite(x).all():
            finding = "the guess has numbers that are not finite"
            return Failure(problem, Run(BAD_GUESS, 0, 0.0, 0.0), finding, "take another guess")
        freed = free_targets(problem, self.plant, guess.q[-1])
        scales = find_scales(
            self.transcription,
            self.transcription.pack(complete(usual, problem, self.plant)),
            self.transcription.variable_bounds(freed),
        )
        weight = max(map(abs, problem.cost.weights))
        outcome = search(x, lambda x: self._call(freed, x, watch, scales))
        outcome = appeal(self.program, outcome, problem.solver, weight)
        run, found, clash = outcome.run, outcome.x, outcome.clash
        if run.status not in (SOLVED, ACCEPTABLE) or not np.isfinite(found).all():
            finding, remedy = explain(run.status, run.iterations, has_model=bool(self.plant.manifest.coordinates))
            if named := find_cause(problem, self.plant, run, guess, self._read_end(found)):
                finding = named.finding if run.status == INVALID else f"{finding}; {named.finding}"
                return Failure(problem, run, finding, named.remedy, named.place)
            clashing = self._describe(problem, run, found, clash)
            finding = f"{finding}: {clashing}" if clashing else finding
            if lost := self._find_singular(problem, run, found):
                return Failure(problem, run, f"{finding}; {lost}", f"take loops: multipliers, or {remedy}")
            return Failure(problem, run, finding, remedy)
        try:
            solution = self._solution(problem, run, found)
            cause = ""
            if self._is_judged:
                run, cause = examine(self.program, outcome, problem.solver, weight)
        except NoNumbersError as lack:
            finding, remedy = explain(INVALID, run.iterations)
            return Failure(problem, replace(run, status=INVALID), f"{finding}, at the end: {lack}", remedy)
        gap, most = solution.violation.closure or 0.0, max(OPENED, problem.solver.tolerance)
        if gap > most:  # before other constraints, which open loops violate, too
            finding, remedy = explain(OPEN, run.iterations)
            return Failure(problem, replace(run, status=OPEN), f"{finding}, by {gap:.1e} of {most:.1e}", remedy)
        if cause:
            finding, remedy = explain(run.status, run.iterations)
            return Failure(problem, run, f"{finding}, {cause}", remedy)
        solution = replace(solution, run=run)
        for status, find in ((JUMPED, find_jump), (ELSEWHERE, find_other_assembly)):
            if cause := find(solution, self.plant):
                finding, remedy = explain(status, run.iterations)
                return Failure(problem, replace(run, status=status), f"{finding}; {cause}", remedy)
        return solution

    def _describe(self, problem: Problem, run: Run, x: Array, clash: tuple[int, ...]) -> str:
        """Describe what clashes: the violated rows and what is at its limits, or rows that cross before any search."""
        own = self.transcription
        if run.status not in INFEASIBLE or not run.iterations or not np.isfinite(x).all():
            return describe(clash, own, self.plant.manifest)
        try:
            g = evaluate(self.program.numpy.constraint, x, own.parameters(problem))
        except NoNumbersError:
            return describe(clash, own, self.plant.manifest)
        names = see_solver(name_parts(own, self.plant.manifest), own.program)
        found = Found(x, own.variable_bounds(problem), g, own.constraint_bounds(problem))
        return describe_point(found, names)

    def _read_end(self, x: Array) -> Trajectory | None:
        """Return the motion at which a search ended; None where its numbers are no motion."""
        try:
            return self.transcription.unpack(self.program.numpy.complete(x)) if np.isfinite(x).all() else None
        except ValueError:
            return None

    def _find_singular(self, problem: Problem, run: Run, x: Array) -> str:
        """Return that the reduced form does not determine the motion at which a search ended; else nothing."""
        if problem.loops is not Loops.REDUCED or not np.isfinite(x).all():
            return ""
        try:
            return find_singular(self._solution(problem, run, x), self.plant)
        except NoNumbersError:
            return ""

    def _call(self, problem: Problem, x: Array, watch: Watch | None, scales: Array) -> Outcome:
        """Run the solver from x."""
        lower, upper = self.transcription.variable_bounds(problem)
        g_lower, g_upper = self.transcription.constraint_bounds(problem)
        parameters = self.transcription.parameters(problem)
        told = None if watch is None else report(watch)
        start = Start(x, parameters, lower, upper, g_lower, g_upper, told, scales)
        outcome = call(self._solver(problem), start)
        run = replace(outcome.run, method=methods.choose(choose_method(problem, self.plant)))
        return replace(outcome, run=run)

    def _solution(self, problem: Problem, run: Run, x: Array) -> Solution:
        """Read the motion that a search ended at. Raises NoNumbersError where there is none."""
        transcription = self.transcription
        functions, parameters = self.program.numpy, transcription.parameters(problem)
        completed = functions.complete(x)
        return make_solution(
            problem,
            self.plant.manifest,
            transcription,
            run,
            measure_size(self.program),
            Values(
                x=x,
                g=evaluate(functions.constraint, x, parameters),
                terms=evaluate(functions.terms, x, parameters),
                completed=completed,
            ),
        )

    def _solver(self, problem: Problem) -> methods.Solver:
        """Make the solver with the options of a problem, once for all that have the same."""
        weight = max(map(abs, problem.cost.weights))
        options = replace(
            choose_method(problem, self.plant), objective_scaling=problem.solver.objective_scaling or 1 / weight
        )
        if options not in self._solvers:
            scaling = options.objective_scaling or 1.0
            settings = dict(options.options)
            order = Order(self.program, options.tolerance, options.max_iterations, scaling, settings, options.threads)
            self._solvers[options] = METHODS[methods.choose(options)].make(order)
        return self._solvers[options]


def choose_method(problem: Problem, plant: Plant) -> SolverOptions:
    """Return the solver's options with their method, by default `mbs` where everything is in C.

    Raises ProblemError where that has one thread, and the problem asks for more.
    """
    kernel = problem.representation.equations.write(problem.loops).kernel
    is_in_c = is_compiled(plant, kernel) and not problem.functions
    options = methods.settle(problem.solver, calls_casadi=not is_in_c)
    if options.threads > 1 and not METHODS[methods.choose(options)].has_threads:
        finding = f"found {options.threads}, but {options.method} has one thread, and kernels are not all in C"
        raise ProblemError(problem.name, [("solver.threads", finding, "leave it out")])
    return options


@dataclass(frozen=True)
class Values:
    """The numbers of a program at the end of a search."""

    x: Array
    g: Array
    terms: Array  # of the cost, without their weights
    completed: Array  # all variables


def search(x: Array, call: Callable[[Array], Outcome]) -> Outcome:
    """Call a solver from x; where it finds nothing to improve there, call it again from points nearby."""
    outcome = call(x)
    if outcome.run.status == SOLVED and outcome.run.iterations == 0:
        nudge = NUDGE * np.maximum(np.abs(x), 1.0) * np.random.default_rng(0).uniform(-1.0, 1.0, x.size)
        outcome = call(x + nudge)
        if outcome.run.status == SOLVED:  # a saddle may be met again from one side, but not from the other
            outcome = call(x - nudge)
    return outcome


def call(solver: methods.Solver, start: Start) -> Outcome:
    """Call a solver once, and measure its times, without the time to prepare it."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    answer = solver(start)
    seconds = time.perf_counter() - begin - answer.preparing
    cpu_seconds = time.process_time() - cpu_begin - answer.cpu_preparing
    run = Run(answer.status, answer.iterations, seconds, answer.evaluating, cpu_seconds, answer.cpu_evaluating)
    return Outcome(run, answer.x, answer.clash, answer.multipliers, start)


def report(watch: Watch) -> Callable[[Iterate], None]:
    """Return a function that shows a watch every iterate."""
    return lambda iterate: watch(Progress(iterate.number, iterate.cost, iterate.violation))


def measure_size(program: Prepared) -> Size:
    """Return the size of a program, as a method sees it."""
    data = program.data
    return Size(data.kept.size, data.kept_rows.size, *program.numpy.count_nonzeros())


def make_solution(
    problem: Problem, manifest: Manifest, transcription: Transcription, run: Run, size: Size, values: Values
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


def find_crossed_bounds(problem: Problem, manifest: Manifest) -> str | None:
    """Describe the first bound that no number can keep: solvers would raise an exception for it."""
    names = [c.name for c in manifest.coordinates]
    bounds = problem.bounds
    for kind, ranges, of in (
        ("coordinate", bounds.q, manifest.positions),
        ("velocity", bounds.qd, names),
        ("input", bounds.u, [names[i] for i in manifest.actuated]),
        ("force of driven joint", bounds.tau, [names[i] for i in manifest.driven][: len(bounds.tau)]),
        ("input rate", bounds.rates, [names[i] for i in manifest.actuated][: len(bounds.rates)]),
        ("control rate", [control.rates for control in problem.controls], problem.added.controls),
        ("constraint", [c.range for c in problem.constraints], [c.label for c in problem.constraints]),
        ("state", [state.bounds for state in problem.states], problem.added.states[: len(problem.states)]),
        ("control", [control.bounds for control in problem.controls], problem.added.controls),
        ("integral", [part.range for part in problem.integrals], [part.expression for part in problem.integrals]),
    ):
        for (lower, upper), name in zip(ranges, of, strict=True):
            if not (lower <= upper and lower < np.inf and upper > -np.inf):
                return f"the bounds of {kind} {name} are [{lower:g}, {upper:g}]"
    return None


def solve(
    problem: Problem,
    plant: Plant,
    watch: Watch | None = None,
    guess: Trajectory | None = None,
    make: Callable[[Problem, Plant], Solver] = Solver,
) -> Solution | Failure:
    """Solve a problem from a guess, by default the one that it describes; a guess may be on any grid.

    `make` may return an earlier solver of the same structure. Where no pose meets the targets, it fails at once. Raises
    ProblemError with every fault of the problem.
    """
    check_problem(problem, plant.manifest)
    _check_states(problem, plant)
    plant = equip(plant, problem)
    scheme = schemes.build(problem.family, problem.degree)
    start = make_guess(problem, plant, scheme) if guess is None else adapt(guess, problem, scheme)
    if isinstance(start, Pose):
        return Failure(problem, Run(UNREACHABLE, 0, 0.0, 0.0), *describe_unreachable(start))
    problem = settle(problem, plant, start)
    check_problem(problem, plant.manifest)
    solver, usual = make(problem, plant), start
    for amount in list_steps(problem)[:-1]:
        found = solver.solve(set_relaxation(problem, amount), start, watch, usual)
        if isinstance(found, Solution):  # else the step after begins where this one did
            start = found.trajectory
    return solver.solve(problem, start, watch, usual)


def find_jump(solution: Solution, plant: Plant) -> str:
    """Describe why the points of a reduced form lie on two branches of the loops; nothing where they do not."""
    closure = _find_closure(solution, plant)
    if closure is None or solution.problem.loops is not Loops.REDUCED or not closure.jumps(solution.trajectory.q):
        return ""
    return _name_independent(closure)


def find_singular(solution: Solution, plant: Plant) -> str:
    """Describe why the reduced form does not determine a motion; nothing where it does, or is not taken."""
    closure = _find_closure(solution, plant)
    if closure is None or solution.problem.loops is not Loops.REDUCED:
        return ""
    try:
        is_regular = closure.is_regular(solution.trajectory.q)
    except ValueError:  # there are no dependent coordinates
        is_regular = False
    return "" if is_regular else _name_independent(closure)


def _find_closure(solution: Solution, plant: Plant) -> Closure | None:
    """Return the loops of the mechanism that a solution has found."""
    return find_closure(equip(plant, solution.problem, solution.trajectory.unknowns))


def _name_independent(closure: Closure) -> str:
    named = ", ".join(closure.manifest.coordinates[i].name for i in closure.independent)
    return f"on the way, the independent joints {named} do not determine the others, as at a dead centre"


def _check_states(problem: Problem, plant: Plant) -> None:
    """Raise ProblemError for a start, an end or contacts that kernels contradict."""
    if findings := find_wrong_states(problem, plant):
        raise ProblemError(problem.name, findings)


def find_wrong_states(problem: Problem, plant: Plant) -> list[Finding]:
    """Find a start or an end that closed loops contradict, and contacts whose forces act elsewhere or that slip."""
    findings = list(find_stray_forces(problem, plant))
    closure = find_closure(plant)
    return findings if closure is None else [*findings, *find_open_states(problem, closure)]


def describe_unreachable(pose: Pose) -> tuple[str, str]:
    """Return finding and remedy of targets that no pose meets, or no motion reaches."""
    finding = f"no pose within the bounds meets the targets; the nearest one found is {pose.distance:.3g} m or rad away"
    remedy = "move the target or widen the bounds"
    if not pose.has_way:
        finding = "from the start to the pose found for the end, no motion was found that keeps the loops closed"
        remedy = "take guess.motion: rest, or another start, or targets that the mechanism reaches as it is assembled"
    return finding, remedy


def settle(problem: Problem, plant: Plant, guess: Trajectory | None = None) -> Problem:
    """Choose how loops become variables, where a problem leaves that open, and leave out conditions of the end.

    Loops are reduced where that is sure to work: where the independent coordinates determine the others along the
    guess, or at the start without one, and where the representation has a reduced form. Conditions that contacts imply
    are left out where a guess gives the pose. Raises ProblemError for values that contradict the contacts.
    """
    if guess is not None:
        problem = leave_out_surplus(problem, plant, guess.q[-1])
    closure = find_closure(plant)
    if closure is None or problem.loops is not None:
        return problem
    reduced = replace(problem, loops=Loops.REDUCED)
    path = np.array([problem.start_q])
    if guess is not None:
        path = np.concatenate((guess.q, guess.point_q.reshape(-1, guess.q.shape[1])))
    is_possible = not list(find_loop_conflicts(reduced, plant.manifest)) and closure.is_regular(path)
    return reduced if is_possible else replace(problem, loops=Loops.MULTIPLIERS)


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


def measure_excess(values: Array, lower: Array, upper: Array) -> float:
    """Return by how much values leave their bounds: the largest."""
    return float(np.maximum(lower - values, values - upper).max(initial=0.0))
