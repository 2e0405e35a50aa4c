"""The equations of motion with joints that slide, stick, or rest on stops: accelerations, and the forces that hold.

    M qdd + c = Q + J^T lam + forces,    J qdd + gamma = 0

Loops leave the velocities N x of joints that are not driven, with M = L L^T, B = J L^-T and N = L^-T ker B. Forces on
joints accelerate them by W = N N^T, of which `factor` is N^T. Where loops lock joints, W is singular, and several
distributions of forces hold the same joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import Closure
from mbsrun.kernel import KernelError
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.joints import HELD, Joints

Array = NDArray[np.float64]

RANK = 1e-8  # of the singular values of B, relative to the first: smaller ones are 0, as in C
LOCKED = 1e-6  # of a joint's response without loops: one that has less left is locked


@dataclass(frozen=True, eq=False)
class Inertia:
    """The inertia of a mechanism at a pose; (f,) are the joints that are not driven."""

    M: Array  # (n, n)
    J: Array  # (e, n)
    moving: NDArray[np.intp]  # (f,)
    free: Array  # (f, f): L^-1
    factor: Array  # (k, f): N^T, the same without loops
    pull: Array  # (f, e): L^-T B^+

    def respond(self, chosen: NDArray[np.intp]) -> Array:
        """Return the accelerations (n, m) by a unit force on each of the chosen joints; driven joints have none."""
        found = np.zeros((len(self.M), len(chosen)))
        found[self.moving] = self.factor.T @ self.factor[:, self.find(chosen)]
        return found

    def find(self, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return where chosen joints are among the moving ones."""
        return np.searchsorted(self.moving, chosen)

    def measure(self, chosen: NDArray[np.intp]) -> Array:
        """Return the accelerations of joints by unit forces on them, were there no loops, (m,)."""
        return np.asarray((self.free[:, self.find(chosen)] ** 2).sum(axis=0))

    def scale(self, chosen: NDArray[np.intp]) -> Array:
        """Return the columns of `factor` of joints, relative to their lengths without loops, (k, m)."""
        return np.asarray(self.factor[:, self.find(chosen)] / np.sqrt(self.measure(chosen)))

    def are_independent(self, chosen: NDArray[np.intp]) -> bool:
        """Return whether the chosen joints can be held by one distribution of forces alone."""
        if not len(self.J) or not chosen.size:
            return True
        columns = self.scale(chosen)
        return columns.shape[0] >= chosen.size and bool(np.linalg.svd(columns, compute_uv=False)[-1] > LOCKED)

    def choose(self, chosen: NDArray[np.intp], slack: Array) -> NDArray[np.intp]:
        """Choose joints that lock all the chosen ones by one distribution of forces; most slack goes first."""
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
        """Compute the inertia at a pose. Raises KernelError and SingularError."""
        M, moving = self.dynamics.mass_matrix(q, qd, v), self.moving
        J = self.closure.jacobian(q)
        free = np.asarray(np.linalg.inv(self.dynamics.factorise(M, moving)), dtype=np.float64)
        if not len(J):
            return Inertia(M, J, moving, free, free, np.zeros((len(moving), 0)))
        U, sizes, V = np.linalg.svd(J[:, moving] @ free.T)
        rank = int((sizes > RANK * sizes.max(initial=0.0)).sum())
        pull = np.asarray(free.T @ (V[:rank].T / sizes[:rank]) @ U[:, :rank].T)
        return Inertia(M, J, moving, free, np.asarray(V[rank:] @ free), pull)

    def accelerate(
        self, time: float, q: Array, qd: Array, v: Array, inertia: Inertia, modes: NDArray[np.int_], forces: Array
    ) -> Array:
        """Compute the accelerations under the friction of sliding joints and forces on joints at rest, (n,)."""
        qdd, moving = np.zeros_like(qd), self.moving
        qdd[self.joints.driven] = self.dynamics.course.at(time)[2]
        right = forces + self.rub(qd, modes) - self.dynamics.residual(q, qd, qdd, v, self._no_multipliers)
        qdd[moving] = inertia.factor.T @ (inertia.factor @ right[moving])
        if len(inertia.J):
            driven = inertia.J @ np.where(self.joints.is_driven, qdd, 0.0)
            qdd[moving] -= inertia.pull @ (self.closure.bias(q, qd) + driven)
        qdd[np.isin(modes, HELD)] = 0.0
        return qdd

    def rub(self, qd: Array, modes: NDArray[np.int_]) -> Array:
        """Return the friction of sliding joints, (n,)."""
        return np.asarray(-np.where(np.abs(modes) == 1, modes, 0) * self.joints.rub(qd))

    def find_all(self, t: Array, q: Array, qd: Array, v: Array, modes: NDArray[np.int_]) -> tuple[Array, Array, Array]:
        """Return accelerations (K, n), multipliers (K, e) and forces of driven joints (K, d) in modes (K, n).

        They are not counted as effort, and NaN where they fail.
        """
        sizes = qd.shape[1], len(self.closure.manifest.owners), len(self.joints.driven)
        qdds, lams, taus = (np.full((len(t), size), np.nan) for size in sizes)
        for k, row in enumerate(modes):
            try:
                inertia = self.weigh(q[k], qd[k], v[k])
                state = float(t[k]), q[k], qd[k], v[k]
                forces = self.hold(*state, inertia, row)
                qdd = self.accelerate(*state, inertia, row, forces)
                rest = self.dynamics.residual(q[k], qd[k], qdd, v[k], self._no_multipliers)
            except (KernelError, SingularError):
                continue
            rest -= forces + self.rub(qd[k], row)
            lam = np.linalg.lstsq(inertia.J[:, self.moving].T, rest[self.moving], rcond=RANK)[0]
            qdds[k], lams[k], taus[k] = qdd, lam, (rest - inertia.J.T @ lam)[self.joints.driven]
        return qdds, lams, taus

    def find_work(
        self, inertia: Inertia, before: Array, after: Array, joints: NDArray[np.intp], impulses: Array
    ) -> float:
        """Return the work of driven joints in an impact, with impulses (m,) on some joints."""
        if not self.joints.driven:
            return 0.0
        rest = inertia.M @ (after - before)
        rest[joints] -= impulses
        lam = np.linalg.lstsq(inertia.J[:, self.moving].T, rest[self.moving], rcond=RANK)[0]
        return float((rest - inertia.J.T @ lam)[self.joints.driven] @ before[self.joints.driven])

    def drive(self, t: Array, q: Array, qd: Array, v: Array, modes: NDArray[np.int_]) -> Array:
        """Return the forces of driven joints (K, d) in modes (K, n); NaN where they fail."""
        return self.find_all(t, q, qd, v, modes)[2]

    def hold(self, time: float, q: Array, qd: Array, v: Array, inertia: Inertia, modes: NDArray[np.int_]) -> Array:
        """Return the forces that hold joints at rest, (n,): the least ones where several do."""
        held, forces = np.flatnonzero(np.isin(modes, HELD)), np.zeros(len(qd))
        if held.size:
            free = self.accelerate(time, q, qd, v, inertia, np.where(np.isin(modes, HELD), 0, modes), forces)
            A = inertia.respond(held)[held]
            if inertia.are_independent(held):
                forces[held] = -np.linalg.solve(A, free[held])
            else:
                forces[held] = -np.linalg.lstsq(A, free[held], rcond=LOCKED**2)[0]
        return forces

    @property
    def _no_multipliers(self) -> Array | None:
        count = len(self.closure.manifest.owners)
        return np.zeros(count) if count else None
