"""Derivatives of an optimum by numbers of its problem, forward and adjoint.

The numbers of a program are weights and constants p, bounds of variables and ranges of rows. With K of the optimum (see
`point`), and a change of the numbers, the free variables and the multipliers of active rows move by (Fiacco,
"Introduction to sensitivity and stability analysis in nonlinear programming", 1983, theorem 3.2.2)

    [H  J'] [dx  ]   [-(grad f)_w dw - L_xc dc - H_h dh]
    [J  0 ] [dlam] = [ dr - g_c dc - J_h dh            ]

with dw of weights, dc of constants, dh of held variables' bounds, dr of active rows' limits. The adjoint solves with
the same factors once: for the gradient v of a function of x, K a = (v, 0) gives the derivatives v_h dh + a' times the
right side. The derivative of the cost needs no system: it is the one of the Lagrangian at constant x.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbsrun.ocp.evaluation.backends.numpy import Functions, build
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.optima.lifting import lift_constants
from mbsrun.ocp.optima.point import Active, Optimum, complete
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, SMOOTH, SPLIT, STUCK

SAME = 1e-9  # of derivatives that ought to be equal, over the largest
OPEN = 1e-8  # of the rate at which an implied limit opens, over the largest change
TURNED = 1e-6  # of a derivative's change by other multipliers, over the derivative
STEP = 1e-3  # of differences of order four, over the size of the change


@dataclass(frozen=True, eq=False)
class Numbers:
    """All numbers of a program, or their derivatives by one number of the problem."""

    parameters: Array  # weights, then constants
    lower: Array
    upper: Array
    least: Array
    most: Array

    @property
    def parts(self) -> tuple[Array, ...]:
        """Return the arrays."""
        return self.parameters, self.lower, self.upper, self.least, self.most


def take_differences(numbers: Callable[[float], Sequence[Array]], step: float) -> list[Array]:
    """Return the derivatives at 0 of arrays, by differences of order four; 0 where limits are infinite."""
    found = [numbers(k * step) for k in (-2, -1, 1, 2)]
    return [_combine(parts, step) for parts in zip(*found, strict=True)]


def _combine(parts: tuple[Array, ...], step: float) -> Array:
    finite = np.isfinite(parts).all(axis=0)
    a, b, c, d = (np.where(finite, part, 0.0) for part in parts)
    return np.asarray((8 * (c - b) - (d - a)) / (12 * step))


@dataclass(frozen=True, eq=False)
class Movement:
    """How an optimum moves with numbers of its problem; `changes` has the derivatives of the program's numbers."""

    prepared: Prepared
    optimum: Optimum
    changes: tuple[Numbers | None, ...]  # None: the number moves one limit of an equality
    spans: tuple[float, ...] = ()  # by which numbers are to move with this active set, for a derivative to be one

    @property
    def status(self) -> str:
        """Return whether the optimum has derivatives at all."""
        return self.optimum.status

    def find_status(self, k: int) -> str:
        """Return whether the optimum has derivatives by number k."""
        return self._statuses[k] if self.status in (SMOOTH, CHANGING) else self.status

    def move(self, k: int) -> Array:
        """Return the derivative of the variables by number k. Call it where its status permits."""
        optimum, active = self.optimum, self.optimum.active
        free = active.free
        dx = np.zeros(optimum.x.size)
        dx[free], dx[active.held] = self._solved[: free.size, k], self._held[:, k]
        return dx

    def pull(self, gradient: Array) -> Array:
        """Return the derivatives of a function of the variables, whose gradient is given, by all numbers.

        A number by which there is none has NaN.
        """
        optimum, active = self.optimum, self.optimum.active
        free, rows = active.free, active.chosen.size
        adjoint = optimum.factors.solve(np.concatenate((gradient[free], np.zeros(rows))))
        found = adjoint @ self._right + gradient[active.held] @ self._held
        exists = [self.find_status(k) == SMOOTH for k in range(len(self.changes))]
        return np.where(exists, found, np.nan)

    def find_costs(self) -> Array:
        """Return the derivatives of the cost by all numbers.

        They exist where multipliers are unique, also where the active set changes; NaN elsewhere.
        """
        optimum = self.optimum
        if self.status not in (SMOOTH, CHANGING):
            return np.full(len(self.changes), np.nan)
        values = self.prepared.numpy.terms(optimum.x, optimum.instance.parameters)
        limits, forces = optimum.multipliers[optimum.active.chosen], optimum.zeta[optimum.active.held]
        found = []
        for k, change in enumerate(self._given):
            weights = change.parameters[: self._weights]
            total = optimum.scale * float(weights @ values) - float(limits @ self._limits[:, k])
            total += float(forces @ self._held[:, k])
            constants = change.parameters[self._weights :]
            if constants.any():
                total += float(self._by_constants.slope @ constants)
            found.append(total / optimum.scale if self._statuses[k] in (SMOOTH, CHANGING) else np.nan)
        return np.array(found)

    def combine(self, rates: Array) -> Numbers:
        """Return the derivatives of the program's numbers where the problem's change at given rates."""
        pairs = zip(rates.tolist(), self._given, strict=True)
        moving = [[rate * part for part in change.parts] for rate, change in pairs if rate]
        return Numbers(*(np.sum(parts, axis=0) for parts in zip(*moving, strict=True))) if moving else self._nothing

    @property
    def _nothing(self) -> Numbers:
        at = self.optimum.instance
        parts = at.parameters, at.lower, at.upper, at.g_lower, at.g_upper
        return Numbers(*(np.zeros(part.size) for part in parts))

    @cached_property
    def _given(self) -> tuple[Numbers, ...]:
        """The changes, and zeros for the ones that are not known."""
        return tuple(change or self._nothing for change in self.changes)

    @property
    def _weights(self) -> int:
        return len(self.prepared.data.H)

    @cached_property
    def _lifted(self) -> tuple[Functions, Array, Array]:
        """The functions with constants as variables, the optimum with them, and the weights."""
        program, optimum = lift_constants(self.prepared.data), self.optimum
        weights, constants = np.split(optimum.instance.parameters, [self._weights])
        functions = build(program, self.prepared.plant, self.prepared.others)
        return functions, np.concatenate((optimum.x, constants)), weights

    @cached_property
    def _by_constants(self) -> _ByConstants:
        """Differentiate by all constants, at the optimum."""
        optimum, n = self.optimum, self.optimum.x.size
        functions, whole, weights = self._lifted
        rows = Matrix(functions.jacobian(whole, weights)[:, n:])
        curve = functions.hessian(whole, weights, optimum.scale, optimum.multipliers)
        slope = optimum.scale * functions.gradient(whole, weights)[n:] + optimum.multipliers @ rows
        return _ByConstants(Matrix(curve[:n, n:]), rows, np.asarray(slope))

    @cached_property
    def _held(self) -> Array:
        """The derivatives of held variables, (held, numbers)."""
        active = self.optimum.active
        held = active.held
        at_upper = active.variables[held] == 1
        return _stack([np.where(at_upper, x.upper[held], x.lower[held]) for x in self._given], held.size)

    @cached_property
    def _limits(self) -> Array:
        """The derivatives of active rows' limits, (rows, numbers)."""
        active = self.optimum.active
        chosen = active.chosen
        at_most = active.rows[chosen] == 1
        return _stack([np.where(at_most, x.most[chosen], x.least[chosen]) for x in self._given], chosen.size)

    @cached_property
    def _pushed(self) -> list[tuple[Array, Array]]:
        """The derivatives of grad L and of g at constant x, by each number."""
        return [self.push(change) for change in self._given]

    @cached_property
    def _solved(self) -> Array:
        """The derivatives of free variables and of active rows' multipliers, (..., numbers)."""
        return self.optimum.factors.solve(self._right)

    @cached_property
    def _right(self) -> Array:
        """The right sides, (free variables and active rows, numbers)."""
        optimum, active = self.optimum, self.optimum.active
        free, held, chosen = active.free, active.held, active.chosen
        moved = _stack([force for force, _ in self._pushed], optimum.x.size)
        rows = _stack([row for _, row in self._pushed], optimum.multipliers.size)
        upper = -moved[free] - optimum.hessian.tocsr()[free][:, held] @ self._held
        lower = self._limits - rows[chosen] - optimum.jacobian.tocsr()[chosen][:, held] @ self._held
        return np.concatenate((upper, lower))

    def push(self, change: Numbers) -> tuple[Array, Array]:
        """Return the derivatives of grad L and of g at constant x."""
        optimum = self.optimum
        weights, constants = np.split(change.parameters, [self._weights])
        force: Array = np.zeros(optimum.x.size)
        rows: Array = np.zeros(optimum.multipliers.size)
        if weights.any():
            p = np.concatenate((weights, optimum.instance.parameters[self._weights :]))
            force = optimum.scale * self.prepared.numpy.gradient(optimum.x, p)
        if constants.any():
            force = force + np.asarray(self._by_constants.curve @ constants)
            rows = np.asarray(self._by_constants.rows @ constants)
        return force, rows

    @cached_property
    def _statuses(self) -> list[str]:
        return [self.examine(k) for k in range(len(self.changes))]

    def examine(self, k: int) -> str:
        """Find what keeps number k from having derivatives, where the optimum itself has some."""
        if self.changes[k] is None:
            return SPLIT
        change, active, limits = self._given[k], self.optimum.active, self.optimum.limits
        largest = max((float(np.abs(part).max(initial=0.0)) for part in change.parts), default=0.0)
        if largest == 0:
            return SMOOTH
        for sides, lower, upper in (
            (active.variables, change.lower, change.upper),
            (active.rows, change.least, change.most),
        ):
            if (np.abs(lower - upper)[sides == 2] > SAME * largest).any():
                return SPLIT
        idle = (limits.least == limits.most) & (active.rows == 0)
        moved = change.least[idle] - self.push(change)[1][idle]
        apart = change.most[idle] - change.least[idle]
        if max(np.abs(moved).max(initial=0.0), np.abs(apart).max(initial=0.0)) > SAME * largest:
            return STUCK
        return self._examine_set(k, SAME * largest)

    def _examine_set(self, k: int, same: float) -> str:
        """Find whether the active set stays for number k, and its multipliers do not matter."""
        if self._parts_copies(self._given[k], same) or self._opens_some(k):
            return CHANGING
        if self.spans and self.measure_reach(k) < self.spans[k]:
            return CHANGING
        return DEPENDENT if self._bends(k) else SMOOTH

    def measure_reach(self, k: int) -> float:
        """Return by how much number k may move until the active set changes, to first order."""
        optimum, active, change = self.optimum, self.optimum.active, self._given[k]
        dx, dlam = self.move(k), np.zeros(optimum.multipliers.size)
        dlam[active.chosen] = self._solved[active.free.size :, k]
        force, rows = self._pushed[k]
        dg = optimum.jacobian @ dx + rows
        dzeta = force + optimum.hessian @ dx + optimum.jacobian.T @ dlam
        limits, others = optimum.limits, optimum.weak.together(optimum.implied)
        lengths = []
        for sides, other, value, rate, pull, low, high, moved in (
            (active.variables, others.variables, optimum.x, dx, (optimum.zeta, dzeta), limits.lower, limits.upper,
             (change.lower, change.upper)),
            (active.rows, others.rows, optimum.values, dg, (optimum.multipliers, dlam), limits.least, limits.most,
             (change.least, change.most)),
        ):  # fmt: skip
            open_ = (sides == 0) & (other == 0)
            lengths += [
                _reach(np.abs(limit - value)[open_], (rate - own)[open_])
                for limit, own in zip((low, high), moved, strict=True)
            ]
            held = np.abs(sides) == 1
            lengths.append(_reach(np.abs(pull[0][held]), pull[1][held]))
        return min(lengths)

    def _opens_some(self, k: int) -> bool:
        """Return whether number k moves limits that active ones imply, or that are weakly active."""
        some = self.optimum.implied.together(self.optimum.weak)
        openings = find_openings(self.optimum, some, self._given[k], self._pushed[k][1], self.move(k))
        return bool((np.abs(openings) > OPEN).any())

    def _bends(self, k: int) -> bool:
        """Return whether the derivative depends on which of many multipliers the active limits have.

        The curvature of the conditions, weighted by a direction of multipliers, must not turn the derivative.
        """
        optimum, active = self.optimum, self.optimum.active
        if not optimum.directions.size:
            return False
        dx, constants = self.move(k), self._given[k].parameters[self._weights :]
        direction = np.random.default_rng(k).standard_normal(len(optimum.directions)) @ optimum.directions
        direction *= np.abs(optimum.multipliers).max() / np.abs(direction).max()
        turn = self._curve_rows(direction, dx, constants)
        turned = optimum.factors.solve(np.concatenate((turn[active.free], np.zeros(active.chosen.size))))
        return bool(np.abs(turned[: active.free.size]).max() > TURNED * np.abs(dx).max())

    def _curve_rows(self, multipliers: Array, dx: Array, constants: Array) -> Array:
        """Return the change of J' multipliers along a change of variables and constants."""
        functions, x, p, change = self.prepared.numpy, self.optimum.x, self.optimum.instance.parameters, dx
        if constants.any():
            functions, x, p = self._lifted
            change = np.concatenate((dx, constants))
        return np.asarray(complete(functions.hessian(x, p, 0.0, multipliers)) @ change)[: dx.size]

    def _parts_copies(self, change: Numbers, same: float) -> bool:
        """Return whether bounds of variables that are equal, and that are active together, move apart."""
        active, ties, start = self.optimum.active, self.optimum.limits.ties, self.optimum.instance
        for side, bounds, moved in ((-1, start.lower, change.lower), (1, start.upper, change.upper)):
            at = np.flatnonzero(active.variables == side)
            leader = np.full(ties.max(initial=-1) + 1, -1)
            leader[ties[at]] = at
            others = np.flatnonzero(leader[ties] >= 0)
            first = leader[ties[others]]
            equal = bounds[others] == bounds[first]
            if (np.abs(moved[others] - moved[first])[equal] > same).any():
                return True
        return False


