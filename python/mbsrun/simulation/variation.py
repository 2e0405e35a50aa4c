"""Derivatives by the state of accelerations, forces, guards and impacts, of joints that stop, slide and stick in loops.

The equations of a mode and their derivatives have one form. With forces lam that hold rows J a + b = 0,

    M a + c = G lam:    M da - G dlam = -d(M a + c - G lam),    J da = -d(J a + b),

where the right sides are taken at constant a and lam. The rows are the equations of loops, of joints at rest, and of
driven ones. An impact has velocities for a, impulses for lam, and M (a - before) in place of M a + c.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsrun.closure import Closure
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.joints import Joints, are_held
from mbsrun.simulation.motion import FORCE, PLACE, SPEED, Guard, Jump, Segment

Array = NDArray[np.float64]

RANK = 1e-10  # of the singular values of J M^-1 G: smaller ones are 0
SHIFT = 1e-6  # s: of central differences of inputs over time


class SlopeError(MbsError):
    """A motion that has no derivative."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """A guard at its event: its derivatives by the state (N,) and by the time, and what it guards."""

    slope: Array
    drift: float
    name: str  # in words
    key: int  # of the joint or point
    rebound: float | None  # the speed after an impact; None: the guard is of another kind


class Field(ABC):
    """The rates of the state (q, qd) in a mode, with their derivatives, and what happens at events."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = replace(dynamics, formulation=Formulation.SEMI)
        self.places, self.size = dynamics.places, dynamics.places + dynamics.size

    def at(self, t: Array, x: Array, piece: Piece, segment: Segment) -> tuple[Array, Array]:
        """Return the rates (k, N) at states (k, N), and their derivatives (k, N, N)."""
        q, qd = np.split(x, [self.places], axis=1)
        qdd, by_x = self.accelerate(t, q, qd, piece, segment)
        upper = np.concatenate(self.dynamics.rate_slopes(q, qd), axis=2)
        return np.hstack((self.dynamics.rates(q, qd), qdd)), np.concatenate((upper, by_x), axis=1)

    def project(self, x: Array, segment: Segment) -> Array:
        """Return the derivative (N, N) of the state that keeps the equations of a mode by a state (N,) near it."""
        q, qd = np.split(x[None], [self.places], axis=1)
        J, by_q, H, h_q = self.restrain(q, qd, segment)
        E = self.dynamics.rate_slopes(q, qd)[1][0]
        found = np.eye(self.size)
        found[: self.places, : self.places] -= E @ np.linalg.pinv(H, rcond=RANK) @ h_q
        found[self.places :] -= np.linalg.pinv(J, rcond=RANK) @ (np.hstack((by_q, J)) @ found)
        return found

    @abstractmethod
    def accelerate(self, t: Array, q: Array, qd: Array, piece: Piece, segment: Segment) -> tuple[Array, Array]:
        """Return accelerations (k, n), and their derivatives by the state (k, n, N). Raises SlopeError."""

    @abstractmethod
    def restrain(self, q: Array, qd: Array, segment: Segment) -> tuple[Array, Array, Array, Array]:
        """Return the rows J of J qd = 0, the derivative of J qd by q, and the same of positions, by qd and by q."""

    @abstractmethod
    def has_guards(self, segment: Segment) -> bool:
        """Return whether a guard fell to 0 before the steps."""

    @abstractmethod
    def list_crossings(
        self, time: float, before: Array, after: Array, piece: Piece, old: Segment, new: Segment
    ) -> list[Crossing]:
        """Describe the guards of an event."""

    @abstractmethod
    def strike(self, segment: Segment, before: Array) -> Array | None:
        """Return the derivative (N, N) of the state after impacts by the state before; None where there was none."""


def border(M: Array, G: Array, J: Array, top: Array, low: Array) -> tuple[Array, Array]:
    """Solve M a - G lam = top, J a = low, for (k, n, m) and (k, r, m); where lam is not unique, return the least."""
    if not J.shape[1]:
        return np.asarray(np.linalg.solve(M, top)), np.zeros((len(M), 0, top.shape[2]))
    response, free = np.linalg.solve(M, G), np.linalg.solve(M, top)
    lam = np.linalg.pinv(J @ response, rcond=RANK) @ (low - J @ free)
    return np.asarray(free + response @ lam), np.asarray(lam)


