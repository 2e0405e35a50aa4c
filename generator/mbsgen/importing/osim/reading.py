"""Models of OpenSim (.osim, versions 2.3 to 4) -> Draft of a model: one body each, in the frame of its joint.

Joints connect frames at offsets to bodies. A joint that reaches its parent first carries its child, else its parent. A
joint between two carried bodies closes a loop. A body that no joint connects moves freely, as in OpenSim.

A coordinate is the joint of one axis of its CustomJoint: an axis whose function is linear in this coordinate alone. All
other axes that depend on it follow it where their functions are linear, else by an equation. A coordinate without such
an axis is replaced by the coordinate that a CoordinateCouplerConstraint gives it by a linear function.

Source: OpenSim's documentation of its classes, and files that it wrote (versions 20303, 30000 and 40000 to 40600).
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.expressions import Expression, Name, Number, Operation, parse, substitute, write
from mbsgen.importing.choices import Choices, FileCoordinate, Imported
from mbsgen.importing.closing import Closure, Curve, Equation, Spot, Term, X
from mbsgen.importing.drafting import Draft, Move, list_moves, move_freely
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.contacts import CONTACTS, Touch, Touching
from mbsgen.importing.osim.forces import READ, Forces, is_on
from mbsgen.importing.osim.frames import GROUND, Frames, Mount, invert
from mbsgen.importing.osim.functions import Sum, read_function, write_number, write_shift
from mbsgen.importing.osim.joints import (
    JOINTS,
    SLIDE,
    TURN,
    Axis,
    count_coordinates,
    is_angle,
    list_axes,
    list_coordinates,
)
from mbsgen.importing.osim.muscles import MUSCLES, PAIRS, PATHS, SHAPES, Line, Paths, Point, Surface
from mbsgen.importing.osim.pushes import PUSHES, Push, Pushes, turn_triple
from mbsgen.importing.osim.vocabulary import VOCABULARY
from mbsgen.importing.poses import ORIGIN, Pose, write_axis, write_triple
from mbsgen.importing.solids import NOTHING, Solid
from mbsgen.importing.vocabulary import survey
from mbsgen.model.model import BASE, Contact, LoopEnd, PathPoint, Plane, Presence, Sphere, Wrap, Wrench
from mbsgen.model.model import ORIGIN as MODEL_ORIGIN
from mbsgen.model.tree import Cut

LOOSE = ("components", "ComponentSet")  # parts of a model for all kinds of components
GRAVITY = (0.0, -9.80665, 0.0)  # the default of OpenSim
OLDEST, NEWER, NEWEST = 20303, 30500, 40000  # between the last two, files of versions that were never released
FULL_TURNS = 4 * math.pi  # rad: a range beyond this is probably in degrees
ROUNDING = 1e-12  # of the components of a normal
BOUNDLESS = 9999.0  # rad or m: the size of bounds that stand for none
_CUTS = {
    "WeldJoint": (Cut.SOLID, None, None),
    "PinJoint": (Cut.HINGE, 2, None),
    "SliderJoint": (Cut.PRISMATIC, 0, None),
    "UniversalJoint": (Cut.UNIVERSAL, 0, 1),
    "GimbalJoint": (Cut.BALL, None, None),
    "BallJoint": (Cut.BALL, None, None),
    "PlanarJoint": (Cut.PLANAR, 2, None),
}
_CONSTRAINTS = {"WeldConstraint": Cut.SOLID, "PointConstraint": Cut.BALL}
_METRES, _NEWTONS = ("meters", "meter", "metres", "m", ""), ("N", "newtons", "newton", "")


def read_osim(root: Element, choices: Choices, findings: Findings) -> Imported:
    """Make a model of an OpenSim file. Raises InputError with all its faults."""
    given = root.attributes.get("Version", "")
    version = int(given) if given.isdecimal() and len(given) < 7 else 0
    model = root.first("Model")
    if version < OLDEST or NEWER <= version < NEWEST:
        finding = f"its version is {abbreviate(given)}" if given else "an <OpenSimDocument> without a version"
        findings.fault(root, finding, "open it in OpenSim 4, and save it")
    elif model is None:
        tag = root.children[0].tag if root.children else ""
        finding = f"it holds <{tag[:40]}>, and no <Model>" if tag else "no <Model>"
        findings.fault(root, finding, "give the file of a model")
    if findings.faults or model is None:
        raise findings.refuse()
    return _File(root, model, choices, findings, is_nested=version < NEWEST).read()


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint of the file, and its frames."""

    name: str
    element: Element
    parent: Mount
    child: Mount
    coordinates: tuple[str, ...]
    is_turned_back: bool  # its functions place the parent in the child

    @property
    def ends(self) -> tuple[str, str]:
        return self.parent.body, self.child.body


@dataclass(frozen=True)
class _Leader:
    """The axis whose motion is a coordinate."""

    axis: Axis
    slope: float

    @property
    def size(self) -> float:
        """Return the coordinate of the model in terms of the coordinate of the file."""
        return abs(self.slope)


