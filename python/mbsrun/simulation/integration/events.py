"""Motions from event to event: the course of integrators whose equations switch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import SingularError
from mbsrun.simulation.integration.steps import describe_singularity
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings

Array = NDArray[np.float64]

MANY = 100  # impacts at one time: the rest of them is one without rebounds
MOST = 1000  # impacts at one time
SOON = 1e-9  # s: a switch that follows another within this time is at once
CHATTER = 200  # switches at once end a motion


class Course(ABC):
    """A motion in the making: its mode holds from event to event, and over pieces of the inputs."""

    switches: ClassVar[str]  # in words
    lost: ClassVar[type[Exception]]  # raised where no mode goes on
    remedy: ClassVar[str]  # then

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.stalled, self.time = 0, -1.0

    @abstractmethod
    def settle(self, time: float, piece: Piece, q: Array, qd: Array) -> tuple[Array, Array]:
        """Pass the events at a state, and find the mode then; return the state."""

    @abstractmethod
    def run(self, piece: Piece, q: Array, qd: Array, allowance: Allowance) -> Iterator[Chunk]:
        """Integrate until an event or the end of the piece; the chunk of an event at once has one state."""

    def follow(self, piece: Piece, q: Array, qd: Array, allowance: Allowance) -> Iterator[Chunk]:
        """Go through a piece; yield the steps. Raises HaltError where the motion cannot go on."""
        time = piece.start
        try:
            while time < piece.end:
                allowance.spend()
                self._count(time)
                q, qd = self.settle(time, piece, q, qd)
                for chunk in self.run(replace(piece, start=time), q, qd, allowance):
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
        except self.lost as error:
            raise HaltError(Halt(time, None, str(error), self.remedy)) from None

    def _count(self, time: float) -> None:
        """Count the switches that follow each other at once."""
        self.stalled, self.time = (self.stalled + 1 if time - self.time <= SOON else 0), time
        if self.stalled > CHATTER:
            finding = f"{CHATTER} switches of {self.switches}, each within {SOON:g} s of the one before"
            raise HaltError(Halt(time, None, finding, "change a restitution or a friction a little"))