@dataclass(frozen=True, eq=False)
class _ByConstants:
    """Derivatives by constants: of grad L, of g, and of L."""

    curve: Matrix
    rows: Matrix
    slope: Array


def find_openings(optimum: Optimum, some: Active, change: Numbers, rows: Array, dx: Array) -> Array:
    """Return the rates at which some limits open, over the largest change; below 0, they are passed.

    `rows` are the rates of g at constant x.
    """
    held, chosen = some.held, some.chosen
    bounds = np.where(some.variables[held] == 1, change.upper[held], change.lower[held])
    limits = np.where(some.rows[chosen] == 1, change.most[chosen], change.least[chosen])
    sides = np.concatenate((some.variables[held], some.rows[chosen]))
    rates = sides * np.concatenate((bounds - dx[held], limits - (optimum.jacobian @ dx + rows)[chosen]))
    parts = (dx, rows, change.lower, change.upper, change.least, change.most)
    largest = max(float(np.abs(part).max(initial=0.0)) for part in parts)
    return np.asarray(rates / (largest or 1.0))


def _reach(gaps: Array, rates: Array) -> float:
    """Return by how much a number may move, either way, until the first gap is closed."""
    moving = (rates != 0) & np.isfinite(gaps)
    return float(np.min(gaps[moving] / np.abs(rates[moving]), initial=np.inf))


def _stack(columns: Sequence[Array], rows: int) -> Array:
    return np.stack(columns, axis=1) if columns else np.zeros((rows, 0))


def measure_step(dx: Array, x: Array) -> float:
    """Return a step of differences along dx from x."""
    largest = float((np.abs(dx) / np.maximum(1.0, np.abs(x))).max(initial=0.0))
    return STEP / largest if largest > 0 else STEP
