"""Implicit steps of a fixed length on the residual: no mass matrix is formed, and any formulation is admitted.

    R(t, q, qd, qdd) = 0

Generalised alpha: Chung, Hulbert, Journal of Applied Mechanics 60 (1993); as here Arnold, Bruls, Multibody System
Dynamics 18 (2007), equations (5) to (12). Collocation: Hairer, Wanner, "Solving Ordinary Differential Equations II",
section IV.5; the unknowns are the accelerations z of the stages, with Z = A z and A Z for velocities and coordinates.

Symplectic Euler, of the momenta p = M(q) qd and the Hamiltonian H(q, p) (Hairer, Lubich, Wanner, "Geometric Numerical
Integration", section VI.3),

    p' = p - h dH/dq(q, p') + h Q,    q' = q + h dH/dp(q, p')

is solved for the velocity w = dH/dp(q, p'), with p' = M(q) w. Since dH/dq(q, p') = -dL/dq(q, w), and the residual is
Phi(q, w, 0) = dM/dt w - dL/dq - Q, the equation is, with B = d(M w)/dq = dPhi/dq(q, 0, w) - dPhi/dq(q, 0, 0),

    M (w - qd) + h (Phi(q, w, 0) - B w) = 0,    d/dw of it:  M - h (B^T + dQ/dw)

Where coordinates change by rates(q, qd), with quaternions, velocities alone follow from the accelerations by these
formulas, and coordinates from the velocities: at the stages of a collocation they solve its own equations; generalised
alpha moves by the mean velocity of the step on the group of the coordinates (`groups`; Bruls, Cardona, Journal of
Computational and Nonlinear Dynamics 5 (2010), 031002; Arnold, Bruls, Cardona, Numerische Mathematik 129 (2015)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance, LimitError
from mbsrun.ocp.ground import schemes
from mbsrun.simulation.drive import DriveError, Piece, differentiate
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.integration.groups import find_group
from mbsrun.simulation.integration.steps import SINGULAR, count_steps, describe_singularity, place_steps
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings, Stages

Array = NDArray[np.float64]

STEPS = 512  # yielded at a time
ITERATIONS = 25
CONVERGED = 1e-10  # a change of the state, relative or absolute; Newton's error is then about its square


class _StuckError(Exception):
    """Newton's method does not converge, or its step is not finite; joint: where the last change was largest."""

    def __init__(
        self, joint: str, finding: str = f"Newton's method does not converge within {ITERATIONS} iterations"
    ) -> None:
        super().__init__(joint)
        self.joint, self.finding = joint, finding


@dataclass(frozen=True, eq=False)
class State:
    """The end of a step, with its stages, (s, nq) and (s, n)."""

    q: Array
    qd: Array
    qdd: Array
    stage_q: Array
    stage_qd: Array


Step = Callable[[State, float, float], State]  # state, its time, length of the step -> the next state


@dataclass(frozen=True, eq=False)
class Scheme:
    """A method: how it steps, and where in a step (s,), with which weights (s,) it evaluates integrals, if it does."""

    start: Callable[[Array, Array], Array]  # q and qd at the start of a piece -> qdd there
    step: Step
    points: Array | None = None
    weights: Array | None = None


@dataclass(frozen=True)
class _Loop:
    """The residual with the inputs of a piece, which may follow the state."""

    dynamics: Dynamics
    piece: Piece

    def residual(self, t: Array, q: Array, qd: Array, qdd: Array) -> Array:
        """Evaluate the residual at times (K,) and states (K, ...), shape (K, n)."""
        return self.dynamics.residual(q, qd, qdd, self.piece.follow(t, q, qd))

    def stiffnesses(self, t: Array, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array]:
        """Differentiate the residual by q, qd and qdd, with the inputs that follow the state."""
        v = self.piece.follow(t, q, qd)
        K, C, M = self.dynamics.stiffnesses(q, qd, qdd, v)
        if self.piece.law is None:
            return K, C, M
        S = self.dynamics.input_slopes(q, qd, qdd, v)
        by_q, by_qd = differentiate(self.piece.law, t, q, qd)
        return K + S @ by_q, C + S @ by_qd, M


Make = Callable[[Dynamics, Piece, Settings], Scheme]  # the scheme of a method for a piece


