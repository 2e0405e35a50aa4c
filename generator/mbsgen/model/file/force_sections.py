"""Force elements and contacts in a model file: sections -> parts of a Model."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Union

from pydantic import Field

from mbsgen.documents import Read, Section
from mbsgen.expressions import Number
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.file.loops import LoopEndSection
from mbsgen.model.file.tir import TyreFile
from mbsgen.model.file.visual_sections import read_file_name
from mbsgen.model.model import (
    BASE,
    GROUND,
    HERTZ,
    ORIGIN,
    UNITS,
    WIDTH,
    ZERO,
    Block,
    Cable,
    Capsule,
    Contact,
    ForceElement,
    Grip,
    Hull,
    Other,
    PathPoint,
    Plane,
    Presence,
    Sphere,
    Stop,
    Stops,
    Wheel,
    Wrap,
)
from mbsgen.model.muscle_curves import DEGROOTE, Curves, Millard, Thelen
from mbsgen.model.muscles import ONE, PASSIVE, SPEED, STRAIN, Muscle
from mbsgen.model.sections import (
    DirectionField,
    LimitField,
    NumberField,
    OptionalNumberField,
    PlacementSection,
    TripleField,
)
from mbsgen.model.tyres import BRUSH, FADING, MAGIC, WAYS, Tyre, drop_unread


class PresenceSection(Section):
    """The range of a coordinate in which a line passes a point."""

    number: str = Field(examples=["q_knee"], description="q_NAME of a joint")
    range: tuple[NumberField, NumberField] = Field(examples=[[-0.5, 0.2]], description="rad or m")


class PathPointSection(LoopEndSection):
    """A point that the line of a force passes."""

    shift: TripleField = Field(
        ORIGIN, examples=[["0.01*q_knee", 0.0, 0.0]], description="along its axes, over q_NAME of joints, m"
    )
    presence: PresenceSection | None = Field(
        None, alias="while", examples=[{"number": "q_knee", "range": [-0.5, 0.2]}], description="else always"
    )

    @property
    def point(self) -> PathPoint:
        """The same as a part of a Model."""
        own = self.presence
        presence = None if own is None else Presence(own.number, *own.range)
        return PathPoint(self.body, self.placement, self.shift, presence)


class AroundSection(LoopEndSection):
    """A surface around which the line of a force wraps where it would cut it."""

    side: Literal["x", "-x", "y", "-y", "z", "-z"] | None = Field(
        None, examples=["-y"], description="the half on which the line stays; else it takes the nearer way"
    )
    between: tuple[int, int] | None = Field(
        None, examples=[[1, 2]], description="numbers of points of the line, from 1, between which it wraps; else all"
    )


class RoundSection(AroundSection):
    """A cylinder about its z axis, or a sphere, around which the line of a force wraps where it would cut it."""

    type: Literal["cylinder", "sphere"] = Field(examples=["cylinder"])
    radius: NumberField = Field(examples=[0.03], description="m")
    length: Annotated[NumberField | None, Field(examples=[0.1], description="of a cylinder, m; else without ends")] = (
        None
    )

    def make(self) -> Wrap:
        """Make the part of a Model."""
        size, side = (self.radius,), self.side or ""
        return Wrap(size, self.body, self.placement, self.type, self.length, side, self.between)


class EllipsoidSection(AroundSection):
    """An ellipsoid along the axes of its frame, around which the line of a force wraps where it would cut it."""

    type: Literal["ellipsoid"] = Field(examples=["ellipsoid"])
    radii: TripleField = Field(examples=[[0.03, 0.02, 0.04]], description="half axes, m")
    method: Literal["hybrid", "midpoint", "axial"] = Field(
        "hybrid", examples=["midpoint"], description="how the line finds its plane, as in OpenSim"
    )

    def make(self) -> Wrap:
        """Make the part of a Model."""
        side = self.side or ""
        return Wrap(self.radii, self.body, self.placement, self.type, None, side, self.between, self.method)


class TorusSection(AroundSection):
    """A torus about its z axis, through which the line of a force passes."""

    type: Literal["torus"] = Field(examples=["torus"])
    radius: NumberField = Field(examples=[0.03], description="of the ring in the middle of its tube, m")
    tube: NumberField = Field(examples=[0.005], description="the radius of the tube, m")

    def make(self) -> Wrap:
        """Make the part of a Model."""
        size, side = (self.radius, self.tube), self.side or ""
        return Wrap(size, self.body, self.placement, self.type, None, side, self.between)


WrapSection = Annotated[
    Union[RoundSection, EllipsoidSection, TorusSection],  # noqa: UP007
    Field(discriminator="type", examples=[{"type": "cylinder", "body": "thigh", "radius": 0.03}]),
]


class TendonSection(Section):
    """An elastic tendon, in series with the fibres of a muscle."""

    state: NumberField = Field(
        examples=["soleus_tendon"],
        description="a signal, as a rule: with De Groote's curves force over strength, else its strain over `strain`",
    )
    strain: NumberField = Field(STRAIN, examples=[0.049], description="at which it pulls with the strength")


class DeGrooteSection(Section):
    """The curves of De Groote and others (2016)."""

    type: Literal["degroote"] = Field(examples=["degroote"])

    def make(self) -> Curves:
        """Make the part of a Model."""
        return DEGROOTE


class ThelenSection(Section):
    """The curves of Thelen (2003)."""

    type: Literal["thelen"] = Field(examples=["thelen"])
    active_shape: NumberField = Field(Thelen.active_shape, examples=[0.45], description="of active force over length")
    passive_shape: NumberField = Field(Thelen.passive_shape, examples=[5.0], description="exponent of passive force")
    velocity_shape: NumberField = Field(Thelen.velocity_shape, examples=[0.25], description="of force over velocity")
    greatest: NumberField = Field(Thelen.greatest, examples=[1.4], description="force of fibres that lengthen")
    reach: NumberField = Field(
        Thelen.reach, examples=[0.95], description="part of it from which the force is a line over velocity"
    )

    def make(self) -> Curves:
        """Make the part of a Model."""
        return Thelen(**{key: getattr(self, key) for key in Thelen().numbers})


class MillardSection(Section):
    """The curves of Millard and others (2013); lengths are over `fibre`, forces over `strength`."""

    type: Literal["millard"] = Field(examples=["millard"])
    shortest: NumberField = Field(Millard.shortest, examples=[0.4441], description="length of active fibres")
    transition: NumberField = Field(
        Millard.transition, examples=[0.73], description="length from which active force rises less steeply"
    )
    longest: NumberField = Field(Millard.longest, examples=[1.8123], description="length of active fibres")
    shallow: NumberField = Field(Millard.shallow, examples=[0.8616], description="slope of active force there")
    floor: NumberField = Field(Millard.floor, examples=[0.1], description="least active force")
    shortening_end: NumberField = Field(
        Millard.shortening_end, examples=[0.1], description="slope of force over velocity where fibres shorten fastest"
    )
    shortening_near: NumberField = Field(Millard.shortening_near, examples=[0.25], description="and near that")
    isometric: NumberField = Field(Millard.isometric, examples=[5.0], description="slope at rest")
    lengthening_near: NumberField = Field(
        Millard.lengthening_near, examples=[0.15], description="slope near the largest speed of lengthening"
    )
    lengthening_end: NumberField = Field(Millard.lengthening_end, examples=[0.1], description="and at that")
    greatest: NumberField = Field(Millard.greatest, examples=[1.4], description="force of fibres that lengthen fastest")
    shortening_curviness: NumberField = Field(Millard.shortening_curviness, examples=[0.6], description="0 to 1")
    lengthening_curviness: NumberField = Field(Millard.lengthening_curviness, examples=[0.9], description="0 to 1")
    slack: NumberField = Field(
        Millard.slack, examples=[0.05], description="strain at which passive fibres begin to pull"
    )
    passive_low: NumberField = Field(Millard.passive_low, examples=[0.2], description="slope of passive force there")
    passive_slope: OptionalNumberField = Field(
        None, examples=[2.86], description="where they pull with the strength; else 2/(passive - slack)"
    )
    passive_curviness: NumberField = Field(Millard.passive_curviness, examples=[0.75], description="0 to 1")
    tendon_slope: OptionalNumberField = Field(
        None, examples=[28.1], description="of an elastic tendon that pulls with the strength; else 1.375/strain"
    )
    tendon_toe: NumberField = Field(
        Millard.tendon_toe, examples=[0.667], description="force from which the tendon's is a line"
    )
    tendon_curviness: NumberField = Field(Millard.tendon_curviness, examples=[0.5], description="0 to 1")

    def make(self) -> Curves:
        """Make the part of a Model."""
        names = Millard(passive_slope=ZERO, tendon_slope=ZERO).numbers
        return Millard(**{key: getattr(self, key) for key in names})


CurvesSection = Annotated[
    Union[DeGrooteSection, ThelenSection, MillardSection],  # noqa: UP007
    Field(discriminator="type", examples=[{"type": "millard"}]),
]


class MuscleSection(Section):
    """A muscle of Hill's type."""

    strength: NumberField = Field(examples=[450.0], description="largest isometric force, N")
    fibre: NumberField = Field(examples=[0.11], description="length at which fibres are strongest, m")
    tendon: NumberField = Field(examples=[0.06], description="length of the slack tendon, m")
    activation: NumberField = Field(examples=["deltoid"], description="a signal, as a rule")
    pennation: NumberField = Field(ZERO, examples=["15 deg"], description="of fibres of that length, rad")
    speed: NumberField = Field(SPEED, examples=[10.0], description="at which they shorten without force, lengths/s")
    damping: NumberField = Field(ZERO, examples=[0.01], description="of fibres: force over strength at that speed")
    passive: NumberField = Field(
        PASSIVE, examples=[0.6], description="strain of passive fibres that pull with the strength; 0: none pull"
    )
    width: NumberField = Field(ONE, examples=[1.5], description="by which the curve of active force is stretched")
    elastic: TendonSection | None = Field(None, examples=[None], description="else the tendon is rigid")
    curves: CurvesSection | None = Field(None, examples=[None], description="else `degroote`")

    def make(self) -> Muscle:
        """Make the part of a Model."""
        return Muscle(
            self.strength,
            self.fibre,
            self.tendon,
            self.activation,
            self.pennation,
            self.speed,
            self.damping,
            self.passive,
            self.width,
            None if self.elastic is None else self.elastic.state,
            STRAIN if self.elastic is None else self.elastic.strain,
            DEGROOTE if self.curves is None else self.curves.make(),
        )


