"""Motions of joints with rigid stops and dry friction, from event to event: explicit methods keep their order.

    M(q) qdd + c(q, qd) = Q + lam,

where lam acts on single joints. A joint that slides has lam = -sign(qd) T(qd), and T falls from its static value to its
sliding one by Stribeck's law. A joint at rest sticks, or rests on a stop: qdd = 0, while lam is between -Ts and Ts, at
a stop to infinity at one side. The forces of all joints at rest solve one complementarity problem (`complementarity`).
A joint that starts to slide has its sliding friction at once, or Ts at speed 0 with a Stribeck speed.

Between events one C function integrates; it finds the time at which a joint reaches a stop, comes to rest, or is no
longer held, to rounding. Impacts obey Newton's hypothesis: stops at which joints approach or rest get impulses P >= 0,

    w+ + e w- >= 0,    P >= 0,    P (w+ + e w-) = 0,    w: velocities away from the stops;

with one restitution e for all, Poisson's hypothesis gives the same. Friction is bounded, so it has no impulse. Impacts
that come faster and faster end in rest: a rebound that rises by less than REBOUND is the last one, and
the geometric series of the flights gives the time of rest.

Pfeiffer, Glocker, "Multibody dynamics with unilateral contacts" (1996), chapters 5 and 6.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.limits import Allowance
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration import explicit
from mbsrun.simulation.integration.braking import SLOW, BrakedCourse
from mbsrun.simulation.integration.complementarity import (
    NOISE,
    WITHIN,
    ComplementarityError,
    solve_bounded,
    solve_redundant,
)
from mbsrun.simulation.integration.events import MANY, MOST, Course
from mbsrun.simulation.integration.explicit import Pair
from mbsrun.simulation.integration.holding import LOCKED, Forces, Inertia
from mbsrun.simulation.integration.joints import SLACK, are_held
from mbsrun.simulation.integration.rubbing import RubbingCourse
from mbsrun.simulation.integration.touching import TouchingCourse
from mbsrun.simulation.motion import (
    Chunk,
    Event,
    Halt,
    HaltError,
    Jump,
    Kind,
    Mode,
    Settings,
)

Array = NDArray[np.float64]

REBOUND = 1e-15  # m, rad: a rebound that rises less is the last one
NEAR = 1e-9  # of the forces of a joint: a force that is as near to the most that holds it lets it go
TIGHT = 1e-12  # the same, where other joints may take the load over


def integrate(
    pair: Pair, dynamics: Dynamics, piece: Piece, q: Array, qd: Array, settings: Settings, allowance: Allowance
) -> Iterator[Chunk]:
    """Go through a piece of the inputs; yield the steps.

    Raises HaltError where a kernel fails, switches do not end, or the allowance is used up.
    """
    manifest = dynamics.kernels.manifest
    if not (manifest.rigid or manifest.loaded or manifest.switching):
        yield from explicit.integrate(pair, dynamics, piece, q, qd, settings, allowance)
        return
    if "course" not in dynamics.kept:
        make = TouchingCourse if manifest.rigid else RubbingCourse if manifest.loaded else _Course
        dynamics.kept["course"] = make(dynamics, pair, settings)
    course: Course = dynamics.kept["course"]
    yield from course.follow(piece, q, qd, allowance)


class _Course(BrakedCourse):
    """A motion of joints that stop, stick and slide."""

    switches = "stops and dry friction"
    lost, remedy = ComplementarityError, "start elsewhere"

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings) -> None:
        super().__init__(dynamics, pair, settings)
        self.forces = Forces(dynamics)
        self.held = np.zeros(len(self.joints.place))  # the last forces on joints at rest

    def settle(self, time: float, piece: Piece, q: Array, qd: Array) -> tuple[Array, Array]:
        """Pass the impacts at a state, and find the mode then, with the forces on joints at rest; return the state."""
        joints, events = self.joints, list[Event]()
        q, qd = q.copy(), qd.copy()
        sides = joints.touch(q)
        self.fastest = max(self.fastest, float(np.abs(qd).max(initial=0.0)))
        if self.modes is not None:  # of several joints that lock each other, only some are held exactly
            released = np.isin(np.arange(len(qd)), list(self.released))
            qd[are_held(self.modes) & ~released] = 0.0
        inertia = self.forces.weigh(q, qd, piece.at(time, q, qd))
        for k in range(MOST):
            joints.still(qd, self.fastest)
            pressed = joints.press(sides)
            closing = pressed * qd < 0
            if not closing.any():
                break
            if k < MANY or (joints.restitution[closing] == 1).any():
                impact = self.hit(time, piece, q, qd, inertia, np.where(pressed * qd > 0, 0, pressed))
            else:  # of impacts that alternate without end, each with less speed
                impact = self.strike(time, qd, inertia, pressed, np.zeros_like(qd))
            qd, self.loss, self.driven = impact.qd, self.loss + impact.loss, self.driven + impact.driven
            events += impact.events
            self.jumps = (*self.jumps, impact.jump)
        else:
            finding = f"{MOST} impacts at one time"
            raise HaltError(Halt(time, None, finding, "change a restitution a little"))
        sides = np.where(sides * qd > 0, 0, sides)
        modes, self.holding = self.decide(time, q, qd, piece.at(time, q, qd), inertia, sides)
        told = {(event.joint, event.kind) for event in events}
        events += [event for event in self.compare(time, qd, modes) if (event.joint, event.kind) not in told]
        self.modes, self.released, self.passed = modes, {}, (*self.passed, *events)
        return q, qd

    def hit(self, time: float, piece: Piece, q: Array, qd: Array, inertia: Inertia, sides: NDArray[np.int_]) -> _Impact:
        """Pass one impact; a rebound that is too low to be seen is none."""
        joints = self.joints
        restitution = joints.restitution.copy()
        impact = self.strike(time, qd, inertia, sides, restitution)
        speeds = sides * impact.qd
        if not ((speeds > 0) & (speeds < SLOW)).any():
            return impact
        v = piece.at(time, q, impact.qd)
        left = np.where(sides * impact.qd > 0, 0, sides)
        rest = self.decide(time, q, impact.qd, v, inertia, left)
        qdd = self.forces.accelerate(time, q, impact.qd, v, inertia, *rest)
        w, a = sides * impact.qd, sides * qdd
        low = (sides != 0) & (sides * qd < 0) & (restitution < 1) & (w > 0) & (a < 0)
        low &= w * w <= -2 * a * REBOUND * np.maximum(1, np.abs(joints.find_stops(sides)))
        if not low.any():
            return impact
        last = {int(i): time + float(-2 * w[i] / a[i] / (1 - restitution[i])) for i in np.flatnonzero(low)}
        restitution[low] = 0.0
        return self.strike(time, qd, inertia, sides, restitution, last)

    def strike(
        self,
        time: float,
        qd: Array,
        inertia: Inertia,
        sides: NDArray[np.int_],
        restitution: Array,
        last: Mapping[int, float] | None = None,
    ) -> _Impact:
        """Solve for the impulses of stops where joints approach or rest. `last`: joints that rest then, by the time."""
        joints, last = self.joints, last or {}
        touching = np.flatnonzero(sides)
        s = sides[touching].astype(np.float64)
        w = s * qd[touching]
        responses = inertia.respond(touching) * s  # changes of velocities by a unit impulse at each stop
        A, b, zero = s[:, None] * responses[touching], (1 + restitution[touching]) * w, np.zeros(len(s))
        impulses, rest, _ = self.weigh(inertia, touching, A, b, zero, np.full(len(s), np.inf), zero)
        after = qd + responses @ impulses
        root = np.sqrt(inertia.measure(touching))
        hit = impulses * root > NOISE * (impulses * root).max(initial=0.0)
        bound = touching[hit | (rest <= NOISE * (np.abs(A) @ impulses + np.abs(b)))]
        after[bound] = -restitution[bound] * qd[bound] + 0.0
        loss = -0.5 * float(impulses @ (s * after[touching] + w))
        names = [c.name for c in joints.manifest.coordinates]
        driven = self.forces.find_work(inertia, qd, after, touching, s * impulses)
        events = tuple(
            Event(last.get(int(i), time), names[i], Kind.REST if int(i) in last else Kind.IMPACT, *map(float, pair))
            for i, pair in zip(touching, np.stack((qd, after), axis=1)[touching], strict=True)
            if sides[i] * qd[i] < 0 or i in touching[hit]
        )
        jump = Jump(qd, after, tuple(map(int, touching[hit])), tuple(map(float, restitution[touching[hit]])))
        return _Impact(after, events, loss, driven, jump)

    def weigh(
        self,
        inertia: Inertia,
        chosen: NDArray[np.intp],
        A: Array,
        b: Array,
        low: Array,
        high: Array,
        near: Array,
    ) -> tuple[Array, Array, NDArray[np.int_]]:
        """Solve a complementarity problem of chosen joints; of several solutions take one near `near`."""
        if inertia.are_independent(chosen):
            return solve_bounded(A, b, low, high)
        try:
            return solve_redundant(A, b, low, high, near, inertia.measure(chosen))
        except ComplementarityError:
            names = ", ".join(self.joints.manifest.coordinates[i].name for i in chosen)
            finding = f"loops or driven joints press a joint through its stop, of joints {names}"
            raise ComplementarityError(finding) from None

    def decide(
        self, time: float, q: Array, qd: Array, v: Array, inertia: Inertia, sides: NDArray[np.int_]
    ) -> tuple[NDArray[np.int_], Array]:
        """Return the mode of each joint at a state, and the forces (n,) that hold joints at rest.

        `locking` then lists the joints whose forces vary while all of them rest.
        """
        joints, n = self.joints, len(qd)
        modes = np.where(joints.is_dry & (qd != 0), np.sign(qd), Mode.FREE).astype(np.int_)
        still = np.flatnonzero((qd == 0) & (joints.is_dry | (sides != 0)) & ~joints.is_driven)
        forces, self.locking = np.zeros(n), still[:0]
        if not still.size:
            return modes, forces
        free = self.forces.accelerate(time, q, qd, v, inertia, modes, forces)[still]
        A = inertia.respond(still)[still]
        released = {int(i): self.released[int(i)] for i in still if int(i) in self.released}
        rest = self.balance(inertia, still, A, free, sides, released)
        if not rest.is_alone:  # forces may be shared anew, before a joint that was at its most slides
            trial = self.balance(inertia, still, A, free, sides, {})
            if (trial.place == WITHIN).all() and not trial.near[np.isin(still, trial.locking)].any():
                rest, released = trial, {}
            else:
                at_most = trial.near & ~np.isin(still, list(released))
                released |= {int(i): int(-np.sign(x)) for i, x in zip(still[at_most], trial.lam[at_most], strict=True)}
                rest = self.balance(inertia, still, A, free, sides, released)
        locked = (inertia.scale(still) ** 2).sum(axis=0) <= LOCKED**2
        is_moving = bool(qd.any()) or not self.dynamics.course.is_constant
        for k, i in enumerate(still):
            way = int(-rest.place[k]) or (released.get(int(i), 0) if rest.near[k] else 0)
            if not way and locked[k] and is_moving:  # driven joints move it, and now turn it round or begin to
                way = 1
            if way:
                modes[i] = way if joints.is_dry[i] else Mode.FREE
            else:
                modes[i] = {0: Mode.STICKS, 1: Mode.LOWER, -1: Mode.UPPER}[int(sides[i])]
                forces[i] = rest.lam[k]
        held = np.flatnonzero(are_held(modes))
        if not held.size:
            return modes, forces
        self.locking = inertia.choose(held, rest.slack[np.searchsorted(still, held)])
        self.held = forces
        return modes, forces

    def balance(
        self,
        inertia: Inertia,
        still: NDArray[np.intp],
        A: Array,
        free: Array,
        sides: NDArray[np.int_],
        released: Mapping[int, int],
    ) -> _Rest:
        """Find the forces on joints at rest; `released` ones have the friction with which they start to slide."""
        joints = self.joints
        level = joints.static[still].copy()
        starts = np.array([i in released for i in still])
        level[starts] = joints.starting[still[starts]]
        while True:
            pressed = joints.press(sides)[still]
            low = np.where(pressed < 0, -np.inf, -level)
            high = np.where(pressed > 0, np.inf, level)
            lam, qdd, place = self.weigh(inertia, still, A, free, low, high, self.held[still])
            noise = SLACK * (np.abs(A) @ np.abs(lam) + np.abs(free))
            place = np.where((np.abs(qdd) <= noise) & ~starts, WITHIN, place)
            slips = (place != WITHIN) & (level > joints.starting[still])
            if not slips.any():
                break
            level[slips] = joints.starting[still[slips]]
        bound = np.where(lam > 0, high, low)
        near = np.abs(lam - bound) <= NEAR * np.where(np.isfinite(bound), np.abs(bound) + np.abs(A) @ np.abs(lam), 1.0)
        room = np.minimum(lam - low, high - lam)
        slack = room / (np.abs(lam) + room + np.finfo(float).tiny)
        is_alone = inertia.are_independent(still)
        near = near if is_alone else slack <= TIGHT
        locking = still if is_alone else inertia.choose(still, slack)
        return _Rest(lam, place, near, slack, locking, is_alone)


@dataclass(frozen=True, eq=False)
class _Rest:
    """The forces on m joints at rest."""

    lam: Array  # (m,)
    place: NDArray[np.int_]  # (m,): WITHIN bounds, or at one, where the joint starts to move
    near: NDArray[np.bool_]  # (m,): as much as friction or a stop can bear
    slack: Array  # (m,): from 0 at a bound to 1
    locking: NDArray[np.intp]  # joints that can hold all
    is_alone: bool  # whether no other forces hold as well


@dataclass(frozen=True, eq=False)
class _Impact:
    """The velocities after an impact, and the energy that it took [J]."""

    qd: Array
    events: tuple[Event, ...]
    loss: float
    driven: float  # work of driven joints
    jump: Jump
