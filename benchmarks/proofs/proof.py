"""A point of a nonlinear program with its multipliers -> a proof that a strict local minimum is near.

    minimise f(x) such that g(x) = 0 in some rows, between bounds in others, and x between bounds

Bounds that hold x or a row of g are an active set; x there is its bound, and the rows are equations. There remains
the system F(z) = 0 of z = (free x, lam): the gradient of f + lam' g by free x, and held rows of g less their bounds.

Krawczyk's test proves one zero z* within |z - z0| <= rho: with any matrix C, here an approximate inverse of F'(z0),

    |C F(z0)| + |I - C F'(Z)| rho < rho,   Z the box of all such z.

F and F' are evaluated in balls of Arb; C and products with it in doubles, with bounds of their rounding: n u times the
same products of absolute values, n the number of terms. On Z, multipliers of held bounds keep their sign, and other
numbers stay off their bounds: strict complementarity. With A the held rows, H + w A'A positive definite for all z in Z
gives d'Hd > 0 where A d = 0: z* is a strict local minimum. This is proved by L D L' with D > 0 that differs from
H + w A'A - s I, in a norm, by less than s.

Where rounding hides this, another way is tried. F' is regular on Z, so it has as many positive eigenvalues everywhere;
that H is positive where A d = 0 follows on Z from one matrix in Z. `steps` shows it for the middle of F'(Z).

Rows of one meaning have no unique multipliers, and F' is singular. One case of it is dropped before, see `rest`: limits
in a last interval at rest. With x = (w, v), w the states of the interval, all v have one w on Z, since the derivative
by w of its equations r is regular there; it is the state at the end. So limits of w hold where limits of the end do.
`monotone` drops limits that the ends of a state imply. Where bounds hold more numbers than the equations leave free, as
where all controls switch at nodes, `vertices` releases bounds; the proof shows that their numbers stay within.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from flint import arb, ctx
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from benchmarks.proofs.intervals import Instructions
from benchmarks.proofs.steps import ROOM, UNIT, Array, Matrix, bound_curvature, find_steps
from benchmarks.proofs.vertices import SHIFT, choose_release, find_dependence

Indices = NDArray[np.int64]

BITS = 90
LEAST, LARGEST = 1e-13, 1e-8  # radius
LOT = 64  # rows of the inverse at once
NEAR = 1e-6  # of a bound that may hold a number, relative
FAR = 1e-3  # relative: another optimum than the one that was found
WEIGHTS = (1e4, 1e6, 1e2, 1.0, 1e8)  # w
SHIFTS = tuple(10.0**-k for k in range(2, 13))  # s


@dataclass(frozen=True, eq=False)
class Rest:
    """Numbers of a last interval at rest, which equal others at the end, and the rows that give them."""

    variables: Indices
    ends: Indices
    rows: Indices


@dataclass(frozen=True, eq=False)
class Nonlinear:
    """A program in CasADi's symbols, with its numbers."""

    objective: ca.Function  # x -> f
    constraint: ca.Function  # x -> g
    lower: Array  # of x
    upper: Array
    g_lower: Array
    g_upper: Array
    rest: Rest | None = None


@dataclass(frozen=True, eq=False)
class Point:
    """A point with an active set: -1, 0, 1 for each x and row that lies at its lower bound, none, its upper one."""

    x: Array
    lam: Array  # of all rows of g
    held: NDArray[np.int8]  # of x
    rows: NDArray[np.int8]  # of g; an equation is 1

    @property
    def free(self) -> Indices:
        """Number the x that no bound holds."""
        return np.flatnonzero(self.held == 0)

    @property
    def kept(self) -> Indices:
        """Number the rows that are equations here."""
        return np.flatnonzero(self.rows != 0)

    @property
    def unknowns(self) -> Array:
        """Return z."""
        return np.concatenate([self.x[self.free], self.lam[self.kept]])

    def release(self, place: int, lam: Array) -> Point:
        """Release a bound by its place, of x and then of rows, with new multipliers."""
        signs = np.concatenate([self.held, self.rows])
        signs[place] = 0
        held, rows = signs[: len(self.x)], signs[len(self.x) :]
        return Point(self.x, np.where(rows == 0, 0.0, lam), held, rows)


