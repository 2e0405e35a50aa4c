"""Muscles and springs of OpenSim along paths -> lines through points, and laws of their tension.

A path has points that are fixed in frames, that move with coordinates, or that it passes in a range of a coordinate.
OpenSim widens such a range by 1e-5, and holds a point that moves where its coordinate leaves its own range. Muscles of
De Groote and Fregly, Millard and Thelen have their own curves. A RigidTendonMuscle, and on demand the other two, get
De Groote's, and keep their numbers as Moco's ModOpReplaceMusclesWithDeGrooteFregly2016 keeps them.

A Ligament pulls by a curve of its length over the resting one, where it is longer. With the strain e over the slack
length, a Blankevoort1991Ligament pulls with k e^2/(2 toe), from e = toe on with k (e - toe/2), and while it lengthens
with its damping times the rate of e, which Simbody's step of degree 5 begins over a strain of 0.01.

OpenSim changes Millard's curves: at an elastic tendon without damping of the fibres, active force is 0.1 at least, and
slopes of force over velocity at the largest speeds are half of those near them at least; else both are 0.

Source: OpenSim's documentation of its classes and their defaults.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.expressions import (
    FLOATS,
    Expression,
    Name,
    Number,
    Operation,
    evaluate,
    fold,
    is_free_name,
    parse,
    substitute,
    write,
)
from mbsgen.importing.closing import X
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.forces import is_on
from mbsgen.importing.osim.frames import Frames, Mount
from mbsgen.importing.osim.functions import (
    FUNCTIONS,
    Sum,
    find_function,
    read_formula,
    read_function,
    write_number,
    write_over,
    write_spline,
)
from mbsgen.model.model import ZERO
from mbsgen.model.muscle_curves import DEGROOTE, Curves, Millard, Thelen
from mbsgen.model.muscles import LENGTH, LENGTH_RATE, Muscle

MUSCLES = ("DeGrooteFregly2016Muscle", "Millard2012EquilibriumMuscle", "Thelen2003Muscle", "RigidTendonMuscle")
PATH_SPRING = "PathSpring"
LIGAMENT, BLANKEVOORT, PATH_ACTUATOR = "Ligament", "Blankevoort1991Ligament", "PathActuator"
PASSIVE = (PATH_SPRING, LIGAMENT, BLANKEVOORT)
PATHS = (*MUSCLES, *PASSIVE, PATH_ACTUATOR)
POINT_SPRING, POINT_FORCE = "PointToPointSpring", "ExpressionBasedPointToPointForce"
POINT_ACTUATOR = "PointToPointActuator"
PAIRS = (POINT_SPRING, POINT_FORCE, POINT_ACTUATOR)  # between two points
POINTS = ("PathPoint", "ConditionalPathPoint", "MovingPathPoint")
SURFACES: Mapping[str, str] = {
    "WrapCylinder": "cylinder",
    "WrapSphere": "sphere",
    "WrapEllipsoid": "ellipsoid",
    "WrapTorus": "torus",
}
_METHODS = ("hybrid", "midpoint", "axial")  # of an ellipsoid
SIDES = ("x", "-x", "y", "-y", "z", "-z")
WIDENING = 1e-5  # of the range of a point, rad or m
_AXES = "xyz"
_SPRING = parse(f"stiffness*max({LENGTH} - rest, 0)*(1 + dissipation*{LENGTH_RATE})")
_LINEAR = parse(f"k*({LENGTH} - rest)")
_STEP = "(min(max(strain*100, 0), 1))"
_BLANKEVOORT = parse(
    "stiffness*(min(max(strain, 0), toe)**2/(2*toe) + max(strain - toe, 0))"
    f" + damping*max({LENGTH_RATE}, 0)/slack*{_STEP}**3*(10 - 15*{_STEP} + 6*{_STEP}**2)"
)
_LIGAMENT_X = (-5, 0.998, 0.999, 1, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.601, 1.602, 5)  # OpenSim's default
_LIGAMENT_Y = (0, 0, 0, 0, 0.035, 0.12, 0.26, 0.55, 1.17, 2, 2, 2, 2)
_CLOSED = 1e-6  # the largest force of a ligament at its resting length, over its scale
_NUMBERS: Mapping[str, tuple[str, float]] = {  # of all muscles
    "strength": ("max_isometric_force", 1000.0),
    "fibre": ("optimal_fiber_length", 0.1),
    "tendon": ("tendon_slack_length", 0.2),
    "pennation": ("pennation_angle_at_optimal", 0.0),
    "speed": ("max_contraction_velocity", 10.0),
}
_OWN: Mapping[str, Mapping[str, tuple[str, float]]] = {
    "DeGrooteFregly2016Muscle": {
        "damping": ("fiber_damping", 0.0),
        "passive": ("passive_fiber_strain_at_one_norm_force", 0.6),
        "width": ("active_force_width_scale", 1.0),
        "tendon_strain": ("tendon_strain_at_one_norm_force", 0.049),
    },
    "Thelen2003Muscle": {"passive": ("FmaxMuscleStrain", 0.6), "tendon_strain": ("FmaxTendonStrain", 0.04)},
    "Millard2012EquilibriumMuscle": {"damping": ("fiber_damping", 0.1)},
    "RigidTendonMuscle": {},
}
_UNDAMPED = 0.001  # Millard's fibres do not damp below this
_LEAST = 0.1
SHAPES: Mapping[str, Mapping[str, tuple[str, str]]] = {  # numbers of curves: an element of the muscle, and its element
    "Thelen2003Muscle": {
        "active_shape": ("", "KshapeActive"),
        "passive_shape": ("", "KshapePassive"),
        "velocity_shape": ("", "Af"),
        "greatest": ("", "Flen"),
        "reach": ("", "fv_linear_extrap_threshold"),
    },
    "Millard2012EquilibriumMuscle": {
        "shortest": ("ActiveForceLengthCurve", "min_norm_active_fiber_length"),
        "transition": ("ActiveForceLengthCurve", "transition_norm_fiber_length"),
        "longest": ("ActiveForceLengthCurve", "max_norm_active_fiber_length"),
        "shallow": ("ActiveForceLengthCurve", "shallow_ascending_slope"),
        "floor": ("ActiveForceLengthCurve", "minimum_value"),
        "shortening_end": ("ForceVelocityCurve", "concentric_slope_at_vmax"),
        "shortening_near": ("ForceVelocityCurve", "concentric_slope_near_vmax"),
        "isometric": ("ForceVelocityCurve", "isometric_slope"),
        "lengthening_end": ("ForceVelocityCurve", "eccentric_slope_at_vmax"),
        "lengthening_near": ("ForceVelocityCurve", "eccentric_slope_near_vmax"),
        "greatest": ("ForceVelocityCurve", "max_eccentric_velocity_force_multiplier"),
        "shortening_curviness": ("ForceVelocityCurve", "concentric_curviness"),
        "lengthening_curviness": ("ForceVelocityCurve", "eccentric_curviness"),
        "slack": ("FiberForceLengthCurve", "strain_at_zero_force"),
        "passive_low": ("FiberForceLengthCurve", "stiffness_at_low_force"),
        "passive_slope": ("FiberForceLengthCurve", "stiffness_at_one_norm_force"),
        "passive_curviness": ("FiberForceLengthCurve", "curviness"),
        "tendon_slope": ("TendonForceLengthCurve", "stiffness_at_one_norm_force"),
        "tendon_toe": ("TendonForceLengthCurve", "norm_force_at_toe_end"),
        "tendon_curviness": ("TendonForceLengthCurve", "curviness"),
    },
}
_VANISHING = ("tendon", "pennation", "damping")
_CURVES: Mapping[str, tuple[str, float]] = {  # of Millard's muscles: elements with strain_at_one_norm_force
    "passive": ("FiberForceLengthCurve", 0.7),
    "tendon_strain": ("TendonForceLengthCurve", 0.049),
}


@dataclass(frozen=True, eq=False)
class Point:
    """A point of a path."""

    mount: Mount
    location: tuple[float, ...]
    shift: tuple[Sum, ...] = ()  # of a point that moves: its coordinates
    presence: tuple[str, float, float] | None = None  # a coordinate, and the range in which the path passes the point


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface around which a path wraps."""

    mount: Mount
    kind: str
    size: tuple[float, ...]
    length: float | None  # of a cylinder
    side: str
    between: tuple[int, int]  # points, from 1
    method: str  # of an ellipsoid


