"""Forces between bodies: force elements and contacts -> probes, definitions and wrenches of a Tree.

A force element of tension T between the points a and b, with d = b - a and length = |d|, pulls a by T d/length and b by
the opposite. A spring and damper has

    T = stiffness (length - rest) + damping rate + force.

Through further points of bodies, or moving ones, its length is the sum of the distances from each point to the next,
and T pulls along each of these lines. Around surfaces, T is along the derivatives of the length by the points on both
sides, and its reaction presses on the surface; see `mbsgen.model.wrapping`, `mbsgen.model.wrapping_shapes`. A muscle
has the tension of `mbsgen.model.muscles`.

Its direction d/length does not exist where the points meet: kernels then fail, with a status of the element. A spring
of length 0 at rest, without anything else, has the force stiffness d, which needs no direction.

A cable cannot push. With e = softplus(length - rest, width), which is length - rest where that is well above 0,

    T = stiffness e phi(dissipation rate) + force,    phi(x) = softplus(1 + x, 1/10)/softplus(1, 1/10).

phi(x) is 1 + x within 5e-6 of itself for x >= 0, and above 0 everywhere (1 + x is the law of Hunt and Crossley,
"Coefficient of restitution interpreted as damping in vibroimpact", J. Appl. Mech. 42, 1975). phi grows; phi(0) is 1.
The tension T differs from the elastic one by a force against the rate, which takes energy out.

A contact of a sphere of centre c and radius r touches a plane, a sphere or a box at the point p, along the normal n:

    plane through P of normal n:        gap = n.(c - P) - r,    p = c - r n
    the same, and a wheel of radius R:  gap = n.(c - P) - R n.e - r,    p = c - R e - r n
    sphere of centre P and radius R:    gap = |c - P| - r - R,  p = (R c + r P)/(r + R),   n = (c - P)/|c - P|
    box of centre P and edges e:        gap = g - r,            p = c - r n,               n = the gradient of g by c
    capsule of centre P and radius R:   gap = g - r - R,        p = c - r n,               n = the gradient of g by c
The wheel turns about c and its axis a. Its sphere is at c - R e, the point of the circle that is nearest to the plane:

    e = (n - (n.a) a) / sqrt(1 - (n.a)^2)

A wheel that lies flat on the plane has no such point: kernels then fail, with a status of the contact. With a tyre, the
force and the moment of `mbsgen.model.tyres` act at p - gap n, the point of the plane below. Where its slips are states,
they are the speeds of joints (`mbsgen.model.slips`), which feel their rates as forces.

A sphere with R -> inf is the plane, and either of two spheres may be called the other one. With the velocity v of the
first side relative to the other one, both at p, and rate = n.v, the force

    depth = softplus(-gap, width)
    N = stiffness depth^exponent phi(-dissipation rate)
    F = N n - coefficient N v_t / sqrt(v_t.v_t + speed^2),    v_t = v - rate n,

acts on the sphere at p, and its opposite on the other side at p. Where the centres of two spheres coincide, there is no
normal: kernels then fail, with a status of the contact. A half power is depth^k sqrt(depth + 1e-6 width): a root has no
derivative at 0. The distance g of a box is, with c - P = x in its axes, and s(x) = softplus(x, width),

    q_i = |x_i| - e_i/2,   y_i = s(q_i),   m = the largest q_i,    g = sqrt(y.y + (width/1000)^2) - s(-m),

where |x| = s(2 x) - x, and m = q_z + s(q_y + s(q_x - q_y) - q_z) = width log(sum of exp(q_i/width)). A few widths from
edges and from planes of equal depth, g is the distance, below 0 inside. It passes through a face without a bend, since
s(q) - s(-q) = q. The gradient is never longer than step(m) + step(-m) = 1, so friction takes energy out everywhere.

The distance g from the segment of a capsule, of length l along z, is with the same s

    g = sqrt(x^2 + y^2 + s(|z| - l/2)^2).

A few widths from the planes through the ends it is the distance; where it is 0, on the segment, kernels fail.

A sphere may have a law of `mbsgen.model.contact_laws` instead.

The friction is Coulomb's, regularised (Brown, McPhee, "A continuous velocity-based friction model", J. Comput.
Nonlinear Dyn. 11, 2016, compare such laws); a body at rest on a slope creeps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

from sympy import Expr, Integer, Mul, Symbol, asin, sign, sqrt

from mbsgen.expressions import Expression, Name, names, parse
from mbsgen.model import model
from mbsgen.model.bushings import NAMES, UNIT, Between, Seen
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.model import LENGTH, LENGTH_RATE, Block, Capsule, Contact, ForceElement, Sphere, Stop, press
from mbsgen.model.quantities import name_lengths
from mbsgen.model.slips import name_slip
from mbsgen.model.steps import differentiate
from mbsgen.model.symbols import total
from mbsgen.model.tree import (
    IDENTITY,
    ONE,
    ZERO,
    Barrier,
    Definition,
    Distance,
    Length,
    Meeting,
    Probe,
    Reading,
    Rigid,
    Solid,
    Vector,
    Wrench,
    rate_symbol,
)
from mbsgen.model.triples import add, cross, dot, scale, subtract
from mbsgen.model.tyres import LATERAL, LONGITUDINAL, Tyre
from mbsgen.model.wrapping import Round, Turn, holds, make_turn
from mbsgen.model.wrapping_shapes import Shape, make_shaped_turn

POWERS = (1.0, 1.5, 2.0, 2.5, 3.0)  # exponents of a depth
Read = Callable[[Expression, Mapping[str, Expr]], Expr]  # an expression of a Model, given further names

_PHI = "softplus(1 + {0}, 1/10)/softplus(1, 1/10)"
_SPRING = parse("stiffness*(length - rest) + damping*rate + force")
_CABLE = parse(f"stiffness*softplus(length - rest, width)*{_PHI.format('dissipation*rate')} + force")
_DEPTH = parse("softplus(-gap, width)")
_NORMAL = parse(f"stiffness*power*{_PHI.format('-dissipation*rate')}")
_ROOT = parse("sqrt(depth + 1e-6*width)")
_BEYOND = parse("softplus(2*x, width) - x - edge/2")
_OUTSIDE = parse("softplus(q, width)")
_SIDE = parse("2*step(2*x, width) - 1")
_END = parse("(2*step(2*x, width) - 1)*step(q, width)")  # by x, of the distance beyond the end of a capsule
_BOX = {  # in turn
    "outside": parse("sqrt(y_x**2 + y_y**2 + y_z**2 + (1e-3*width)**2)"),
    "pair": parse("q_y + softplus(q_x - q_y, width)"),
    "most": parse("q_z + softplus(pair - q_z, width)"),
    "gap": parse("outside - softplus(-most, width) - radius"),
    "inside": parse("step(-most, width)"),
    "both": parse("inside*step(pair - q_z, width)"),
    "first": parse("step(q_x - q_y, width)"),
}
_SLOPES = (  # of the gap by x
    parse("side_x*(y_x*step(q_x, width)/outside + both*first)"),
    parse("side_y*(y_y*step(q_y, width)/outside + both*(1 - first))"),
    parse("side_z*(y_z*step(q_z, width)/outside + inside - both)"),
)
_DRAG = parse("coefficient*normal/sqrt(square + speed**2)")
_NOTHING: Vector = (ZERO, ZERO, ZERO)
_DEFLECTIONS = {LONGITUDINAL: "u", LATERAL: "v"}  # names in the laws of tyres
_LENGTHS = {LONGITUDINAL: "sigma_x", LATERAL: "sigma_y"}


@dataclass(frozen=True)
class Anchor:
    """A point of a body, in its frame."""

    body: int  # 0: the base
    point: Vector


@dataclass(frozen=True)
class Spot:
    """A point of the line of a force element."""

    anchor: Anchor
    axes: tuple[Vector, ...] = ()  # of its shift, in the frame of that body
    shift: tuple[Expr, ...] = _NOTHING
    coordinates: tuple[tuple[Symbol, Symbol, str], ...] = ()  # that the shift reads, their rates and joints
    presence: tuple[Expr, Expr, Expr] | None = None  # a coordinate, and the bounds between which the line passes it


@dataclass(frozen=True)
class _Seen:
    """A point of a line in the base frame."""

    anchor: Anchor
    place: Vector
    velocity: Vector
    arm: Vector  # from the anchor
    moves: tuple[tuple[str, Vector], ...]  # joints, and the derivatives of the place in the body by their coordinates
    presence: Expr  # 1 or 0


@dataclass(frozen=True)
class Surface:
    """A surface around which the line of a force element wraps between two of its points; round, if without a shape."""

    anchor: Anchor  # its centre
    axis: Vector | None  # of a cylinder, of length 1, in the frame of that body; None: a sphere
    side: Vector | None  # of length 1, likewise: into the half on which the line stays; None: the nearer way
    radius: Expr
    half: Expr | None  # of the length of a cylinder; None: no ends
    first: int
    last: int
    shape: Shape | None = None  # along its axes; None: a cylinder or a sphere
    axes: tuple[Vector, ...] = ()  # of the shape, in the frame of that body

    def covers(self, first: int, last: int) -> bool:
        """Return whether the line may wrap between two points."""
        return self.first <= first and last <= self.last


Frame = tuple[Anchor, Sequence[Vector]]  # a frame on a body: its origin and its axes, in the body's frame
Define = Callable[[str, Vector], Vector]  # gives a vector that two forces share a name


@dataclass(frozen=True)
class _Line:
    """The line of a force element, and what a tension does along it."""

    length: Symbol
    rate: Symbol
    pull: Callable[[str, Expr, Define], None]  # the owner of the force, and the tension


@dataclass(frozen=True)
class _Part:
    """A part of a line between two points."""

    number: int
    span: tuple[int, int]  # the numbers of its points
    a: _Seen
    b: _Seen
    d: Vector  # from a to b
    size: Expr
    weight: Expr  # 1 where the line has this part, else 0


@dataclass(frozen=True)
class _Bend:
    """A part of a line around a surface."""

    part: _Part
    turn: Turn
    weight: Expr  # 1 where it wraps, else 0
    rate: Expr  # of the length
    anchor: Anchor  # the centre of the surface
    force: Vector  # on the surface, over the tension
    moment: Vector  # about its centre


@dataclass(frozen=True)
class Side:
    """The side of a contact that is touched: a point of a plane, or the centre of a sphere or a box."""

    anchor: Anchor
    axes: tuple[Vector, ...]  # in the frame of that body, of length 1: the normal of a plane; the axes of a box


@dataclass(frozen=True)
class PlacedHull:
    """A solid in a frame on a body: the hull of points, rounded by a radius."""

    anchor: Anchor  # the origin of the frame
    axes: tuple[Vector, ...]  # in the frame of that body
    points: tuple[tuple[float, float, float], ...]
    radius: float


@dataclass(frozen=True)
class Sight:
    """A number of the pose that stops may read: the coordinate of a joint, or of a frame's origin."""

    symbol: Symbol
    rate: Symbol
    joint: str = ""
    anchor: Anchor | None = None  # of a frame
    axis: int = 0  # of the base, likewise


