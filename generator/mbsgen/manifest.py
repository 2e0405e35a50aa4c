"""The manifest: everything that the solving side knows of generated code. Written by mbsgen, read by mbsrun.

`manifest.json` is beside the C files. It names every kernel with the shapes and nonzero patterns of its arguments. It
also holds the data for pictures and initial guesses: coordinates with their limits, frames and the edges between them.
The user's names appear here only; in C they are mangled.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, ValidationError, model_serializer
from pydantic_core import from_json

from mbsgen.errors import Fault, InputError
from mbsgen.roles import ACCELERATING, QUICKEST, Axis, Order, Role, choose_quickest, name_kernel

FORMAT = 2
FILE_NAME = "manifest.json"


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)


_RARE = ("matrix", "unit", "row_axis", "col_axis", "of", "by")


class Argument(_Entry):
    """An input or output of a kernel: a matrix given by its nonzeros, column by column."""

    name: str
    role: Role
    rows: int
    cols: int
    colind: tuple[int, ...] | None = None  # compressed columns; None for a dense matrix
    row: tuple[int, ...] | None = None
    differentiable: bool = True
    matrix: bool = False  # a matrix even with one column
    unit: str = ""
    row_axis: Axis | None = None  # the meaning of the rows; None: they have no names
    col_axis: Axis | None = None
    of: str | None = None  # of a derivative: the argument that is differentiated; of a seed: the result that it weights
    by: str | None = None  # of a derivative or an adjoint: the argument that is differentiated by

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave the fields out that say nothing of most arguments."""
        return {k: x for k, x in write(self).items() if k not in _RARE or x}

    @property
    def nnz(self) -> int:
        """Count the nonzeros."""
        return self.rows * self.cols if self.row is None else len(self.row)


class Flops(_Entry):
    """Operations of one evaluation, by kind, with the two totals of every report."""

    paper: int  # + - * /, unary minus, sqrt, sin and cos: one each
    arithmetic: int  # + - * /
    add: int
    mul: int
    div: int
    neg: int
    sqrt: int
    trig: int
    other: int  # exp, log, tanh, ... of user force laws; outside both conventions
    guard: int = 0  # products and signs of the tests that pivots stand out of rounding; outside both conventions


class Kernel(_Entry):
    """One C function, with its two signatures."""

    name: str  # "impl", "jac_impl", "adj1_impl", "jac_adj1_impl", "sensors", "frames", "setup"
    base: str  # the function that it is, or is a derivative of: "impl"
    order: Order
    symbol: str  # the function in CasADi's contract, e.g. "jac_arm_pendulum_impl"
    function: str  # the typed C function, e.g. "arm_pendulum_compute_jac_impl"
    sources: tuple[str, ...]  # the C files that it is compiled from, headers aside
    inputs: tuple[Argument, ...]
    outputs: tuple[Argument, ...]
    flops: Flops
    equations: int
    integer: Literal["casadi_int", "int"] = "casadi_int"  # the type of counts and places in CasADi's contract

    @property
    def single_symbol(self) -> str:
        """Return `symbol` as C compiled with -DMBS_REAL=float has it, e.g. "jac_arm_pendulum_float_impl"."""
        end = f"_{self.base}"
        return f"{self.symbol.removesuffix(end)}_float{end}"

    def taking(self, role: Role) -> Argument | None:
        """Return the input of a role, if there is one."""
        return next((a for a in self.inputs if a.role is role), None)

    def giving(self, role: Role) -> Argument | None:
        """Return the first result of a role, if there is one."""
        return next((a for a in self.outputs if a.role is role), None)


class Stops(_Entry):
    """Where a joint is stopped."""

    lower: float | None  # rad or m; None: nowhere
    upper: float | None
    restitution: float | None  # of rigid stops, whose forces no kernel has; None: compliant, in the force law


class BearingLoad(_Entry):
    """Friction by the forces N [N] of a joint's bearings across its axis: coefficient times arm times their sum."""

    coefficient: float  # of sliding
    static: float  # of a joint at rest
    arm: float  # of a revolute joint, the radius of its pin [m]; else 1
    length: float | None  # between two bearings [m]; None: there is one


