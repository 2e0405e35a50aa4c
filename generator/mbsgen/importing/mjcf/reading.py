"""MJCF, the format of MuJoCo -> Draft of a model: one body a body, its frame at its last joint's anchor.

Coordinates of hinges and slides agree with the file (`qpos`). A ball is three turns about z, y, x; a free body slides
along the axes of the world and then turns about z, y, x, all 0 where its frame is the world's; or each has a
quaternion. An angle is in degrees unless the compiler section says otherwise.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.expressions import Call, Expression, Name, Number, Operation, Power
from mbsgen.importing.choices import Choices, Imported
from mbsgen.importing.closing import Spot
from mbsgen.importing.drafting import Draft, Move, damp, describe_friction, list_moves, make_law, move_freely
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.actuators import JOINTS, TERMS, read_actuators, read_polynomial
from mbsgen.importing.mjcf.contacts import Contacts, Geom, Welded
from mbsgen.importing.mjcf.equalities import Coordinate, Place, Register, add_equalities, list_sites
from mbsgen.importing.mjcf.geometry import SHAPES, SIZES, SPANNED, WEIGHTLESS, make_solid
from mbsgen.importing.mjcf.geoms import (
    LAST_GROUP,
    MOST,
    UndrawnError,
    make_visual,
    read_assets,
    read_color,
    scale_shape,
)
from mbsgen.importing.mjcf.inheritance import MAIN, Defaults, include_files
from mbsgen.importing.mjcf.mesh_solids import MeshError
from mbsgen.importing.mjcf.meshes import Meshes
from mbsgen.importing.mjcf.reference import Degree, Reference
from mbsgen.importing.mjcf.schema import review
from mbsgen.importing.mjcf.settings import read_limits, read_settings
from mbsgen.importing.mjcf.tendons import Tendons, list_passed_sites
from mbsgen.importing.poses import ORIGIN, Array, Pose, place
from mbsgen.importing.rotations import find_turns, turn, turn_quaternion
from mbsgen.importing.solids import NOTHING, Solid, add
from mbsgen.model.model import BASE, COORDINATE, RATE, ZERO, Law, Visual
from mbsgen.model.tree import Motion

DENSITY = 1000.0  # of water, MuJoCo's default [kg/m3]
TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
KINDS = ("hinge", "slide", "ball", "free")
SCALES = ("scale", "scaling", "massscale")  # of a frame
SAVE = "save the compiled model (mujoco.mj_saveLastXML), and import that"
COPIES = ("composite", "flexcomp", "replicate", "attach", "plugin")  # elements that make bodies from other text
ALTERING = ("deformable", "extension")  # sections that act on bodies
INERTIAL = 'give the body an <inertial>; MuJoCo saves one with <compiler saveinertial="true"/>'
MARKS = frozenset(  # elements without mass and force, or read elsewhere
    ["inertial", "joint", "freejoint", "geom", "site", "body", "frame", "camera", "light"]
)


def read_mjcf(root: Element, choices: Choices, findings: Findings) -> Imported:
    """Make a model of an MJCF file. Raises InputError with all its faults.

    Springs that the file gives by times need the inertias of all bodies, so such a file is read twice.
    """
    whole = include_files(root, choices.root, findings)
    is_timed = any("springdamper" in element.attributes for element in whole.walk())
    springs = _Scene(whole, choices, Findings(whole.file), {}).find_springs() if is_timed else {}
    return _Scene(whole, choices, findings, springs).read()


@dataclass(frozen=True)
class _Spring:
    """A spring and a damper that follow from a time constant and a ratio of damping."""

    stiffness: float
    damping: float


@dataclass(frozen=True, eq=False)
class _Placed:
    """A child of a body, with its surrounding frames resolved."""

    element: Element
    around: Pose  # of those frames, in the body
    active: str  # default class


@dataclass(frozen=True, eq=False)
class _Waiting:
    """A body that is still to be read."""

    placed: _Placed
    carrier: Place
    is_top: bool  # a body of the world
    welded: Welded  # to what carries it


class _Scene:
    """An MJCF file during reading."""

    def __init__(
        self, root: Element, choices: Choices, findings: Findings, springs: Mapping[int, _Spring | None]
    ) -> None:
        review(root, findings)
        self._root = root
        self._choices = choices
        self._findings = findings
        self._draft = Draft(findings, choices)
        self._defaults = Defaults(root, findings)
        self._settings = read_settings(root, findings)
        self._drives = read_actuators(root, self._defaults, self._settings, findings)
        self._scale = 1.0
        self._skipped: Counter[str] = Counter()
        self._register = Register()
        self._used_sites = {*choices.sensors, *list_sites(root), *list_passed_sites(root)}
        self._assets = read_assets(root, self._settings.compiler, self._defaults, Findings(root.file))
        self._meshes = Meshes(self._assets, self._settings.compiler, root, choices.root, findings)
        self._springs = springs  # by the identities of joints; None: nothing determines it
        self._reference = Reference()
        self._times: dict[int, tuple[float, ...]] = {}  # time constants and ratios of damping
        self._degrees: dict[int, list[int]] = {}  # numbers in the reference, by the identities of joints
        self._contacts = Contacts(
            self._draft,
            findings,
            self._defaults,
            self._measure,
            self._enclose,
            self._read_pose,
            filters_parents="filterparent" not in self._settings.disabled,
        )
        self._welds = 0  # moving bodies, or groups of them without joints between each other

    def read(self) -> Imported:
        """Read the file, and complete the model."""
        worlds = [*self._root.all("worldbody")]
        if not worlds:
            self._findings.fault(self._root, "there is no <worldbody>", "give it one, with the bodies in it")
        self._scale = self._find_scale(worlds)
        for world in worlds:
            self._add_bodies(world)
        add_equalities(
            self._root,
            self._register,
            self._draft,
            self._defaults,
            self._findings,
            are_disabled=self._settings.lacks("equality"),
        )
        tendons = Tendons(self._register, self._draft, self._defaults, self._settings, self._findings)
        for section in self._root.all("tendon"):
            for element in section.children:
                tendons.read(element)
        self._tell_sections()
        self._draft.warn_of_limits()
        return self._draft.finish(self._root.attributes.get("model", "scene"), self._settings.gravity, self._root)

    def find_springs(self) -> Mapping[int, _Spring | None]:
        """Find the springs that the file gives by times, by the inertia in its pose, as MuJoCo's compiler does."""
        worlds = [*self._root.all("worldbody")]
        self._scale = self._find_scale(worlds)
        for world in worlds:
            self._add_bodies(world)
        inertias = self._reference.find_inertias()
        if not np.isfinite(inertias).all():
            return dict.fromkeys(self._times)
        found: dict[int, _Spring | None] = {}
        for joint, (time, ratio) in self._times.items():
            inertia = 1.0 / float(np.mean(1.0 / inertias[self._degrees[joint]]))
            found[joint] = _Spring(inertia / (time * ratio) ** 2, 2 * inertia / time)
        return found

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _add_bodies(self, world: Element) -> None:
        base = self._defaults.check(world, world.attributes.get("childclass", MAIN))
        waiting: list[_Waiting] = []
        self._add_children(world, Place(Spot(BASE, ORIGIN), ORIGIN), base, waiting, Welded())
        while waiting:
            self._add_body(waiting.pop(), waiting)

    def _add_body(self, this: _Waiting, waiting: list[_Waiting]) -> None:
        body, around, carrier = this.placed.element, this.placed.around, this.carrier
        active = self._defaults.check(body, body.attributes.get("childclass", this.placed.active))
        parent, step = carrier.spot.body, self._read_pose(body, body.attributes)
        pose = carrier.spot.pose @ around @ step
        parts = [*self._unframe(body, ORIGIN, active)]
        moves, anchor = self._read_moves(parts, pose, is_top=this.is_top)
        welded = this.welded
        if moves:
            self._welds += 1
            welded = Welded(self._welds, this.welded.number)
        solid = self._read_solid(parts, is_still=welded.number == 0).scaled(self._scale).shifted(anchor)
        name = body.attributes.get("name", "")
        first = ORIGIN if self._is_free(parts) else pose
        own = self._draft.add_body(name or "body", parent, first, moves, solid, body)
        self._warn_body(body)
        inner = Pose(np.eye(3), -anchor, ())
        self._draft.show(own, self._read_visuals(parts, inner))
        found = Place(Spot(own, inner), carrier.home @ around @ step)
        self._reference.add_body(own, parent, found.home, solid.shifted(-anchor))
        self._list_degrees(parts, own, found.home)
        if name:
            self._draft.add_frame(name, own, inner, body)
            self._register.bodies.setdefault(name, found)
        self._add_children(body, found, active, waiting, welded)

    def _add_children(
        self, body: Element, carrier: Place, active: str, waiting: list[_Waiting], welded: Welded
    ) -> None:
        """Queue the bodies of a body, and add its sites."""
        own, inner = carrier.spot.body, carrier.spot.pose
        found: list[_Waiting] = []
        for part in self._unframe(body, ORIGIN, active):
            element = part.element
            if element.tag == "body":
                found.append(_Waiting(part, carrier, body.tag == "worldbody", welded))
            elif element.tag == "site":
                attributes = self._defaults.resolve(element, part.active)
                if attributes.get("name") in self._used_sites:
                    spot = Spot(own, inner @ part.around @ self._read_site(element, attributes))
                    self._register.sites[attributes["name"]] = spot
                    if attributes["name"] in self._choices.sensors:
                        self._draft.add_frame(attributes["name"], own, spot.pose, element)
                self._skipped["site"] += 1
            elif element.tag in COPIES:
                self._findings.fault(element, f"{element.tag} makes bodies by its own rules", SAVE)
            elif element.tag not in MARKS:
                self._findings.fault(element, f"no part of a body is called {element.tag[:40]}", "take it out")
            elif element.tag in ("geom", "camera", "light"):
                self._skipped[element.tag] += 1
                if body.tag == "worldbody" and self._defaults.resolve(element, part.active).get("type") != "plane":
                    self._findings.omit(element, "this geom is not drawn: it belongs to the world")
                if element.tag == "geom":
                    owner = "world" if body.tag == "worldbody" else body.attributes.get("name", "")
                    attributes = self._defaults.resolve(element, part.active)
                    spot = Spot(own, inner @ part.around)
                    self._contacts.note(Geom(element, attributes, spot, owner, welded))
        waiting += found[::-1]

    def _unframe(self, element: Element, around: Pose, active: str) -> Iterator[_Placed]:
        """Yield the children of a body, or of a <frame>, with all frames resolved."""
        for child in element.children:
            if child.tag == "frame":
                inner = self._defaults.check(child, child.attributes.get("childclass", active))
                if scaled := [key for key in SCALES if key in child.attributes]:
                    self._findings.fault(child, f"{' and '.join(scaled)}: it scales its bodies", SAVE)
                yield from self._unframe(child, around @ self._read_pose(child, child.attributes), inner)
            else:
                yield _Placed(child, around, active)

    def _warn_body(self, body: Element) -> None:
        if self._findings.number(body, "gravcomp", 0.0) and self._settings.is_passive:
            self._findings.warn(body, "gravcomp: no force that carries a body's weight is made")
        if body.attributes.get("sleep") == "init" and "sleep" in self._settings.enabled:
            self._findings.warn(body, "sleep: the body is awake from the beginning")
        if body.attributes.get("mocap") == "true":
            self._findings.warn(body, "mocap: the body stands fast")

    # --- poses -------------------------------------------------------------------------------------------------------

    def _read_pose(self, element: Element, attributes: Mapping[str, str]) -> Pose:
        position = np.array(self._findings.numbers(element, "pos", (0.0, 0.0, 0.0), attributes=attributes))
        rotation = self._read_rotation(element, attributes)
        return Pose(rotation, position, () if np.array_equal(rotation, np.eye(3)) else None)

    def _read_site(self, element: Element, attributes: Mapping[str, str]) -> Pose:
        """Read the pose of a site, which two points may give."""
        if not self._has_span(element, attributes, attributes.get("type", "sphere")):
            return self._read_pose(element, attributes)
        middle, along = self._span(element, attributes)
        return Pose(turn_to(-along) if along.any() else np.eye(3), middle)

    def _has_span(self, element: Element, attributes: Mapping[str, str], shape: str) -> bool:
        """Return whether two points place a geom or a site; a fault for two points without a use."""
        if "fromto" not in attributes:
            return False
        if shape not in SPANNED:
            self._findings.fault(element, f"a {shape[:40]} has no fromto", f"give pos, or one of {', '.join(SPANNED)}")
            return False
        if any(self._findings.numbers(element, "pos", (0.0, 0.0, 0.0), attributes=attributes)):
            self._findings.fault(element, "it is placed by pos and fromto", "keep one of them")
        return True

    def _span(self, element: Element, attributes: Mapping[str, str]) -> tuple[Array, Array]:
        """Read two points: their middle, and the vector from the first to the second."""
        points = self._findings.numbers(element, "fromto", (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), attributes=attributes)
        ends = np.array(points)
        return (ends[:3] + ends[3:]) / 2, ends[3:] - ends[:3]

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
        for letter, angle in zip(self._settings.sequence, angles, strict=True):
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
        return self._draft.writer.snap(math.radians(angle) if self._settings.degrees else angle)

    # --- joints ------------------------------------------------------------------------------------------------------

    def _is_free(self, parts: list[_Placed]) -> bool:
        return any(self._read_kind(part) == "free" for part in parts if part.element.tag in JOINTS)

    def _read_kind(self, part: _Placed) -> str:
        if part.element.tag == "freejoint":
            return "free"
        attributes = self._defaults.resolve(part.element, part.active)
        return self._findings.choice(part.element, "type", KINDS, attributes)

    def _read_moves(self, parts: list[_Placed], pose: Pose, *, is_top: bool) -> tuple[list[Move], Array]:
        """Read the joints of a body; the second result is the position of the last one's anchor in the body."""
        moves: list[Move] = []
        anchor = np.zeros(3)
        for part in (part for part in parts if part.element.tag in JOINTS):
            kind = self._read_kind(part)
            attributes = self._defaults.resolve(part.element, part.active)
            if kind == "free":
                if not is_top or moves:
                    remedy = "let only bodies of the world float, without other joints"
                    self._findings.fault(part.element, "a free joint within the tree", remedy)
                moves += self._move_freely(part.element, pose)
                self._tell_start(part.element, pose)
                align = part.element.attributes.get("align", "auto")
                if (self._settings.compiler.get("alignfree", "false") if align == "auto" else align) == "true":
                    self._findings.tell(part.element, "align: coordinates are of the body's frame in the file")
                moves = self._resist(part.element, attributes, moves, "a free joint")
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
                driven = not self._drives.efforts or attributes.get("name") in self._drives.efforts
                is_quaternion = self._choices.quaternions and alone
                turns = list_moves("ball" if is_quaternion else "spherical", part.element, step, actuated=driven)
                moves += self._resist(part.element, attributes, turns, "a ball")
            else:
                moves.append(self._read_move(part, kind, attributes, step))
        return moves, anchor

    def _move_freely(self, element: Element, pose: Pose) -> Iterator[Move]:
        """Yield the joints of a free body, with the coordinates that it has in the file."""
        z, y, x = (angle for _, angle in find_turns(pose.rotation))
        starts = (*pose.position, z, y, x)
        for move, start in zip(move_freely(element, quaternion=self._choices.quaternions), starts, strict=True):
            yield replace(move, start=float(start))

    def _list_degrees(self, parts: list[_Placed], body: str, home: Pose) -> None:
        """Note the degrees of freedom of a body in the pose of the file, whose springs may follow from them."""
        for part in (part for part in parts if part.element.tag in JOINTS):
            kind, element = self._read_kind(part), part.element
            attributes = self._defaults.resolve(element, part.active)
            armature = self._findings.number(element, "armature", 0.0, attributes)
            armature += self._drives.rotors[attributes.get("name", "")]
            position = self._findings.numbers(element, "pos", (0.0, 0.0, 0.0), attributes=attributes)
            axis = self._findings.numbers(element, "axis", (0.0, 0.0, 1.0), attributes=attributes)
            point = home.position if kind == "free" else (home @ part.around @ place(position)).position
            along = home.rotation @ part.around.rotation @ np.array(axis)
            along = along / (np.linalg.norm(along) or 1.0)
            slides: list[Array] = {"slide": [along], "free": [*np.eye(3)]}.get(kind, [])
            turns: list[Array] = {"hinge": [along], "slide": []}.get(kind, [*home.rotation.T])
            self._degrees[id(element)] = [
                self._reference.add_degree(body, Degree(is_turn, line, point, armature))
                for is_turn, lines in ((False, slides), (True, turns))
                for line in lines
            ]
            time, ratio = self._findings.numbers(element, "springdamper", (0.0, 0.0), attributes=attributes)
            if time > 0 and ratio > 0:
                self._times[id(element)] = time, ratio

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
        efforts = self._drives.efforts
        if name is not None:
            self._register.coordinates[name] = Coordinate(reference, name in efforts)
        self._warn_joint(element, attributes)
        limits = self._read_limits(element, attributes, "range", "limited")
        lower, upper = (None, None) if limits is None or self._settings.lacks("limit") else map(coordinate, limits)
        return Move(
            motion,
            axis,
            element,
            name=name,
            pose=step,
            actuated=name in efforts or not efforts,
            lower=lower,
            upper=upper,
            law=self._read_law(element, attributes, name, coordinate(number("springref"))),
            armature=number("armature") + self._drives.rotors[name or ""],
            effort=self._read_effort(element, attributes, efforts.get(name or "")),
            start=reference,
        )

    def _read_limits(
        self, element: Element, attributes: Mapping[str, str], key: str, switch: str
    ) -> tuple[float, float] | None:
        return read_limits(element, attributes, key, switch, self._settings, self._findings)

    def _read_law(self, element: Element, attributes: Mapping[str, str], name: str | None, rest: float) -> Law:
        """Read spring, damper and dry friction of a joint, which flags may disable."""
        nothing = (0.0,) * TERMS
        spring, damper = (read_polynomial(element, x, attributes, self._findings) for x in ("stiffness", "damping"))
        if (timed := self._springs.get(id(element))) is not None:
            spring, damper = (timed.stiffness, *spring[1:]), (timed.damping, *damper[1:])
            text = f"springdamper: a stiffness of {timed.stiffness:g} and a damping of {timed.damping:g}"
            self._findings.tell(element, f"{text}, by the inertia in the pose of the file")
        damper = tuple(x + y for x, y in zip(damper, self._drives.dampers[name or ""], strict=True))
        spring = nothing if self._settings.lacks("spring") else spring
        damper = nothing if self._settings.lacks("damper") else damper
        friction, speed = self._findings.number(element, "frictionloss", 0.0, attributes), self._choices.friction_speed
        friction = 0.0 if self._settings.lacks("frictionloss") else friction
        if friction:
            self._findings.tell(element, describe_friction(friction, self._choices))
        linear = max(spring[0], 0.0), rest, max(damper[0], 0.0)
        return make_law(*linear, friction, speed, write_polynomials(spring, rest, damper))

    def _read_effort(self, element: Element, attributes: Mapping[str, str], effort: float | None) -> float | None:
        """Return the largest force of the actuators at a joint; `effort` is theirs, before the joint's own limit."""
        limits = self._read_limits(element, attributes, "actuatorfrcrange", "actuatorfrclimited")
        if limits is None:
            return effort
        largest = max(map(abs, limits))
        if limits[0] != -limits[1]:
            text = f"actuatorfrcrange of {limits[0]:g} to {limits[1]:g} bounds the input at {largest:g}, both ways"
            self._findings.tell(element, text)
        return largest if effort is None else min(effort, largest)

    def _warn_joint(self, element: Element, attributes: Mapping[str, str]) -> None:
        if id(element) in self._springs and self._springs[id(element)] is None:
            self._findings.warn(element, "springdamper is left out: in the pose of the file, something has no inertia")
        if self._findings.number(element, "springyield", 0.0, attributes) > 0 and not self._settings.lacks("spring"):
            self._findings.warn(element, "springyield: the spring is elastic beyond it")

    def _resist(self, element: Element, attributes: Mapping[str, str], moves: list[Move], what: str) -> list[Move]:
        """Damp a ball or a free body, alike in all directions; warn of the forces that a model does not have."""
        findings, timed = self._findings, self._springs.get(id(element))
        damping, *higher = read_polynomial(element, "damping", attributes, findings)
        damping = damping if timed is None else timed.damping
        is_spring = timed is not None or any(read_polynomial(element, "stiffness", attributes, findings))
        floats = any(move.floats for move in moves)
        left_out = {
            "stiffness": is_spring and not self._settings.lacks("spring"),
            "damping": damping and floats and not self._settings.lacks("damper"),
            "the damping of second and third order": any(higher) and not self._settings.lacks("damper"),
            "frictionloss": any(read_polynomial(element, "frictionloss", attributes, findings))
            and not self._settings.lacks("frictionloss"),
            "armature": any(read_polynomial(element, "armature", attributes, findings)),
            "springyield": findings.number(element, "springyield", 0.0, attributes) > 0
            and not self._settings.lacks("spring"),
            "springdamper": id(element) in self._springs and timed is None,
            "range": what == "a ball" and self._limits_ball(element, attributes),
        }
        for key in (key for key, is_there in left_out.items() if is_there):
            findings.warn(element, f"{key} of {what} is left out: it does not act on a single coordinate")
        if attributes.get("name") in self._drives.efforts:
            inputs = "has no inputs" if what == "a free joint" else "has an input for each of its turns"
            findings.warn(element, f"the actuator of {what} is left out: it {inputs} in a model")
        return moves if floats or self._settings.lacks("damper") else damp(moves, damping)

    def _limits_ball(self, element: Element, attributes: Mapping[str, str]) -> bool:
        limits = self._read_limits(element, attributes, "range", "limited")
        if limits is not None and limits[0] != 0:
            text = f"the range of a ball begins at {limits[0]:g}"
            self._findings.fault(element, text, "give 0 and the largest angle of its turn")
        return limits is not None and not self._settings.lacks("limit")

    def _tell_start(self, element: Element, pose: Pose) -> None:
        origin = ", ".join(f"{x:.6g}" for x in pose.position)
        turned = "" if pose.is_straight else ", and turns it"
        self._findings.tell(
            element, f"coordinates are relative to the world; the file puts the body at {origin}{turned}"
        )

    # --- masses ------------------------------------------------------------------------------------------------------

    def _find_scale(self, worlds: list[Element]) -> float:
        total = self._findings.number(self._root, "settotalmass", -1.0, self._settings.compiler)
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
                mass += self._read_solid(parts).mass
                waiting += [(part.element, part.active) for part in parts if part.element.tag == "body"]
        self._findings = kept
        return total / mass if mass > 0 else 1.0

    def _read_solid(self, parts: list[_Placed], *, is_still: bool = False) -> Solid:
        """Read the solid of a body; `is_still`: its mass acts on nothing."""
        inertials = [part for part in parts if part.element.tag == "inertial"]
        if len(inertials) > 1:
            self._findings.fault(inertials[1].element, "a second <inertial> of the body", "keep one of them")
        if inertials and self._settings.from_geometry != "true":
            return self._read_inertial(inertials[0].element).seen_from(inertials[0].around)
        if self._settings.from_geometry == "false":
            return NOTHING
        geoms = [part for part in parts if part.element.tag == "geom"]
        return add(solid.seen_from(pose) for part in geoms for solid, pose in self._read_geom(part, is_still=is_still))

    def _read_inertial(self, inertial: Element) -> Solid:
        attributes = inertial.attributes
        mass = self._findings.number(inertial, "mass", 0.0)
        if missing := [key for key in ("pos", "mass") if key not in attributes]:
            self._findings.fault(inertial, f"an inertial without {' and '.join(missing)}", "give pos, mass and inertia")
        if "fullinertia" in attributes:
            if given := [key for key in ("diaginertia", *TURNS) if key in attributes]:
                text = f"it has fullinertia, and {' and '.join(given)}"
                self._findings.fault(inertial, text, "keep fullinertia, which is along the axes of the body, or these")
            xx, yy, zz, xy, xz, yz = self._findings.numbers(inertial, "fullinertia", (0.0,) * 6)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            tensor = np.diag(self._findings.numbers(inertial, "diaginertia", (0.0,) * 3))
        return Solid(mass, np.zeros(3), tensor).seen_from(self._read_pose(inertial, attributes))

    def _read_geom(self, part: _Placed, *, is_still: bool) -> Iterator[tuple[Solid, Pose]]:
        element = part.element
        attributes = self._defaults.resolve(element, part.active)
        group = self._findings.number(element, "group", 0.0, attributes)
        low, high = self._settings.groups
        mass = self._findings.number(element, "mass", 0.0, attributes) if "mass" in attributes else None
        density = self._findings.number(element, "density", DENSITY, attributes)
        shape = attributes.get("type", "sphere")
        for key, value in (("mass", mass or 0.0), ("density", density)):
            if value < 0:
                self._findings.fault(element, f"a {key} of {value:g}", "give 0 or more")
        if not low <= group <= high or mass == 0 or (mass is None and density == 0) or shape in WEIGHTLESS:
            return
        try:
            found = self._weigh(element, attributes, shape, mass, density)
        except MeshError as error:
            if not is_still or self._scale != 1:
                self._findings.fault(element, error.finding, error.remedy)
            else:
                self._findings.tell(element, f"without mass, which nothing would feel here: {error.finding}")
            return
        if found is not None:
            yield found[0], part.around @ found[1]

    def _weigh(
        self, element: Element, attributes: Mapping[str, str], shape: str, mass: float | None, density: float
    ) -> tuple[Solid, Pose] | None:
        """Return the solid of a geom, and its pose; None after a fault. Raises MeshError."""
        if shape == "mesh":
            if attributes.get("shellinertia") == "true":
                self._findings.fault(element, "shellinertia of a mesh", 'give the mesh itself inertia="shell"')
            return self._meshes.weigh(attributes.get("mesh", ""), mass, density), self._read_pose(element, attributes)
        if shape not in SHAPES:
            raise MeshError(f"the inertia of a {shape[:40]} is not computed here", INERTIAL)
        size, pose = self._measure(element, attributes, shape)
        if min(size) <= 0:
            found = " ".join(f"{length:g}" for length in size)
            self._findings.fault(element, f"the size of a {shape} is {found}", "give more than 0")
            return None
        is_shell = self._findings.choice(element, "shellinertia", ("false", "true"), attributes) == "true"
        return make_solid(shape, size, mass=mass, density=density, is_shell=is_shell), pose

    def _measure(self, element: Element, attributes: Mapping[str, str], shape: str) -> tuple[list[float], Pose]:
        """Read the size of a shape, and its pose; two points, or a mesh, also give its length and direction.

        Raises MeshError.
        """
        if "mesh" in attributes:
            scale = self._findings.number(element, "fitscale", 1.0, attributes)
            size, pose = self._meshes.fit(attributes["mesh"], shape, scale)
            return size, self._read_pose(element, attributes) @ pose
        count = SIZES[shape]
        words = attributes.get("size", "").split()
        spans = self._has_span(element, attributes, shape)
        wanted = 1 if spans else count
        if len(words) < wanted:
            self._findings.fault(element, f"a {shape} of {len(words)} sizes", f"give {wanted}")
            return [1.0] * count, ORIGIN
        first = {"size": " ".join(words[:wanted])}  # further sizes are allowed, and ignored
        size = list(self._findings.numbers(element, "size", (1.0,) * wanted, attributes=first))
        if not spans:
            return size, self._read_pose(element, attributes)
        middle, along = self._span(element, attributes)
        half = float(np.linalg.norm(along)) / 2
        pose = Pose(turn_to(along) if half else np.eye(3), middle)
        return [*[size[0]] * (count - 1), half], pose

    def _enclose(self, element: Element, attributes: Mapping[str, str]) -> tuple[Array, Pose]:
        """Return the corners of the convex hull of a geom's mesh, and its pose. Raises MeshError."""
        return self._meshes.enclose(attributes.get("mesh", "")), self._read_pose(element, attributes)

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
        shape, turns = attributes.get("type", "sphere"), self._choices.quarter_turns
        if shape == "mesh":
            file, scale = self._assets.find_mesh(attributes.get("mesh", ""), self._findings)
            pose = inner @ part.around @ self._read_pose(element, attributes)
            return make_visual("mesh", scale, pose, turns, color or "", file)
        if shape not in SHAPES:
            raise UndrawnError(f"its type is {abbreviate(shape)}")
        try:
            half, own = self._measure(element, attributes, shape)
        except MeshError as error:
            raise UndrawnError(error.finding) from None
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
        if not self._settings.lacks("contact"):
            self._tell_contacts()
        if not self._drives.efforts:
            self._findings.sum_up("no actuator is given: every hinge and slide has an input u")

    def _tell_contacts(self) -> None:
        """Add the contacts that the choices ask for, and warn of all others."""
        pairs = [x for section in self._root.all("contact") for x in section.all("pair")]
        count = len(self._contacts.moving)
        if self._choices.contacts is not None:
            self._contacts.add(self._root)
        elif count or pairs:
            text = f"{max(count, 2) if pairs else count} of the bodies' geoms may touch others: they pass through"
            remedy = "--contacts 0 makes contacts"
            self._findings.sum_up(f"{text}; {remedy}", alters=True)


