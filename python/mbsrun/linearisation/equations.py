"""Small motions about a pose at rest: equilibria, linear equations, modes, transfer functions, controllability.

With velocities qd = Z s along the motions Z that loops admit while driven joints stand still (1 without both),
coordinates q' = N qd, and a force on every joint Phi(q, qd, qdd) - S u - D tau - J^T lam = 0, small changes obey

    M s' + C s + K x = F u,    x' = s,    M = ZT Phi_qdd Z,   C = ZT Phi_qd Z,   K = ZT Phi_q N Z,   F = ZT S

with the multipliers lam of the pose, so K has the stiffness of loaded loops. As first-order equations

    d/dt (x, s) = A (x, s) + B u,    outputs = G (x, s),

which are the changes of x and the displacements of sensors. Where driven joints move by y, qd = Z s + W y', and

    M s' + C s + K x + Md y'' + Cd y' + Kd y = F u,    Md = ZT Phi_qdd W,   Cd = ZT Phi_qd W,   Kd = ZT Phi_q N W.

A pole is controllable where (A - pole, B) keeps full rank (Popov, Belevitch, Hautus), and observable where
(A - pole; G) does.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from mbsgen.errors import MbsError
from mbsrun.closure import CLOSED, RANK, Closure
from mbsrun.kernel import ArgumentError, Kernels
from mbsrun.quaternions import list_entries, neutral, normalise

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BALANCED = 1e-8  # the largest force that counts as none, relative to the largest of the joints, or absolute below 1
ITERATIONS = 100  # of Newton's method for an equilibrium
UNSUPPORTED = 0.1  # the part of the missing forces that no step balances, above which a pose has to yield to it
LONGEST = 0.3  # its step [rad, m]
ZERO = 1e-6  # of poles, relative to |A|: a double pole at 0 is found to the root of the rounding
ROUNDING = 1e-12  # of the real parts of poles, relative to |A|
LOST = 1e-9  # of singular values, relative to the largest: a mode below is out of reach


class BalanceError(MbsError):
    """A pose that is no equilibrium."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A pose at rest, with the forces that keep it."""

    q: Array  # (nq,)
    u: Array  # (m,)
    multipliers: Array  # (e,)
    tau: Array  # (d,): of the driven joints, which stand still


@dataclass(frozen=True)
class Mode:
    """A real pole, or a pair of poles."""

    pole: complex  # with an imaginary part of at least 0 [1/s]
    shape: Complex  # of x, (d,): largest entry 1
    controllable: float  # the least singular value of (A - pole, B), relative to |A| + |B|
    observable: float  # the same of (A - pole; G)

    @property
    def frequency(self) -> float:
        """Undamped frequency [Hz]."""
        return abs(self.pole) / (2 * np.pi)

    @property
    def damping(self) -> float:
        """Damping ratio: 1 and more where nothing swings, below 0 where it grows."""
        return (0.0 - self.pole.real) / abs(self.pole) if self.pole else 0.0  # never -0


@dataclass(frozen=True, eq=False)
class Excitation:
    """The part of the linear equations that reads the motion of driven joints, for e of them."""

    M: Array  # (d, e)
    C: Array
    K: Array
    G: Array  # (o, e): outputs that move with them by themselves


