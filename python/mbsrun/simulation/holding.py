"""The equations of motion with joints that slide, stick, or rest on stops: accelerations, and the forces that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.joints import HELD, Joints

Array = NDArray[np.float64]


class Forces:
    """The equations of motion with the forces of joints at rest and of sliding ones."""

    def __init__(self, dynamics: Dynamics) -> None:
        formulation = dynamics.formulation
        own = Formulation.SEMI if formulation.evaluated.is_direct else formulation
        self.dynamics, self.joints = replace(dynamics, formulation=own), Joints.of(dynamics.kernels.manifest)
        self.moving = np.flatnonzero(~self.joints.is_driven)

    def mass(self, q: Array, qd: Array, v: Array) -> Array:
        """Compute the mass matrix, (..., n, n)."""
        return self.dynamics.mass_matrix(q, qd, v)

    def respond(self, M: Array, chosen: NDArray[np.intp]) -> Array:
        """Return the accelerations (n, m) by a unit force on each of the chosen joints; driven joints have none."""
        n, moving = len(M), self.moving
        forces = np.zeros((n, len(chosen)))
        forces[chosen, np.arange(len(chosen))] = 1.0
        found = np.zeros((n, len(chosen)))
        found[moving] = self.solve(M[np.ix_(moving, moving)], forces[moving])
        return found

    def solve(self, M: Array, right: Array) -> Array:
        """Solve M x = right. Raises SingularError."""
        if not len(M):
            return np.zeros_like(right)
        return np.stack([self.dynamics.solve(M, column) for column in right.T], axis=1)

    def accelerate(
        self, time: float, q: Array, qd: Array, v: Array, M: Array, modes: NDArray[np.int_], forces: Array
    ) -> Array:
        """Compute the accelerations under the friction of sliding joints and forces on joints at rest, (n,)."""
        qdd = np.zeros_like(qd)
        qdd[self.joints.driven] = self.dynamics.course.at(time)[2]
        signs = np.where(np.abs(modes) == 1, modes, 0)
        right = forces - signs * self.joints.rub(qd) - self.dynamics.residual(q, qd, qdd, v)
        qdd[self.moving] = self.solve(M[np.ix_(self.moving, self.moving)], right[self.moving, None])[:, 0]
        qdd[np.isin(modes, HELD)] = 0.0
        return qdd

    def find_accelerations(self, t: Array, q: Array, qd: Array, v: Array, modes: NDArray[np.int_]) -> Array:
        """Return the accelerations (K, n) in modes (K, n), not counted as effort; NaN where they fail."""
        found = np.full(qd.shape, np.nan)
        for k, row in enumerate(modes):
            try:
                M = self.mass(q[k], qd[k], v[k])
                forces = self.hold(float(t[k]), q[k], qd[k], v[k], M, row)
                found[k] = self.accelerate(float(t[k]), q[k], qd[k], v[k], M, row, forces)
            except (KernelError, SingularError):
                continue
        return found

    def drive(self, t: Array, q: Array, qd: Array, v: Array, modes: NDArray[np.int_]) -> Array:
        """Return the forces of driven joints (K, d) in modes (K, n); NaN where they fail."""
        qdd = self.find_accelerations(t, q, qd, v, modes)
        return self.dynamics.residual(q, qd, qdd, v)[:, self.joints.driven]

    def hold(self, time: float, q: Array, qd: Array, v: Array, M: Array, modes: NDArray[np.int_]) -> Array:
        """Return the forces that hold joints at rest, (n,)."""
        held, forces = np.flatnonzero(np.isin(modes, HELD)), np.zeros(len(qd))
        if held.size:
            free = self.accelerate(time, q, qd, v, M, np.where(np.isin(modes, HELD), 0, modes), forces)
            forces[held] = -np.linalg.solve(self.respond(M, held)[held], free[held])
        return forces
