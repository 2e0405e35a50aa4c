"""Motions of trees with dry friction by the load of joints, from event to event: explicit methods keep their order.

Between events each joint keeps its mode (`bearings`): it sticks, or slides one way. An event is where a joint that
slides comes to rest, or the force that holds one at rest exceeds what its friction bears.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.bearings import Bearings, LoadError, Pattern, Rub
from mbsrun.simulation.integration.joints import name_change
from mbsrun.simulation.integration.stepwise import Stepwise
from mbsrun.simulation.integration.tableaus import Pair
from mbsrun.simulation.motion import FORCE, SPEED, Chunk, Event, Mode, Segment, Settings

Array = NDArray[np.float64]

SLACK = 1e-13  # of the forces of all joints: by how much a force that holds may exceed what friction bears
LENGTHS = 100  # steps at least of a piece with varying inputs, where no joint moves


@dataclass(frozen=True)
class Guard:
    """A bound of a joint: its velocity the way it slides (SPEED), or the reserve of friction that holds it (FORCE)."""

    joint: int
    kind: int


@dataclass(frozen=True, eq=False)
class Modes:
    """The mode of each joint."""

    numbers: NDArray[np.int_]  # (n,), as `Mode` lists them
    pattern: Pattern

    @property
    def is_locked(self) -> bool:
        """Return whether no joint moves."""
        return bool((self.numbers == Mode.STICKS).all())


class RubbingCourse(Stepwise[Modes, Guard]):
    """A motion of joints that stick and slide under their loads."""

    switches = "dry friction"
    lost, remedy = LoadError, "lessen the coefficient of friction, or give a torque in place of load"
    retried = (KernelError, LoadError)

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings) -> None:
        super().__init__(dynamics, pair, settings)
        self.bearings = Bearings.of(self.dynamics)
        self.names = [c.name for c in dynamics.kernels.manifest.coordinates]
        self.released: dict[int, int] = {}  # joints that are no longer held, and the ways in which they start
        self.fastest = 0.0  # velocity, so far
        self.passed: tuple[Event, ...] = ()  # since the last chunk

    def settle(self, time: float, piece: Piece, q: Array, qd: Array) -> tuple[Array, Array]:
        """Find the mode at a state; return the state."""
        qd = qd.copy()
        qd[[x.joint for x in self.fired if x.kind == SPEED]] = 0.0
        self.fastest = max(self.fastest, float(np.abs(qd).max(initial=0.0)))
        self.bearings.joints.still(qd, self.fastest)
        state = self.bearings.place(q[None], qd[None], piece.at(time, q, qd)[None])
        modes, _ = self.bearings.settle(state, qd, self.released)
        if self.mode is not None:
            self.passed = (*self.passed, *self.compare(time, qd, modes))
        self.mode, self.released, self.fired = Modes(modes, self.bearings.read(modes)), {}, ()
        return q, qd

    def compare(self, time: float, qd: Array, modes: NDArray[np.int_]) -> Iterator[Event]:
        """List the changes of modes."""
        assert self.mode is not None, "there was a mode"
        for i, (old, new) in enumerate(zip(self.mode.numbers, modes, strict=True)):
            kind = name_change(int(old), int(new))
            if kind is not None:
                yield Event(time, self.names[i], kind, float(qd[i]), float(qd[i]))

    def rub(self, piece: Piece, mode: Modes, t: Array, x: Array) -> Rub:
        """Return the friction at states (K, nq + n)."""
        q, qd = np.split(x, [self.dynamics.places], axis=1)
        return self.bearings.slide(self.bearings.place(q, qd, piece.follow(t, q, qd)), qd, mode.pattern)

    def move(self, piece: Piece, mode: Modes, t: Array, x: Array) -> Array:
        """Return the rates of states."""
        q, qd = np.split(x, [self.dynamics.places], axis=1)
        return np.hstack((self.dynamics.rates(q, qd), self.rub(piece, mode, t, x).qdd))

    def advance(
        self, piece: Piece, mode: Modes, time: float, x: Array, h: float, *, fixed: bool
    ) -> tuple[float, Array]:
        """Take a step; where no joint moves, varying inputs set its length."""
        if mode.is_locked and not (fixed or piece.is_constant):
            h = min(h, (piece.end - piece.start) / LENGTHS)
        return super().advance(piece, mode, time, x, h, fixed=fixed)

    def list_guards(self, mode: Modes) -> list[Guard]:
        """List what must not fall below 0 while a mode lasts."""
        kinds = {int(Mode.STICKS): FORCE, int(Mode.FORWARD): SPEED, int(Mode.BACKWARD): SPEED}
        return [Guard(i, kinds[int(x)]) for i, x in enumerate(mode.numbers) if int(x) in kinds]

    def measure(self, piece: Piece, mode: Modes, guards: list[Guard], t: Array, x: Array) -> Array:
        """Return the guards at states, (K, guards)."""
        values = mode.numbers * x[:, self.dynamics.places :]
        if any(guard.kind == FORCE for guard in guards):
            found, held = self.rub(piece, mode, t, x), mode.numbers == Mode.STICKS
            slack = SLACK * np.abs(found.lam).max(axis=1, keepdims=True)
            most = self.bearings.joints.static + self.bearings.static * found.loads + slack
            values = np.where(held, most - np.abs(found.lam), values)
        return np.asarray(values[:, [guard.joint for guard in guards]])

    def release(self, piece: Piece, mode: Modes, time: float, x: Array) -> None:
        """Note the ways in which joints start to slide."""
        slips = [guard.joint for guard in self.fired if guard.kind == FORCE]
        lam = self.rub(piece, mode, np.array([time]), x[None]).lam[0] if slips else np.zeros(0)
        self.released = {i: -int(np.sign(lam[i])) for i in slips}

    def gather(self, piece: Piece, mode: Modes, times: list[float], states: list[Array]) -> Chunk:
        """Bundle steps with the motion and the friction within them."""
        t, x = np.array(times), np.array(states)
        q, qd = np.split(x, [self.dynamics.places], axis=1)

        def push(at: Array, places: Array, speeds: Array) -> tuple[Array, Array, Array]:
            found = self.rub(piece, mode, at, np.hstack((places, speeds)))
            lost = (self.bearings.rub(speeds) * found.loads * np.abs(speeds)).sum(axis=1)
            return found.qdd, np.zeros((len(at), 0)), lost

        segment = Segment(tuple(mode.numbers.tolist()), self.passed, push=push)
        if len(t) > 1:
            self.passed, self.guards = (), ()
        return Chunk(t, q, qd, self.interpolate(piece, mode, t, x), segment=segment)
