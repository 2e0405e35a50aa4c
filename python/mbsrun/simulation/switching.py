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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation import explicit
from mbsrun.simulation.complementarity import WITHIN, ComplementarityError, solve_bounded
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.explicit import FREE_STEPS, STEPS, Brakes, Pair, Plant
from mbsrun.simulation.holding import Forces
from mbsrun.simulation.joints import SLACK, Joints
from mbsrun.simulation.motion import (
    PLACE,
    SPEED,
    Chunk,
    Event,
    Guard,
    Halt,
    HaltError,
    Jump,
    Kind,
    Mode,
    Segment,
    Settings,
)
from mbsrun.simulation.steps import count_steps, describe_singularity, place_steps

Array = NDArray[np.float64]

SLOW = 1e-3  # m/s, rad/s: only a slower rebound may be the last one
REBOUND = 1e-15  # m, rad: a rebound that rises less is the last one
NEAR = 1e-9  # of the forces of a joint: a force that is as near to the most that holds it lets it go
MANY = 100  # impacts at one time: the rest of them is one without rebounds
MOST = 1000  # switches at one time


def integrate(
    pair: Pair, dynamics: Dynamics, piece: Piece, q: Array, qd: Array, settings: Settings, allowance: Allowance
) -> Iterator[Chunk]:
    """Go through a piece of the inputs; yield the steps.

    Raises HaltError where a kernel fails, switches do not end, or the allowance is used up.
    """
    if not dynamics.kernels.manifest.switching:
        yield from explicit.integrate(pair, dynamics, piece, q, qd, settings, allowance)
        return
    if "switching" not in dynamics.kept:
        dynamics.kept["switching"] = _Course(dynamics, pair, settings)
    course: _Course = dynamics.kept["switching"]
    yield from course.follow(piece, q, qd, allowance)