def write_polynomials(spring: Sequence[float], rest: float, damper: Sequence[float]) -> Expression:
    """Write -(k1 x + k2 x^2 + k3 x^3) - (d1 v + d2 v |v| + d3 v^3) without linear terms that a law has, above 0."""
    q, qd = Name(COORDINATE), Name(RATE)
    x: Expression = q if not rest else Operation("-" if rest > 0 else "+", q, Number(abs(rest)))
    powers = (
        (min(spring[0], 0.0), x),
        (spring[1], Power(x, 2)),
        (spring[2], Power(x, 3)),
        (min(damper[0], 0.0), qd),
        (damper[1], Operation("*", qd, Call("abs", (qd,)))),
        (damper[2], Power(qd, 3)),
    )
    total: Expression | None = None
    for term in (Operation("*", Number(-factor), power) for factor, power in powers if factor):
        total = term if total is None else Operation("+", total, term)
    return ZERO if total is None else total


def turn_to(axis: Array | list[float]) -> Array:
    """Return the smallest rotation that takes z to a direction."""
    unit = np.asarray(axis, float) / np.linalg.norm(axis)
    across = np.cross((0.0, 0.0, 1.0), unit)
    sine = float(np.linalg.norm(across))
    if sine < 1e-14:
        return turn((1.0, 0.0, 0.0), math.pi) if unit[2] < 0 else np.eye(3)
    return turn(across, math.atan2(sine, unit[2]))
