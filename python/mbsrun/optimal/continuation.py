"""From a solved problem to a hard one along a number: predict, solve, choose the next step by the prediction's error.

A predictor of first order, with changes of the active set, gives the guess of each solve (Allgower, Georg,
"Introduction to numerical continuation methods", SIAM 2003, chapters 2 and 6). Where no step is short enough, the
motions may turn back: near a turning point v* of the number, the derivative of a motion grows as 1 / sqrt(v* - v). So
the inverse of its square goes to 0 in a straight line, which shows v*.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.optima.movement import STEP
from mbsrun.ocp.optima.neighbours import predict
from mbsrun.ocp.optima.status import SMOOTH
from mbsrun.ocp.solution.phases import Guess
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal import display
from mbsrun.optimal.derivatives import Derivatives
from mbsrun.optimal.result import Solved, Unsolved

REACHED, TURNING, STUCK = "Reached", "Turning_Point", "No_Shorter_Step"
SENTENCES = {
    REACHED: "the value is reached",
    TURNING: "the motions turn back before the value is reached; no motion of this kind lies beyond",
    STUCK: "no step is short enough; the problem may have no solution there, or solutions far from these",
}
FIRST = 0.25  # of the way
SHORTEST = 1e-5  # of the way, below which no step is tried
WISHED, MOST = 0.05, 0.5  # error of a prediction, over the size of the motion
GROWTH, SHRINKING = 3.0, 0.2  # of steps, at most and at least
NEAR = 1e-2  # of the way, from the last motion to a turning point
LIMIT = 500  # solves


@dataclass(frozen=True)
class Stop:
    """A solve on the way."""

    value: float
    is_taken: bool  # False: it failed, or is another motion, so a shorter step follows
    status: str
    cost: float  # NaN where there is none
    iterations: int
    error: float  # of the prediction, over the size of the motion; NaN where there is none
    defect: float  # of the re-simulation, the largest of an interval


@dataclass(frozen=True, eq=False, repr=False)
class Continued:
    """The way along a number, and the solution at its end."""

    name: str  # of the number
    status: str
    stops: tuple[Stop, ...]
    solution: Any  # Solved or SolvedPhases, of the last stop that was taken; Unsolved where the first failed
    turning: float = field(default=math.nan)  # the value at which motions turn, about

    @property
    def is_reached(self) -> bool:
        """Return whether the solution belongs to the value asked for."""
        return self.status == REACHED

    @property
    def value(self) -> float:
        """Return the value that the solution belongs to."""
        return next((stop.value for stop in reversed(self.stops) if stop.is_taken), math.nan)

    @property
    def reason(self) -> str:
        """Return the status as a sentence."""
        at = f", at about {self.turning:.6g}" if self.status == TURNING else ""
        return f"{SENTENCES.get(self.status, self.status)}{at}"

    def __repr__(self) -> str:
        taken = sum(stop.is_taken for stop in self.stops)
        rows = {"number": self.name, "status": f"{self.status}: {self.reason}", "value": f"{self.value:.10g}"}
        return display.write_text("continued", rows | {"steps": f"{taken} of {len(self.stops)} solves"})


Watch = Callable[[Stop], None]


def follow(control: Any, name: str, to: float, guess: Any = None, watch: Watch | None = None) -> Continued:
    """Solve a problem, and go on to another value of a number. Raises ProblemError for a name that is no number."""
    way = _Way(control, name, to, watch or (lambda _: None))
    found = control.solve(guess=guess)
    if isinstance(found, Unsolved):
        way.note(way.start, found, math.nan, is_taken=False)
        return Continued(name, found.status, tuple(way.stops), found)
    way.note(way.start, found, math.nan, is_taken=True)
    return way.go(found)


class _Way:
    """The state of a search along a number."""

    def __init__(self, control: Any, name: str, to: float, watch: Watch) -> None:
        self.control, self.name, self.to, self.watch = control, name, to, watch
        self.start = float(control.read_number(name))
        if not math.isfinite(to):
            raise ProblemError(control.name, [(name, f"found the value {to}", "give a finite one")])
        self.stops: list[Stop] = []
        self.speeds: list[tuple[float, float]] = []  # the size of the derivative at each value

    def go(self, found: Any) -> Continued:
        """Take steps until the value is reached, or none is short enough."""
        value, whole = self.start, self.to - self.start
        step = FIRST * whole
        while value != self.to and len(self.stops) < LIMIT:
            derivatives = self.control.with_numbers({self.name: value}).derivatives(found, [self.name])
            self._measure(value, derivatives)
            taken = False
            while abs(step) >= SHORTEST * abs(whole) and not taken:
                aim = self.to if abs(self.to - value) <= abs(step) * (1 + 1e-9) else value + step
                guess = _guess(derivatives, aim - value)
                after = self.control.with_numbers({self.name: aim}).solve(guess=_give(guess, self.control))
                error = math.nan if isinstance(after, Unsolved) else _compare(guess, after)
                taken = error <= MOST
                self.note(aim, after, error, is_taken=taken)
                factor = math.sqrt(WISHED / max(error, 1e-12)) if math.isfinite(error) else SHRINKING
                step = (aim - value) * min(GROWTH if taken else 0.5, max(SHRINKING, factor))
            if not taken:
                return self._give_up(value, found)
            value, found = aim, after
        status = REACHED if value == self.to else STUCK
        return Continued(self.name, status, tuple(self.stops), found)

    def note(self, value: float, found: Any, error: float, *, is_taken: bool) -> None:
        """Keep a stop, and show it."""
        if isinstance(found, Unsolved):
            stop = Stop(value, is_taken, found.status, math.nan, found.failure.run.iterations, error, math.nan)
        else:
            checks = [own.resimulation for own in _list_solutions(found)]
            defects = [math.nan if x is None or x.defect is None else x.defect for x in checks]
            run = found.solution.run
            stop = Stop(value, is_taken, found.status, found.cost, run.iterations, error, max(defects))
        self.stops.append(stop)
        self.watch(stop)

    def _measure(self, value: float, derivatives: Derivatives) -> None:
        if derivatives.statuses[self.name] == SMOOTH:
            dx = derivatives.answer.movement.move(0)
            self.speeds.append((value, float(np.abs(dx).max(initial=0.0))))

    def _give_up(self, value: float, found: Any) -> Continued:
        """Return the end of a way that goes no farther: at a turning point, or elsewhere."""
        turning = _find_turning(self.speeds)
        is_near = 0 <= (turning - value) / (self.to - self.start) <= NEAR
        status = TURNING if is_near else STUCK
        return Continued(self.name, status, tuple(self.stops), found, turning if is_near else math.nan)


def _find_turning(speeds: list[tuple[float, float]]) -> float:
    """Return where the inverse of the squared speed vanishes, by its last two values; NaN where it does not fall."""
    if len(speeds) < 2:
        return math.nan
    (v, a), (w, b) = ((value, speed**-2 if speed else math.inf) for value, speed in speeds[-2:])
    return w + (w - v) * b / (a - b) if b < a < math.inf else math.nan


def _guess(derivatives: Derivatives, change: float) -> Guess:
    """Return the solution with the predicted change; without one where there is no prediction."""
    answer = derivatives.answer
    found = predict(answer.movement, [change])
    x = answer.movement.optimum.x
    if found.status == SMOOTH:
        x = x + found.dx
    limits = answer.movement.optimum.instance
    held = limits.lower == limits.upper
    x = np.where(held, x, np.clip(x, limits.lower, limits.upper))
    motions = answer.solver.transcription.unpack(answer.solver.program.numpy.complete(x))
    return Guess(tuple(derivatives.trim(k, motion) for k, motion in enumerate(motions)), derivatives.read_unknowns(x))


def _give(guess: Guess, control: Any) -> Any:
    """Return a guess as a problem takes it."""
    return guess if hasattr(control, "plants") else guess.trajectories[0]


def _list_solutions(found: Any) -> list[Any]:
    return [found.solution] if isinstance(found, Solved) else list(found.solution.phases)


def _compare(guess: Guess, found: Any) -> float:
    """Return the largest error of predicted states, over the size of each kind of numbers."""
    errors = [0.0]
    for predicted, solution in zip(guess.trajectories, _list_solutions(found), strict=True):
        for a, b in zip(_list_arrays(predicted), _list_arrays(solution.trajectory), strict=True):
            if b.size:
                errors.append(float(np.abs(a - b).max()) / max(float(np.abs(b).max()), STEP))
    return max(errors)


def _list_arrays(motion: Trajectory) -> tuple[Array, ...]:
    return motion.q, motion.qd, motion.states
