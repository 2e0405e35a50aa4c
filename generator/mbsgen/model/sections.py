"""The parts of a model file that joints of every type share: numbers, directions, placements, settings.

A section is the shape of one mapping in the file; its examples show users what is right, and replace wrong values while
the rest of the file is examined. Lengths are in m, angles in rad, forces in N, moments in N m.
"""

from __future__ import annotations

import math
import operator
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from mbsgen import documents
from mbsgen.algebra.dense import combine, cross, dot, identity, times, transpose
from mbsgen.documents import Read, Section, WrongValueError, abbreviate
from mbsgen.expressions import FLOATS, Expression, ExpressionError, evaluate
from mbsgen.model.model import (
    ONE,
    ORIGIN,
    UNITS,
    ZERO,
    BearingLoad,
    DryFriction,
    Follow,
    Friction,
    Joint,
    Law,
    Placement,
    Rotation,
    Stops,
    Triple,
)
from mbsgen.model.orientations import turn_quaternion, write_turns

_DIRECTION = "give x, y, z, -x, -y, -z or a direction such as [0, 0.6, 0.8]"


def read_number(value: Any) -> Expression:
    """Read a number or an expression."""
    return documents.read_number(value, example="l1/2")


def read_limit(value: Any) -> Expression | None:
    """Read a number, an expression, or nothing where there is no limit."""
    if isinstance(value, float) and math.isinf(value):
        raise WrongValueError(f"found {value}", "give null where there is no limit")
    return None if value is None else read_number(value)


def read_optional_number(value: Any) -> Expression | None:
    """Read a number, an expression, or nothing."""
    return None if value is None else read_number(value)


def read_direction(value: Any) -> Triple:
    """Read a named axis or three numbers."""
    if isinstance(value, str) and value in UNITS:
        return UNITS[value]
    if isinstance(value, list) and len(value) == 3:
        a, b, c = map(read_number, value)
        return a, b, c
    raise WrongValueError(f"found {abbreviate(value)}", _DIRECTION)


def read_optional_direction(value: Any) -> Triple | None:
    """Read a direction, or nothing."""
    return None if value is None else read_direction(value)


Written = float | str  # a number, or an expression
WrittenDirection = Literal["x", "y", "z", "-x", "-y", "-z"] | tuple[Written, Written, Written]
NumberField = Annotated[Expression, Read(read_number, Written)]
LimitField = Annotated[Expression | None, Read(read_limit, Written | None)]
OptionalNumberField = Annotated[Expression | None, Read(read_optional_number, Written | None)]
DirectionField = Annotated[Triple, Read(read_direction, WrittenDirection)]
OptionalDirectionField = Annotated[Triple | None, Read(read_optional_direction, WrittenDirection | None)]
TripleField = tuple[NumberField, NumberField, NumberField]


class RotationSection(Section):
    """A rotation about one axis of the frame turned so far."""

    axis: Literal["x", "y", "z"] = Field(examples=["z"])
    angle: NumberField = Field(examples=[0.5])


_RPY = ("roll", "pitch", "yaw")


class RpySection(Section):
    """Roll, pitch and yaw: rotations about x, then y, then z of the frame that is turned from."""

    rpy: TripleField = Field(examples=[[0.0, 0.0, 0.5]], description="rad")

    @property
    def turns(self) -> tuple[Rotation, ...]:
        """The same as rotations in turn."""
        return tuple(Rotation(k, self.rpy[k], _RPY[k]) for k in (2, 1, 0) if self.rpy[k] != ZERO)


def read_quaternion(value: Any) -> tuple[Rotation, ...]:
    """Read a quaternion x, y, z, w of any length but 0."""
    if not isinstance(value, list) or len(value) != 4:
        raise WrongValueError(f"found {abbreviate(value)}", "give x, y, z, w, the scalar last")
    x, y, z, w = map(_read_constant, value)
    if max(map(abs, (x, y, z, w))) < _SHORTEST:
        raise WrongValueError("a quaternion of length 0", "give x, y, z, w of length 1")
    return write_turns(turn_quaternion((w, x, y, z)))


