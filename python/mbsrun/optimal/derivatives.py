"""Derivatives of a solution by numbers of its problem, in Python: by name, along a change, or of one function of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from mbsgen.documents import nearest
from mbsgen.errors import MbsError
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.optima.movement import measure_step, take_differences
from mbsrun.ocp.optima.neighbours import Moved as Change
from mbsrun.ocp.optima.neighbours import move_one_sided, predict
from mbsrun.ocp.optima.questions import Answer, ask
from mbsrun.ocp.optima.status import SENTENCES, SMOOTH
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solving.phases import Make
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.transcription.transcription import Transcription
from mbsrun.optimal import display
from mbsrun.optimal.naming import Source

PARTS = ("q", "qd", "u", "states", "controls", "unknowns", "t")  # of a motion, that a function may read


class NoDerivativeError(MbsError):
    """A derivative that does not exist."""


@dataclass(frozen=True, eq=False, repr=False)
class Derivatives:
    """How a solution moves with numbers of its problem.

    `status` says whether it has derivatives at all, `statuses` by each number; `explain` puts a status in a sentence.
    Where a derivative does not exist, asking for it raises NoDerivativeError, and arrays hold NaN.
    """

    name: str  # of the problem
    answer: Answer

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the numbers."""
        return tuple(number.name for number in self.answer.numbers)

    @property
    def status(self) -> str:
        """Return `Differentiable`, or why the solution has no derivatives."""
        return self.answer.movement.status

    @cached_property
    def statuses(self) -> MappingProxyType[str, str]:
        """Return the status by each number."""
        found = {name: self.answer.movement.find_status(k) for k, name in enumerate(self.names)}
        return MappingProxyType(found)

    @property
    def reason(self) -> str:
        """Return the status as a sentence."""
        return SENTENCES[self.status]

    @property
    def active(self) -> int:
        """Return how many bounds and inequalities hold with equality."""
        active = self.answer.movement.optimum.active
        return int((np.abs(active.variables) == 1).sum() + (np.abs(active.rows) == 1).sum())

    @cached_property
    def cost(self) -> MappingProxyType[str, float]:
        """Return the derivatives of the optimal cost by each number; NaN where there is none."""
        return MappingProxyType(dict(zip(self.names, self.answer.movement.find_costs().tolist(), strict=True)))

    def by(self, name: str) -> Moved:
        """Return the derivatives of the whole motion by a number. Raises NoDerivativeError, ProblemError."""
        return self.along({name: 1.0})

    def along(self, direction: Mapping[str, float]) -> Moved:
        """Return the derivatives of the whole motion along a change of several numbers.

        Raises NoDerivativeError, ProblemError for a name that is none.
        """
        dx = np.zeros(self.answer.movement.optimum.x.size)
        for name, rate in direction.items():
            dx += rate * self.answer.movement.move(self._find(name))
        cost = sum(rate * self.cost[name] for name, rate in direction.items())
        return Moved(tuple(self._unpack(dx)), float(cost))

    def one_sided(self, direction: Mapping[str, float]) -> Moved:
        """Return the derivatives of the whole motion where numbers begin to change in a direction, and not back.

        They exist where limits are weakly active, too, which `by` and `along` refuse. Raises NoDerivativeError,
        ProblemError for a name that is none.
        """
        movement, rates = self.answer.movement, self._list_rates(direction)
        return self._give(move_one_sided(movement, rates), rates, "one-sided derivative")

    def predict(self, changes: Mapping[str, float], *, active_set: bool = True) -> Moved:
        """Return the change of the motion for finite changes of numbers, to first order.

        With `active_set`, limits become active and inactive on the way, as in a quadratic program at the solution;
        else the prediction is tangential. Raises NoDerivativeError, ProblemError for a name that is none.
        """
        if not active_set:
            return self.along(changes)
        movement, rates = self.answer.movement, self._list_rates(changes)
        return self._give(predict(movement, rates), rates, "prediction")

    def _list_rates(self, direction: Mapping[str, float]) -> list[float]:
        rates = [0.0] * len(self.names)
        for name, rate in direction.items():
            rates[self._look(name)] = float(rate)
        return rates

    def _give(self, found: Change, rates: Sequence[float], what: str) -> Moved:
        if found.status != SMOOTH:
            raise NoDerivativeError(f"{self.name} has no {what} ({found.status}): {SENTENCES[found.status]}")
        costs = self.answer.movement.find_costs()
        cost = sum(rate * cost for rate, cost in zip(rates, costs.tolist(), strict=True) if rate)
        return Moved(tuple(self._unpack(found.dx)), float(cost), found.changes)

    def pull(self, weights: Mapping[str, Any], phase: str = "") -> MappingProxyType[str, float]:
        """Return the derivatives of a sum of products, by each number: one solve with the factors for all of them.

        `weights` are arrays by the names of parts of a motion, with the shapes that a trajectory has at mesh points:
        `q` (N + 1, nq), `qd` (N + 1, n), `u` (N, m), `states`, `controls`, `unknowns` and `t` (N + 1,). The function is
        the sum of weights times entries, so the weights are the gradient of any function of the motion. NaN stands
        where there is no derivative. Raises ProblemError for other names and shapes.
        """
        gradient = self._place(weights, phase)
        found = self.answer.movement.pull(gradient)
        return MappingProxyType(dict(zip(self.names, found.tolist(), strict=True)))

    def explain(self) -> dict[str, str]:
        """Return a sentence for each number by which there is no derivative."""
        return {name: SENTENCES[status] for name, status in self.statuses.items() if status != SMOOTH}

    def __repr__(self) -> str:
        rows = {"status": self.status, "active limits": str(self.active)}
        rows |= {f"d cost / d {name}": f"{value:.8g}" for name, value in self.cost.items()}
        return display.write_text(f"derivatives of {self.name}", rows)

    def _look(self, name: str) -> int:
        if name not in self.names:
            meant = nearest(name, self.names)
            remedy = f"did you mean {meant}?" if meant else f"there are {', '.join(self.names)}"
            raise ProblemError(self.name, [(name, "the derivatives have no such number", remedy)])
        return self.names.index(name)

    def _find(self, name: str) -> int:
        k = self._look(name)
        status = self.answer.movement.find_status(k)
        if status != SMOOTH:
            raise NoDerivativeError(f"{self.name} has no derivative by {name} ({status}): {SENTENCES[status]}")
        return k

    def _unpack(self, dx: Array) -> list[Trajectory]:
        """Return the derivatives of all motions, which are read off the variables by smooth functions."""
        x = self.answer.movement.optimum.x
        transcription, functions = self.answer.solver.transcription, self.answer.solver.program.numpy
        names = [part.name for part in fields(Trajectory)]

        def read(d: float) -> list[Array]:
            motions = transcription.unpack(functions.complete(x + d * dx))
            return [getattr(motion, name) for motion in motions for name in names]

        found, count = take_differences(read, measure_step(dx, x)), len(names)
        parts = [found[i : i + count] for i in range(0, len(found), count)]
        moved = [Trajectory(**dict(zip(names, part, strict=True))) for part in parts]
        return [self.trim(k, motion) for k, motion in enumerate(moved)]

    def trim(self, phase: int, motion: Trajectory) -> Trajectory:
        """Return a motion without the parameters that are held as unknowns."""
        return replace(motion, unknowns=motion.unknowns[: self._count_own(phase)])

    def read_unknowns(self, x: Array) -> tuple[tuple[str, float], ...]:
        """Return the unknowns of the problem by name, off the variables that a solver sees."""
        answer = self.answer
        places = answer.solver.transcription.list_unknowns(answer.problem)
        seen = {name: answer.solver.transcription.see(at)[0] for name, at in places.items()}
        return tuple((name, float(x[k])) for name, k in seen.items() if name not in answer.held)

    def _count_own(self, phase: int) -> int:
        """Count the unknowns of a phase without the parameters that are held as such."""
        return len(self.answer.list_unknowns(phase))

    def _place(self, weights: Mapping[str, Any], phase: str) -> Array:
        """Return the gradient of a sum of products by the variables that a solver sees."""
        whole = self.answer.solver.transcription
        names = [own.name for own in self.answer.problem.phases]
        if phase not in names:
            raise ProblemError(self.name, [(phase or "phase", "no such phase", f"give one of {', '.join(names)}")])
        k = names.index(phase)
        motion = self.answer.guess.trajectories[k]
        shapes = {name: getattr(motion, name).shape for name in PARTS} | {"unknowns": (self._count_own(k),)}
        values = read_weights(self.name, weights, shapes)
        gradient, own = np.zeros(whole.program.variables), whole.phases[k]
        start = whole.offsets[k].variables
        part = gradient[start : start + own.layout.size]
        try:
            _scatter(part, own, values, motion.t)
        except _UnreadError as error:
            raise ProblemError(self.name, [error.line]) from None
        return gradient[whole.program.kept]


