"""Variational steps of a fixed length on a Lie group, with loops and driven joints: RATTLE in momenta.

A velocity w holds for a step h and moves q0 to q1 = q0 tau(h w) (`groups`). The discrete Lagrangian

    L_d = h/2 (L(q0, w) + L(q1, w)),    L = w.M(q) w / 2 - V(q)

and the discrete momenta at both ends of the step, p = M(q) qd, give with x = h w and A = A(x)

    A(x)^T (M(q0) + M(q1)) w / 2  = p0 + h/2 (G(q0, w) + J(q0)^T lam),      h(q1) = 0                              (1)
    A(-x)^T (M(q0) + M(q1)) w / 2 = p1 - h/2 (G(q1, w) + J(q1)^T lam1),     J(q1) qd1 = 0,  p1 = M(q1) qd1         (2)

where G are the derivatives of L along the group, and the forces: half of their impulse acts at each end. (1) is solved
for w and lam by Newton's method, (2) is linear in qd1 and lam1. The method is symmetric, so of order 2; without forces
it keeps the canonical form of q and p, so that the error of energy stays bounded, and momenta of symmetries stay to
rounding. Loops and their rates are closed to rounding at every step, and quaternions have length 1.

Marsden, West, Acta Numerica 10 (2001), sections 1.3 and 3.5; Leimkuhler, Skeel, Journal of Computational Physics 112
(1994); on groups Hante, Arnold, Journal of Computational and Applied Mathematics 387 (2021), "RATTLie".

The residual is Phi(q, w, 0) = dM/dt w + gyr(w, M w) - dL - Q, with momenta in moving axes (`Group.gyrate`), so

    G = B w + gyr(w, M w) - Phi(q, w, 0),    B = d(M w) along the group = (dPhi/dq(q, 0, w) - dPhi/dq(q, 0, 0)) N(q),

with rates N(q) w of q, and dG/dw = B^T + dQ/dw. Of forces that are even in w, Newton's matrix lacks the derivative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import GAP
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import Piece, differentiate
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration import implicit, rattle
from mbsrun.simulation.integration.groups import find_group
from mbsrun.simulation.integration.implicit import (
    CONVERGED,
    ITERATIONS,
    Scheme,
    State,
    find_start,
    iterate,
    scale_velocities,
)
from mbsrun.simulation.integration.multipliers import NOISE, Loops, solve_step
from mbsrun.simulation.integration.steps import count_steps, place_steps, sample
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings, Stages

Array = NDArray[np.float64]

STEPS = 4096  # taken in C at a time
END = (CONVERGED, NOISE, ITERATIONS)  # of Newton's method in C
POINTS, WEIGHTS = np.array([0.0, 1.0]), np.array([0.5, 0.5])  # of the power of forces in a step


@dataclass(frozen=True, eq=False)
class _End:
    """The end of a step with the velocity w: everything that depends on its place alone, or is linear in w."""

    q: Array  # (nq,)
    M: Array  # (n, n)
    B: Array  # (n, n): M w differentiated along the group
    gap: Array  # (e,): h
    J: Array  # (e, n)


class _Mechanism:
    """A model under the inputs of a piece."""

    def __init__(self, dynamics: Dynamics, piece: Piece) -> None:
        self.dynamics, self.piece = dynamics, piece
        self.group, self.loops = find_group(dynamics.kernels), Loops(dynamics, piece)
        self.driven, self.n, self.e = self.loops.driven, dynamics.size, self.loops.size
        self.is_closed = bool(self.e or self.driven)
        self.lam = np.zeros(self.e)  # of the last step: a guess for the next one

    def start(self, q: Array, qd: Array) -> Array:
        """Return the accelerations at the start of the piece."""
        if not self.is_closed:
            return find_start(self.dynamics, self.piece, q, qd)
        qdd, self.lam = self.loops.start(q, qd)
        return qdd

    def start_lam(self, q: Array, qd: Array) -> Array:
        """Return the multipliers at the start of the piece."""
        return self.loops.start(q, qd)[1] if self.is_closed else self.lam

    def place(self, q: Array, w: Array) -> _End:
        """Evaluate an end of a step."""
        dynamics, rest = self.dynamics, np.zeros((2, self.n))
        v = np.zeros((2, len(dynamics.kernels.manifest.inputs)))
        _, K, _, M = dynamics.linearise(np.tile(q, (2, 1)), rest, np.array([w, rest[0]]), v)
        B = (K[0] - K[1]) @ dynamics.rate_slopes(q, w)[1]
        if not self.e:
            return _End(q, M[0], B, np.zeros(0), np.zeros((0, self.n)))
        J = dynamics.kernels("loop_jacobian", q=q, qd=w)["J"]
        return _End(q, M[0], B, dynamics.kernels("loops", q=q)[GAP], J)

    def push(self, time: float, end: _End, w: Array) -> tuple[Array, Array]:
        """Return G (n,), and its derivative by w (n, n), with the inputs of that time, place and velocity."""
        dynamics, rest, t = self.dynamics, np.zeros((2, self.n)), np.array([time])
        v = self.piece.at(time, end.q, w)
        Phi, _, C, _ = dynamics.linearise(np.tile(end.q, (2, 1)), np.array([w, -w]), rest, np.tile(v, (2, 1)))
        by_w = end.B.T - (C[0] + C[1]) / 2  # the inertia's own part of C is odd in w
        if self.piece.law is not None:
            lam = np.zeros((1, self.e)) if self.e else None
            S = dynamics.input_slopes(end.q[None], w[None], rest[:1], v[None], lam)[0]
            by_w = by_w - S @ differentiate(self.piece.law, t, end.q[None], w[None])[1][0]
        return end.B @ w + self.group.gyrate(w, end.M @ w) - Phi[0], by_w

    def step(self, state: State, time: float, h: float) -> State:
        """Solve (1) for w and lam, and (2) for the velocities at the end."""
        q, qd, n, e, group = state.q, state.qd, self.n, self.e, self.group
        (before, *_), (after, rates, _) = self.dynamics.course.at(time), self.dynamics.course.at(time + h)

        def correct(z: Array) -> Array:
            w, lam, x = z[:n], z[n:], h * z[:n]
            near, far = self.place(q, w), self.place(group.move(q, x), w)
            (G, by_w), A, mean = self.push(time, near, w), group.trivialise(x), (near.M + far.M) / 2
            along = h * group.carry(x)  # the way of the far end by w
            p = mean @ w
            slopes = h * group.vary(x, p) + A.T @ (mean + far.B @ along / 2) - h / 2 * by_w
            matrix = np.block([[slopes, -h / 2 * near.J.T], [far.J @ along / h, np.zeros((e, e))]])
            right = np.concatenate((A.T @ p - near.M @ qd - h / 2 * (G + near.J.T @ lam), far.gap / h))
            return self.solve(matrix, right)

        guess = np.concatenate((qd + h / 2 * state.qdd, self.lam))
        guess[self.driven] = (after - before) / h
        scale = np.concatenate((scale_velocities(state, h), np.zeros(e)))
        z = iterate(self.dynamics, correct, guess, scale, NOISE if self.is_closed else 0.0)
        w, self.lam = z[:n], z[n:]
        near, far = self.place(q, w), self.place(group.move(q, h * w), w)
        p = group.trivialise(-h * w).T @ (near.M + far.M) @ w / 2 + h / 2 * self.push(time + h, far, w)[0]
        ends = self.release(far, p, rates)
        return State(far.q, ends, (ends - qd) / h, np.stack((q, far.q)), np.stack((w, w)))

    def release(self, end: _End, p: Array, rates: Array) -> Array:
        """Solve M qd = p + J^T lam, J qd = 0 for qd (n,); driven joints have given rates."""
        if not self.is_closed:
            return self.dynamics.solve(end.M, p)
        given = np.zeros(self.n + self.e)
        given[self.driven] = rates
        matrix = np.block([[end.M, -end.J.T], [end.J, np.zeros((self.e, self.e))]])
        right = matrix @ given - np.concatenate((p, np.zeros(self.e)))
        return (given + self.solve(matrix, right))[: self.n]

    def solve(self, matrix: Array, right: Array) -> Array:
        """Return -matrix^-1 right, (n + e,); driven entries are known, so their change is 0."""
        if not self.is_closed:
            return -np.asarray(np.linalg.solve(matrix, right))
        matrix[self.driven], matrix[:, self.driven], right[self.driven] = 0, 0, 0
        matrix[self.driven, self.driven] = 1
        return solve_step(matrix, right)


def make(dynamics: Dynamics, piece: Piece, _: Settings) -> Scheme:
    """Unknown: the velocity w of the step, and the multipliers at its start."""
    mechanism = _Mechanism(dynamics, piece)
    return Scheme(mechanism.start, mechanism.step, POINTS, WEIGHTS)


def integrate(
    dynamics: Dynamics, piece: Piece, q: Array, qd: Array, settings: Settings, allowance: Allowance
) -> Iterator[Chunk]:
    """Go through a piece by steps of equal length, at most `settings.step`; yield the steps.

    Steps are taken in C where that takes the model. The first one that fails there is repeated in Python, with all that
    follow. Raises HaltError where a kernel fails, or Newton's method does, or the allowance is used up.
    """
    if not rattle.is_taken(dynamics, piece):
        yield from implicit.integrate(make, dynamics, piece, q, qd, settings, allowance)
        return
    if "stepper" not in dynamics.kept:
        dynamics.kept["stepper"] = rattle.Stepper(dynamics, find_group(dynamics.kernels), END)
    stepper: rattle.Stepper = dynamics.kept["stepper"]
    count, taken, row = count_steps(piece, settings.step), 0, np.concatenate((q, qd))
    h, guess = (piece.end - piece.start) / count, np.concatenate((qd, _Mechanism(dynamics, piece).start_lam(q, qd)))
    while taken < count:
        steps = min(STEPS, count - taken, max(1, allowance.steps))
        times = place_steps(piece, taken + np.arange(steps + 1), count)
        try:
            allowance.spend(steps)
        except LimitError as error:
            raise HaltError(Halt(float(times[0]), None, error.finding, error.remedy)) from None
        done, states, speeds = stepper.run(h, sample(piece, times), row, guess, steps)
        dynamics.effort.steps += done
        taken += done
        if done:
            yield _bundle(times[: done + 1], states, speeds, dynamics.places)
            row = states[-1]
        if done < steps:
            rest, (q, qd) = replace(piece, start=float(times[done])), np.split(row, [dynamics.places])
            yield from implicit.integrate(make, dynamics, rest, q, qd, settings, allowance)
            return


def _bundle(times: Array, states: Array, speeds: Array, places: int) -> Chunk:
    """Make a chunk of steps; the power of forces is taken at both ends of a step, at its velocity."""
    q, qd = np.split(states, [places], axis=1)
    ends, both = np.stack((q[:-1], q[1:]), axis=1), np.repeat(speeds[:, None], 2, axis=1)
    return Chunk(times, q, qd, stages=Stages(np.stack((times[:-1], times[1:]), axis=1), ends, both, WEIGHTS))