def read_matrix(value: Any) -> tuple[Rotation, ...]:
    """Read the rows of a rotation matrix, whose columns are the axes of the frame."""
    rows = value if isinstance(value, list) else []
    if len(rows) != 3 or not all(isinstance(row, list) and len(row) == 3 for row in rows):
        raise WrongValueError(f"found {abbreviate(value)}", "give three rows of three numbers")
    R = tuple(tuple(_read_constant(entry) for entry in row) for row in rows)
    columns = transpose(R)
    gaps = combine(operator.sub, times(columns, R), identity(3))
    off = max(abs(gap) for row in gaps for gap in row)
    if not off <= _LOOSE:
        raise WrongValueError(f"the columns are not orthonormal: they are off by {off:.2g}", "give more digits")
    x, y, z = columns
    if dot(cross(x, y), z) < 0:
        raise WrongValueError("the axes are left-handed", "change the sign of one column")
    return write_turns(R)


def _read_constant(value: Any) -> float:
    try:
        return evaluate(read_number(value), {}, FLOATS)
    except ExpressionError as error:
        raise WrongValueError(error.finding, "give a number, such as 0.5 or sqrt(2)/2") from None


_SHORTEST = 1e-100  # of a quaternion
_LOOSE = 1e-5  # of the products of a matrix' columns: six digits are written often
WrittenRow = tuple[Written, Written, Written]


class QuaternionSection(Section):
    """An orientation by a quaternion of any length."""

    quaternion: Annotated[
        tuple[Rotation, ...],
        Read(read_quaternion, tuple[Written, Written, Written, Written]),
    ] = Field(examples=[[0.0, 0.0, 0.0, 1.0]], description="x, y, z, w: the scalar last")

    @property
    def turns(self) -> tuple[Rotation, ...]:
        """The same as rotations in turn."""
        return self.quaternion


class MatrixSection(Section):
    """An orientation by a rotation matrix."""

    matrix: Annotated[
        tuple[Rotation, ...],
        Read(read_matrix, tuple[WrittenRow, WrittenRow, WrittenRow]),
    ] = Field(
        examples=[[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]],
        description="by rows; its columns are the frame's axes",
    )

    @property
    def turns(self) -> tuple[Rotation, ...]:
        """The same as rotations in turn."""
        return self.matrix


def _name_form(value: Any) -> str:
    if isinstance(value, dict | Section):
        keys = value.keys() if isinstance(value, dict) else type(value).model_fields.keys()
        return next((key for key in ("quaternion", "matrix") if key in keys), "rpy")
    return "turns"


OrientationField = Annotated[
    Annotated[tuple[RotationSection, ...], Tag("turns")]
    | Annotated[RpySection, Tag("rpy")]
    | Annotated[QuaternionSection, Tag("quaternion")]
    | Annotated[MatrixSection, Tag("matrix")],
    Discriminator(_name_form),
]


class PlacementSection(Section):
    """Where a frame stands: its origin and its orientation, by rotations in turn, each about the axes turned so far."""

    position: TripleField = Field(ORIGIN, examples=[[0.1, 0.0, 0.0]])
    orientation: OrientationField = Field((), examples=[[{"axis": "x", "angle": 0.5}]])

    @property
    def placement(self) -> Placement:
        """The same as a part of a Model."""
        given = self.orientation
        if isinstance(given, tuple):
            return Placement(self.position, tuple(Rotation("xyz".index(step.axis), step.angle) for step in given))
        return Placement(self.position, given.turns)


class BearingSection(Section):
    """Friction by the joint's own reaction: coefficient times the forces of its bearings across its axis."""

    coefficient: NumberField = Field(examples=[0.15], description="Coulomb's coefficient of sliding")
    static: OptionalNumberField = Field(
        None, examples=[0.2], description="the coefficient at rest; by default the same"
    )
    radius: OptionalNumberField = Field(None, examples=[0.01], description="m, of the pin of a revolute joint")
    length: OptionalNumberField = Field(
        None,
        examples=[0.1],
        description="m, between two bearings beside the joint's origin, which carry moments too; else there is one",
    )


class FrictionSection(Section):
    """Dry friction: smoothed by a speed, -torque*tanh(qd/speed); without one the joint sticks and slides."""

    torque: NumberField = Field(examples=[0.5], description="Nm; of a prismatic joint, the force in N")
    speed: OptionalNumberField = Field(
        None, examples=[0.01], description="smooths: at this speed 3/4 of it are reached, in rad/s or m/s"
    )
    static: OptionalNumberField = Field(
        None, examples=[0.6], description="the most that holds the joint at rest; by default the same"
    )
    stribeck: OptionalNumberField = Field(
        None,
        examples=[0.02],
        description="speed over which static falls to torque, rad/s or m/s; by default at once",
    )
    one_way: OptionalNumberField = Field(
        None, examples=[None], description="of a one-way clutch: 1 or -1, the only way in which the joint moves"
    )
    load: BearingSection | None = Field(
        None, examples=[{"coefficient": 0.15, "radius": 0.01}], description="added to torque: by the joint's reaction"
    )

    def read(self) -> tuple[Friction | None, DryFriction | None]:
        """Return friction that is smoothed, or dry, as parts of a Model."""
        load = None if self.load is None else BearingLoad(**dict(self.load))
        return read_friction(**{**dict(self), "load": load})


