"""Motions of trees with dry friction by the load of joints, from event to event: explicit methods keep their order.

Between events each joint keeps its mode (`bearings`): it sticks, or slides one way. An event is where a joint that
slides comes to rest, or the force that holds one at rest exceeds what its friction bears. Steps are taken in C.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.bearings import Bearings, LoadError
from mbsrun.simulation.integration.braking import BrakedCourse
from mbsrun.simulation.integration.tableaus import Pair
from mbsrun.simulation.motion import Mode, Push, Settings

Array = NDArray[np.float64]


class RubbingCourse(BrakedCourse):
    """A motion of joints that stick and slide under their loads."""

    switches = "dry friction"
    lost, remedy = LoadError, "lessen the coefficient of friction, or give a torque in place of load"

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings) -> None:
        formulation = dynamics.formulation
        own = Formulation.SEMI if formulation.evaluated.is_direct else formulation
        self.bearings = Bearings.of(replace(dynamics, formulation=own))
        super().__init__(dynamics, pair, settings, self.bearings.lay())

    def settle(self, time: float, piece: Piece, q: Array, qd: Array) -> tuple[Array, Array]:
        """Find the mode at a state; return the state."""
        qd = qd.copy()
        self.fastest = max(self.fastest, float(np.abs(qd).max(initial=0.0)))
        self.joints.still(qd, self.fastest)
        state = self.bearings.place(q[None], qd[None], piece.at(time, q, qd)[None])
        modes, rub = self.bearings.settle(state, qd, self.released)
        self.passed = (*self.passed, *self.compare(time, qd, modes))
        self.modes, self.released = modes, {}
        self.locking, self.holding = np.flatnonzero(modes == Mode.STICKS), rub.lam[0]
        return q, qd

    def explain(self, halt: BaseException) -> BaseException:
        """Return why steps end early: where loads are not known, of which joints, and whether none or several."""
        if not self.plant.is_lost:
            return halt
        assert self.modes is not None, "steps have a mode"
        pattern = self.bearings.read(self.modes)
        q, qd, v = (self.plant.memory.arrays[name][None] for name in ("q", "qd", "v"))
        try:
            self.bearings.slide(self.bearings.place(q, qd, v[:, :-1]), qd, pattern)
        except LoadError as error:
            return error
        return self.bearings.doubt(pattern.sliding)

    def push(self, piece: Piece) -> Push:
        """Return accelerations and the power of friction by loads in the present mode, as a function of states."""
        assert self.modes is not None, "a mode was found"
        pattern = self.bearings.read(self.modes)

        def find(t: Array, q: Array, qd: Array) -> tuple[Array, Array, Array]:
            found = self.bearings.slide(self.bearings.place(q, qd, piece.follow(t, q, qd)), qd, pattern)
            lost = (self.bearings.rub(qd) * found.loads * np.abs(qd)).sum(axis=1)
            return found.qdd, np.zeros((len(t), 0)), lost

        return find