@dataclass(frozen=True)
class Proof:
    """The figures of a proof; `reason` says why it fails, and is empty where it does not."""

    radius: float  # z* lies within radius max(1, |z0|) of each entry
    contraction: float  # the norm of I - C F'(Z)
    least_multiplier: float  # of held bounds
    least_distance: float  # of other numbers, from their bounds
    curvature: float  # a lower bound of eigenvalues of H + w A'A, scaled to a diagonal of nearly 1, or see `steps`
    reason: str = ""


class System:
    """F and F' of a program, for any active set."""

    def __init__(self, program: Nonlinear) -> None:
        """Differentiate the Lagrangian in CasADi's symbols. Raises UnknownOperationError."""
        self.program = program
        x, lam = ca.SX.sym("x", len(program.lower)), ca.SX.sym("lam", len(program.g_lower))
        f, g = program.objective.expand()(x), program.constraint.expand()(x)
        hessian, gradient = ca.hessian(f + ca.dot(lam, g), x)
        first = ca.Function("first", [x, lam], [ca.densify(gradient), ca.densify(g)])
        self.second = ca.Function("second", [x, lam], [ca.tril(hessian), ca.jacobian(g, x)])
        self.gradient = first
        self.balls = Instructions.of(first), Instructions.of(self.second)
        self.patterns = tuple(
            tuple(np.array(x, dtype=np.int64) for x in self.second.sparsity_out(k).get_triplet()) for k in range(2)
        )

    def bound_rows(self, point: Point) -> Array:
        """Return the values that held rows take."""
        both = np.where(point.rows < 0, self.program.g_lower, self.program.g_upper)
        return both[point.kept]

    def assemble(self, point: Point, H: Array, J: Array) -> tuple[Matrix, Matrix]:
        """Return H of the free x, and A, of values of nonzeros."""
        n, free = len(self.program.lower), point.free
        triangle = Matrix(sparse.coo_array((H, self.patterns[0]), shape=(n, n)))
        whole = Matrix(triangle + sparse.tril(triangle, -1).T)
        return Matrix(whole[free][:, free]), Matrix(self._differentiate(J)[point.kept][:, free])

    def _differentiate(self, J: Array) -> sparse.csr_array:
        """Return the Jacobian of all rows by all x, of values of nonzeros."""
        shape = (len(self.program.g_lower), len(self.program.lower))
        return sparse.csr_array(sparse.coo_array((J, self.patterns[1]), shape=shape))

    def loosen(self, point: Point) -> Point:
        """Release bounds until the gradients of held rows and bounds are independent. Raises RuntimeError."""
        program = self.program
        J = self._differentiate(np.array(self.second(point.x, point.lam)[1].nonzeros()))
        gradient = np.array(self.gradient(point.x, 0 * point.lam)[0]).ravel()  # of the cost
        bounded = np.concatenate([program.lower < program.upper, program.g_lower < program.g_upper])
        while (y := find_dependence(Matrix(J[point.kept][:, point.free]))) is not None:
            along = np.zeros(len(point.lam))
            along[point.kept] = y
            signs = np.where(bounded, np.concatenate([point.held, point.rows]), 0)
            multipliers = np.concatenate([-gradient - J.T @ point.lam, point.lam])
            release = choose_release(signs, multipliers, np.concatenate([-(J.T @ along), along]))
            if release is None:
                raise RuntimeError("the rows depend on each other")
            point = point.release(release.place, point.lam + release.step * along)
        return point

    def hold_near(self, x: Array) -> Point:
        """Hold numbers and rows near their bounds, with the multipliers that fit best. Raises RuntimeError."""
        program = self.program
        g = np.array(program.constraint(x)).ravel()
        held, rows = _find_near(x, program.lower, program.upper), _find_near(g, program.g_lower, program.g_upper)
        x = np.where(held < 0, program.lower, np.where(held > 0, program.upper, x))
        point = Point(x, np.zeros(len(g)), held, rows)
        gradient, _ = self._evaluate(point)
        _, A = self.assemble(point, *(np.array(part.nonzeros()) for part in self.second(x, point.lam)))
        m, n = A.shape
        fit = splu(Matrix(sparse.block_array([[sparse.eye_array(n), A.T], [A, -SHIFT * sparse.eye_array(m)]])))
        lam = point.lam.copy()
        lam[point.kept] = fit.solve(np.concatenate([-gradient[point.free], np.zeros(m)]))[n:]
        return replace(point, lam=lam)

    def improve(self, point: Point) -> Point:
        """Release the bound that would have to pull the most, else hold the number that is the farthest beyond one."""
        program = self.program
        gradient, g = self._evaluate(point)
        signs, values = np.concatenate([point.held, point.rows]), np.concatenate([point.x, g])
        multipliers = np.concatenate([-gradient, point.lam])
        lower = np.concatenate([program.lower, program.g_lower])
        upper = np.concatenate([program.upper, program.g_upper])
        pulls = np.where((signs != 0) & (lower < upper), -signs * multipliers, 0.0)
        beyond = np.where(signs == 0, np.maximum(lower - values, values - upper) / np.maximum(1.0, np.abs(values)), 0.0)
        if pulls.max() > 0:
            return point.release(int(pulls.argmax()), point.lam)
        if beyond.max() <= 0:
            return point
        place = int(beyond.argmax())
        signs[place] = -1 if values[place] < lower[place] else 1
        held, rows = signs[: len(point.x)], signs[len(point.x) :]
        x = np.where(held < 0, program.lower, np.where(held > 0, program.upper, point.x))
        return Point(x, point.lam, held, rows)

    def step(self, point: Point, *, is_exact: bool = True) -> Point:
        """Take a step of Newton's method, with a residual of more digits than its matrix. Raises RuntimeError.

        Without `is_exact`, the residual has the digits of doubles, and takes far less time.
        """
        if is_exact:
            right, _ = _evaluate_residual(self, point)
        else:
            gradient, g = self._evaluate(point)
            right = np.concatenate([gradient[point.free], g[point.kept] - self.bound_rows(point)])
        H, J = (np.array(part.nonzeros()) for part in self.second(point.x, point.lam))
        step = splu(_border(*self.assemble(point, H, J))).solve(right)
        x, lam, free = point.x.copy(), point.lam.copy(), point.free
        x[free] -= step[: len(free)]
        lam[point.kept] -= step[len(free) :]
        return Point(x, lam, point.held, point.rows)

    def _evaluate(self, point: Point) -> tuple[Array, Array]:
        """Return the gradient of the Lagrangian, and g, in doubles."""
        gradient, g = self.gradient(point.x, point.lam)
        return np.array(gradient).ravel(), np.array(g).ravel()

    def change(self, point: Point, *, is_exact: bool = True) -> Point:
        """Hold numbers beyond bounds, and release bounds that would have to pull; the same point if there are none."""
        program = self.program
        if is_exact:
            gradient, g = (
                np.array([float(y.mid()) for y in part]) for part in self.balls[0].evaluate(_box(point, 0.0))
            )
        else:
            gradient, g = self._evaluate(point)
        held = _revise(point.x, -gradient, point.held, program.lower, program.upper)
        rows = _revise(g, point.lam, point.rows, program.g_lower, program.g_upper)
        if np.array_equal(held, point.held) and np.array_equal(rows, point.rows):
            return point
        x = np.where(held < 0, program.lower, np.where(held > 0, program.upper, point.x))
        return Point(x, np.where(rows == 0, 0.0, point.lam), held, rows)