class StopsSection(Section):
    """The stops of a joint at its limits: rigid, or compliant."""

    restitution: OptionalNumberField = Field(
        None, examples=[0.5], description="of rigid stops: the part of the speed that is kept, 0 to 1"
    )
    stiffness: OptionalNumberField = Field(
        None, examples=[1e4], description="of compliant stops: Nm/rad, of a prismatic joint N/m"
    )
    dissipation: NumberField = Field(
        ZERO, examples=[0.5], description="of compliant stops: Hunt and Crossley's factor of the speed, s/rad or s/m"
    )


def read_friction(
    torque: Expression,
    speed: Expression | None = None,
    static: Expression | None = None,
    stribeck: Expression | None = None,
    one_way: Expression | None = None,
    load: BearingLoad | None = None,
) -> tuple[Friction | None, DryFriction | None]:
    """Return friction that is smoothed, or dry; of numbers that contradict each other both, which a check refuses."""
    smooth = None if speed is None else Friction(torque, speed)
    is_dry = smooth is None or any(x is not None for x in (static, stribeck, one_way, load))
    return smooth, DryFriction(torque, static, stribeck, one_way, load) if is_dry else None


class FollowSection(Section):
    """A joint without a coordinate: it follows another one, as by a gear or a linkage."""

    joint: str = Field(examples=["q1"], description="the joint that it follows")
    ratio: NumberField = Field(ONE, examples=[-1.0], description="of its q to the q of the other joint")
    offset: NumberField = Field(ZERO, examples=[0.1], description="its q where the other's is 0")


class SettingSection(Section):
    """The settings of an elementary joint beside its axis."""

    name: str | None = Field(None, examples=["q1"], description="else the body's, or made of it and the axis")
    actuated: bool | None = Field(None, examples=[True], description="whether it takes an input u; else it is passive")
    limits: tuple[LimitField, LimitField] = Field((None, None), examples=[[-1.0, 1.0]], description="rad or m")
    max_speed: LimitField = Field(None, examples=[2.0], description="of qd either way, rad/s or m/s")
    max_force: LimitField = Field(None, examples=[50.0], description="of the input u either way, Nm or N")
    stiffness: NumberField = Field(ZERO, examples=[10.0], description="of a spring: -stiffness*(q - rest)")
    rest: NumberField = Field(ZERO, examples=[0.1], description="q where the spring is slack")
    damping: NumberField = Field(ZERO, examples=[0.1], description="of a damper: -damping*qd")
    friction: FrictionSection | None = Field(None, examples=[{"torque": 0.5, "speed": 0.01}])
    stops: StopsSection | None = Field(None, examples=[{"restitution": 0.5}], description="at the limits")
    follows: FollowSection | None = Field(
        None, examples=[{"joint": "q1", "ratio": -1.0}], description="another joint; then it has no coordinate and no u"
    )
    armature: NumberField = Field(
        ZERO, examples=[0.02], description="of a rotor: its inertia times the gear ratio squared, in kg m2 or kg"
    )
    force: NumberField = Field(
        ZERO, examples=["-2*q**3"], description="Nm or N, added to all else: an expression over parameters, q and qd"
    )

    def apply(self, joint: Joint) -> Joint:
        """Return an elementary joint with these settings."""
        smooth, dry = (None, None) if self.friction is None else self.friction.read()
        ends = None if self.stops is None else Stops(**dict(self.stops))
        followed = self.follows
        follows = None if followed is None else Follow(followed.joint, followed.ratio, followed.offset)
        actuated = joint.actuated and follows is None
        return replace(
            joint,
            name=self.name,
            actuated=actuated if self.actuated is None else self.actuated,
            lower=self.limits[0],
            upper=self.limits[1],
            max_speed=self.max_speed,
            max_force=self.max_force,
            law=Law(self.stiffness, self.rest, self.damping, smooth, self.force),
            armature=self.armature,
            follows=follows,
            dry=dry,
            stops=ends,
        )
