"""The Model: a mechanism as its author describes it, in expressions over named parameters; checked, then frozen.

Bodies stand in any order and name their parents; joints turn about, or slide along, any axis. Lengths are in m, angles
in rad, masses in kg. A Model is read of a file (`reader`), or made in Python (`construction`), and can be written to a
file (`writer`). `reduction.build_tree` makes of it the Tree that the recursions read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType

from mbsgen.expressions import Call, Expression, Name, Negation, Number, Operation, names
from mbsgen.manifest import Shape
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.muscles import LENGTH as LENGTH
from mbsgen.model.muscles import LENGTH_RATE as LENGTH_RATE
from mbsgen.model.muscles import Muscle
from mbsgen.model.tree import Cut, Kind, Motion
from mbsgen.model.tyres import Tyre

BASE = "base"  # the name of the fixed base
COORDINATE, RATE = "q", "qd"  # a joint's own, in the expression of its force

Triple = tuple[Expression, Expression, Expression]

ZERO, ONE = Number(0.0), Number(1.0)
ORIGIN: Triple = (ZERO, ZERO, ZERO)
UNITS: Mapping[str, Triple] = MappingProxyType(
    {
        sign + axis: (Number(length * (axis == "x")), Number(length * (axis == "y")), Number(length * (axis == "z")))
        for sign, length in (("", 1.0), ("-", -1.0))
        for axis in "xyz"
    }
)  # the directions that have names


@dataclass(frozen=True)
class Parameter:
    """A named number; `value` may use constant parameters that stand before it."""

    name: str
    value: Expression
    kind: Kind = Kind.CONSTANT


@dataclass(frozen=True)
class Rotation:
    """A rotation about coordinate axis 0, 1 or 2."""

    axis: int
    angle: Expression
    name: str = field(default="", compare=False)  # of its angle, where the author does not list turns


@dataclass(frozen=True)
class Placement:
    """Where a frame stands in another: its origin, and rotations in turn, each about the axes turned so far."""

    position: Triple = ORIGIN
    orientation: tuple[Rotation, ...] = ()


HERE = Placement()


@dataclass(frozen=True)
class Row:
    """A row of a Denavit-Hartenberg table at q = 0, and the place of the whole on the body that carries it."""

    is_standard: bool  # else modified
    base: Placement
    a: Expression  # [m]
    alpha: Expression  # [rad]
    d: Expression  # [m]
    theta: Expression  # [rad]


@dataclass(frozen=True)
class Friction:
    """Dry friction, smoothed: -torque tanh(qd/speed)."""

    torque: Expression  # of a prismatic joint, the force [N m or N]
    speed: Expression  # at which 3/4 of it are reached [rad/s or m/s]


@dataclass(frozen=True)
class Law:
    """The force law of a joint, in the direction of q: the sum of its terms [N m or N]."""

    stiffness: Expression = ZERO
    rest: Expression = ZERO  # q of the slack spring
    damping: Expression = ZERO
    friction: Friction | None = None
    force: Expression = ZERO  # over parameters and the joint's own q and qd

    @property
    def total(self) -> Expression:
        """The law as one expression over parameters, q and qd."""
        total, *rest = [*self._terms()] or [ZERO]
        for term in rest:
            total = Operation("+", total, term)
        return total

    def _terms(self) -> Iterator[Expression]:
        q, qd = Name(COORDINATE), Name(RATE)
        if self.stiffness != ZERO:
            yield Negation(Operation("*", self.stiffness, q if self.rest == ZERO else Operation("-", q, self.rest)))
        if self.damping != ZERO:
            yield Negation(Operation("*", self.damping, qd))
        if self.friction is not None:
            slope = Call("tanh", (Operation("/", qd, self.friction.speed),))
            yield Negation(Operation("*", self.friction.torque, slope))
        if self.force != ZERO:
            yield self.force


FREE = Law()


@dataclass(frozen=True)
class BearingLoad:
    """Coulomb's friction by the forces that two bearings of a joint carry across its axis."""

    coefficient: Expression  # of sliding
    static: Expression | None = None  # of a joint at rest; None: the same
    radius: Expression | None = None  # of the pin of a revolute joint [m]
    length: Expression | None = None  # between the bearings [m]; None: they are one, which carries no moment by forces


