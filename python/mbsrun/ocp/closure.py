"""Closed loops outside a program: poses, velocities and accelerations that keep them closed.

    h(q) = 0,    J qd = 0,    J qdd + gamma = 0,    J = dh/dq,    gamma = Jd qd

with the kernels `loops` and `loop_accelerations`. Newton's method finds a pose near a given one; among the poses that
close the loops to first order it takes the nearest: dq = -J^+ h. Some coordinates can keep their values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.ocp.plant import Plant

Array = NDArray[np.float64]

CLOSED = 1e-10  # the largest gap of closed loops [m, 1]
ITERATIONS = 50  # of Newton's method
LONGEST = 0.5  # step of Newton's method [rad, m]
SETTLED = 1e-14  # a step below which Newton's method ends [rad, m]
INDEPENDENT = 1e-6  # the least part of a unit vector that other conditions leave undetermined
REGULAR = 1e-3  # the least singular value of the block of dependent coordinates, relative to the largest of J


@dataclass(frozen=True)
class Gap:
    """The loop that is open by the most."""

    name: str
    distance: float  # [m, 1]

    def __str__(self) -> str:
        return f"the loop {self.name} stays open by {self.distance:.3g}"


class Closure:
    """The loops of a mechanism without quaternions; arrays have a leading batch axis B unless they say otherwise."""

    def __init__(self, plant: Plant) -> None:
        """Take the kernels of a mechanism that has loops."""
        self.plant, self.manifest = plant, plant.manifest
        self.independent, self.dependent = list(self.manifest.independent), list(self.manifest.dependent)

    # --- what loops say of a motion ---

    def gaps(self, q: Array) -> Array:
        """Return h, (B, m)."""
        return self.plant("loops", q=q)["gap"]

    def jacobian(self, q: Array) -> Array:
        """Return J, (B, m, n)."""
        return self.plant("jac_loops", q=q)["jac_gap_q"]

    def bias(self, q: Array, qd: Array) -> Array:
        """Return gamma, (B, m)."""
        return self.plant("loop_accelerations", q=q, qd=qd, qdd=np.zeros_like(qd))["hdd"]

    def measure(self, q: Array) -> float:
        """Return the largest gap of some poses (..., n)."""
        return float(np.abs(self.gaps(q.reshape(-1, q.shape[-1]))).max(initial=0.0))

    def measure_rates(self, q: Array, qd: Array) -> float:
        """Return the largest rate at which loops open in some states (..., n)."""
        n = q.shape[-1]
        return float(np.abs(self.jacobian(q.reshape(-1, n)) @ qd.reshape(-1, n, 1)).max(initial=0.0))

    def find_gap(self, q: Array) -> Gap:
        """Find the loop that is open by the most in one pose (n,)."""
        gaps = np.abs(self.gaps(q[None])[0])
        k = int(gaps.argmax())
        return Gap(self.manifest.loops[self.manifest.owners[k]].name, float(gaps[k]))

    # --- poses ---

    def close(self, q: Array, held: Sequence[int] = ()) -> Array:
        """Close the loops near one pose (n,), with some coordinates held; return the last iterate."""
        q = np.array(q, dtype=np.float64)
        free = np.setdiff1d(np.arange(q.size), np.array(held, dtype=np.int64))
        if not free.size:
            return q
        for _ in range(ITERATIONS):
            gap, J = self.gaps(q[None])[0], self.jacobian(q[None])[0][:, free]
            if not (np.isfinite(gap).all() and np.isfinite(J).all()):
                break
            step = -np.linalg.lstsq(J, gap, rcond=1e-9)[0]
            length = float(np.abs(step).max(initial=0.0))
            q[free] += step * min(1.0, LONGEST / max(length, SETTLED))
            if length < SETTLED:
                break
        return q

    def follow(self, path: Array, start: Array, held: Sequence[int]) -> Array | None:
        """Close a path (K, n) point by point, from a closed pose on.

        Held coordinates keep their values of the path, and the others go on from the point before; where none is held,
        each pose goes to the nearest closed one. Return None where loops do not close, or coordinates jump.
        """
        others, closed, last = np.setdiff1d(np.arange(len(start)), held), np.empty_like(path), start
        for k, pose in enumerate(path):
            near = pose.copy()
            if held:
                near[others] = last[others]
            found = self.close(near, held)
            if not self.is_closed(found) or np.abs((found - last)[others]).max(initial=0.0) > LONGEST:
                return None
            closed[k] = last = found
        return closed

    def is_closed(self, q: Array) -> bool:
        """Return whether the loops of some poses (..., n) are closed."""
        return self.measure(q) <= CLOSED

    # --- velocities and accelerations ---

    def complete_velocities(self, q: Array, yd: Array) -> Array:
        """Return qd from the independent velocities (B, f)."""
        return self._complete(self.jacobian(q), yd, np.zeros((len(q), len(self.dependent))))

    def complete_accelerations(self, q: Array, qd: Array, ydd: Array) -> Array:
        """Return qdd from the independent accelerations (B, f)."""
        return self._complete(self.jacobian(q), ydd, self.bias(q, qd))

    def _complete(self, J: Array, y: Array, bias: Array) -> Array:
        """Solve J x + bias = 0 for the dependent entries of x."""
        x = np.empty((len(J), J.shape[2]))
        x[:, self.independent] = y
        right = -(J[:, :, self.independent] @ y[:, :, None]) - bias[:, :, None]
        x[:, self.dependent] = (np.linalg.pinv(J[:, :, self.dependent]) @ right)[:, :, 0]
        return x

    def project(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return the nearest states that keep the loops closed, for states that nearly do."""
        for _ in range(2):
            J = self.jacobian(q)
            q = q - (np.linalg.pinv(J) @ self.gaps(q)[:, :, None])[:, :, 0]
        return q, self.project_velocities(q, qd)

    def project_velocities(self, q: Array, qd: Array) -> Array:
        """Return the nearest velocities that keep the loops closed."""
        J = self.jacobian(q)
        return np.asarray(qd - (np.linalg.pinv(J) @ (J @ qd[:, :, None]))[:, :, 0])

    def project_accelerations(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the nearest accelerations that keep the loops closed."""
        J = self.jacobian(q)
        opening = J @ qdd[:, :, None] + self.bias(q, qd)[:, :, None]
        return np.asarray(qdd - (np.linalg.pinv(J) @ opening)[:, :, 0])

    # --- independent coordinates ---

    def is_regular(self, q: Array) -> bool:
        """Return whether the independent coordinates determine the others along a path (K, n), by one branch."""
        J = self.jacobian(q)
        block = J[:, :, self.dependent]
        if not np.isfinite(J).all():
            return False
        least, most = (np.linalg.svd(x, compute_uv=False) for x in (block, J))
        signs = np.sign(np.linalg.det(block))
        return bool((least[:, -1] >= REGULAR * most[:, 0]).all() and (signs == signs[0]).all())

    def choose(self, q: Array, candidates: Sequence[int]) -> list[int]:
        """Choose the first candidates that can have any value near a pose (n,), whatever the chosen before have."""
        basis = np.linalg.svd(self.jacobian(q[None])[0], full_matrices=False)[2]
        chosen = []
        for i in candidates:
            left = np.eye(q.size)[i]
            for _ in range(2):  # twice is enough: the second time removes the rounding of the first
                left = left - basis.T @ (basis @ left)
            length = float(np.linalg.norm(left))
            if length > INDEPENDENT:
                chosen.append(i)
                basis = np.concatenate((basis, left[None] / length))
        return chosen


def find_closure(plant: Plant) -> Closure | None:
    """Return the loops of a mechanism; None where it has none."""
    return Closure(plant) if has_loops(plant.manifest) else None


def has_loops(manifest: Manifest) -> bool:
    """Return whether a mechanism has closed loops or constraints."""
    return bool(manifest.dependent)
