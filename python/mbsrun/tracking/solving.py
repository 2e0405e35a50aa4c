"""A controller that solves its problem to a tolerance at each sample, by a method of `ocp.methods`.

The problem is transcribed once. Each solve starts from the last plan, moved ahead by the time that has passed:
the standard warm start of model predictive control, see Diehl, Ferreau, Haverbeke, "Efficient numerical methods for
nonlinear MPC and moving horizon estimation", LNCIS 384 (2009), section 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp import methods, schemes
from mbsrun.ocp.checks import ProblemError
from mbsrun.ocp.guess import Pose, make_guess
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.solution import Failure
from mbsrun.ocp.solve import Solver, choose_method, settle
from mbsrun.ocp.trajectory import Trajectory, average_inputs, move_ahead
from mbsrun.tracking.controller import Decision
from mbsrun.tracking.trial import Horizon

Array = NDArray[np.float64]

UNREACHED = "No_Guess"


class SolvingController:
    """Solves an optimal control problem from each measured state."""

    def __init__(self, problem: Problem, plant: Plant, period: float, horizon: Horizon | None = None) -> None:
        """Take a problem, of which every sample replaces the start, and the horizon where it shrinks.

        Raises ProblemError for a problem with faults.
        """
        if problem.inputs != "constant":
            finding = "a sample holds its inputs from sample to sample, and these change within an interval"
            raise ProblemError(problem.name, [("inputs", finding, "take constant ones")])
        if problem.every_component or problem.forces:
            finding = "the simulated plant takes the inputs u alone, and the problem gives further forces"
            raise ProblemError(problem.name, [("forces", finding, "leave forces, wrenches and contacts out")])
        if problem.every_state or problem.controls:
            finding = "a sample measures coordinates and velocities, and the problem adds states or controls"
            raise ProblemError(problem.name, [("states", finding, "leave them out")])
        if problem.driven:
            finding = "each plan would move driven joints from the start of their motions, and the plant holds them"
            remedy = "give these joints actuators in the model, and references or constraints that they follow"
            raise ProblemError(problem.name, [("driven", finding, remedy)])
        self.period, self.horizon = period, horizon
        problem = replace(
            problem, solver=replace(problem.solver, fallback=False)
        )  # a sample waits for one method alone
        self._plant, self._problem, self._next = plant, self._shape(problem, 0.0), problem
        self._solver: Solver | None = None
        self._plan: Trajectory | None = None
        self._begun, self._time = 0.0, 0.0

    def prepare(self, time: float, constants: Mapping[str, float]) -> None:
        """Set the time and the constants of the next solve."""
        known = {**dict(self._problem.constants), **constants}
        problem = self._shape(self._problem, time)
        self._next = replace(problem, constants=tuple((name, known[name]) for name, _ in problem.constants))
        self._time = time

    def feedback(self, q: Array, qd: Array) -> Decision:
        """Solve from a state; a plan that is found is kept."""
        problem = replace(self._next, start_q=tuple(q.tolist()), start_qd=tuple(qd.tolist()))
        guess = self._guess(problem)
        if isinstance(guess, Pose):
            return Decision(self.planned(self._time), UNREACHED, False, 0, 0.0, math.nan)
        if self._solver is None:
            problem = self._problem = self._next = settle(problem, self._plant, guess)
            self._solver = Solver(problem, self._plant)
        outcome = self._solver.solve(problem, guess)
        run = outcome.run
        if isinstance(outcome, Failure):
            return Decision(self.planned(self._time), run.status, False, run.iterations, run.cpu_seconds, math.nan)
        if self._plan is None:
            self._problem = replace(self._problem, solver=methods.warm(choose_method(self._problem, self._plant)))
        self._plan, self._begun = outcome.trajectory, self._time
        return Decision(
            self.planned(self._time), run.status, True, run.iterations, run.cpu_seconds, outcome.violation.constraints
        )

    def planned(self, time: float) -> Array:
        """Return the plan's mean inputs over the period from a time on; zeros where there is no plan yet."""
        if self._plan is None:
            return np.zeros(len(self._problem.bounds.u))
        elapsed = time - self._begun
        return np.asarray(average_inputs(self._plan.t, self._plan.u, np.array([elapsed, elapsed + self.period]))[0])

    def _guess(self, problem: Problem) -> Trajectory | Pose:
        if self._plan is None or self._solver is None:
            return make_guess(problem, self._plant, schemes.build(problem.family, problem.degree))
        scheme = self._solver.transcription.scheme
        times = problem.grid.times(problem.horizon, scheme.points)
        return move_ahead(self._plan, self._time - self._begun, *times)

    def _shape(self, problem: Problem, time: float) -> Problem:
        """Return the problem with its length at a time: one program serves all lengths of a horizon that shrinks."""
        if self.horizon is None:
            return problem
        length = self.horizon.length(time)
        return replace(problem, horizon=length, horizon_range=(length, length))