class Friction(_Entry):
    """Dry friction of a joint [N m or N], which no kernel has."""

    torque: float  # against sliding
    static: float  # the most that holds the joint at rest
    stribeck: float | None  # speed over which the latter falls to the former; None: at once
    one_way: Literal[-1, 0, 1] = 0  # of a clutch: the only way in which the joint moves; 0: both
    load: BearingLoad | None = None  # what the joint's reaction adds

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if x is not None or k != "load"}


class RigidPoint(_Entry):
    """A point of a rigid contact, or a rigid stop of a number, whose force no kernel has."""

    name: str
    restitution: float
    coefficient: float  # of dry friction
    is_stop: bool = False  # at a limit of a number, which has no place
    hold: float = 0.0  # of a stop: the largest pull that it bears
    is_coupling: bool = False  # which has no limit: it holds the number wherever it is, at times that are given

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if x or k != "is_coupling"}

    @property
    def stop(self) -> str:
        """Return the name of its stop in the model."""
        return self.name if self.is_coupling else self.name.rpartition(".")[0]


class Solid(_Entry):
    """The convex hull of points in a frame, rounded by a radius."""

    points: tuple[tuple[float, float, float], ...]  # [m]
    radius: float  # [m]


class RigidPair(_Entry):
    """Two solids in rigid contact, whose forces no kernel has."""

    name: str
    first: Solid
    other: Solid
    restitution: float
    coefficient: float  # of dry friction

    @property
    def is_stop(self) -> bool:
        """Return False: solids are no stop of a number."""
        return False


class OpenJoint(_Entry):
    """A joint whose rigid stops and dry friction a use gives: their force is a signal, in the direction of q."""

    name: str
    signal: str
    stops: Stops | None = None  # rigid ones
    friction: Friction | None = None


class OpenContact(_Entry):
    """A rigid point on a plane of the base whose force a use gives: an open wrench at a sensor of the same name."""

    name: str
    point: str  # the name of the sensor and of the wrench
    axis: int  # 0 to 2: along which the plane's normal points
    height: float  # of the plane along the axis [m]
    restitution: float
    coefficient: float  # of dry friction


class Coordinate(_Entry):
    """One joint: an entry of qd and qdd, and of q unless `configuration` lists others."""

    name: str
    motion: Literal["revolute", "prismatic"]
    actuated: bool  # the actuated joints, in order, are the entries of u
    lower: float | None  # rad or m; None: unbounded
    upper: float | None
    max_speed: float | None = None  # of qd, either way [rad/s or m/s]; None: unbounded
    max_force: float | None = None  # of u, either way [N m or N]
    stops: Stops | None = None
    friction: Friction | None = None

    @property
    def is_smooth(self) -> bool:
        """Return whether the kernels hold all forces on the joint: it has neither dry friction nor rigid stops."""
        return self.friction is None and (self.stops is None or self.stops.restitution is None)

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if x is not None or k not in ("stops", "friction")}

    @property
    def unit(self) -> str:
        """Return the unit of q."""
        return {"revolute": "rad", "prismatic": "m"}[self.motion]

    @property
    def force_unit(self) -> str:
        """Return the unit of u."""
        return {"revolute": "N m", "prismatic": "N"}[self.motion]


class Parameter(_Entry):
    """A named number of the model that is an input of `setup`."""

    name: str
    value: float


class Frame(_Entry):
    """A frame whose pose the `frames` kernel computes: a joint frame (moving with its body) or a named sensor."""

    name: str
    parent: int  # index of the frame that an edge is drawn from; -1: the base
    sensor: bool
    slides: bool = False  # a joint frame that slides on its parent; it turns otherwise
    com: tuple[float, float, float] | None = None  # centre of mass [m], where no other frame shows the body's extent


class Point(_Entry):
    """A point that is fixed in a frame."""

    frame: int  # -1: the base
    at: tuple[float, float, float]  # [m]


class Mass(_Entry):
    """A body of the model with a mass, in the frame that moves with it."""

    name: str
    frame: int  # -1: it is fixed to the base
    mass: float  # [kg]
    com: tuple[float, float, float]  # [m]
    inertia: tuple[float, float, float, float, float, float]  # about com, in the frame: xx yy zz xy xz yz [kg m2]


