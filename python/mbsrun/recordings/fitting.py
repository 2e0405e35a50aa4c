"""Inverse kinematics along a recording: the poses whose sensors are nearest to recorded markers.

For every frame k, within the limits of the coordinates, with the loops closed and quaternions of length 1,

    minimise  1/2 sum_m w_m |p_m(q_k) - marker_mk|^2  +  1/2 sum_i w_i (q_ik - coordinate_ik)^2;

or for all frames together, with  1/2 S sum_k |second difference of q at k|^2  besides, which makes neighbours alike. A
marker that a frame lacks is left out of its sum. Gauss-Newton steps d solve, with A = J^T J + S D^T D + mu,

    minimise 1/2 d^T A d + g^T d   subject to  H d = -h,  lower <= q + d <= upper;

mu grows where a step does not reduce the sum plus rho |h|_1 (Nocedal, Wright, "Numerical optimization", 2006, chapters
10, 16 and 18). J and H are exact: the kernels' Jacobians of sensors and of loops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from mbsrun.closure import Closure
from mbsrun.kernel import Kernels
from mbsrun.models import Extent
from mbsrun.quaternions import list_quaternions, neutral, normalise

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Report = Callable[[str, int, int], None]  # takes the current step, the number of finished ones, and of all

FITTED = Extent(("sensors", "frames"), 1, optional=("loops", "loop_rates", "loop_jacobian", "rates"))  # of a model
ITERATIONS = 200  # of a frame
ROUNDS_OF_ALL = 60  # of all frames together
SETTLED = 1e-10  # a step below which an iteration ends, relative to 1 + |q|
ROUNDED = 1e-12  # of a sum: a difference within which it has not grown
STARTS = 30  # poses from which the first frame is fitted
DAMPING = 1e-9  # the least mu, relative to the mean of A's diagonal
STRONGEST = 1e6  # the largest mu: then the iteration ends
DETERMINED = 1e-7  # the least singular value of a direction that markers determine, relative to the largest
HELD = 1e-6  # the part of a coordinate in an undetermined direction from which it is undetermined
BOUNDARY = 1e-12  # relative distance from a limit that counts as none
ROUNDS = 60  # of the interior point method
CENTRE = 0.1  # of its complementarity that a step aims at
INSIDE = 1e-11  # of its complementarity, relative, when it ends
NEARLY = 1e-8  # of its other conditions then
LEAST = 1e-150  # distance from a limit
STUCK = 1e-8  # of its steps
SOFT = 1e-12  # of multipliers in the rows of constraints: so that dependent ones can be solved with
NEAR = 1e-6  # of its result: how near the one on the active limits is


@dataclass(frozen=True, eq=False)
class Targets:
    """Recorded markers, and recorded coordinates, at K times."""

    times: Array  # (K,)
    sensors: tuple[int, ...]  # of M markers, among the sensors of the model
    markers: Array  # (K, M, 3) [m]; NaN in gaps
    marker_weights: Array  # (M,)
    coordinates: tuple[int, ...]  # C entries of q
    values: Array  # (K, C); NaN in gaps
    value_weights: Array  # (C,)


@dataclass(frozen=True, eq=False)
class Fit:
    """The poses that fit, and how well."""

    times: Array  # (K,)
    q: Array  # (K, nq)
    errors: Array  # (K, M): distances of sensors from markers [m]; NaN in gaps
    deviations: Array  # (K, C): of coordinates from recorded ones; NaN in gaps
    is_undetermined: Mask  # (K, nq): entries that the frame's own markers leave open
    converged: Mask  # (K,)
    iterations: int  # of all frames
    at_limits: Mask  # (K, nq)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Residuals of one frame, and its constraints, with their derivatives."""

    r: Array
    J: Array
    h: Array
    H: Array

    @property
    def cost(self) -> float:
        """Return half the sum of squares."""
        return 0.5 * float(self.r @ self.r)