def integrate(
    make: Make,
    dynamics: Dynamics,
    piece: Piece,
    q: Array,
    qd: Array,
    settings: Settings,
    allowance: Allowance,
) -> Iterator[Chunk]:
    """Go through a piece by steps of equal length, at most `settings.step`; yield the steps.

    Raises HaltError where a kernel fails, or Newton's method does, or the allowance is used up.
    """
    return _march(make(dynamics, piece, settings), dynamics, piece, (q, qd), settings, allowance)


def _march(
    scheme: Scheme,
    dynamics: Dynamics,
    piece: Piece,
    start: tuple[Array, Array],
    settings: Settings,
    allowance: Allowance,
) -> Iterator[Chunk]:
    count, (q, qd) = count_steps(piece, settings.step), start
    h, time, k = (piece.end - piece.start) / count, piece.start, 0
    done: list[State] = []
    try:
        done.append(State(q, qd, scheme.start(q, qd), q[None], qd[None]))
        for k in range(count):
            time = piece.start + k * h
            allowance.spend()
            done.append(_check(dynamics, done[-1], scheme.step(done[-1], time, h), h))
            dynamics.effort.steps += 1
            if len(done) > STEPS:
                yield _gather(done, piece, k + 1, count, scheme)
                done = done[-1:]
    except (KernelError, SingularError, LimitError, DriveError, _StuckError, np.linalg.LinAlgError) as error:
        if len(done) > 1:
            yield _gather(done, piece, k, count, scheme)
        if isinstance(error, DriveError) and piece.law is None:
            raise
        raise HaltError(_describe(error, time)) from None
    if len(done) > 1:
        yield _gather(done, piece, count, count, scheme)


def _check(dynamics: Dynamics, before: State, state: State, h: float) -> State:
    """Return the end of a step. Raises _StuckError where it is not finite, at the joint that moved most before."""
    if np.isfinite(state.q).all() and np.isfinite(state.qd).all():
        return state
    worst = int(np.argmax(np.abs(before.qd) * scale_velocities(before, h)))
    raise _StuckError(dynamics.kernels.manifest.coordinates[worst].name, "the motion diverges: its numbers overflow")


def _gather(done: list[State], piece: Piece, last: int, count: int, scheme: Scheme) -> Chunk:
    """Bundle states, the last of which is reached with step number `last` of `count`."""
    t = place_steps(piece, last + 1 - len(done) + np.arange(len(done)), count)
    q, qd = np.array([state.q for state in done]), np.array([state.qd for state in done])
    if scheme.points is None or scheme.weights is None:
        return Chunk(t, q, qd)
    stage_q, stage_qd = np.array([x.stage_q for x in done[1:]]), np.array([x.stage_qd for x in done[1:]])
    stages = Stages(t[:-1, None] + np.diff(t)[:, None] * scheme.points, stage_q, stage_qd, scheme.weights)
    return Chunk(t, q, qd, stages=stages)


def _describe(error: Exception, time: float) -> Halt:
    if isinstance(error, LimitError | DriveError):
        return Halt(time, None, error.finding, error.remedy)
    if isinstance(error, _StuckError):
        return Halt(time, error.joint, error.finding, "take a smaller step")
    if isinstance(error, KernelError | SingularError):
        return describe_singularity(error, time)
    return Halt(time, None, SINGULAR, "start elsewhere, or keep away from this configuration")


def find_start(dynamics: Dynamics, piece: Piece, q: Array, qd: Array) -> Array:
    """Solve the residual at the piece's start for the accelerations; it is linear in them."""
    v, rest = piece.at(piece.start, q, qd), np.zeros_like(qd)
    M = dynamics.stiffnesses(q, qd, rest, v)[2]
    try:
        return -np.asarray(np.linalg.solve(M, dynamics.residual(q, qd, rest, v)))
    except np.linalg.LinAlgError:
        raise SingularError(dynamics.find_pivot(M)) from None


