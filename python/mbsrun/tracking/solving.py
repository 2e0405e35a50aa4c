"""A controller that solves its problem to a tolerance at each sample, by a method of `ocp.methods`.

The problem is transcribed once. Each solve starts from the last plan, moved ahead by the time that has passed:
the standard warm start of model predictive control, see Diehl, Ferreau, Haverbeke, "Efficient numerical methods for
nonlinear MPC and moving horizon estimation", LNCIS 384 (2009), section 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp import methods
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory, average_inputs, move_ahead
from mbsrun.ocp.guessing.guess import Pose, make_guess
from mbsrun.ocp.problem.problem import Problem, Range, State
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.preparation import settle
from mbsrun.ocp.solving.solve import Solver, choose_method
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.tracking.added import is_interval, list_chosen, list_lines
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
        if problem.every_component:
            finding = "the simulated plant takes inputs u and controls, and the problem gives further forces"
            raise ProblemError(problem.name, [("wrenches", finding, "leave wrenches, signals and contacts out")])
        if problem.delays:
            _check_delays(problem, period, horizon)
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
        self._states: Array = np.zeros(0)
        self._given: dict[int, Array] = {}  # inputs, by the number of the period
        self._lines = list_lines(problem, period)

    def prepare(self, time: float, constants: Mapping[str, float]) -> None:
        """Set the time and the constants of the next solve."""
        known = {**dict(self._problem.constants), **constants}
        problem = self._shape(self._problem, time)
        self._next = replace(problem, constants=tuple((name, known[name]) for name, _ in problem.constants))
        self._time = time

    def measure(self, states: Array) -> None:
        """Take the states that the problem adds."""
        self._states = states

    def note(self, time: float, inputs: Array) -> None:
        """Remember the inputs that are given for a period."""
        self._given[self._number(time)] = inputs

    def feedback(self, q: Array, qd: Array) -> Decision:
        """Solve from a state; a plan that is found is kept."""
        problem = self._follow(replace(self._next, start_q=tuple(q.tolist()), start_qd=tuple(qd.tolist())))
        guess = self._guess(problem)
        if isinstance(guess, Pose):
            return Decision(self.planned(self._time), UNREACHED, False, 0, 0.0, math.nan)
        if self._solver is None:
            problem = self._problem = self._next = settle(problem, self._plant, guess)
            self._solver = Solver(problem, self._plant, is_judged=False)  # as a controller in C, which has no judge
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
        """Return the plan's mean inputs over the period from a time on; zeros where there is no plan yet.

        Inputs that act late are given as much earlier.
        """
        if self._plan is None:
            return np.zeros(len(self._problem.bounds.u) + len(self._problem.controls))
        return self._read(time - self._begun)

    def _read(self, elapsed: float) -> Array:
        """Read the inputs to give in a period off the plan."""
        assert self._plan is not None, "only a plan can be read"
        times = np.array([elapsed, elapsed + self.period])
        chosen, planned = list_chosen(self._problem), np.hstack((self._plan.u, self._plan.controls))
        found = np.zeros(planned.shape[1])
        found[chosen] = average_inputs(self._plan.t, planned[:, chosen], times)[0]
        for line in self._lines:
            later = times + line.periods * self.period
            found[line.input] = average_inputs(self._plan.t, planned, later)[0, line.input]
        return found

    def _number(self, time: float) -> int:
        return round(time / self.period)

    def _follow(self, problem: Problem) -> Problem:
        """Return the problem that follows on the measured states and on the inputs that were given."""
        k = self._number(self._time)
        measured = dict(zip((state.name for state in problem.states), self._states.tolist(), strict=False))
        given = {
            line.input: tuple(float(self._take(k - i, line.input, line.history)) for i in range(line.periods, 0, -1))
            for line in self._lines
        }
        return replace(
            problem,
            states=tuple(_begin(state, measured.get(state.name)) for state in problem.states),
            delays=tuple(
                replace(delay, commands=given[line.input])
                for delay, line in zip(problem.delays, self._lines, strict=True)
            ),
            first_inputs=self._limit_first(problem.bounds.rates, 0, k),
            first_controls=self._limit_first([x.rates for x in problem.controls], len(problem.bounds.u), k),
        )

    def _take(self, k: int, i: int, otherwise: float) -> float:
        return float(self._given[k][i]) if k in self._given else otherwise

    def _limit_first(self, rates: Sequence[Range], begin: int, k: int) -> tuple[Range, ...]:
        """Return ranges of first inputs or controls, from entry `begin` on, that keep their rates after the last."""
        if not rates or k - 1 not in self._given:
            return ()
        late = {line.input for line in self._lines}
        before = self._given[k - 1]
        return tuple(
            (-math.inf, math.inf)
            if i in late
            else (float(before[i]) + self.period * slowest, float(before[i]) + self.period * fastest)
            for i, (slowest, fastest) in enumerate(rates, begin)
        )

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


def _begin(state: State, measured: float | None) -> State:
    """Return a state with a measured start, unless its start is chosen by the plan."""
    return state if measured is None or state.start[0] != state.start[1] else replace(state, start=(measured, measured))


def _check_delays(problem: Problem, period: float, horizon: Horizon | None) -> None:
    """Raise ProblemError for delays that no samples of the loop can have."""
    findings = []
    if any(delay.history is None for delay in problem.delays):
        findings.append(("inputs.history", "the loop knows the inputs before its start", "give their values"))
    if horizon is not None or not is_interval(problem, period):
        finding = f"inputs with delays are planned by intervals, and periods of {period:g} s are none"
        remedy = f"give a rate of {problem.intervals / problem.horizon:g} Hz, and a horizon of one length"
        findings.append(("inputs.delay", finding, remedy))
    if findings:
        raise ProblemError(problem.name, findings)