def _revise(values: Array, multipliers: Array, signs: NDArray[np.int8], lower: Array, upper: Array) -> NDArray[np.int8]:
    """Return which bounds hold, by the values of free numbers and the multipliers of held ones."""
    pulled = (signs != 0) & (signs * multipliers < 0) & (lower < upper)
    beyond = np.where(values < lower, -1, np.where(values > upper, 1, 0))
    return np.where(signs == 0, beyond, np.where(pulled, 0, signs)).astype(np.int8)


def _find_near(values: Array, lower: Array, upper: Array) -> NDArray[np.int8]:
    """Return the sides of the bounds that values are near, relative to the values; equations are 1."""
    room = NEAR * np.maximum(1.0, np.abs(values))
    signs = np.where(values - lower < room, -1, np.where(upper - values < room, 1, 0))
    return np.where(lower == upper, 1, signs).astype(np.int8)


def approach(system: System, x: Array, rounds: int = 40) -> Point | None:
    """Find an active set from an optimum in doubles, with one change at a time; None where it is not found."""
    try:
        point = system.hold_near(x)
        for _ in range(rounds):
            point = system.loosen(point)
            for _ in range(3):
                point = system.step(point, is_exact=False)
            improved = system.improve(point)
            if improved is point:
                return point if np.abs(point.x - x).max() < FAR * max(1.0, float(np.abs(x).max())) else None
            point = improved
    except (RuntimeError, ArithmeticError):
        pass
    return None


