"""Implicit steps of a fixed length for models with loops: the multipliers lam are unknowns, h(q) = 0 is an equation.

Generalised alpha, index 3 (Arnold, Bruls, Multibody System Dynamics 18 (2007), section 3): at the end of a step

    Phi(q, qd, qdd, lam) = 0,    h(q) = 0

Radau collocation of the stabilised index 2 system (Gear, Gupta, Leimkuhler, Journal of Computational and Applied
Mathematics 12 (1985); Hairer, Wanner, "Solving Ordinary Differential Equations II", section VII.1): at each stage

    q' = v + B mu,    Phi(q, v, v', lam) = 0,    h(q) = 0,    J(q) v = 0,    B = J^T at the start of the step

where mu vanishes along a motion. The last stage is the end of the step, so loops are closed there to rounding. In both,
driven joints have their given coordinates, velocities and accelerations, and no unknown.

A step that meets a singular pose has a matrix without an inverse; its solution of least norm is taken then. Steps of
Radau collocation are taken in C where that takes the model (`radau`), and the ones that fail there are repeated here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_derivative, name_kernel
from mbsrun.closure import GAP
from mbsrun.ocp.ground import schemes
from mbsrun.simulation.course import place_driven
from mbsrun.simulation.drive import Piece, differentiate
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration import radau
from mbsrun.simulation.integration.groups import find_group
from mbsrun.simulation.integration.implicit import (
    CONVERGED,
    ITERATIONS,
    Places,
    Scheme,
    State,
    extrapolate,
    iterate,
    scale_changes,
)
from mbsrun.simulation.motion import Settings

Array = NDArray[np.float64]
Residuals = tuple[Array, Array, Array]  # Phi, h and J v

NOISE = 1e-7  # of a change of the state: near a singular pose, rounding of h over a small pivot of J
RANK = 1e-12  # of singular values, relative to the first


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives of the residual at K states."""

    K: Array  # (K, n, nq)
    C: Array  # (K, n, n)
    M: Array  # (K, n, n)
    lam: Array  # (K, n, e)
    h: Array  # of h by q, (K, e, nq)
    hd_q: Array  # of J v by q, (K, e, nq)
    J: Array  # (K, e, n)


