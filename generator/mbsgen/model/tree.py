"""The Tree: bodies in order, one elementary joint each; the input of every formulation.

Body i (from 1) has parent `parent < i`; 0 is the base. Its frame has its origin at its joint and turns with it;
`orientation` holds its axes at q = 0 in the parent's frame. The joint axis is a coordinate axis of that frame. Numbers
are SymPy expressions in parameter symbols; a number 0 is structural.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import chain

from sympy import Expr, Integer, Symbol

COORDINATE = Symbol("q", real=True)  # a joint's own, in its force law; no parameter's symbol has assumptions
RATE = Symbol("qd", real=True)
NO_FORCE = Integer(0)

Vector = tuple[Expr, Expr, Expr]
Matrix = tuple[Vector, Vector, Vector]  # rows

ZERO, ONE = Integer(0), Integer(1)
IDENTITY: Matrix = ((ONE, ZERO, ZERO), (ZERO, ONE, ZERO), (ZERO, ZERO, ONE))


class Motion(Enum):
    """The motion of an elementary joint along its axis."""

    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


class Kind(Enum):
    """How a parameter enters generated code."""

    CONSTANT = "constant"  # folded
    RUNTIME = "runtime"  # an input of `setup`
    DIFFERENTIATED = "differentiated"  # an input of every kernel, by which its derivatives are taken too


@dataclass(frozen=True)
class Parameter:
    """A named number."""

    name: str
    symbol: Symbol
    value: float
    kind: Kind


@dataclass(frozen=True)
class Stops:
    """The limits at which a joint is stopped, None where it is not; no force of rigid ones is in the equations."""

    lower: float | None
    upper: float | None
    restitution: float | None  # of rigid stops; None: compliant, and part of the joint's law


@dataclass(frozen=True)
class BearingLoad:
    """Friction by the forces N [N] of a joint's bearings across its axis: coefficient times arm times their sum."""

    coefficient: float  # of sliding
    static: float  # of a joint at rest
    arm: float  # of a revolute joint, the radius of its pin [m]; else 1
    length: float | None  # between two bearings [m]; None: there is one


@dataclass(frozen=True)
class DryFriction:
    """Coulomb's friction [N m or N], which is not in the equations."""

    torque: float  # against sliding
    static: float  # the most that holds a joint at rest
    stribeck: float | None  # speed over which the latter falls to the former; None: at once
    one_way: int = 0  # of a clutch: 1 or -1, the only way in which the joint moves
    load: BearingLoad | None = field(default=None, repr=False)  # what the joint's reaction adds


@dataclass(frozen=True)
class Joint:
    """One degree of freedom: rotation (rad) or translation (m) about or along an axis of the body's frame."""

    name: str
    motion: Motion
    axis: int  # 0, 1, 2: x, y, z of the body's own frame
    actuated: bool
    lower: float | None  # None: unbounded
    upper: float | None
    law: Expr = NO_FORCE  # Qp(q, qd): force added to the actuator's, in COORDINATE, RATE and parameters [N m or N]
    max_speed: float | None = field(default=None, repr=False)  # of qd either way [rad/s or m/s]; None: unbounded
    max_force: float | None = field(default=None, repr=False)  # of u either way [N m or N]
    stops: Stops | None = field(default=None, repr=False)
    dry: DryFriction | None = field(default=None, repr=False)
    armature: Expr = field(default=ZERO, repr=False)  # what the rotor that drives it adds to M_ii [kg m2 or kg]


@dataclass(frozen=True)
class RigidPart:
    """A rigid part welded to a body, beside the body's own mass."""

    name: str  # of the body in the model file
    mass: Expr  # [kg]
    com: Vector  # centre of mass, in the frame of the body of the Tree [m]
    inertia: Matrix  # about it, in that frame [kg m2]


@dataclass(frozen=True)
class Body:
    """A rigid body and the joint that carries it."""

    name: str
    parent: int  # 0: the base; else the number, from 1, of an earlier body
    joint: Joint
    position: Vector  # dpt: the joint's point on the parent, in the parent's frame [m]
    orientation: Matrix  # columns: the body's axes at q = 0, in the parent's frame
    mass: Expr  # [kg]
    com: Vector  # l: centre of mass, in the body's frame [m]
    inertia: Matrix  # In: about the centre of mass, in the body's frame [kg m2]
    axes: Matrix = IDENTITY  # columns: the axes that the author gave the body, in the body's frame
    parts: tuple[RigidPart, ...] = ()  # further parts, whose common centre of mass depends on parameters