class Seat(_Entry):
    """The frame of a body of the model, in the frame of the manifest that moves with it."""

    name: str
    frame: int  # -1: it is fixed to the base
    at: tuple[float, float, float]  # [m]
    axes: tuple[float, ...]  # one after the other


class Axle(_Entry):
    """The joint of a frame."""

    name: str
    coordinate: int | None  # its entry of qd; None: it follows another joint
    axis: tuple[float, float, float]  # in the frame, a unit vector


class Tension(_Entry):
    """The law of a spring or a cable."""

    stiffness: float  # [N/m]
    rest: float  # [m]
    damping: float  # of a spring [N s/m]
    dissipation: float  # of a cable [s/m]
    width: float  # of a cable [m]


class Grip(_Entry):
    """The law of a contact."""

    stiffness: float  # [N/m^exponent]
    exponent: float
    dissipation: float  # [s/m]
    width: float  # [m]
    coefficient: float  # of friction; 0: none
    speed: float  # [m/s]


class Contraction(_Entry):
    """Forces and rate of the fibres of a muscle as expressions."""

    active: str  # [N]
    passive: str  # and of damping [N]
    isometric: str  # active force at rest [N]
    velocity: str  # [m/s]
    stretch: str  # length over the best length
    strength: str  # [N]
    best: str  # length [m]


class Fibres(_Entry):
    """Numbers of a muscle as expressions, over its length, rate and signals."""

    activation: str
    fibre: str  # length [m]
    cosine: str  # of the angle between fibres and tendon
    tendon_state: str = ""  # of an elastic tendon: its force over the strength, or its strain over that at the strength
    equilibrium: str = (
        ""  # of an elastic tendon: 0 along a motion; fibre_length, fibre_cosine, tendon_state_rate are in it
    )
    settling: str = ""  # of an elastic tendon, unless fibres damp: tendon_state_rate [1/s], where equilibrium is 0
    contraction: Contraction | None = None  # fibre_length, fibre_cosine and tendon_state_rate are in it


class Element(_Entry):
    """A spring or a cable between two points."""

    name: str
    cable: bool
    first: Point
    second: Point
    law: Tension | None = None  # None: no text can hold its numbers
    force: str = ""  # further tension, over its length and rate, run-time parameters and numbers of the state
    via: tuple[Point, ...] = ()  # between the ends
    muscle: Fibres | None = None

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if k not in ("force", "via", "muscle") or x}


class Ball(_Entry):
    """A sphere that another side touches."""

    centre: Point
    radius: float  # [m]


class Brick(_Entry):
    """A box that another side touches."""

    centre: Point
    axes: tuple[float, ...]  # in the frame of the centre, one after the other
    size: tuple[float, float, float]  # [m]


class Rod(_Entry):
    """A capsule that another side touches."""

    centre: Point
    axis: tuple[float, float, float]  # in the frame of the centre, a unit vector
    radius: float  # [m]
    length: float  # between the centres of its ends [m]


class Corners(_Entry):
    """A hull that another side touches: balls about its points."""

    centre: Point
    axes: tuple[float, ...]  # in the frame of the centre, one after the other
    radius: float  # [m]; 0: points
    points: tuple[tuple[float, float, float], ...]  # along the axes [m]


class Touch(_Entry):
    """A contact of a sphere, a box, a hull or a point with a plane or another solid."""

    name: str
    centre: Point
    axes: tuple[float, ...]  # of the box in that frame, one after the other
    radius: float  # of the sphere [m]; 0: a point
    size: tuple[float, float, float] | None  # of the box [m]
    plane: Point | None = None
    normal: tuple[float, float, float] | None = None  # of the plane, in the frame of its point, a unit vector
    law: Grip | None = None
    sphere: Ball | None = None  # in place of a plane
    box: Brick | None = None  # in place of a plane
    capsule: Rod | None = None  # in place of a plane
    hull: Corners | None = None  # in place of a plane
    points: tuple[tuple[float, float, float], ...] | None = None  # of a hull, along `axes` [m]

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        keys = ("plane", "normal", "sphere", "box", "capsule", "hull", "points")
        absent = [key for key in keys if getattr(self, key) is None]
        return {k: x for k, x in write(self).items() if k not in absent}