@dataclass(frozen=True, eq=False, repr=False)
class Linearisation:
    """Linear equations about an equilibrium, for d freedoms, m inputs, o outputs."""

    equilibrium: Equilibrium
    freedoms: tuple[str, ...]  # names of x
    inputs: tuple[str, ...]
    driven: tuple[str, ...]
    outputs: tuple[str, ...]
    M: Array  # (d, d)
    C: Array
    K: Array
    F: Array  # (d, m)
    G: Array  # (o, 2 d)
    excitation: Excitation

    def __repr__(self) -> str:
        """Return the names of freedoms, inputs and outputs."""
        parts = {"freedoms": self.freedoms, "inputs": self.inputs, "outputs": self.outputs}
        told = (f"{kind} {', '.join(names)}" for kind, names in parts.items() if names)
        return f"Linearisation({'; '.join(told)})"

    @cached_property
    def A(self) -> Array:
        """The system matrix, (2 d, 2 d), of (x, s)."""
        d = len(self.M)
        lower = -np.linalg.solve(self.M, np.hstack((self.K, self.C)))
        return np.vstack((np.hstack((np.zeros((d, d)), np.eye(d))), lower))

    @cached_property
    def B(self) -> Array:
        """The input matrix, (2 d, m)."""
        return np.vstack((np.zeros_like(self.F), np.linalg.solve(self.M, self.F)))

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Poles in order of their size; of a pair, the one with a positive imaginary part."""
        poles, shapes = np.linalg.eig(self.A)
        d, size = len(self.M), np.linalg.norm(self.A) + np.linalg.norm(self.B)
        length = np.linalg.norm(self.A)
        poles = np.where(np.abs(poles) < ZERO * length, 0.0, poles)
        poles = np.where(np.abs(poles.real) < ROUNDING * length, 1j * poles.imag, poles)
        found = []
        for pole, vector in zip(poles, shapes.T, strict=True):
            if pole.imag < 0:
                continue
            shape = vector[:d] / vector[:d][np.abs(vector[:d]).argmax()] if vector[:d].any() else vector[:d]
            rest = self.A - pole * np.eye(2 * d)
            reach = linalg.svdvals(np.hstack((rest, self.B)))[-1]
            sight = linalg.svdvals(np.vstack((rest, self.G)))[-1]
            whole = complex(pole.real + 0.0, pole.imag + 0.0)  # 0 instead of -0
            found.append(Mode(whole, shape, float(reach / size), float(sight / size)))
        return tuple(sorted(found, key=lambda mode: (abs(mode.pole), mode.pole.real)))

    @property
    def is_stable(self) -> bool:
        """Return whether all poles have a negative real part."""
        return all(mode.pole.real < 0 for mode in self.modes)

    def respond(self, frequencies: Array) -> Complex:
        """Return the transfer functions at frequencies [Hz]: (frequencies, outputs, inputs)."""
        identity = np.eye(len(self.A))
        return np.array([self.G @ np.linalg.solve(2j * np.pi * f * identity - self.A, self.B) for f in frequencies])

    def transmit(self, frequencies: Array) -> Complex:
        """Return the transfer functions from the motion of driven joints to outputs: (frequencies, outputs, driven)."""
        d, own = len(self.M), self.excitation
        found = []
        for p in 2j * np.pi * frequencies:
            force = own.M * p**2 + own.C * p + own.K
            found.append(own.G - self.G[:, :d] @ np.linalg.solve(self.M * p**2 + self.C * p + self.K, force))
        return np.array(found)

    def find_zeros(self, output: int, entry: int) -> Complex:
        """Return the zeros of the transfer function from an input to an output."""
        size = len(self.A)
        pencil = np.zeros((size + 1, size + 1))
        pencil[:size, :size], pencil[:size, size], pencil[size, :size] = self.A, self.B[:, entry], self.G[output]
        mass = np.zeros_like(pencil)
        mass[:size, :size] = np.eye(size)
        found = linalg.eigvals(pencil, mass, homogeneous_eigvals=True)
        finite = np.abs(found[1]) > RANK * np.abs(found).max(axis=0)
        return np.asarray(found[0][finite] / found[1][finite])

    def regulate(self, R: ArrayLike, Q: ArrayLike = 1.0) -> Array:
        """Return the gains (m, 2 d) of u = -gains z that minimise the integral of z'Q z + u'R u, z = (x, s).

        A weight is a number, or one number for each entry, or a matrix: Q symmetric without negative eigenvalues, R
        with positive ones. Raises ArgumentError for other weights, BalanceError where a pole that is not stable cannot
        be controlled.
        """
        Q, R = _read_weight("Q", Q, len(self.A)), _read_weight("R", R, self.B.shape[1])
        lost = [mode for mode in self.modes if mode.pole.real >= 0 and mode.controllable < LOST]
        if lost:
            named = ", ".join(f"{mode.pole:.3g}" for mode in lost)
            raise BalanceError(f"no input reaches the poles {named}; give the mechanism more inputs")
        try:
            P = linalg.solve_continuous_are(self.A, self.B, Q, R)
        except np.linalg.LinAlgError:
            raise BalanceError(
                "no gains were found; give weights to more coordinates, or nearer to each other"
            ) from None
        return np.asarray(np.linalg.solve(R, self.B.T @ P))


def _read_weight(name: str, weight: ArrayLike, size: int) -> Array:
    """Return a weight as a matrix. Raises ArgumentError for one that is none."""
    given = np.asarray(weight, dtype=float)
    found = given * np.eye(size) if given.ndim == 0 else np.diag(given) if given.ndim == 1 else given
    if found.shape != (size, size) or not np.isfinite(found).all():
        raise ArgumentError(f"{name} has shape {given.shape}; give a number, ({size},) or ({size}, {size}) of numbers")
    least = np.linalg.eigvalsh(found).min(initial=1.0)
    is_wrong = least <= 0 if name == "R" else least < -LOST * np.abs(found).max()
    if is_wrong or not np.allclose(found, found.T):
        raise ArgumentError(f"{name} must be symmetric, without {'zero or ' * (name == 'R')}negative eigenvalues")
    return found


def linearise(kernels: Kernels, equilibrium: Equilibrium) -> Linearisation:
    """Linearise the equations of motion about an equilibrium."""
    manifest, q = kernels.manifest, equilibrium.q
    blocks = kernels("jac_impl", **_state(kernels, equilibrium))
    Z, N, freedoms = _list_motions(kernels, q)
    W, d = _list_driven_motions(kernels, q), Z.shape[1]
    G, outputs = [np.eye(d)], list(freedoms)
    direct = [np.zeros((d, W.shape[1]))]
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    if sensors:
        moved = kernels("jac_sensors", q=q)["jac_position_q"] @ N
        G.append(moved @ Z)
        direct.append(moved @ W)
        outputs += [f"{sensor}.{axis}" for sensor in sensors for axis in "xyz"]
    S = -blocks["jac_Phi_u"] if manifest.actuated else np.zeros((len(Z), 0))
    return Linearisation(
        equilibrium=equilibrium,
        freedoms=freedoms,
        inputs=tuple(manifest.coordinates[i].name for i in manifest.actuated),
        driven=tuple(manifest.coordinates[i].name for i in manifest.driven),
        outputs=tuple(outputs),
        M=Z.T @ blocks["jac_Phi_qdd"] @ Z,
        C=Z.T @ blocks["jac_Phi_qd"] @ Z,
        K=Z.T @ blocks["jac_Phi_q"] @ N @ Z,
        F=Z.T @ S,
        G=np.hstack((np.vstack(G), np.zeros((len(outputs), d)))),
        excitation=Excitation(
            M=Z.T @ blocks["jac_Phi_qdd"] @ W,
            C=Z.T @ blocks["jac_Phi_qd"] @ W,
            K=Z.T @ blocks["jac_Phi_q"] @ N @ W,
            G=np.vstack(direct),
        ),
    )


def balance(kernels: Kernels, q: Array, given: Mapping[int, float]) -> Equilibrium:
    """Keep a pose at rest, by the inputs of least norm beside the given ones.

    Raises BalanceError where no inputs keep it, OpenError for open loops.
    """
    check_kernels(kernels)
    manifest, closure = kernels.manifest, Closure(kernels)
    if not closure.is_closed(q):
        raise closure.tell_open(q)
    u = np.zeros(len(manifest.actuated))
    u[list(given)] = list(given.values())
    free = [k for k in range(u.size) if k not in given]
    at_rest = _unload(kernels, q, u)
    forces, scale = _find_forces(kernels, at_rest)
    Z, _, names = _list_motions(kernels, q)
    S = np.zeros((len(Z), 0)) if not u.size else -kernels("jac_impl", **_state(kernels, at_rest))["jac_Phi_u"]
    u[free] += np.linalg.lstsq(Z.T @ S[:, free], Z.T @ forces, rcond=RANK)[0] if free else 0.0
    rest = forces - S[:, free] @ u[free]
    left = np.abs(Z.T @ rest)
    if left.max(initial=0.0) > BALANCED * max(1.0, scale):
        worst = int(left.argmax())
        raise BalanceError(
            f"the pose is no equilibrium: a force of {left[worst]:.3g} along {names[worst]} is not balanced; "
            "settle it, or give another pose"
        )
    return Equilibrium(q, u, *_carry(closure, q, rest))


def settle(kernels: Kernels, q: Array, u: Array) -> Equilibrium:
    """Find an equilibrium near a pose, under given inputs (m,), by Newton's method; it need not be stable.

    Raises BalanceError where it finds none.
    """
    check_kernels(kernels)
    closure, given = Closure(kernels), dict(enumerate(u))
    held = list_entries(kernels.manifest, kernels.manifest.driven)
    for _ in range(ITERATIONS):
        q = closure.close(normalise(q, kernels.manifest), held)
        if not closure.is_closed(q):
            raise closure.tell_open(q)
        Z, N, _ = _list_motions(kernels, q)
        forces, scale = _find_forces(kernels, _unload(kernels, q, u))
        state = _state(kernels, Equilibrium(q, u, *_carry(closure, q, forces)))
        slopes = kernels("jac_impl", **state)
        missing, least = Z.T @ forces, BALANCED * max(1.0, scale)
        K = Z.T @ slopes["jac_Phi_q"] @ N @ Z
        step = -np.asarray(np.linalg.lstsq(K, missing, rcond=RANK)[0])
        left = missing + K @ step
        if np.abs(left).max(initial=0.0) > max(least, UNSUPPORTED * np.abs(missing).max()):
            step += _yield_to(left, Z.T @ slopes["jac_Phi_qdd"] @ Z)
        longest = np.abs(step).max(initial=0.0)
        q = q + N @ Z @ step * min(1.0, LONGEST / max(longest, CLOSED))
        if longest <= CLOSED and np.abs(missing).max(initial=0.0) <= least:
            return balance(kernels, closure.close(normalise(q, kernels.manifest), held), given)
    raise BalanceError("no equilibrium was found near the pose; give another pose, or other inputs")


def _yield_to(left: Array, M: Array) -> Array:
    """Return a step of the largest length the way that forces accelerate which no stiffness balances.

    A horizontal arm has none: the moment of its weight is the largest there.
    """
    pushed = -np.asarray(np.linalg.lstsq(M, left, rcond=RANK)[0])
    return np.asarray(pushed * LONGEST / np.abs(pushed).max())


def check_kernels(kernels: Kernels, needed: Collection[str] = ("impl", "jac_impl")) -> None:
    """Raise ArgumentError where a generated folder lacks functions."""
    known = {kernel.name for kernel in kernels.manifest.kernels}
    missing = [name for name in needed if name not in known]
    if missing:
        raise ArgumentError(f"{kernels.manifest.model} was generated without {', '.join(missing)}")
    if kernels.manifest.reads_time:
        raise ArgumentError(
            f"forces of {kernels.manifest.model} depend on the time t, so no pose stays an equilibrium; replace t in "
            "the model by a signal, which is 0 here"
        )


def _state(kernels: Kernels, at: Equilibrium) -> dict[str, Any]:
    """Return the inputs of `impl` at rest."""
    manifest = kernels.manifest
    rest = np.zeros(len(manifest.coordinates))
    given = {"q": at.q, "qd": rest, "qdd": rest, "u": at.u, "lam": at.multipliers, "tau": at.tau}
    taken = {argument.name for argument in kernels.describe("impl").inputs}
    if "w" in taken:
        given["w"] = np.zeros(len(manifest.inputs) - at.u.size)
    return {name: value for name, value in given.items() if name in taken}


def _unload(kernels: Kernels, q: Array, u: Array) -> Equilibrium:
    """Return a pose under inputs alone: loops and driven joints bear nothing."""
    return Equilibrium(q, u, np.zeros(len(kernels.manifest.owners)), np.zeros(len(kernels.manifest.driven)))


def _carry(closure: Closure, q: Array, forces: Array) -> tuple[Array, Array]:
    """Return the multipliers of the loops, and the forces of the driven joints, that carry some forces together."""
    driven = list(closure.manifest.driven)
    J = closure.jacobian(q)
    free = np.delete(J, driven, axis=1)
    multipliers = np.zeros(0)
    if closure.count:
        multipliers = np.asarray(np.linalg.lstsq(free.T, np.delete(forces, driven), rcond=RANK)[0])
    return multipliers, (forces - J.T @ multipliers)[driven]


def _find_forces(kernels: Kernels, at: Equilibrium) -> tuple[Array, float]:
    """Return the forces that are missing at rest (n,), and the largest number among them."""
    forces = kernels("impl", **_state(kernels, at))["Phi"]
    return forces, float(np.abs(forces).max(initial=0.0))


def _list_motions(kernels: Kernels, q: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Return Z (n, d), N (nq, n), and the names of the freedoms."""
    manifest, closure = kernels.manifest, Closure(kernels)
    n = len(manifest.coordinates)
    names = [coordinate.name for coordinate in manifest.coordinates]
    N = np.eye(n)
    if manifest.configuration:
        N = kernels("jac_rates", q=q, qd=np.zeros(n))["jac_rate_qd"]
    chosen = _choose_freedoms(closure)
    if not chosen:
        raise BalanceError(
            f"driven joints determine the whole motion of {manifest.model}, so nothing moves about a pose; "
            "linearise the model without `driven`"
        )
    given = [*chosen, *manifest.driven]
    Z = np.array([closure.complete_velocities(q, given, row) for row in np.eye(len(given))[: len(chosen)]]).T
    return Z, N, tuple(names[i] for i in chosen)