@dataclass(frozen=True, eq=False)
class Places:
    """Coordinates at the stages of a step, which follow from the velocities V (s, n) there: Q = q + h A rates(Q, V)."""

    dynamics: Dynamics
    A: Array  # (s, s)
    b: Array  # (s,)

    @cached_property
    def are_integrals(self) -> bool:
        """Return whether rates are the velocities."""
        return not self.dynamics.kernels.manifest.quaternions

    def stages(self, q: Array, V: Array, h: float) -> Array:
        """Return Q, (s, nq). Rates of quaternions are linear in them, and other rates do not depend on places."""
        if self.are_integrals:
            return np.asarray(q + h * self.A @ V)
        Q = np.tile(q, (len(V), 1))
        for _ in range(2):  # of Newton's method: the first gives quaternions, so that the second gives places
            residual = Q - q - h * self.A @ self.dynamics.rates(Q, V)
            Q = Q - np.linalg.solve(self._differentiate(Q, V, h)[0], residual.ravel()).reshape(Q.shape)
        return Q

    def end(self, q: Array, Q: Array, V: Array, h: float) -> Array:
        """Return q + h b rates(Q, V), (nq,)."""
        return np.asarray(q + h * self.b @ self.dynamics.rates(Q, V))

    def stiffen(self, K: Array, Q: Array, V: Array, h: float) -> Array:
        """Differentiate by V a function with the derivatives K (s, n, nq) by Q: (s, s, n, n), stage by stage."""
        if self.are_integrals:
            return np.asarray(h * self.A[:, :, None, None] * K[:, None])
        slopes = np.linalg.solve(*self._differentiate(Q, V, h)).reshape(*Q.shape, *V.shape)
        return np.asarray(np.einsum("iaq,iqjb->ijab", K, slopes))

    def _differentiate(self, Q: Array, V: Array, h: float) -> tuple[Array, Array]:
        """Differentiate Q - h A rates(Q, V) by Q, and h A rates(Q, V) by V."""
        by_q, by_qd = (
            h * np.einsum("ij,jab->iajb", self.A, slopes).reshape(Q.size, -1)
            for slopes in self.dynamics.rate_slopes(Q, V)
        )
        return np.eye(Q.size) - by_q, by_qd


def make_alpha(dynamics: Dynamics, piece: Piece, settings: Settings) -> Scheme:
    """Unknown: qdd at the step's end. `a` is the method's own acceleration, which follows qdd."""
    rho = settings.rho
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    ratio = (1 - alpha_f) / (1 - alpha_m)  # d a / d qdd
    group = find_group(dynamics.kernels)
    loop, memory = _Loop(dynamics, piece), dict[str, Array]()

    def step(state: State, time: float, h: float) -> State:
        a, end = memory.get("a", state.qdd), np.array([time + h])

        def advance(qdd: Array) -> tuple[Array, Array, Array, Array]:
            """Return q, qd and a at the end, and the way of the step along the group."""
            new = ((1 - alpha_f) * qdd + alpha_f * state.qdd - alpha_m * a) / (1 - alpha_m)
            way = h * (state.qd + h * ((0.5 - beta) * a + beta * new))
            return group.move(state.q, way), state.qd + h * ((1 - gamma) * a + gamma * new), new, way

        def correct(qdd: Array) -> Array:
            q, qd, _, way = advance(qdd)
            at = (end, q[None], qd[None], qdd[None])
            K, C, M = (x[0] for x in loop.stiffnesses(*at))
            along = K if group.is_flat else K @ dynamics.rate_slopes(q, qd)[1] @ group.carry(way)
            matrix = M + ratio * (h * gamma * C + h * h * beta * along)
            return -np.asarray(np.linalg.solve(matrix, loop.residual(*at)[0]))

        qdd = iterate(dynamics, correct, state.qdd, scale_changes(state, h))
        q, qd, memory["a"], *_ = advance(qdd)
        return State(q, qd, qdd, np.stack((state.q, q)), np.stack((state.qd, qd)))

    return Scheme(partial(find_start, dynamics, piece), step, np.array([0.0, 1.0]), np.array([0.5, 0.5]))