@dataclass(frozen=True)
class DryFriction:
    """Coulomb's friction: a joint at rest sticks, a sliding one is braked; it is no part of the force law."""

    torque: Expression  # against sliding; of a prismatic joint, the force [N m or N]
    static: Expression | None = None  # the most that holds a joint at rest; None: the same
    stribeck: Expression | None = None  # speed over which `static` falls to `torque` [rad/s or m/s]; None: at once
    one_way: Expression | None = None  # of a clutch: 1 or -1, the only way in which the joint moves
    load: BearingLoad | None = None  # what the joint's own reaction adds


@dataclass(frozen=True)
class Stops:
    """The stops of a joint at its limits: rigid with a restitution, or compliant with a stiffness."""

    restitution: Expression | None = None  # the part of the speed that is kept; None: compliant
    stiffness: Expression | None = None  # [N m/rad or N/m]
    dissipation: Expression = ZERO  # of a compliant one, over the speed of entry [s/rad or s/m]


STOPS, LOAD = (tuple(x.name for x in fields(part)) for part in (Stops, BearingLoad))  # the keys of a file


@dataclass(frozen=True)
class Follow:
    """The rule of a joint without a coordinate: its q is ratio times the q of another joint, plus offset."""

    joint: str  # the other one's name
    ratio: Expression = ONE  # not 0
    offset: Expression = ZERO  # [rad or m]


@dataclass(frozen=True)
class Joint:
    """One degree of freedom: rotation about, or translation along, an axis."""

    motion: Motion
    axis: Triple  # a direction of any length, in the frame that moves
    name: str | None = None  # None: its body's, or derived from it (see `expansion`)
    placement: Placement = HERE  # of the frame that moves, at q = 0, in the frame that carries it
    actuated: bool = True
    lower: Expression | None = None  # None: unbounded
    upper: Expression | None = None
    law: Law = FREE
    max_speed: Expression | None = None  # of qd either way [rad/s or m/s]; None: unbounded
    max_force: Expression | None = None  # of its input u either way [N m or N]
    armature: Expression = ZERO  # of the rotor that drives it, times its gear ratio squared [kg m2 or kg]
    follows: Follow | None = None  # another joint; it has neither a coordinate nor an input then
    floats: bool = False  # one of the joints of a quaternion, see `joints`: at 0, in a moving frame
    part_of: str = ""  # the joint type that the author named, where its elementary joints alone do not show it
    row: Row | None = field(default=None, compare=False)  # of a table, which `placement` is of
    dry: DryFriction | None = None
    stops: Stops | None = None

    @property
    def acting_law(self) -> Law:
        """The force law with the forces of compliant stops: Hunt and Crossley's, which never pull.

        Of a depth x beyond a limit: stiffness max(x, 0) max(1 + dissipation dx/dt, 0).
        """
        if self.stops is None or self.stops.stiffness is None:
            return self.law
        q, qd, force = Name(COORDINATE), Name(RATE), self.law.force
        if self.lower is not None:
            pressed = press(self.stops, Operation("-", self.lower, q), Negation(qd))
            force = pressed if force == ZERO else Operation("+", force, pressed)
        if self.upper is not None:
            pressed = press(self.stops, Operation("-", q, self.upper), qd)
            force = Negation(pressed) if force == ZERO else Operation("-", force, pressed)
        return replace(self.law, force=force)


def press(stops: Stops, depth: Expression, rate: Expression) -> Expression:
    """Return the force of a compliant stop."""
    assert stops.stiffness is not None, "a compliant stop has a stiffness"
    force = Operation("*", stops.stiffness, Call("max", (depth, ZERO)))
    if stops.dissipation == ZERO:
        return force
    loss = Operation("+", ONE, Operation("*", stops.dissipation, rate))
    return Operation("*", force, Call("max", (loss, ZERO)))


@dataclass(frozen=True)
class Fixed:
    """A fixed connection of a body to its parent."""

    placement: Placement = HERE  # of the body's frame, in the parent's
    row: Row | None = field(default=None, compare=False)  # of a standard table: the body is beyond its joint


Carrier = Joint | Fixed | tuple[Joint, ...]  # a joint, nothing that moves, or joints in a row from the parent on