class _File:
    """A file during reading."""

    def __init__(self, root: Element, model: Element, choices: Choices, findings: Findings, *, is_nested: bool) -> None:
        self._root = root
        self._model = model
        self._choices = choices
        self._findings = findings
        self._is_nested = is_nested  # joints stand in the bodies that they carry
        self._frames = Frames(model, findings)
        self._coordinates: dict[str, Element] = {}
        self._axes: dict[str, list[Axis]] = {}  # by joint; their amounts over coordinates that are not held
        self._angles: set[str] = set()  # coordinates
        self._ranges: dict[str, tuple[float | None, float | None]] = {}  # of coordinates
        self._leaders: dict[str, _Leader] = {}  # by coordinate
        self._replaced: dict[str, tuple[str, float, float]] = {}  # coordinates by others, ratios and offsets
        self._held: dict[str, float] = {}
        self._forces = Forces(findings)
        self._lines: list[Line] = []  # muscles and springs along paths
        self._pushes: list[Push] = []
        self._own: dict[str, str] = {GROUND: BASE}  # bodies of the model, by name in the file
        self._inner: dict[str, Pose] = {GROUND: ORIGIN}  # poses of the file's frames of bodies in the model's
        self._roots: dict[str, str] = {BASE: BASE}  # bodies of the model that do not move relative to others, by these

    def read(self) -> Imported:
        """Read the file, and complete the model."""
        self._tell_rest()
        if not self._frames.bodies:
            self._findings.fault(self._model, "no body", "give a model with bodies")
        joints = [*self._read_joints()]
        for element in self._list("ForceSet"):
            if element.tag in READ:
                self._forces.read(element, self._coordinates)
        paths = Paths(
            self._frames,
            self._findings,
            self._coordinates,
            self._ranges,
            self._is_nested,
            self._choices.rigid_tendons,
            self._choices.degroote,
            self._frames.surfaces,
        )
        found = [paths.read(x) for x in self._list("ForceSet") if x.tag in PATHS]
        found += [paths.read_pair(x) for x in self._list("ForceSet") if x.tag in PAIRS]
        self._lines = [line for line in found if line is not None]
        pushing = Pushes(self._frames, self._findings, self._find_end)
        self._pushes = [each for x in self._list("ForceSet") if x.tag in PUSHES for each in pushing.read(x)]
        touching = Touching(self._model, self._frames, self._findings)
        touches = [each for x in self._list("ForceSet") if x.tag in CONTACTS for each in touching.read(x)]
        couplers = [x for x in self._list("ConstraintSet") if x.tag == "CoordinateCouplerConstraint" and self._acts(x)]
        rules = {id(x): rule for x in couplers if (rule := self._read_coupler(x)) is not None}
        self._resolve(joints, [rules[id(x)] for x in couplers if id(x) in rules])
        self._solids = {name: self._read_solid(element) for name, element in self._frames.bodies.items()}
        markers = [(x, self._find_marker(x)) for x in self._list("MarkerSet") if x.tag == "Marker"]
        closures = [
            (x, self._find_end(x, 1), self._find_end(x, 2))
            for x in self._list("ConstraintSet")
            if x.tag in _CONSTRAINTS and self._acts(x)
        ]
        gravity = self._read_gravity()
        if self._findings.faults:
            raise self._findings.refuse()
        carriers = _choose_carriers(joints, self._frames.bodies)
        rest = self._set_aside(joints, carriers)
        locked = [(name, x * self._leaders[name].size) for name, x in self._held.items() if name in self._leaders]
        others = [pair for pair in self._choices.locked if pair[0] not in self._coordinates]
        self._draft = Draft(self._findings, replace(self._choices, locked=(*locked, *others), allow_unphysical=True))
        self._add_bodies(carriers)
        for joint in rest:
            self._close_by_joint(joint)
        for element in couplers:
            self._couple(element, *rules[id(element)])
        for element, first, second in closures:
            self._close(element, first, second)
        for marker, mount in markers:
            self._add_marker(marker, mount)
        for line in self._lines:
            self._add_line(line)
        for push in self._pushes:
            self._add_push(push)
        for touch in touches:
            self._add_contact(touch)
        self._tell_muscles()
        if self._findings.faults:
            raise self._findings.refuse()
        name = self._model.attributes.get("name", "").removesuffix(".osim")
        if not name and self._choices.name is None:
            self._findings.tell(self._model, 'it has no name: called "model" (--name)')
        imported = self._draft.finish(name or "model", gravity, self._root)
        balls = [joint.coordinates[:3] for joint in joints if joint.element.tag in ("BallJoint", "FreeJoint")]
        turns = tuple((a, b, c) for a, b, c in balls)
        return replace(imported, coordinates=tuple(self._list_coordinates()), balls=turns)

    def _list_coordinates(self) -> Iterator[FileCoordinate]:
        """Yield the coordinates of the file by the joints of the model; joints that close loops have none."""
        for name in self._coordinates:
            amount = self._replace(Sum(slopes={name: 1.0})).rescale(self._sizes)
            if not amount.coordinates:
                yield FileCoordinate(name, "", 0.0, amount.constant)
            elif amount.line is not None and amount.line[0] in self._leaders:
                other, slope = amount.line
                yield FileCoordinate(name, self._draft.find_joint(other), slope, amount.constant)

    def _read_gravity(self) -> tuple[float, ...]:
        child = self._model.first("gravity")
        if child is None:
            return GRAVITY
        return self._findings.numbers(child, "gravity", GRAVITY, attributes={"gravity": child.text})

    def _list(self, name: str) -> Iterator[Element]:
        """Yield the objects of a set of the model, and components of the model that may be in any set."""
        for holder in (name, *LOOSE):
            found = self._model.first(holder)
            objects = found if found is None or holder == "components" else found.first("objects")
            for each in () if objects is None else objects.children:
                if name != "JointSet" or holder == name or each.tag in JOINTS:
                    yield each

    def _acts(self, element: Element) -> bool:
        if not is_on(element):
            self._findings.tell(element, "it is switched off in the file: left out")
        return is_on(element)

    # --- joints and coordinates --------------------------------------------------------------------------------------

    def _list_joints(self) -> Iterator[tuple[Element, Element | None]]:
        """Yield joints, and the bodies that they stand in."""
        if not self._is_nested:
            yield from ((joint, None) for joint in self._list("JointSet"))
            return
        for body in self._list("BodySet"):
            holder = body.first("Joint")
            if body.tag == "Body" and holder is not None:
                yield from ((joint, body) for joint in holder.children)

    def _read_joints(self) -> Iterator[_Joint]:
        for element, body in self._list_joints():
            name = element.attributes.get("name", "")
            if element.tag not in JOINTS:
                remedy = f"give one of {', '.join(JOINTS)}; a CustomJoint can have any functions of coordinates"
                self._findings.fault(
                    element, f"a joint of the kind {abbreviate(element.tag)}, which is not read", remedy
                )
                continue
            if name in self._axes:
                name = next(x for k in itertools.count(2) if (x := f"{name}_{k}") not in self._axes)
            parent, child = self._find_ends(element, body)
            coordinates = self._read_coordinates(element, name)
            if parent is None or child is None or coordinates is None:
                continue
            if parent.body == child.body:
                self._findings.fault(element, f"both of its frames are on {abbreviate(child.body)}", "name two bodies")
                continue
            joint = _Joint(name, element, parent, child, coordinates, _read_flag(element, "reverse"))
            self._axes[name] = list_axes(element, coordinates, self._findings)
            yield joint

    def _find_ends(self, joint: Element, body: Element | None) -> tuple[Mount | None, Mount | None]:
        if body is None:
            parent, child = (
                self._frames.find(joint.first(f"socket_{end}_frame"), joint) for end in ("parent", "child")
            )
            return parent, child
        carrier = self._frames.find_body(joint.first("parent_body"), joint)
        outer = self._frames.read_pose(joint, "location_in_parent", "orientation_in_parent")
        own = Mount(body.attributes.get("name", ""), self._frames.read_pose(joint))
        return None if carrier is None else Mount(carrier.body, outer), own

    def _read_coordinates(self, joint: Element, name: str) -> tuple[str, ...] | None:
        """Read the coordinates of a joint; None where they are too many or too few."""
        elements, wanted = list_coordinates(joint), count_coordinates(joint)
        if wanted is not None and not elements:
            for k in range(wanted):
                self._coordinates.setdefault(f"{name}_coord_{k}", joint)
            return tuple(f"{name}_coord_{k}" for k in range(wanted))
        if wanted is not None and len(elements) != wanted:
            self._findings.fault(joint, f"a {joint.tag} of {len(elements)} coordinates", f"give {wanted}")
            return None
        for element in elements:
            own = element.attributes.get("name", "")
            if own in self._coordinates:
                text = f"a second coordinate {abbreviate(own)}: line {self._coordinates[own].line} has the first"
                self._findings.fault(element, text, "rename one")
            self._coordinates.setdefault(own, element)
            self._ranges[own] = self._read_range(element)
            if _read_flag(element, "prescribed"):
                text = "its prescribed function of time is left out, and it moves by forces (driven: in the model file)"
                self._findings.warn(element, text)
        return tuple(element.attributes.get("name", "") for element in elements)

    def _read_coupler(self, element: Element) -> tuple[str, Sum] | None:
        """Read the dependent coordinate of a coupling, and its value."""
        independent, dependent, scale, function = (
            element.first(tag)
            for tag in (
                "independent_coordinate_names",
                "dependent_coordinate_name",
                "scale_factor",
                "coupled_coordinates_function",
            )
        )
        names = [] if independent is None else independent.text.split()
        own = "" if dependent is None else dependent.text
        missing = [name for name in (*names, own) if name not in self._coordinates]
        for name in missing:
            meant = nearest(name, list(self._coordinates))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a coordinate of the file"
            self._findings.fault(element, f"there is no coordinate {abbreviate(name)}", remedy)
        inner = None if function is None or not function.children else function.children[0]
        if inner is None or not names:
            self._findings.fault(element, "a coupling of no function or no coordinates", "give both, or remove it")
            return None
        if own in names:
            self._findings.fault(element, f"{abbreviate(own)} depends on itself", "name another coordinate")
            return None
        if missing:
            return None
        amount = read_function(inner, names, self._findings)
        factor = 1.0 if scale is None else self._findings.number(scale, "scale", 1.0, {"scale": scale.text})
        return own, amount.scaled(factor)

    def _resolve(self, joints: Sequence[_Joint], rules: Sequence[tuple[str, Sum]]) -> None:
        """Put held and replaced coordinates into the amounts of axes, and choose the axis of each other coordinate."""
        chosen = dict(self._choices.locked)
        for name, element in self._coordinates.items():
            if name in chosen:
                self._held[name] = chosen[name]
            elif _read_flag(element, "locked"):
                self._held[name] = self._read_value(element)
        for joint in joints:
            self._angles |= {x for x in joint.coordinates if is_angle(x, self._axes[joint.name])}
            for coordinate in joint.coordinates:
                if coordinate not in self._held or self._find_leader(joint, coordinate):
                    self._lead(joint, coordinate, rules)
        for name, axes in self._axes.items():
            self._axes[name] = [replace(axis, amount=self._replace(axis.amount)) for axis in axes]

    def _find_leader(self, joint: _Joint, coordinate: str) -> _Leader | None:
        """Find the axis that moves by this coordinate alone, in proportion; rather by its own amount."""
        found = [
            _Leader(axis, line[1])
            for axis in self._axes[joint.name]
            if (line := axis.amount.line) is not None and line[0] == coordinate
        ]
        return min(found, key=lambda x: abs(math.log(x.size)), default=None)

    def _lead(self, joint: _Joint, coordinate: str, rules: Sequence[tuple[str, Sum]]) -> None:
        leader = self._find_leader(joint, coordinate)
        if leader is not None:
            self._leaders[coordinate] = leader
            if leader.size != 1 and coordinate not in self._held:
                text = f"the joint {abbreviate(coordinate)} has {leader.size:g} times the coordinate of the file"
                self._findings.tell(leader.axis.source, text)
            return
        for own, amount in rules:
            if own == coordinate and amount.line is not None:
                self._replaced[coordinate] = (*amount.line, amount.constant)
                return
        element = self._coordinates[coordinate]
        remedy = "give an axis of its joint a LinearFunction of it, or couple it to another coordinate by one"
        self._findings.fault(element, "no axis turns or slides in proportion to it alone", remedy)

    def _replace(self, amount: Sum) -> Sum:
        """Put values and other coordinates in the place of coordinates that are no joints."""
        for _ in range(len(self._replaced) + 1):
            amount = amount.hold(self._held)
            if not any(name in self._replaced for name in amount.coordinates):
                break
            constant, slopes = amount.constant, dict[str, float]()
            for name, slope in amount.slopes.items():
                other, ratio, offset = self._replaced.get(name, (name, 1.0, 0.0))
                slopes[other] = slopes.get(other, 0.0) + slope * ratio
                constant += slope * offset
            curves = []
            for name, curve in amount.curves:
                other, ratio, offset = self._replaced.get(name, (name, 1.0, 0.0))
                text = write_shift("x" if ratio == 1 else f"{write_number(ratio)}*x", -offset)
                curves.append((other, curve if text == "x" else substitute(curve, {X: parse(text)})))
            amount = Sum(constant, {name: x for name, x in slopes.items() if x}, tuple(curves))
        return amount

    def _read_value(self, coordinate: Element) -> float:
        child = coordinate.first("default_value")
        return 0.0 if child is None else self._findings.number(child, "value", 0.0, {"value": child.text})

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _set_aside(self, joints: Sequence[_Joint], carriers: Mapping[str, _Joint]) -> list[_Joint]:
        """Return the joints that close loops; their coordinates are no joints of the model."""
        used = {joint.name for joint in carriers.values()}
        rest = [joint for joint in joints if joint.name not in used]
        for name in (name for joint in rest for name in joint.coordinates):
            self._leaders.pop(name, None)
        return rest

    def _add_bodies(self, carriers: Mapping[str, _Joint]) -> None:
        """Add all bodies, each before the bodies that it carries."""
        carried: dict[str, list[str]] = {}
        for body in self._frames.bodies:
            joint = carriers.get(body)
            above = GROUND if joint is None else _find_other(joint, body)
            carried.setdefault(above, []).append(body)
        waiting = carried.get(GROUND, [])[::-1]
        while waiting:
            body = waiting.pop()
            self._add_body(body, carriers.get(body))
            waiting += carried.get(body, [])[::-1]

    def _add_body(self, body: str, joint: _Joint | None) -> None:
        element = self._frames.bodies[body]
        solid = self._solids[body]
        if joint is None:
            self._findings.tell(element, "no joint connects it: it moves freely, as in OpenSim")
            moves = move_freely(element, quaternion=self._choices.quaternions)
            self._own[body] = self._draft.add_body(body, BASE, ORIGIN, moves, solid, element)
            self._inner[body] = ORIGIN
            self._roots[self._own[body]] = self._own[body]
        else:
            self._carry(body, joint, solid)
        self._draft.add_frame(body, self._own[body], self._inner[body], element)

    def _carry(self, body: str, joint: _Joint, solid: Solid) -> None:
        """Add a body on the other one of a joint; its frame is the last frame of the joint that moves."""
        is_upright = joint.child.body == body
        near, far = (joint.parent, joint.child) if is_upright else (joint.child, joint.parent)
        if not is_upright:
            text = f"it carries its parent {abbreviate(body)} here: its child stands nearer to the ground"
            self._findings.tell(joint.element, text)
        axes = self._axes[joint.name]
        if is_upright == joint.is_turned_back:
            axes = [axis.turned_back() for axis in axes[::-1]]
        moves, rest = self._list_moves(joint, axes, near.body)
        pose = self._inner[near.body] @ near.pose
        inner = rest @ invert(far.pose)
        if not moves:
            pose, inner = pose @ inner, ORIGIN
        self._inner[body] = inner
        solid = solid.seen_from(inner)
        self._own[body] = self._draft.add_body(
            body, self._own[near.body], pose, moves, solid, self._frames.bodies[body]
        )
        self._roots[self._own[body]] = self._own[body] if moves else self._roots[self._own[near.body]]

    def _list_moves(self, joint: _Joint, axes: Sequence[Axis], near: str) -> tuple[list[Move], Pose]:
        """List the moves of a joint, and the pose of its last frame after them."""
        whole = {"BallJoint": "ball", "FreeJoint": "free"}.get(joint.element.tag)
        if self._choices.quaternions and whole is not None and self._is_plain(joint, near):
            text = f"its coordinates {', '.join(joint.coordinates)} are a quaternion here"
            self._findings.tell(joint.element, text if whole == "ball" else f"{text}, and a position")
            return list_moves(whole, joint.element, actuated=False), ORIGIN
        own = [name for name in joint.coordinates if name in self._leaders]
        slides = sum(self._leaders[name].axis.motion is SLIDE for name in own)
        is_base = near == GROUND and slides > 1
        moves, pending = list[Move](), ORIGIN
        for axis in axes:
            line = axis.amount.line
            leads = [x for x in own if self._leaders[x].axis.name == axis.name]
            if leads:
                move = self._make_leader(axis, leads[0], is_base=is_base)
            elif not axis.amount.coordinates:
                pending = pending @ axis.at(axis.amount.constant)
                continue
            else:
                move = self._make_follower(joint, axis, line)
            moves.append(replace(move, pose=pending @ move.pose))
            pending = ORIGIN
        return moves, pending

    def _is_plain(self, joint: _Joint, near: str) -> bool:
        """Return whether nothing in the file concerns single coordinates of a joint of several."""
        forces = self._forces
        named = {*self._held, *self._replaced, *forces.springs, *forces.limits, *forces.formulas, *forces.efforts}
        coupled = {name for x in self._list("ConstraintSet") for each in x.children for name in each.text.split()}
        is_possible = joint.element.tag == "BallJoint" or near == GROUND
        return is_possible and not (named | coupled).intersection(joint.coordinates)

    def _make_leader(self, axis: Axis, coordinate: str, *, is_base: bool) -> Move:
        """Make the joint of a coordinate."""
        leader, element = self._leaders[coordinate], self._coordinates[coordinate]
        original = leader.axis
        constant = original.amount.constant
        efforts, size = self._forces.efforts, leader.size
        lower, upper = self._ranges.get(coordinate, (None, None))
        if axis.motion is TURN and max(abs(lower or 0.0), abs(upper or 0.0)) > FULL_TURNS:
            self._findings.tell(element, "its range is in rad, as OpenSim takes it; is it meant in degrees?")
        effort = self._forces.find_effort(coordinate)
        return Move(
            axis.motion,
            axis.direction if leader.slope > 0 else -axis.direction,
            element,
            name=coordinate,
            pose=axis.at(constant),
            actuated=coordinate in efforts if efforts or self._is_driven else not is_base,
            lower=None if lower is None else lower * size,
            upper=None if upper is None else upper * size,
            law=self._forces.make_law(coordinate, size, in_degrees=coordinate in self._angles),
            effort=None if effort is None else effort / size,
            start=self._read_value(element) * size if element.tag == "Coordinate" else 0.0,
        )

    def _make_follower(self, joint: _Joint, axis: Axis, line: tuple[str, float] | None) -> Move:
        """Make the joint of an axis whose motion coordinates of other axes give."""
        name = f"{joint.name}_{axis.name}"
        sizes = {key: leader.size for key, leader in self._leaders.items()}
        if lost := [key for key in axis.amount.coordinates if key not in sizes]:
            text = f"{abbreviate(lost[0])} is the coordinate of a joint that closes a loop"
            self._findings.fault(axis.source, text, "let another joint close the loop")
            return Move(axis.motion, axis.direction, axis.source, name=name)
        amount = axis.amount.rescale(sizes)
        defaults = {
            key: self._read_value(element) * sizes[key] for key, element in self._coordinates.items() if key in sizes
        }
        move = Move(
            axis.motion, axis.direction, axis.source, name=name, actuated=False, start=amount.hold(defaults).constant
        )
        if line is not None:
            slope = amount.slopes[line[0]]
            offset = f" + {amount.constant:g}" if amount.constant else ""
            self._findings.tell(axis.source, f"no coordinate: it moves by {slope:g} {abbreviate(line[0])}{offset}")
            return replace(move, follows=(line[0], slope, amount.constant))
        self._draft.closing.dependent.add(name)
        self._draft.closing.equations.append(_equate(name, amount, axis.source, f"{name}_of_{amount.coordinates[0]}"))
        return move

    def _read_range(self, coordinate: Element) -> tuple[float | None, float | None]:
        child = coordinate.first("range")
        if child is None:
            return None, None
        words = child.text.split()
        if len(words) != 2:
            self._findings.fault(child, f"a range of {len(words)} numbers", "give the lower and the upper bound")
            return None, None
        lower, upper = (self._findings.bound(child, "range", {"range": word}) for word in words)
        if lower is not None and upper is not None and lower > upper:
            self._findings.fault(child, f"a range from {lower:g} to {upper:g}", "swap them")
        if lower is not None and lower == upper:
            self._findings.tell(child, f"a range from {lower:g} to {lower:g} is taken as none")
            return None, None
        lower, upper = (None if x is None or abs(x) >= BOUNDLESS else x for x in (lower, upper))
        return lower, upper

    def _read_solid(self, body: Element) -> Solid:
        mass = body.first("mass")
        inertia = body.first("inertia")
        if inertia is not None:
            zeros = (0.0,) * 6
            moments = self._findings.numbers(inertia, "inertia", zeros, attributes={"inertia": inertia.text})
        else:
            moments = tuple(self._read_number(body, f"inertia_{axes}") for axes in ("xx", "yy", "zz", "xy", "xz", "yz"))
        xx, yy, zz, xy, xz, yz = moments
        com = np.array(self._frames.read_vector(body, "mass_center"))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        weight = 0.0 if mass is None else self._findings.number(mass, "mass", 0.0, {"mass": mass.text})
        return Solid(weight, com, tensor) if weight or tensor.any() else NOTHING

    def _read_number(self, element: Element, tag: str) -> float:
        child = element.first(tag)
        return 0.0 if child is None else self._findings.number(child, tag, 0.0, {tag: child.text})

    def _find_marker(self, marker: Element) -> Mount | None:
        frame, body = (marker.first(tag) for tag in ("socket_parent_frame", "body"))
        if frame is None and body is not None:
            return self._frames.find_body(body, marker)
        return self._frames.find(frame, marker)

    def _add_marker(self, marker: Element, mount: Mount | None) -> None:
        assert mount is not None, "faults have been raised"
        at = Pose(np.eye(3), np.array(self._frames.read_vector(marker, "location")), ())
        pose = self._inner[mount.body] @ mount.pose @ at
        self._draft.add_frame(marker.attributes.get("name", ""), self._own[mount.body], pose, marker)

    # --- muscles and springs along paths -----------------------------------------------------------------------------

    def _add_line(self, line: Line) -> None:
        kept = [self._make_point(line, x) for x in line.points]
        path = [point for point in kept if point is not None]
        numbers = [k for k, x in enumerate(kept, 1) if x is not None]  # of the points that are left
        wraps = [wrap for x in line.wraps if (wrap := self._make_wrap(x, numbers)) is not None]
        self._draft.add_force(line.name, path, line.force, line.muscle, wraps, line.signals, line.element)

    def _make_wrap(self, surface: Surface, numbers: Sequence[int]) -> Wrap | None:
        """Make a surface of the model between points of which some are left; None where too few are."""
        inside = [k for k, number in enumerate(numbers, 1) if surface.between[0] <= number <= surface.between[1]]
        if len(inside) < 2:
            return None
        here = self._inner[surface.mount.body] @ surface.mount.pose
        return Wrap(
            tuple(map(Number, surface.size)),
            self._own[surface.mount.body],
            self._draft.writer.placement(here),
            surface.kind,
            None if surface.length is None else Number(surface.length),
            surface.side,
            None if len(inside) == len(numbers) else (inside[0], inside[-1]),
            surface.method if surface.kind == "ellipsoid" else "hybrid",
        )

    def _make_point(self, line: Line, point: Point) -> PathPoint | None:
        """Make a point of the model; None for one that the path never passes."""
        here = self._inner[point.mount.body] @ point.mount.pose
        body = self._own[point.mount.body]
        shift, presence = MODEL_ORIGIN, None
        if point.shift:
            x, y, z = (self._write_amount(line, amount) for amount in point.shift)
            shift = (x, y, z)
        else:
            here = here @ Pose(np.eye(3), np.array(point.location), ())
            here = Pose(np.eye(3), here.position, ())
        if point.presence is not None:
            name, lower, upper = point.presence
            amount = self._replace(Sum(slopes={name: 1.0})).rescale(self._sizes)
            if amount.line is None:
                if not lower <= amount.constant <= upper:
                    return None
            else:
                other, slope = amount.line
                bounds = sorted((bound - amount.constant) / slope for bound in (lower, upper))
                presence = Presence(self._name_coordinate(line, other), *map(Number, bounds))
        return PathPoint(body, self._draft.writer.placement(here), shift, presence)

    def _write_amount(self, line: Line, amount: Sum) -> Expression:
        """Write an amount over coordinates of the model."""
        amount = self._replace(amount).rescale(self._sizes)
        total: Expression = Number(amount.constant)
        for name, slope in amount.slopes.items():
            total = Operation("+", total, Operation("*", Number(slope), Name(self._name_coordinate(line, name))))
        for name, curve in amount.curves:
            own = {X: Name(self._name_coordinate(line, name))}
            total = Operation("+", total, substitute(curve, own))
        return parse(write(total))

    def _name_coordinate(self, line: Line, coordinate: str) -> str:
        """Return the name of a coordinate in forces; a fault where it is no joint."""
        if coordinate not in self._leaders:
            self._findings.fault(
                line.element, f"{abbreviate(coordinate)} is the coordinate of no joint here", "remove it"
            )
            return "q_"
        return f"q_{re.sub(r'[^A-Za-z0-9_]', '_', self._draft.find_joint(coordinate))}"

    @property
    def _is_driven(self) -> bool:
        """Return whether muscles or other actuators along paths move the model."""
        return any(line.signals for line in self._lines) or any(push.signals for push in self._pushes)

    def _add_push(self, push: Push) -> None:
        """Add a wrench at a frame, or between two."""
        here = self._inner[push.mount.body] @ push.mount.pose
        at = self._draft.writer.placement(here)
        force, moment, against = push.force, push.moment, None
        if push.against is not None:
            there = self._inner[push.against.body] @ push.against.pose
            against = LoopEnd(self._own[push.against.body], self._draft.writer.placement(there))
        elif not push.in_base:
            force, moment = (turn_triple(here.rotation, x) for x in (force, moment))
        wrench = Wrench(
            push.name,
            self._own[push.mount.body],
            at.position,
            push.in_base or against is not None,
            force,
            moment,
            at.orientation if against is not None else (),
            against,
            push.by_turns,
        )
        self._draft.add_wrench(wrench, push.signals, push.element)

    # --- contacts ----------------------------------------------------------------------------------------------------

    def _add_contact(self, touch: Touch) -> None:
        ball, other = touch.sphere.mount, touch.other.mount
        bodies = [self._own[x.body] for x in (ball, other)]
        if self._roots[bodies[0]] == self._roots[bodies[1]]:
            self._findings.tell(touch.element, f"{abbreviate(touch.name)} is between bodies that do not move: left out")
            return
        writer = self._draft.writer
        first, second = (self._inner[x.body] @ x.pose for x in (ball, other))
        assert touch.sphere.radius is not None, "the first side is a sphere"
        centre = write_triple(second.position)
        if touch.other.radius is None:
            normal = np.where(np.abs(second.rotation[:, 0]) < ROUNDING, 0.0, -second.rotation[:, 0])
            side: Plane | Sphere = Plane(bodies[1], centre, write_axis(normal))
        else:
            side = Sphere(Number(touch.other.radius), bodies[1], centre)
        contact = Contact(
            name=touch.name,
            body=bodies[0],
            stiffness=Number(touch.stiffness),
            placement=writer.placement(Pose(np.eye(3), first.position, ())),
            radius=Number(touch.sphere.radius),
            other=side,
            dissipation=Number(touch.dissipation),
            friction=touch.friction,
            law=touch.law,
        )
        self._draft.add_contact(contact, touch.element)

    @property
    def _sizes(self) -> dict[str, float]:
        return {name: leader.size for name, leader in self._leaders.items()}

    def _tell_muscles(self) -> None:
        """Add what is different of muscles of other kinds."""
        kinds = Counter(line.element.tag for line in self._lines if line.muscle is not None)
        if kinds:
            self._findings.sum_up(
                "the activation of a muscle is the signal of its name, and the state of an elastic tendon the signal "
                "NAME_tendon: its force over the strength, or, with Millard's and Thelen's curves, its strain over the "
                "strain at the strength"
            )
        for tag, count in kinds.items():
            if tag != MUSCLES[0] and (tag not in SHAPES or self._choices.degroote):
                text = f"{count} of the kind {tag} have the curves of {MUSCLES[0]}, with the numbers that Moco gives it"
                self._findings.sum_up(text, alters=True)

    # --- loops and couplings -----------------------------------------------------------------------------------------

    def _attach(self, mount: Mount) -> Spot:
        return Spot(self._own[mount.body], self._inner[mount.body] @ mount.pose)

    def _close_by_joint(self, joint: _Joint) -> None:
        """Close a loop by a joint between two bodies that other joints carry."""
        kind = joint.element.tag
        if kind == "FreeJoint":
            self._findings.tell(joint.element, "other joints carry both of its bodies: it is left out")
            return
        if kind not in _CUTS:
            remedy = f"let another joint close it, one of {', '.join(_CUTS)}"
            self._findings.fault(joint.element, f"a {kind} that closes a loop", remedy)
            return
        cut, axis, axis2 = _CUTS[kind]
        first, second = self._attach(joint.parent), self._attach(joint.child)
        one, other = (None if k is None else np.eye(3)[k] for k in (axis, axis2))
        self._draft.closing.closures.append(Closure(joint.name, cut, first, second, joint.element, one, other))
        self._findings.tell(joint.element, "it closes a loop: it has no coordinate")
        for name in joint.coordinates:
            for element in self._forces.list_passive(name):
                self._findings.warn(element, "it acts on a joint that closes a loop, and is left out")

    def _couple(self, element: Element, own: str, amount: Sum) -> None:
        """Couple a coordinate to another one, or add the equation of several."""
        if own in self._replaced:
            other = self._replaced[own][0]
            self._findings.tell(element, f"coordinate {abbreviate(own)} is replaced by {abbreviate(other)}")
            return
        amount = self._replace(amount)
        for name in (own, *amount.coordinates):
            if name == own and own in self._held and own not in self._leaders:
                remedy = "hold the coordinates that it depends on instead"
                self._findings.fault(element, f"{abbreviate(own)} is held, and is no joint here", remedy)
                return
            if name not in self._leaders:
                self._findings.fault(element, f"{abbreviate(name)} is the coordinate of no joint here", "remove it")
                return
        sizes = {name: leader.size for name, leader in self._leaders.items()}
        amount = amount.rescale(sizes).scaled(sizes[own])
        line = amount.line
        if line is not None and own not in self._held and self._draft.closing.couple(own, (*line, amount.constant)):
            offset = f" + {amount.constant:g}" if amount.constant else ""
            text = f"coordinate {abbreviate(own)} follows: it is {line[1]:g} {abbreviate(line[0])}{offset}"
            self._findings.tell(element, text)
            return
        self._draft.closing.dependent.add(own)
        name = element.attributes.get("name", "") or f"{own}_coupled"
        self._draft.closing.equations.append(_equate(own, amount, element, name))

    def _close(self, element: Element, first: Mount | None, second: Mount | None) -> None:
        """Close a loop by a constraint."""
        assert first is not None, "faults have been raised"
        assert second is not None, "faults have been raised"
        name = element.attributes.get("name", "") or element.tag
        cut = _CONSTRAINTS[element.tag]
        self._draft.closing.closures.append(Closure(name, cut, self._attach(first), self._attach(second), element))

    def _find_end(self, element: Element, k: int) -> Mount | None:
        socket = element.first(f"socket_frame{k}") or element.first(f"socket_body_{k}")
        if self._is_nested:
            mount = self._frames.find_body(element.first(f"body_{k}"), element)
        else:
            mount = self._frames.find(socket, element)
        if mount is None:
            return None
        own = self._frames.read_pose(element, f"location_body_{k}", f"orientation_body_{k}")
        return Mount(mount.body, mount.pose @ own)

    # --- the rest ----------------------------------------------------------------------------------------------------

    def _tell_rest(self) -> None:
        """Add the warnings of all elements that act on motions and are not read, and one line of all others."""
        found = survey(self._root, VOCABULARY, "OpenSimDocument", self._findings)
        for tag, known in (("length_units", _METRES), ("force_units", _NEWTONS)):
            unit = self._model.first(tag)
            if unit is not None and unit.text not in known:
                text = f"{tag} is {abbreviate(unit.text)}: numbers are taken as {known[0]}, as OpenSim takes them"
                self._findings.tell(unit, text)
        if found.idle:
            shown = ", ".join(f"{count} {tag[:40]}" for tag, count in sorted(found.idle.items()))
            self._findings.sum_up(f"of no meaning for the dynamics: {shown}")


