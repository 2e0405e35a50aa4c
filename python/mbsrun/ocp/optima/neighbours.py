"""Optima of neighbouring problems to first order, with changes of the active set.

Where a limit is weakly active, an optimum has one-sided derivatives: the change solves a quadratic program in which
weak limits are inequalities (Jittorntrum, "Solution point differentiability without strict complementarity in nonlinear
programming", Mathematical Programming Study 21 (1984)). With y the rates at which weak limits open, and mu their
multipliers,

    y = r + M mu,   y >= 0,   mu >= 0,   y' mu = 0,   M = A K^-1 A',

A the gradients of weak limits, is the optimality of a least-squares problem with nonnegative mu where M is positive
definite. For a finite change, the quadratic program at the optimum is followed: its solution is straight between values
at which a limit is met or its multiplier vanishes, and there the active set changes (Ferreau, Bock, Diehl, "An online
active set strategy", Int. J. Robust Nonlinear Control 18 (2008)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.optima.movement import OPEN, Movement, find_openings
from mbsrun.ocp.optima.point import Active, assemble
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, SMOOTH
from mbsrun.ocp.optima.symmetric import Factors

MOST = 500  # changes of the active set along a step
LATER = 1e-12  # of a step: an event before it happens now
ZERO = 1e-9  # a rate, over the largest one, that is none


@dataclass(frozen=True, eq=False)
class Moved:
    """A change of the optimum, or the reason why there is none."""

    dx: Array
    status: str
    changes: int = 0  # of the active set, along a finite step


def move_one_sided(movement: Movement, rates: Sequence[float]) -> Moved:
    """Return the derivative of the variables where the numbers begin to change at given rates."""
    optimum = movement.optimum
    bad = [movement.examine(k) for k, rate in enumerate(rates) if rate != 0]
    status = next((x for x in bad if x not in (SMOOTH, CHANGING)), optimum.status)
    if status not in (SMOOTH, CHANGING):
        return Moved(np.full(optimum.x.size, np.nan), status)
    path = _Path(movement, np.asarray(rates, dtype=np.float64))
    found, active = path.find_sides()
    if found is None:
        return Moved(np.full(optimum.x.size, np.nan), DEPENDENT)
    dx, _ = path.step(active, found)
    return Moved(dx, SMOOTH)


def predict(movement: Movement, changes: Sequence[float]) -> Moved:
    """Return the change of the variables by finite changes of the numbers, as a quadratic program has it."""
    first = move_one_sided(movement, changes)
    if first.status != SMOOTH:
        return first
    path = _Path(movement, np.asarray(changes, dtype=np.float64))
    factors, active = path.find_sides()
    assert factors is not None, "the one-sided derivative was found"
    return path.follow(active, factors)


class _Path:
    """The solution of the quadratic program at an optimum, while its numbers go along a direction."""

    def __init__(self, movement: Movement, rates: Array) -> None:
        self.movement, self.optimum = movement, movement.optimum
        self.change = movement.combine(rates)
        self.force, self.rows = movement.push(self.change)
        at = self.optimum
        self.hessian, self.jacobian = at.hessian.tocsr(), at.jacobian.tocsr()
        x, g = at.x, at.values
        self.bounds = ((at.limits.lower, self.change.lower), (at.limits.upper, self.change.upper))
        self.ranges = ((at.limits.least, self.change.least), (at.limits.most, self.change.most))
        self.x, self.g, self.lam, self.zeta = x.copy(), g.copy(), at.multipliers.copy(), at.zeta.copy()

    def factorise(self, active: Active) -> Factors | None:
        """Return the factors of K; None where the active set has no strict minimum."""
        factors = Factors(assemble(self.optimum.hessian, self.jacobian, active))
        return None if factors.is_singular or factors.negative != active.chosen.size else factors

    def step(self, active: Active, factors: Factors) -> tuple[Array, Array]:
        """Return the rates of variables and multipliers while an active set stays."""
        free, held, chosen = active.free, active.held, active.chosen
        dx, dlam = np.zeros(self.x.size), np.zeros(self.lam.size)
        dx[held] = np.where(active.variables[held] == 1, self.change.upper[held], self.change.lower[held])
        limits = np.where(active.rows[chosen] == 1, self.change.most[chosen], self.change.least[chosen])
        right = -(self.force + self.hessian @ dx)[free], limits - self.rows[chosen] - (self.jacobian @ dx)[chosen]
        found = factors.solve(np.concatenate(right))
        dx[free], dlam[chosen] = found[: free.size], found[free.size :]
        return dx, dlam

    def find_sides(self) -> tuple[Factors | None, Active]:
        """Choose among weak limits the ones that become active; None where they depend on each other.

        There is none either where a limit that others imply is passed.
        """
        strong, weak = self.optimum.active, self.optimum.weak
        if self._passes_implied(self.step(strong, self.optimum.factors)[0]):
            return None, strong
        variables, rows = np.flatnonzero(weak.variables), np.flatnonzero(weak.rows)
        if not variables.size + rows.size:
            return self.optimum.factors, strong
        dx, _ = self.step(strong, self.optimum.factors)
        A, sides = self._list_gradients(variables, rows), np.concatenate((weak.variables[variables], weak.rows[rows]))
        limits = [np.where(weak.variables[variables] == 1, self.change.upper[variables], self.change.lower[variables])]
        limits.append(np.where(weak.rows[rows] == 1, self.change.most[rows], self.change.least[rows]) - self.rows[rows])
        opening = -sides * (A @ dx - np.concatenate(limits))
        free = strong.free
        part = (sparse.diags_array(-sides.astype(np.float64)) @ A).tocsr()[:, free].T.toarray()
        above = np.concatenate((part, np.zeros((strong.chosen.size, part.shape[1]))))
        M = above.T @ self.optimum.factors.solve(above)
        mu = _complement((M + M.T) / 2, opening)
        if mu is None:
            return None, strong
        chosen = mu > ZERO * max(float(np.abs(mu).max(initial=0.0)), 1e-300)
        new = Active(strong.variables.copy(), strong.rows.copy())
        taken = np.flatnonzero(chosen)
        own = taken[taken < variables.size]
        new.variables[variables[own]] = weak.variables[variables[own]]
        new.rows[rows[taken[taken >= variables.size] - variables.size]] = weak.rows[
            rows[taken[taken >= variables.size] - variables.size]
        ]
        return self.factorise(new), new

    def _passes_implied(self, dx: Array) -> bool:
        return bool((find_openings(self.optimum, self.optimum.implied, self.change, self.rows, dx) < -OPEN).any())

    def _list_gradients(self, variables: Indices, rows: Indices) -> sparse.csr_array:
        units = sparse.csr_array(
            (np.ones(variables.size), (np.arange(variables.size), variables)), shape=(variables.size, self.x.size)
        )
        return sparse.csr_array(sparse.vstack([units, self.jacobian[rows]]))

    def follow(self, active: Active, factors: Factors) -> Moved:
        """Go all the way, from one change of the active set to the next."""
        t, count = 0.0, 0
        for count in range(MOST):
            dx, dlam = self.step(active, factors)
            dg = self.jacobian @ dx + self.rows
            dzeta = self.force + self.hessian @ dx + self.jacobian.T @ dlam
            length, event = self._find_event(active, t, (dx, dg, dlam, dzeta))
            self.x, self.g = self.x + length * dx, self.g + length * dg
            self.lam, self.zeta = self.lam + length * dlam, self.zeta + length * dzeta
            t += length
            if event is None:
                moved = self.x - self.optimum.x
                return Moved(moved, DEPENDENT if self._passes_implied(moved) else SMOOTH, count)
            active = _apply(active, event)
            found = self.factorise(active)
            if found is None:
                break
            factors = found
        return Moved(np.full(self.x.size, np.nan), FLAT if count < MOST - 1 else CHANGING, count)

    def _find_event(
        self, active: Active, t: float, rates: tuple[Array, Array, Array, Array]
    ) -> tuple[float, _Event | None]:
        """Return how far the way is straight, and what happens there."""
        dx, dg, dlam, dzeta = rates
        length, event = 1.0 - t, None
        weak, implied = self.optimum.weak if t == 0 else None, self.optimum.implied
        for is_row, sides, values, slopes, limits, forces, pulls in (
            (False, active.variables, self.x, dx, self.bounds, self.zeta, dzeta),
            (True, active.rows, self.g, dg, self.ranges, -self.lam, -dlam),
        ):
            for side, (limit, moved) in zip((-1, 1), limits, strict=True):
                open_ = (sides == 0) & np.isfinite(limit) & ((implied.rows if is_row else implied.variables) == 0)
                if weak is not None:
                    open_ &= (weak.rows if is_row else weak.variables) == 0
                gap, closing = side * (limit + t * moved - values), side * (slopes - moved)
                found = _meet(np.where(open_, np.maximum(gap, 0.0), np.inf), closing)
                if found is not None and found[0] < length:
                    length, event = found[0], _Event(is_row, found[1], side)
                held = sides == side
                force, falling = -side * forces, side * pulls
                found = _meet(np.where(held, np.maximum(force, 0.0), np.inf), falling)
                if found is not None and found[0] < length:
                    length, event = found[0], _Event(is_row, found[1], 0)
        return length, event


@dataclass(frozen=True)
class _Event:
    is_row: bool
    index: int
    side: int  # that becomes active; 0: none


def _apply(active: Active, event: _Event) -> Active:
    new = replace(active, variables=active.variables.copy(), rows=active.rows.copy())
    (new.rows if event.is_row else new.variables)[event.index] = event.side
    return new


def _meet(distances: Array, speeds: Array) -> tuple[float, int] | None:
    """Return when the first of some distances is gone, and which one."""
    moving = np.flatnonzero((speeds > 0) & np.isfinite(distances))
    if not moving.size:
        return None
    times = distances[moving] / speeds[moving]
    k = int(np.argmin(times))
    return max(float(times[k]), LATER), int(moving[k])


def _complement(M: Array, r: Array) -> Array | None:
    """Solve y = r + M mu, y >= 0, mu >= 0, y' mu = 0 for mu; None where M is not positive definite."""
    from scipy.linalg import LinAlgError, cholesky, solve_triangular
    from scipy.optimize import nnls  # here, and late: it takes long to load

    scale = np.sqrt(np.maximum(np.diag(M), 1e-300))
    try:
        L = cholesky(M / np.outer(scale, scale), lower=True)
    except LinAlgError:
        return None
    if np.diag(L).min() < ZERO:
        return None
    return np.asarray(nnls(L.T, -solve_triangular(L, r / scale, lower=True))[0] / scale)
