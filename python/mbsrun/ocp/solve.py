"""IPOPT on a transcribed problem: Problem and plant -> Solution or Failure.

The program is built once for all problems of one structure, and IPOPT gets its exact derivatives. What does not
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

from mbsrun.ocp import solution
from mbsrun.ocp.guess import find_pose, interpolate
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem, SolverOptions
from mbsrun.ocp.solution import CostTerms, Failure, Run, Size, Solution, Violation
from mbsrun.ocp.trajectory import Trajectory
from mbsrun.ocp.transcription import structure, transcribe

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Progress:
    """Where the solver is."""

    iteration: int
    cost: float
    violation: float  # of the constraints, the largest


Watch = Callable[[Progress], None]

# MUMPS orders by AMD, and neither scales nor permutes: it is fastest so on the banded systems of collocation.
_IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "nlp_scaling_method": "none",
    "linear_solver": "mumps",
    "mumps_pivot_order": 0,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
}

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
}
_UNKNOWN = ("IPOPT ended with {status} after {iterations} iterations", "check bounds, horizon and guess")


class Solver:
    """A transcribed problem, to be solved for any start, targets, bounds and weights."""

    def __init__(self, problem: Problem, plant: Plant) -> None:
        """Transcribe a problem."""
        self.plant = plant
        self.transcription = transcribe(problem, plant)
        self._solvers: dict[SolverOptions, tuple[ca.Function, _Callback]] = {}

    def solve(self, problem: Problem, guess: Trajectory, watch: Watch | None = None) -> Solution | Failure:
        """Solve a problem of the same structure from a guess; `watch` is told of every iteration."""
        if structure(problem) != self.transcription.structure:
            raise ValueError(f"{problem.name} differs in structure from what was transcribed; make a Solver for it")
        transcription = self.transcription
        lower, upper = transcription.variable_bounds(problem)
        g_lower, g_upper = transcription.constraint_bounds(problem)
        ipopt, callback = self._solver(problem)
        callback.begin(watch, g_lower, g_upper)
        begin = time.perf_counter()
        answer = ipopt(
            x0=transcription.pack(guess),
            p=transcription.parameters(problem),
            lbx=lower,
            ubx=upper,
            lbg=g_lower,
            ubg=g_upper,
        )
        callback.end()
        run = _run(ipopt.stats(), time.perf_counter() - begin)
        x = answer["x"].full().ravel()
        if run.status not in (solution.SOLVED, solution.ACCEPTABLE) or not np.isfinite(x).all():
            finding, remedy = _REASONS.get(run.status, _UNKNOWN)
            return Failure(problem, run, finding.format(**vars(run)), remedy)
        return self._solution(problem, run, x)

    def _solution(self, problem: Problem, run: Run, x: Array) -> Solution:
        manifest, transcription = self.plant.manifest, self.transcription
        program, trajectory = transcription.program, transcription.unpack(x)
        g = program.constraint(x, transcription.parameters(problem)).full().ravel()
        names = tuple(c.name for c in manifest.coordinates)
        return Solution(
            problem=problem,
            model=manifest.model,
            model_hash=manifest.model_hash,
            coordinates=names,
            inputs=tuple(names[i] for i in manifest.actuated),
            run=run,
            size=Size(
                program.variables,
                program.constraints,
                program.jacobian.nnz_out(1),
                program.hessian.nnz_out(0),
            ),
            cost=CostTerms(tuple(transcription.cost_terms(problem, x).items())),
            violation=Violation(
                _excess(g, *transcription.constraint_bounds(problem)),
                _excess(x, *transcription.variable_bounds(problem)),
            ),
            trajectory=trajectory,
        )

    def _solver(self, problem: Problem) -> tuple[ca.Function, _Callback]:
        """Make IPOPT with the options of a problem, once for all that have the same."""
        weight = max(map(abs, problem.cost.weights))
        options = replace(problem.solver, objective_scaling=problem.solver.objective_scaling or 1 / weight)
        if options not in self._solvers:
            program = self.transcription.program
            callback = _Callback(program.variables, program.constraints, program.parameters)
            x, p = ca.MX.sym("x", program.variables), ca.MX.sym("p", program.parameters)
            nlp: dict[str, Any] = {"x": x, "p": p, "f": program.objective(x, p), "g": program.constraint(x, p)}
            settings: dict[str, Any] = {
                "grad_f": program.gradient,
                "jac_g": program.jacobian,
                "hess_lag": program.hessian,
                "iteration_callback": callback,
                "print_time": False,
                "error_on_fail": False,
                "ipopt": {
                    **_IPOPT,
                    "tol": options.tolerance,
                    "max_iter": options.max_iterations,
                    "obj_scaling_factor": options.objective_scaling,
                },
            }
            self._solvers[options] = (ca.nlpsol("ocp", "ipopt", nlp, settings), callback)
        return self._solvers[options]


def solve(problem: Problem, plant: Plant, watch: Watch | None = None) -> Solution | Failure:
    """Solve a problem from an interpolation to a pose that meets its targets; where there is none, say so at once."""
    pose = find_pose(problem, plant)
    if not pose.is_reached:
        return Failure(
            problem,
            Run(solution.UNREACHABLE, 0, 0.0, 0.0),
            f"no pose within the bounds meets the targets; the nearest one found is {pose.distance:.3g} m or rad away",
            "move the target or widen the bounds",
        )
    solver = Solver(problem, plant)
    return solver.solve(problem, interpolate(problem, solver.transcription.scheme, pose.q), watch)


class _Callback(ca.Callback):
    """Tells a watch of every iteration."""

    def __init__(self, variables: int, constraints: int, parameters: int) -> None:
        super().__init__()
        sizes = {"x": variables, "f": 1, "g": constraints, "lam_x": variables, "lam_g": constraints}
        self._patterns = [ca.Sparsity.dense(sizes.get(name, parameters)) for name in ca.nlpsol_out()]
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
            cost, g = float(arguments[1]), arguments[2].full().ravel()
            try:
                self._watch(Progress(self._iteration, cost, _excess(g, *self._bounds)))
            except Exception as error:
                self._error = error
                return [ca.DM(1)]  # asks IPOPT to stop
        self._iteration += 1
        return [ca.DM(0)]


def _run(statistics: dict[str, Any], seconds: float) -> Run:
    evaluating = sum(value for key, value in statistics.items() if key.startswith("t_wall_nlp_"))
    return Run(statistics["return_status"], statistics["iter_count"], seconds, evaluating)


def _excess(values: Array, lower: Array, upper: Array) -> float:
    """Tell by how much values leave their bounds: the largest."""
    return float(np.maximum(lower - values, values - upper).max(initial=0.0))
