"""The structure of an identification: which combinations of the unknown numbers forces depend on at all.

The columns of the equations are written at random states that loops admit. A column that depends linearly on columns
before it, within rounding, adds to their numbers (M. Gautier, "Numerical calculation of the base inertial parameters of
robots", J. Robotic Systems 8, 1991):

    A x = sum over kept b of A_b beta_b,    beta_b = x_b + sum over others d of c_bd x_d

The kept numbers with their sums are the base parameters; they alone can be determined from any motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import Closure
from mbsrun.identification.equations import Samples, Setting, write_rows
from mbsrun.identification.settings import FALL, IdentificationError
from mbsrun.identification.unknowns import Unknown
from mbsrun.quaternions import normalise

Array = NDArray[np.float64]

RANK = 1e-8  # of a column's length: less is rounding
ROUNDED = 1e-9  # of a coefficient: smaller ones are rounding
STATES = 40  # at least; three times as many rows as columns
SPEED, ACCELERATION = 3.0, 10.0  # of random states
REACH = 2.0  # of joints without limits [rad], a quarter of it in m
NEAR = 0.3  # the spread of closed poses [rad, m]


@dataclass(frozen=True, eq=False)
class Structure:
    """The base parameters of a mechanism."""

    unknowns: tuple[Unknown, ...]  # the linear ones
    kept: tuple[int, ...]  # of `unknowns`
    G: Array  # (kept, unknowns): beta = G x

    @property
    def unfelt(self) -> tuple[str, ...]:
        """Name the numbers that no force depends on."""
        return tuple(x.name for k, x in enumerate(self.unknowns) if not self.G[:, k].any())

    @property
    def names(self) -> tuple[str, ...]:
        """Name the base parameters by the numbers that they are sums of."""
        return tuple(self.describe(b) for b in range(len(self.kept)))

    def describe(self, b: int) -> str:
        """Write a base parameter as a sum, its own number first."""
        own = self.kept[b]
        text = self.unknowns[own].name
        for k in np.flatnonzero(self.G[b]).tolist():
            if k != own:
                c = self.G[b, k]
                size = "" if abs(abs(c) - 1) < ROUNDED else f"{abs(c):.6g} "
                text += f" {'-' if c < 0 else '+'} {size}{self.unknowns[k].name}"
        return text

    def evaluate(self, values: Array) -> Array:
        """Return the base parameters of numbers (unknowns,)."""
        return np.asarray(self.G @ values)


def find_structure(setting: Setting, unknowns: Sequence[Unknown], seed: int = 0) -> Structure:
    """Find the base parameters. Raises IdentificationError where no force depends on any unknown number."""
    linear = tuple(x for x in unknowns if x.is_linear)
    if not linear:
        return Structure((), (), np.zeros((0, 0)))
    states = draw_states(setting, max(STATES, 3 * len(linear) // max(1, len(setting.rows)) + 1), seed)
    A, _ = write_rows(setting, states, linear, np.full(len(setting.manifest.coordinates), FALL))
    rows = A.reshape(-1, len(linear))
    rows = rows[np.isfinite(rows).all(axis=1)]
    lengths = np.linalg.norm(rows, axis=0)
    largest = lengths.max(initial=0.0)
    kept = select_columns(rows / np.where(lengths > RANK * largest, lengths, np.inf))
    if not kept:
        determined = ", ".join(x.name for x in linear[:6])
        raise IdentificationError(f"no force depends on {determined}; choose other unknown numbers")
    found = np.linalg.lstsq(rows[:, kept] / lengths[kept], rows, rcond=None)[0] / lengths[kept, None]
    found[:, lengths <= RANK * largest] = 0.0
    found[np.abs(found) * lengths[kept, None] < ROUNDED * np.maximum(lengths, ROUNDED * largest)] = 0.0
    found[:, kept] = np.eye(len(kept))
    return Structure(linear, tuple(kept), _tidy(found))


def _tidy(G: Array) -> Array:
    """Round the coefficients to the digits that they have."""
    return np.array([[float(f"{x:.10g}") for x in row] for row in G.tolist()]).reshape(G.shape)


def select_columns(A: Array, tolerance: float = RANK) -> list[int]:
    """List the columns, of length 1 or 0, that do not depend on the ones before them: Gram and Schmidt, twice."""
    if not A.size:
        return []
    R: Array = np.asarray(np.linalg.qr(A, mode="r")) if len(A) > A.shape[1] else A
    Q, kept = np.zeros((R.shape[0], 0)), []
    for k in range(R.shape[1]):
        r = R[:, k]
        for _ in range(2):
            r = r - Q @ (Q.T @ r)
        if (length := float(np.linalg.norm(r))) > tolerance:
            kept.append(k)
            Q = np.column_stack((Q, r / length))
    return kept


def draw_states(setting: Setting, count: int, seed: int) -> Samples:
    """Draw states within the limits of joints, at which loops are closed."""
    manifest, rng = setting.manifest, np.random.default_rng(seed)
    n, m = len(manifest.coordinates), len(manifest.actuated)
    qd, qdd = SPEED * rng.uniform(-1, 1, (count, n)), ACCELERATION * rng.uniform(-1, 1, (count, n))
    w = rng.uniform(-1, 1, (count, manifest.open_entries))
    zero = np.zeros((count, m))
    if not manifest.loops:
        low, high = list_ranges(setting)
        q = normalise(rng.uniform(low, high, (count, len(low))), manifest)
        return Samples(np.arange(count, dtype=float), q, qd, qdd, "", w, zero, rng.uniform(-1, 1, (count, m)))
    closure, pose = Closure(setting.kernels), np.array(manifest.pose)
    poses = closure.close(pose + NEAR * rng.uniform(-1, 1, (4 * count, len(pose))))
    q = poses[[closure.is_closed(x) for x in poses]][:count]
    if not len(q):
        raise IdentificationError(f"no closed pose of {manifest.model} was found near its own; check its loops")
    qd = closure.project_velocities(q, qd[: len(q)])
    qdd = closure.project_accelerations(q, qd, qdd[: len(q)])
    t = np.arange(len(q), dtype=float)
    return Samples(t, q, qd, qdd, "", w[: len(q)], zero[: len(q)], rng.uniform(-1, 1, (len(q), m)))


def list_ranges(setting: Setting) -> tuple[Array, Array]:
    """Return the lowest and the highest entries of q: of joints without limits, some reach."""
    manifest = setting.manifest
    joints = {c.name: c for c in manifest.coordinates}
    low, high = [], []
    for name in manifest.positions:
        joint = joints.get(name)
        reach = REACH if joint is None or joint.unit == "rad" else REACH / 4
        a = -reach if joint is None or joint.lower is None else max(joint.lower, -10 * reach)
        b = reach if joint is None or joint.upper is None else min(joint.upper, 10 * reach)
        low.append(min(a, b - reach) if joint is None or joint.lower is None else a)
        high.append(max(b, a + reach) if joint is None or joint.upper is None else b)
    return np.array(low), np.array(high)