def _choose_freedoms(closure: Closure) -> list[int]:
    manifest = closure.manifest
    every = closure.independent if closure.count else range(len(manifest.coordinates))
    return [i for i in every if i not in manifest.driven]


def _list_driven_motions(kernels: Kernels, q: Array) -> Array:
    """Return W (n, e): the velocities of all joints where one driven joint moves, and freedoms stand still."""
    manifest, closure = kernels.manifest, Closure(kernels)
    chosen = _choose_freedoms(closure)
    given = [*chosen, *manifest.driven]
    rows = [closure.complete_velocities(q, given, row) for row in np.eye(len(given))[len(chosen) :]]
    return np.array(rows).reshape(len(rows), len(manifest.coordinates)).T


def find_pose(kernels: Kernels, values: Mapping[str, float], start: Array | None = None) -> Array:
    """Return a pose (nq,) with some coordinates at given values; loops give the others.

    The pose is the model's own, or the one to start from. Raises OpenError where loops cannot be closed.
    """
    manifest, closure = kernels.manifest, Closure(kernels)
    places = [manifest.positions.index(name) for name in values]
    if start is None:
        start = np.array(manifest.pose) if manifest.pose else neutral(manifest)
    q = start.copy()
    q[places] = list(values.values())
    q = normalise(q, manifest)
    return closure.move(start, places, q[places]) if closure.count else q
