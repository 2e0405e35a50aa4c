"""MJCF, the format of MuJoCo -> Draft of a model: one body a body, its frame at its last joint's anchor.

Coordinates of hinges and slides agree with the file (`qpos`). A ball is three turns about z, y, x; a free body slides
along the axes of the world and then turns about z, y, x, all 0 where its frame is the world's; or each has a
quaternion. An angle is in degrees unless the compiler section says otherwise.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.closing import Spot
from mbsgen.importing.drafting import GRAVITY, Choices, Draft, Imported, Move, list_moves, make_law, move_freely
from mbsgen.importing.equalities import Coordinate, Place, Register, add_equalities, list_sites
from mbsgen.importing.findings import Findings
from mbsgen.importing.geometry import SHAPES, SIZES, SPANNED, WEIGHTLESS, make_solid
from mbsgen.importing.geoms import (
    LAST_GROUP,
    MOST,
    UndrawnError,
    make_visual,
    read_assets,
    read_color,
    scale_shape,
)
from mbsgen.importing.inheritance import MAIN, Defaults, include_files
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Array, Pose, place
from mbsgen.importing.solids import NOTHING, Solid, add
from mbsgen.model.model import BASE, Visual
from mbsgen.model.orientations import find_turns, turn, turn_quaternion
from mbsgen.model.tree import Motion

DENSITY = 1000.0  # of water, MuJoCo's default [kg/m3]
TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
JOINTS = ("joint", "freejoint")
KINDS = ("hinge", "slide", "ball", "free")
COPIES = ("composite", "flexcomp", "replicate", "attach", "plugin")  # elements that make bodies from other text
ALTERING = ("tendon", "deformable", "extension")  # sections that act on bodies
MARKS = frozenset(  # elements without mass and force, or read elsewhere
    ["inertial", "joint", "freejoint", "geom", "site", "body", "frame", "camera", "light"]
)


def read_mjcf(root: Element, choices: Choices, findings: Findings) -> Imported:
    """Make a model of an MJCF file. Raises InputError with all its faults."""
    return _Scene(include_files(root, findings), choices, findings).read()


@dataclass(frozen=True)
class _Compiler:
    """The settings for the numbers of a file."""

    degrees: bool = True
    sequence: str = "xyz"
    from_geometry: str = "auto"
    groups: tuple[float, ...] = (0, 5)
    autolimits: bool = True


@dataclass(frozen=True, eq=False)
class _Placed:
    """A child of a body, with its surrounding frames resolved."""

    element: Element
    around: Pose  # of those frames, in the body
    active: str  # default class


_Waiting = tuple[Element, Place, Pose, str]  # a body, its carrier, frames between them, default class


class _Scene:
    """An MJCF file during reading."""

    def __init__(self, root: Element, choices: Choices, findings: Findings) -> None:
        self._root = root
        self._choices = choices
        self._findings = findings
        self._draft = Draft(findings, choices)
        self._defaults = Defaults(root, findings)
        self._settings = {k: v for element in root.all("compiler") for k, v in element.attributes.items()}
        self._compiler = self._read_compiler()
        self._rotors: defaultdict[str, float] = defaultdict(float)  # rotor inertia at joints, from actuators
        self._driven = self._read_actuators()
        self._scale = 1.0
        self._skipped: Counter[str] = Counter()
        self._register = Register()
        self._used_sites = {*choices.sensors, *list_sites(root)}
        self._assets = read_assets(root, self._settings, self._defaults, Findings(root.file))
        self._touching = 0  # number of geoms of bodies that may have contacts

    def read(self) -> Imported:
        """Read the file, and complete the model."""
        worlds = [*self._root.all("worldbody")]
        if not worlds:
            self._findings.fault(self._root, "there is no <worldbody>", "give it one, with the bodies in it")
        gravity = self._read_gravity()
        self._scale = self._find_scale(worlds)
        for world in worlds:
            self._add_bodies(world)
        self._check_actuators()
        add_equalities(self._root, self._register, self._draft, self._defaults, self._findings)
        self._tell_sections()
        return self._draft.finish(self._root.attributes.get("model", "scene"), gravity, self._root)

    # --- settings ----------------------------------------------------------------------------------------------------

    def _read_compiler(self) -> _Compiler:
        settings = self._settings
        source = next(self._root.all("compiler"), self._root)
        if settings.get("coordinate", "local") != "local":
            self._findings.fault(source, "global coordinates", "save the file by a MuJoCo before 2.3.3, as local ones")
        for key in ("boundmass", "boundinertia"):
            if self._findings.number(source, key, 0.0, settings) > 0:
                self._findings.warn(source, f"{key}: masses and inertias are taken as they are in the file")
        if settings.get("balanceinertia") == "true":
            self._findings.warn(source, "balanceinertia: inertias are taken as they are in the file")
        sequence = settings.get("eulerseq", "xyz")
        if len(sequence) != 3 or not set(sequence) <= set("xyzXYZ"):
            self._findings.fault(source, f"eulerseq is {abbreviate(sequence)}", "give three of x, y, z, X, Y, Z")
            sequence = "xyz"
        return _Compiler(
            self._findings.choice(source, "angle", ("degree", "radian"), settings) == "degree",
            sequence,
            self._findings.choice(source, "inertiafromgeom", ("auto", "true", "false"), settings),
            self._findings.numbers(source, "inertiagrouprange", (0.0, 5.0), attributes=settings),
            settings.get("autolimits", "true") != "false",
        )

    def _read_gravity(self) -> tuple[float, ...]:
        gravity: tuple[float, ...] = GRAVITY
        for option in self._root.all("option"):
            gravity = self._findings.numbers(option, "gravity", gravity)
            for key in ("density", "viscosity", "wind"):
                if any(self._findings.numbers(option, key, (0.0,) * (3 if key == "wind" else 1))):
                    self._findings.warn(option, f"{key}: the forces of a fluid are not part of a model")
            if any(flag.attributes.get("gravity") == "disable" for flag in option.all("flag")):
                gravity = (0.0, 0.0, 0.0)
        return gravity

    def _read_actuators(self) -> dict[str, float | None]:
        """Return the driven joints, with the greatest force if given; other actuators make notices."""
        driven: dict[str, float | None] = {}
        for section in self._root.all("actuator"):
            for element in section.children:
                attributes = self._defaults.resolve(element, MAIN)
                joint = attributes.get("joint", attributes.get("jointinparent"))
                if joint is None:
                    self._findings.warn(element, f"{element.tag}: only actuators of joints become inputs")
                    continue
                gear = self._findings.number(element, "gear", 1.0, _take_first(attributes, "gear"))
                what = "the joint's force" if gear == 1 else f"the joint's force, after the gear {gear:g}"
                if element.tag == "motor" and gear != 1:
                    self._findings.tell(element, f"the input u of joint {abbreviate(joint)} is {what}")
                elif element.tag != "motor":
                    text = f"{element.tag} of joint {abbreviate(joint)}: gains and dynamics are left out"
                    self._findings.warn(element, f"{text}; the input u is {what}")
                self._rotors[joint] += gear**2 * self._findings.number(element, "armature", 0.0, attributes)
                driven[joint] = self._find_effort(element, attributes, abs(gear))
        return driven

    def _check_actuators(self) -> None:
        """Report actuators of unknown joints."""
        there = [j.attributes["name"] for j in self._root.walk() if j.tag in JOINTS and "name" in j.attributes]
        for section in self._root.all("actuator"):
            for element in section.children:
                attributes = self._defaults.resolve(element, MAIN)
                joint = attributes.get("joint", attributes.get("jointinparent"))
                if joint is not None and joint not in there:
                    meant = nearest(joint, there)
                    remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a joint of the file"
                    self._findings.fault(element, f"there is no joint {abbreviate(joint)}", remedy)

    def _find_effort(self, element: Element, attributes: Mapping[str, str], gear: float) -> float | None:
        ranges = [
            max(map(abs, self._findings.numbers(element, key, (0.0, 0.0), attributes=attributes)))
            for key in (["forcerange", "ctrlrange"] if element.tag == "motor" else ["forcerange"])
            if key in attributes
        ]
        return min(ranges) * gear if ranges and min(ranges) > 0 else None

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _add_bodies(self, world: Element) -> None:
        base = world.attributes.get("childclass", MAIN)
        waiting: list[_Waiting] = []
        self._add_children(world, Place(Spot(BASE, ORIGIN), ORIGIN), self._defaults.check(world, base), waiting)
        while waiting:
            body, carrier, around, active = waiting.pop()
            active = self._defaults.check(body, body.attributes.get("childclass", active))
            parent, step = carrier.spot.body, self._read_pose(body, body.attributes)
            pose = carrier.spot.pose @ around @ step
            parts = [*self._unframe(body, ORIGIN, active)]
            moves, anchor = self._read_moves(body, parts, pose)
            solid = self._read_solid(body, parts).scaled(self._scale).shifted(anchor)
            name = body.attributes.get("name", "")
            first = ORIGIN if self._is_free(parts) else pose
            own = self._draft.add_body(name or "body", parent, first, moves, solid, body)
            self._warn_body(body)
            inner = Pose(np.eye(3), -anchor, ())
            self._draft.show(own, self._read_visuals(parts, inner))
            found = Place(Spot(own, inner), carrier.home @ around @ step)
            if name:
                self._draft.add_frame(name, own, inner, body)
                self._register.bodies.setdefault(name, found)
            self._add_children(body, found, active, waiting)

    def _add_children(self, body: Element, carrier: Place, active: str, waiting: list[_Waiting]) -> None:
        """Queue the bodies of a body, and add its sites."""
        own, inner = carrier.spot.body, carrier.spot.pose
        found: list[_Waiting] = []
        for part in self._unframe(body, ORIGIN, active):
            element = part.element
            if element.tag == "body":
                found.append((element, carrier, part.around, part.active))
            elif element.tag == "site":
                attributes = self._defaults.resolve(element, part.active)
                if attributes.get("name") in self._used_sites:
                    spot = Spot(own, inner @ part.around @ self._read_pose(element, attributes))
                    self._register.sites[attributes["name"]] = spot
                    if attributes["name"] in self._choices.sensors:
                        self._draft.add_frame(attributes["name"], own, spot.pose, element)
                self._skipped["site"] += 1
            elif element.tag in COPIES:
                remedy = "save the compiled model (mujoco.mj_saveLastXML), and import that"
                self._findings.fault(element, f"{element.tag} makes bodies by its own rules", remedy)
            elif element.tag not in MARKS:
                self._findings.fault(element, f"no part of a body is called {element.tag[:40]}", "take it out")
            elif element.tag in ("geom", "camera", "light"):
                self._skipped[element.tag] += 1
                if body.tag == "worldbody" and self._defaults.resolve(element, part.active).get("type") != "plane":
                    self._findings.omit(element, "this geom is not drawn: it belongs to the world")
                self._touching += element.tag == "geom" and body.tag != "worldbody" and self._touches(part)
        waiting += found[::-1]

    def _touches(self, part: _Placed) -> bool:
        """Return whether a geom may have contacts: it may, unless both its masks are 0."""
        attributes = self._defaults.resolve(part.element, part.active)
        return any(attributes.get(mask, "1").strip() != "0" for mask in ("contype", "conaffinity"))

    def _unframe(self, element: Element, around: Pose, active: str) -> Iterator[_Placed]:
        """Yield the children of a body, or of a <frame>, with all frames resolved."""
        for child in element.children:
            if child.tag == "frame":
                inner = self._defaults.check(child, child.attributes.get("childclass", active))
                yield from self._unframe(child, around @ self._read_pose(child, child.attributes), inner)
            else:
                yield _Placed(child, around, active)

    def _warn_body(self, body: Element) -> None:
        if self._findings.number(body, "gravcomp", 0.0):
            self._findings.warn(body, "gravcomp: no force that carries a body's weight is made")
        if body.attributes.get("mocap") == "true":
            self._findings.warn(body, "mocap: the body stands fast")

    # --- poses -------------------------------------------------------------------------------------------------------

    def _read_pose(self, element: Element, attributes: Mapping[str, str]) -> Pose:
        position = np.array(self._findings.numbers(element, "pos", (0.0, 0.0, 0.0), attributes=attributes))
        rotation = self._read_rotation(element, attributes)
        return Pose(rotation, position, () if np.array_equal(rotation, np.eye(3)) else None)

    def _read_rotation(self, element: Element, attributes: Mapping[str, str]) -> Array:
        given = [key for key in TURNS if key in element.attributes] or [key for key in TURNS if key in attributes]
        if len(given) > 1:
            self._findings.fault(element, f"it is turned by {' and '.join(given)}", "keep one of them")
        if not given:
            return np.eye(3)
        read = self._findings.numbers
        match given[0]:
            case "quat":
                quaternion = read(element, "quat", (1.0, 0.0, 0.0, 0.0), attributes=attributes)
                return turn_quaternion(quaternion) if self._has_length(element, "quat", quaternion) else np.eye(3)
            case "axisangle":
                *axis, angle = read(element, "axisangle", (0.0, 0.0, 1.0, 0.0), attributes=attributes)
                return turn(axis, self._angle(angle)) if self._has_length(element, "axisangle", axis) else np.eye(3)
            case "xyaxes":
                numbers = read(element, "xyaxes", (1.0, 0.0, 0.0, 0.0, 1.0, 0.0), attributes=attributes)
                return self._turn_axes(element, np.array(numbers[:3]), np.array(numbers[3:]))
            case "zaxis":
                axis = list(read(element, "zaxis", (0.0, 0.0, 1.0), attributes=attributes))
                return turn_to(axis) if self._has_length(element, "zaxis", axis) else np.eye(3)
        rotation = np.eye(3)
        angles = read(element, "euler", (0.0, 0.0, 0.0), attributes=attributes)
        for letter, angle in zip(self._compiler.sequence, angles, strict=True):
            step = turn(np.eye(3)["xyz".index(letter.lower())], self._angle(angle))
            rotation = rotation @ step if letter.islower() else step @ rotation
        return rotation

    def _has_length(self, element: Element, key: str, vector: tuple[float, ...] | list[float]) -> bool:
        if any(vector):
            return True
        self._findings.fault(element, f"{key} is 0", "give a direction")
        return False

    def _turn_axes(self, element: Element, x: Array, y: Array) -> Array:
        normal = np.cross(x, y)
        if not normal.any():
            self._findings.fault(element, "xyaxes are parallel, or 0", "give two directions")
            return np.eye(3)
        x = x / np.linalg.norm(x)
        normal = normal / np.linalg.norm(normal)
        return np.column_stack([x, np.cross(normal, x), normal])

    def _angle(self, angle: float) -> float:
        return self._draft.writer.snap(math.radians(angle) if self._compiler.degrees else angle)

    # --- joints ------------------------------------------------------------------------------------------------------

    def _is_free(self, parts: list[_Placed]) -> bool:
        return any(self._read_kind(part) == "free" for part in parts if part.element.tag in JOINTS)

    def _read_kind(self, part: _Placed) -> str:
        if part.element.tag == "freejoint":
            return "free"
        attributes = self._defaults.resolve(part.element, part.active)
        return self._findings.choice(part.element, "type", KINDS, attributes)

    def _read_moves(self, body: Element, parts: list[_Placed], pose: Pose) -> tuple[list[Move], Array]:
        """Read the joints of a body; the second result is the position of the last one's anchor in the body."""
        moves: list[Move] = []
        anchor = np.zeros(3)
        for part in (part for part in parts if part.element.tag in JOINTS):
            kind = self._read_kind(part)
            attributes = self._defaults.resolve(part.element, part.active)
            if kind == "free":
                if body.path.count("/") != 2 or moves:
                    remedy = "let only bodies of the world float, without other joints"
                    self._findings.fault(part.element, "a free joint within the tree", remedy)
                moves += self._move_freely(part.element, pose)
                self._tell_start(part.element, pose)
                self._warn_of_six(part.element, attributes, "a free joint")
                continue
            position = self._findings.numbers(part.element, "pos", (0.0, 0.0, 0.0), attributes=attributes)
            before, anchor = anchor, (part.around @ place(position)).position
            step = place(anchor - before)
            if kind == "ball":
                alone = sum(x.element.tag in JOINTS for x in parts) == 1
                if not self._choices.quaternions:
                    text = "a ball is turns about z, y, x; the second locks at a quarter turn (else --quaternions)"
                    self._findings.tell(part.element, text)
                elif not alone:
                    text = "a ball beside other joints has no quaternion: it is turns about z, y, x"
                    self._findings.tell(part.element, text)
                self._warn_of_six(part.element, attributes, "a ball")
                driven = not self._driven or attributes.get("name") in self._driven
                is_quaternion = self._choices.quaternions and alone
                moves += list_moves("ball" if is_quaternion else "spherical", part.element, step, actuated=driven)
            else:
                moves.append(self._read_move(part, kind, attributes, step))
        return moves, anchor

    def _move_freely(self, element: Element, pose: Pose) -> Iterator[Move]:
        """Yield the joints of a free body, with the coordinates that it has in the file."""
        z, y, x = (angle for _, angle in find_turns(pose.rotation))
        starts = (*pose.position, z, y, x)
        for move, start in zip(move_freely(element, quaternion=self._choices.quaternions), starts, strict=True):
            yield replace(move, start=float(start))

    def _read_move(self, part: _Placed, kind: str, attributes: Mapping[str, str], step: Pose) -> Move:
        element, name = part.element, attributes.get("name")
        is_hinge = kind == "hinge"

        def number(key: str) -> float:
            return self._findings.number(element, key, 0.0, attributes)

        def coordinate(value: float) -> float:
            return self._angle(value) if is_hinge else value

        axis = np.array(self._findings.numbers(element, "axis", (0.0, 0.0, 1.0), attributes=attributes))
        if not axis.any():
            self._findings.fault(element, "an axis without direction", "give a nonzero one, e.g. 0 0 1")
            axis = np.array([0.0, 0.0, 1.0])
        axis = part.around.rotation @ axis
        reference = coordinate(number("ref"))
        motion = Motion.REVOLUTE if is_hinge else Motion.PRISMATIC
        if reference:
            step = Move(motion, axis, element, pose=step).at(-reference)
        if name is not None:
            self._register.coordinates[name] = Coordinate(reference, name in self._driven)
        lower, upper = self._read_range(element, attributes, is_hinge=is_hinge)
        self._warn_joint(element, attributes)
        friction, speed = number("frictionloss"), self._choices.friction_speed
        if friction:
            self._findings.tell(element, f"dry friction of {friction:g}, smoothed: tanh(qd/{speed:g})")
        return Move(
            motion,
            axis,
            element,
            name=name,
            pose=step,
            actuated=name in self._driven or not self._driven,
            lower=lower,
            upper=upper,
            law=make_law(number("stiffness"), coordinate(number("springref")), number("damping"), friction, speed),
            armature=number("armature") + self._rotors[name or ""],
            effort=self._driven.get(name or ""),
            start=reference,
        )

    def _read_range(
        self, element: Element, attributes: Mapping[str, str], *, is_hinge: bool
    ) -> tuple[float | None, float | None]:
        limited = attributes.get("limited", "auto")
        if "range" not in attributes or limited == "false" or (limited == "auto" and not self._compiler.autolimits):
            return None, None
        lower, upper = self._findings.numbers(element, "range", (0.0, 0.0), attributes=attributes)
        if lower > upper:
            self._findings.fault(element, f"range is {lower:g} to {upper:g}", "swap them")
        if is_hinge:
            lower, upper = self._angle(lower), self._angle(upper)
        return lower, upper

    def _warn_joint(self, element: Element, attributes: Mapping[str, str]) -> None:
        if any(self._findings.numbers(element, "springdamper", (0.0, 0.0), attributes=attributes)):
            self._findings.warn(element, "springdamper: give stiffness and damping instead; it is left out")

    def _warn_of_six(self, element: Element, attributes: Mapping[str, str], what: str) -> None:
        for key in ("stiffness", "damping", "frictionloss", "armature", "range"):
            if any(word.strip("0.") for word in attributes.get(key, "").split()):
                self._findings.warn(element, f"{key} of {what} is left out: it is about no single coordinate")

    def _tell_start(self, element: Element, pose: Pose) -> None:
        origin = ", ".join(f"{x:.6g}" for x in pose.position)
        turned = "" if pose.is_straight else ", and turns it"
        self._findings.tell(
            element, f"coordinates are relative to the world; the file puts the body at {origin}{turned}"
        )

    # --- masses ------------------------------------------------------------------------------------------------------

    def _find_scale(self, worlds: list[Element]) -> float:
        total = self._findings.number(self._root, "settotalmass", -1.0, self._settings)
        if total <= 0:
            return 1.0
        sink = Findings(self._root.file)  # faults of masses are reported when they are finally read
        kept, self._findings = self._findings, sink
        mass = 0.0
        for world in worlds:
            waiting = [(b.element, b.active) for b in self._unframe(world, ORIGIN, MAIN) if b.element.tag == "body"]
            while waiting:
                body, active = waiting.pop()
                active = body.attributes.get("childclass", active)
                parts = [*self._unframe(body, ORIGIN, active)]
                mass += self._read_solid(body, parts).mass
                waiting += [(part.element, part.active) for part in parts if part.element.tag == "body"]
        self._findings = kept
        return total / mass if mass > 0 else 1.0

    def _read_solid(self, body: Element, parts: list[_Placed]) -> Solid:
        inertial = body.first("inertial")
        if inertial is not None and self._compiler.from_geometry != "true":
            return self._read_inertial(inertial)
        if self._compiler.from_geometry == "false":
            return NOTHING
        return add(
            solid.seen_from(pose)
            for part in parts
            if part.element.tag == "geom"
            for solid, pose in self._read_geom(part)
        )

    def _read_inertial(self, inertial: Element) -> Solid:
        attributes = inertial.attributes
        mass = self._findings.number(inertial, "mass", 0.0)
        if "fullinertia" in attributes:
            xx, yy, zz, xy, xz, yz = self._findings.numbers(inertial, "fullinertia", (0.0,) * 6)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            tensor = np.diag(self._findings.numbers(inertial, "diaginertia", (0.0,) * 3))
        return Solid(mass, np.zeros(3), tensor).seen_from(self._read_pose(inertial, attributes))

    def _read_geom(self, part: _Placed) -> Iterator[tuple[Solid, Pose]]:
        element = part.element
        attributes = self._defaults.resolve(element, part.active)
        group = self._findings.number(element, "group", 0.0, attributes)
        low, high = self._compiler.groups
        mass = self._findings.number(element, "mass", 0.0, attributes) if "mass" in attributes else None
        density = self._findings.number(element, "density", DENSITY, attributes)
        shape = attributes.get("type", "mesh" if "mesh" in attributes else "sphere")
        if not low <= group <= high or mass == 0 or (mass is None and density == 0) or shape in WEIGHTLESS:
            return
        if shape not in SHAPES or attributes.get("shellinertia") == "true":
            what = f"a {shape[:40]}" if shape not in SHAPES else "a shell"
            remedy = 'give the body an <inertial>; MuJoCo saves one with <compiler saveinertial="true"/>'
            self._findings.fault(element, f"the inertia of {what} is not computed here", remedy)
            return
        size, pose = self._measure(element, attributes, shape)
        if min(size) <= 0:
            found = " ".join(f"{length:g}" for length in size)
            self._findings.fault(element, f"the size of a {shape} is {found}", "give more than 0")
            return
        yield make_solid(shape, size, mass=mass, density=density), part.around @ pose

    def _measure(self, element: Element, attributes: Mapping[str, str], shape: str) -> tuple[list[float], Pose]:
        """Read the size of a shape, and its pose; two points also give its length and direction."""
        count = SIZES[shape]
        words = attributes.get("size", "").split()
        spans = shape in SPANNED and "fromto" in attributes and "pos" not in element.attributes
        wanted = 1 if spans else count
        if len(words) < wanted:
            self._findings.fault(element, f"a {shape} of {len(words)} sizes", f"give {wanted}")
            return [1.0] * count, ORIGIN
        first = {"size": " ".join(words[:wanted])}  # further sizes are allowed, and ignored
        size = list(self._findings.numbers(element, "size", (1.0,) * wanted, attributes=first))
        if not spans:
            return size, self._read_pose(element, attributes)
        points = self._findings.numbers(element, "fromto", (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), attributes=attributes)
        ends = np.array(points)
        along = ends[3:] - ends[:3]
        half = float(np.linalg.norm(along)) / 2
        pose = Pose(turn_to(along) if half else np.eye(3), (ends[:3] + ends[3:]) / 2)
        return [*[size[0]] * (count - 1), half], pose

    # --- pictures ----------------------------------------------------------------------------------------------------

    def _read_visuals(self, parts: list[_Placed], inner: Pose) -> list[Visual]:
        """Read the geoms that draw a body; `inner` is the pose of the file's body in the draft's."""
        found: list[Visual] = []
        kept, self._findings = self._findings, Findings(self._root.file)  # a faulty shape is a notice
        for part in (part for part in parts if part.element.tag == "geom"):
            self._findings.faults.clear()
            try:
                visual = self._read_visual(part, inner)
                if self._findings.faults:
                    raise UndrawnError(self._findings.faults[0].finding)
                if len(found) == MOST:
                    raise UndrawnError(f"its body has more than {MOST}")
            except UndrawnError as error:
                kept.omit(part.element, f"this geom is not drawn: {error}")
            else:
                found += [] if visual is None else [visual]
        self._findings = kept
        return found

    def _read_visual(self, part: _Placed, inner: Pose) -> Visual | None:
        """Read a geom; None for one that a viewer hides. Raises UndrawnError for one that is not understood."""
        element = part.element
        attributes = self._defaults.resolve(element, part.active)
        color = read_color(element, attributes, self._findings)
        if color is None:
            color = self._assets.colors.get(attributes.get("material", ""))
        if color == "" or self._findings.number(element, "group", 0.0, attributes) > LAST_GROUP:
            return None
        shape, turns = attributes.get("type", "mesh" if "mesh" in attributes else "sphere"), self._choices.quarter_turns
        if shape == "mesh":
            file, scale = self._assets.find_mesh(attributes.get("mesh", ""), self._findings)
            pose = inner @ part.around @ self._read_pose(element, attributes)
            return make_visual("mesh", scale, pose, turns, color or "", file)
        if "mesh" in attributes:
            raise UndrawnError(f"it is a {shape[:40]} fitted to a mesh")
        if shape not in SHAPES:
            raise UndrawnError(f"its type is {abbreviate(shape)}")
        half, own = self._measure(element, attributes, shape)
        return make_visual(*scale_shape(shape, half), inner @ part.around @ own, turns, color or "")

    # --- the rest ----------------------------------------------------------------------------------------------------

    def _tell_sections(self) -> None:
        for section in self._root.children:
            if section.tag in ALTERING:
                for element in section.children:
                    self._findings.warn(element, f"{element.tag[:40]} ({section.tag}) is not part of a model")
            elif section.tag in ("contact", "sensor", "keyframe", "asset", "custom", "visual", "statistic", "size"):
                self._skipped[section.tag] += 1
        if self._skipped:
            counts = ", ".join(f"{count} {tag}" for tag, count in sorted(self._skipped.items()))
            self._findings.sum_up(f"read for masses, or left out: {counts}")
        if self._touching:
            text = (
                f"{self._touching} of the bodies' geoms may touch others: they pass through; a model describes contacts"
            )
            self._findings.sum_up(f"{text} under `contacts`", alters=True)
        if not self._driven:
            self._findings.sum_up("no actuator is given: every hinge and slide has an input u")


def _take_first(attributes: Mapping[str, str], name: str) -> dict[str, str]:
    """Return the first of several numbers, for a joint with one degree of freedom."""
    words = attributes.get(name, "").split()
    return {name: words[0]} if words else {}


def turn_to(axis: Array | list[float]) -> Array:
    """Return the smallest rotation that takes z to a direction."""
    unit = np.asarray(axis, float) / np.linalg.norm(axis)
    across = np.cross((0.0, 0.0, 1.0), unit)
    sine = float(np.linalg.norm(across))
    if sine < 1e-14:
        return turn((1.0, 0.0, 0.0), math.pi) if unit[2] < 0 else np.eye(3)
    return turn(across, math.atan2(sine, unit[2]))
