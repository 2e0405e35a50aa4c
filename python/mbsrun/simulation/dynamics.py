"""The equations of motion in a formulation: accelerations, residuals, and the Jacobians of both.

    impl    Phi(q, qd, qdd) - Q = 0, accelerations from M = d Phi / d qdd
    semi    M(q) qdd + c(q, qd) - Q = 0, accelerations by Cholesky's decomposition of M
    exp1, exp2    qdd directly; the residual is qdd - qdd(q, qd, Q)

All take one state or a batch: q, qd, qdd (..., n) and the inputs v (..., m), u and then w. With quaternions there are
more coordinates q than velocities qd, whose rates are N(q) qd.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import Argument, Kernel
from mbsgen.roles import Order, Role, name_derivative, name_kernel
from mbsrun.kernel import KernelError, Kernels
from mbsrun.simulation.course import Course, stand
from mbsrun.simulation.formulation import Evaluated, Formulation
from mbsrun.simulation.memory import Source
from mbsrun.simulation.motion import Effort

Array = NDArray[np.float64]

LOST = 1e3  # a pivot below n LOST epsilon of its diagonal entry has lost its digits


class SingularError(MbsError):
    """A mass matrix that cannot be solved with, and the joint where that shows."""

    def __init__(self, joint: str) -> None:
        self.joint = joint
        super().__init__(f"the mass matrix is singular at joint {joint}")


@dataclass(frozen=True)
class Equations:
    """A model's equations of motion in one formulation, as loops in C take them."""

    kernels: Source
    formulation: Formulation
    course: Course = field(default_factory=lambda: stand(()))  # the motion of driven joints
    effort: Effort = field(default_factory=Effort)
    kept: dict[str, Any] = field(default_factory=dict)  # objects that an integrator makes once, and uses again

    @cached_property
    def size(self) -> int:
        """Count the velocities."""
        return len(self.kernels.manifest.coordinates)

    @cached_property
    def places(self) -> int:
        """Count the coordinates."""
        return len(self.kernels.manifest.positions)

    @cached_property
    def forces_count(self) -> int:
        """Count the entries of u; the entries of w follow them."""
        return len(self.kernels.manifest.actuated)