Shape = Literal["box", "ellipsoid", "sphere", "cylinder", "capsule", "mesh"]


class Drawing(_Entry):
    """A shape that draws a body of the model, in the frame that moves with it."""

    body: str
    frame: int  # -1: it is fixed to the base
    shape: Shape
    size: tuple[float, ...]  # edges; diameters; radius; radius and length, twice; scales along the axes [m]
    at: tuple[float, float, float]  # [m]
    axes: tuple[float, ...]  # one after the other
    color: str = ""  # "#rrggbb", or one of the palette
    file: str = ""  # of a mesh, below the model's folder


class Foot(Point):
    """The point of an open wrench, with the axes of its components."""

    axes: tuple[float, ...] = ()  # in the frame of the point, one after the other; (): the base's, or the frame's own

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if k != "axes" or x}


class Given(_Entry):
    """A wrench on a body, by expressions over run-time parameters and numbers of the state; "" is 0."""

    name: str
    at: Point
    in_base: bool  # components in the base frame; else along these axes
    axes: tuple[float, ...]  # of the body, in the frame of the point, one after the other
    force: tuple[str, str, str]  # [N]
    moment: tuple[str, str, str]  # [N m]


class Reading(_Entry):
    """A number of the state that expressions of forces read: a coordinate, or a component of a point of a frame."""

    name: str
    rate: bool  # its time derivative
    entry: int  # of q; of a point: 0, 1, 2 for x, y, z in the base frame
    point: Point | None = None


class Formula(_Entry):
    """A number for pictures that depends on run-time or differentiated parameters, as an expression."""

    place: tuple[str | int, ...]  # keys and indices that lead to it
    text: str


class Appearance(_Entry):
    """The content of a picture beside frames, at the model's numbers; nothing computes with it."""

    gravity: tuple[float, float, float]  # in the base frame [m/s2]
    masses: tuple[Mass, ...]
    axles: tuple[Axle, ...]  # of the joint frames, in their order
    bodies: tuple[Seat, ...] = ()
    elements: tuple[Element, ...] = ()
    contacts: tuple[Touch, ...] = ()
    wrenches: tuple[Foot, ...] = ()  # where the open wrenches act, in the manifest's order
    drawings: tuple[Drawing, ...] = ()
    given: tuple[Given, ...] = ()  # wrenches that the model gives
    readings: tuple[Reading, ...] = ()
    formulas: tuple[Formula, ...] = ()  # numbers of elements, contacts, wrenches, bodies, masses and drawings

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if k not in ("drawings", "given", "readings", "formulas") or x}


class Wrench(_Entry):
    """An external wrench that the model leaves open: entries of the input w, in the order of the manifest."""

    name: str
    frame: int  # index of the frame of the body that it acts on
    in_base: bool  # components in the base frame; else in the body's
    force: bool  # three entries are its force
    moment: bool  # three more are its moment


class Loop(_Entry):
    """A loop or a constraint: the equations of h that it has, in the order of the manifest."""

    name: str
    cut: str  # see `tree.Cut`; "constraint" of an equation
    first: int = -1  # index of the frame of the body of its first end; -1: the base
    second: int = -1
    first_point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the end, in that frame [m]
    second_point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    equations: tuple[str, ...] = ()  # what its entries of h are: "x", "y", "z", "distance", ...
    redundant: tuple[str, ...] = ()  # its equations that follow from others, and are no entries of h


TIME = "t"  # the signal that is the time
FIRST_LENGTH = 100_000  # the status of the first force without a direction; joints and loops have the numbers below