@dataclass(frozen=True)
class Inertia:
    """The inertia tensor in the body's axes, about the centre of mass or another point."""

    xx: Expression = ZERO
    yy: Expression = ZERO
    zz: Expression = ZERO
    xy: Expression = ZERO
    xz: Expression = ZERO
    yz: Expression = ZERO
    about: Triple | None = field(default=None, kw_only=True)  # in the body's frame [m]; None: the centre of mass

    @property
    def rows(self) -> tuple[Triple, Triple, Triple]:
        """The tensor as a symmetric matrix."""
        return (self.xx, self.xy, self.xz), (self.xy, self.yy, self.yz), (self.xz, self.yz, self.zz)


@dataclass(frozen=True)
class Visual:
    """A shape that draws a body, in the body's frame; nothing is computed with it."""

    shape: Shape
    size: tuple[Expression, ...]  # edges; diameters; radius; radius and length, twice; scales along the axes [m]
    placement: Placement = HERE
    color: str = ""  # "#rrggbb", or one of the palette
    file: str = ""  # of a mesh, below the model's folder


@dataclass(frozen=True)
class Body:
    """A rigid body, and what carries it: a joint, a sequence of joints from the parent on, or nothing that moves."""

    name: str
    joint: Carrier
    parent: str = BASE  # or a body's name
    mass: Expression = ZERO
    com: Triple = ORIGIN  # centre of mass, in the body's frame
    inertia: Inertia = Inertia()
    visuals: tuple[Visual, ...] = ()
    is_list: bool = field(default=False, compare=False)  # the file lists the joints, each with its own place
    slips_at: str = ""  # the contact of a tyre whose slip its speed is, see `slips`: no file has it

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The joints that carry the body, from the parent on."""
        match self.joint:
            case Fixed():
                return ()
            case Joint():
                return (self.joint,)
        return self.joint


@dataclass(frozen=True)
class Frame:
    """A named frame on a body."""

    name: str
    body: str
    placement: Placement = HERE
    is_sensor: bool = True  # its pose is an output; else only forces read it


@dataclass(frozen=True)
class Wrench:
    """An external force and moment on a body, at a point fixed in it: over parameters and numbers of the state."""

    name: str
    body: str
    position: Triple = ORIGIN  # of the point, in the body's frame
    in_base: bool = True  # components in the base's frame; else in the body's
    force: Triple | None = ORIGIN  # [N]; None: three numbers of the input w
    moment: Triple | None = ORIGIN  # [N m]; None: three more
    orientation: tuple[Rotation, ...] = ()  # of its frame in the body's, seen from `against`
    against: LoopEnd | None = None  # the frame along whose axes it acts, with the opposite on that body
    by_turns: bool = False  # the moment is about the turns x, y, z from that frame to its own; else about its axes

    @property
    def placement(self) -> Placement:
        """Return the place of its frame in the body's."""
        return Placement(self.position, self.orientation)


@dataclass(frozen=True)
class LoopEnd:
    """One end of a loop: a frame on a body."""

    body: str  # or BASE
    placement: Placement = HERE  # in the body's frame


@dataclass(frozen=True)
class Presence:
    """The range of a number of the state in which a line passes a point."""

    number: str  # q_NAME of a joint
    lower: Expression
    upper: Expression


@dataclass(frozen=True)
class PathPoint(LoopEnd):
    """A point that the line of a force element passes."""

    shift: Triple = ORIGIN  # along the axes of the placement, over q_NAME of joints [m]
    presence: Presence | None = None  # None: the line always passes it


@dataclass(frozen=True)
class Loop:
    """A joint that closes a loop of bodies, between frames on two of them; see `tree.Cut`."""

    name: str
    cut: Cut
    first: LoopEnd
    second: LoopEnd
    axis: Triple = UNITS["z"]  # in both frames; of a universal joint, the first axis, in the first frame
    axis2: Triple = UNITS["x"]  # of a universal joint: the second axis, in the second frame
    length: Expression = ZERO  # of a rod [m]
    pitch: Expression = ZERO  # of a helical joint [m/rad]


@dataclass(frozen=True)
class Cable:
    """The properties of a force element that can only pull."""

    width: Expression  # of the transition from slack to tight [m]
    dissipation: Expression = ZERO  # by which part of itself the tension grows with the rate [s/m]


SIZES = {  # of surfaces around which lines wrap, in order
    "cylinder": ("radius",),
    "sphere": ("radius",),
    "ellipsoid": ("x", "y", "z"),
    "torus": ("radius", "tube"),
}