class JointField(Field):
    """Joints with stops and dry friction, in trees and loops, beside driven ones."""

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__(dynamics)
        self.joints, self.closure = Joints.of(dynamics.kernels.manifest), Closure(dynamics.kernels)

    def accelerate(self, t: Array, q: Array, qd: Array, piece: Piece, segment: Segment) -> tuple[Array, Array]:
        """Return accelerations, and their derivatives by the state."""
        qdd, by_x, _, _ = self.solve(t, q, qd, piece, segment)
        return qdd, by_x

    def solve(self, t: Array, q: Array, qd: Array, piece: Piece, segment: Segment) -> tuple[Array, Array, Array, Array]:
        """Return the same, and the forces (k, held) on held and driven joints, with their derivatives."""
        dynamics, closure, v, K = self.dynamics, self.closure, piece.values(t), len(t)
        held, signs, loops = self.list_held(segment), self.find_signs(segment), closure.count
        rest, none = np.zeros_like(qd), np.zeros((K, loops)) if loops else None
        units = np.zeros((K, dynamics.size, len(held)))
        units[:, held, np.arange(len(held))] = 1.0
        M = dynamics.mass_matrix(q, qd, v)
        J = np.concatenate((closure.jacobian(q), units.swapaxes(1, 2)), axis=1)
        G = J.swapaxes(1, 2)
        push = self.find_constant_forces(segment) - signs * self.joints.rub(qd)
        right = push - dynamics.residual(q, qd, rest, v, none)
        goal = np.concatenate((-closure.bias(q, qd), self.course(t)[:, held]), axis=1)
        qdd, lam = (x[:, :, 0] for x in border(M, G, J, right[..., None], goal[..., None]))
        Kq, C, M = dynamics.stiffnesses(q, qd, qdd, v, lam[:, :loops] if loops else None)
        C = C + (signs * self.joints.steepen(qd))[:, :, None] * np.eye(dynamics.size)
        turn = self.vary_loops(q, qd, qdd)
        low = np.concatenate((turn, np.zeros((K, len(held), self.size))), axis=1)
        by_x, slopes = border(M, G, J, -np.concatenate((Kq, C), axis=2), -low)
        return qdd, by_x, lam[:, loops:], slopes[:, loops:]

    def vary_loops(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the derivatives of J qdd + gamma by the state, (k, e, N)."""
        if not self.closure.count:
            return np.zeros((len(q), 0, self.size))
        found = self.dynamics.kernels("jac_loop_accelerations", q=q, qd=qd, qdd=qdd)
        return np.concatenate((found["jac_hdd_q"], found["jac_hdd_qd"]), axis=2)

    def course(self, t: Array) -> Array:
        """Return the accelerations of driven joints, and 0 for others, (k, n)."""
        found = np.zeros((len(t), self.dynamics.size))
        if self.joints.driven:
            found[:, self.joints.driven] = self.dynamics.course.states(t)[2]
        return found

    def list_held(self, segment: Segment) -> list[int]:
        """List the joints whose forces follow from their accelerations; others at rest stand with them."""
        resting = np.flatnonzero(are_held(segment.modes)) if segment.locking is None else segment.locking
        return sorted({*map(int, resting), *self.joints.driven})

    def find_signs(self, segment: Segment) -> NDArray[np.int_]:
        """Return the ways in which joints slide, (n,)."""
        modes = np.array(segment.modes, dtype=np.int_)
        return np.where(np.abs(modes) == 1, modes, 0)

    def find_constant_forces(self, segment: Segment) -> Array:
        """Return the forces on joints at rest that stay as they are, (n,)."""
        if segment.locking is None:
            return np.zeros(self.dynamics.size)
        constant = are_held(segment.modes)
        constant[list(segment.locking)] = False
        return np.where(constant, np.array(segment.forces), 0.0)

    def restrain(self, q: Array, qd: Array, segment: Segment) -> tuple[Array, Array, Array, Array]:
        """Return the rows that hold velocities and positions of loops, joints at rest and driven ones."""
        held, driven, n = self.list_held(segment), self.joints.driven, self.dynamics.size
        still = np.eye(n)[sorted({*held, *np.flatnonzero(are_held(segment.modes)).tolist()})]
        J = np.concatenate((self.closure.jacobian(q)[0], still))
        by_q, h_q = np.zeros((len(J), self.places)), np.zeros((0, self.places))
        if self.closure.count:
            by_q[: self.closure.count] = self.dynamics.kernels("jac_loop_rates", q=q, qd=qd)["jac_hd_q"][0]
            h_q = self.dynamics.kernels("jac_loops", q=q)["jac_gap_q"][0]
        own = np.eye(self.places)[[self.joints.place[i] for i in driven]]
        H = np.concatenate((self.closure.jacobian(q)[0], np.eye(n)[driven]))
        return J, by_q, H, np.concatenate((h_q, own))

    def has_guards(self, segment: Segment) -> bool:
        """Return whether a guard fell to 0 before the steps."""
        return bool(segment.guards)

    def list_crossings(
        self, time: float, before: Array, after: Array, piece: Piece, old: Segment, new: Segment
    ) -> list[Crossing]:
        """Describe the guards of an event."""
        names = [c.name for c in self.joints.manifest.coordinates]
        return [
            Crossing(
                *self.slope(time, guard, before, piece, old),
                f"joint {names[guard.joint]}",
                guard.joint,
                abs(float(after[self.places + guard.joint])) if guard.kind == PLACE else None,
            )
            for guard in new.guards
        ]

    def slope(self, time: float, guard: Guard, x: Array, piece: Piece, segment: Segment) -> tuple[Array, float]:
        """Return the derivative (N,) of a guard's number by the state, and by the time at a constant state."""
        found = np.zeros(len(x))
        if guard.kind != FORCE:
            found[self.places + guard.joint if guard.kind == SPEED else guard.place] = 1.0
            return found, 0.0
        held = self.list_held(segment)
        if guard.joint not in held:
            raise SlopeError("joints share their load anew")
        row = held.index(guard.joint)
        at = (x[None, : self.places], x[None, self.places :], piece, segment)
        found = self.solve(np.array([time]), *at)[3][0, row]
        near = [float(self.solve(np.array([time + shift]), *at)[2][0, row]) for shift in (-SHIFT, SHIFT)]
        return found, (near[1] - near[0]) / (2 * SHIFT)

    def strike(self, segment: Segment, before: Array) -> Array | None:
        """Return the derivative of the state after impacts by the state before."""
        R = None
        for jump in segment.jumps:
            own = self._strike(before[: self.places], jump)
            R = own if R is None else own @ R
        return R

    def _strike(self, q: Array, jump: Jump) -> Array:
        """Return the derivative (N, N) of the state after an impact by the state before.

        M (after - before) = impulses of loops, of driven joints and of joints that hit; after = -restitution before in
        these, and driven joints do not change.
        """
        n, hit, driven = self.dynamics.size, list(jump.joints), self.joints.driven
        place, closure, change = q[None], self.closure, (jump.after - jump.before)[None]
        moved, M = self._weigh(place, change)
        stops = np.eye(n)[[*hit, *driven]]
        J = np.concatenate((closure.jacobian(place)[0], stops))
        by_q, by_before = np.zeros((len(J), self.places)), np.zeros((len(J), n))
        e = closure.count
        by_before[e + np.arange(len(hit)), hit] = jump.restitution
        by_before[e + len(hit) + np.arange(len(driven)), driven] = -1.0
        if e:
            impulses = np.linalg.lstsq(J.T, M @ change[0], rcond=RANK)[0]
            by_q[:e] = self.dynamics.kernels("jac_loop_rates", q=place, qd=jump.after[None])["jac_hd_q"][0]
            moved -= self.dynamics.kernels("jac_loop_forces", q=place, lam=impulses[None, :e])["jac_Q_q"][0]
        top, low = np.hstack((-moved, M)), -np.hstack((by_q, by_before))
        found = np.eye(self.size)
        found[self.places :] = border(M[None], J.T[None], J[None], top[None], low[None])[0][0]
        return found

    def _weigh(self, q: Array, change: Array) -> tuple[Array, Array]:
        return weigh(self.dynamics, q, change)


def weigh(dynamics: Dynamics, q: Array, change: Array) -> tuple[Array, Array]:
    """Return the derivative of M change by q, (n, nq), and M, at one pose (1, nq) for a change (1, n)."""
    manifest, rest = dynamics.kernels.manifest, np.zeros_like(change)
    v, lam = np.zeros((1, len(manifest.inputs))), np.zeros((1, len(manifest.owners))) if manifest.owners else None
    moved, _, M = dynamics.stiffnesses(q, rest, change, v, lam)
    still = dynamics.stiffnesses(q, rest, rest, v, lam)[0]
    return (moved - still)[0], M[0]
