"""The plan: for each body, the choices that change what its equations cost but not what they compute."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any


class Mass(Enum):
    """Where the mass goes that a revolute joint lets move between its two bodies: points on the axis belong to both."""

    PASSED = "passed"  # all of it to the parent: no division
    BALANCING = "balancing"  # so much that the parent's first moment along the link vanishes; divides by its length
    POINT = "point"  # what stays makes the body a point mass at its centre of percussion; divides by its inertia


@dataclass(frozen=True)
class Choice:
    """How one body is written."""

    own_frame: bool = True  # in its own frame, or in the one that its predecessor on parallel axes is written in
    mass: Mass = Mass.PASSED
    scaled: bool = False  # directions across the axis have the length of the link, instead of 1
    ring: int = 1  # which transverse second moment (0, 1: the first or second axis after the joint's) is spread evenly
    level: bool = False  # the part of it along the axis stays, and the body's ring is felt as a whole


@dataclass(frozen=True)
class Plan:
    """A choice for every body."""

    choices: tuple[Choice, ...]

    def __getitem__(self, number: int) -> Choice:
        """Look up the choice for body `number`, from 1."""
        return self.choices[number - 1]

    def put(self, number: int, choice: Choice) -> Plan:
        """Choose otherwise for one body."""
        return Plan((*self.choices[: number - 1], choice, *self.choices[number:]))

    def change(self, number: int, **values: Any) -> Plan:
        """Choose otherwise for one body, by name."""
        return self.put(number, replace(self[number], **values))


def plain_plan(size: int) -> Plan:
    """Write every body in its own frame, and divide by nothing."""
    return Plan((Choice(),) * size)
