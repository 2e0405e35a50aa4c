"""Derivatives of a motion by its start, through stops and dry friction.

Within a mode the derivative X = dx/dx0 of the state x = (q, qd) obeys the method's own steps, differentiated: of stages
k_i = f(y_i), y_i = x + h sum_j A_ij k_j,

    K_i = f_x(y_i) (X + h sum_j A_ij K_j),    X(t + h) = X + h sum_i b_i K_i.

An event has a guard g(x, t) = 0, and a jump x+ = R(x). Its time depends on the start too, which the saltation matrix
counts (Aizerman, Gantmacher, "On the stability of periodic motions", J. Appl. Math. Mech. 22 (1958); Leine, Nijmeijer,
"Dynamics and bifurcations of non-smooth mechanical systems" (2004), section 7.3):

    X+ = (R_x + (f+ - R_x f-) g_x / (g_x f- + g_t)) X-

The derivative holds while a small change of the start leaves the order of events. Where the guard's rate is 0, at a
grazing event, and where several guards meet, there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Manifest
from mbsrun.kernel import Kernels
from mbsrun.simulation.drive import Drive, Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.joints import HELD, Joints
from mbsrun.simulation.integration.methods import METHODS
from mbsrun.simulation.integration.tableaus import DOP853, EULER, RK4, RK45, Pair
from mbsrun.simulation.motion import FORCE, PLACE, SPEED, Chunk, Guard, Jump, Motion, Segment, Settings
from mbsrun.simulation.simulate import simulate

Array = NDArray[np.float64]

PAIRS = {"euler": EULER, "rk4": RK4, "rk45": RK45, "dop853": DOP853}
GRAZING = 1e6  # an event that makes more of a small change of the state grazes
RETURN = 0.1  # of a rebound's velocity: a joint that comes back as fast did not graze
SHIFT = 1e-6  # s: of central differences of inputs over time


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """A motion with the derivative of its end by its start."""

    motion: Motion
    slopes: Array  # (nq + n, nq + n): of q, qd at the end, by q, qd at the start; NaN where there is a finding
    finding: str | None  # why there is no derivative


def differentiate(kernels: Kernels, drive: Drive, q: ArrayLike, qd: ArrayLike, settings: Settings) -> Sensitivity:
    """Integrate a motion as `simulate` does, by an explicit method, with the derivative of its end by its start.

    Raises ValueError for loops, driven joints, rigid contacts, inputs that follow the state, and other methods.
    """
    _check(kernels.manifest, drive, settings)
    watcher = _Watcher(kernels, PAIRS[settings.method])
    motion = simulate(kernels, drive, q, qd, settings, watch=watcher.add)
    finding = watcher.finding if motion.halt is None else str(motion.halt)
    slopes = watcher.X if finding is None else np.full_like(watcher.X, np.nan)
    return Sensitivity(motion, slopes, finding)


def _check(manifest: Manifest, drive: Drive, settings: Settings) -> None:
    if settings.method not in PAIRS:
        raise ValueError(f"{settings.method} is not differentiated; give one of {', '.join(PAIRS)}")
    if manifest.loops or manifest.driven or manifest.rigid:
        raise ValueError("loops, driven joints and rigid contacts are not differentiated; take them away")
    if drive.control is not None:
        raise ValueError("inputs that follow the state are not differentiated; give them over time")
    assert METHODS[settings.method].stability is not None, "the methods are explicit"


class _Watcher:
    """Carries the derivative along the steps of a motion."""

    def __init__(self, kernels: Kernels, pair: Pair) -> None:
        self.field, self.tableau = _Field(kernels), pair.tableau
        size = len(kernels.manifest.positions) + len(kernels.manifest.coordinates)
        self.X = np.eye(size)
        self.last: tuple[Array, Piece, Segment] | None = None  # the state before an event, and its mode
        self.finding: str | None = None
        self.rebounds: dict[int, float] = {}  # velocities after the last impacts of joints

    def add(self, _: Dynamics, piece: Piece, chunk: Chunk) -> None:
        """Go along steps; pass the event before them first."""
        segment = chunk.segment or Segment((0,) * chunk.qd.shape[1])
        state = np.hstack((chunk.q, chunk.qd))
        if self.last is not None and (segment.guards or segment.jumps):
            self.jump(float(chunk.t[0]), segment, state[0])
        for matrix in self.differentiate(piece, chunk.t, state, segment.modes):
            self.X = matrix @ self.X
        self.last = state[-1], piece, segment

    def differentiate(self, piece: Piece, t: Array, state: Array, modes: tuple[int, ...]) -> Array:
        """Return the derivative of each step's end by its start, (k, N, N)."""
        A, b, c = (np.array(x, dtype=np.float64) for x in (self.tableau.A, self.tableau.b, self.tableau.c))
        h, x, size = np.diff(t)[:, None], state[:-1], state.shape[1]
        rates, slopes = list[Array](), list[Array]()
        for i in range(len(b)):
            y, Y = x.copy(), np.broadcast_to(np.eye(size), (len(x), size, size)).copy()
            for j in np.flatnonzero(A[i, :i]):
                y += h * A[i, j] * rates[j]
                Y += h[:, :, None] * A[i, j] * slopes[j]
            rate, slope = self.field.at(t[:-1] + c[i] * h[:, 0], y, piece, modes)
            rates.append(rate)
            slopes.append(slope @ Y)
        step = sum((b[i] * slopes[i] for i in range(len(b))), start=np.zeros_like(slopes[0]))
        return np.eye(size) + h[:, :, None] * step

    def jump(self, time: float, segment: Segment, after: Array) -> None:
        """Multiply by the saltation matrix of an event."""
        assert self.last is not None, "an event follows steps"
        before, piece, old = self.last
        if len(segment.guards) != 1:
            many = "several joints switch at once" if segment.guards else "a joint hits a stop as an input jumps"
            self.finding = self.finding or f"{many} at t = {time:.6g} s, where there is no derivative"
            return
        (guard,), field = segment.guards, self.field
        f_before, f_after = (
            field.at(np.array([time]), x[None], piece, modes)[0][0]
            for x, modes in ((before, old.modes), (after, segment.modes))
        )
        R = np.eye(len(before))
        for jump in segment.jumps:
            R = field.strike(before[: field.places], jump) @ R
        change = f_after - R @ f_before
        if not change.any():
            self.X = R @ self.X
            return
        slope, drift = field.slope(time, guard, before, piece, old.modes)
        rate = float(slope @ f_before) + drift
        returns = abs(rate) > RETURN * self.rebounds.get(guard.joint, np.inf)  # one of many, before the joint rests
        self.rebounds |= {guard.joint: abs(float(after[field.places + guard.joint]))} if guard.kind == PLACE else {}
        if not (np.abs(np.outer(change, slope)).max() < GRAZING * abs(rate) or (returns and guard.kind == PLACE)):
            name = field.joints.manifest.coordinates[guard.joint].name
            self.finding = self.finding or f"joint {name} grazes at t = {time:.6g} s, where there is no derivative"
            return
        self.X = (R + np.outer(change, slope) / rate) @ self.X


