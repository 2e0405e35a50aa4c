"""Small motions about a steady motion of a mechanism that rolls: rigid contacts neither slip nor leave.

The velocities at the points of contact vanish: J(q) qd = 0, the rows of `slide` in `touching`. Only the distances
among them could be integrated; the others are constraints of velocities alone. Along a steady motion, velocities v0 and
forces lam of the contacts are constant, and small changes x of q, with velocities v, obey

    J v + B x = 0,    B = d(J v0)/dq,    so that    v = Z s - J^+ B x,    J Z = 0
    ZT (M v' + C v + (K - d(J^T lam)/dq) x) = 0,    x' = v

which is a system z' = A z of z = (x, s). Poles at 0 belong to coordinates that nothing depends on, as places along a
plane. Rounding makes several of them small numbers.

Meijaard, Papadopoulos, Ruina, Schwab, "Linearized dynamics equations for the balance and steer of a bicycle",
Proceedings of the Royal Society A 463 (2007), has such a system, with published poles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from mbsrun.kernel import ArgumentError, Kernels
from mbsrun.linearisation.equations import BALANCED, BalanceError

Array = NDArray[np.float64]

INSIDE = 1e-9  # m: a point that is as near to the other side touches it


@dataclass(frozen=True, eq=False)
class Rolling:
    """Linear equations about a steady motion of n coordinates with e constraints of velocities, of rank r."""

    q: Array  # (n,)
    qd: Array  # (n,)
    multipliers: Array  # (e,): forces of contacts along the axes of the base [N], three for each point
    Z: Array  # (n, n - r): the velocities that contacts admit
    A: Array  # (2 n - r, 2 n - r): of the changes of q, then of the coordinates of velocities in Z

    @cached_property
    def poles(self) -> NDArray[np.complex128]:
        """The poles [1/s], from the smallest to the largest."""
        found = np.linalg.eigvals(self.A)
        return np.asarray(found[np.lexsort((found.imag, np.abs(found)))])


def roll(kernels: Kernels, q: ArrayLike, qd: ArrayLike, u: ArrayLike = ()) -> Rolling:
    """Linearise about a steady motion from q, qd (n,) under inputs u, in which all rigid contacts roll.

    Raises ArgumentError for models without rigid contacts, with loops, driven joints or quaternions, and for kernels
    that were not generated; BalanceError where a contact is open or slips, or where the motion is not steady.
    """
    manifest, n = kernels.manifest, len(kernels.manifest.coordinates)
    if not manifest.rigid or manifest.configuration or manifest.loops or manifest.driven or manifest.open_entries:
        needs = "it needs rigid contacts, without quaternions, loops, driven joints and inputs w"
        raise ArgumentError(f"{manifest.model} does not roll: {needs}")
    q, qd, u = (np.asarray(x, dtype=np.float64) for x in (q, qd, u))
    if (q.shape, qd.shape, u.shape) != ((n,), (n,), (len(manifest.actuated),)):
        raise ArgumentError(f"q and qd must be {n} numbers, u {len(manifest.actuated)}")
    touching, slopes = kernels("touching", q=q), kernels("jac_touching", q=q)
    J = touching["slide"]
    by_q = slopes["jac_slide_q"].reshape(n, len(J), n).transpose(1, 0, 2)  # rows, velocities, coordinates
    _demand_rolling(kernels, touching["clearance"].ravel(), J, qd)
    parts: dict[str, Any] = {"q": q, "qd": qd, "qdd": np.zeros(n), **({"u": u} if u.size else {})}
    blocks = kernels("lin_impl", **parts)
    K, C, M = (blocks.get(f"jac_Phi_{x}", np.zeros((n, n))) for x in ("q", "qd", "qdd"))
    lam = _hold(J, blocks["Phi"].ravel())
    K = K - np.einsum("eij,e->ij", by_q, lam)
    Z, back = linalg.null_space(J), np.linalg.pinv(J) @ np.einsum("eij,i->ej", by_q, qd)
    rates = np.hstack((-back, Z))  # qd by (x, s)
    force = C @ rates + np.hstack((K, np.zeros((n, Z.shape[1]))))
    drift = np.hstack((back @ rates[:, :n], back @ rates[:, n:]))  # less the part of qdd without s'
    lower = -np.linalg.solve(Z.T @ M @ Z, Z.T @ (force - M @ drift))
    return Rolling(q, qd, lam, Z, np.vstack((rates, lower)))


def _demand_rolling(kernels: Kernels, clearance: Array, J: Array, qd: Array) -> None:
    slip = (J @ qd).reshape(-1, 3)
    for k, point in enumerate(kernels.manifest.rigid):
        if abs(clearance[k]) > INSIDE:
            raise BalanceError(f"contact {point.name} is {clearance[k]:.3g} m from the other side; let it touch")
        if np.abs(slip[k]).max() > BALANCED * max(1.0, float(np.abs(qd).max())):
            raise BalanceError(
                f"contact {point.name} slips with {np.abs(slip[k]).max():.3g} m/s; give velocities that roll"
            )


def _hold(J: Array, Phi: Array) -> Array:
    """Return the forces of the contacts that keep the motion steady, (e,)."""
    lam, *_ = np.linalg.lstsq(J.T, Phi, rcond=None)
    left = np.abs(Phi - J.T @ lam)
    if left.max() > BALANCED * max(1.0, float(np.abs(Phi).max())):
        raise BalanceError(
            f"the motion is not steady: a force of {left.max():.3g} is left in coordinate {left.argmax() + 1}; "
            "give other velocities or inputs"
        )
    return np.asarray(lam)