@dataclass(frozen=True)
class Quaternion:
    """A joint that turns in any direction, or moves freely: with a quaternion, and velocities along the body's axes.

    Three bodies of the Tree stand for it, whose joints turn about x, y, z, or six, the first three of which slide along
    x, y, z. They have its velocities, and stand at 0: it is their frame that moves.
    """

    name: str
    first: int  # number of the first of its bodies
    is_free: bool  # it has six

    @property
    def bodies(self) -> range:
        """Number the bodies that stand for it."""
        return range(self.first, self.first + (6 if self.is_free else 3))

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Name its coordinates: the place of its frame [m], and the quaternion, its scalar last."""
        return tuple(f"{self.name}.{x}" for x in (*("xyz" if self.is_free else ""), "qx", "qy", "qz", "qw"))


@dataclass(frozen=True)
class Coupling:
    """A joint without a coordinate: its q is ratio * q of another joint + offset, or a sum over several joints."""

    follower: int  # number of its body
    leader: int  # number of the other joint's body; that joint has a coordinate
    ratio: Expr  # not 0
    offset: Expr  # [rad or m]
    more: tuple[tuple[int, Expr], ...] = field(default=(), repr=False)  # further leaders, each with its ratio

    @property
    def terms(self) -> tuple[tuple[int, Expr], ...]:
        """List all leaders, by the numbers of their bodies, each with its ratio."""
        return ((self.leader, self.ratio), *self.more)


class Cut(Enum):
    """A kind of loop, by the quantities that it keeps equal. Axes are the z axes of its two frames."""

    ROD = "rod"  # the distance of the origins
    BALL = "ball"  # the origins
    HINGE = "hinge"  # the origins and the axes
    UNIVERSAL = "universal"  # the origins, and the angle between the axes
    CYLINDRICAL = "cylindrical"  # the axes, as lines
    HELICAL = "helical"  # the axes, as lines, and the shift along them with the turn about them
    PRISMATIC = "prismatic"  # the axes, as lines, and the turn about them
    PLANAR = "planar"  # the second origin in the plane across the first axis, and the directions of the axes
    SOLID = "solid"  # the frames


@dataclass(frozen=True)
class LoopFrame:
    """One end of a loop: a frame on a body."""

    body: int  # 0: the base
    position: Vector  # in the body's frame [m]
    axes: Matrix  # columns: the frame's axes in the body's frame


@dataclass(frozen=True)
class Loop:
    """A cut: a joint that closes a loop of bodies, between frames on two of them."""

    name: str
    cut: Cut
    first: LoopFrame
    second: LoopFrame
    value: Expr = ZERO  # rod: the distance [m]; universal: the cosine of the axes' angle; helical: the pitch [m/rad]


@dataclass(frozen=True)
class Constraint:
    """An equation of coordinates: the expression is 0."""

    name: str
    equation: Expr  # over `coordinate_symbol` of joints, and parameters


def coordinate_symbol(joint: str) -> Symbol:
    """Return the symbol of a joint's coordinate in constraints and forces; no parameter has it."""
    return Symbol(f"q[{joint}]", real=True)


def signal_symbol(name: str) -> Symbol:
    """Return the symbol of a signal, or of the time, in forces; no parameter has it."""
    return Symbol(f"signal[{name}]", real=True)


class Reading(Enum):
    """A vector that forces read of the state: of a point of a body, in the base frame."""

    POSITION = "position"  # [m]
    VELOCITY = "velocity"  # [m/s]
    DIRECTION = "direction"  # a vector that is fixed in the body
    SPIN = "spin"  # the body's angular velocity [rad/s]


@dataclass(frozen=True)
class Probe:
    """A vector of the state that forces read, by the symbols of its three components."""

    symbols: tuple[Symbol, Symbol, Symbol]
    reading: Reading
    body: int  # 0: the base
    point: Vector = (ZERO, ZERO, ZERO)  # in the body's frame [m]; of a direction, its components there


@dataclass(frozen=True)
class Length:
    """A length by which a force element or a contact is divided, so that it must not vanish."""

    name: str  # of the force element or the contact
    scale: Expr  # the squares of the places of both ends [m2]
    part: int = 0  # of a force element through several points: of this pair of points, from 1

    @property
    def label(self) -> str:
        """The name in a file of code."""
        return f"{self.name}.{self.part}" if self.part else self.name


@dataclass(frozen=True)
class Definition:
    """A number that forces have in common, by its symbol."""

    symbol: Symbol
    value: Expr  # over parameters, coordinates, velocities, probes and earlier definitions
    length: Length | None = None  # it is the square of the length of this force
    owner: str = ""  # the force element, or the point of contact
    key: str = ""  # its name there


@dataclass(frozen=True)
class Rigid:
    """A point at which two bodies touch, whose force no kernel has."""

    bodies: tuple[int, int]  # the first side and the other one; 0: the base
    normal: Vector  # out of the other side, in the base frame
    point: Vector  # in the base frame [m]
    restitution: float
    coefficient: float  # of dry friction