class _Field:
    """The rates of the state in a mode, with their derivatives."""

    def __init__(self, kernels: Kernels) -> None:
        self.dynamics = Dynamics(kernels, Formulation.SEMI)
        self.joints, self.places = Joints.of(kernels.manifest), self.dynamics.places

    def at(self, t: Array, x: Array, piece: Piece, modes: tuple[int, ...]) -> tuple[Array, Array]:
        """Return the rates (k, N) at states (k, N), and their derivatives (k, N, N)."""
        qdd, by_q, by_qd = self.accelerate(t, x, piece, modes)
        q, qd = np.split(x, [self.places], axis=1)
        upper = np.concatenate(self.dynamics.rate_slopes(q, qd), axis=2)
        slopes = np.concatenate((upper, np.concatenate((by_q, by_qd), axis=2)), axis=1)
        return np.hstack((self.dynamics.rates(q, qd), qdd)), slopes

    def accelerate(self, t: Array, x: Array, piece: Piece, modes: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """Return accelerations (k, n), and their derivatives by q and qd."""
        q, qd = np.split(x, [self.places], axis=1)
        v, dynamics = piece.values(t), self.dynamics
        free = np.flatnonzero(~np.isin(modes, HELD))
        signs = np.where(np.abs(modes) == 1, modes, 0)
        qdd = np.zeros_like(qd)
        M = dynamics.mass_matrix(q, qd, v)[:, free][:, :, free]
        right = -signs * self.joints.rub(qd) - dynamics.residual(q, qd, qdd, v)
        qdd[:, free] = np.linalg.solve(M, right[:, free, None])[:, :, 0]
        K, C, _ = dynamics.stiffnesses(q, qd, qdd, v)
        C = C + (signs * self.joints.steepen(qd))[:, :, None] * np.eye(qd.shape[1])
        by_q, by_qd = np.zeros_like(K), np.zeros_like(C)
        by_q[:, free], by_qd[:, free] = -np.linalg.solve(M, K[:, free]), -np.linalg.solve(M, C[:, free])
        return qdd, by_q, by_qd

    def slope(self, time: float, guard: Guard, x: Array, piece: Piece, modes: tuple[int, ...]) -> tuple[Array, float]:
        """Return the derivative (N,) of a guard's number by the state, and by the time at a constant state."""
        found = np.zeros(len(x))
        if guard.kind != FORCE:
            found[self.places + guard.joint if guard.kind == SPEED else guard.place] = 1.0
            return found, 0.0
        q, qd = np.split(x[None], [self.places], axis=1)
        qdd, by_q, by_qd = self.accelerate(np.array([time]), x[None], piece, modes)
        K, C, M = self.dynamics.stiffnesses(q, qd, qdd, piece.values(np.array([time])))
        found = np.concatenate((K + M @ by_q, C + M @ by_qd), axis=2)[0, guard.joint]
        near = [self.hold(time + shift, x, guard.joint, piece, modes) for shift in (-SHIFT, SHIFT)]
        return found, (near[1] - near[0]) / (2 * SHIFT)

    def hold(self, time: float, x: Array, joint: int, piece: Piece, modes: tuple[int, ...]) -> float:
        """Return the force that holds a joint."""
        q, qd = np.split(x[None], [self.places], axis=1)
        qdd = self.accelerate(np.array([time]), x[None], piece, modes)[0]
        return float(self.dynamics.residual(q, qd, qdd, piece.values(np.array([time])))[0, joint])

    def strike(self, q: Array, jump: Jump) -> Array:
        """Return the derivative (N, N) of the state after an impact by the state before.

        M (after - before) = impulses on the joints that hit, and after = -restitution before there.
        """
        n, hit = len(jump.before), list(jump.joints)
        rest, v = np.zeros((1, n)), np.zeros((1, len(self.joints.manifest.inputs)))
        change = (jump.after - jump.before)[None]
        moved, _, M = self.dynamics.stiffnesses(q[None], rest, change, v)
        still = self.dynamics.stiffnesses(q[None], rest, rest, v)[0]
        system = np.zeros((n + len(hit), n + len(hit)))
        system[:n, :n] = M[0]
        system[n:, hit] = np.eye(len(hit))
        system[hit, n:] = -np.eye(len(hit))
        right = np.zeros((n + len(hit), self.places + n))
        right[:n, : self.places] = -(moved - still)[0]
        right[:n, self.places :] = M[0]
        right[n + np.arange(len(hit)), [self.places + i for i in hit]] = [-e for e in jump.restitution]
        found = np.eye(self.places + n)
        found[self.places :] = np.linalg.solve(system, right)[:n]
        return found