@dataclass(frozen=True)
class Circle:
    """A wheel about the centre of a contact: its axis is of length 1."""

    radius: Expression
    axis: Vector  # in the frame of the body that carries the centre


@dataclass(frozen=True)
class _Axle:
    """The axis of a wheel in the base frame, and the sine of its lean out of the plane."""

    axis: Vector
    lean: Symbol
    square: Symbol  # of the cosine


@dataclass(frozen=True)
class _Meeting:
    """The point at which two sides touch, or would touch."""

    n: Vector  # out of the other side
    gap: Symbol
    arm: Vector  # from the centre of the first side to the point
    reach: Vector  # from the place of the other side to the point
    axle: _Axle | None = None  # of a wheel


class Loads:
    """Collects the probes, definitions and wrenches of forces."""

    def __init__(self, read: Read) -> None:
        """Take what reads the expressions of the model."""
        self._read = read
        self.probes: list[Probe] = []
        self.definitions: list[Definition] = []
        self.wrenches: list[Wrench] = []
        self.distances: list[Distance] = []
        self.meetings: list[Meeting] = []
        self.pushes: list[tuple[str, Expr]] = []  # forces in joints, by their names
        self._lines: dict[str, _Line] = {}

    def add_element(
        self, element: ForceElement, path: Sequence[Spot], around: Sequence[Surface] = (), *, is_read: bool = False
    ) -> None:
        """Add the wrenches of a force element, at its points that can move, and on surfaces around which it wraps.

        Stops may read its length if `is_read`.
        """
        name = element.name
        if not element.is_straight:
            self._add_path(element, path, around)
            return
        first, second = (spot.anchor for spot in path)
        a, b = (self._probe(name, k, Reading.POSITION, end) for k, end in (("a", first), ("b", second)))
        d = self._define_vector(name, "d", subtract(b, a))
        rests = (element.rest, element.damping, element.cable, element.law) == (
            model.ZERO,
            model.ZERO,
            None,
            model.ZERO,
        )
        if rests and not is_read:
            pull = self._read(element.stiffness, {})  # a spring of length 0 at rest has no division by its length
        else:
            v, w = (self._probe(name, k, Reading.VELOCITY, end) for k, end in (("a", first), ("b", second)))
            square = self._define(name, "square", dot(d, d), Length(name, dot(a, a) + dot(b, b)))
            length = self._define(name, "length", sqrt(square))
            rate = self._define(name, "rate", dot(d, subtract(w, v)) / length)
            pull = self._define(name, "pull", self._tension(element, length, rate) / length)
            self._lines[name] = _Line(length, rate, partial(self._pull_ends, first, second, scale(1 / length, d)))
        self._pull_ends(first, second, d, name, pull, partial(self._define_vector, name))

    def add_between(self, wrench: model.Wrench, first: Frame, second: Frame) -> None:
        """Add a wrench between two frames: it acts at the second one, and its opposite on the first one's body."""
        name, defined = wrench.name, dict[str, Expr]()
        assert wrench.force is not None, "it is no input"
        assert wrench.moment is not None, "it is no input"

        def define(key: str, value: Expr, length: Length | None = None) -> Expr:
            if key not in defined:
                symbol = Symbol(f"wrench[{name}] {key}", real=True)
                self.definitions.append(Definition(symbol, value, length))
                defined[key] = symbol
            return defined[key]

        def guard(key: str, value: Expr) -> Expr:
            return define(key, value, Length(name, UNIT))

        between = Between(self._look(name, "from", first), self._look(name, "at", second), define, guard)
        read = frozenset[str]().union(*map(names, (*wrench.force, *wrench.moment)))
        own = between.list_shifts()
        if wrench.by_turns or not read.isdisjoint(NAMES[6:]):
            own |= between.list_turns()
        force, moment = (_vector(self._read(x, own) for x in v) for v in (wrench.force, wrench.moment))
        F = between.sum_along(force)
        M = between.sum_moment(moment) if wrench.by_turns else between.sum_along(moment)
        F, M = (
            _vector(define(f"{key}.{axis}", x) for axis, x in zip("xyz", v, strict=True))
            for key, v in (("F", F), ("M", M))
        )
        self._act(name, second[0], F, M)
        self._act(name, first[0], scale(-1, F), subtract(cross(F, between.arm), M))

    def _look(self, name: str, key: str, frame: Frame) -> Seen:
        """Probe a frame."""
        anchor, axes = frame
        place, velocity, spin = (
            self._probe(name, f"{key} {x.value}", x, anchor) for x in (Reading.POSITION, Reading.VELOCITY, Reading.SPIN)
        )
        x, y, z = (
            self._probe(name, f"{key} {k}", Reading.DIRECTION, Anchor(anchor.body, a))
            for k, a in zip("xyz", axes, strict=True)
        )
        return Seen(place, velocity, spin, (x, y, z))

    def _pull_ends(self, first: Anchor, second: Anchor, way: Vector, name: str, tension: Expr, define: Define) -> None:
        """Pull two points together, by multiples of the way from the first to the second."""
        F = define("F", scale(tension, way))
        self._act(name, first, F, _NOTHING)
        self._act(name, second, scale(-1, F), _NOTHING)

    def _add_path(self, element: ForceElement, path: Sequence[Spot], around: Sequence[Surface]) -> None:
        """Add the wrenches of a force element through several points, moving ones, or around surfaces.

        The part from one point to another counts where both are there, and none between them: its weight is 1, else 0.
        """
        name = element.name
        seen = [self._see(name, k, spot) for k, spot in enumerate(path, 1)]
        shares, rates, parts = list[Expr](), list[Expr](), list[_Part]()
        for i, k in combinations(range(len(path)), 2):
            if any(spot.presence is None for spot in path[i + 1 : k]):
                continue
            a, b = seen[i], seen[k]
            weight = Mul(a.presence, b.presence, *(1 - x.presence for x in seen[i + 1 : k]))
            moves = a.moves or b.moves or any(x.covers(i, k) for x in around)
            if a.anchor.body == b.anchor.body and not moves:  # no force between them matters
                d = subtract(b.anchor.point, a.anchor.point)
                shares.append(weight * sqrt(dot(d, d)))
                continue
            number = len(parts) + 1
            d = self._define_vector(name, f"d{number}", subtract(b.place, a.place))
            reach = Length(name, dot(a.place, a.place) + dot(b.place, b.place), number)
            size = self._define(name, f"part{number}", sqrt(self._define(name, f"square{number}", dot(d, d), reach)))
            weight = weight if weight.is_number else self._define(name, f"weight{number}", weight)
            parts.append(_Part(number, (i, k), a, b, d, size, weight))
        bends = {x.part.number: x for j, surface in enumerate(around, 1) for x in self._bend(name, j, surface, parts)}
        straights = list[Expr]()
        for part in parts:
            straight, bend = part.weight, bends.get(part.number)
            if bend is not None:
                straight = self._define(name, f"straight{part.number}", part.weight - bend.weight)
                shares.append(bend.weight * bend.turn.length)
                rates.append(bend.weight * bend.rate)
            shares.append(straight * part.size)
            rates.append(straight * dot(part.d, subtract(part.b.velocity, part.a.velocity)) / part.size)
            straights.append(straight / part.size)
        length = self._define(name, "length", total(shares))
        rate = self._define(name, "rate", total(rates))
        tension = self._define(name, "tension", self._tension(element, length, rate))

        def pull(owner: str, tension: Expr, define: Define) -> None:
            for part, share in zip(parts, straights, strict=True):
                F = define(f"F{part.number}", scale(tension * share, part.d))
                self._pull(owner, part.a, F)
                self._pull(owner, part.b, scale(-1, F))
            for bend in bends.values():
                self._pull_around(owner, bend, tension)

        pull(name, tension, partial(self._define_vector, name))
        self._lines[name] = _Line(length, rate, pull)

    def _bend(self, name: str, number: int, surface: Surface, parts: Sequence[_Part]) -> Iterator[_Bend]:
        """Define the ways of a line around a surface: of all parts, one wraps at most.

        It is the first one that must, else the one that may and gets longer by the least.
        """
        key = f"round{number}"
        c, v = (self._probe(name, key, x, surface.anchor) for x in (Reading.POSITION, Reading.VELOCITY))
        spin = self._probe(name, key, Reading.SPIN, surface.anchor)
        axis, side = (
            None if x is None else self._probe(name, f"{key} {k}", Reading.DIRECTION, Anchor(surface.anchor.body, x))
            for k, x in (("axis", surface.axis), ("side", surface.side))
        )
        axes = [
            self._probe(name, f"{key} {k}", Reading.DIRECTION, Anchor(surface.anchor.body, x))
            for k, x in zip("xyz"[: len(surface.axes)], surface.axes, strict=True)
        ]
        body = Round(surface.radius, axis, surface.half, side)
        covered = [x for x in parts if surface.covers(*x.span)]
        ways = list[tuple[_Part, tuple[Vector, Vector], Turn]]()
        for part in covered:
            own = f"{key}_{part.number}"
            a, b = (
                self._define_vector(name, f"{own} {k}", subtract(x.place, c))
                for k, x in (("from", part.a), ("to", part.b))
            )
            define = partial(self._define_within, name, own)
            turn = (
                make_turn(body, a, b, define)
                if surface.shape is None
                else make_shaped_turn(surface.shape, axes, a, b, define)
            )
            ways.append((part, (a, b), turn))
        must, may = ([part.weight * getattr(turn, k) for part, _, turn in ways] for k in ("must", "may"))
        longer = [turn.length - part.size for part, _, turn in ways]
        none = Mul(*(1 - x for x in must))
        for k, (part, arms, turn) in enumerate(ways):
            rivals = [
                1 - may[j] * (holds(longer[k] - longer[j]) if j < k else 1 - holds(longer[j] - longer[k]))
                for j in range(len(ways))
                if j != k
            ]
            first = must[k] * Mul(*(1 - x for x in must[:k]))
            weight = self._define(name, f"{key}_{part.number} weight", first + may[k] * none * Mul(*rivals))
            forces = [
                self._define_vector(name, f"{key}_{part.number} along_{x}", g)
                for x, g in zip("ab", turn.slopes, strict=True)
            ]
            both, moment = add(*forces), add(cross(arms[0], forces[0]), cross(arms[1], forces[1]))
            rate = dot(forces[0], part.a.velocity) + dot(forces[1], part.b.velocity) - dot(both, v) - dot(moment, spin)
            yield _Bend(part, turn, weight, rate, surface.anchor, both, moment)

    def _pull_around(self, name: str, bend: _Bend, tension: Expr) -> None:
        """Add the forces of a line on the points of a bend, and on the surface."""
        push = tension * bend.weight
        for seen, slope in zip((bend.part.a, bend.part.b), bend.turn.slopes, strict=True):
            self._pull(name, seen, scale(-push, slope))
        self._act(name, bend.anchor, scale(push, bend.force), scale(push, bend.moment))

    def _see(self, name: str, k: int, spot: Spot) -> _Seen:
        """Define the place and the velocity of a point of a line, in the base frame, and whether it is there."""
        anchor, presence = spot.anchor, ONE
        if spot.presence is not None:
            q, lower, upper = spot.presence
            presence = self._define(name, f"there{k}", (1 + sign(q - lower)) * (1 + sign(upper - q)) / 4)
        p, v = (self._probe(name, f"p{k}", reading, anchor) for reading in (Reading.POSITION, Reading.VELOCITY))
        if not any(x.free_symbols for x in spot.shift) and spot.shift == _NOTHING:
            return _Seen(anchor, p, v, _NOTHING, (), presence)
        axes = [
            self._probe(name, f"{x}{k}", Reading.DIRECTION, Anchor(anchor.body, a))
            for x, a in zip("xyz", spot.axes, strict=True)
        ]
        arm = self._define_vector(name, f"arm{k}", _combine(spot.shift, axes))
        spin = self._probe(name, f"w{k}", Reading.SPIN, anchor)
        velocity, moves = add(v, cross(spin, arm)), []
        for j, (coordinate, rate, joint) in enumerate(spot.coordinates):
            slopes = [differentiate(x, coordinate) for x in spot.shift]
            if any(slopes):
                way = self._define_vector(name, f"way{k}_{j}", _combine(slopes, axes))
                velocity = add(velocity, scale(rate, way))
                moves.append((joint, way))
        velocity = self._define_vector(name, f"v{k}", velocity)
        return _Seen(anchor, self._define_vector(name, f"at{k}", add(p, arm)), velocity, arm, tuple(moves), presence)

    def _pull(self, name: str, seen: _Seen, F: Vector) -> None:
        self._act(name, seen.anchor, F, _NOTHING if seen.arm == _NOTHING else cross(seen.arm, F))
        self.pushes += [(joint, dot(F, way)) for joint, way in seen.moves]

    def _tension(self, element: ForceElement, length: Expr, rate: Expr) -> Expr:
        own = {LENGTH: length, LENGTH_RATE: rate}
        own |= {key: self._read(getattr(element, key), {}) for key in ("stiffness", "rest", "damping")}
        own["force"] = self._read(element.law, own)
        if element.cable is None:
            return self._read(_SPRING, own)
        own |= {key: self._read(getattr(element.cable, key), {}) for key in ("width", "dissipation")}
        return self._read(_CABLE, own)

    def add_contact(
        self, contact: Contact, points: Sequence[tuple[str, Anchor]], side: Side, exponent: float, circle: Circle | None
    ) -> None:
        """Add the wrenches of a contact at some points of a body, by their names, with the side that is touched."""
        assert exponent in POWERS, "exponents are checked"
        for name, point in points:
            self._touch(contact, name, point, side, exponent, circle)

    def add_rigid(
        self,
        contact: Contact,
        points: Sequence[tuple[str, Anchor]],
        side: Side,
        law: tuple[float, float],
        circle: Circle | None,
    ) -> None:
        """Add the points of a rigid contact likewise; `law` is its restitution and its coefficient of friction."""
        for name, centre in points:
            met = self._meet(contact, name, centre, side, circle)
            c = self._probe(name, "centre", Reading.POSITION, centre)
            bodies = centre.body, side.anchor.body
            self.distances.append(Distance(name, met.gap, Rigid(bodies, met.n, add(c, met.arm), *law)))

    def add_meeting(self, name: str, shapes: Sequence[PlacedHull], law: tuple[float, float]) -> None:
        """Add two solids in rigid contact; `law` as of `add_rigid`."""
        solids = []
        for key, shape in zip(("first", "other"), shapes, strict=True):
            place = self._probe(name, f"{key} place", Reading.POSITION, shape.anchor)
            x, y, z = (
                self._probe(name, f"{key} {k}", Reading.DIRECTION, Anchor(shape.anchor.body, a))
                for k, a in zip("xyz", shape.axes, strict=True)
            )
            solids.append(Solid(shape.anchor.body, place, (x, y, z), shape.points, shape.radius))
        self.meetings.append(Meeting(name, solids[0], solids[1], *law))

    def add_stop(
        self,
        stop: Stop,
        sights: Sequence[Sight],
        limits: tuple[Expr | None, Expr | None],
        rigid: tuple[float, float] | None,
    ) -> None:
        """Add stops at limits of a number of the pose: forces of compliant ones, distances of rigid ones.

        `sights` are the numbers that it may read beside lengths; `rigid` is the restitution, and the largest pull that
        the stops bear; None: they are compliant.
        """
        name, lines = stop.name, {key: self._lines[own] for key, own in name_lengths([*self._lines]).items()}
        read = {key: line for key, line in lines.items() if key in names(stop.quantity)}
        quantity = self._read(stop.quantity, {key: line.length for key, line in lines.items()})
        value = self._note(name, "value", quantity)
        slopes = {
            symbol: self._note(name, f"by {symbol}", differentiate(quantity, symbol))
            for symbol in (*(x.symbol for x in sights), *(line.length for line in read.values()))
            if quantity.has(symbol)
        }
        seen = [x for x in sights if x.symbol in slopes]
        pulled = [x for x in read.values() if x.length in slopes]
        terms = [slopes[x.symbol] * x.rate for x in seen] + [slopes[x.length] * x.rate for x in pulled]
        rate = self._note(name, "rate", total(terms))

        def push(force: Expr) -> None:
            for x in seen:
                part = force * slopes[x.symbol]
                if x.anchor is None:
                    self.pushes.append((x.joint, part))
                else:
                    self._act(name, x.anchor, scale(part, IDENTITY[x.axis]), _NOTHING)
            for line in pulled:
                line.pull(name, -force * slopes[line.length], lambda _, vector: vector)

        elements = tuple(own for key, own in name_lengths([*self._lines]).items() if key in read)
        if stop.is_coupling:
            assert rigid is not None, "a coupling holds its number"
            wrenches, joints = self._collect(partial(push, Integer(1)))
            gap, away = self._note(name, "gap", value), self._note(name, "rate of the gap", rate)
            self.distances.append(
                Distance(name, gap, Barrier(wrenches, joints, away, elements, *rigid, is_coupling=True))
            )
        for key, way, limit in zip(("lower", "upper"), (1, -1), limits, strict=True):
            if limit is None:
                continue
            own = f"{name}.{key}"
            gap, away = self._note(own, "gap", way * (value - limit)), self._note(own, "rate", way * rate)
            if rigid is None:
                given = {"depth": -gap, "speed": -away}
                push(way * self._note(own, "force", self._read(press(stop.law, Name("depth"), Name("speed")), given)))
            else:
                wrenches, joints = self._collect(partial(push, Integer(way)))
                self.distances.append(Distance(own, gap, Barrier(wrenches, joints, away, elements, *rigid)))

    def _collect(self, act: Callable[[], None]) -> tuple[tuple[Wrench, ...], tuple[tuple[str, Expr], ...]]:
        """Return the wrenches and forces in joints that a function adds, instead of adding them."""
        kept = self.wrenches, self.pushes
        self.wrenches, self.pushes = [], []
        act()
        found = tuple(self.wrenches), tuple(self.pushes)
        self.wrenches, self.pushes = kept
        return found

    def _touch(
        self, contact: Contact, name: str, centre: Anchor, side: Side, exponent: float, circle: Circle | None
    ) -> None:
        met = self._meet(contact, name, centre, side, circle)
        n, gap, arm, reach = met.n, met.gap, met.arm, met.reach
        (vc, wc), (vP, wP) = (
            [self._probe(name, k, reading, at) for reading in (Reading.VELOCITY, Reading.SPIN)]
            for k, at in (("c", centre), ("P", side.anchor))
        )
        shift = self._shift(contact) * gap
        if shift:
            arm, reach = subtract(arm, scale(shift, n)), subtract(reach, scale(shift, n))
        relative = subtract(add(vc, cross(wc, arm)), add(vP, cross(wP, reach)))
        v = self._define_vector(name, "v", relative)
        rate = self._define(name, "rate", dot(n, v))
        self.distances.append(Distance(name, gap))
        depth, N = self._press(contact, name, gap, rate, exponent)
        F, M = scale(N, n), _NOTHING
        if met.axle is not None and contact.tyre is not None:
            across = scale(1 / sqrt(met.axle.square), met.axle.axis)
            forward = self._define_vector(name, "x", cross(across, n))
            left = self._define_vector(name, "y", cross(n, forward))
            slips = {
                "vx": dot(forward, subtract(vc, add(vP, cross(wP, reach)))),
                "sy": dot(left, v),
                "spin": dot(met.axle.axis, subtract(wc, wP)),
                "gamma": asin(met.axle.lean),
            }
            force, moment = self._slide(contact, contact.tyre, name, {**slips, "load": N, "depth": depth})
            F = add(F, add(scale(force[0], forward), scale(force[1], left)))
            M = self._define_vector(name, "M", _combine(moment, (forward, left, n)))
        if contact.friction is not None:
            slip = self._define_vector(name, "slip", subtract(v, scale(rate, n)))
            own = {"normal": N, "square": dot(slip, slip)}
            own |= {key: self._read(getattr(contact.friction, key), {}) for key in ("coefficient", "speed")}
            law = _DRAG
            if contact.law is not None:
                law, own = contact.law.drag, own | self._list_numbers(contact, contact.law)
            drag = self._define(name, "drag", self._read(law, own))
            F = subtract(F, scale(drag, slip))
        F = self._define_vector(name, "F", F)
        self._act(name, centre, F, add(cross(arm, F), M))
        self._act(name, side.anchor, scale(-1, F), subtract(cross(F, reach), M))

    def _slide(
        self, contact: Contact, tyre: Tyre, name: str, given: Mapping[str, Expr]
    ) -> tuple[tuple[Expr, Expr], Vector]:
        """Define the force of a tyre forward and to the left, and its moment along these and the normal."""
        assert contact.wheel is not None, "a tyre is of a wheel"
        side = -1 if tyre.mirrored else 1
        own = {key: self._read(x, {}) for key, x in (*tyre.numbers, ("speed", tyre.speed))}
        own |= {key: x if x.is_Symbol else self._define(name, key, x) for key, x in given.items()}
        own |= {key: side * own[key] for key in ("sy", "gamma")}
        slips = {way: rate_symbol(name_slip(contact.name, way)) for way in tyre.relaxed}
        signs = {LONGITUDINAL: 1, LATERAL: side}
        for way, rate in slips.items():
            own[_DEFLECTIONS[way]] = signs[way] * rate
        own |= {_LENGTHS[way]: self._read(x, {}) for way, x in tyre.lengths}
        own["radius"] = self._read(contact.wheel.radius, {}) + self._read(contact.radius, {})
        own["stiffness"] = self._read(contact.stiffness, {})
        for key, law in tyre.law:
            value = self._read(law, own)
            own[key] = value if value.is_number else self._define(name, key, value)
        for way in slips:
            self.pushes.append((name_slip(contact.name, way), signs[way] * own[f"d{_DEFLECTIONS[way]}"]))
        return (own["Fx"], side * own["Fy"]), (side * own["Mx"], own["My"], side * own["Mz"])

    def _meet(self, contact: Contact, name: str, centre: Anchor, side: Side, circle: Circle | None) -> _Meeting:
        """Define the normal, the gap and the point of contact."""
        r = self._read(contact.radius, {})
        c, P = (self._probe(name, k, Reading.POSITION, at) for k, at in (("c", centre), ("P", side.anchor)))
        if isinstance(contact.other, Sphere):
            R = self._read(contact.other.radius, {})
            return self._meet_within(name, c, P, r, R) if contact.other.inside else self._meet_sphere(name, c, P, r, R)
        if isinstance(contact.other, Capsule):
            return self._meet_capsule(contact, contact.other, name, (c, P), r, side)
        if isinstance(contact.other, Block):
            return self._meet_box(contact, contact.other, name, subtract(c, P), r, side)
        (normal,) = side.axes
        n = self._probe(name, "n", Reading.DIRECTION, Anchor(side.anchor.body, normal))
        arm, axle = scale(-r, n), None
        if circle is not None:
            rim, axle = self._roll(name, n, centre, circle)
            arm = add(arm, rim)
        reach = self._define_vector(name, "reach", add(subtract(c, P), arm))
        return _Meeting(n, self._define(name, "gap", dot(n, reach)), arm, reach, axle)

    def _roll(self, name: str, n: Vector, centre: Anchor, circle: Circle) -> tuple[Vector, _Axle]:
        """Define the way from the centre of a wheel to the point of its circle that is nearest to a plane."""
        a = self._probe(name, "a", Reading.DIRECTION, Anchor(centre.body, circle.axis))
        lean = self._define(name, "lean", dot(n, a))
        square = self._define(name, "square", 1 - lean**2, Length(name, Integer(1)))
        part = self._define(name, "part", -self._read(circle.radius, {}) / sqrt(square))
        return self._define_vector(name, "rim", scale(part, subtract(n, scale(lean, a)))), _Axle(a, lean, square)

    def _meet_sphere(self, name: str, c: Vector, P: Vector, r: Expr, R: Expr) -> _Meeting:
        d = self._define_vector(name, "d", subtract(c, P))
        square = self._define(name, "square", dot(d, d), Length(name, dot(c, c) + dot(P, P)))
        length = self._define(name, "length", sqrt(square))
        n = self._define_vector(name, "n", scale(1 / length, d))
        gap = self._define(name, "gap", length - r - R)
        return _Meeting(n, gap, scale(-r / (r + R), d), scale(R / (r + R), d))

    def _meet_within(self, name: str, c: Vector, P: Vector, r: Expr, R: Expr) -> _Meeting:
        d = self._define_vector(name, "d", subtract(c, P))
        square = self._define(name, "square", dot(d, d), Length(name, dot(c, c) + dot(P, P)))
        length = self._define(name, "length", sqrt(square))
        n = self._define_vector(name, "n", scale(-1 / length, d))
        gap = self._define(name, "gap", R - r - length)
        return _Meeting(n, gap, scale(r / (R - r), d), scale(R / (R - r), d))

    def _meet_box(self, contact: Contact, box: Block, name: str, d: Vector, r: Expr, side: Side) -> _Meeting:
        # the distance is a smooth function of q = |x| - edge/2 in the box's axes, and n is its gradient
        own = {"width": self._read(contact.width, {}), "radius": r}
        axes = [
            self._probe(name, k, Reading.DIRECTION, Anchor(side.anchor.body, a))
            for k, a in zip("XYZ", side.axes, strict=True)
        ]
        for k, a, edge in zip("xyz", axes, box.size, strict=True):
            near = {**own, "x": self._define(name, f"x.{k}", dot(a, d)), "edge": self._read(edge, {})}
            near["q"] = own[f"q_{k}"] = self._define(name, f"q.{k}", self._read(_BEYOND, near))
            own[f"y_{k}"] = self._define(name, f"y.{k}", self._read(_OUTSIDE, near))
            own[f"side_{k}"] = self._define(name, f"side.{k}", self._read(_SIDE, near))
        found = {}
        for key, law in _BOX.items():
            own[key] = found[key] = self._define(name, key, self._read(law, own))
        gap = found["gap"]
        slopes = [self._define(name, f"slope.{k}", self._read(law, own)) for k, law in zip("xyz", _SLOPES, strict=True)]
        x, y, z = (scale(slope, a) for slope, a in zip(slopes, axes, strict=True))
        n = self._define_vector(name, "n", add(add(x, y), z))
        arm = scale(-r, n)
        return _Meeting(n, gap, arm, add(d, arm))

    def _meet_capsule(
        self, contact: Contact, capsule: Capsule, name: str, centres: tuple[Vector, Vector], r: Expr, side: Side
    ) -> _Meeting:
        # as of a box: the distance is smooth where the nearest point of the segment becomes its end
        (c, P), own = centres, {"width": self._read(contact.width, {}), "edge": self._read(capsule.length, {})}
        d = subtract(c, P)
        a = self._probe(name, "Z", Reading.DIRECTION, Anchor(side.anchor.body, side.axes[2]))
        own["x"] = along = self._define(name, "along", dot(a, d))
        across = self._define_vector(name, "across", subtract(d, scale(along, a)))
        own["q"] = self._define(name, "q", self._read(_BEYOND, own))
        beyond = self._define(name, "beyond", self._read(_OUTSIDE, own))
        square = dot(across, across) + beyond**2
        square = self._define(name, "square", square, Length(name, dot(c, c) + dot(P, P)))
        length = self._define(name, "length", sqrt(square))
        slope = self._define(name, "slope", self._read(_END, own) * beyond)
        n = self._define_vector(name, "n", scale(1 / length, add(across, scale(slope, a))))
        gap = self._define(name, "gap", length - r - self._read(capsule.radius, {}))
        arm = scale(-r, n)
        return _Meeting(n, gap, arm, add(d, arm))

    def _shift(self, contact: Contact) -> Expr:
        """Return the part of the gap by which a force acts further from the first side than its nearest point."""
        if contact.tyre is not None:
            return ONE
        if contact.law is None:
            return ZERO
        share = self._read(contact.law.share, {})
        if isinstance(contact.other, Sphere):
            r, R = (self._read(x, {}) for x in (contact.radius, contact.other.radius))
            return share - r / (r + R)
        return share

    def _list_numbers(self, contact: Contact, law: SphereLaw) -> dict[str, Expr]:
        static = law.static
        if static is None:
            static = model.ZERO if contact.friction is None else contact.friction.coefficient
        given = {key: getattr(law, key) for key in law.keys} | {"static": static}
        return {key: self._read(x, {}) for key, x in given.items()}

    def _press(self, contact: Contact, name: str, gap: Expr, rate: Expr, exponent: float) -> tuple[Expr, Expr]:
        """Define the depth and the normal force."""
        own = {key: self._read(getattr(contact, key), {}) for key in ("stiffness", "dissipation", "width")}
        own |= {"gap": gap, "rate": rate}
        if contact.law is not None:
            own |= self._list_numbers(contact, contact.law)
            if contact.law.near is not None:
                own["near"] = self._define(name, "near", self._read(contact.law.near, own))
            return -gap, self._define(name, "N", self._read(contact.law.press(contact.dissipation), own))
        own["depth"] = self._define(name, "depth", self._read(_DEPTH, own))
        own["power"] = own["depth"] ** int(exponent)
        if exponent % 1:
            own["power"] *= self._read(_ROOT, own)
        return own["depth"], self._define(name, "N", self._read(_NORMAL, own))

    def _probe(self, name: str, key: str, reading: Reading, anchor: Anchor) -> Vector:
        x, y, z = (_symbolize(name, key, reading, axis) for axis in "xyz")
        self.probes.append(Probe((x, y, z), reading, anchor.body, anchor.point))
        return x, y, z

    def _define(self, name: str, key: str, value: Expr, length: Length | None = None) -> Symbol:
        symbol = Symbol(f"force[{name}] {key}", real=True)
        self.definitions.append(Definition(symbol, value, length, name, key))
        return symbol

    def _note(self, name: str, key: str, value: Expr) -> Symbol:
        """Define a number of a stop, which is no force element."""
        symbol = Symbol(f"stop[{name}] {key}", real=True)
        self.definitions.append(Definition(symbol, value))
        return symbol

    def _define_within(self, name: str, part: str, key: str, value: Expr) -> Symbol:
        return self._define(name, f"{part} {key}", value)

    def _define_vector(self, name: str, key: str, vector: Vector) -> Vector:
        x, y, z = (self._define(name, f"{key}.{axis}", value) for axis, value in zip("xyz", vector, strict=True))
        return x, y, z

    def _act(self, name: str, anchor: Anchor, force: Vector, moment: Vector) -> None:
        if anchor.body:
            self.wrenches.append(Wrench(name, anchor.body, anchor.point, True, force, moment))


def list_end_symbols(name: str) -> tuple[Symbol, Symbol]:
    """Return the symbols of the first entries of the positions of both ends of a force element."""
    return _symbolize(name, "a", Reading.POSITION, "x"), _symbolize(name, "b", Reading.POSITION, "x")


def _symbolize(name: str, key: str, reading: Reading, axis: str) -> Symbol:
    return Symbol(f"force[{name}] {key} {reading.value}.{axis}", real=True)


def _vector(components: Iterable[Expr]) -> Vector:
    x, y, z = components
    return x, y, z


def _combine(factors: Sequence[Expr], vectors: Sequence[Vector]) -> Vector:
    x, y, z = (total(f * v[c] for f, v in zip(factors, vectors, strict=True)) for c in range(3))
    return x, y, z