def rate_symbol(joint: str) -> Symbol:
    """Return the symbol of a joint's velocity in forces; no parameter has it."""
    return Symbol(f"qd[{joint}]", real=True)


@dataclass(frozen=True)
class Closure:
    """The closed pose, kept equations and independent velocities of a tree, in the coordinates of the coupled tree."""

    pose: tuple[float, ...]  # q at which all loops are closed
    kept: tuple[int, ...]  # numbers, from 0, of the equations that do not follow from others
    independent: tuple[int, ...]  # entries of qd, from 0, that determine all others
    dependent: tuple[int, ...]  # the other ones; as many as kept equations
    distance: float = field(default=0.0, repr=False)  # by which equations that are left out are open, along the motion
    size: float = field(default=1.0, repr=False)  # of its loops [m]
    unit: float = field(default=1.0, repr=False)  # of lengths in iterations [m], a power of two
    pulls: tuple[float, ...] = field(default=(), repr=False)  # units of multipliers in the mass matrix's norm; (): 1
    plain_pulls: tuple[float, ...] = field(default=(), repr=False)  # the same where all velocities weigh 1


@dataclass(frozen=True)
class Sensor:
    """A named frame on a body."""

    name: str
    body: int  # 0: the base
    position: Vector  # in the body's frame [m]
    orientation: Matrix  # columns: the sensor's axes in the body's frame


@dataclass(frozen=True)
class Wrench:
    """An external force and moment on a body, at a point fixed in it.

    Components may depend on the state: on coordinates and velocities of joints, probes and definitions.
    """

    name: str
    body: int  # from 1
    position: Vector  # of the point, in the body's frame [m]
    in_base: bool  # components in the base frame; else along the axes in `orientation`
    force: Vector | None  # [N]; None: three entries of the input w
    moment: Vector | None  # [N m]; None: three more entries of w
    orientation: Matrix = IDENTITY  # columns: the axes of the components, in the body's frame


@dataclass(frozen=True)
class Barrier:
    """A number of the pose that rigid stops keep at 0 or above, by a force that no kernel has.

    Its derivatives by the velocities are the generalised forces of wrenches and forces in joints, by virtual power.
    """

    wrenches: tuple[Wrench, ...]
    joints: tuple[tuple[str, Expr], ...]  # forces in joints, by their names
    rate: Symbol  # of the number over time
    elements: tuple[str, ...]  # the force elements whose lengths it reads
    restitution: float
    hold: float = 0.0  # the largest pull that it bears
    is_coupling: bool = False  # holds the number wherever it is, for a time
    coefficient: float = 0.0  # of friction, which a stop does not have


@dataclass(frozen=True)
class Distance:
    """The distance of a point of contact from its plane, or of two spheres, or from a stop; below 0 inside."""

    name: str
    symbol: Symbol  # of its definition
    rigid: Rigid | Barrier | None = None  # None: a compliant contact, whose forces are wrenches

    @property
    def owners(self) -> tuple[str, ...]:
        """Name the forces whose lengths it divides by."""
        return self.rigid.elements if isinstance(self.rigid, Barrier) else (self.name,)


@dataclass(frozen=True)
class Solid:
    """The convex hull of points in a frame that moves with a body, rounded by a radius."""

    body: int  # 0: the base
    place: Vector  # of the origin of the frame, over the symbols of a probe, in the base frame [m]
    axes: tuple[Vector, Vector, Vector]  # of the frame, likewise
    points: tuple[tuple[float, float, float], ...]  # in that frame [m]
    radius: float  # [m]


@dataclass(frozen=True)
class Meeting:
    """Two solids that may touch, whose forces no kernel has."""

    name: str
    first: Solid
    other: Solid
    restitution: float
    coefficient: float  # of dry friction


