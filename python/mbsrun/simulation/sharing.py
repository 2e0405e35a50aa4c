"""Static optimisation along a recorded motion: at each time the least activations of muscles that its forces take.

A muscle with a rigid tendon pulls with T0 + a T1 at the activation a, so its generalised forces are linear in a. With
the rates of coordinates qd = Z x, where loops leave the rates x of the independent ones, the forces that are left are

    r = Z^T (Phi + L^T (T0 + T1 a)),    L = derivatives of lengths by coordinates

where Phi is the residual without muscles. The sum of all a^2 and (r/reserve)^2 is the least, within bounds of a: a
problem of least squares with one minimum. Forces r are the ones of reserve actuators, such as the residual ones of a
pelvis. OpenSim's tool of this name leaves T0 out, which is the force of passive fibres and damping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from mbsrun.closure import Closure
from mbsrun.external import Mechanism
from mbsrun.kernel import ArgumentError
from mbsrun.simulation.course import stand
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.muscles import list_muscles, measure_pull
from mbsrun.simulation.recorded import Retraced

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shares:
    """The activations along a motion, and what is left for reserves."""

    t: Array  # (K,)
    activations: Array  # (K, m)
    tensions: Array  # (K, m)
    reserves: Array  # (K, d): generalised forces on independent coordinates
    coordinates: tuple[str, ...]  # these
    unsolved: int  # times at which the search did not end


def share(
    kernels: Mechanism, motion: Retraced, *, reserve: float, bounds: tuple[float, float], is_passive: bool
) -> Shares:
    """Find the least activations along a motion, within bounds; `reserve` [N m, N] costs as much as an activation of 1.

    With `is_passive`, fibres that are not active pull too. Raises ArgumentError for muscles that have no such problem.
    """
    manifest = kernels.manifest
    muscles = list_muscles(manifest)
    if muscles.elastic:
        remedy = "import the file with --rigid-tendons, or leave elastic out"
        raise ArgumentError(f"the force in the elastic tendon of {muscles.elastic[0]} is not given; {remedy}")
    pull = measure_pull(kernels, muscles, motion.q, motion.qd, motion.w)
    free = list(manifest.independent) if manifest.loops else list(range(motion.qd.shape[1]))
    Z = _list_motions(kernels, motion.q, free)
    dynamics = Dynamics(kernels, Formulation.IMPL, stand(np.zeros(len(manifest.driven))))
    v = np.concatenate((np.zeros((len(motion.t), dynamics.forces_count)), motion.w), axis=1)
    lam = np.zeros((len(motion.t), len(manifest.equations)))
    Phi = dynamics.residual(motion.q, motion.qd, motion.qdd, v, lam)
    if not is_passive:
        Phi = Phi - np.einsum("kmn,km->kn", pull.slopes, pull.passive)
    rest = np.einsum("knd,kn->kd", Z, Phi)
    gains = np.einsum("knd,kmn,km->kdm", Z, pull.slopes, pull.active)
    activations, reserves, unsolved = [], [], 0
    for b, B in zip(rest, gains, strict=True):
        rows = np.vstack((np.eye(B.shape[1]), B / reserve))
        found = lsq_linear(rows, np.concatenate((np.zeros(B.shape[1]), -b / reserve)), bounds, "bvls", tol=1e-14)
        unsolved += not found.success
        activations.append(found.x)
        reserves.append(b + B @ found.x)
    a = np.array(activations)
    tensions = a * pull.active + (pull.passive if is_passive else 0.0)
    names = tuple(manifest.coordinates[i].name for i in free)
    return Shares(motion.t, a, tensions, np.array(reserves), names, unsolved)


def _list_motions(kernels: Mechanism, q: Array, free: list[int]) -> Array:
    """Return the velocities of all coordinates by the ones of independent coordinates, (K, n, d)."""
    if not kernels.manifest.loops:
        return np.broadcast_to(np.eye(len(free)), (len(q), len(free), len(free)))
    J = Closure(kernels).jacobian(q)
    bound = [i for i in range(J.shape[2]) if i not in free]
    Z = np.zeros((len(q), J.shape[2], len(free)))
    Z[:, free] = np.eye(len(free))
    for k, rows in enumerate(J):
        Z[k][bound] = -np.linalg.lstsq(rows[:, bound], rows[:, free], rcond=None)[0]
    return Z
