"""An optimum with its active set, by Newton's method on the equations that hold there.

    minimise f(x)  subject to  least <= g(x) <= most,  lower <= x <= upper

Bounds and rows that a solution touches become equations; the others are left out. Newton's method then solves

    grad f + J' lam = zeta,    g of active rows = their limits,    x of held variables = their bounds

to rounding, and corrects the set: a limit whose multiplier has the wrong sign is released, one that is passed is taken
in (Bergounioux, Ito, Kunisch, "Primal-dual strategy for constrained optimal control problems", SIAM J. Control Optim.
37 (1999)). So nothing is smoothed by the barrier of the method that found the solution. Held variables leave the
system; the rest is K = [[H, J'], [J, 0]] of free variables and active rows. With m rows, the solution is a strict
minimum, and its rows are independent, exactly if K has m negative eigenvalues and none that is 0 (Gould, "On practical
conditions for the existence and uniqueness of solutions to the general equality quadratic programming problem",
Mathematical Programming 32 (1985)).

Variables that linear rows tie to be equal, as mesh points to the last collocation points before them, share one bound.
Limits that other conditions imply are left out (see `thinning`): K belongs to the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Matrix, Program
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.optima.interior import Task
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, NOT_CONVERGED, SMOOTH
from mbsrun.ocp.optima.symmetric import Factors, mirror
from mbsrun.ocp.optima.thinning import thin

WEAK = 1e-8  # a multiplier over the gradient, or a distance over the size, that says nothing
STRICT = 1e-5  # the larger one of a distance and a multiplier: from here on, their order is beyond doubt
SMALL = 1e-10  # a step, over the size of a variable, after which Newton's method has ended ...
ROUNDED = 1e-7  # ... or this, where steps do not become smaller any more
FAR = 0.1  # a distance from the solution, over the size of a variable: it is another one
ROUNDS = 15
LOST = 10.0  # a distance from the solution, over the size of a variable, from which nothing comes back
SINGULAR = 1e15  # the condition of a scaled system without digits

Sides = NDArray[np.int8]  # -1: at the lower limit, 1: at the upper one, 2: at both, 0: at none


class Functions(Protocol):
    """The functions of a program that are called here."""

    def gradient(self, x: Array, p: Array) -> Array: ...

    def constraint(self, x: Array, p: Array) -> Array: ...

    def jacobian(self, x: Array, p: Array) -> Matrix: ...

    def hessian(self, x: Array, p: Array, lam_f: float, lam_g: Array) -> Matrix: ...


@dataclass(frozen=True, eq=False)
class Active:
    """Which limits hold with equality."""

    variables: Sides
    rows: Sides

    @property
    def free(self) -> Indices:
        """List the variables that no bound holds."""
        return np.flatnonzero(self.variables == 0)

    @property
    def held(self) -> Indices:
        """List the variables at a bound."""
        return np.flatnonzero(self.variables != 0)

    @property
    def chosen(self) -> Indices:
        """List the rows that are equations."""
        return np.flatnonzero(self.rows != 0)

    def without(self, others: Active) -> Active:
        """Return the limits that are in no other set."""
        return Active(np.where(others.variables, 0, self.variables), np.where(others.rows, 0, self.rows))

    def together(self, others: Active) -> Active:
        """Return the limits of both sets."""
        return Active(
            np.where(self.variables, self.variables, others.variables), np.where(self.rows, self.rows, others.rows)
        )

    def is_same(self, other: Active) -> bool:
        """Return whether two sets are equal."""
        return np.array_equal(self.variables, other.variables) and np.array_equal(self.rows, other.rows)


@dataclass(frozen=True, eq=False)
class Limits:
    """The limits of variables and rows; of variables that are equal, the tightest ones alone."""

    lower: Array
    upper: Array
    least: Array
    most: Array
    ties: Indices  # (variables,): the same number for variables that are equal

    def place(self, active: Active) -> tuple[Array, Array]:
        """Return the values of held variables and of chosen rows."""
        held, chosen = active.held, active.chosen
        return (
            np.where(active.variables[held] == 1, self.upper[held], self.lower[held]),
            np.where(active.rows[chosen] == 1, self.most[chosen], self.least[chosen]),
        )

    @property
    def equal(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Mark the variables and rows whose limits are equal."""
        return self.lower == self.upper, self.least == self.most


