"""Steps of fixed length by the functions of a face, differentiable as these are: Runge-Kutta methods.

A tree's state is (x, v) = (q, qd), with x' = E(q) qd and v' = qdd. A mechanism with closed loops has the independent
coordinates and velocities for (x, v): `close` and `close_rates` give the others, `exp1_red` gives v'. So loops stay
closed, and no coordinate drifts.

The implicit midpoint rule solves g(a) = a - v'(x + h/2 v + h^2/4 a, v + h/2 a) = 0 by Newton's method, outside of all
derivatives. Then two more steps a - G^-1 g(a) with the last, constant matrix G follow inside. They change no value. The
first one has the first derivatives of the solution, since g is 0; the second one has the second derivatives, since the
first derivatives of g are 0, too. With quaternions the unknowns are z = x' and a = v', both in the middle:
z = E(x + h/2 z) (v + h/2 a). As z is perpendicular to the middle of a quaternion, its length stays.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from mbsgen.roles import QUICKEST, Role
from mbsrun.binding import ArgumentError
from mbsrun.faces.face import VALUES, Face
from mbsrun.faces.operators import Operator
from mbsrun.kernel import is_count
from mbsrun.simulation.integration.tableaus import FIXED, Tableau

A = TypeVar("A")  # an array of the library
Policy = Callable[[Any, Any, Any], Mapping[str, Any]]  # of the number of the step, q and qd: further inputs

MIDPOINT = "midpoint"
NEWTON = 6  # steps of Newton's method, from no acceleration
SOLVED = 1e-9  # the sum of residuals of a solution, relative to 1 plus the sum of accelerations


class SteppingFace(Face[A]):
    """A face whose functions can be integrated."""

    def step(
        self, q: Any, qd: Any, h: Any, *, method: str = "rk4", dynamics: str | None = None, **inputs: Any
    ) -> tuple[A, A]:
        """Return q and qd after a step of length h [s], in which the other inputs stay as they are.

        `method` is euler, rk4 or the implicit midpoint. A step whose equations are not solved gives results that are
        not a number. `dynamics` is the function that gives accelerations: exp, and exp1_red for closed loops. The loops
        of the given state are closed. Raises ArgumentError for anything else.
        """
        flow = self._make_flow(method, dynamics, inputs)
        return flow.step(self._read(q), self._read(qd), h)

    @abstractmethod
    def rollout(
        self,
        q: Any,
        qd: Any,
        h: float,
        *,
        steps: int | None = None,
        along: Mapping[str, Any] | None = None,
        policy: Policy | None = None,
        method: str = "rk4",
        dynamics: str | None = None,
        **inputs: Any,
    ) -> tuple[A, A]:
        """Return q and qd at the start and after each of some steps, along a leading axis.

        `along` are inputs with a leading axis of steps; `policy` returns further inputs from the number of a step, q
        and qd; all others are the same in every step. Reverse mode keeps some 2 sqrt(steps) states, and repeats the
        steps between them.
        """

    @abstractmethod
    def _still(self, array: A) -> A:
        """Return an array as a constant of all derivatives."""

    @abstractmethod
    def _slope(self, name: str, inputs: Mapping[str, Any], by: Sequence[str]) -> tuple[Any, ...]:
        """Return the Jacobians of a function's first result by some inputs, as constants."""

    @abstractmethod
    def _solve(self, matrices: A, vectors: A) -> A:
        """Solve linear systems; what cannot be solved is not a number."""

    @abstractmethod
    def _keep(self, is_right: Any, array: A) -> A:
        """Return an array, not a number where it is not right."""

    def _make_flow(self, method: str, dynamics: str | None, inputs: Mapping[str, Any]) -> _Flow | _Midpoint:
        if method not in (*FIXED, MIDPOINT):
            raise ArgumentError(f"method: {method!r} given; there are {', '.join(FIXED)}, {MIDPOINT}")
        manifest = self.manifest
        if manifest.driven or (manifest.loops and manifest.quaternions):
            raise ArgumentError(
                f"{manifest.model}: steps of driven joints, and of closed loops with quaternions, are not made"
            )
        kind, own = (_ClosedFlow, "exp1_red") if manifest.loops else (_Flow, QUICKEST)
        if method != MIDPOINT:
            return kind(self, FIXED[method], dynamics or own, inputs)
        flow = kind(self, FIXED["euler"], dynamics or own, inputs)
        return _TurningMidpoint(flow) if manifest.quaternions else _Midpoint(flow)

    def _count_steps(self, steps: int | None, along: Mapping[str, Any], inputs: Mapping[str, Any]) -> int:
        if not (steps is None or is_count(steps, 0)):
            raise ArgumentError(f"rollout: steps: {steps}; give a whole number, 0 or more")
        twice = sorted(set(along) & set(inputs))
        if twice:
            raise ArgumentError(
                f"rollout: {', '.join(twice)}: given for all steps, and along them; give one of the two"
            )
        lengths = {f"along[{name!r}]": int(array.shape[0]) for name, array in along.items()}
        if steps is not None:
            lengths["steps"] = steps
        if not lengths:
            raise ArgumentError("rollout: give the number of steps, or inputs along them")
        if len(set(lengths.values())) > 1:
            raise ArgumentError(f"rollout: the lengths differ: {', '.join(f'{k} {n}' for k, n in lengths.items())}")
        return next(iter(lengths.values()))