class Fitter:
    """Fits a mechanism to targets."""

    def __init__(self, kernels: Kernels, targets: Targets) -> None:
        self.kernels, self.targets, self.manifest = kernels, targets, kernels.manifest
        self.closure = Closure(kernels) if self.manifest.loops else None
        self.quaternions = list_quaternions(self.manifest)
        limits = {c.name: (c.lower, c.upper) for c in self.manifest.coordinates}
        pairs = [limits.get(name, (None, None)) for name in self.manifest.positions]
        self.lower = np.array([-np.inf if a is None else a for a, _ in pairs])
        self.upper = np.array([np.inf if b is None else b for _, b in pairs])
        self.iterations = 0

    def fit(self, smooth: float = 0.0, report: Report | None = None) -> Fit:
        """Fit every frame, from the one with the most markers on; then all together, where smoothness has a weight."""
        K, n = len(self.targets.times), len(self.manifest.positions)
        q, converged = np.zeros((K, n)), np.zeros(K, dtype=bool)
        known = np.isfinite(self.targets.markers).all(axis=2).sum(axis=1) + np.isfinite(self.targets.values).sum(axis=1)
        first = int(known.argmax())
        q[first], converged[first] = self.start(first)
        order = [(k, k - 1) for k in range(first + 1, K)] + [(k, k + 1) for k in range(first - 1, -1, -1)]
        for done, (k, before) in enumerate(order, 2):
            q[k], converged[k] = self.solve(k, q[before])
            if report is not None:
                report("fitting frames", done, K)
        if smooth > 0 and K > 2:
            q, is_done = self.solve_all(q, smooth, report)
            converged[:] = is_done
        q = self.settle_signs(normalise(q, self.manifest))
        return self.judge(q, converged)

    def start(self, k: int) -> tuple[Array, bool]:
        """Fit one frame from several poses, and take the best."""
        pose = np.array(self.manifest.pose) if self.manifest.pose else neutral(self.manifest)
        lower, upper = (
            np.where(np.isfinite(x), x, pose + side) for x, side in ((self.lower, -np.pi), (self.upper, np.pi))
        )
        for x in self.quaternions:
            lower[x.entries], upper[x.entries] = -1.0, 1.0
        from scipy.stats import qmc  # only here, and late: it takes a while to load

        spread = lower + qmc.Halton(pose.size, scramble=False).random(STARTS) * (upper - lower)
        found = []
        for start in (pose, *normalise(spread, self.manifest)):
            q, is_done = self.solve(k, start)
            sums = self.evaluate(k, q)
            is_good = is_done and float(np.abs(sums.h).max(initial=0.0)) < 1e-8
            found.append((not is_good, sums.cost, q))
        best = min(found, key=lambda x: (x[0], round(x[1], 12)))
        return best[2], not best[0]

    # --- one frame ---

    def evaluate(self, k: int, q: Array) -> _Sums:
        """Return the residuals of a frame, their Jacobian, and the constraints."""
        p = self.kernels("sensors", q=q)["position"].T if self.targets.sensors else np.zeros((0, 3))
        J = self.kernels("jac_sensors", q=q)["jac_position_q"] if self.targets.sensors else np.zeros((0, q.size))
        return self.weigh(k, q, p, J.reshape(-1, 3, q.size))

    def weigh(self, k: int, q: Array, p: Array, J: Array) -> _Sums:
        """Return residuals and constraints of a frame, from places p (sensors, 3) and their slopes J."""
        targets, chosen = self.targets, list(self.targets.sensors)
        marker, value = targets.markers[k], targets.values[k]
        seen, given = np.isfinite(marker).all(axis=1), np.isfinite(value)
        root, other = np.sqrt(targets.marker_weights[seen]), np.sqrt(targets.value_weights[given])
        picked = np.eye(q.size)[list(targets.coordinates)][given]
        r = np.concatenate(
            (
                (root[:, None] * (p[chosen][seen] - marker[seen])).ravel(),
                other * (q[list(targets.coordinates)][given] - value[given]),
            )
        )
        slopes = (root[:, None, None] * J[chosen][seen]).reshape(-1, q.size)
        return _Sums(r, np.concatenate((slopes, other[:, None] * picked)), *self.constrain(q))

    def constrain(self, q: Array) -> tuple[Array, Array]:
        """Return the gaps of loops and of quaternions' lengths, and their derivatives."""
        h, H = [], []
        if self.closure is not None:
            h.append(self.closure.gaps(q))
            H.append(self.closure.slopes(q[None])[0])
        for x in self.quaternions:
            row = np.zeros((1, q.size))
            row[0, x.entries] = q[x.entries]
            h.append(np.array([(q[x.entries] @ q[x.entries] - 1) / 2]))
            H.append(row)
        return (np.concatenate(h), np.concatenate(H)) if h else (np.zeros(0), np.zeros((0, q.size)))

    def solve(self, k: int, q: Array) -> tuple[Array, bool]:
        """Fit one frame from a pose; return whether it converged."""
        q = np.clip(q, self.lower, self.upper)
        here, mu = self.evaluate(k, q), DAMPING
        for _ in range(ITERATIONS):
            self.iterations += 1
            A, g = here.J.T @ here.J, here.J.T @ here.r
            scale = max(float(np.trace(A)) / q.size, 1e-12)
            step, multipliers = solve_step(
                A + mu * scale * np.eye(q.size), g, here.H, here.h, self.lower - q, self.upper - q
            )
            rho = 2 * float(np.abs(multipliers).max(initial=0.0)) + scale
            there = self.evaluate(k, np.clip(q + step, self.lower, self.upper))
            gain = here.cost + rho * np.abs(here.h).sum() - there.cost - rho * np.abs(there.h).sum()
            is_small = float(np.abs(step).max(initial=0.0)) <= SETTLED * (1 + float(np.abs(q).max(initial=0.0)))
            if gain >= -ROUNDED * here.cost or is_small:
                q, here, mu = np.clip(q + step, self.lower, self.upper), there, max(DAMPING, mu / 10)
            elif mu < STRONGEST:
                mu *= 10
            else:
                return q, False
            if is_small:
                return q, mu < 1
        return q, False

    # --- all frames ---

    def solve_all(self, q: Array, smooth: float, report: Report | None = None) -> tuple[Array, bool]:
        """Fit all frames together, from poses (K, nq); return whether that converged."""
        K, n = q.shape
        D = np.sqrt(smooth) * sparse.kron(second_differences(self.targets.times), sparse.eye_array(n))
        rough = (D.T @ D).tocsc()
        lower, upper = np.tile(self.lower, K), np.tile(self.upper, K)
        x, mu = np.clip(q.ravel(), lower, upper), DAMPING
        here = self.evaluate_all(x.reshape(K, n))
        cost = sum(part.cost for part in here) + _find_energy(D @ x)
        for k in range(ROUNDS_OF_ALL):
            self.iterations += K
            if report is not None:
                report("fitting all frames", k, ROUNDS_OF_ALL)
            A = sparse.csc_array(sparse.block_diag([part.J.T @ part.J for part in here])) + rough
            g = np.concatenate([part.J.T @ part.r for part in here]) + D.T @ (D @ x)
            H = sparse.csc_array(sparse.block_diag([part.H for part in here]))
            h = np.concatenate([part.h for part in here])
            scale = max(float(A.diagonal().mean()), 1e-12)
            damped = (A + mu * scale * sparse.eye_array(x.size)).tocsc()
            step, multipliers = solve_step(damped, g, H, h, lower - x, upper - x)
            rho = 2 * float(np.abs(multipliers).max(initial=0.0)) + scale
            trial = np.clip(x + step, lower, upper)
            there = self.evaluate_all(trial.reshape(K, n))
            found = sum(part.cost for part in there) + _find_energy(D @ trial)
            gain = cost - found + rho * (np.abs(h).sum() - sum(np.abs(part.h).sum() for part in there))
            is_small = float(np.abs(step).max()) <= SETTLED * (1 + float(np.abs(x).max()))
            if gain >= -ROUNDED * cost or is_small:
                x, here, cost, mu = trial, there, found, max(DAMPING, mu / 10)
            elif mu < STRONGEST:
                mu *= 10
            else:
                return x.reshape(K, n), False
            if is_small:
                return x.reshape(K, n), mu < 1
        return x.reshape(K, n), False

    def evaluate_all(self, q: Array) -> list[_Sums]:
        """Return residuals and constraints of every frame."""
        K, n = q.shape
        if not self.targets.sensors:
            return [self.evaluate(k, pose) for k, pose in enumerate(q)]
        p = self.kernels("sensors", q=q)["position"].transpose(0, 2, 1)
        J = self.kernels("jac_sensors", q=q)["jac_position_q"].reshape(K, -1, 3, n)
        return [self.weigh(k, q[k], p[k], J[k]) for k in range(K)]

    # --- the result ---

    def settle_signs(self, q: Array) -> Array:
        """Return poses whose quaternions, of which two signs are one attitude, keep their sign from frame to frame."""
        for x in self.quaternions:
            part = q[:, x.entries]
            flips = np.sign((part[1:] * part[:-1]).sum(axis=1))
            q[1:, x.entries] *= np.cumprod(np.where(flips == 0, 1.0, flips))[:, None]
        return q

    def judge(self, q: Array, converged: Mask) -> Fit:
        """Measure a fit."""
        targets = self.targets
        sums = self.evaluate_all(q)
        if targets.sensors:
            p = self.kernels("sensors", q=q)["position"].transpose(0, 2, 1)[:, list(targets.sensors)]
        else:
            p = np.zeros((len(q), 0, 3))
        return Fit(
            times=targets.times,
            q=q,
            errors=np.linalg.norm(p - targets.markers, axis=2),
            deviations=q[:, list(targets.coordinates)] - targets.values,
            is_undetermined=np.array([find_undetermined(part.J, part.H) for part in sums]).reshape(q.shape),
            converged=converged,
            iterations=self.iterations,
            at_limits=_is_near(q, self.lower) | _is_near(q, self.upper),
        )


