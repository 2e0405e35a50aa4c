"""The equations of motion with joints that slide, stick, or rest on stops: accelerations, and the forces that hold.

    M qdd + c = Q + J^T lam + forces,    J qdd + gamma = 0

Loops leave the velocities N x of joints that are not driven, with M = L L^T, B = J L^-T and N = L^-T ker B. Forces on
joints accelerate them by W = N N^T = L^-T P L^-1, P the projection on ker B, of which `factor` is P L^-1. Where loops
lock joints, W is singular, and several distributions of forces hold the same joints.

All is computed for one state, or for any leading axes of states in the same modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsrun.closure import Closure
from mbsrun.kernel import KernelError
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.joints import Joints, are_held

Array = NDArray[np.float64]
Modes = NDArray[np.int_]
Results = tuple[Array, Array, Array]  # accelerations, multipliers, forces of driven joints

RANK = 1e-8  # of the singular values of B, relative to the first: smaller ones are 0, as in C
LOCKED = 1e-6  # of a joint's response without loops: one that has less left is locked
MANY = 1000  # states that are computed at once: more need much memory


@dataclass(frozen=True, eq=False)
class Inertia:
    """The inertia of a mechanism at poses; (f,) are the joints that are not driven."""

    M: Array  # (..., n, n)
    J: Array  # (..., e, n)
    moving: NDArray[np.intp]  # (f,)
    free: Array  # (..., f, f): L^-1
    factor: Array  # (..., f, f): P L^-1, the same without loops
    pull: Array  # (..., f, e): L^-T B^+

    def respond(self, chosen: NDArray[np.intp]) -> Array:
        """Return accelerations (..., n, m) by a unit force on each of the chosen joints; driven joints have none."""
        found = np.zeros((*self.M.shape[:-1], len(chosen)))
        found[..., self.moving, :] = self.factor.mT @ self.factor[..., self.find(chosen)]
        return found

    def move(self, forces: Array) -> Array:
        """Return the accelerations of moving joints (..., f) by forces on them (..., f)."""
        return _apply(self.factor.mT, _apply(self.factor, forces))

    def find(self, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return where chosen joints are among the moving ones."""
        return np.searchsorted(self.moving, chosen)

    def measure(self, chosen: NDArray[np.intp]) -> Array:
        """Return the accelerations of joints by unit forces on them, were there no loops, (..., m)."""
        return np.asarray((self.free[..., self.find(chosen)] ** 2).sum(axis=-2))

    def scale(self, chosen: NDArray[np.intp]) -> Array:
        """Return the columns of `factor` of joints, relative to their lengths without loops, (..., f, m)."""
        return np.asarray(self.factor[..., self.find(chosen)] / np.sqrt(self.measure(chosen))[..., None, :])

    def are_independent(self, chosen: NDArray[np.intp]) -> bool:
        """Return whether the chosen joints can be held by one distribution of forces alone, in all states."""
        if not self.J.shape[-2] or not chosen.size:
            return True
        return bool((np.linalg.svd(self.scale(chosen), compute_uv=False)[..., -1] > LOCKED).all())

    def choose(self, chosen: NDArray[np.intp], slack: Array) -> NDArray[np.intp]:
        """Choose joints that lock all the chosen ones in one state by one distribution; most slack goes first."""
        if self.are_independent(chosen):
            return chosen
        most = len(self.moving) - len(self.J)
        columns, basis, found = self.scale(chosen), np.zeros((len(self.factor), 0)), list[int]()
        for k in np.argsort(-slack, kind="stable"):
            rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
            rest -= basis @ (basis.T @ rest)
            length = float(np.linalg.norm(rest))
            if length > LOCKED and len(found) < most:
                basis = np.column_stack((basis, rest / length))
                found.append(int(chosen[k]))
        return np.array(sorted(found), dtype=np.intp)