@dataclass(frozen=True)
class Dynamics(Equations):
    """The same, to be evaluated; it counts its calls."""

    kernels: Kernels
    _taken: dict[str, frozenset[str]] = field(default_factory=dict)  # by kernel: the inputs that it takes

    def rates(self, q: Array, qd: Array) -> Array:
        """Compute the time derivatives of q, in its shape."""
        if not self.kernels.manifest.configuration:
            return qd
        return self.kernels("rates", q=q, qd=qd)["rate"]

    def rate_slopes(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Differentiate the rates of q by q and by qd."""
        if not self.kernels.manifest.configuration:
            zero = np.zeros((*q.shape, self.size))
            return zero, np.broadcast_to(np.eye(self.size), zero.shape)
        blocks = self.kernels("jac_rates", q=q, qd=qd)
        return blocks["jac_rate_q"], blocks["jac_rate_qd"]

    def accelerations(self, q: Array, qd: Array, v: Array) -> Array:
        """Solve for qdd, shape (..., n). Raises KernelError and SingularError."""
        self.effort.evaluations += _states(q)
        if self._evaluated.mass is None:
            return self.call(self._evaluated.function, q, qd, v)["qdd"]
        rest = np.zeros_like(qd)
        M = self.call(self._evaluated.mass, q, qd, v, rest)[self._mass_result]
        return -self.solve(M, self.call(self._evaluated.function, q, qd, v, rest)["Phi"])

    def mass_matrix(self, q: Array, qd: Array, v: Array) -> Array:
        """Compute the mass matrix, (..., n, n), in a formulation that has one."""
        assert self._evaluated.mass is not None, "a formulation of accelerations has no mass matrix"
        return self.call(self._evaluated.mass, q, qd, v, np.zeros_like(qd))[self._mass_result]

    def slopes(self, q: Array, qd: Array, v: Array) -> tuple[Array, Array]:
        """Differentiate the accelerations by q and by qd, a row for each."""
        self.effort.jacobians += _states(q)
        name = name_kernel(self._evaluated.function, Order.JACOBIAN)
        if self._evaluated.is_direct:
            by_q, by_qd = self._pick(name, "qdd", ("q", "qd"), q, qd, v)
            return by_q, by_qd
        K, C, M = self._pick(name, "Phi", ("q", "qd", "qdd"), q, qd, v, self.accelerations(q, qd, v))
        return -np.asarray(np.linalg.solve(M, K)), -np.asarray(np.linalg.solve(M, C))

    def residual(self, q: Array, qd: Array, qdd: Array, v: Array, lam: Array | None = None) -> Array:
        """Evaluate the residual, shape (..., n), with the multipliers of loops."""
        self.effort.evaluations += _states(q)
        name = self._evaluated.function
        if self._evaluated.is_direct:
            return qdd - self.call(name, q, qd, v)["qdd"]
        return self.call(name, q, qd, v, qdd, lam)["Phi"]

    def stiffnesses(
        self, q: Array, qd: Array, qdd: Array, v: Array, lam: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Differentiate the residual by q, qd and qdd, shapes (..., n, nq), (..., n, n) twice."""
        self.effort.jacobians += _states(q)
        name = name_kernel(self._evaluated.function, Order.JACOBIAN)
        if self._evaluated.is_direct:
            K, C = self._pick(name, "qdd", ("q", "qd"), q, qd, v)
            return -K, -C, np.broadcast_to(np.eye(self.size), C.shape)
        K, C, M = self._pick(name, "Phi", ("q", "qd", "qdd"), q, qd, v, qdd, lam)
        return K, C, M

    def linearise(self, q: Array, qd: Array, qdd: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Evaluate the residual without the forces of loops, and differentiate it by q, qd and qdd, as above."""
        self.effort.evaluations += _states(q)
        self.effort.jacobians += _states(q)
        name = name_kernel(self._evaluated.function, Order.LINEARISATION)
        count = len(self.kernels.manifest.owners)
        lam = np.zeros((*q.shape[:-1], count)) if count else None
        blocks = self.call(name, q, qd, v, qdd, lam)
        K, C, M = self._take(blocks, "Phi", ("q", "qd", "qdd"), q)
        return blocks["Phi"], K, C, M

    def input_slopes(self, q: Array, qd: Array, qdd: Array, v: Array, lam: Array | None = None) -> Array:
        """Differentiate the residual by the inputs, in which it is linear: states (K, ...) -> (K, n, m)."""
        K, m = v.shape
        a, b, c = (np.repeat(x, m + 1, axis=0) for x in (q, qd, qdd))
        inputs = v[:, None] + np.eye(m + 1, m, k=-1)  # as they are; then with each larger by 1
        lam = None if lam is None else np.repeat(lam, m + 1, axis=0)
        residuals = self.residual(a, b, c, inputs.reshape(-1, m), lam).reshape(K, m + 1, -1)
        return np.asarray((residuals[:, 1:] - residuals[:, :1]).transpose(0, 2, 1))

    def call(
        self,
        name: str,
        q: Array,
        qd: Array,
        v: Array,
        qdd: Array | None = None,
        lam: Array | None = None,
    ) -> Mapping[str, Array]:
        """Call a kernel with the inputs that it takes."""
        forces = self.forces_count
        given = {"q": q, "qd": qd, "u": v[..., :forces], "w": v[..., forces:], "qdd": qdd, "lam": lam}
        given["tau"] = np.zeros(len(self.kernels.manifest.driven))
        taken = self._taken.get(name)
        if taken is None:
            inputs = self.kernels.describe(name).inputs
            taken = self._taken[name] = frozenset(a.name for a in inputs if a.nnz)
        wanted: dict[str, Any] = {key: x for key, x in given.items() if key in taken and x is not None}
        return self.kernels(name, **wanted)

    def forces(self, t: Array, q: Array, qd: Array, v: Array) -> tuple[Array, Array]:
        """Return multipliers (K, e) and forces of driven joints (K, d) at times (K,); NaN where they fail."""
        results, nothing = self.solve_all(t, q, qd, v), np.zeros((len(t), 0))
        return results.get("lam", nothing), results.get("tau", nothing)

    def find_accelerations(self, t: Array, q: Array, qd: Array, v: Array) -> Array:
        """Return the accelerations (K, n) at times (K,), not counted as effort; NaN where they fail."""
        if any(self.kernels.manifest.find(x.value) for x in (Formulation.EXP1, Formulation.EXP2)):
            return self.solve_all(t, q, qd, v)["qdd"]
        try:
            return replace(self, effort=Effort()).accelerations(q, qd, v)
        except (KernelError, SingularError):
            return np.full(qd.shape, np.nan)

    def solve_all(self, t: Array, q: Array, qd: Array, v: Array) -> dict[str, Array]:
        """Return accelerations, with multipliers and forces of driven joints, at times (K,); NaN where they fail."""
        manifest = self.kernels.manifest
        name = next(x for x in (Formulation.EXP1.value, Formulation.EXP2.value) if manifest.find(x) is not None)
        given: dict[str, Any] = {"q": q, "qd": qd, "u": v[:, : self.forces_count], "w": v[:, self.forces_count :]}
        given["a"] = self.course.states(t)[2]
        taken = [a.name for a in manifest.kernel(name).inputs if a.nnz]
        results, _ = self.kernels.attempt(name, **{key: x for key, x in given.items() if key in taken})
        return results

    @property
    def _evaluated(self) -> Evaluated:
        return self.formulation.evaluated

    @cached_property
    def _mass_result(self) -> str:
        """Name the mass matrix among the results of its kernel."""
        assert self._evaluated.mass is not None, "a formulation of accelerations has no mass matrix"
        kernel = self.kernels.describe(self._evaluated.mass)
        return find_mass_matrix(kernel).name

    def _pick(
        self,
        name: str,
        result: str,
        by: tuple[str, ...],
        q: Array,
        qd: Array,
        v: Array,
        qdd: Array | None = None,
        lam: Array | None = None,
    ) -> tuple[Array, ...]:
        """Call a Jacobian kernel; blocks without an entry are 0."""
        return self._take(self.call(name, q, qd, v, qdd, lam), result, by, q)

    def _take(self, blocks: Mapping[str, Array], result: str, by: tuple[str, ...], q: Array) -> tuple[Array, ...]:
        shapes = ((*q.shape[:-1], self.size, self.places if x == "q" else self.size) for x in by)
        names = (name_derivative(result, x) for x in by)
        return tuple(blocks.get(name, np.zeros(shape)) for name, shape in zip(names, shapes, strict=True))

    def solve(self, M: Array, right: Array) -> Array:
        """Solve M x = right, M (..., n, n). Raises SingularError."""
        self.factorise(M, np.arange(self.size))
        return np.asarray(np.linalg.solve(M, right[..., None])[..., 0])

    def factorise(self, M: Array, chosen: NDArray[np.intp]) -> Array:
        """Return the Cholesky factor of M (..., n, n) for the chosen joints, (..., f, f). Raises SingularError."""
        block = M[..., chosen[:, None], chosen]
        try:
            L = np.linalg.cholesky(block)
        except np.linalg.LinAlgError:
            raise SingularError(self.find_pivot(block, chosen)) from None
        pivots = np.diagonal(L, axis1=-2, axis2=-1) ** 2
        if (pivots <= self.size * LOST * np.finfo(float).eps * np.diagonal(block, axis1=-2, axis2=-1)).any():
            raise SingularError(self.find_pivot(block, chosen))
        return np.asarray(L)

    def find_pivot(self, M: Array, chosen: NDArray[np.intp] | None = None) -> str:
        """Name the joint whose pivot is lost first: the leading block up to it has no Cholesky factor, or a bad one."""
        numbers = [*range(self.size)] if chosen is None else [*map(int, chosen)]
        for matrix in M.reshape(-1, len(numbers), len(numbers)):
            for j, joint in enumerate(numbers):
                block = matrix[: j + 1, : j + 1]
                pivot = block[j, j] - block[j, :j] @ np.linalg.lstsq(block[:j, :j], block[:j, j], rcond=None)[0]
                if not pivot > self.size * LOST * np.finfo(float).eps * block[j, j]:
                    return self.kernels.manifest.coordinates[joint].name
        return self.kernels.manifest.coordinates[numbers[-1]].name


def find_mass_matrix(kernel: Kernel) -> Argument:
    """Find M among the results of a kernel: as such, or as the derivative of the residual by the accelerations."""
    accelerations = kernel.taking(Role.ACCELERATION)
    return next(
        result
        for result in kernel.outputs
        if result.role is Role.MASS_MATRIX or (accelerations is not None and result.by == accelerations.name)
    )


def _states(q: Array) -> int:
    return 1 if q.ndim == 1 else len(q)
