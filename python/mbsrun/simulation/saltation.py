"""Derivatives of a motion by its start, through stops and dry friction.

Within a mode the derivative X = dx/dx0 of the state x = (q, qd) obeys the method's own steps, differentiated: of stages
k_i = f(y_i), y_i = x + h sum_j A_ij k_j,

    K_i = f_x(y_i) (X + h sum_j A_ij K_j),    X(t + h) = X + h sum_i b_i K_i.

An event has a guard g(x, t) = 0, and a jump x+ = R(x). Its time depends on the start too, which the saltation matrix
counts (Aizerman, Gantmacher, "On the stability of periodic motions", J. Appl. Math. Mech. 22 (1958); Leine, Nijmeijer,
"Dynamics and bifurcations of non-smooth mechanical systems" (2004), section 7.3):

    X+ = (R_x + (f+ - R_x f-) g_x / (g_x f- + g_t)) X-

The derivative holds while a small change of the start leaves the order of events. Where the guard's rate is 0, at a
grazing event, and where several guards meet by chance, there is none. Guards that meet at all neighbouring starts are
one event. Changes of the start keep the equations of loops and of points that touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Manifest
from mbsrun.kernel import ArgumentError, Kernels
from mbsrun.simulation.contact_variation import ContactField
from mbsrun.simulation.course import Course
from mbsrun.simulation.drive import Drive, Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.methods import METHODS
from mbsrun.simulation.integration.tableaus import DOP853, EULER, RK4, RK45, Pair
from mbsrun.simulation.motion import Chunk, Motion, Segment, Settings
from mbsrun.simulation.simulate import simulate
from mbsrun.simulation.variation import Crossing, Field, JointField, SlopeError

Array = NDArray[np.float64]

PAIRS = {"euler": EULER, "rk4": RK4, "rk45": RK45, "dop853": DOP853}
GRAZING = 1e6  # an event that makes more of a small change of the state grazes
RETURN = 0.1  # of a rebound's velocity: a joint that comes back as fast did not graze
NOTHING = 1e-10  # of the rates of the state: an event with a smaller change is none
SAME = 1e-6  # of the derivatives of the times of guards: guards that differ by less are of one event


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """A motion with the derivative of its end by its start."""

    motion: Motion
    slopes: Array  # (nq + n, nq + n): of q, qd at the end, by q, qd at the start; NaN where there is a finding
    finding: str | None  # why there is no derivative


def differentiate(
    kernels: Kernels, drive: Drive, q: ArrayLike, qd: ArrayLike, settings: Settings, course: Course | None = None
) -> Sensitivity:
    """Integrate a motion as `simulate` does, by an explicit method, with the derivative of its end by its start.

    In loops, and where points touch at the start, a change of the start is followed by the least one that keeps their
    equations. Raises ValueError for inputs that follow the state, and other methods, ArgumentError for kernels that
    were not generated, and what `simulate` raises.
    """
    _check(kernels.manifest, drive, settings)
    watcher = _Watcher(PAIRS[settings.method], len(kernels.manifest.positions) + len(kernels.manifest.coordinates))
    motion = simulate(kernels, drive, q, qd, settings, course=course, watch=watcher.add)
    finding = watcher.finding if motion.halt is None else str(motion.halt)
    slopes = watcher.X if finding is None else np.full_like(watcher.X, np.nan)
    return Sensitivity(motion, slopes, finding)


def _check(manifest: Manifest, drive: Drive, settings: Settings) -> None:
    if settings.method not in PAIRS:
        raise ValueError(f"{settings.method} is not differentiated; give one of {', '.join(PAIRS)}")
    if manifest.loaded:
        finding = f"friction by the load of joints {', '.join(manifest.loaded)} is not differentiated"
        raise ValueError(f"{finding}; give a torque in place of load")
    if settings.latches:
        raise ValueError("latches that hold at given times are not differentiated; leave the times out")
    if drive.control is not None:
        raise ValueError("inputs that follow the state are not differentiated; give them over time")
    needed = {"jac_semi_res"} | ({"jac_rates"} if manifest.configuration else set())
    if manifest.loops:
        needed |= {"jac_loops", "jac_loop_rates", "jac_loop_accelerations", "jac_loop_forces"}
    missing = sorted(needed - {kernel.name for kernel in manifest.kernels})
    if missing:
        raise ArgumentError(f"{manifest.model} was generated without {', '.join(missing)}; generate all functions")
    assert METHODS[settings.method].stability is not None, "the methods are explicit"


class _Watcher:
    """Carries the derivative along the steps of a motion."""

    def __init__(self, pair: Pair, size: int) -> None:
        self.tableau = pair.tableau
        self.X = np.eye(size)
        self.field: Field | None = None
        self.last: tuple[Array, Piece, Segment] | None = None  # the state before an event, and its mode
        self.finding: str | None = None
        self.rebounds: dict[int, float] = {}  # speeds after the last impacts of joints and points

    def add(self, dynamics: Dynamics, piece: Piece, chunk: Chunk) -> None:
        """Go along steps; pass the event before them first."""
        if self.finding is not None:
            return
        if self.field is None:
            self.field = ContactField(dynamics) if dynamics.kernels.manifest.rigid else JointField(dynamics)
        segment = chunk.segment or Segment((0,) * chunk.qd.shape[1])
        state, time = np.hstack((chunk.q, chunk.qd)), float(chunk.t[0])
        try:
            if self.last is not None:
                self.jump(self.field, time, segment, state[0])
            elif self.field.strike(segment, state[0]) is not None:
                raise SlopeError("the motion begins with an impact")
            self.X = self.field.project(state[0], segment) @ self.X
            for matrix in self.differentiate(self.field, piece, chunk.t, state, segment):
                self.X = matrix @ self.X
            self.X = self.field.project(state[-1], segment) @ self.X
        except SlopeError as error:
            self.note(str(error), time)
        self.last = state[-1], piece, segment

    def note(self, finding: str, time: float) -> None:
        """Note why there is no derivative."""
        self.finding = self.finding or f"{finding} at t = {time:.6g} s, where there is no derivative"

    def differentiate(self, field: Field, piece: Piece, t: Array, state: Array, segment: Segment) -> Array:
        """Return the derivative of each step's end by its start, (k, N, N)."""
        A, b, c = (np.array(x, dtype=np.float64) for x in (self.tableau.A, self.tableau.b, self.tableau.c))
        h, x, size = np.diff(t)[:, None], state[:-1], state.shape[1]
        rates, slopes = list[Array](), list[Array]()
        for i in range(len(b)):
            y, Y = x.copy(), np.broadcast_to(np.eye(size), (len(x), size, size)).copy()
            for j in np.flatnonzero(A[i, :i]):
                y += h * A[i, j] * rates[j]
                Y += h[:, :, None] * A[i, j] * slopes[j]
            rate, slope = field.at(t[:-1] + c[i] * h[:, 0], y, piece, segment)
            rates.append(rate)
            slopes.append(slope @ Y)
        step = sum((b[i] * slopes[i] for i in range(len(b))), start=np.zeros_like(slopes[0]))
        return np.eye(size) + h[:, :, None] * step

    def jump(self, field: Field, time: float, segment: Segment, after: Array) -> None:
        """Multiply by the saltation matrix of an event."""
        assert self.last is not None, "an event follows steps"
        before, piece, old = self.last
        impact = field.strike(segment, before)
        is_event = impact is not None or field.has_guards(segment)
        if not is_event:
            return
        R = np.eye(len(before)) if impact is None else impact
        R = field.project(after, segment) @ R
        f_before, f_after = (
            field.at(np.array([time]), x[None], piece, mode)[0][0] for x, mode in ((before, old), (after, segment))
        )
        change = f_after - R @ f_before
        if impact is None and np.abs(change).max() <= NOTHING * max(np.abs(f_after).max(), np.abs(f_before).max()):
            self.X = R @ self.X
            return
        crossings = field.list_crossings(time, before, after, piece, old, segment)
        crossing = self.choose(crossings, f_before, time)
        if crossing is None or not change.any():
            self.X = R @ self.X
            return
        rate = float(crossing.slope @ f_before) + crossing.drift
        speed = crossing.rebound
        returns = speed is not None and abs(rate) > RETURN * self.rebounds.get(crossing.key, np.inf)  # one of many
        self.rebounds |= {crossing.key: speed} if speed is not None else {}
        if not (np.abs(np.outer(change, crossing.slope)).max() < GRAZING * abs(rate) or returns):
            self.note(f"{crossing.name} grazes", time)
            return
        self.X = (R + np.outer(change, crossing.slope) / rate) @ self.X

    def choose(self, crossings: list[Crossing], rates: Array, time: float) -> Crossing | None:
        """Return the guard of an event; of several, a guard of a group that meets at all neighbouring starts."""
        if not crossings:
            self.note("a joint hits a stop as an input jumps", time)
            return None
        if len(crossings) > 1:
            times = [x.slope @ self.X / (float(x.slope @ rates) + x.drift or np.nan) for x in crossings]
            scale = max(float(np.abs(x).max()) for x in times)
            if not all(np.abs(x - times[0]).max() <= SAME * scale for x in times):
                self.note(f"several {crossings[0].name.split()[0]}s switch at once", time)
                return None
        return crossings[0]