def choose_slopes(
    operator: Operator, blocks: Sequence[Any], by: Sequence[str], make_zeros: Callable[[tuple[int, int]], Any]
) -> tuple[Any, ...]:
    """Return the blocks of the first result by some inputs, of all blocks of a Jacobian; zeros for absent ones."""
    sizes = {port.argument.name: port.argument.nnz for port in operator.value.given}
    names = list(sizes)
    found = {
        names[block.by]: array for block, array in zip(operator.jacobian.blocks, blocks, strict=True) if block.of == 0
    }
    rows = operator.value.sizes[0]
    return tuple(found[name] if name in found else make_zeros((rows, sizes[name])) for name in by)


def divide(steps: int) -> tuple[int, int, int]:
    """Divide steps into blocks for checkpoints: the number of blocks, their length, and the steps that are left."""
    length = max(1, round(steps**0.5))
    return steps // length, length, steps % length


@dataclass(frozen=True)
class _Flow:
    """The equations of motion of a tree, with all inputs but the state."""

    face: SteppingFace[Any]
    tableau: Tableau
    dynamics: str
    inputs: Mapping[str, Any]

    def step(self, q: Any, qd: Any, h: Any) -> tuple[Any, Any]:
        x, v = self.split(q, qd)
        rates: list[Any] = []
        accelerations: list[Any] = []
        for row in self.tableau.A:
            pose, speed = self.place(q, _add(x, h, row, rates)), _add(v, h, row, accelerations)
            rates.append(self.find_rate(pose, speed))
            accelerations.append(self.accelerate(pose, speed))
        return self.join(self.place(q, _add(x, h, self.tableau.b, rates)), _add(v, h, self.tableau.b, accelerations))

    def split(self, q: Any, qd: Any) -> tuple[Any, Any]:
        return q, qd

    def place(self, q: Any, x: Any) -> Any:  # noqa: ARG002
        return x

    def join(self, q: Any, v: Any) -> tuple[Any, Any]:
        return q, v

    def find_rate(self, q: Any, v: Any) -> Any:
        return self._call("rates", Role.RATE, q=q, qd=v) if self.face.manifest.quaternions else v

    def accelerate(self, q: Any, v: Any) -> Any:
        return self._call(self.dynamics, Role.ACCELERATION, q=q, qd=v, **self.inputs)

    def linearise(self, q: Any, v: Any) -> tuple[Any, ...]:
        """Return the derivatives of the accelerations by x and v, as constants."""
        return self.face._slope(self.dynamics, {"q": q, "qd": v, **self.inputs}, ("q", "qd"))

    def linearise_rate(self, q: Any, v: Any) -> tuple[Any, ...]:
        """Return the derivatives of x' by x and v, as constants."""
        return self.face._slope("rates", {"q": q, "qd": v, **self._list_parameters("rates")}, ("q", "qd"))

    def hold(self) -> Self:
        """Return the same equations, whose inputs are constants of all derivatives."""
        face = self.face
        return replace(self, inputs={name: face._still(face._read(x)) for name, x in self.inputs.items()})

    def _call(self, name: str, role: Role, **given: Any) -> Any:
        """Call a function, with the parameters that it takes, and return its result of a role."""
        entry, parameters = self.face._find(name).value.entry, self._list_parameters(name)
        found = next((a.name for a in entry.kernel.outputs if a.role is role), None)
        if found is None:
            raise ArgumentError(f"{name} gives no {role.value}")
        return self.face(name, **{**given, **parameters})[found]

    def _list_parameters(self, name: str) -> Mapping[str, Any]:
        """List the given parameters that a function takes."""
        entry = self.face._find(name).value.entry
        taken = {entry.hidden, entry.design, VALUES if entry.hidden else None}
        return {key: value for key, value in self.inputs.items() if key in taken}


@dataclass(frozen=True)
class _ClosedFlow(_Flow):
    """The equations of motion in the independent coordinates of closed loops."""

    def split(self, q: Any, qd: Any) -> tuple[Any, Any]:
        chosen = self._choose(self.face.manifest.independent)
        return q @ chosen, qd @ chosen

    def place(self, q: Any, x: Any) -> Any:
        independent, dependent = (self._choose(x) for x in (self.face.manifest.independent, self._list_others()))
        return self._call("close", Role.RESULT, q=x @ independent.T + q @ dependent @ dependent.T)

    def join(self, q: Any, v: Any) -> tuple[Any, Any]:
        return q, self._call("close_rates", Role.RESULT, q=q, yd=v)

    def find_rate(self, q: Any, v: Any) -> Any:  # noqa: ARG002
        return v

    def accelerate(self, q: Any, v: Any) -> Any:
        return self._call(self.dynamics, Role.ACCELERATION, q=q, yd=v, **self.inputs)

    def linearise(self, q: Any, v: Any) -> tuple[Any, ...]:
        by_pose, by_speed = self.face._slope(self.dynamics, {"q": q, "yd": v, **self.inputs}, ("q", "yd"))
        (closing,) = self.face._slope("close", {"q": q, **self._list_parameters("close")}, ("q",))
        return by_pose @ closing @ self._choose(self.face.manifest.independent), by_speed

    def _list_others(self) -> Sequence[int]:
        manifest = self.face.manifest
        return [i for i in range(len(manifest.coordinates)) if i not in manifest.independent]

    def _choose(self, entries: Sequence[int]) -> Any:
        return self.face._read(np.eye(len(self.face.manifest.coordinates))[:, list(entries)])