def settle(system: System, point: Point, rounds: int = 20) -> Point:
    """Find the active set and the zero of F near a point, in doubles first. Raises ArithmeticError."""
    before, ctx.prec = ctx.prec, BITS
    try:
        for is_exact in (False, True):
            for _ in range(rounds):
                point = system.loosen(point)
                for _ in range(3):
                    point = system.step(point, is_exact=is_exact)
                changed = system.change(point, is_exact=is_exact)
                if changed is point:
                    break
                point = changed
        if changed is point:
            return point
    except RuntimeError as error:
        raise ArithmeticError("the matrix of the conditions is singular: no isolated optimum") from error
    finally:
        ctx.prec = before
    raise ArithmeticError("no active set was found")


def prove(system: System, point: Point) -> Proof:
    """Prove a strict local minimum near a point, if it is one."""
    before, ctx.prec = ctx.prec, BITS
    try:
        return _prove(system, point)
    except (ArithmeticError, RuntimeError) as error:
        return Proof(np.inf, np.inf, 0.0, 0.0, 0.0, str(error) or type(error).__name__)
    finally:
        ctx.prec = before


def _prove(system: System, point: Point) -> Proof:
    z = point.unknowns
    scale, size = np.maximum(1.0, np.abs(z)), len(z)
    residual = _evaluate_residual(system, point)
    middle, _ = _evaluate_matrix(system, point, 0.0)
    factors = splu(_border(*middle))
    guess = np.abs(factors.solve(residual[0])) / scale  # the test below decides
    radius = float(min(max(8 * guess.max(), LEAST), LARGEST))
    (H, A), (H_radius, A_radius) = _evaluate_matrix(system, point, radius)
    matrix, radii = _border(H, A), _border(H_radius, A_radius)
    contraction, moved, slack = 0.0, 0.0, _bound_rounding(matrix)
    steps, leaked = find_steps(H, A), 0.0
    for lot, C in _list_rows(factors, size):
        product, absolute = np.abs(C @ matrix - _unit(lot, size)), np.abs(C)
        rest = product * (1 + UNIT) + absolute @ (radii + slack * abs(matrix))
        contraction = max(contraction, ROOM * float(((rest @ scale) / scale[lot]).max()))
        shift = np.abs(C @ residual[0]) + absolute @ (residual[1] + (size + 4) * UNIT * np.abs(residual[0]))
        moved = max(moved, ROOM * float((shift / scale[lot]).max()))
        if steps is not None:
            leaked = max(leaked, ROOM * float((absolute[:, H.shape[0] :] @ steps.leak / scale[lot]).max()))
    if not moved + contraction * radius < radius:
        reason = f"Krawczyk's test fails: a step of {moved:.1e} and a contraction of {contraction:.1e} at {radius:.0e}"
        return Proof(radius, contraction, 0.0, 0.0, 0.0, reason)
    if not _is_regular(system, point, A, A_radius):
        return Proof(radius, contraction, 0.0, 0.0, 0.0, "the rest in the last interval was not proved")
    signs, distance = _check_sides(system, point, radius)
    if signs <= 0 or distance <= 0:
        reason = f"no strict complementarity: multipliers from {signs:.1e}, distances from {distance:.1e}"
        return Proof(radius, contraction, signs, distance, 0.0, reason)
    curvature = _bound_curvature(H, A, H_radius, A_radius)
    if not curvature and steps is not None:
        curvature = bound_curvature(H, steps, leaked / (1 - contraction) * ROOM * scale[: len(steps.Z)])
    reason = "" if curvature > 0 else "the second-order condition was not proved"
    return Proof(radius, contraction, signs, distance, curvature, reason)