ABSENT = Number(1.0)  # a stiffness that is missing, which the reader refuses


class ForceSection(Section):
    """A force along the line through frames: a spring and damper, a cable, or a muscle."""

    name: str = Field(examples=["strut"])
    type: Literal["spring", "cable", "muscle"] = Field(
        "spring", examples=["spring"], description="a cable cannot push; a muscle has its numbers under muscle"
    )
    first: PathPointSection = Field(alias="from", examples=[{"body": BASE}])
    second: PathPointSection = Field(alias="to", examples=[{"body": BASE}])
    via: tuple[PathPointSection, ...] = Field((), examples=[[]], description="points that the line passes, in order")
    wraps: tuple[WrapSection, ...] = Field((), examples=[[]], description="surfaces around which the line wraps")
    muscle: MuscleSection | None = Field(None, examples=[None], description="of a muscle")
    stiffness: NumberField = Field(ZERO, examples=[100.0], description="N/m")
    rest: NumberField = Field(ZERO, examples=[0.3], description="length at which it is slack, m")
    damping: NumberField = Field(ZERO, examples=[2.0], description="of a spring: N s/m")
    dissipation: NumberField = Field(
        ZERO, examples=[0.1], description="of a cable: by which part of itself the tension grows with the rate, s/m"
    )
    width: NumberField = Field(
        WIDTH, examples=[1e-3], description="of a cable: of the transition from slack to tight, m; else 1e-4"
    )
    force: NumberField = Field(
        ZERO, examples=["-2*rate"], description="N, further tension: over parameters, length, rate and the state"
    )

    def make(self) -> ForceElement:
        """Make the part of a Model."""
        cable = Cable(self.width, self.dissipation) if self.type == "cable" else None
        ends = self.first.point, self.second.point
        via = tuple(section.point for section in self.via)
        muscle = None if self.muscle is None else self.muscle.make()
        if self.type == "muscle" and muscle is None:
            muscle = Muscle(ZERO, ZERO, ZERO, ZERO)  # its checks name what is missing
        return ForceElement(
            self.name,
            *ends,
            self.stiffness,
            self.rest,
            self.damping,
            cable,
            self.force,
            via,
            muscle,
            tuple(section.make() for section in self.wraps),
        )


