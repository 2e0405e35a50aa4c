"""Derivatives by the state of accelerations, forces, guards and impacts of rigid contacts.

A point at rest along the other side has a force R (3,) that holds S qd = 0, with S its Jacobian. One that slips along w
has the force N (n - mu w), with N holding n S qd = 0. The equations of `variation` then have the rows

    S qdd + drift, or n (S qdd + drift) + nd v,    drift = (dS/dq E qd) qd,    v = S qd

whose derivatives contain second derivatives of S along the motion alone: a difference of order 8 of the exact first
ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.contacts import Contacts, Loads, Mode, State, Touch, find_way, span
from mbsrun.simulation.integration.touching import Bound, Guard, Passage, Strike
from mbsrun.simulation.motion import Segment
from mbsrun.simulation.variation import RANK, SHIFT, Crossing, Field, SlopeError, border, weigh

Array = NDArray[np.float64]

STEP = 1e-3  # rad, m: of the difference
WEIGHTS = np.array([672.0, -168.0, 32.0, -3.0]) / 840  # of differences over 2 STEP, 4 STEP ...
STRAIGHT = 1e-12  # of the derivatives of a velocity: what is less across the slip is rounding


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of points in K states."""

    gap: Array  # (K, P, nq)
    normal: Array  # (K, P, 3, nq)
    slide: Array  # (K, P, 3, n, nq)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The equations of a mode: forces lam (r,) along G, and rows J a + b, with derivatives by the state; K states."""

    G: Array  # (K, n, r)
    J: Array  # (K, r, n)
    push: Array  # (K, n, N): derivative of G lam
    ends: Array  # (K, r, N): derivative of J a + b
    first: dict[int, int]  # of each point, the first of its rows