def _is_regular(system: System, point: Point, A: Matrix, A_radius: Matrix) -> bool:
    """Return whether the numbers of a last interval at rest are given uniquely on the box, by |I - C r'| < 1."""
    rest = system.program.rest
    if rest is None:
        return True
    rows, columns = np.searchsorted(point.kept, rest.rows), np.searchsorted(point.free, rest.variables)
    middle, radii = (part.tocsr()[rows][:, columns].toarray() for part in (A, A_radius))
    try:
        C = np.linalg.inv(middle)
    except np.linalg.LinAlgError:
        return False
    slack = (len(C) + 4) * UNIT
    gap = np.abs(C @ middle - np.eye(len(C))) + np.abs(C) @ (radii + slack * np.abs(middle))
    return bool(ROOM * gap.sum(axis=1).max() < 1)


def level(program: Nonlinear, point: Point) -> Point:
    """Set the numbers of a last interval at rest to their ends exactly."""
    if program.rest is None:
        return point
    x = point.x.copy()
    x[program.rest.variables] = x[program.rest.ends]
    return replace(point, x=x)


def _bound_rounding(matrix: Matrix) -> float:
    """Return a bound of the relative error of products with the columns of a matrix, by their number of terms."""
    return float(np.diff(matrix.indptr).max() + 4) * UNIT


def enclose_cost(system: System, point: Point, radius: float) -> tuple[float, float]:
    """Return the least and the largest cost within a ball."""
    before, ctx.prec = ctx.prec, BITS
    try:
        ((cost,),) = Instructions.of(system.program.objective.expand()).evaluate(_box(point, radius)[:1])
        return float(cost.lower()), float(cost.upper())
    finally:
        ctx.prec = before


def _balls(values: Array, radii: Array | float) -> list[arb]:
    return [arb(float(x), float(r)) for x, r in zip(values, np.broadcast_to(radii, values.shape), strict=True)]


def _box(point: Point, radius: float) -> tuple[list[arb], list[arb]]:
    """Return x and lam as balls; held x are their bounds, and rows that are not held have no multiplier."""
    x_radius = np.where(point.held == 0, radius * np.maximum(1.0, np.abs(point.x)) * ROOM, 0.0)
    lam_radius = np.where(point.rows != 0, radius * np.maximum(1.0, np.abs(point.lam)) * ROOM, 0.0)
    return _balls(point.x, x_radius), _balls(point.lam, lam_radius)


def _split(values: list[arb]) -> tuple[Array, Array]:
    """Return middles as doubles, and bounds of the distances from them."""
    middles = np.array([float(x.mid()) for x in values])
    radii = np.array([float(abs(x - arb(m)).upper()) for x, m in zip(values, middles, strict=True)])
    if not np.isfinite(middles).all() or not np.isfinite(radii).all():
        raise ArithmeticError("a function is not finite on the ball")
    return middles, np.nextafter(radii, np.inf)


def _evaluate_residual(system: System, point: Point) -> tuple[Array, Array]:
    """Return F(z0) and its error."""
    gradient, g = system.balls[0].evaluate(_box(point, 0.0))
    bounds = system.bound_rows(point).tolist()
    return _split(
        [*(gradient[k] for k in point.free), *(g[k] - arb(b) for k, b in zip(point.kept, bounds, strict=True))]
    )


