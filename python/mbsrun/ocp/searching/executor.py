"""Execute the trials of a search in this process: each attempt solves one problem from one start.

`trials` plans them, and `search` records outcomes. A `Worker` builds a program once for each structure of a problem,
and solves it again and again. `cluster` starts workers in many processes.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from mbsrun.ocp import methods
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.linear import MUMPS, OWN, choose
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import UNREACHABLE
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import Pose, adapt, balance, find_pose, interpolate, rest
from mbsrun.ocp.guessing.mirror import reflect
from mbsrun.ocp.guessing.starts import coarsen, count_turns, hop, vary
from mbsrun.ocp.methods.ipopt import LINEAR_SOLVER
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.problem.structure import Structure, structure
from mbsrun.ocp.searching.search import Job, Outcome
from mbsrun.ocp.searching.study import Study
from mbsrun.ocp.searching.trials import MULTISTART, Found, Hop, Trial, Varied
from mbsrun.ocp.solution import solution
from mbsrun.ocp.solution.record import Attempt
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import Solver

Environment = Mapping[str, str | int]

# Methods begin with a barrier that would push a motion out of a shallow minimum. These options keep the motion in it.
HOLD = MappingProxyType({"mu_init": 1e-6, "bound_push": 1e-8, "bound_frac": 1e-8})
HOLD_STAGES = (("mu_init", 1e-6), ("bound_push", 1e-8))
DIGITS = 12  # of the hash of the generated code, as outcomes keep it
SOLVERS = 12  # kept for the next trial: the representations, with the standard form and others


def choose_options(problem: Problem, trial: Trial, study: Study) -> Problem:
    """Choose the method of a trial, and add the options that it requires and the problem does not state.

    Searches for optima take the method of the study, unless the problem states options of IPOPT. The other protocols
    compare times with the paper's, so they take IPOPT with the study's linear solver. A problem that states an option
    of MUMPS takes MUMPS.
    """
    solver = problem.solver
    is_held = isinstance(trial.start, Found) and trial.start.is_held
    if solver.method not in (None, "ipopt"):
        return problem
    is_free = not solver.options or methods.choose(solver) == "mbs"
    if trial.protocol in ("robust", MULTISTART) and study.method == "mbs" and is_free:
        options = dict(HOLD_STAGES if is_held else ()) | dict(solver.options)
        return replace(problem, solver=replace(solver, method="mbs", options=tuple(options.items())))
    wanted = OWN if trial.protocol in ("robust", MULTISTART) else study.linear_solver
    is_bound = any(name.startswith(MUMPS) for name, _ in solver.options)
    told: dict[str, float | int | str] = {LINEAR_SOLVER: MUMPS if is_bound else choose(wanted)}
    if is_held:
        told |= HOLD
    return replace(
        problem, solver=replace(solver, method="ipopt", options=tuple((told | dict(solver.options)).items()))
    )


def state(order: Job) -> Problem:
    """State the problem of an order, with its method and options."""
    return choose_options(order.study.state(order.trial.task), order.trial, order.study)


class Worker:
    """Makes attempts in one process; it builds a program once for each structure, and keeps some of them."""

    def __init__(self, plant: Plant, environment: Environment = MappingProxyType({})) -> None:
        """Take the kernels of a model; every outcome contains `environment`, versions and machine."""
        self.plant, self.environment = plant, environment
        self._solvers: OrderedDict[Structure, Solver] = OrderedDict()
        self._poses: dict[tuple[object, ...], Pose] = {}

    def carry_out(self, order: Job) -> Outcome:
        """Solve the problem of a trial from its start, and return the attempt for the record."""
        trial, problem = order.trial, state(order)
        found = self.solve(order)
        if isinstance(found, Failure) or found.is_only_acceptable:
            return self._tell(trial, problem, found.run, None)
        return self._tell(trial, problem, found.run, resimulate(found, self.plant) if trial.is_checked else found)

    def solve(self, order: Job) -> Solution | Failure:
        """Solve the problem of a trial from its start; the processor time includes a coarse solve."""
        trial, problem = order.trial, state(order)
        guess = self.make_guess(order, problem)
        if guess is None:
            run = solution.Run(UNREACHABLE, 0, 0.0, 0.0)
            return Failure(problem, run, "no pose meets the targets", "move the target or widen the bounds")
        begun = 0.0  # processor time of a coarse solve
        coarse = coarsen(problem, trial.start.variation) if isinstance(trial.start, Varied) else None
        if coarse is not None:
            first = self._find_solver(coarse).solve(coarse, guess)
            if isinstance(first, Failure):
                return replace(first, problem=problem, run=replace(first.run, status=f"Coarse_{first.run.status}"))
            begun = first.run.cpu_seconds
            guess = adapt(first.trajectory, problem, schemes.build(problem.family, problem.degree))
        found = self._find_solver(problem).solve(problem, guess)
        return replace(found, run=replace(found.run, cpu_seconds=found.run.cpu_seconds + begun))

    def _tell(self, trial: Trial, problem: Problem, run: solution.Run, found: Solution | None) -> Outcome:
        effort = (run.status, run.iterations, run.cpu_seconds, run.cpu_seconds_evaluating)
        named = (trial.task, trial.protocol, trial.part, trial.guess, trial.round)
        solver = {"solver": problem.solver.method, **dict(problem.solver.options)}
        code = {"model": self.plant.manifest.model, "generated": self.plant.manifest.model_hash[:DIGITS]}
        told = json.dumps({**self.environment, **code, **solver})
        if found is None:
            return Outcome(Attempt(*named, *effort, None), None, told)
        size, check = found.size, found.resimulation
        attempt = Attempt(
            *named,
            *effort,
            found.cost.total,
            defect=None if check is None else check.defect,
            variables=size.variables,
            constraints=size.constraints,
            jacobian_nonzeros=size.jacobian_nonzeros,
            hessian_nonzeros=size.hessian_nonzeros,
            turns=count_turns(found.trajectory, problem, self.plant.manifest),
        )
        return Outcome(attempt, found.trajectory, told)

    def _find_solver(self, problem: Problem) -> Solver:
        shape = structure(problem)
        solver = self._solvers.pop(shape, None) or Solver(problem, self.plant)
        self._solvers[shape] = solver
        if len(self._solvers) > SOLVERS:
            self._solvers.popitem(last=False)
        return solver

    def make_guess(self, order: Job, problem: Problem) -> Trajectory | None:
        """Return the motion that a trial starts from, on its mesh or a coarse one; None for a target out of reach."""
        scheme, start = schemes.build(problem.family, problem.degree), order.trial.start
        if isinstance(start, Found):
            assert order.motion is not None, "a trial that starts from a motion is ordered with it"
            own, signs = order.motion, order.study.mirror
            return adapt(reflect(own, signs, self.plant.manifest) if start.is_mirrored else own, problem, scheme)
        if isinstance(start, Hop):
            assert order.motion is not None, "a hop is ordered with the motion that it starts from"
            return hop(adapt(order.motion, problem, scheme), problem, self.plant, start.seed)
        if isinstance(start, Varied):
            chosen = coarsen(problem, start.variation) or problem
            scheme = schemes.build(chosen.family, chosen.degree)
            return vary(start.variation, chosen, self.plant, scheme, order.study.bumped)
        motion = self._move(problem)
        return None if motion is None else balance(motion, problem, self.plant, start.inputs)

    def _move(self, problem: Problem) -> Trajectory | None:
        scheme = schemes.build(problem.family, problem.degree)
        if problem.guess.motion == "rest":
            return rest(problem, scheme, self.plant)
        end = problem.end
        key = (
            *(problem.start_q, problem.bounds.q, problem.guess.upright),
            *(end.sensors, end.coordinates, end.orientations),
        )
        if key not in self._poses:
            self._poses[key] = find_pose(problem, self.plant)
        pose = self._poses[key]
        motion = interpolate(problem, scheme, pose.q, self.plant) if pose.is_reached else None
        return None if motion is None or not np.isfinite(motion.point_q).all() else motion


class LocalExecutor:
    """Executes orders one by one, in this process."""

    def __init__(self, plant: Plant, environment: Environment = MappingProxyType({})) -> None:
        self._worker = Worker(plant, environment)

    def carry_out(self, orders: Iterable[Job]) -> Iterator[Outcome]:
        """Carry out orders in their sequence."""
        yield from map(self._worker.carry_out, orders)
