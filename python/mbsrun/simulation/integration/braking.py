"""Motions of joints that stop, stick and slide, from event to event: one C function integrates between events.

It finds the time at which a guard falls below 0, to rounding: a joint reaches a stop, comes to rest, or is let go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mbsrun.limits import Allowance
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.events import Course
from mbsrun.simulation.integration.explicit import Brakes, Loads, Pair, Plant
from mbsrun.simulation.integration.joints import STILL, TOUCH, Joints, are_held, name_change
from mbsrun.simulation.integration.steps import count_steps
from mbsrun.simulation.motion import (
    PLACE,
    SPEED,
    Bounces,
    Chunk,
    Event,
    Guard,
    Jump,
    Kind,
    Push,
    Segment,
    Settings,
)

Array = NDArray[np.float64]

SLOW = 1e-3  # m/s, rad/s: only a slower rebound may be the last one


class BrakedCourse(Course):
    """A motion in modes of joints, as `Mode` lists them; `settle` finds the mode."""

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings, loads: Loads | None = None) -> None:
        super().__init__(settings)
        self.joints, self.dynamics = Joints.of(dynamics.kernels.manifest), dynamics
        self.plant = Plant(dynamics, pair, settings, switches=True, loads=loads)
        self.modes: NDArray[np.int_] | None = None
        self.released: dict[int, int] = {}  # joints that are no longer held, and the directions in which they start
        self.locking = np.zeros(0, dtype=np.intp)  # joints that hold all joints at rest
        self.holding = np.zeros(0)  # forces (n,) that hold them at the start of the mode
        self.fastest = 0.0  # velocity, in the last steps
        self.passed: tuple[Event, ...] = ()  # since the last chunk, with the energy that they took [J],
        self.loss = self.driven = 0.0  # and the work of driven joints
        self.guards: tuple[Guard, ...] = ()
        self.jumps: tuple[Jump, ...] = ()

    def push(self, _piece: Piece) -> Push | None:
        """Return the friction by loads in the present mode, as a function of states."""
        return None

    def explain(self, halt: BaseException) -> BaseException:
        """Return why steps end early, in the words of the course."""
        return halt

    def run(self, piece: Piece, q: Array, qd: Array, allowance: Allowance) -> Iterator[Chunk]:
        """Integrate until an event or the end of the piece; the chunk of an event at once has one state."""
        plant, state, forces = self.plant, np.concatenate((q, qd)), self.holding
        assert self.modes is not None, "a mode was found"
        brakes = self.joints.brake(self.modes, forces, self.locking)
        guards = self.joints.guard(self.modes, forces, self.locking)
        count = count_steps(piece, self.settings.step) if not plant.manner.estimates else 0
        time, first = piece.start, 0
        while time < piece.end:
            plant.open(piece)
            plant.switch(brakes, guards)
            if self.bounces:
                plant.bounce(self.joints.restitution, SLOW, STILL, TOUCH)
            done, halt, times, states = plant.advance(piece, state, time, first, count, allowance)
            if self.is_locked:  # closing loops would move it by rounding
                states[:] = state
            is_event, bounced = plant.is_event, plant.bounced
            if is_event:
                self.snap(guards, plant.fired, states[done])
            if done and times[done] == times[done - 1] and done not in bounced[0]:  # an event at once
                done -= 1
                states[done] = states[done + 1]
            if done:
                allowance.note(done - 1 - len(bounced[0]))
            time, state, first = float(times[done]), states[done], first + done
            if done:
                self.fastest = float(np.abs(states[: done + 1, self.dynamics.places :]).max())
            bounces = self.describe(bounced, guards, times, states)
            chunk = self.gather(piece, times[: done + 1], states[: done + 1], brakes, bounces)
            if is_event:
                self.guards = (*self.guards, *(guards[k] for k in plant.fired))
            yield chunk
            if halt is not None:
                raise self.explain(halt)
            if is_event:
                return

    @property
    def is_locked(self) -> bool:
        """Return whether no joint moves, and driven ones do not either."""
        free = int((~self.joints.is_driven).sum()) - len(self.joints.manifest.owners)
        return len(self.locking) >= free and self.dynamics.course.is_constant

    @property
    def bounces(self) -> bool:
        """Return whether impacts are passed in C: no joint rests, and the restitution of one throws it back."""
        assert self.modes is not None, "a mode was found"
        return not are_held(self.modes).any() and bool((self.joints.restitution > 0).any())

    def describe(
        self,
        bounced: tuple[NDArray[np.intp], NDArray[np.intp], Array],
        guards: Sequence[Guard],
        times: Array,
        states: Array,
    ) -> Bounces | None:
        """Describe the impacts that were passed in C."""
        rows, fallen, impulses = bounced
        if not rows.size:
            return None
        own = [guards[k] for k in fallen]
        joints, names = [guard.joint for guard in own], [c.name for c in self.joints.manifest.coordinates]
        before, after = (states[row, self.dynamics.places + np.array(joints)] for row in (rows - 1, rows))
        sides = np.array([guard.side for guard in own])
        numbers = zip(times[rows].tolist(), joints, before.tolist(), after.tolist(), strict=True)
        events = tuple(Event(t, names[i], Kind.IMPACT, v, w) for t, i, v, w in numbers)
        restitution = tuple(self.joints.restitution[joints].tolist())
        return Bounces(rows, events, -0.5 * impulses * sides * (before + after), tuple(own), restitution)

    def gather(self, piece: Piece, times: Array, states: Array, brakes: Brakes, bounces: Bounces | None) -> Chunk:
        """Bundle steps with the motion within them, in their own mode."""
        assert self.modes is not None, "a mode was found"
        happened = self.passed, self.loss, self.driven, self.guards, self.jumps
        modes, locking, forces = (tuple(x.tolist()) for x in (self.modes, self.locking, self.holding))
        push = self.push(piece)
        segment = Segment(modes, *happened, push=push, bounces=bounces, locking=locking, forces=forces)
        if len(times) > 1:
            self.passed, self.loss, self.driven, self.guards, self.jumps = (), 0.0, 0.0, (), ()
        q, qd = np.split(states, [self.dynamics.places], axis=1)
        read = self.plant.make_dense(piece, times[:-1], states[:-1])

        is_locked = self.is_locked

        def dense(t: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
            if is_locked:
                return q[step], qd[step]
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

    def compare(self, time: float, qd: Array, modes: NDArray[np.int_]) -> Iterator[Event]:
        """List the changes of modes since the last event, impacts aside."""
        if self.modes is None:
            return
        for i, (old, new) in enumerate(zip(self.modes, modes, strict=True)):
            kind = name_change(int(old), int(new))
            if kind is not None:
                speed = float(qd[i])
                yield Event(time, self.joints.manifest.coordinates[i].name, kind, speed, speed)