def _evaluate_matrix(
    system: System, point: Point, radius: float
) -> tuple[tuple[Matrix, Matrix], tuple[Matrix, Matrix]]:
    """Return H and A, middles and radii."""
    H, J = (_split(part) for part in system.balls[1].evaluate(_box(point, radius)))
    return system.assemble(point, H[0], J[0]), system.assemble(point, H[1], J[1])


def _border(H: Matrix, A: Matrix) -> Matrix:
    return Matrix(sparse.block_array([[H, A.T], [A, None]], format="csc"))


def _list_rows(factors: object, size: int) -> Iterator[tuple[Indices, Array]]:
    """List rows of the approximate inverse of a symmetric matrix, which are its columns, some at a time."""
    for begin in range(0, size, LOT):
        lot = np.arange(begin, min(begin + LOT, size))
        yield lot, factors.solve(_unit(lot, size).T).T  # type: ignore[attr-defined]


def _unit(lot: Indices, size: int) -> Array:
    rows = np.zeros((len(lot), size))
    rows[np.arange(len(lot)), lot] = 1.0
    return rows


def _check_sides(system: System, point: Point, radius: float) -> tuple[float, float]:
    """Return the least multiplier of held bounds, and the least distance of other numbers from bounds, over the box."""
    program, (x, lam) = system.program, _box(point, radius)
    gradient, g = system.balls[0].evaluate((x, lam))
    pulls = [-y for y in gradient]
    sides = (
        (x, pulls, point.held, program.lower, program.upper),
        (g, lam, point.rows, program.g_lower, program.g_upper),
    )
    signs, distances = [np.inf], [np.inf]
    for values, multipliers, held, lows, highs in sides:
        for value, y, side, low, high in zip(
            values, multipliers, held.tolist(), lows.tolist(), highs.tolist(), strict=True
        ):
            if not side:
                distances += [float((value - arb(low)).lower()), float((arb(high) - value).lower())]
            elif low < high:
                signs.append(float((side * y).lower()))
    return min(signs), min(distances)


def _bound_curvature(H: Matrix, A: Matrix, H_radius: Matrix, A_radius: Matrix) -> float:
    """Return a lower bound of the eigenvalues of D (H + w A'A) D for all H and A in their intervals; 0: none is found.

    D holds powers of 2, so that products with it are exact, and makes the diagonal nearly 1.
    """
    size = H.shape[0]
    wide, slack = abs(A) + A_radius, _bound_rounding(A) + 4 * UNIT
    for weight in WEIGHTS:
        S = Matrix(H + weight * (A.T @ A))
        S = Matrix((S + S.T) / 2)
        doubt = H_radius + weight * (abs(A).T @ A_radius + A_radius.T @ wide)
        doubt = doubt + slack * (abs(H) + weight * (wide.T @ wide))
        D = sparse.diags_array(2.0 ** np.round(-np.log2(np.maximum(S.diagonal(), 1e-30)) / 2))
        S, doubt = Matrix(D @ S @ D), Matrix(D @ doubt @ D)
        for shift in SHIFTS:
            shifted = Matrix(S - shift * sparse.eye_array(size))
            rest = _bound_difference(shifted, doubt)
            if rest < shift:
                return (shift - rest) / ROOM
    return 0.0


def _bound_difference(S: Matrix, doubt: Matrix) -> float:
    """Return a bound of the norm of S, give or take `doubt`, less the nearest L D L' with D > 0; infinity for none."""
    options = {"SymmetricMode": True}
    try:
        factors = splu(S, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:
        return np.inf
    D = factors.U.diagonal()
    if not np.array_equal(factors.perm_r, factors.perm_c) or not (D > 0).all():
        return np.inf
    L, order = Matrix(factors.L), np.argsort(factors.perm_c)
    scaled = Matrix(L @ sparse.diags_array(D))
    error = abs(S[order][:, order] - scaled @ L.T) + UNIT * abs(S[order][:, order])
    error = error + 2 * _bound_rounding(Matrix(L.T)) * (abs(scaled) @ abs(L).T) + doubt[order][:, order]
    return ROOM * float(error.sum(axis=1).max())
