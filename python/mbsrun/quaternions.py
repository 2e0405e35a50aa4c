"""Coordinates whose rates are not velocities: quaternions, outside the kernels.

A quaternion (v, s) is four entries of q, its scalar last; its joint's angular velocity w is three entries of qd, along
the body's own axes. With Hamilton's product *,

    q' = q * (w, 0) / 2;

the kernel `rates` computes this for all coordinates of a model. The rotation is by q/|q|, so q, -q and any
multiple are one attitude. In a model without quaternions, rates are velocities, and these functions change nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quaternion:
    """Where one is found."""

    joint: str
    first: int  # of its four entries in q
    spin: int  # first of the three of its angular velocity in qd

    @property
    def entries(self) -> list[int]:
        """List its entries of q."""
        return [self.first + k for k in range(4)]

    @property
    def spins(self) -> list[int]:
        """List its entries of qd: the angular velocity."""
        return [self.spin + k for k in range(3)]


def list_quaternions(manifest: Manifest) -> tuple[Quaternion, ...]:
    """List a model's quaternions; each has one entry more in q than in qd."""
    names = manifest.positions
    return tuple(Quaternion(names[k].removesuffix(".qx"), k, k - i) for i, k in enumerate(manifest.quaternions))


def find_quaternion(quaternions: Iterable[Quaternion], i: int) -> Quaternion | None:
    """Return the quaternion that entry i of q belongs to; None for a coordinate of another kind."""
    return next((x for x in quaternions if i in x.entries), None)


def list_places(manifest: Manifest) -> list[tuple[list[int], list[int]]]:
    """Pair the entries of q with the entries of qd that their rates read: one each, or the ones of a turn or a place.

    The velocity of a free body is along its own axes, so its three entries go together.
    """
    turns = {x.first: x for x in list_quaternions(manifest)}
    bodies = {
        x.first - 3 for x in turns.values() if f"{x.joint}.x" in manifest.positions[max(x.first - 3, 0) : x.first]
    }
    pairs, i, k = [], 0, 0
    while k < len(manifest.positions):
        places, speeds = (4, 3) if k in turns else (3, 3) if k in bodies else (1, 1)
        pairs.append(([*range(k, k + places)], [*range(i, i + speeds)]))
        k, i = k + places, i + speeds
    return pairs


def list_entries(manifest: Manifest, velocities: Collection[int]) -> list[int]:
    """List the entries of q whose rates read some entries of qd alone."""
    return [k for places, speeds in list_places(manifest) if set(speeds) <= set(velocities) for k in places]


def list_divided(manifest: Manifest, velocities: Collection[int]) -> list[int]:
    """List the entries of q whose rates read some of these entries of qd, and others too."""
    chosen = set(velocities)
    return [
        k for places, speeds in list_places(manifest) if 0 < len(chosen & set(speeds)) < len(speeds) for k in places
    ]


def neutral(manifest: Manifest) -> Array:
    """Return the coordinates (nq,) at which all joints are at 0, and quaternions are the identity."""
    q = np.zeros(len(manifest.positions))
    q[[x.first + 3 for x in list_quaternions(manifest)]] = 1.0
    return q


def normalise(q: Array, manifest: Manifest) -> Array:
    """Scale the quaternions of q (..., nq) to length 1; quaternions of length 0 stay."""
    q = q.copy()
    for x in list_quaternions(manifest):
        length = np.linalg.norm(q[..., x.entries], axis=-1, keepdims=True)
        q[..., x.entries] /= np.where(length == 0, 1.0, length)
    return q


def measure_lengths(q: Array, manifest: Manifest) -> Array:
    """Return the lengths of the quaternions of q (..., nq): (..., quaternions)."""
    lengths = [np.linalg.norm(q[..., x.entries], axis=-1) for x in list_quaternions(manifest)]
    return np.stack(lengths, axis=-1) if lengths else np.zeros((*q.shape[:-1], 0))


# --- rates and velocities ------------------------------------------------------------------------------------------


def find_rates(plant: Plant, q: Array, qd: Array) -> Array:
    """Return the time derivatives of q, one state or a batch: q (..., nq), qd (..., n)."""
    return plant("rates", q=q, qd=qd)["rate"] if plant.manifest.configuration else qd