@dataclass(frozen=True)
class Tree:
    """A mechanism, ready for the recursions."""

    name: str
    gravity: Vector  # in the base frame [m/s2]
    parameters: tuple[Parameter, ...]
    bodies: tuple[Body, ...]  # bodies[i - 1] is body i
    sensors: tuple[Sensor, ...]
    wrenches: tuple[Wrench, ...] = ()
    probes: tuple[Probe, ...] = ()  # what wrenches and force laws read of the state
    definitions: tuple[Definition, ...] = ()  # what they have in common
    distances: tuple[Distance, ...] = ()  # of contacts, by their definitions
    meetings: tuple[Meeting, ...] = ()  # solids that may touch
    signals: tuple[str, ...] = ()  # numbers that forces read, the last entries of the input w; TIME is the last one
    quaternions: tuple[Quaternion, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    loops: tuple[Loop, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    driven: tuple[int, ...] = ()  # bodies, from 1, of the joints whose accelerations are given
    chosen: tuple[int, ...] = ()  # bodies of the joints that the author calls independent
    rough: tuple[tuple[int, float], ...] = ()  # bodies, and the author's rough coordinates of their joints
    loop_tolerance: float = 0.0  # within which equations follow from others, rad or of a loop's size
    closure: Closure | None = None  # of a tree with loops or constraints, once it is closed

    @property
    def is_constrained(self) -> bool:
        """Return whether equations restrict the joints' motion."""
        return bool(self.loops or self.constraints or self.driven)

    @property
    def followers(self) -> frozenset[int]:
        """Number the bodies whose joints follow others."""
        return frozenset(x.follower for x in self.couplings)

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The joints that are entries of qd: all except followers."""
        followers = self.followers
        return tuple(body.joint for i, body in enumerate(self.bodies, 1) if i not in followers)

    @property
    def open_entries(self) -> int:
        """Count the entries of the input w: components of wrenches that the model leaves open, then signals."""
        return 3 * sum(vector is None for x in self.wrenches for vector in (x.force, x.moment)) + len(self.signals)

    @property
    def rigid(self) -> tuple[tuple[str, Rigid | Barrier], ...]:
        """The points of rigid contacts, and rigid stops, by their names."""
        return tuple((x.name, x.rigid) for x in self.distances if x.rigid is not None)

    @property
    def elements(self) -> tuple[str, ...]:
        """Name the springs and cables."""
        touching = {x.name for x in self.distances}
        return tuple(dict.fromkeys(x.owner for x in self.definitions if x.owner and x.owner not in touching))

    @property
    def uncoupled(self) -> Tree:
        """The same tree with a coordinate for every joint."""
        return replace(self, couplings=())

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the names of the entries of q, in order: one for each of `joints`, except quaternions."""
        beginnings = {x.first: x.coordinates for x in self.quaternions}
        inside = {i for x in self.quaternions for i in x.bodies}
        own = {i: (body.joint.name,) for i, body in enumerate(self.bodies, 1) if i not in inside}
        numbers = (i for i in range(1, len(self.bodies) + 1) if i not in self.followers)
        return tuple(name for i in numbers for name in (own | beginnings).get(i, ()))

    @property
    def neutral(self) -> tuple[float, ...]:
        """Return the coordinates at which all joints are at 0, and quaternions are the identity."""
        scalars = {x.coordinates[-1] for x in self.quaternions}
        return tuple(float(name in scalars) for name in self.coordinates)

    @property
    def symbols(self) -> frozenset[Symbol]:
        """The symbols of the parameters that a number of the tree depends on."""
        numbers = [*self.gravity]
        for body in self.bodies:
            numbers += [*body.position, *chain(*body.orientation), body.joint.law, body.joint.armature]
            numbers += [body.mass, *body.com, *chain(*body.inertia)]
            for part in body.parts:
                numbers += [part.mass, *part.com, *chain(*part.inertia)]
        numbers += [number for x in self.couplings for number in (*(ratio for _, ratio in x.terms), x.offset)]
        for loop in self.loops:
            ends = (loop.first, loop.second)
            numbers += [loop.value, *(number for end in ends for number in (*end.position, *chain(*end.axes)))]
        numbers += [constraint.equation for constraint in self.constraints]
        for sensor in self.sensors:
            numbers += [*sensor.position, *chain(*sensor.orientation)]
        for wrench in self.wrenches:
            numbers += [*wrench.position, *chain(*wrench.orientation), *(wrench.force or ()), *(wrench.moment or ())]
        numbers += [number for probe in self.probes for number in probe.point]
        numbers += [definition.value for definition in self.definitions]
        return frozenset().union(*(number.free_symbols for number in numbers)) - {COORDINATE, RATE, *self.state_symbols}

    @property
    def state_symbols(self) -> frozenset[Symbol]:
        """The symbols that stand for numbers of the state in constraints, force laws and wrenches."""
        joints = [body.joint.name for body in self.bodies]
        own = {symbol(name) for name in joints for symbol in (coordinate_symbol, rate_symbol)}
        own |= set(map(signal_symbol, self.signals))
        return frozenset(own).union(*(x.symbols for x in self.probes), (x.symbol for x in self.definitions))

    @property
    def without_readings(self) -> Tree:
        """The same tree without wrenches that read the state, for equations that do not depend on wrenches."""
        known = self.state_symbols

        def reads(wrench: Wrench) -> bool:
            return any(x.free_symbols & known for v in (wrench.force, wrench.moment) for x in v or ())

        return replace(self, wrenches=tuple(x for x in self.wrenches if not reads(x)))

    def children(self, i: int) -> tuple[int, ...]:
        """Number the bodies whose parent is body i."""
        return tuple(j for j, body in enumerate(self.bodies, 1) if body.parent == i)