@dataclass(frozen=True)
class Loops:
    """The equations of motion with multipliers, under the inputs of a piece."""

    dynamics: Dynamics
    piece: Piece

    @cached_property
    def size(self) -> int:
        """Count the equations of loops."""
        return len(self.dynamics.kernels.manifest.owners)

    @cached_property
    def driven(self) -> list[int]:
        """List the driven entries of qd."""
        return list(self.dynamics.kernels.manifest.driven)

    @cached_property
    def placed(self) -> list[int]:
        """List the driven entries of q."""
        return place_driven(self.dynamics.kernels.manifest)

    def guide(self, t: Array, q: Array, qd: Array, qdd: Array) -> None:
        """Write the driven entries of states (K, ...) at times (K,)."""
        if self.driven:
            q[:, self.placed], qd[:, self.driven], qdd[:, self.driven] = self.dynamics.course.states(t)

    def linearise(self, t: Array, q: Array, qd: Array, qdd: Array, lam: Array) -> tuple[Residuals, _Slopes]:
        """Evaluate Phi (K, n), h and J qd (K, e), and differentiate them."""
        dynamics, v, count = self.dynamics, self.piece.follow(t, q, qd), len(t)
        dynamics.effort.evaluations += count
        dynamics.effort.jacobians += count
        name = dynamics.formulation.evaluated.function
        n, nq, e = dynamics.size, dynamics.places, self.size
        blocks = dynamics.call(name_kernel(name, Order.LINEARISATION), q, qd, v, qdd, lam)
        Phi = blocks["Phi"].copy()
        Phi[:, self.driven] = 0
        sizes = {"q": nq, "qd": n, "qdd": n, "lam": e}
        K, C, M, by_lam = (_pick(blocks, "Phi", x, (count, n, size)) for x, size in sizes.items())
        if self.piece.law is not None:
            S = dynamics.input_slopes(q, qd, qdd, v, lam)
            by_q, by_qd = differentiate(self.piece.law, t, q, qd)
            K, C = K + S @ by_q, C + S @ by_qd
        if not e:
            none = np.zeros((count, 0))
            return (Phi, none, none), _Slopes(K, C, M, by_lam, *(np.zeros((count, 0, x)) for x in (nq, nq, n)))
        places = dynamics.kernels(name_kernel("loops", Order.LINEARISATION), q=q)
        rates = dynamics.kernels(name_kernel("loop_rates", Order.LINEARISATION), q=q, qd=qd)
        by_place, by_q = places[name_derivative(GAP, "q")], _pick(rates, "hd", "q", (count, e, nq))
        slopes = _Slopes(K, C, M, by_lam, by_place, by_q, rates[name_derivative("hd", "qd")])
        return (Phi, places[GAP], rates["hd"]), slopes

    def fix(self, matrix: Array) -> None:
        """Make the driven accelerations of a matrix (s, rows, s, columns) known: their change is 0."""
        for i in range(len(matrix) if self.driven else 0):
            matrix[i, self.driven] = 0
            matrix[:, :, i, self.driven] = 0
            matrix[i, self.driven, i, self.driven] = 1

    def start(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Solve Phi = 0, J qdd + gamma = 0 for the accelerations and multipliers at the start of the piece."""
        n, e, t = self.dynamics.size, self.size, np.array([self.piece.start])
        state = q[None], qd[None], np.zeros((1, n)), np.zeros((1, e))
        self.guide(t, *state[:3])
        (right, *_), slopes = self.linearise(t, *state)
        matrix = np.zeros((1, n + e, 1, n + e))
        matrix[0, :n, 0, :n], matrix[0, :n, 0, n:], matrix[0, n:, 0, :n] = slopes.M[0], slopes.lam[0], slopes.J[0]
        gamma = self.dynamics.kernels("loop_jacobian", q=q, qd=qd)["gamma"] if e else np.zeros(0)
        gamma = gamma + slopes.J[0] @ state[2][0]
        self.fix(matrix)
        found = -np.asarray(np.linalg.lstsq(matrix[0, :, 0], np.concatenate((right[0], gamma)), rcond=RANK)[0])
        return found[:n] + state[2][0], found[n:]


def make_alpha(dynamics: Dynamics, piece: Piece, settings: Settings) -> Scheme:
    """Unknown: qdd and lam at the step's end. `a` is the method's own acceleration, which follows qdd."""
    rho, n = settings.rho, dynamics.size
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    ratio = (1 - alpha_f) / (1 - alpha_m)  # d a / d qdd
    group = find_group(dynamics.kernels)
    loops, memory = Loops(dynamics, piece), dict[str, Array]()

    def start(q: Array, qd: Array) -> Array:
        memory["a"], memory["lam"] = loops.start(q, qd)
        return memory["a"]

    def step(state: State, time: float, h: float) -> State:
        a, end = memory["a"], np.array([time + h])

        def advance(z: Array) -> tuple[Any, Array, Array]:
            """Return q, qd, qdd and lam at the end, the method's acceleration, and the way along the group."""
            qdd = z[None, :n].copy()
            new = ((1 - alpha_f) * qdd + alpha_f * state.qdd - alpha_m * a) / (1 - alpha_m)
            way = h * (state.qd + h * ((0.5 - beta) * a + beta * new))[0]
            q = group.move(state.q, way)[None]
            qd = state.qd + h * ((1 - gamma) * a + gamma * new)
            loops.guide(end, q, qd, qdd)
            return (q, qd, qdd, z[None, n:]), new[0], way

        def correct(z: Array) -> Array:
            at, _, way = advance(z)
            (Phi, gap, _), slopes = loops.linearise(end, *at)
            by_q = np.concatenate((slopes.K[0], slopes.h[0]))
            along = by_q if group.is_flat else by_q @ dynamics.rate_slopes(at[0][0], at[1][0])[1] @ group.carry(way)
            matrix = np.zeros((1, len(z), 1, len(z)))
            matrix[0, :, 0, :n] = ratio * h * h * beta * along
            matrix[0, :n, 0, :n] += slopes.M[0] + ratio * h * gamma * slopes.C[0]
            matrix[0, :n, 0, n:] = slopes.lam[0]
            loops.fix(matrix)
            scale = np.r_[np.ones(n), np.full(len(z) - n, 1 / (beta * h * h))]
            return solve_step(scale[:, None] * matrix[0, :, 0], scale * np.concatenate((Phi[0], gap[0])))

        scale = np.r_[scale_changes(state, h), np.zeros(loops.size)]
        z = iterate(dynamics, correct, np.concatenate((state.qdd, memory["lam"])), scale, NOISE)
        (q, qd, qdd, _), memory["a"], *_ = advance(z)
        memory["lam"] = z[n:]
        return State(q[0], qd[0], qdd[0], np.stack((state.q, q[0])), np.stack((state.qd, qd[0])))

    return Scheme(start, step, np.array([0.0, 1.0]), np.array([0.5, 0.5]))


def make_radau(dynamics: Dynamics, piece: Piece, settings: Settings) -> Scheme:
    """Unknown: v', lam and mu at the stages."""
    scheme = schemes.build(schemes.Family.RADAU, settings.stages)
    A, c, s, n = scheme.integration, scheme.points, scheme.degree, dynamics.size
    places, values, loops = Places(dynamics, A, scheme.weights), extrapolate(c), Loops(dynamics, piece)
    e, memory = loops.size, dict[str, Array]()
    stepper = _make_stepper(dynamics, A) if radau.is_taken(dynamics, piece) else None

    def start(q: Array, qd: Array) -> Array:
        qdd, lam = loops.start(q, qd)
        memory["guess"] = np.tile(np.concatenate((qdd, lam, np.zeros(e))), (s, 1))
        return qdd

    def step_in_c(state: State, t: Array, h: float, weights: Array) -> State | None:
        assert stepper is not None, "C takes the model"
        z, course = memory["guess"].copy(), np.hstack(dynamics.course.states(t))
        found = stepper.step(h, piece.values(t), course, (state.q, state.qd), weights, z)
        if found is None:
            return None
        memory["guess"] = np.tile(values @ z, (s, 1))
        qdd = z[-1, :n]
        qdd[loops.driven] = dynamics.course.states(t[-1:])[2][0]
        return State(found[0][-1], found[1][-1], qdd, *found)

    def step(state: State, time: float, h: float) -> State:
        t, B = time + h * c, np.zeros((n, e))
        weights = np.r_[scale_changes(state, h), np.zeros(e), np.full(e, h)]
        if stepper is not None and (taken := step_in_c(state, t, h, weights)) is not None:
            return taken
        scale = np.tile(np.r_[np.ones(n), np.full(e, 1 / (h * h)), np.full(e, 1 / h)], s)
        if e:
            B = dynamics.kernels("loop_jacobian", q=state.q, qd=state.qd)["J"].T.copy()
        B[loops.driven] = 0

        def advance(z: Array) -> tuple[Any, Array, Array]:
            """Return q, v, v' and lam at the stages, the velocities with B mu, and q as it follows from these."""
            qdd, lam, mu = z[:, :n].copy(), z[:, n : n + e], z[:, n + e :]
            qd = state.qd + h * A @ qdd
            if loops.driven:
                qd[:, loops.driven] = dynamics.course.states(t)[1]
            moving = qd + mu @ B.T
            free = places.stages(state.q, moving, h)
            q = free.copy()
            loops.guide(t, q, qd, qdd)
            return (q, qd, qdd, lam), moving, free

        def correct(z: Array) -> Array:
            at, moving, free = advance(z)
            residuals, slopes = loops.linearise(t, *at)
            by_q = np.concatenate((slopes.K, slopes.h, slopes.hd_q), axis=1)
            by_moving = places.stiffen(by_q, free, moving, h)  # (s, s, n + 2 e, n)
            matrix = np.zeros((s, n + 2 * e, s, n + 2 * e))
            matrix[..., n + e :] = np.einsum("ijab,be->iaje", by_moving, B)
            by_moving[range(s), range(s)] += np.concatenate((slopes.C, np.zeros((s, e, n)), slopes.J), axis=1)
            matrix[..., :n] = h * np.einsum("ijab,jk->iakb", by_moving, A)
            matrix[range(s), :n, range(s), :n] += slopes.M
            matrix[range(s), :n, range(s), n : n + e] = slopes.lam
            loops.fix(matrix)
            right = np.concatenate(residuals, axis=1).ravel()
            return solve_step(scale[:, None] * matrix.reshape(scale.size, -1), scale * right).reshape(s, -1)

        z = iterate(dynamics, correct, memory["guess"], weights, NOISE)
        (q, qd, qdd, _), *_ = advance(z)
        memory["guess"] = np.tile(values @ z, (s, 1))
        return State(q[-1], qd[-1], qdd[-1], q, qd)

    return Scheme(start, step, c, scheme.weights)


def _make_stepper(dynamics: Dynamics, A: Array) -> radau.Stepper:
    """Make the steps in C of a method, once for all pieces."""
    if "stepper" not in dynamics.kept:
        dynamics.kept["stepper"] = radau.Stepper(dynamics, A, (CONVERGED, NOISE, ITERATIONS))
    stepper: radau.Stepper = dynamics.kept["stepper"]
    return stepper


def _pick(blocks: Mapping[str, Array], result: str, by: str, shape: tuple[int, ...]) -> Array:
    """Return a derivative among a kernel's results; a block without an entry is 0."""
    found = blocks.get(name_derivative(result, by))
    return np.zeros(shape) if found is None else found


def solve_step(matrix: Array, right: Array) -> Array:
    """Return the Newton step -matrix^-1 right; of a singular matrix, the one of least norm."""
    try:
        return -np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return -np.asarray(np.linalg.lstsq(matrix, right, rcond=RANK)[0])
