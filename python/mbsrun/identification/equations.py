"""The equations of an identification: motions with measured forces -> rows that are linear in the unknown numbers.

    Phi(q, qd, qdd) - S u = JT lam,    Phi = Phi_0 + Y (pi - pi_0) + damping qd + friction tanh(qd/v) + ...

Forces of loops, of driven joints and of joints without a measured torque are eliminated: rows are combinations W of the
equations with W JT = 0. Where as many torques are measured as there are freedoms, a row is the difference between a
computed torque and the measured one; of a tree, each joint has a row. Elsewhere, rows are the independent motions that
are left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsgen.roles import MOMENTS
from mbsrun.closure import Closure
from mbsrun.identification.settings import ARMATURE, DAMPING, FRICTION, INERTIA, MOTOR, OFFSET, STRIBECK
from mbsrun.identification.unknowns import Unknown
from mbsrun.kernel import Kernels

Array = NDArray[np.float64]

SINGULAR = 1e-6  # of singular values: poses at which torques do not determine the motion are left out


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """A motion at K times."""

    t: Array  # (K,) [s]
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    qdd: Array  # (K, n)


@dataclass(frozen=True, eq=False)
class Samples(SampledMotion):
    """A motion with measured torques."""

    name: str
    w: Array  # (K, ...)
    u: Array  # (K, m): torques, or 0 where currents are given
    i: Array  # (K, m): currents [A]; 0 where there are none
    left_out: int = 0  # samples of the recording that could not be used

    def take(self, kept: Any) -> Samples:
        """Return some of the times: a mask, or indices."""
        names = ("t", "q", "qd", "qdd", "w", "u", "i")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})


@dataclass(frozen=True)
class Setting:
    """The mechanism whose equations are written."""

    kernels: Kernels
    speeds: Array  # of dry friction, (n,)
    unmeasured: tuple[int, ...]  # entries of qd whose forces are not known

    @property
    def manifest(self) -> Manifest:
        """Return the description of the mechanism."""
        return self.kernels.manifest

    @property
    def is_free(self) -> bool:
        """Return whether every row is an equation of one joint."""
        return not self.manifest.loops

    @property
    def rows(self) -> tuple[str, ...]:
        """Name the rows of one time, by joints."""
        names = [c.name for c in self.manifest.coordinates]
        if self.is_free:
            return tuple(names[i] for i in self.open)
        measured = self.measured
        freedoms = set(self.manifest.independent)
        if len(measured) == len(freedoms) and not freedoms & {*self.unmeasured}:
            return tuple(names[i] for i in measured)
        return tuple(names[i] for i in self.open if i in freedoms)

    @property
    def open(self) -> tuple[int, ...]:
        """List the joints whose forces are all known."""
        hidden = {*self.unmeasured, *self.manifest.driven}
        return tuple(i for i in range(len(self.manifest.coordinates)) if i not in hidden)

    @property
    def measured(self) -> tuple[int, ...]:
        """List the joints with a measured torque."""
        return tuple(i for i in self.manifest.actuated if i not in self.unmeasured)


def write_rows(setting: Setting, samples: Samples, unknowns: Sequence[Unknown], falls: Array) -> tuple[Array, Array]:
    """Return A (K, rows, unknowns), with zeros for nonlinear ones, and b (K, rows): A (x - x_0) = b.

    `falls` are the speeds of the Stribeck effect of each joint, (n,). A time at which rows cannot be written is NaN.
    """
    manifest, K = setting.manifest, len(samples.t)
    n = len(manifest.coordinates)
    columns = np.zeros((K, n, len(unknowns)))
    inertial = [k for k, x in enumerate(unknowns) if x.kind == INERTIA]
    if inertial:
        Y, width = _write_regressor(setting.kernels, samples), len(MOMENTS)
        own = {k: np.array(unknowns[k].column) for k in inertial}
        plain = [k for k in inertial if own[k][unknowns[k].moment] == 1 and np.count_nonzero(own[k]) == 1]
        columns[:, :, plain] = Y[:, :, [width * unknowns[k].body + unknowns[k].moment for k in plain]]
        for k in (k for k in inertial if k not in plain):  # of bodies whose frame is not the joint's
            used = np.flatnonzero(own[k])
            columns[:, :, k] = Y[:, :, width * unknowns[k].body + used] @ own[k][used]
    places = {i: k for k, i in enumerate(manifest.actuated)}
    slopes = np.tanh(samples.qd / setting.speeds)
    for k, x in enumerate(unknowns):
        v = samples.qd[:, x.joint] if x.joint >= 0 else np.zeros(K)
        if x.kind == ARMATURE:
            columns[:, x.joint, k] = samples.qdd[:, x.joint]
        elif x.kind == DAMPING:
            columns[:, x.joint, k] = v
        elif x.kind == FRICTION:
            columns[:, x.joint, k] = slopes[:, x.joint]
        elif x.kind == STRIBECK:
            columns[:, x.joint, k] = slopes[:, x.joint] * np.exp(-((v / falls[x.joint]) ** 2))
        elif x.kind == OFFSET:
            columns[:, x.joint, k] = 1.0
        elif x.kind == MOTOR:
            columns[:, x.joint, k] = -samples.i[:, places[x.joint]]
    return _project(setting, samples, columns, -find_residual(setting.kernels, samples))


def find_residual(kernels: Kernels, samples: Samples) -> Array:
    """Return Phi - S u with the present numbers of the model, (K, n), without the forces of loops."""
    given = {"q": samples.q, "qd": samples.qd, "qdd": samples.qdd, "u": samples.u, "w": samples.w}
    inputs: dict[str, Any] = {}
    for argument in kernels.describe("impl").inputs:
        if argument.name in given:
            inputs[argument.name] = given[argument.name]
        elif argument.name in ("lam", "tau"):
            inputs[argument.name] = np.zeros(argument.rows)
    return np.asarray(kernels("impl", **inputs)["Phi"]).reshape(len(samples.t), -1)


def _write_regressor(kernels: Kernels, samples: Samples) -> Array:
    return np.asarray(kernels("regressor", q=samples.q, qd=samples.qd, qdd=samples.qdd)["Y"])


def _project(setting: Setting, samples: Samples, columns: Array, right: Array) -> tuple[Array, Array]:
    if setting.is_free:
        rows = list(setting.open)
        if rows == list(range(columns.shape[1])):
            return columns, right
        return columns[:, rows], right[:, rows]
    W = _find_combinations(setting, samples.q)
    return np.einsum("kfn,knp->kfp", W, columns), np.einsum("kfn,kn->kf", W, right)


def _find_combinations(setting: Setting, q: Array) -> Array:
    """Return W (K, rows, n): motions that loops and hidden joints admit, per unit of each row; NaN where singular."""
    manifest, n = setting.manifest, len(setting.manifest.coordinates)
    names, rows = [c.name for c in manifest.coordinates], setting.rows
    chosen = [names.index(name) for name in rows]
    J = Closure(setting.kernels).jacobian(q)
    held = np.eye(n)[[*manifest.driven, *setting.unmeasured]]
    W = np.full((len(q), len(rows), n), np.nan)
    for k, own in enumerate(J):
        all_rows = np.vstack((own, held, np.eye(n)[chosen]))
        values = np.linalg.svd(all_rows, compute_uv=False)
        if len(values) < n or values[-1] < SINGULAR * values[0]:
            continue
        right = np.zeros((len(all_rows), len(rows)))
        right[-len(rows) :] = np.eye(len(rows))
        W[k] = np.linalg.lstsq(all_rows, right, rcond=None)[0].T
    return W