class ContactField(Field):
    """Points that touch, slip, stick and leave."""

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__(dynamics)
        self.contacts = Contacts(self.dynamics)

    # --- points ---

    def vary(self, q: Array) -> Slopes:
        """Differentiate the points in states (K, nq)."""
        found, K, points, n = (
            self.dynamics.kernels("jac_touching", q=q),
            len(q),
            len(self.contacts.names),
            self.dynamics.size,
        )
        return Slopes(
            found["jac_clearance_q"].reshape(K, points, -1),
            found["jac_direction_q"].reshape(K, points, 3, -1),
            found["jac_slide_q"].reshape(K, n, points, 3, -1).transpose(0, 2, 3, 1, 4),
        )

    def vary_along(self, q: Array, rate: Array) -> tuple[Array, Array]:
        """Return the rates of `normal` and `slide` of the derivatives while q moves with `rate`, (K, nq) both."""
        length = STEP / np.maximum(np.abs(rate).max(axis=1, keepdims=True), 1e-300)
        normal, slide = 0.0, 0.0
        for k, weight in enumerate(WEIGHTS, start=1):
            ahead, behind = (self.vary(q + sign * k * length * rate) for sign in (1, -1))
            normal = normal + weight * (ahead.normal - behind.normal)
            slide = slide + weight * (ahead.slide - behind.slide)
        inverse = 1 / length[:, :, None, None]
        moving = (np.abs(rate).max(axis=1) > 0)[:, None, None, None]
        return (
            np.where(moving, inverse * normal, 0.0),
            np.where(moving[..., None], inverse[..., None] * slide, 0.0),
        )

    # --- between events ---

    def accelerate(self, t: Array, q: Array, qd: Array, piece: Piece, segment: Segment) -> tuple[Array, Array]:
        """Return accelerations, and their derivatives by the state."""
        qdd, by_x, _, _ = self.solve(t, q, qd, piece, find_passage(segment).mode)
        return qdd, by_x

    def solve(self, t: Array, q: Array, qd: Array, piece: Piece, mode: Mode) -> tuple[Array, Array, Loads, Array]:
        """Return the same, and the forces on points (K, P, 3), with their derivatives (K, P, 3, N)."""
        contacts, v, points = self.contacts, piece.values(t), len(self.contacts.names)
        touch, (M, free) = contacts.touch(q, qd), contacts.find_free(q, qd, v)
        loads = contacts.load(touch, M, free, mode)
        Kq, C, M = self.dynamics.stiffnesses(q, qd, loads.qdd, v)
        right = -np.concatenate((Kq, C), axis=2)
        none = np.zeros((len(t), points, 3, self.size))
        if not mode.closed:
            return loads.qdd, np.asarray(np.linalg.solve(M, right)), loads, none
        slopes = self.vary(q)
        units, turns = self.find_units(touch, slopes, qd, mode)
        rows = self.list_rows(touch, slopes, loads, mode, units, turns)
        rows = self.add_ends(rows, touch, slopes, loads, mode, q, qd)
        self.check(M, rows, mode)
        by_x, lam = border(M, rows.G, rows.J, right + rows.push, -rows.ends)
        return loads.qdd, by_x, loads, self.vary_forces(lam, rows, loads, mode, units, turns, none)

    def check(self, M: Array, rows: _Rows, mode: Mode) -> None:
        """Check that slipping points share their load in one way. Raises SlopeError."""
        rubbing = any(mode.states[k] == State.SLIP and self.contacts.coefficient[k] > 0 for k in mode.closed)
        if not (rubbing and rows.first):
            return
        sizes = np.linalg.svd(rows.J @ np.linalg.solve(M, rows.G), compute_uv=False)
        if (sizes[:, -1] <= RANK * sizes[:, 0]).any():
            raise SlopeError("points that slip share their load in several ways")

    def find_units(self, touch: Touch, slopes: Slopes, qd: Array, mode: Mode) -> tuple[Array, Array]:
        """Return the directions n - mu w of forces (K, P, 3), and their derivatives by the state (K, P, 3, N)."""
        units = touch.normal.copy()
        turns = np.zeros((*units.shape, self.size))
        turns[..., : self.places] = slopes.normal
        for k in mode.closed:
            mu = float(self.contacts.coefficient[k])
            if mode.states[k] == State.SLIP and mu > 0:
                units[:, k] -= mu * find_way(touch, mode, k)
                turns[:, k] -= mu * self.turn(touch, slopes, qd, mode, k)
        return units, turns

    def turn(self, touch: Touch, slopes: Slopes, qd: Array, mode: Mode, k: int) -> Array:
        """Return the derivative by the state of the way in which a point slips, (K, 3, N)."""
        n, n_q = touch.normal[:, k], slopes.normal[:, k]
        way, size = find_way(touch, mode, k), np.linalg.norm(touch.slip[:, k], axis=1)
        found = np.zeros((len(n), 3, self.size))
        found[..., : self.places] = -n[:, :, None] * np.einsum("ki,kiq->kq", way, n_q)[:, None]
        across = np.cross(n, way)
        velocity = np.concatenate((np.einsum("kinq,kn->kiq", slopes.slide[:, k], qd), touch.slide[:, k]), axis=2)
        side = np.einsum("ki,kiN->kN", across, velocity)
        speed = touch.speed[:, k]
        side[:, : self.places] -= speed[:, None] * np.einsum("ki,kiq->kq", across, n_q)
        side = np.where(np.abs(side) <= STRAIGHT * np.abs(velocity).max(axis=(1, 2))[:, None], 0.0, side)
        is_turning = side.any(axis=1)
        if (is_turning & (size <= STRAIGHT * np.abs(touch.velocity).max(initial=1e-300))).any():
            raise SlopeError(f"contact {self.contacts.names[k]} begins to slip, in one of many directions")
        sign = np.where((touch.slip[:, k] * way).sum(axis=1) < 0, -1.0, 1.0)
        turned = np.where(is_turning, sign / np.maximum(size, 1e-300), 0.0)
        return np.asarray(found + across[:, :, None] * (turned[:, None] * side)[:, None])

    def list_rows(self, touch: Touch, slopes: Slopes, loads: Loads, mode: Mode, units: Array, turns: Array) -> _Rows:
        """List the rows of points that have forces, with the derivatives of these."""
        G, J, first = list[Array](), list[Array](), dict[int, int]()
        push, count = np.zeros((len(touch.gap), self.dynamics.size, self.size)), 0
        for k in mode.closed:
            S, S_q, n = touch.slide[:, k], slopes.slide[:, k], touch.normal[:, k]
            force = loads.normal[:, k, None] * n + loads.friction[:, k]
            push[..., : self.places] += np.einsum("kinq,ki->knq", S_q, force)
            if not self.sticks(mode, k):
                push += np.einsum("kin,kiN->knN", S, turns[:, k]) * loads.normal[:, k, None, None]
            if k in mode.leaving and not self.sticks(mode, k):
                continue
            first[k] = count
            if k in mode.leaving:  # held across the normal alone
                across = np.stack(span(n), axis=1)
                G.append(np.einsum("kin,kti->knt", S, across))
                J.append(G[-1].swapaxes(1, 2))
                turned = loads.normal[:, k, None, None] * slopes.normal[:, k]
                turned = (
                    turned - n[:, :, None] * np.einsum("ki,kiq->kq", loads.friction[:, k], slopes.normal[:, k])[:, None]
                )
                push[..., : self.places] += np.einsum("kin,kiq->knq", S, turned)
            elif self.sticks(mode, k):
                G.append(S.swapaxes(1, 2))
                J.append(S)
            else:
                G.append(np.einsum("kin,ki->kn", S, units[:, k])[..., None])
                J.append(np.einsum("kin,ki->kn", S, n)[:, None])
            count += J[-1].shape[1]
        K, size = len(touch.gap), self.dynamics.size
        joined = (
            np.concatenate((np.zeros((K, size, 0)), *G), axis=2),
            np.concatenate((np.zeros((K, 0, size)), *J), axis=1),
        )
        return _Rows(*joined, push, np.zeros((K, count, self.size)), first)

    def sticks(self, mode: Mode, k: int) -> bool:
        """Return whether a point is held along the other side, too."""
        return mode.states[k] == State.STICK and bool(self.contacts.coefficient[k] > 0)

    def add_ends(
        self, rows: _Rows, touch: Touch, slopes: Slopes, loads: Loads, mode: Mode, q: Array, qd: Array
    ) -> _Rows:
        """Add the derivatives of the accelerations of points."""
        places, rate = self.places, self.dynamics.rates(q, qd)
        r_q, r_qd = self.dynamics.rate_slopes(q, qd)
        normals, slides = self.vary_along(q, rate)
        for k, row in rows.first.items():
            S, S_q = touch.slide[:, k], slopes.slide[:, k]
            along = np.einsum("kinq,kn->kiq", S_q, qd)  # of v by q
            motion = np.einsum("kin,kn->ki", S, loads.qdd) + touch.drift[:, k]
            turn = np.concatenate(
                (
                    np.einsum("kinq,kn->kiq", S_q, loads.qdd)
                    + np.einsum("kinq,kn->kiq", slides[:, k], qd)
                    + along @ r_q,
                    np.einsum("kinq,kq->kin", S_q, rate) + along @ r_qd,
                ),
                axis=2,
            )
            if self.sticks(mode, k):
                rows.ends[:, row : row + 3] = turn
                continue
            n, n_q, v = touch.normal[:, k], slopes.normal[:, k], touch.velocity[:, k]
            nd = np.einsum("kiq,kq->ki", n_q, rate)
            end = np.einsum("ki,kiN->kN", n, turn) + np.einsum("ki,kiN->kN", nd, np.concatenate((along, S), axis=2))
            end[:, :places] += np.einsum("ki,kiq->kq", motion, n_q)
            end[:, :places] += np.einsum("ki,kiq->kq", v, normals[:, k] + n_q @ r_q)
            end[:, places:] += np.einsum("ki,kin->kn", v, n_q @ r_qd)
            rows.ends[:, row] = end
        return rows

    def vary_forces(
        self, lam: Array, rows: _Rows, loads: Loads, mode: Mode, units: Array, turns: Array, found: Array
    ) -> Array:
        """Return the derivatives of forces on points, (K, P, 3, N)."""
        for k, row in rows.first.items():
            if self.sticks(mode, k):
                found[:, k] = lam[:, row : row + 3]
            else:
                found[:, k] = units[:, k, :, None] * lam[:, row, None] + loads.normal[:, k, None, None] * turns[:, k]
        return found

    def restrain(self, q: Array, qd: Array, segment: Segment) -> tuple[Array, Array, Array, Array]:
        """Return the rows that hold points that touch."""
        mode, touch, slopes = find_passage(segment).mode, self.contacts.touch(q, qd), self.vary(q)
        J, by_q = [np.zeros((0, self.dynamics.size))], [np.zeros((0, self.places))]
        H, closed = [np.zeros((0, self.dynamics.size))], mode.closed
        for k in closed:
            S, n = touch.slide[0, k], touch.normal[0, k]
            along = np.einsum("inq,n->iq", slopes.slide[0, k], qd[0])
            H.append((n @ S)[None])
            if self.sticks(mode, k):
                J.append(S)
                by_q.append(along)
            else:
                J.append((n @ S)[None])
                by_q.append((n @ along + touch.velocity[0, k] @ slopes.normal[0, k])[None])
        return np.concatenate(J), np.concatenate(by_q), np.concatenate(H), slopes.gap[0, closed]

    # --- events ---

    def has_guards(self, segment: Segment) -> bool:
        """Return whether a guard fell to 0 before the steps."""
        return bool(find_passage(segment).guards)

    def list_crossings(
        self, time: float, before: Array, after: Array, piece: Piece, old: Segment, new: Segment
    ) -> list[Crossing]:
        """Describe the guards of an event."""
        q, qd = np.split(after[None], [self.places], axis=1)
        speeds = self.contacts.touch(q, qd).speed[0]
        return [
            Crossing(
                *self.slope(time, guard, before, piece, find_passage(old).mode),
                ("stop " if self.dynamics.kernels.manifest.rigid[guard.point].is_stop else "contact ")
                + self.contacts.names[guard.point],
                guard.point,
                abs(float(speeds[guard.point])) if guard.bound is Bound.GAP else None,
            )
            for guard in find_passage(new).guards
        ]

    def slope(self, time: float, guard: Guard, x: Array, piece: Piece, mode: Mode) -> tuple[Array, float]:
        """Return the derivative (N,) of a guard's number by the state, and by the time at a constant state."""
        k, (q, qd) = guard.point, np.split(x[None], [self.places], axis=1)
        found = np.zeros(self.size)
        slopes, touch = self.vary(q), self.contacts.touch(q, qd)
        if guard.bound is Bound.GAP:
            found[: self.places] = slopes.gap[0, k]
            return found, 0.0
        if guard.bound is Bound.SLIP:
            found[: self.places] = mode.ways[k] @ np.einsum("inq,n->iq", slopes.slide[0, k], qd[0])
            found[self.places :] = mode.ways[k] @ touch.slide[0, k]
            return found, 0.0
        self._check_alone(q, qd, piece.values(np.array([time])), touch, mode)
        _, _, loads, forces = self.solve(np.array([time]), q, qd, piece, mode)
        n, N, T, mu = touch.normal[0, k], loads.normal[0, k], loads.friction[0, k], float(self.contacts.coefficient[k])
        force = N * n + T
        press = n @ forces[0, k]
        press[: self.places] += force @ slopes.normal[0, k]
        times = (np.array([time + shift]) for shift in (-SHIFT, SHIFT))
        if guard.bound is Bound.PRESS:
            near = [float(self.solve(t, q, qd, piece, mode)[2].normal[0, k]) for t in times]
            return press, (near[1] - near[0]) / (2 * SHIFT)
        turned = np.zeros((3, self.size))
        turned[:, : self.places] = slopes.normal[0, k]
        size = float(np.linalg.norm(T))
        across = T @ (forces[0, k] - n[:, None] * press - N * turned) / max(size, 1e-300)
        rest = list[float]()
        for t in times:
            other = self.solve(t, q, qd, piece, mode)[2]
            rest.append(float(mu * other.normal[0, k] - np.linalg.norm(other.friction[0, k])))
        return mu * press - across, (rest[1] - rest[0]) / (2 * SHIFT)

    def _check_alone(self, q: Array, qd: Array, v: Array, touch: Touch, mode: Mode) -> None:
        """Check that the forces on points are determined. Raises SlopeError."""
        J = np.concatenate(
            [
                touch.slide[0, k] if self.sticks(mode, k) else (touch.normal[0, k] @ touch.slide[0, k])[None]
                for k in mode.closed
            ]
        )
        M = self.dynamics.mass_matrix(q, qd, v)[0]
        J = J[np.abs(J).max(axis=1) > 1e-12 * np.abs(J).max()]
        sizes = np.linalg.svd(J @ np.linalg.solve(M, J.T), compute_uv=False)
        if sizes[-1] <= RANK * sizes[0]:
            raise SlopeError("points share their load in several ways")

    def strike(self, segment: Segment, _: Array) -> Array | None:
        """Return the derivative of the state after impacts by the state before."""
        strikes = find_passage(segment).strikes
        if not strikes:
            return None
        R, normal = np.eye(self.size), np.zeros((len(self.contacts.names), self.size))
        for strike in strikes:
            after, normal = self._strike(strike, R, normal)
            R = np.vstack((R[: self.places], after))
        return R

    def _strike(self, strike: Strike, R: Array, given: Array) -> tuple[Array, Array]:
        """Return the derivatives of the velocities (n, N) and normal impulses (P, N) of a phase.

        `R` (N, N) are the derivatives of the state before it, and `given` these of the impulses of the phase before.
        """
        q, mode, loads, places = strike.q[None], strike.mode, strike.loads, self.places
        after, before = loads.qdd, strike.before[None]
        slopes, touch = self.vary(q), self.contacts.touch(q, after)
        moved, M = weigh(self.dynamics, q, after - before)
        units, turns = self.find_units(touch, slopes, after, mode)
        rows = self.list_rows(touch, slopes, loads, mode, units, turns)
        self._add_speeds(rows, strike, touch, slopes)
        self.check(M[None], rows, mode)
        left = M - rows.push[0][:, places:]  # the way of a slip is the one after the impact
        top = np.hstack((rows.push[0][:, :places] - moved, M)) @ R
        normal = np.zeros_like(given)
        for k in mode.leaving:
            assert strike.leaving is not None, "points leave in the second phase"
            normal[k] = strike.leaving[k] * given[k]
            unit = touch.normal[0, k] if self.sticks(mode, k) else units[0, k]
            top += np.outer(touch.slide[0, k].T @ unit, normal[k])
        found, lam = (x[0] for x in border(left[None], rows.G, rows.J, top[None], -rows.ends @ R))
        for k, row in rows.first.items():
            if k in mode.leaving:
                continue
            if self.sticks(mode, k):
                force = loads.normal[0, k] * touch.normal[0, k] + loads.friction[0, k]
                normal[k] = touch.normal[0, k] @ lam[row : row + 3] + force @ slopes.normal[0, k] @ R[:places]
            else:
                normal[k] = lam[row]
        return found, normal

    def _add_speeds(self, rows: _Rows, strike: Strike, touch: Touch, slopes: Slopes) -> None:
        """Add the derivatives of velocities after an impact, less the goals, by q and by velocities before."""
        old = self.contacts.touch(strike.q[None], strike.before[None])
        for k, row in rows.first.items():
            e, n, n_q = float(strike.restitution[k]), touch.normal[0, k], slopes.normal[0, k]
            along = [np.einsum("inq,n->iq", slopes.slide[0, k], x) for x in (strike.loads.qdd[0], strike.before)]
            speed = np.concatenate((old.velocity[0, k] @ n_q + n @ along[1], n @ touch.slide[0, k]))
            if k in strike.mode.leaving:
                across = np.stack(span(n[None]), axis=1)[0]
                rows.ends[0, row : row + 2, : self.places] = across @ (along[0] - float(touch.speed[0, k]) * n_q)
            elif self.sticks(strike.mode, k):
                rows.ends[0, row : row + 3, : self.places] = along[0] + e * float(old.speed[0, k]) * n_q
                rows.ends[0, row : row + 3] += e * np.outer(n, speed)
            else:
                rows.ends[0, row, : self.places] = n @ along[0] + touch.velocity[0, k] @ n_q
                rows.ends[0, row] += e * speed


def find_passage(segment: Segment) -> Passage:
    """Return how a model with rigid contacts came into its mode."""
    assert isinstance(segment.passage, Passage), "the steps belong to rigid contacts"
    return segment.passage