@dataclass(frozen=True, eq=False)
class Line:
    """A muscle or a spring along a path."""

    name: str
    element: Element
    points: tuple[Point, ...]
    wraps: tuple[Surface, ...]
    force: Expression = ZERO
    muscle: Muscle | None = None
    driven: str = ""  # the signal of an actuator

    @property
    def signals(self) -> tuple[str, ...]:
        """Return the signals that its muscle reads."""
        if self.muscle is None:
            return (self.driven,) if self.driven else ()
        given = (self.muscle.activation, self.muscle.tendon_state)
        return tuple(x.name for x in given if isinstance(x, Name))


@dataclass
class Paths:
    """Reads the lines of a file."""

    frames: Frames
    findings: Findings
    coordinates: Mapping[str, Element]
    ranges: Mapping[str, tuple[float | None, float | None]]  # of coordinates
    is_nested: bool  # as in versions 2 and 3
    is_rigid: bool  # all tendons
    is_degroote: bool  # all curves
    surfaces: Mapping[str, tuple[Element, Mount]]  # around which paths may wrap, with their bodies

    def read(self, element: Element) -> Line | None:
        """Read a muscle or a spring of PATHS; None, with a notice or a fault, where there is none."""
        if not is_on(element):
            self.findings.tell(element, "it is switched off in the file: left out")
            return None
        path = element.first("GeometryPath") or element.first("path")
        if path is not None and path.tag == "path":
            path = path.first("GeometryPath")
        if path is None:
            self.findings.fault(element, "no GeometryPath", "give the points of its path")
            return None
        found = [self._read_point(x) for x in _list_objects(path, "PathPointSet")]
        points = tuple(x for x in found if x is not None)
        if len(found) < 2:
            self.findings.fault(path, f"a path of {len(found)} points", "give at least two")
        ends = [x for x in (points[:1] + points[-1:]) if x.presence is not None]
        if ends:
            self.findings.fault(path, "it begins or ends at a conditional point", "give a PathPoint there")
        if len(found) < 2 or len(points) < len(found) or ends:
            return None
        wraps = self._read_wraps(element, path, len(points))
        if wraps is None:
            return None
        name = element.attributes.get("name", "") or element.tag
        if element.tag == PATH_ACTUATOR:
            signal = spell_signal(name)
            force = Operation("*", Number(self._number(element, "optimal_force", 1.0)), Name(signal))
            return Line(name, element, points, wraps, force, driven=signal)
        if element.tag in PASSIVE:
            law = self._read_law(element)
            return None if law is None else Line(name, element, points, wraps, law)
        return Line(name, element, points, wraps, muscle=self._read_muscle(element, name))

    def _read_wraps(self, element: Element, path: Element, points: int) -> tuple[Surface, ...] | None:
        """Read the surfaces around which a path wraps; None, with a warning, where this is not possible."""
        found = list[Surface]()
        for given in _list_objects(path, "PathWrapSet"):
            name = _read_text(given, "wrap_object")
            if name not in self.surfaces:
                meant = nearest(name, list(self.surfaces))
                remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a WrapObject of the file"
                self.findings.fault(given, f"there is no surface {abbreviate(name)}", remedy)
                continue
            surface, mount = self.surfaces[name]
            if not is_on(surface):
                self.findings.tell(given, f"{abbreviate(name)} is switched off in the file: left out")
                continue
            reason = self._find_obstacle(surface)
            own = None if reason else self._read_surface(given, surface, mount, points)
            if own is not None and any(
                max(own.between[0], x.between[0]) < min(own.between[1], x.between[1]) for x in found
            ):
                reason = "as another surface between the same points"
            if reason:
                text = f"its path wraps around {abbreviate(name)}, {reason}, which is not read: its force is left out"
                self.findings.warn(element, text)
                return None
            found += [] if own is None else [own]
        return tuple(found)

    def _find_obstacle(self, surface: Element) -> str:
        """Return why a path cannot wrap around a surface; "" if it can."""
        side = _read_side(surface)
        if surface.tag not in SURFACES:
            return f"a {surface.tag}"
        is_axial = SURFACES[surface.tag] in ("cylinder", "torus")
        return "with a side along its axis" if is_axial and side.endswith("z") else ""

    def _read_surface(self, given: Element, surface: Element, mount: Mount, points: int) -> Surface | None:
        """Read a surface between points of a path; None with a fault."""
        bounds = given.first("range")
        drawn: tuple[float, ...] = (-1.0, -1.0)
        if bounds is not None:
            drawn = self.findings.numbers(bounds, "range", drawn, attributes={"range": bounds.text})
        first, last = (int(x) if x >= 1 else end for x, end in zip(drawn, (1, points), strict=True))
        side = _read_side(surface)
        kind, method = SURFACES[surface.tag], _read_text(given, "method").lower() or _METHODS[0]
        size = self._read_size(surface)
        length = self._number(surface, "length", 1.0) if kind == "cylinder" else None
        if not first < last <= points:
            remedy = "give the numbers of two of its points, from 1, in order"
            self.findings.fault(given, f"a range from point {first} to {last} of {points}", remedy)
        elif side and side not in SIDES:
            self.findings.fault(surface, f"a quadrant {abbreviate(side)}", f"give all, {', '.join(SIDES)}")
        elif min(size) <= 0 or (length is not None and length <= 0):
            self.findings.fault(surface, "a radius or a length of 0 or less", "give more than 0")
        elif kind == "torus" and size[0] <= size[1]:
            self.findings.fault(surface, f"an outer_radius of {size[0]:g}", f"give more than {size[1]:g}")
        elif kind == "ellipsoid" and method not in _METHODS:
            self.findings.fault(given, f"a method {abbreviate(method)}", f"give {', '.join(_METHODS)}")
        else:
            pose = self.frames.read_pose(surface, "translation", "xyz_body_rotation")
            seat = replace(mount, pose=mount.pose @ pose)
            return Surface(seat, kind, size, length, side, (first, last), method)
        return None

    def _read_size(self, surface: Element) -> tuple[float, ...]:
        """Read the radius, both radii of a torus, or the half axes of an ellipsoid."""
        if surface.tag == "WrapTorus":
            return self._number(surface, "outer_radius", -1.0), self._number(surface, "inner_radius", -1.0)
        if surface.tag != "WrapEllipsoid":
            return (self._number(surface, "radius", 1.0),)
        given, none = surface.first("dimensions"), (-1.0, -1.0, -1.0)
        if given is None:
            return none
        return self.findings.numbers(given, "dimensions", none, attributes={"dimensions": given.text})

    def _read_point(self, element: Element) -> Point | None:
        if element.tag not in POINTS:
            self.findings.fault(
                element, f"a point of the kind {abbreviate(element.tag)}", f"give one of {', '.join(POINTS)}"
            )
            return None
        body = element.first("body")
        nested = self.is_nested or (body is not None and element.first("socket_parent_frame") is None)
        if nested:
            mount = self.frames.find_body(body, element)
        else:
            mount = self.frames.find(element.first("socket_parent_frame"), element)
        if mount is None:
            return None
        if element.tag == "MovingPathPoint":
            sums = [self._read_place(element, axis) for axis in _AXES]
            kept = tuple(x for x in sums if x is not None)
            return Point(mount, (0.0, 0.0, 0.0), kept) if len(kept) == len(sums) else None
        location = self.frames.read_vector(element, "location")
        if element.tag == "PathPoint":
            return Point(mount, location)
        presence = self._read_presence(element)
        return None if presence is None else Point(mount, location, presence=presence)

    def _read_presence(self, element: Element) -> tuple[str, float, float] | None:
        name = self._find_coordinate(element, "coordinate")
        bounds = element.first("range")
        if name is None or bounds is None:
            if bounds is None:
                self.findings.fault(element, "a conditional point without a range", "give it two numbers")
            return None
        lower, upper = self.findings.numbers(bounds, "range", (0.0, 0.0), attributes={"range": bounds.text})
        if lower > upper:
            self.findings.fault(bounds, f"a range from {lower:g} to {upper:g}", "swap them")
        return name, lower - WIDENING, upper + WIDENING

    def _read_place(self, element: Element, axis: str) -> Sum | None:
        place = element.first(f"{axis}_location")
        function = None if place is None else find_function(place)
        if function is None:
            self.findings.fault(element, f"no {axis}_location", "give it a function")
            return None
        if function.tag == "Constant":
            return read_function(function, [], self.findings)
        name = self._find_coordinate(element, f"{axis}_coordinate")
        return None if name is None else self._clamp(read_function(function, [name], self.findings), name)

    def _clamp(self, amount: Sum, name: str) -> Sum:
        """Hold a place where its coordinate leaves its range."""
        text = X
        for function, bound in zip(("max", "min"), self.ranges.get(name, (None, None)), strict=True):
            text = text if bound is None else f"{function}({text}, {write_number(bound)})"
        if text == X:
            return amount
        curves: list[tuple[str, Expression]] = [
            (name, Operation("*", Number(slope), parse(text))) for slope in amount.slopes.values()
        ]
        curves += [(name, substitute(curve, {X: parse(text)})) for _, curve in amount.curves]
        return Sum(amount.constant, curves=tuple(curves))

    def _find_coordinate(self, element: Element, tag: str) -> str | None:
        child = element.first(f"socket_{tag}") or element.first(tag)
        name = "" if child is None else child.text.rsplit("/", 1)[-1]
        if name in self.coordinates:
            return name
        meant = nearest(name, list(self.coordinates))
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a coordinate of the file"
        finding = f"there is no coordinate {abbreviate(name)}" if name else f"no {tag}"
        self.findings.fault(element if child is None else child, finding, remedy)
        return None

    def read_pair(self, element: Element) -> Line | None:
        """Read a force of PAIRS; None, with a notice or faults, where there is none."""
        if not is_on(element):
            self.findings.tell(element, "it is switched off in the file: left out")
            return None
        name = element.attributes.get("name", "") or element.tag
        read = self.frames.read_vector
        if element.tag == POINT_ACTUATOR:
            ends = [self.frames.find_named(element, f"body{k}") for k in "AB"]
            points = [Point(mount, read(element, f"point{k}")) for k, mount in zip("AB", ends, strict=True) if mount]
        else:
            ends = [self._find_end(element, k) for k in (1, 2)]
            points = [Point(mount, read(element, f"point{k}")) for k, mount in enumerate(ends, 1) if mount]
        if len(points) < 2:
            return None
        if element.tag == POINT_ACTUATOR:
            if _is_true(element, "points_are_global"):
                self.findings.warn(element, "its points are in the ground's frame, which is not read: left out")
                return None
            signal = spell_signal(name)
            push = Operation("*", Number(-self._number(element, "optimal_force", 1.0)), Name(signal))
            return Line(name, element, tuple(points), (), parse(write(push)), driven=signal)
        if element.tag == POINT_SPRING:
            given = {"k": self._number(element, "stiffness", 1.0), "rest": self._number(element, "rest_length", 0.0)}
            law: Expression | None = substitute(_LINEAR, {key: Number(x) for key, x in given.items()})
        else:
            law = read_formula(element, {"d": LENGTH, "ddot": LENGTH_RATE}, self.findings)
        return None if law is None else Line(name, element, tuple(points), (), law)

    def _find_end(self, element: Element, k: int) -> Mount | None:
        socket, body = element.first(f"socket_body{k}"), element.first(f"body{k}")
        if socket is None and body is not None:
            return self.frames.find_body(body, element)
        return self.frames.find(socket, element)

    def _read_law(self, element: Element) -> Expression | None:
        """Read the tension of a spring or a ligament; None with a warning or a fault."""
        if element.tag == PATH_SPRING:
            return self._read_spring(element)
        return self._read_ligament(element) if element.tag == LIGAMENT else self._read_blankevoort(element)

    def _read_ligament(self, element: Element) -> Expression | None:
        rest, scale = self._number(element, "resting_length", 0.0), self._number(element, "pcsa_force", 0.0)
        if rest <= 0:
            at = element.first("resting_length") or element
            self.findings.fault(at, f"resting_length is {rest:g}", "give more than 0")
            return None
        held = element.first("force_length_curve")
        known = [x for x in element.children if x.tag in FUNCTIONS]
        function = find_function(held) if held is not None and held.children else next(iter(known), None)
        if function is None:
            total = write_spline(np.array(_LIGAMENT_X, dtype=float), np.array(_LIGAMENT_Y, dtype=float))
        else:
            total = write_over(read_function(function, [X], self.findings))
        begin: float = evaluate(total, {X: 1.0}, FLOATS)
        if abs(begin) > _CLOSED:
            text = "its curve is not 0 at its resting length, where its force jumps, which is not read: it is left out"
            self.findings.warn(element, text)
            return None
        stretch = parse(f"max({LENGTH}/{write_number(rest)}, 1)")
        return Operation("*", Number(scale), substitute(total, {X: stretch}))

    def _read_blankevoort(self, element: Element) -> Expression | None:
        tags = {"stiffness": ("linear_stiffness", 1.0), "toe": ("transition_strain", 0.06)}
        tags |= {"damping": ("damping_coefficient", 0.003), "slack": ("slack_length", 0.0)}
        numbers = {key: self._number(element, *pair) for key, pair in tags.items()}
        for key, value in numbers.items():
            self._check(element, tags[key][0], value, may_vanish=key in ("stiffness", "damping"))
        if numbers["toe"] <= 0 or numbers["slack"] <= 0:
            return None
        strain = parse(f"{LENGTH}/{write_number(numbers['slack'])} - 1")
        return substitute(_BLANKEVOORT, {"strain": strain, **{key: Number(x) for key, x in numbers.items()}})

    def _read_spring(self, element: Element) -> Expression:
        given = {"stiffness": "stiffness", "rest": "resting_length", "dissipation": "dissipation"}
        return substitute(_SPRING, {key: Number(self._number(element, tag, 0.0)) for key, tag in given.items()})

    def _read_muscle(self, element: Element, name: str) -> Muscle:
        tag = element.tag
        given = {**_NUMBERS, **_OWN[tag]}
        numbers = {key: self._number(element, *pair) for key, pair in given.items()}
        if tag == "Millard2012EquilibriumMuscle":
            for key, (curve, default) in _CURVES.items():
                own = element.first(curve)
                numbers[key] = default if own is None else self._number(own, "strain_at_one_norm_force", default)
        for key, value in numbers.items():
            self._check(
                element, given[key][0] if key in given else _CURVES[key][0], value, may_vanish=key in _VANISHING
            )
        if tag == "Millard2012EquilibriumMuscle" and numbers["damping"] < _UNDAMPED:
            numbers["damping"] = 0.0
        if _is_true(element, "ignore_passive_fiber_force"):
            numbers["passive"] = 0.0
        signal = spell_signal(name)
        is_rigid = self.is_rigid or _is_true(element, "ignore_tendon_compliance") or tag == "RigidTendonMuscle"
        values = {key: Number(x) for key, x in numbers.items() if not (is_rigid and key == "tendon_strain")}
        tendon = None if is_rigid else Name(f"{signal}_tendon")
        curves: Curves = DEGROOTE
        if tag in SHAPES and not self.is_degroote:
            curves = self._read_curves(element, may_settle=not is_rigid and not numbers.get("damping"))
        return Muscle(activation=Name(signal), tendon_state=tendon, curves=curves, **values)

    def _read_curves(self, element: Element, *, may_settle: bool) -> Curves:
        """Read the numbers of curves; `may_settle` where OpenSim solves for the fibres' velocity without damping."""
        found = dict[str, float]()
        for key, (outer, tag) in SHAPES[element.tag].items():
            whole = element.first(outer) if outer else element
            child = None if whole is None else whole.first(tag)
            if child is not None and child.text:
                found[key] = self.findings.number(child, tag, 0.0, {tag: child.text})
        if element.tag == "Thelen2003Muscle":
            return Thelen(**{key: Number(x) for key, x in found.items()})
        found["floor"] = max(found.get("floor", _LEAST), _LEAST) if may_settle else 0.0
        curves = Millard(**{key: Number(x) for key, x in found.items()})
        ends = {"shortening_end": curves.shortening_near, "lengthening_end": curves.lengthening_near}
        for key, near in ends.items():
            least = fold(substitute(parse("max(end, near/2)"), {"end": curves.numbers[key], "near": near}))
            curves = replace(curves, **{key: least if may_settle else ZERO})
        return curves

    def _check(self, element: Element, tag: str, value: float, *, may_vanish: bool) -> None:
        child = element.first(tag) or element
        if value < 0 or (value == 0 and not may_vanish):
            self.findings.fault(child, f"{tag} is {value:g}", f"give {'0 or more' if may_vanish else 'more than 0'}")
        elif tag == _NUMBERS["pennation"][0] and value >= math.pi / 2:
            self.findings.fault(child, f"{tag} is {value:g} rad", "give less than a quarter turn, in rad")

    def _number(self, element: Element, tag: str, default: float) -> float:
        child = element.first(tag)
        return default if child is None else self.findings.number(child, tag, default, {tag: child.text})


def spell_signal(name: str) -> str:
    """Return the name of a muscle as expressions have it."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return word if is_free_name(word) and word not in (LENGTH, LENGTH_RATE, "t") else f"muscle_{word}"


def _read_side(surface: Element) -> str:
    text = _read_text(surface, "quadrant").lower().removeprefix("+")
    return "" if text in ("all", "unassigned") else text


def _list_objects(path: Element, name: str) -> Iterator[Element]:
    found = path.first(name)
    objects = None if found is None else found.first("objects")
    yield from () if objects is None else objects.children


def _read_text(element: Element, tag: str) -> str:
    child = element.first(tag)
    return "" if child is None else child.text


def _is_true(element: Element, tag: str) -> bool:
    return _read_text(element, tag).lower() in ("true", "1")