@dataclass(frozen=True, eq=False)
class Optimum:
    """A point that solves the equations of an active set; the cost is scaled."""

    x: Array
    multipliers: Array  # of all rows: L = f + multipliers' g
    zeta: Array  # grad L: multipliers of held variables, 0 elsewhere
    active: Active
    weak: Active  # limits that are about to become active or inactive, which are not among the active ones
    implied: Active  # limits that hold because of the active ones
    directions: Array  # (k, rows): what multipliers may change by if implied limits have some
    limits: Limits
    instance: Instance
    scale: float  # of the cost
    status: str  # SMOOTH, or why it has no derivative
    factors: Factors  # of K
    jacobian: Matrix = field(repr=False)
    hessian: Matrix = field(repr=False)  # whole
    gradient: Array = field(repr=False)  # of the scaled cost
    values: Array = field(repr=False)  # g
    moved: float = 0.0  # from the solution, over sizes


def find_optimum(
    functions: Functions, program: Program, start: Instance, scale: float, answer: tuple[Array, Array]
) -> Optimum:
    """Find the optimum near a solution, `start`, its active set and its status; `scale` multiplies the cost.

    `answer` is a method's: the point that the search begins at, and multipliers of all rows, L = f + multipliers' g.
    """
    return _Search(functions, program, start, scale).find(*answer)


@dataclass(frozen=True, eq=False)
class _Values:
    """The functions at a point."""

    x: Array
    g: Array
    c: Array  # gradient of the scaled cost
    J: sparse.csr_array


@dataclass(frozen=True, eq=False)
class _System:
    """The Hessian of the Lagrangian, and the factors of K."""

    hessian: Matrix
    factors: Factors