def _equate(own: str, amount: Sum, source: Element, name: str) -> Equation:
    """Return the equation by which a joint moves by an amount."""
    terms: list[Term | Curve] = [Term(own, 1.0)]
    terms += [Term(other, -slope) for other, slope in amount.slopes.items()]
    terms += [Curve(other, -1.0, curve) for other, curve in amount.curves]
    return Equation(name, tuple(terms), -amount.constant, source)


def _choose_carriers(joints: Sequence[_Joint], bodies: Mapping[str, Element]) -> dict[str, _Joint]:
    """Return the joint that carries each body: the first in the file that reaches it from the ground."""
    carriers: dict[str, _Joint] = {}
    reached = {GROUND}
    waiting = list(bodies)
    while True:
        for joint in joints:
            parent, child = joint.ends
            if parent in reached and child not in reached:
                carriers[child] = joint
                reached.add(child)
                break
        else:
            back = next((x for x in joints if x.ends[1] in reached and x.ends[0] not in reached), None)
            if back is not None:
                carriers[back.ends[0]] = back
                reached.add(back.ends[0])
                continue
            children = {x.ends[1] for x in joints}
            alone = [body for body in waiting if body not in reached]
            if not alone:
                return carriers
            reached.add(next((body for body in alone if body not in children), alone[0]))


def _find_other(joint: _Joint, body: str) -> str:
    parent, child = joint.ends
    return parent if body == child else child


def _read_flag(parent: Element, tag: str) -> bool:
    child = parent.first(tag)
    return child is not None and child.text.lower() in ("true", "1")
