"""An NLP solver on a transcribed problem: Problem and plant -> Solution or Failure.

The program is built once for all problems of one structure, and the solver gets its exact derivatives. What does not
converge is a Failure, which has no trajectory that could be taken for a solution.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.ocp import schemes, solution
from mbsrun.ocp.checks import check_problem
from mbsrun.ocp.guess import Pose, adapt, make_guess
from mbsrun.ocp.methods import METHODS, Order, read_status
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem, SolverOptions
from mbsrun.ocp.program import NonlinearProgram
from mbsrun.ocp.solution import CostTerms, Failure, Run, Size, Solution, Violation
from mbsrun.ocp.trajectory import Trajectory
from mbsrun.ocp.transcription import structure, transcribe
from mbsrun.quaternions import measure_lengths

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Progress:
    """Where the solver is."""

    iteration: int
    cost: float
    violation: float  # of the constraints, the largest


Watch = Callable[[Progress], None]

_REASONS = {
    "Infeasible_Problem_Detected": (
        "the search ended where the constraints contradict each other",
        "check target, bounds and horizon",
    ),
    "Maximum_Iterations_Exceeded": (
        "the search was not over after {iterations} iterations",
        "raise solver.max_iterations, or check bounds and horizon",
    ),
    "Invalid_Number_Detected": (
        "a kernel failed, or gave a number that is not finite",
        "check the start and the bounds for poses that the model cannot take",
    ),
    "Not_Enough_Degrees_Of_Freedom": (
        "more is asked for than the inputs can do",
        "drop a constraint, or take more intervals",
    ),
    "NonIpopt_Exception_Thrown": ("the search was interrupted", "let it run to its end"),
    "Diverging_Iterates": (
        "the iterates run away: the cost seems to have no lower bound",
        "bound what can grow, or give the cost a term that grows with it",
    ),
    "Restoration_Failed": (
        "the search could not come closer to meeting the constraints after {iterations} iterations",
        "try another guess, or check target, bounds and horizon",
    ),
    "Maximum_CpuTime_Exceeded": ("the search was not over in its time", "raise max_cpu_time, or drop it"),
    "Maximum_WallTime_Exceeded": ("the search was not over in its time", "raise max_wall_time, or drop it"),
}
_UNKNOWN = ("the solver ended with {status} after {iterations} iterations", "check bounds, horizon and guess")

NUDGE = 1e-2  # relative, and absolute below 1: what a guess is moved by that the solver found nothing to improve in


class Solver:
    """A transcribed problem, to be solved for any start, targets, bounds and weights."""

    def __init__(self, problem: Problem, plant: Plant) -> None:
        """Transcribe a problem. Raises ProblemError with every fault of it."""
        check_problem(problem, plant.manifest)
        self.plant = plant
        self.transcription = transcribe(problem, plant)
        self._solvers: dict[SolverOptions, tuple[ca.Function, _Callback]] = {}

    def solve(self, problem: Problem, guess: Trajectory, watch: Watch | None = None) -> Solution | Failure:
        """Solve a problem of the same structure from a guess on its grid; `watch` is told of every iteration.

        A guess in which the solver finds nothing to improve may be a saddle or a maximum as well, so it is moved a
        little and solved again. Raises ProblemError for a problem with faults, ValueError for one of another structure.
        """
        check_problem(problem, self.plant.manifest)
        if structure(problem) != self.transcription.structure:
            raise ValueError(f"{problem.name} differs in structure from what was transcribed; make a Solver for it")
        crossed = self._find_crossed_bounds(problem)
        if crossed:
            return Failure(problem, Run(solution.BAD_BOUNDS, 0, 0.0, 0.0), crossed, "give bounds that leave room")
        x = self.transcription.pack(guess)
        if not np.isfinite(x).all():
            finding = "the guess has numbers that are not finite"
            return Failure(problem, Run(solution.BAD_GUESS, 0, 0.0, 0.0), finding, "take another guess")
        run, found = self._call(problem, x, watch)
        if run.status == solution.SOLVED and run.iterations == 0:
            nudge = NUDGE * np.maximum(np.abs(x), 1.0) * np.random.default_rng(0).uniform(-1.0, 1.0, x.size)
            run, found = self._call(problem, x + nudge, watch)
            if run.status == solution.SOLVED:  # a saddle may be met again from one side, but not from the other
                run, found = self._call(problem, x - nudge, watch)
        if run.status not in (solution.SOLVED, solution.ACCEPTABLE) or not np.isfinite(found).all():
            finding, remedy = _REASONS.get(run.status, _UNKNOWN)
            return Failure(problem, run, finding.format(**vars(run)), remedy)
        return self._solution(problem, run, found)

    def _find_crossed_bounds(self, problem: Problem) -> str | None:
        """Name the first bound that no number can keep, which solvers would answer with an exception."""
        m = self.plant.manifest
        names = [c.name for c in m.coordinates]
        bounds = problem.bounds
        for kind, ranges, of in (
            ("coordinate", bounds.q, m.positions),
            ("velocity", bounds.qd, names),
            ("input", bounds.u, [names[i] for i in m.actuated]),
            ("constraint", [c.range for c in problem.constraints], [c.expression for c in problem.constraints]),
        ):
            for (lower, upper), name in zip(ranges, of, strict=True):
                if not (lower <= upper and lower < np.inf and upper > -np.inf):
                    return f"the bounds of {kind} {name} are [{lower:g}, {upper:g}]"
        return None

    def _call(self, problem: Problem, x: Array, watch: Watch | None) -> tuple[Run, Array]:
        """Let the solver run from x."""
        lower, upper = self.transcription.variable_bounds(problem)
        g_lower, g_upper = self.transcription.constraint_bounds(problem)
        parameters = self.transcription.parameters(problem)
        function, callback = self._solver(problem)
        callback.begin(watch, g_lower, g_upper)
        begin, cpu_begin = time.perf_counter(), time.process_time()
        answer = function(x0=x, p=parameters, lbx=lower, ubx=upper, lbg=g_lower, ubg=g_upper)
        seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
        callback.end()
        return _run(function.stats(), seconds, cpu_seconds), answer["x"].full().ravel()

    def _solution(self, problem: Problem, run: Run, x: Array) -> Solution:
        manifest, transcription = self.plant.manifest, self.transcription
        program, trajectory = transcription.program, transcription.unpack(x)
        g = program.constraint(x, transcription.parameters(problem)).full().ravel()
        return Solution(
            problem=problem,
            model=manifest.model,
            model_hash=manifest.model_hash,
            coordinates=manifest.positions,
            inputs=tuple(manifest.coordinates[i].name for i in manifest.actuated),
            run=run,
            size=Size(
                program.variables,
                program.constraints,
                program.jacobian.nnz_out(1),
                program.hessian.nnz_out(0),
            ),
            cost=CostTerms(transcription.cost_terms(problem, x)),
            violation=Violation(
                _excess(g, *transcription.constraint_bounds(problem)),
                _excess(x, *transcription.variable_bounds(problem)),
                _measure_lengths(trajectory, manifest),
            ),
            trajectory=trajectory,
        )

    def _solver(self, problem: Problem) -> tuple[ca.Function, _Callback]:
        """Make the solver with the options of a problem, once for all that have the same."""
        weight = max(map(abs, problem.cost.weights))
        options = replace(problem.solver, objective_scaling=problem.solver.objective_scaling or 1 / weight)
        if options not in self._solvers:
            program, method = self.transcription.program, METHODS[options.method]
            scaling = options.objective_scaling or 1.0
            callback = _Callback(program, scaling if method.scales_outside else 1.0)
            told = dict(options.options)
            order = Order(program, options.tolerance, options.max_iterations, scaling, told, callback)
            self._solvers[options] = (method.make(order), callback)
        return self._solvers[options]


def solve(
    problem: Problem, plant: Plant, watch: Watch | None = None, guess: Trajectory | None = None
) -> Solution | Failure:
    """Solve a problem from a guess, by default the one that it describes; a guess may be on any grid.

    Where no pose meets the targets, that is said at once. Raises ProblemError with every fault of the problem.
    """
    check_problem(problem, plant.manifest)
    scheme = schemes.build(problem.family, problem.degree)
    start = make_guess(problem, plant, scheme) if guess is None else adapt(guess, problem, scheme)
    if isinstance(start, Pose):
        return Failure(
            problem,
            Run(solution.UNREACHABLE, 0, 0.0, 0.0),
            f"no pose within the bounds meets the targets; the nearest one found is {start.distance:.3g} m or rad away",
            "move the target or widen the bounds",
        )
    return Solver(problem, plant).solve(problem, start, watch)


class _Callback(ca.Callback):
    """Tells a watch of every iteration."""

    def __init__(self, program: NonlinearProgram, scale: float) -> None:
        """Make it for a program, of which the solver sees the cost times `scale`."""
        super().__init__()
        variables, constraints = program.variables, program.constraints
        sizes = {"x": variables, "f": 1, "g": constraints, "lam_x": variables, "lam_g": constraints}
        self._patterns = [ca.Sparsity.dense(sizes.get(name, program.parameters)) for name in ca.nlpsol_out()]
        self._scale = scale
        self._watch: Watch | None = None
        self._bounds: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
        self._iteration = 0
        self._error: Exception | None = None
        self.construct("watch")

    def begin(self, watch: Watch | None, lower: Array, upper: Array) -> None:
        """Count from 0 again; g must lie within the bounds."""
        self._watch, self._bounds, self._iteration, self._error = watch, (lower, upper), 0, None

    def end(self) -> None:
        """Raise what the watch raised, which CasADi would turn into a warning."""
        if self._error is not None:
            raise self._error

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._patterns[i]

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        if self._watch is not None:
            cost, g = float(arguments[1]) / self._scale, arguments[2].full().ravel()
            try:
                self._watch(Progress(self._iteration, cost, _excess(g, *self._bounds)))
            except Exception as error:
                self._error = error
                return [ca.DM(1)]  # asks IPOPT to stop
        self._iteration += 1
        return [ca.DM(0)]


def _run(statistics: dict[str, Any], seconds: float, cpu_seconds: float) -> Run:
    evaluating, cpu_evaluating = (
        sum(value for key, value in statistics.items() if key.startswith(f"t_{clock}_nlp_"))
        for clock in ("wall", "proc")
    )
    iterations = statistics["iter_count"]
    return Run(read_status(statistics), iterations, seconds, evaluating, cpu_seconds, cpu_evaluating)


def _measure_lengths(trajectory: Trajectory, manifest: Manifest) -> float | None:
    """Tell how far from 1 a quaternion's length comes, at mesh and collocation points."""
    if not manifest.quaternions:
        return None
    lengths = (measure_lengths(q, manifest) for q in (trajectory.q, trajectory.point_q))
    return max(float(np.abs(length - 1).max()) for length in lengths)


def _excess(values: Array, lower: Array, upper: Array) -> float:
    """Tell by how much values leave their bounds: the largest."""
    return float(np.maximum(lower - values, values - upper).max(initial=0.0))