class _Search:
    def __init__(self, functions: Functions, program: Program, start: Instance, scale: float) -> None:
        self.functions, self.start, self.scale = functions, start, scale
        self.limits = _tie(program, start)
        self.size = np.maximum(1.0, np.abs(start.x))

    def find(self, x: Array, multipliers: Array) -> Optimum:
        """Run the search; from the answer itself, where the optimum with its active limits leaves no doubt of them."""
        lam = self.scale * multipliers
        read = self._read(x, lam)
        found = None if read is None else self._improve(x, lam, read, self._no_limits)
        if found is not None and found.status == SMOOTH and found.active.is_same(read or found.active):
            at = _Values(found.x, found.values, found.gradient, found.jacobian.tocsr())
            if self._read(found.x, found.multipliers, at) is not None:
                return found
        begun = self._guess(x, lam)
        fails = isinstance(begun, str)  # dependent limits may let it fail in either way, by rounding
        if isinstance(begun, str):
            at = self._evaluate(self.start.x)
            found = self._end(at, lam, self._touch(at), self._no_limits, begun)
            begun = at.x, lam, *self._part(at, lam)
        else:
            found = self._improve(*begun)
        return self._leave_out(found, *begun) if fails or found.status in (DEPENDENT, CHANGING) else found

    def _leave_out(self, found: Optimum, x: Array, lam: Array, active: Active, weak: Active) -> Optimum:
        """Search without the limits that others imply; where that fails, return what was found, and why."""
        at, every = self._evaluate(x), active.together(weak)
        least = WEAK * float(np.abs(at.c).max(initial=0.0))
        left = thin(at.J, every.variables, every.rows, lam, at.c + at.J.T @ lam)
        if left is None:
            return found
        kept = Active(left.variables, left.rows)
        zeta = at.c + at.J.T @ left.lam
        open_ = Active(
            np.where(np.abs(zeta) <= least, weak.variables, 0), np.where(np.abs(left.lam) <= least, weak.rows, 0)
        )
        implied = every.without(kept)
        open_ = open_.without(implied)
        again = self._improve(x, left.lam, kept.without(open_), open_, implied)
        if again.status in (SMOOTH, CHANGING):
            return replace(again, directions=left.directions)
        is_flat = again.factors.is_singular and found.status != NOT_CONVERGED
        return replace(found, status=FLAT) if is_flat else found

    def _improve(self, x: Array, lam: Array, active: Active, weak: Active, implied: Active | None = None) -> Optimum:
        """Solve the equations of an active set by Newton's method, and correct the set."""
        implied = implied or self._no_limits
        at, before, status = self._evaluate(x), np.inf, NOT_CONVERGED
        last: _System | None = None
        for _ in range(ROUNDS):
            last = self._factorise(at, lam, active)
            if last.factors.is_singular:
                return self._end(at, lam, active, weak, DEPENDENT, implied, last)
            x, lam = self._step(at, lam, active, last)
            step = float((np.abs(x - at.x) / self.size).max(initial=0.0))
            if not np.isfinite(step) or (np.abs(x - self.start.x) / self.size).max(initial=0.0) > LOST:
                break
            at = self._evaluate(x)
            corrected = self._correct(at, lam, active, weak.together(implied))
            if corrected.is_same(active) and (step <= SMALL or ROUNDED >= step >= 0.1 * before):
                status, last = SMOOTH, last if step <= SMALL else None
                break
            active, before, last = corrected, step, None
        return self._end(at, lam, active, weak, status, implied, last if status == SMOOTH else None)

    def _factorise(self, at: _Values, lam: Array, active: Active) -> _System:
        hessian = self._curve(at.x, lam)
        return _System(hessian, Factors(assemble(hessian, at.J, active)))

    def _read(self, x: Array, lam: Array, at: _Values | None = None) -> Active | None:
        """Return the active limits where distances or multipliers of a point are large enough; None elsewhere."""
        at, limits = at or self._evaluate(x), self.limits
        most = float(np.abs(at.c).max(initial=0.0)) or 1.0
        reach, zeta = np.maximum(1.0, np.abs(at.g)), at.c + at.J.T @ lam
        found = [
            _separate(x, limits.lower, limits.upper, zeta * self.size / most, self.size),
            _separate(at.g, limits.least, limits.most, -lam * reach / most, reach),
        ]
        if any(sides is None for sides in found):
            return None
        variables, rows = (np.zeros(0, dtype=np.int8) if sides is None else sides for sides in found)
        rows[(rows == 2) & _vanish(at.J, limits)] = 0
        return Active(variables, rows)

    @property
    def _no_limits(self) -> Active:
        return Active(np.zeros(self.size.size, np.int8), np.zeros(self.limits.least.size, np.int8))

    def _end(
        self,
        at: _Values,
        lam: Array,
        active: Active,
        weak: Active,
        status: str,
        implied: Active | None = None,
        last: _System | None = None,  # at this point, up to rounding
    ) -> Optimum:
        implied, last = implied or self._no_limits, last or self._factorise(at, lam, active)
        hessian, factors = last.hessian, last.factors
        moved = float((np.abs(at.x - self.start.x) / self.size).max(initial=0.0))
        if status == SMOOTH and not moved <= FAR:
            status = NOT_CONVERGED
        if status == SMOOTH:
            status = _judge(factors, active, weak) if self._holds(at, implied) else DEPENDENT
        zeta = at.c + at.J.T @ lam
        zeta[active.free] = 0.0
        return Optimum(
            at.x, lam, zeta, active, weak, implied, np.zeros((0, lam.size)), self.limits, self.start, self.scale,
            status, factors, Matrix(at.J), hessian, at.c, at.g, moved,
        )  # fmt: skip

    def _holds(self, at: _Values, implied: Active) -> bool:
        """Return whether the limits that were left out hold."""
        bounds, limits = self.limits.place(implied)
        held, chosen = implied.held, implied.chosen
        off = np.abs(at.x[held] - bounds) / self.size[held]
        rows = np.abs(at.g[chosen] - limits) / np.maximum(1.0, np.abs(limits))
        return max(float(off.max(initial=0.0)), float(rows.max(initial=0.0))) <= WEAK

    def _evaluate(self, x: Array) -> _Values:
        p = self.start.parameters
        c = self.scale * self.functions.gradient(x, p)
        return _Values(x, self.functions.constraint(x, p), c, self.functions.jacobian(x, p).tocsr())

    def _curve(self, x: Array, lam: Array) -> Matrix:
        return complete(self.functions.hessian(x, self.start.parameters, self.scale, lam))

    def _guess(self, x: Array, lam: Array) -> tuple[Array, Array, Active, Active] | str:
        """Go on to more digits; return point, multipliers, active limits and weak ones; or why that failed.

        Of multipliers, over the gradient, and distances, over sizes, the larger one decides; of weak limits both are 0.
        """
        limits = self.limits

        def values(x: Array) -> tuple[Array, Array, Matrix]:
            at = self._evaluate(x)
            return at.g, at.c, Matrix(at.J)

        bounds, ranges = (limits.lower, limits.upper), (limits.least, limits.most)
        found = Task(bounds, ranges, self.size, values, self._curve).approach(x, lam)
        if isinstance(found, str):
            return found
        at = self._evaluate(found.x)
        most = float(np.abs(at.c).max(initial=0.0)) or 1.0
        reach = np.maximum(1.0, np.abs(at.g))
        variables, weak = _choose(found.below, found.above, self.size, most)
        rows, weak_rows = _choose(found.row_below, found.row_above, reach, most)
        variables[limits.lower == limits.upper] = 2
        rows[(limits.least == limits.most) & ~_vanish(at.J, limits)] = 2
        return found.x, found.lam, Active(variables, rows), Active(weak, weak_rows)

    def _touch(self, at: _Values) -> Active:
        limits = self.limits
        reach = np.maximum(1.0, np.abs(at.g))
        return Active(
            _touch(at.x, limits.lower, limits.upper, WEAK * self.size),
            _touch(at.g, limits.least, limits.most, WEAK * reach),
        )

    def _part(self, at: _Values, lam: Array) -> tuple[Active, Active]:
        """Return the limits that are met with a force, and the ones that are met without."""
        touched, limits = self._touch(at), self.limits
        forced, zeta = WEAK * float(np.abs(at.c).max(initial=0.0)), at.c + at.J.T @ lam
        touched.rows[(limits.least == limits.most) & _vanish(at.J, limits)] = 0
        strong = Active(
            np.where((touched.variables == 2) | (np.abs(zeta) > forced), touched.variables, 0).astype(np.int8),
            np.where((touched.rows == 2) | (np.abs(lam) > forced), touched.rows, 0).astype(np.int8),
        )
        return strong, touched.without(strong)

    def _release(self, at: _Values, lam: Array, active: Active) -> Active:
        zeta = at.c + at.J.T @ lam
        variables, rows = active.variables.copy(), active.rows.copy()
        least = WEAK * float(np.abs(at.c).max(initial=0.0))
        variables[((variables == -1) & (zeta < -least)) | ((variables == 1) & (zeta > least))] = 0
        rows[((rows == -1) & (lam > least)) | ((rows == 1) & (lam < -least))] = 0
        return Active(variables, rows)

    def _correct(self, at: _Values, lam: Array, active: Active, weak: Active) -> Active:
        """Release limits of the wrong sign, and take in limits that are passed, unless they are weak."""
        released, limits = self._release(at, lam, active), self.limits
        variables, rows = released.variables.copy(), released.rows.copy()
        passed = (active.variables == 0) & (weak.variables == 0)
        variables[passed & (at.x < limits.lower - SMALL * self.size)] = -1
        variables[passed & (at.x > limits.upper + SMALL * self.size)] = 1
        passed, reach = (active.rows == 0) & (weak.rows == 0), np.maximum(1.0, np.abs(at.g))
        rows[passed & (at.g < limits.least - SMALL * reach)] = -1
        rows[passed & (at.g > limits.most + SMALL * reach)] = 1
        return Active(variables, rows)

    def _step(self, at: _Values, lam: Array, active: Active, system: _System) -> tuple[Array, Array]:
        """Return the point and the multipliers after a step of Newton's method."""
        free, held, chosen = active.free, active.held, active.chosen
        bounds, limits = self.limits.place(active)
        dx = np.zeros(at.x.size)
        dx[held] = bounds - at.x[held]
        right = -at.c[free] - (system.hessian @ dx)[free], limits - at.g[chosen] - (at.J @ dx)[chosen]
        found = system.factors.solve(np.concatenate(right))
        dx[free] = found[: free.size]
        new = np.zeros(lam.size)
        new[chosen] = found[free.size :]
        return at.x + dx, new