class _Course:
    """A motion in the making: its mode, which holds over pieces of the inputs, and the C functions."""

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings) -> None:
        self.joints, self.dynamics, self.settings = Joints.of(dynamics.kernels.manifest), dynamics, settings
        self.plant = Plant(dynamics, pair, settings, switches=True)
        self.forces = Forces(dynamics)
        self.modes: NDArray[np.int_] | None = None
        self.released: dict[int, int] = {}  # joints that are no longer held, and the directions in which they start
        self.stalled, self.time = 0, -1.0
        self.passed: tuple[Event, ...] = ()  # since the last chunk, with the energy that they took [J],
        self.loss = self.driven = 0.0  # and the work of driven joints
        self.guards: tuple[Guard, ...] = ()
        self.jumps: tuple[Jump, ...] = ()

    def follow(self, piece: Piece, q: Array, qd: Array, allowance: Allowance) -> Iterator[Chunk]:
        """Go through a piece; yield the steps."""
        time = piece.start
        try:
            while time < piece.end:
                allowance.spend()
                self.count(time)
                q, qd, forces = self.settle(time, piece, q, qd)
                for chunk in self.run(replace(piece, start=time), q, qd, forces, allowance):
                    time, q, qd = float(chunk.t[-1]), chunk.q[-1], chunk.qd[-1]
                    if len(chunk.t) > 1:
                        yield chunk
        except LimitError as error:
            raise HaltError(Halt(time, None, error.finding, error.remedy)) from None
        except (KernelError, SingularError) as error:
            raise HaltError(describe_singularity(error, time)) from None
        except DriveError as error:
            if piece.law is None:
                raise
            raise HaltError(Halt(time, None, error.finding, error.remedy)) from None
        except ComplementarityError as error:
            raise HaltError(Halt(time, None, str(error), "start elsewhere")) from None

    def count(self, time: float) -> None:
        """Count the switches at one time."""
        self.stalled, self.time = (self.stalled + 1 if time == self.time else 0), time
        if self.stalled > MOST:
            finding = f"{MOST} switches of stops and dry friction at one time"
            raise HaltError(Halt(time, None, finding, "change a restitution or a friction a little"))

    def run(self, piece: Piece, q: Array, qd: Array, forces: Array, allowance: Allowance) -> Iterator[Chunk]:
        """Integrate until an event or the end of the piece; the chunk of an event at once has one state.

        `forces` (n,) hold joints at rest at the start.
        """
        plant, state = self.plant, np.concatenate((q, qd))
        assert self.modes is not None, "a mode was found"
        brakes, guards = self.joints.brake(self.modes), self.joints.guard(self.modes, forces)
        count = count_steps(piece, self.settings.step) if not plant.manner.estimates else 0
        time, first = piece.start, 0
        while time < piece.end:
            steps = min(max(1, allowance.steps), min(STEPS, count - first) if count else FREE_STEPS)
            allowance.spend()
            times = place_steps(piece, first + np.arange(steps + 1), count) if count else np.full(steps + 1, time)
            length = (piece.end - piece.start) / count if count else None
            plant.open(piece)
            plant.switch(brakes, guards)
            done, halt, states = plant.run(piece, state, times, steps, length)
            is_event = plant.is_event
            if is_event:
                self.snap(guards, plant.fired, states[done])
            if done and times[done] == times[done - 1]:  # an event at once
                done -= 1
                states[done] = states[done + 1]
            if done:
                allowance.note(done - 1)
            time, state, first = float(times[done]), states[done], first + done
            chunk = self.gather(piece, times[: done + 1], states[: done + 1], brakes)
            if is_event:
                self.guards = (*self.guards, *(guards[k] for k in plant.fired))
            yield chunk
            if halt is not None:
                raise halt
            if is_event:
                return

    def gather(self, piece: Piece, times: Array, states: Array, brakes: Brakes) -> Chunk:
        """Bundle steps with the motion within them, in their own mode."""
        assert self.modes is not None, "a mode was found"
        happened = self.passed, self.loss, self.driven, self.guards, self.jumps
        segment = Segment(tuple(map(int, self.modes)), *happened)
        if len(times) > 1:
            self.passed, self.loss, self.driven, self.guards, self.jumps = (), 0.0, 0.0, (), ()
        q, qd = np.split(states, [self.dynamics.places], axis=1)
        read = self.plant.make_dense(piece, times[:-1], states[:-1])

        def dense(t: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
            self.plant.switch(brakes, ())
            return read(t, step)

        return Chunk(times, q, qd, dense, segment=segment)

    def snap(self, guards: list[Guard], fired: list[int], state: Array) -> None:
        """Put the numbers of guards that are 0 where they are meant to be, and note the joints that are released."""
        places = self.dynamics.places
        for guard in (guards[k] for k in fired):
            if guard.kind == PLACE:
                state[guard.place] = guard.level
            elif guard.kind == SPEED:
                state[places + guard.joint] = 0.0
            else:  # a force below its lowest lets the joint go forward
                self.released[guard.joint] = 1 if guard.side > 0 else -1

    def settle(self, time: float, piece: Piece, q: Array, qd: Array) -> tuple[Array, Array, Array]:
        """Pass the impacts at a state, and find the mode then: return the state, and the forces on joints at rest."""
        joints, events = self.joints, list[Event]()
        q, qd = q.copy(), qd.copy()
        sides = joints.touch(q)
        M = self.forces.mass(q, qd, piece.at(time, q, qd))
        for k in range(MOST):
            joints.still(qd)
            closing = sides * qd < 0
            if not closing.any():
                break
            if k < MANY or (joints.restitution[closing] == 1).any():
                impact = self.hit(time, piece, q, qd, M, np.where(sides * qd > 0, 0, sides))
            else:  # of impacts that alternate without end, each with less speed
                impact = self.strike(time, qd, M, sides, np.zeros_like(qd))
            qd, self.loss, self.driven = impact.qd, self.loss + impact.loss, self.driven + impact.driven
            events += impact.events
            self.jumps = (*self.jumps, impact.jump)
        else:
            finding = f"{MOST} impacts at one time"
            raise HaltError(Halt(time, None, finding, "change a restitution a little"))
        sides = np.where(sides * qd > 0, 0, sides)
        modes, forces = self.decide(time, q, qd, piece.at(time, q, qd), M, sides)
        told = {(event.joint, event.kind) for event in events}
        events += [event for event in self.compare(time, qd, modes) if (event.joint, event.kind) not in told]
        self.modes, self.released, self.passed = modes, {}, (*self.passed, *events)
        return q, qd, forces

    def hit(self, time: float, piece: Piece, q: Array, qd: Array, M: Array, sides: NDArray[np.int_]) -> _Impact:
        """Pass one impact; a rebound that is too low to be seen is none."""
        joints = self.joints
        restitution = joints.restitution.copy()
        impact = self.strike(time, qd, M, sides, restitution)
        speeds = sides * impact.qd
        if not ((speeds > 0) & (speeds < SLOW)).any():
            return impact
        v = piece.at(time, q, impact.qd)
        left = np.where(sides * impact.qd > 0, 0, sides)
        qdd = self.forces.accelerate(time, q, impact.qd, v, M, *self.decide(time, q, impact.qd, v, M, left))
        w, a = sides * impact.qd, sides * qdd
        low = (sides != 0) & (sides * qd < 0) & (restitution < 1) & (w > 0) & (a < 0)
        low &= w * w <= -2 * a * REBOUND * np.maximum(1, np.abs(joints.find_stops(sides)))
        if not low.any():
            return impact
        last = {int(i): time + float(-2 * w[i] / a[i] / (1 - restitution[i])) for i in np.flatnonzero(low)}
        restitution[low] = 0.0
        return self.strike(time, qd, M, sides, restitution, last)

    def strike(
        self,
        time: float,
        qd: Array,
        M: Array,
        sides: NDArray[np.int_],
        restitution: Array,
        last: Mapping[int, float] | None = None,
    ) -> _Impact:
        """Solve for the impulses of stops where joints approach or rest. `last`: joints that rest then, by the time."""
        joints, last = self.joints, last or {}
        touching = np.flatnonzero(sides)
        s = sides[touching].astype(np.float64)
        w = s * qd[touching]
        responses = self.forces.respond(M, touching) * s  # changes of velocities by a unit impulse at each stop
        impulses, _, _ = solve_bounded(
            s[:, None] * responses[touching], (1 + restitution[touching]) * w, np.zeros(len(s)), np.full(len(s), np.inf)
        )
        after = qd + responses @ impulses
        hit = impulses > 0
        after[touching[hit]] = -restitution[touching[hit]] * qd[touching[hit]] + 0.0
        loss = -0.5 * float(impulses @ (s * after[touching] + w))
        names = [c.name for c in joints.manifest.coordinates]
        reactions = M @ (after - qd)
        driven = float(reactions[joints.driven] @ qd[joints.driven]) if joints.driven else 0.0
        events = tuple(
            Event(last.get(int(i), time), names[i], Kind.REST if int(i) in last else Kind.IMPACT, *map(float, pair))
            for i, pair in zip(touching, np.stack((qd, after), axis=1)[touching], strict=True)
            if sides[i] * qd[i] < 0 or i in touching[hit]
        )
        jump = Jump(qd, after, tuple(map(int, touching[hit])), tuple(map(float, restitution[touching[hit]])))
        return _Impact(after, events, loss, driven, jump)

    def decide(
        self, time: float, q: Array, qd: Array, v: Array, M: Array, sides: NDArray[np.int_]
    ) -> tuple[NDArray[np.int_], Array]:
        """Return the mode of each joint at a state, and the forces (n,) that hold joints at rest."""
        joints, n = self.joints, len(qd)
        modes = np.where(joints.is_dry & (qd != 0), np.sign(qd), Mode.FREE).astype(np.int_)
        still = np.flatnonzero((qd == 0) & (joints.is_dry | (sides != 0)) & ~joints.is_driven)
        forces = np.zeros(n)
        if not still.size:
            return modes, forces
        free = self.forces.accelerate(time, q, qd, v, M, modes, forces)
        responses = self.forces.respond(M, still)
        A = responses[still]
        level = joints.static[still].copy()
        starts = np.array([i in self.released for i in still])
        level[starts] = joints.starting[still[starts]]
        while True:
            low = np.where(sides[still] < 0, -np.inf, -level)
            high = np.where(sides[still] > 0, np.inf, level)
            lam, qdd, place = solve_bounded(A, free[still], low, high)
            noise = SLACK * (np.abs(A) @ np.abs(lam) + np.abs(free[still]))
            place = np.where((np.abs(qdd) <= noise) & ~starts, WITHIN, place)
            slips = (place != WITHIN) & (level > joints.starting[still])
            if not slips.any():
                break
            level[slips] = joints.starting[still[slips]]
        bound = np.where(lam > 0, high, low)
        near = np.abs(lam - bound) <= NEAR * np.where(np.isfinite(bound), np.abs(bound) + np.abs(A) @ np.abs(lam), 1.0)
        for k, i in enumerate(still):
            way = int(-place[k]) or (self.released.get(int(i), 0) if near[k] else 0)
            if way:
                modes[i] = way if joints.is_dry[i] else Mode.FREE
            else:
                modes[i] = {0: Mode.STICKS, 1: Mode.LOWER, -1: Mode.UPPER}[int(sides[i])]
                forces[i] = lam[k]
        return modes, forces

    def compare(self, time: float, qd: Array, modes: NDArray[np.int_]) -> Iterator[Event]:
        """List the changes of modes since the last event, impacts aside."""
        if self.modes is None:
            return
        for i, (old, new) in enumerate(zip(self.modes, modes, strict=True)):
            kind = _name_change(int(old), int(new))
            if kind is not None:
                speed = float(qd[i])
                yield Event(time, self.joints.manifest.coordinates[i].name, kind, speed, speed)


@dataclass(frozen=True, eq=False)
class _Impact:
    """The velocities after an impact, and the energy that it took [J]."""

    qd: Array
    events: tuple[Event, ...]
    loss: float
    driven: float  # work of driven joints
    jump: Jump


def _name_change(old: int, new: int) -> Kind | None:
    if old == new:
        return None
    slides = (1, -1)
    if new == Mode.STICKS:
        return Kind.STICK
    if old == Mode.STICKS and new in slides:
        return Kind.SLIP
    if new in (Mode.LOWER, Mode.UPPER):
        return Kind.REST
    if old in (Mode.LOWER, Mode.UPPER):
        return Kind.LEAVE
    return Kind.REVERSE if old in slides and new in slides else None