class Manifest(_Entry):
    """A generated folder, described."""

    format: int
    generator: str
    model: str  # the user's name
    prefix: str  # its mangled form, or a given one; every C name starts with it
    symbols: str = ""  # the prefix of the symbols in object files, with a hash of the C
    model_hash: str  # SHA-256 of the tree and the options it was generated with
    mechanism: str = ""  # SHA-256 of the mechanism in the model file, independent of its wording and of the functions
    header: str
    sources: tuple[str, ...]  # C files to compile, in order
    coordinates: tuple[Coordinate, ...]
    configuration: tuple[str, ...] = ()  # names of the entries of q where they differ from qd: with quaternions
    quaternions: tuple[int, ...] = ()  # the index in q at which each begins: four entries, the scalar last
    parameters: tuple[Parameter, ...]  # run-time parameters, in the order of p
    design: tuple[Parameter, ...] = ()  # differentiated parameters, in the order of theta
    frames: tuple[Frame, ...]
    wrenches: tuple[Wrench, ...] = ()
    signals: tuple[str, ...] = ()  # further entries of w: numbers that forces read; TIME is the last one
    contacts: tuple[str, ...] = ()  # points of contact, by the entries of `distance`
    rigid: tuple[RigidPoint, ...] = ()  # points of rigid contacts, by the entries of `clearance`
    meetings: tuple[RigidPair, ...] = ()  # pairs of solids in rigid contact
    open_joints: tuple[OpenJoint, ...] = ()  # whose rigid stops and dry friction are inputs here
    open_contacts: tuple[OpenContact, ...] = ()  # whose forces are inputs here
    elements: tuple[str, ...] = ()  # springs and cables
    lengths: tuple[str, ...] = ()  # forces that need a direction: FIRST_LENGTH + k is the status without one
    loops: tuple[Loop, ...] = ()
    independent: tuple[int, ...] = ()  # entries of qd that determine all others; empty without loops
    dependent: tuple[int, ...] = ()  # the other ones, as many as entries of h
    pose: tuple[float, ...] = ()  # q at which all loops are closed; empty without loops
    driven: tuple[int, ...] = ()  # entries of qd whose accelerations are given
    appearance: Appearance | None = None
    formulas: tuple[Formula, ...] = ()  # points of frames and loops
    kernels: tuple[Kernel, ...]
    tolerance: float | None = None  # bound on the relative error of the kernels; None: exact

    @model_serializer(mode="wrap")
    def _leave_out(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: x for k, x in write(self).items() if k != "formulas" or x}

    def __repr__(self) -> str:
        """Return the model and the numbers of its parts."""
        parts = f"{len(self.coordinates)} joints, {len(self.frames)} frames, {len(self.kernels)} kernels"
        return f"Manifest({self.model}: {parts})"

    def kernel(self, name: str) -> Kernel:
        """Return a kernel by name; KeyError lists the kernels."""
        for kernel in self.kernels:
            if kernel.name == name:
                return kernel
        if name in self.quickest:
            return self.quickest[name]
        raise KeyError(f"no kernel {name!r}; there are {', '.join(k.name for k in self.kernels)}")

    def find(self, base: str, order: Order = Order.VALUE) -> Kernel | None:
        """Return the kernel of a function and an order, if there is one."""
        if base == QUICKEST:
            return self.quickest.get(name_kernel(QUICKEST, order))
        return next((k for k in self.kernels if (k.base, k.order) == (base, order)), None)

    @property
    def quickest(self) -> Mapping[str, Kernel]:
        """The quicker accelerations, and their derivatives, by the names `exp`, `jac_exp`, …"""
        flops = {k.base: k.flops.paper for k in self.kernels if k.base in ACCELERATING and k.order is Order.VALUE}
        if not flops:
            return {}
        best = choose_quickest(flops)
        return {name_kernel(QUICKEST, k.order): k for k in self.kernels if k.base == best}

    @property
    def setup(self) -> Kernel | None:
        """The kernel that computes from the run-time parameters what others need of them, if there is one."""
        return next((kernel for kernel in self.kernels if kernel.giving(Role.SETUP)), None)

    def list_giving(self, role: Role) -> tuple[str, ...]:
        """Name the functions that give a result of a role."""
        return tuple(k.base for k in self.kernels if k.order is Order.VALUE and k.giving(role))

    @property
    def equations(self) -> tuple[str, ...]:
        """Names of the entries of h, as in `knee.x`."""
        return tuple(f"{loop.name}.{equation}" for loop in self.loops for equation in loop.equations)

    @property
    def owners(self) -> tuple[int, ...]:
        """Indices of the loops that the entries of h belong to."""
        return tuple(k for k, loop in enumerate(self.loops) for _ in loop.equations)

    @property
    def positions(self) -> tuple[str, ...]:
        """Names of the entries of q."""
        return self.configuration or tuple(c.name for c in self.coordinates)

    @property
    def actuated(self) -> tuple[int, ...]:
        """Indices of the actuated coordinates: entry i of u acts on coordinate actuated[i]."""
        return tuple(i for i, c in enumerate(self.coordinates) if c.actuated)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs: entries of u by their joints, then entries of w: of wrenches, and signals."""
        joints = [self.coordinates[i].name for i in self.actuated]
        parts = [
            f"{wrench.name}.{part}.{axis}"
            for wrench in self.wrenches
            for part, is_input in (("force", wrench.force), ("moment", wrench.moment))
            if is_input
            for axis in "xyz"
        ]
        return (*joints, *parts, *self.signals)

    @property
    def touching(self) -> tuple[str, ...]:
        """Names of rigid contacts, and rigid stops of numbers: first points, then pairs of solids."""
        return (*(point.name for point in self.rigid), *(pair.name for pair in self.meetings))

    @property
    def switching(self) -> tuple[str, ...]:
        """Names of the joints with dry friction or rigid stops, which no kernel has: simulations alone do."""
        return tuple(c.name for c in self.coordinates if not c.is_smooth)

    @property
    def loaded(self) -> tuple[str, ...]:
        """Names of the joints whose dry friction depends on their reactions."""
        return tuple(c.name for c in self.coordinates if c.friction is not None and c.friction.load is not None)

    @property
    def open_entries(self) -> int:
        """Count the entries of w: components of open wrenches, then signals."""
        return len(self.inputs) - len(self.actuated)

    @property
    def reads_time(self) -> bool:
        """Return whether forces depend on the time, the last entry of w then."""
        return self.signals[-1:] == (TIME,)


def write(manifest: Manifest) -> str:
    """Return the text of a manifest's file."""
    unsaid: dict[str, Any] = {} if manifest.configuration else {"configuration": True, "quaternions": True}
    if not any(c.max_speed or c.max_force for c in manifest.coordinates):
        unsaid["coordinates"] = {"__all__": {"max_speed", "max_force"}}
    if manifest.tolerance is None:
        unsaid["tolerance"] = True
    unsaid |= {
        name: True
        for name in (
            "appearance",
            "signals",
            "contacts",
            "rigid",
            "meetings",
            "open_joints",
            "open_contacts",
            "elements",
            "lengths",
            "loops",
            "independent",
            "dependent",
            "pose",
            "driven",
        )
        if not getattr(manifest, name)
    }
    return manifest.model_dump_json(indent=2, exclude=unsaid) + "\n"


