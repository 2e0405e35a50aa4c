"""The plan: for each body, the choices that change what its equations cost but not what they compute."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from mbsgen.errors import TapeError
from mbsgen.tape.builder import Scalar


class NoSuchPlanError(TapeError):
    """A plan that asks of a body what its moments or its parameters do not allow."""


class Mass(Enum):
    """Where the mass goes that a revolute joint lets move between its two bodies: points on the axis belong to both."""

    PASSED = "passed"  # all of it to the parent: no division
    BALANCING = (
        "balancing"  # so much that the parent's first moment vanishes along its longest way to the child; divides
    )
    KEPT = "kept"  # nothing moves, nor any other inertia that the joint cannot feel
    POINT = "point"  # what stays makes the body a point mass at its centre of percussion; divides by its inertia


@dataclass(frozen=True)
class Choice:
    """How one body is written."""

    own_frame: bool = True  # in its own frame, or in the one that its predecessor on parallel axes is written in
    mass: Mass = Mass.PASSED
    scaled: bool = False  # directions across the axis have the length of the link, instead of 1; divides by it
    spin_from: int = 1  # the transverse second moment that becomes spin: 0, 1: first, second axis after the joint's


@dataclass(frozen=True)
class Plan:
    """A choice for every body."""

    choices: tuple[Choice, ...]
    by_runtime: bool = False  # divisions by run-time parameters are allowed; by numbers they always are

    def __getitem__(self, number: int) -> Choice:
        """Look up the choice for body `number`, from 1."""
        return self.choices[number - 1]

    def put(self, number: int, choice: Choice) -> Plan:
        """Choose otherwise for one body."""
        return replace(self, choices=(*self.choices[: number - 1], choice, *self.choices[number:]))

    def check_divisor(self, divisor: Scalar) -> None:
        """Raise NoSuchPlanError for a division that is not allowed."""
        if not (self.by_runtime or divisor.is_literal):
            raise NoSuchPlanError("a run-time parameter may be 0")