class Forces:
    """The equations of motion with the forces of joints at rest and of sliding ones."""

    def __init__(self, dynamics: Dynamics) -> None:
        formulation = dynamics.formulation
        own = Formulation.SEMI if formulation.evaluated.is_direct else formulation
        self.dynamics, self.joints = replace(dynamics, formulation=own), Joints.of(dynamics.kernels.manifest)
        self.closure = Closure(dynamics.kernels)
        self.moving = np.flatnonzero(~self.joints.is_driven)

    def weigh(self, q: Array, qd: Array, v: Array) -> Inertia:
        """Compute the inertia at poses. Raises KernelError and SingularError."""
        M, moving = self.dynamics.mass_matrix(q, qd, v), self.moving
        J = self.closure.jacobian(q)
        free = np.asarray(np.linalg.inv(self.dynamics.factorise(M, moving)), dtype=np.float64)
        if not J.shape[-2]:
            return Inertia(M, J, moving, free, free, np.zeros((*free.shape[:-1], 0)))
        U, sizes, V = np.linalg.svd(J[..., moving] @ free.mT, full_matrices=False)
        is_felt = sizes > RANK * sizes.max(axis=-1, keepdims=True, initial=0.0)
        inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=is_felt)
        factor = free - (V.mT * is_felt[..., None, :]) @ (V @ free)
        return Inertia(M, J, moving, free, factor, free.mT @ (V.mT * inverse[..., None, :]) @ U.mT)

    def accelerate(
        self, time: ArrayLike, q: Array, qd: Array, v: Array, inertia: Inertia, modes: Modes, forces: Array
    ) -> Array:
        """Compute the accelerations under the friction of sliding joints and forces on joints at rest, (..., n)."""
        qdd, moving = np.zeros_like(qd), self.moving
        if self.joints.driven:
            t = np.asarray(time, dtype=np.float64)
            qdd[..., self.joints.driven] = self.dynamics.course.states(t.ravel())[2].reshape(*t.shape, -1)
        right = forces + self.rub(qd, modes) - self.dynamics.residual(q, qd, qdd, v, self._no_multipliers)
        if inertia.J.shape[-2]:
            bias = self.closure.bias(q, qd) + _apply(inertia.J, qdd)
            qdd[..., moving] = inertia.move(right[..., moving]) - _apply(inertia.pull, bias)
        else:
            qdd[..., moving] = inertia.move(right[..., moving])
        qdd[..., are_held(modes)] = 0.0
        return qdd

    def rub(self, qd: Array, modes: Modes) -> Array:
        """Return the friction of sliding joints, (..., n)."""
        return np.asarray(-np.where(np.abs(modes) == 1, modes, 0) * self.joints.rub(qd))

    def find_all(self, t: Array, q: Array, qd: Array, v: Array, modes: Modes) -> Results:
        """Return accelerations (K, n), multipliers (K, e) and forces of driven joints (K, d) in modes (K, n).

        They are not counted as effort, and NaN where they fail.
        """
        sizes = qd.shape[1], len(self.closure.manifest.owners), len(self.joints.driven)
        qdds, lams, taus = (np.full((len(t), size), np.nan) for size in sizes)
        rows, kinds = np.unique(modes, axis=0, return_inverse=True)
        for kind, row in enumerate(rows):
            chosen = np.flatnonzero(kinds.ravel() == kind)
            for part in np.split(chosen, range(MANY, len(chosen), MANY)):
                self._fill((qdds, lams, taus), part, (t, q, qd, v), row)
        return qdds, lams, taus

    def _fill(
        self, found: Results, chosen: NDArray[np.intp], states: tuple[Array, Array, Array, Array], modes: Modes
    ) -> None:
        """Compute what is asked for of chosen states, all in the same modes; one by one where one of them fails."""
        try:
            t, q, qd, v = (x[chosen] for x in states)
            for result, values in zip(found, self._find_alike(t, q, qd, v, modes), strict=True):
                result[chosen] = values
        except (KernelError, SingularError):
            for one in chosen[:, None] if chosen.size > 1 else ():
                self._fill(found, one, states, modes)

    def _find_alike(self, t: Array, q: Array, qd: Array, v: Array, modes: Modes) -> Results:
        inertia = self.weigh(q, qd, v)
        forces = self.hold(t, q, qd, v, inertia, modes)
        qdd = self.accelerate(t, q, qd, v, inertia, modes, forces)
        rest = self.dynamics.residual(q, qd, qdd, v, self._no_multipliers) - forces - self.rub(qd, modes)
        lam, driving = self._share(inertia, rest)
        return qdd, lam, driving

    def _share(self, inertia: Inertia, rest: Array) -> tuple[Array, Array]:
        """Return multipliers (..., e) that balance `rest` (..., n) at moving joints, and the forces of driven ones."""
        if not inertia.J.shape[-2]:
            return np.zeros((*rest.shape[:-1], 0)), rest[..., self.joints.driven]
        lam = _apply(np.linalg.pinv(inertia.J[..., self.moving].mT, rcond=RANK), rest[..., self.moving])
        return lam, (rest - _apply(inertia.J.mT, lam))[..., self.joints.driven]

    def find_work(
        self, inertia: Inertia, before: Array, after: Array, joints: NDArray[np.intp], impulses: Array
    ) -> float:
        """Return the work of driven joints in an impact, with impulses (m,) on some joints."""
        if not self.joints.driven:
            return 0.0
        rest = inertia.M @ (after - before)
        rest[joints] -= impulses
        return float(self._share(inertia, rest)[1] @ before[self.joints.driven])

    def drive(self, t: Array, q: Array, qd: Array, v: Array, modes: Modes) -> Array:
        """Return the forces of driven joints (K, d) in modes (K, n); NaN where they fail."""
        return self.find_all(t, q, qd, v, modes)[2]

    def hold(self, time: Array, q: Array, qd: Array, v: Array, inertia: Inertia, modes: Modes) -> Array:
        """Return the forces that hold joints at rest, (..., n): the least ones where several do."""
        held, forces = np.flatnonzero(are_held(modes)), np.zeros_like(qd)
        if held.size:
            free = self.accelerate(time, q, qd, v, inertia, np.where(are_held(modes), 0, modes), forces)[..., held]
            A = inertia.respond(held)[..., held, :]
            if inertia.are_independent(held):
                forces[..., held] = -np.linalg.solve(A, free[..., None])[..., 0]
            else:
                forces[..., held] = -_apply(np.linalg.pinv(A, rcond=LOCKED**2), free)
        return forces

    @property
    def _no_multipliers(self) -> Array | None:
        count = len(self.closure.manifest.owners)
        return np.zeros(count) if count else None


def _apply(A: NDArray[np.floating], x: Array) -> Array:
    """Multiply matrices (..., m, n) with vectors (..., n)."""
    return np.asarray((A @ x[..., None])[..., 0])