def make_collocation(family: schemes.Family, dynamics: Dynamics, piece: Piece, settings: Settings) -> Scheme:
    """Unknowns: qdd at the stages, (s, n)."""
    scheme = schemes.build(family, settings.stages)
    A, b, c, s, n = scheme.integration, scheme.weights, scheme.points, scheme.degree, dynamics.size
    places, values, loop = Places(dynamics, A, b), extrapolate(c), _Loop(dynamics, piece)

    def step(state: State, time: float, h: float) -> State:
        t = time + h * c

        def advance(z: Array) -> tuple[Array, Array]:
            qd = state.qd + h * A @ z
            return places.stages(state.q, qd, h), qd

        def correct(z: Array) -> Array:
            q, qd = advance(z)
            K, C, M = loop.stiffnesses(t, q, qd, z)
            by_qd = places.stiffen(K, q, qd, h)
            by_qd[range(s), range(s)] += C
            blocks = h * np.tensordot(by_qd, A, axes=(1, 0)).transpose(0, 1, 3, 2)  # (s, n, s, n)
            blocks[range(s), :, range(s)] += M
            matrix = blocks.reshape(s * n, s * n)
            residual = loop.residual(t, q, qd, z).ravel()
            return -np.asarray(np.linalg.solve(matrix, residual)).reshape(s, n)

        z = iterate(dynamics, correct, np.tile(state.qdd, (s, 1)), scale_changes(state, h))
        Q, V = advance(z)
        return State(places.end(state.q, Q, V, h), state.qd + h * b @ z, values @ z, Q, V)

    return Scheme(partial(find_start, dynamics, piece), step, c, b)


def make_symplectic(dynamics: Dynamics, piece: Piece, _: Settings) -> Scheme:
    """Unknown: the velocity w of the step. Inputs are those at its start."""
    n = dynamics.size

    def step(state: State, time: float, h: float) -> State:
        q, qd, v = state.q, state.qd, piece.at(time, state.q, state.qd)

        def correct(w: Array) -> Array:
            rest = np.zeros(n)
            states = np.tile(q, (4, 1)), np.array([rest, rest, w, -w]), np.array([w, rest, rest, rest])
            K, C, M = dynamics.stiffnesses(*states, np.tile(v, (4, 1)))
            B = K[0] - K[1]
            damping = (C[2] + C[3]) / 2  # the inertia's own part is odd in w
            residual = M[0] @ (w - qd) + h * (dynamics.residual(q, w, rest, v) - B @ w)
            return -np.asarray(np.linalg.solve(M[0] + h * (damping - B.T), residual))

        w = iterate(dynamics, correct, qd, scale_velocities(state, h))
        end, rest = q + h * w, np.zeros(n)
        M = dynamics.stiffnesses(np.array([q, end]), np.zeros((2, n)), np.zeros((2, n)), np.tile(v, (2, 1)))[2]
        return State(end, dynamics.solve(M[1], M[0] @ w), rest, end[None], w[None])

    return Scheme(partial(find_start, dynamics, piece), step)


def extrapolate(points: Array) -> Array:
    """Evaluate at 1 the basis polynomials of the points: the guess for the next step's stages."""
    gaps = points[:, None] - points
    np.fill_diagonal(gaps, 1.0)
    tops = np.tile(1.0 - points, (len(points), 1))
    np.fill_diagonal(tops, 1.0)
    return np.asarray((tops / gaps).prod(axis=1))


def scale_changes(state: State, h: float) -> Array:
    """Return the change of the state in a step by a unit acceleration, relative to the state, or 1 with quaternions."""
    return h * scale_velocities(state, h)


def scale_velocities(state: State, h: float) -> Array:
    """Return the change of the state in a step by a unit change of velocity, relative to the state, as above."""
    sizes = np.abs(state.q) if state.q.shape == state.qd.shape else 0.0
    return np.asarray(1 / (1 + np.abs(state.qd)) + h / (1 + sizes))


def iterate(
    dynamics: Dynamics, correct: Callable[[Array], Array], guess: Array, scale: Array, noise: float = 0.0
) -> Array:
    """Solve for accelerations by Newton's method, until their change times `scale` (n,) is within CONVERGED.

    A change within `noise` that shrinks no more is taken for rounding.
    """
    z, last = guess, np.inf
    before = change = np.zeros_like(z)
    for _ in range(ITERATIONS):
        dynamics.effort.iterations += 1
        before, change = z, correct(z)
        z = before + change
        size = float(np.max(np.abs(change) * scale))
        if size <= CONVERGED or last / 2 < size <= noise:
            return z
        last = size
        if not np.isfinite(size):
            break
    if not np.isfinite(change).all():
        change = before  # the numbers have overflowed
    worst = np.nan_to_num(np.abs(change) * scale, nan=np.inf).reshape(-1, len(scale)).max(axis=0).argmax()
    raise _StuckError(dynamics.kernels.manifest.coordinates[int(worst)].name)