def read_weights(name: str, weights: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    """Return weights of results with these shapes as arrays. Raises ProblemError with all that do not fit."""
    values, findings = dict[str, Array](), list[tuple[str, str, str]]()
    for part, weight in weights.items():
        if part not in shapes:
            findings.append((part, "no part of a motion that a function may read", f"give {', '.join(shapes)}"))
            continue
        try:
            values[part] = np.asarray(weight, dtype=np.float64)
        except (TypeError, ValueError):
            findings.append((part, "no array of numbers", f"give the shape {shapes[part]}"))
            continue
        if values[part].shape != shapes[part]:
            findings.append((part, f"weights of shape {values[part].shape}", f"give the shape {shapes[part]}"))
    if findings:
        raise ProblemError(name, findings)
    return values


class _UnreadError(Exception):
    """A weight of a number that is no variable."""

    def __init__(self, *line: str) -> None:
        super().__init__()
        name, finding, remedy = line
        self.line = name, finding, remedy


def _scatter(gradient: Array, own: Transcription, weights: Mapping[str, Array], t: Array) -> None:
    """Add weights of a motion to the gradient by the variables of its phase."""
    layout, extras = own.layout, own.layout.extras
    is_constant = own.structure.inputs == "constant"
    share = own.scheme.weights[None, :, None]  # of the points in means over intervals
    for name, value in weights.items():
        if name == "q":
            gradient[layout.mesh[:, : layout.nq]] += value
        elif name == "qd":
            velocities = list(layout.motions.velocities)
            if np.delete(value, velocities, axis=1).any():
                raise _UnreadError(name, "weights of velocities that the loops give", "weigh independent ones")
            gradient[layout.mesh[:, layout.nq :]] += value[:, velocities]
        elif name == "u":
            if value[:, list(extras.given)].any():
                raise _UnreadError(name, "weights of inputs that expressions give", "weigh other inputs")
            free = value[:, list(extras.free)]
            if is_constant:
                gradient[layout.inputs] += free
            else:
                gradient[layout.point_inputs] += share * free[:, None]
        elif name == "states":
            gradient[extras.states] += value
        elif name == "controls" and is_constant:
            gradient[extras.controls] += value
        elif name == "controls":
            np.add.at(gradient, extras.point_controls, share * value[:, None])  # a steady control is one variable
        elif name == "unknowns":
            gradient[layout.unknowns[: value.size]] += value
        elif layout.horizons.size:
            gradient[layout.horizons] += float(value @ t) / t[-1]


def differentiate_solution(
    source: Source, solution: PhasedSolution, plants: Plants, by: Sequence[str] | None, make: Make
) -> Derivatives:
    """Return how a solution moves with numbers of its problem; None: all. Raises ProblemError."""
    names = source.list_names() if by is None else tuple(by)
    numbers = tuple(source.find(name) for name in dict.fromkeys(names))
    answer = ask(solution, source.state(source.data), plants, numbers, make, is_strict=by is not None)
    return Derivatives(source.name, answer)


@dataclass(frozen=True, eq=False)
class Moved:
    """Derivatives of motions by a number, or along a change of several.

    `phases` has a trajectory for each phase, whose arrays are derivatives: `t` of times, `u` of inputs, `q` of
    coordinates, and so on; units are the quantity's over the number's.
    """

    phases: tuple[Trajectory, ...]
    cost: float
    changes: int = 0  # of the active set, in a prediction

    @property
    def trajectory(self) -> Trajectory:
        """Return the derivatives of the one motion of a problem without phases."""
        (own,) = self.phases
        return own

    @property
    def horizon(self) -> float:
        """Return the derivative of the horizon."""
        return float(self.trajectory.t[-1])
