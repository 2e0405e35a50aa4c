"""The plan: for each body, the choices that change the cost of its equations but not their values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, TypeVar

from mbsgen.errors import TapeError
from mbsgen.tape.builder import Scalar


class NoSuchPlanError(TapeError):
    """A plan that a body's moments or parameters do not allow."""


class Mass(Enum):
    """The destination of the mass that a revolute joint allows to move: points on the axis belong to both bodies."""

    PASSED = "passed"  # all of it to the parent: no division
    BALANCING = (
        "balancing"  # as much as makes the parent's first moment vanish along its longest lever to the child; divides
    )
    KEPT = "kept"  # nothing moves, nor any other inertia that the joint cannot feel
    POINT = "point"  # the remainder is a point mass at the centre of percussion; divides by the body's inertia

    __hash__ = object.__hash__  # members are singletons; Enum's own hash is slower, also below


class Meeting(Enum):
    """The place where M meets the first and second moments of a body, and the loads of the joints from there on."""

    PASSED = "passed"  # at each joint before it: they are carried down
    BEYOND = "beyond"  # at the body: the motions of all joints before it are carried up
    SPLIT = "split"  # displacements without rotation at the body, as of levers in a group; others before its joint

    __hash__ = object.__hash__


Transferred = tuple[Mass, int]  # the mass that moves from a body, and the moment that becomes spin

_T = TypeVar("_T", "Choice", "Plan")


def _flip(chosen: _T, flag: str) -> _T:
    flipped: dict[str, Any] = {flag: not getattr(chosen, flag)}
    return replace(chosen, **flipped)


@dataclass(frozen=True)
class Choice:
    """How one body is written."""

    own_frame: bool = True  # its own frame, or the frame that its predecessor on parallel axes is written in
    mass: Mass = Mass.PASSED
    scaled: bool = False  # directions across the axis have the length of the link, instead of 1; divides by it
    spin_from: int = 1  # the transverse second moment that becomes spin: 0, 1: first, second axis after the joint's
    meeting: Meeting = Meeting.PASSED  # in M alone
    by_spin: bool = False  # U from the angular acceleration of the body before, not from its field along the axis
    by_rates: bool = False  # second moments across the axis by rates, not by U
    passes_spin: bool = False  # the momentum of the spin inertia turns with the body before
    by_columns: bool = False  # in sensitivities, entries of the joint that continues its group are added, not loads
    by_moments: bool = False  # in sensitivities, its moments turn with its joint, not the field of accelerations

    def flip(self, flag: str) -> Choice:
        """Return the choice with one of its flags the other way, by its name."""
        return _flip(self, flag)


@dataclass(frozen=True)
class Plan:
    """A choice for every body."""

    choices: tuple[Choice, ...]
    by_runtime: bool = False  # divisions by run-time parameters are allowed; by numbers they always are
    by_angles: bool = False  # M is written in absolute angles, and summed up
    together: int = 0  # in EXP2, joints with fewer joints before them are eliminated together, in M
    by_motions: bool = False  # in EXP2, loads and increments of bodies that M meets are by the motions brought to them
    turns_apart: bool = False  # in EXP2, such motions that turn meet a body before its joint is free
    first_resists: bool = False  # where M meets a body, it takes the load for the motion of the earlier of two joints
    shift_first: bool = False  # in EXP2, a link along the next joint's axis is passed before this joint turns inertia
    in_series: bool = False  # in EXP2, a point mass behind two joints is in series with the rotor between them
    by_levers: bool = False  # in M, second moments are of directions with lengths too
    by_squares: bool = False  # inertia without products across a joint's axis is turned by squares of the sine
    at_rest: bool = False  # in EXP2, other joints do not accelerate along their axes in the bias motion

    def __getitem__(self, number: int) -> Choice:
        """Look up the choice for body `number`, from 1."""
        return self.choices[number - 1]

    def put(self, number: int, choice: Choice) -> Plan:
        """Return the plan with another choice for one body."""
        return replace(self, choices=(*self.choices[: number - 1], choice, *self.choices[number:]))

    def flip(self, flag: str) -> Plan:
        """Return the plan with one of its flags the other way, by its name."""
        return _flip(self, flag)

    @property
    def moved(self) -> tuple[Transferred, ...]:
        """The choices that inertia moves by, of each body."""
        return tuple([(choice.mass, choice.spin_from) for choice in self.choices])

    @property
    def carried_down(self) -> Plan:
        """The same plan, in which all inertia is carried down."""
        return replace(self, choices=tuple(replace(x, meeting=Meeting.PASSED) for x in self.choices))

    def check_divisor(self, divisor: Scalar) -> None:
        """Raise NoSuchPlanError for a division that is not allowed."""
        if not (self.by_runtime or divisor.is_literal):
            raise NoSuchPlanError("a run-time parameter may be 0")