class PlaneSection(Section):
    """A plane on a body, or on the base; without anything, the ground z = 0."""

    body: str = Field(BASE, examples=[BASE], description="a body, or base")
    position: TripleField = Field(ORIGIN, examples=[[0.0, 0.0, 0.1]], description="of a point of it, in that frame, m")
    normal: DirectionField = Field(UNITS["z"], examples=["z"], description="out of the solid, in that frame")


class OtherSphereSection(Section):
    """A sphere on a body, or on the base, that a sphere touches."""

    body: str = Field(BASE, examples=[BASE], description="a body, or base")
    position: TripleField = Field(ORIGIN, examples=[[0.0, 0.0, 0.1]], description="of its centre, in that frame, m")
    radius: NumberField = Field(examples=[0.05], description="m")
    inside: bool = Field(False, examples=[False], description="hollow: the contact's sphere stays within")


class OtherBoxSection(PlacementSection):
    """A box on a body, or on the base, that a sphere touches."""

    body: str = Field(BASE, examples=[BASE], description="a body, or base")
    size: TripleField = Field(examples=[[0.3, 0.2, 0.1]], description="its edges, m; its centre is its origin")


class OtherCapsuleSection(PlacementSection):
    """A cylinder with round ends on a body, or on the base, that a sphere touches; it is along its z axis."""

    body: str = Field(BASE, examples=[BASE], description="a body, or base")
    radius: NumberField = Field(examples=[0.05], description="m")
    length: NumberField = Field(examples=[0.4], description="between the centres of its ends, m")