@dataclass(frozen=True)
class _Midpoint:
    """Steps of equations of motion by the implicit midpoint rule; the unknowns w are the accelerations v'."""

    flow: _Flow

    def step(self, q: Any, qd: Any, h: Any) -> tuple[Any, Any]:
        face, constant = self.flow.face, replace(self, flow=self.flow.hold())
        start = face._still(q), face._still(qd)
        w = constant.begin(*start)
        for _ in range(NEWTON):
            w = w - face._solve(constant.linearise(*start, h, w), constant.residual(*start, h, w))
        matrix, gap = constant.linearise(*start, h, w), constant.residual(*start, h, w)
        w = face._keep(abs(gap).sum(-1) <= SOLVED * (1 + abs(w).sum(-1)), w)
        for _ in range(2):
            w = w - face._solve(matrix, self.residual(q, qd, h, w))
        return self.finish(q, qd, h, w)

    def begin(self, q: Any, qd: Any) -> Any:
        return 0.0 * self.flow.split(q, qd)[1]  # a large acceleration would lead far from stiff springs

    def middle(self, q: Any, qd: Any, h: Any, w: Any) -> tuple[Any, Any]:
        x, v = self.flow.split(q, qd)
        return self.flow.place(q, x + h / 2 * v + h**2 / 4 * w), v + h / 2 * w

    def residual(self, q: Any, qd: Any, h: Any, w: Any) -> Any:
        return w - self.flow.accelerate(*self.middle(q, qd, h, w))

    def linearise(self, q: Any, qd: Any, h: Any, w: Any) -> Any:
        """Return the derivative of the residual by the unknowns."""
        by_pose, by_speed = self.flow.linearise(*self.middle(q, qd, h, w))
        return self.flow.face._read(np.eye(by_pose.shape[-1])) - h**2 / 4 * by_pose - h / 2 * by_speed

    def finish(self, q: Any, qd: Any, h: Any, w: Any) -> tuple[Any, Any]:
        x, v = self.flow.split(q, qd)
        return self.flow.join(self.flow.place(q, x + h * v + h**2 / 2 * w), v + h * w)


@dataclass(frozen=True)
class _TurningMidpoint(_Midpoint):
    """The same with quaternions; the unknowns w are x' and then v'."""

    def begin(self, q: Any, qd: Any) -> Any:
        return self.flow.find_rate(q, qd) @ self._list_rows()[0]

    def middle(self, q: Any, qd: Any, h: Any, w: Any) -> tuple[Any, Any]:
        rate, acceleration = self._split(w)
        return q + h / 2 * rate, qd + h / 2 * acceleration

    def residual(self, q: Any, qd: Any, h: Any, w: Any) -> Any:
        pose, speed = self.middle(q, qd, h, w)
        rates, accelerations = self._list_rows()
        return w - self.flow.find_rate(pose, speed) @ rates - self.flow.accelerate(pose, speed) @ accelerations

    def linearise(self, q: Any, qd: Any, h: Any, w: Any) -> Any:
        """Return the derivative of the residual by the unknowns."""
        state, (rates, accelerations) = self.middle(q, qd, h, w), self._list_rows()
        both = (rates, self.flow.linearise_rate(*state)), (accelerations, self.flow.linearise(*state))
        slopes = (rows.T @ (by_pose @ rates + by_speed @ accelerations) for rows, (by_pose, by_speed) in both)
        return self.flow.face._read(np.eye(w.shape[-1])) - h / 2 * sum(slopes)

    def finish(self, q: Any, qd: Any, h: Any, w: Any) -> tuple[Any, Any]:
        rate, acceleration = self._split(w)
        return q + h * rate, qd + h * acceleration

    def _split(self, w: Any) -> tuple[Any, Any]:
        rates, accelerations = self._list_rows()
        return w @ rates.T, w @ accelerations.T

    def _list_rows(self) -> tuple[Any, Any]:
        """Return the rows of a unit matrix: of the entries of x', and of v'."""
        manifest = self.flow.face.manifest
        nq, n = len(manifest.positions), len(manifest.coordinates)
        rows = np.eye(nq + n)
        return self.flow.face._read(rows[:nq]), self.flow.face._read(rows[nq:])


def _add(start: Any, h: Any, row: Sequence[float], terms: Sequence[Any]) -> Any:
    weighted = [weight * term for weight, term in zip(row, terms, strict=False) if weight]
    return start + h * sum(weighted[1:], weighted[0]) if weighted else start