@dataclass(frozen=True)
class Wrap:
    """A surface on a body, or on the base, around which the line of a force element wraps."""

    size: tuple[Expression, ...]  # radius; of a torus, of its ring and its tube; half axes of an ellipsoid [m]
    body: str = BASE
    placement: Placement = HERE  # of its centre and axes, in the body's frame; a cylinder and a torus are about z
    kind: str = "cylinder"  # sphere, ellipsoid, torus
    length: Expression | None = None  # of a cylinder [m]; None: no ends
    side: str = ""  # x, -x, y, ...: the half on which the line stays; "": the nearer way
    between: tuple[int, int] | None = None  # points of the line, from 1; None: all
    method: str = "hybrid"  # by which an ellipsoid finds its plane

    @property
    def axial(self) -> bool:
        """Return whether it is the same all around z."""
        return self.kind in ("cylinder", "torus")

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the names of its sizes."""
        return SIZES[self.kind]

    def span(self, points: int) -> tuple[int, int]:
        """Return the first and the last of some points between which the line may wrap, from 0."""
        first, last = self.between or (1, points)
        return first - 1, last - 1


@dataclass(frozen=True)
class ForceElement:
    """A force along the line through the origins of frames; a positive tension pulls them together."""

    name: str
    first: PathPoint
    second: PathPoint
    stiffness: Expression = ZERO  # [N/m]
    rest: Expression = ZERO  # the length of the slack spring [m]
    damping: Expression = ZERO  # [N s/m]
    cable: Cable | None = None
    force: Expression = ZERO  # further tension [N], over parameters, LENGTH, LENGTH_RATE and numbers of the state
    via: tuple[PathPoint, ...] = ()  # points that the line passes, from the first end to the second
    muscle: Muscle | None = None  # it has the tension; else None
    wraps: tuple[Wrap, ...] = ()  # between different points

    @property
    def law(self) -> Expression:
        """Return the tension beside springs and dampers."""
        return self.force if self.muscle is None else self.muscle.tension

    @property
    def reads(self) -> frozenset[str]:
        """Return the names in its law and of its muscle's signals."""
        own = names(self.law)
        return own if self.muscle is None else own | names(self.muscle.activation)

    @property
    def path(self) -> tuple[PathPoint, ...]:
        """Return all points of the line, in order."""
        return (self.first, *self.via, self.second)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return the bodies of all points, and of all surfaces around which it wraps."""
        return (*(x.body for x in self.path), *(x.body for x in self.wraps))

    @property
    def is_straight(self) -> bool:
        """Return whether the line is the one through two points that are fixed on their bodies."""
        return not self.via and not self.wraps and all(x.shift == ORIGIN for x in (self.first, self.second))


@dataclass(frozen=True)
class Plane:
    """A plane on a body, or on the base."""

    body: str = BASE
    position: Triple = ORIGIN  # of a point of it, in the body's frame [m]
    normal: Triple = UNITS["z"]  # out of the solid, in the body's frame

    @property
    def placement(self) -> Placement:
        """Where it stands, apart from its normal."""
        return Placement(self.position)


@dataclass(frozen=True)
class Sphere:
    """A sphere on a body, or on the base."""

    radius: Expression  # [m]
    body: str = BASE
    position: Triple = ORIGIN  # of its centre, in the body's frame [m]
    inside: bool = False  # it is hollow, and the other side stays within

    @property
    def placement(self) -> Placement:
        """Where its centre stands."""
        return Placement(self.position)


@dataclass(frozen=True)
class Block:
    """A box on a body, or on the base."""

    size: Triple  # its edges [m]
    body: str = BASE
    placement: Placement = HERE  # of its centre and its axes, in the body's frame


@dataclass(frozen=True)
class Capsule:
    """A cylinder with round ends on a body, or on the base: all points within the radius of a segment."""

    radius: Expression  # [m]
    length: Expression  # of the segment [m]
    body: str = BASE
    placement: Placement = HERE  # of its centre, in the body's frame; the segment is along the z axis


@dataclass(frozen=True)
class Hull:
    """The convex hull of points on a body, or on the base, with its edges rounded by a radius."""

    points: tuple[Triple, ...]  # in its frame [m]
    radius: Expression = ZERO  # [m]
    body: str = BASE
    placement: Placement = HERE  # of its frame, in the body's frame


Other = Plane | Sphere | Block | Capsule | Hull  # the side that a contact touches
GROUND = Plane()
HERTZ, WIDTH = Number(1.5), Number(1e-4)  # of a contact, unless it says otherwise


@dataclass(frozen=True)
class Grip:
    """Coulomb friction, smoothed: coefficient * normal force * v / sqrt(v.v + speed^2); or dry."""

    coefficient: Expression
    speed: Expression | None  # at which 7/10 of it are reached [m/s]; None: dry, of a rigid contact


@dataclass(frozen=True)
class Wheel:
    """A circle that turns with a body: the sphere of a contact moves along it, so that both make a torus."""

    radius: Expression  # [m]
    axis: Triple = UNITS["y"]  # in the contact's frame
    length: Expression = ZERO  # of a cylinder between two such circles [m]; 0: one circle


@dataclass(frozen=True)
class Contact:
    """A contact of a sphere, a box, or the hull of points with a plane, a sphere, a box, a capsule, or a hull.

    Edges of a hull are rounded by the radius. A wheel or a cylinder touches a plane.
    """

    name: str
    body: str
    stiffness: Expression  # [N/m^exponent]; 0 of a rigid contact
    placement: Placement = HERE  # of the centre of the sphere or the box, in the body's frame
    radius: Expression = ZERO  # of the sphere [m]; 0: a point
    size: Triple | None = None  # of a box [m]
    other: Other = GROUND  # the side that is touched
    exponent: Expression = HERTZ  # of the depth
    dissipation: Expression = ZERO  # by which part of itself the force grows with the rate of the depth [s/m]
    width: Expression = WIDTH  # of the transition from distance to depth [m]
    friction: Grip | None = None
    restitution: Expression | None = None  # of a rigid contact; None: compliant
    wheel: Wheel | None = None
    tyre: Tyre | None = None  # of a wheel, in place of friction
    points: tuple[Triple, ...] = ()  # of a hull, in the contact's frame [m]
    law: SphereLaw | None = None  # of a sphere, in place of the usual one

    @property
    def has_points(self) -> bool:
        """Return whether it touches at several points, with numbers from 1."""
        return self.size is not None or bool(self.points) or (self.wheel is not None and self.wheel.length != ZERO)

    @property
    def is_rigid(self) -> bool:
        """Return whether no kernel has its forces."""
        return self.restitution is not None

    @property
    def is_of_solids(self) -> bool:
        """Return whether two solids with corners touch, at points that follow from their pose."""
        if isinstance(self.other, Plane) or (isinstance(self.other, Sphere) and self.other.inside):
            return False  # each corner touches by itself
        return isinstance(self.other, Hull) or self.size is not None or bool(self.points)

    @property
    def key(self) -> str:
        """The key of the touched side in a file."""
        match self.other:
            case Sphere():
                return "sphere"
            case Block():
                return "box"
            case Capsule():
                return "capsule"
            case Hull():
                return "hull"
        return "plane"


@dataclass(frozen=True)
class Stop:
    """Stops at the limits of a number of the pose."""

    name: str
    quantity: Expression  # over coordinates, places of frames, lengths of force elements, and parameters
    lower: Expression | None  # None: no stop there
    upper: Expression | None
    law: Stops
    hold: Expression = ZERO  # of rigid ones: the largest pull that does not take the number away again

    @property
    def is_coupling(self) -> bool:
        """Return whether it holds the number wherever it is, at times that a simulation gives."""
        return self.lower is None and self.upper is None


@dataclass(frozen=True)
class Constraint:
    """An equation of coordinates: the expression is 0."""

    name: str
    equation: Expression  # over the names of joints, and parameters


@dataclass(frozen=True)
class Model:
    """A mechanism as its author describes it."""

    name: str
    gravity: Triple  # in the base's frame [m/s2]
    bodies: tuple[Body, ...]
    parameters: tuple[Parameter, ...] = ()
    frames: tuple[Frame, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    forces: tuple[ForceElement, ...] = ()
    contacts: tuple[Contact, ...] = ()
    stops: tuple[Stop, ...] = ()
    signals: tuple[str, ...] = ()  # numbers that forces read, and that a use gives: inputs of the code
    loops: tuple[Loop, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    driven: tuple[str, ...] = ()  # joints whose accelerations are given
    independent: tuple[str, ...] = ()  # joints whose coordinates determine all others; empty: they are chosen
    assembly: tuple[tuple[str, Expression], ...] = ()  # joints, and coordinates near which loops close; else 0
    loop_tolerance: Expression | None = None  # of equations that follow from others; None: by the digits
    allow_unphysical: bool = False  # take inertias that no body can have
