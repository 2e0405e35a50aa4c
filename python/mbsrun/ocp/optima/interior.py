"""A solution to many more digits, so that active limits and others come apart.

A method of interior points stops where distances s and multipliers z of limits have a product mu of some 1e-9: along an
arc of a constraint both may be 1e-4. Here mu goes down to rounding, by Newton's method without a line search, from the
solution and its multipliers (Wright, "Primal-dual interior-point methods", SIAM 1997, chapter 7):

    grad f + J' lam - z_lower + z_upper = 0,    x - s_lower = lower,  x + s_upper = upper,    s z = mu

and likewise for rows. Then s and z differ by orders of magnitude, unless both vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.optima.status import DEPENDENT, NOT_CONVERGED
from mbsrun.ocp.optima.symmetric import Factors

FIRST, LAST = 1e-9, 1e-20  # mu, of numbers divided by their sizes
BOUNDARY = 0.995  # part of the way to a limit
ENDED = 1e-10  # a step after which the last mu is reached
FAR = 1e3  # a distance from the first point, over the size of a variable, from which nothing comes back
SHORTEST = 1e-12  # first distance of a limit that is met, over the size
LONG, HALF = 0.9, 0.5  # lengths of steps after which the method may end, and mu becomes smaller
ROUNDS = 40

Pair = tuple[Array, Array]

Values = Callable[[Array], tuple[Array, Array, Matrix]]  # g, gradient of the cost and J at a point
Curve = Callable[[Array, Array], Matrix]  # the whole Hessian of the Lagrangian


@dataclass(frozen=True, eq=False)
class Limited:
    """Limits of one side: which numbers have them, and where; sign 1: lower ones."""

    at: Indices
    value: Array
    sign: float

    @classmethod
    def find(cls, limits: Array, sign: float, opened: NDArray[np.bool_]) -> Limited:
        """Find the finite limits of numbers that may move."""
        at = np.flatnonzero(np.isfinite(limits) & opened)
        return cls(at, limits[at], sign)


class Side:
    """The distances s and multipliers z of limits of one side, with their steps."""

    def __init__(self, limited: Limited, s: Array, z: Array) -> None:
        self.limited, self.s, self.z = limited, s, z
        self.ds, self.dz = np.zeros_like(s), np.zeros_like(z)

    def measure(self, values: Array) -> Array:
        """Return by how much distances differ from the ones of values."""
        return np.asarray(self.limited.sign * (values[self.limited.at] - self.limited.value) - self.s)

    def aim(self, values: Array, change: Array, mu: float) -> None:
        """Set the steps, for a change of the values."""
        self.ds = self.limited.sign * change[self.limited.at] + self.measure(values)
        self.dz = mu / self.s - self.z - self.z / self.s * self.ds

    def spread(self, size: int) -> Pair:
        """Return s and z among all numbers."""
        s, z = np.full(size, np.inf), np.zeros(size)
        s[self.limited.at], z[self.limited.at] = self.s, self.z
        return s, z


@dataclass(frozen=True, eq=False)
class Centre:
    """The end of the method: the point, multipliers of rows, and s and z of all limits of variables and rows.

    Where there is no limit, s is infinite and z is 0.
    """

    x: Array
    lam: Array
    below: Pair
    above: Pair
    row_below: Pair
    row_above: Pair


@dataclass(frozen=True, eq=False)
class Task:
    """A program near its solution."""

    bounds: Pair
    ranges: Pair
    size: Array  # of variables
    values: Values
    curve: Curve

    def approach(self, x: Array, lam: Array) -> Centre | str:
        """Go on from a solution and its multipliers of rows; return a status where that fails."""
        x = np.where(self.bounds[0] == self.bounds[1], self.bounds[0], x)
        state = _State.begin(self, x, lam)
        mu = FIRST
        for _ in range(ROUNDS):
            if not state.solve(mu):
                return DEPENDENT
            if not state.is_near(x):
                return NOT_CONVERGED
            length = state.step()
            if mu <= LAST and length > LONG and state.moved < ENDED:
                break
            if length > HALF:
                mu = max(LAST, min(0.2 * mu, mu**1.3))
        return state.end()


class _State:
    """An iterate, with its step."""

    def __init__(self, task: Task, x: Array, lam: Array, at: tuple[Array, Array, Matrix]) -> None:
        limited = np.isfinite(task.ranges[0]) | np.isfinite(task.ranges[1])
        self.task, self.x, self.lam = task, x, np.where(limited, lam, 0.0)
        self.g, self.c, self.J = at[0], at[1], sparse.csr_array(at[2])
        self.movable = np.flatnonzero(task.bounds[0] < task.bounds[1])
        self.equal = task.ranges[0] == task.ranges[1]
        self.scale = float(np.abs(self.c).max(initial=0.0)) or 1.0
        read = np.asarray(abs(self.J[:, self.movable]).max(axis=1).toarray()).ravel() > 0
        self.rows = np.flatnonzero(limited & read)
        self.sides: list[Side] = []
        self.row_sides: list[Side] = []
        self.dx, self.dlam = np.zeros_like(x), np.zeros_like(lam)
        self.moved = np.inf

    @classmethod
    def begin(cls, task: Task, x: Array, lam: Array) -> _State:
        """Make the first iterate."""
        state = cls(task, x, lam, task.values(x))
        reach, zeta = np.maximum(1.0, np.abs(state.g)), state.c + state.J.T @ lam
        opened = task.bounds[0] < task.bounds[1]
        for side, bounds, ranges in zip((1.0, -1.0), task.bounds, task.ranges, strict=True):
            state.sides.append(_begin(x, zeta, Limited.find(bounds, side, opened), task.size, state.scale))
            state.row_sides.append(_begin(state.g, -lam, Limited.find(ranges, side, ~state.equal), reach, state.scale))
        return state

    @np.errstate(over="ignore", divide="ignore", invalid="ignore")  # a distance of 0 has no step
    def solve(self, mu: float) -> bool:
        """Find the step; return whether the system has one."""
        mu *= self.scale
        weights, forces = _sum(self.sides, self.x, mu)
        row_weights, row_forces = _sum(self.row_sides, self.g, mu)
        inner = self.rows[~self.equal[self.rows] & (row_weights[self.rows] > 0)]
        chosen = np.union1d(self.rows[self.equal[self.rows]], inner)
        soft, right = np.zeros(self.g.size), np.where(self.equal, self.task.ranges[0] - self.g, 0.0)
        soft[inner] = 1 / row_weights[inner]
        right[inner] = (row_forces[inner] + self.lam[inner]) * soft[inner]
        hessian = self.task.curve(self.x, self.lam).tocsr()[self.movable][:, self.movable]
        H = sparse.tril(hessian + sparse.diags_array(weights[self.movable]))
        corner = -sparse.diags_array(soft[chosen]).tocsc()
        K = sparse.block_array([[H, None], [self.J[chosen][:, self.movable], corner]], format="csc")
        factors = Factors(Matrix(K), zero=0.0)
        if factors.is_singular:
            return False
        force = forces - self.c - self.J.T @ self.lam
        found = factors.solve(np.concatenate((force[self.movable], right[chosen])))
        self.dx, self.dlam = np.zeros_like(self.x), np.zeros_like(self.lam)
        self.dx[self.movable], self.dlam[chosen] = np.split(found, [self.movable.size])
        change = self.J @ self.dx
        for side in self.sides:
            side.aim(self.x, self.dx, mu)
        for side in self.row_sides:
            side.aim(self.g, change, mu)
        self.moved = float((np.abs(self.dx) / self.task.size).max(initial=0.0))
        return bool(np.isfinite(found).all())

    def is_near(self, first: Array) -> bool:
        """Return whether the next iterate is in sight of the first."""
        return bool((np.abs(self.x + self.dx - first) <= FAR * self.task.size).all())

    def step(self) -> float:
        """Make the step; return the least of its lengths."""
        every = [*self.sides, *self.row_sides]
        primal = min((_limit(side.s, side.ds) for side in every), default=1.0)
        dual = min((_limit(side.z, side.dz) for side in every), default=1.0)
        self.x, self.lam = self.x + primal * self.dx, self.lam + dual * self.dlam
        for side in every:
            side.s, side.z = side.s + primal * side.ds, side.z + dual * side.dz
        self.g, self.c, J = self.task.values(self.x)
        self.J = sparse.csr_array(J)
        return min(primal, dual)

    def end(self) -> Centre:
        """Return the iterate."""
        n, m = self.x.size, self.g.size
        below, above = (side.spread(n) for side in self.sides)
        return Centre(self.x, self.lam, below, above, *(side.spread(m) for side in self.row_sides))


def _begin(values: Array, force: Array, limited: Limited, size: Array, scale: float) -> Side:
    """Return first distances and multipliers; a distance that is none, or a multiplier of the wrong sign, is small."""
    size = size[limited.at]
    s = np.maximum(limited.sign * (values[limited.at] - limited.value), SHORTEST * size)
    least = np.minimum(FIRST * scale / s, scale / size)
    return Side(limited, s, np.maximum(limited.sign * force[limited.at], least))


def _sum(sides: Sequence[Side], values: Array, mu: float) -> tuple[Array, Array]:
    """Return z / s, and the forces that limits shall have, with the part of distances that are not met."""
    weights, forces = np.zeros(values.size), np.zeros(values.size)
    for side in sides:
        at, ratio = side.limited.at, side.z / side.s
        np.add.at(weights, at, ratio)
        np.add.at(forces, at, side.limited.sign * (mu / side.s - ratio * side.measure(values)))
    return weights, forces


def _limit(values: Array, change: Array) -> float:
    falls = change < 0
    return float(min(1.0, BOUNDARY * np.min(values[falls] / -change[falls], initial=np.inf)))