def _judge(factors: Factors, active: Active, weak: Active) -> str:
    """Return the status of a point that solves its equations."""
    if factors.is_singular or factors.measure_condition() > SINGULAR:
        return DEPENDENT
    if factors.negative != active.chosen.size:
        return FLAT
    return CHANGING if weak.variables.any() or weak.rows.any() else SMOOTH


def complete(upper: Matrix) -> Matrix:
    """Return the whole of a symmetric matrix of which the upper triangle is given."""
    return Matrix(mirror(upper))


def assemble(hessian: Matrix, J: sparse.csr_array, active: Active) -> Matrix:
    """Return the lower triangle of K."""
    free, chosen = active.free, active.chosen
    size = free.size + chosen.size
    variables, rows = np.full(hessian.shape[0], -1), np.full(J.shape[0], -1)
    variables[free], rows[chosen] = np.arange(free.size), np.arange(free.size, size)
    curved, sloped = hessian.tocoo(), J.tocoo()
    row = np.concatenate((variables[curved.row], rows[sloped.row]))
    col = np.concatenate((variables[curved.col], variables[sloped.col]))
    kept = (col >= 0) & (row >= col)
    entries = np.concatenate((curved.data, sloped.data))[kept]
    return Matrix(sparse.csc_array((entries, (row[kept], col[kept])), shape=(size, size)))