class OtherHullSection(PlacementSection):
    """The convex hull of points on a body, or on the base; its edges are rounded by a radius."""

    body: str = Field(BASE, examples=[BASE], description="a body, or base")
    points: tuple[TripleField, ...] = Field(examples=[[[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]], description="m")
    radius: NumberField = Field(ZERO, examples=[0.01], description="m")


class StopSection(Section):
    """Stops at limits of a number of the pose: rigid, or compliant."""

    name: str = Field(examples=["strap"])
    quantity: NumberField = Field(
        examples=["q_drum - 2*z_pan"], description="over q_, x_, y_, z_ and length_NAME, and parameters"
    )
    limits: tuple[LimitField, LimitField] = Field(
        (None, None), examples=[[None, 0.5]], description="in the quantity's unit; a coupling with hold has none"
    )
    restitution: OptionalNumberField = Field(
        None, examples=[0.5], description="of rigid stops: the part of the speed that is kept, 0 to 1"
    )
    stiffness: OptionalNumberField = Field(
        None, examples=[None], description="of compliant stops, in place of a restitution: force over depth"
    )
    dissipation: NumberField = Field(
        ZERO, examples=[0.0], description="of compliant stops: Hunt and Crossley's factor of the speed, s/m or s/rad"
    )

    hold: NumberField = Field(
        ZERO, examples=[0.0], description="of rigid stops without a restitution: a latch that bears a pull up to this"
    )

    def make(self) -> Stop:
        """Make the part of a Model."""
        law = Stops(self.restitution, self.stiffness, self.dissipation)
        return Stop(self.name, self.quantity, *self.limits, law, self.hold)


class GripSection(Section):
    """Coulomb friction, smoothed: coefficient*normal force*v/sqrt(v**2 + speed**2); dry without a speed."""

    coefficient: NumberField = Field(examples=[0.8])
    speed: NumberField | None = Field(
        None, examples=[0.01], description="at which 7/10 of it are reached, m/s; a rigid contact has none"
    )


class WheelSection(Section):
    """A circle about an axis of the body; with the contact's radius it is a torus."""

    radius: NumberField | None = Field(
        None, examples=[0.35], description="m, of the circle; without, that in the file of the tyre"
    )
    axis: DirectionField = Field(UNITS["y"], examples=["y"], description="in the contact's frame")
    length: NumberField = Field(ZERO, examples=[0.2], description="of a cylinder between two such circles, m")


def _read_tyre_name(value: Any) -> str:
    return read_file_name(value, "road.tir", (".tir",))


TyreFileField = Annotated[str, Read(_read_tyre_name, str)]


class LengthsSection(Section):
    """Relaxation lengths of a tyre; without one, the slip that way acts at once."""

    longitudinal: NumberField | None = Field(None, examples=[0.3], description="m")
    lateral: NumberField | None = Field(None, examples=[0.5], description="m")


class BrushSection(Section):
    """A tyre of bristles on a rigid wheel."""

    longitudinal: NumberField = Field(examples=[8e4], description="force over slip, N")
    lateral: NumberField = Field(examples=[8e4], description="the same across; bristles are alike where both are")
    friction: NumberField = Field(examples=[0.9], description="Coulomb's coefficient")
    length: NumberField = Field(ZERO, examples=[0.06], description="half of the contact's, m: moment about z")
    relaxation: LengthsSection | None = Field(None, examples=[{"lateral": 0.5}], description="slips that are states")


class TyreSection(Section):
    """A tyre: by the Magic Formula, or a brush."""

    file: TyreFileField | None = Field(None, examples=["road.tir"], description="a TIR file below the model's folder")
    coefficients: dict[str, Annotated[NumberField, Field(examples=[1.0])]] = Field(
        {}, examples=[{"LMUX": 0.8}], description="of the Magic Formula, beside the file's or in place of them"
    )
    brush: BrushSection | None = Field(None, examples=[None], description="in place of a Magic Formula")
    mirrored: bool = Field(False, examples=[False], description="measured for the other side of a car")
    speed: NumberField = Field(FADING, examples=[0.1], description="below which slips fade, m/s")
    transient: bool = Field(
        False, examples=[False], description="slips of a Magic Formula are states, which relax by PTX1 to PTY2"
    )

    def make(self, table: TyreFile | None) -> Tyre:
        """Make the part of a Model, with the file that is named."""
        if self.brush is not None:
            numbers = tuple((key, getattr(self.brush, key)) for key in BRUSH)
            relaxation = self.brush.relaxation
            lengths = () if relaxation is None else tuple((x, y) for x in WAYS if (y := getattr(relaxation, x)))
            return Tyre("brush", numbers, self.speed, self.mirrored, lengths=lengths)
        given = {} if table is None else {key: Number(value) for key, value in table.magic.items()}
        magic = {key: None if x is None else Number(x) for key, x in MAGIC.items()} | given | self.coefficients
        known = tuple((key, x or ZERO) for key, x in magic.items())  # a check names what is missing
        return Tyre("magic", drop_unread(known, self.transient), self.speed, self.mirrored, self.transient)


class SphereLawSection(Section):
    """A law of a sphere: OpenSim's HuntCrossleyForce, or its SmoothSphereHalfSpaceForce."""

    type: Literal["hunt_crossley", "smooth"] = Field(examples=["smooth"])
    static: OptionalNumberField = Field(
        None, examples=[0.9], description="coefficient of friction where slip begins; else as of slip"
    )
    viscous: NumberField = Field(
        SphereLaw.viscous, examples=[0.5], description="part of friction that grows with the slip, s/m"
    )
    share: NumberField = Field(
        SphereLaw.share, examples=[0.5], description="part of the depth by which the sphere yields"
    )
    rounding: NumberField = Field(
        SphereLaw.rounding, examples=[1e-5], description="of smooth: of depths, m**2, and of slips, m**2/s**2"
    )
    depth_slope: NumberField = Field(SphereLaw.depth_slope, examples=[300.0], description="of smooth, 1/m")
    speed_slope: NumberField = Field(SphereLaw.speed_slope, examples=[50.0], description="of smooth, s/m")

    def make(self) -> SphereLaw:
        """Make the part of a Model."""
        return SphereLaw(self.type, **{key: getattr(self, key) for key in SphereLaw("smooth").keys})


class ContactSection(PlacementSection):
    """A contact of a sphere, a box or a hull with a plane, sphere, box, capsule or hull, or of a wheel with a plane."""

    name: str = Field(examples=["heel"])
    body: str = Field(examples=["foot"])
    radius: NumberField = Field(ZERO, examples=[0.03], description="of a sphere, m; a point without")
    size: Annotated[TripleField | None, Field(examples=[[0.3, 0.2, 0.1]], description="edges of a box, m")] = None
    points: Annotated[
        tuple[TripleField, ...], Field(examples=[[]], description="of a hull, m; with a radius, spheres about them")
    ] = ()
    wheel: WheelSection | None = Field(None, examples=[None], description="that rolls on a plane, in place of a size")
    plane: PlaneSection | None = Field(None, examples=[{"normal": "z"}], description="else the ground z = 0")
    sphere: OtherSphereSection | None = Field(None, examples=[None], description="in place of a plane")
    box: OtherBoxSection | None = Field(None, examples=[None], description="in place of a plane")
    capsule: OtherCapsuleSection | None = Field(None, examples=[None], description="in place of a plane")
    hull: OtherHullSection | None = Field(None, examples=[None], description="in place of a plane")
    stiffness: NumberField | None = Field(None, examples=[1e5], description="of a compliant contact, N/m**exponent")
    restitution: NumberField | None = Field(
        None, examples=[None], description="of a rigid contact, in place of a stiffness: 0 to 1"
    )
    exponent: NumberField = Field(HERTZ, examples=[1.5], description="of the depth: 1, 1.5, 2, 2.5 or 3")
    dissipation: NumberField = Field(
        ZERO, examples=[0.5], description="by which part of itself the force grows with the speed of approach, s/m"
    )
    width: NumberField = Field(
        WIDTH, examples=[1e-4], description="of the transition from distance to depth, m; else 1e-4"
    )
    friction: GripSection | None = Field(None, examples=[{"coefficient": 0.8, "speed": 0.01}])
    tyre: TyreSection | None = Field(None, examples=[None], description="of a wheel, in place of friction")
    law: SphereLawSection | None = Field(None, examples=[{"type": "smooth"}], description="of a sphere, as OpenSim's")

    @property
    def other(self) -> Other:
        """The side that is touched, as a part of a Model."""
        if self.box is not None:
            return Block(self.box.size, self.box.body, self.box.placement)
        if self.capsule is not None:
            return Capsule(self.capsule.radius, self.capsule.length, self.capsule.body, self.capsule.placement)
        if self.hull is not None:
            return Hull(self.hull.points, self.hull.radius, self.hull.body, self.hull.placement)
        if self.sphere is not None:
            return Sphere(self.sphere.radius, self.sphere.body, self.sphere.position, self.sphere.inside)
        return GROUND if self.plane is None else Plane(self.plane.body, self.plane.position, self.plane.normal)

    def make(self, table: TyreFile | None = None) -> Contact:
        """Make the part of a Model; `table` is the file of its tyre."""
        grip = None if self.friction is None else Grip(self.friction.coefficient, self.friction.speed)
        vertical = {} if table is None else table.vertical
        stiffness, exponent, dissipation, wheel = self.stiffness, self.exponent, self.dissipation, None
        if self.wheel is not None:
            free = vertical.get("UNLOADED_RADIUS")
            wheel = Wheel(
                self.wheel.radius or (ONE if free is None else Number(free)), self.wheel.axis, self.wheel.length
            )
        if stiffness is None and self.restitution is not None:
            stiffness = ZERO
        elif stiffness is None and table is not None and "VERTICAL_STIFFNESS" in vertical:
            stiffness, exponent = Number(vertical["VERTICAL_STIFFNESS"]), ONE
            dissipation = Number(vertical.get("VERTICAL_DAMPING", 0.0) / table.magic["FNOMIN"])
        return Contact(
            self.name,
            self.body,
            ABSENT if stiffness is None else stiffness,
            self.placement,
            self.radius,
            self.size,
            self.other,
            exponent,
            dissipation,
            self.width,
            grip,
            self.restitution,
            wheel,
            None if self.tyre is None else self.tyre.make(table),
            self.points,
            None if self.law is None else self.law.make(),
        )