def find_velocities(plant: Plant, q: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return qd and qdd (..., n) of a motion q (..., nq), from its first and second derivatives in time.

    Rates are E(q) qd, and the columns of E are independent.
    """
    if not plant.manifest.configuration:
        return first, second
    *times, nq = q.shape
    q, first, second = (x.reshape(-1, nq) for x in (q, first, second))
    still = np.zeros((len(q), len(plant.manifest.coordinates)))
    inverse = np.linalg.pinv(plant("jac_rates", q=q, qd=still)["jac_rate_qd"])
    qd = (inverse @ first[..., None])[..., 0]
    change = plant("jac_rates", q=q, qd=qd)["jac_rate_q"] @ first[..., None]
    qdd = (inverse @ (second[..., None] - change))[..., 0]
    return qd.reshape(*times, -1), qdd.reshape(*times, -1)


# --- a turn on its way ---------------------------------------------------------------------------------------------


def turn(start: Array, a: Array, w: Array, b: Array, r: Array) -> tuple[Array, Array, Array]:
    """Turn from `start` (4,) by the rotation vectors w a, then r b: q and its two derivatives in time, (..., 4) each.

    a, b (3,) are constant; w, r (3, ..., 1) are numbers over time, with their first and second derivatives.
    """
    (w, wd, wdd), (r, rd, rdd) = w, r
    second = _raise(r * b)
    back = second * [-1.0, -1.0, -1.0, 1.0]

    def seen(v: Array) -> Array:
        """Turn a vector into the axes of the body, which the second turn moves."""
        return multiply(multiply(back, _pure(v)), second)[..., :3]

    q = multiply(multiply(start, _raise(w * a)), second)
    carried = seen(wd * a)
    spin = carried + rd * b
    slope = seen(wdd * a) - np.cross(rd * b, carried) + rdd * b
    first = multiply(q, _pure(spin)) / 2
    return q, first, multiply(q, _pure(slope)) / 2 - (spin**2).sum(axis=-1, keepdims=True) * q / 4


def find_turn(start: Array, end: Array) -> Array:
    """Return the rotation vector, in the axes at `start`, of the shorter turn to `end`; both are (4,), of length 1."""
    between = multiply(start * [-1.0, -1.0, -1.0, 1.0], end)
    v, s = (between[:3], between[3]) if between[3] >= 0 else (-between[:3], -between[3])
    sine = float(np.linalg.norm(v))
    return v * (2 * np.arctan2(sine, s) / sine) if sine else np.zeros(3)


def _raise(vector: Array) -> Array:
    """Return the quaternions of rotation vectors (..., 3)."""
    half = np.linalg.norm(vector, axis=-1, keepdims=True) / 2
    return np.concatenate((np.sinc(half / np.pi) * vector / 2, np.cos(half)), axis=-1)


def find_quaternions(R: Array) -> Array:
    """Return the quaternions x, y, z, w of rotations (..., 3, 3), by their largest entry.

    The scalar w is not negative; where it is 0, the first of x, y, z that is not 0 is positive.
    """
    trace = np.trace(R, axis1=-2, axis2=-1)[..., None, None]
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    products = np.empty((*R.shape[:-2], 4, 4))  # 4 q q^T
    products[..., :3, :3] = R + R.swapaxes(-2, -1) + (1 - trace) * np.eye(3)
    products[..., :3, 3] = products[..., 3, :3] = skew
    products[..., 3, 3] = 1 + trace[..., 0, 0]
    largest = np.diagonal(products, axis1=-2, axis2=-1).argmax(axis=-1)[..., None, None]
    q = np.take_along_axis(products, largest, axis=-2)[..., 0, :]
    signed = np.roll(q, 1, axis=-1)
    first = np.take_along_axis(signed, (signed != 0).argmax(axis=-1)[..., None], axis=-1)
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True) * np.where(first < 0, -1.0, 1.0))


def _pure(vector: Array) -> Array:
    """Return the quaternions of scalar 0."""
    return np.concatenate((vector, np.zeros_like(vector[..., :1])), axis=-1)


def multiply(p: Array, q: Array) -> Array:
    """Multiply quaternions (..., 4)."""
    (a, s), (b, t) = (p[..., :3], p[..., 3:]), (q[..., :3], q[..., 3:])
    dot = (a * b).sum(axis=-1, keepdims=True)
    return np.concatenate((s * b + t * a + np.cross(a, b), s * t - dot), axis=-1)


def rotate(q: Array, v: Array) -> Array:
    """Turn vectors v (..., 3) by quaternions q (..., 4) of length 1."""
    return multiply(multiply(q, _pure(v)), q * [-1.0, -1.0, -1.0, 1.0])[..., :3]
