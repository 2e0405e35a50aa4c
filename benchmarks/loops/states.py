"""Random states of a mechanism with closed loops, found with its own kernels of h, J and the derivatives of J qd.

q is drawn around the pose at which the loops were assembled, and put on h(q) = 0 by Newton steps of least norm, qd on
J qd = 0 by the same. Accelerations are functions of q and qd also where loops are open, and there they depend on how a
program writes its equations; so Jacobians are compared along the directions in which loops stay closed,

    J dq = 0,    J dqd + d(J qd)/dq dq = 0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun import Mechanism

Array = NDArray[np.float64]

SPREAD = 0.5  # rad or m: of q around the pose
CONDITION = 1e4  # of J, more than which a state counts as singular


@dataclass(frozen=True)
class Directions:
    """Directions in which loops stay closed to first order, columns: of q and qd together."""

    q: Array
    qd: Array


def draw_states(kernels: Mechanism, states: int, seed: int = 1) -> dict[str, Array]:
    """Draw states with closed loops: an array (states, size) for each input by name. Raises ArithmeticError."""
    rng, manifest = np.random.default_rng(seed), kernels.manifest
    pose, inputs = np.array(manifest.pose), _count_inputs(kernels)
    found: list[tuple[Array, Array]] = []
    for _ in range(50 * states):
        q = close(kernels, pose + rng.uniform(-SPREAD, SPREAD, len(pose)), pose)
        if q is None:
            continue
        J = read_jacobian(kernels, q)
        qd = rng.uniform(-3, 3, J.shape[1])
        found.append((q, np.asarray(qd - np.linalg.lstsq(J, J @ qd, rcond=None)[0])))
        if len(found) == states:
            return {
                "q": np.array([pair[0] for pair in found]),
                "qd": np.array([pair[1] for pair in found]),
                "u": rng.uniform(-5, 5, (states, inputs)),
            }
    raise ArithmeticError(f"{manifest.model}: no {states} states with closed loops were found")


def _count_inputs(kernels: Mechanism) -> int:
    found = [x.rows for x in kernels.manifest.kernel("exp1").inputs if x.name == "u"]
    return found[0] if found else 0


def close(kernels: Mechanism, q: Array, pose: Array) -> Array | None:
    """Close the loops near q; None where Newton's method fails, or the state is far away or singular."""
    start = q
    for _ in range(30):
        h = np.asarray(kernels("loops", q=q)["gap"]).ravel()
        if not np.isfinite(h).all():
            return None
        step = np.linalg.lstsq(read_jacobian(kernels, q), h, rcond=None)[0]
        q = q - step
        if np.abs(step).max() < 1e-14:
            break
    else:
        return None
    far = np.abs(q - start).max() > 2 * SPREAD or np.abs(q - pose).max() > 3 * SPREAD
    return None if far or np.linalg.cond(read_jacobian(kernels, q)) > CONDITION else q


def read_jacobian(kernels: Mechanism, q: Array) -> Array:
    """Return J."""
    zeros = np.zeros(len(kernels.manifest.coordinates))
    return np.asarray(kernels("loop_jacobian", q=q, qd=zeros)["J"])


def find_directions(kernels: Mechanism, q: Array, qd: Array) -> Directions:
    """Return a basis of the directions of (q, qd) in which the loops stay closed."""
    J = read_jacobian(kernels, q)
    _, sizes, rows = np.linalg.svd(J)
    kernel = rows[int((sizes > 1e-10 * sizes[0]).sum()) :].T
    slope = np.asarray(kernels("jac_loop_rates", q=q, qd=qd)["jac_hd_q"])
    bent = -np.linalg.lstsq(J, slope @ kernel, rcond=None)[0]
    blank = np.zeros_like(kernel)
    return Directions(np.hstack([kernel, blank]), np.hstack([bent, kernel]))


def project(blocks: Mapping[str, Array], ways: Directions) -> Array:
    """Return a Jacobian of accelerations along directions."""
    return blocks["jac_qdd_q"] @ ways.q + blocks["jac_qdd_qd"] @ ways.qd