def _choose(below: tuple[Array, Array], above: tuple[Array, Array], size: Array, most: float) -> tuple[Sides, Sides]:
    """Return the limits that are active, and the ones of which distance and multiplier are both 0."""
    active, weak = np.zeros(size.size, dtype=np.int8), np.zeros(size.size, dtype=np.int8)
    for (s, z), sign in ((below, -1), (above, 1)):
        z, s = z * size / most, s / size
        is_weak = np.maximum(z, s) < WEAK
        active[(z > s) & ~is_weak] = sign
        weak[is_weak] = sign
    return active, weak


def _separate(values: Array, lower: Array, upper: Array, force: Array, size: Array) -> Sides | None:
    """Return the limits at which values are held by forces; None where a distance or a force leaves a doubt.

    The force of a lower limit is positive.
    """
    sides = np.zeros(values.size, dtype=np.int8)
    for sign, limits in ((-1, lower), (1, upper)):
        open_ = np.isfinite(limits) & (lower < upper)
        s, z = np.abs(values - limits)[open_] / size[open_], np.maximum(0.0, -sign * force[open_])
        if (np.maximum(s, z) < STRICT).any():
            return None
        sides[np.flatnonzero(open_)[z > s]] = sign
    sides[lower == upper] = 2
    return sides


def _vanish(J: sparse.csr_array, limits: Limits) -> NDArray[np.bool_]:
    """Mark the rows that no variable moves whose bounds differ."""
    movable = np.flatnonzero(limits.lower < limits.upper)
    largest: Array = abs(J[:, movable]).max(axis=1).toarray().ravel()
    return np.equal(largest, 0.0)


def _touch(values: Array, lower: Array, upper: Array, reach: Array) -> Sides:
    """Return the sides at which values are within reach of a limit."""
    sides = np.zeros(values.size, dtype=np.int8)
    below, above = values - lower, upper - values
    sides[(below <= reach) & (below <= above)] = -1
    sides[(above <= reach) & (above < below)] = 1
    sides[lower == upper] = 2
    return sides


def _tie(program: Program, start: Instance) -> Limits:
    """Return the limits; variables that a row of two entries makes equal keep the tightest ones, once."""
    from scipy.sparse.csgraph import connected_components  # here, and late: it takes long to load

    a, b = _list_equal(program, start).T
    graph = sparse.coo_array((np.ones(a.size), (a, b)), shape=(start.x.size, start.x.size))
    ties = np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
    lower, upper = start.lower.copy(), start.upper.copy()
    _keep_one(ties, lower, -1.0)
    _keep_one(ties, upper, 1.0)
    return Limits(lower, upper, start.g_lower, start.g_upper, ties)


def _list_equal(program: Program, start: Instance) -> Indices:
    """List the pairs (pairs, 2) of variables that a linear row of both alone makes equal, as a solver numbers them."""
    A = sparse.csr_array(program.A)
    seen, rows = np.full(program.variables, -1), program.kept_rows
    seen[program.kept] = np.arange(program.kept.size)
    curved = np.zeros(program.constraints, dtype=bool)
    for block in program.blocks:
        curved[block.rows] = True
    zero = (start.g_lower == 0) & (start.g_upper == 0)
    rows = rows[zero & ~curved[rows] & (np.diff(A.indptr)[rows] == 2)]
    first = A.indptr[rows]
    rows = first[A.data[first] == -A.data[first + 1]]
    pairs = np.stack((seen[A.indices[rows]], seen[A.indices[rows + 1]]), axis=1)
    return np.asarray(pairs[(pairs >= 0).all(axis=1)], dtype=np.int64)


def _keep_one(ties: Indices, bounds: Array, sign: float) -> None:
    """Keep the tightest bound of variables that are equal, and none for the others; sign 1: upper bounds."""
    order = np.lexsort((np.arange(ties.size), sign * bounds, ties))
    again = np.concatenate(([False], ties[order][1:] == ties[order][:-1]))
    bounds[order[again]] = sign * np.inf