def read(path: Path) -> Manifest:
    """Read a manifest; InputError when it is missing, of another format, or not a manifest."""
    try:
        text = path.read_bytes()
        return Manifest.model_validate_json(text)
    except FileNotFoundError:
        fault = Fault(str(path), 0, "", "there is no such file", "generate the folder with `mbsgen MODEL -o DIR`")
        raise InputError([fault]) from None
    except OSError as error:
        raise InputError([Fault(str(path), 0, "", f"cannot be read: {error.strerror}", "check the path")]) from None
    except ValidationError as error:
        if (found := _read_format(text)) not in (None, FORMAT):
            finding = f"the manifest has format {found}, this mbsgen reads format {FORMAT}"
            raise InputError([Fault(str(path), 0, "format", finding, "generate the folder again")]) from None
        faults = [
            Fault(
                str(path),
                0,
                ".".join(map(str, e["loc"])),
                e["msg"],
                "generate the folder again with this mbsgen",
            )
            for e in error.errors()
        ]
        raise InputError(faults) from None


def _read_format(text: bytes) -> int | None:
    """Return the format of a manifest that is none of this format; None where it has no such number."""
    try:
        found = from_json(text)
    except ValueError:
        return None
    number = found.get("format") if isinstance(found, dict) else None
    return number if isinstance(number, int) else None