def _find_energy(x: Array) -> float:
    """Return half of the sum of squares: exact to rounding, as the quadratic form of large entries would not be."""
    return 0.5 * float(x @ x)


def _is_near(q: Array, limit: Array) -> Mask:
    return np.asarray(
        np.isfinite(limit) & (np.abs(q - np.where(np.isfinite(limit), limit, 0)) <= BOUNDARY * (1 + np.abs(q)))
    )


def find_undetermined(J: Array, H: Array) -> Mask:
    """Mark the coordinates that move in a direction in which neither residuals nor constraints change."""
    n = J.shape[1]
    length = np.linalg.norm(J, axis=0).max(initial=0.0)
    stacked = np.concatenate((J / (length or 1.0), H, np.zeros((n, n))))
    _, sizes, basis = np.linalg.svd(stacked, full_matrices=False)
    free = basis[sizes <= DETERMINED * max(float(sizes[0]), 1e-300)] if sizes[0] > 0 else np.eye(n)
    return np.asarray(np.abs(free).max(axis=0, initial=0.0) > HELD)


def second_differences(times: Array) -> sparse.csr_array:
    """Return the matrix (K - 2, K) that takes values at K times to second derivatives at the inner ones."""
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    weights = (2 / (before * (before + after)), -2 / (before * after), 2 / (after * (before + after)))
    rows = np.tile(np.arange(len(before)), 3)
    entries = (np.concatenate(weights), (rows, rows + np.repeat(np.arange(3), len(before))))
    return sparse.csr_array(sparse.coo_array(entries, shape=(len(before), len(times))))


def solve_step(
    A: Array | sparse.csc_array, g: Array, H: Array | sparse.csc_array, h: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Solve the quadratic program of a step; return the step and the multipliers of H.

    A is positive definite, and 0 lies between lower and upper. Where the step without limits leaves them, an interior
    point method finds which ones are active.
    """
    none = np.zeros(g.size, dtype=bool)
    step, multipliers = _solve_active(A, g, H, h, lower, none)
    if ((step >= lower) & (step <= upper)).all():
        return step, multipliers
    inner, inner_multipliers, low, high = _solve_inside(A, g, H, h, lower, upper)
    step, multipliers = _solve_active(A, g, H, h, np.where(low, lower, upper), low | high)
    is_same = np.abs(step - inner).max() <= NEAR * (1 + np.abs(inner).max())
    return (np.clip(step, lower, upper), multipliers) if is_same else (inner, inner_multipliers)


def _solve_active(
    A: Array | sparse.csc_array, g: Array, H: Array | sparse.csc_array, h: Array, limits: Array, active: Mask
) -> tuple[Array, Array]:
    """Solve the program with some entries at their limits, and the others free."""
    free = np.flatnonzero(~active)
    step = np.where(active, limits, 0.0)
    found = _solve_kkt(A, H, free, np.concatenate((-(g + A @ step)[free], -(h + H @ step))))
    step[free] = found[: free.size]
    return step, found[free.size :]


def _solve_inside(
    A: Array | sparse.csc_array, g: Array, H: Array | sparse.csc_array, h: Array, lower: Array, upper: Array
) -> tuple[Array, Array, Mask, Mask]:
    """Solve the program from within the limits (Nocedal, Wright, section 16.6).

    Return the step, the multipliers of H, and which lower and upper limits are active.
    """
    n, still = g.size, upper - lower <= 1e-14
    has_low, has_high = np.isfinite(lower) & ~still, np.isfinite(upper) & ~still
    room = np.minimum(0.1 * np.where(np.isfinite(upper - lower), upper - lower, 1.0), 1.0)
    step = np.where(still, lower, np.clip(np.zeros(n), lower + room, upper - room))
    scale = max(float(np.abs(g).max()), 1e-12)
    zl, zu, y = scale * has_low, scale * has_high, np.zeros(h.size)
    free, count = np.flatnonzero(~still), max(int(has_low.sum() + has_high.sum()), 1)
    for _ in range(ROUNDS):
        sl, su = (
            np.maximum(x, LEAST) for x in (np.where(has_low, step - lower, 1.0), np.where(has_high, upper - step, 1.0))
        )
        slope, gap = A @ step + g + H.T @ y - zl + zu, H @ step + h
        mu = float((sl * zl + su * zu).sum()) / count
        gaps = float(np.abs(slope[free]).max(initial=0.0)) / scale, float(np.abs(gap).max(initial=0.0))
        if mu <= INSIDE * scale and (max(gaps) <= NEARLY or mu <= 1e-4 * INSIDE * scale):
            break
        aim_low, aim_high = (has_low * CENTRE * mu - sl * zl) / sl, (has_high * CENTRE * mu - su * zu) / su
        stiff = zl / sl + zu / su
        whole = A + np.diag(stiff) if isinstance(A, np.ndarray) else sparse.csc_array(A + sparse.diags_array(stiff))
        found = _solve_kkt(whole, H, free, np.concatenate(((aim_low - aim_high - slope)[free], -gap)))
        change = np.zeros(n)
        change[free] = found[: free.size]
        dl, du = aim_low - zl / sl * change, aim_high + zu / su * change
        pairs = ((sl, change, has_low), (su, -change, has_high), (zl, dl, has_low), (zu, du, has_high))
        longest = [(-x[down] / d[down]).min(initial=np.inf) for x, d, known in pairs for down in [known & (d < 0)]]
        alpha = min(1.0, 0.995 * min(longest))
        if alpha < STUCK:  # no step meets all constraints within the limits
            break
        step, y = step + alpha * change, y + alpha * found[free.size :]
        zl, zu = zl + alpha * dl, zu + alpha * du
    sl, su = np.where(has_low, step - lower, np.inf), np.where(has_high, upper - step, np.inf)
    return step, y, still | (has_low & (zl > scale * sl)), has_high & (zu > scale * su)


def _solve_kkt(
    A: Array | sparse.csc_array, H: Array | sparse.csc_array, free: NDArray[np.int64], right: Array
) -> Array:
    """Solve [[A, H^T], [H, 0]] x = right for the free variables; a small part of the multipliers softens H."""
    if isinstance(A, np.ndarray):
        part = np.asarray(H)[:, free]
        soft = -SOFT * np.eye(len(part))
        return np.asarray(np.linalg.solve(np.block([[A[np.ix_(free, free)], part.T], [part, soft]]), right))
    rows = sparse.csc_array(H)[:, free]
    soft_rows = -SOFT * sparse.eye_array(rows.shape[0])
    kkt = sparse.block_array([[sparse.csc_array(A)[free][:, free], rows.T], [rows, soft_rows]], format="csc")
    return np.asarray(splu(kkt).solve(right))
