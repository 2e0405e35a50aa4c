"""SDF -> Draft of a model: one body a link, in the frame of the joint that carries it.

Links and joints of SDF form a graph. Joints are taken in the order of the file: a joint carries its child, unless
another joint does, or its parent moves with the child already. Such a joint becomes a loop, or it carries its parent
where nothing else connects the two. A link that no joint carries moves freely, or is fixed to the base in a static
model. All coordinates are 0 in the poses of the file.

Source: the specification of SDFormat, versions 1.2 to 1.12 (sdformat.org).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.importing.choices import Choices, Imported
from mbsgen.importing.closing import Closure, Equation, Spot, Term
from mbsgen.importing.drafting import (
    Draft,
    Move,
    damp,
    describe_friction,
    list_moves,
    list_screw,
    make_law,
    move_freely,
)
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import Pose
from mbsgen.importing.sdf.frames import WORLD, Entry, Frames, read_flag, relate
from mbsgen.importing.sdf.vocabulary import GRAVITY_IN_PHYSICS, choose_vocabulary
from mbsgen.importing.solids import Solid
from mbsgen.importing.vocabulary import survey
from mbsgen.model.model import BASE
from mbsgen.model.tree import Cut, Motion

GRAVITY = (0.0, 0.0, -9.8)  # the default of SDF
OLDEST = (1, 2)  # version 1.0 writes values as attributes
CUTS = {
    "revolute": Cut.HINGE,
    "continuous": Cut.HINGE,
    "prismatic": Cut.PRISMATIC,
    "screw": Cut.HELICAL,
    "universal": Cut.UNIVERSAL,
    "revolute2": Cut.UNIVERSAL,
    "ball": Cut.BALL,
    "fixed": Cut.SOLID,
}
_TWO_AXES = (Cut.UNIVERSAL,)
_WITHOUT_AXIS = (Cut.BALL, Cut.SOLID)


def read_sdf(root: Element, choices: Choices, findings: Findings) -> Imported:
    """Make a model of an SDF file. Raises InputError with all its faults."""
    version = re.fullmatch(r"1\.([0-9]{1,3})", given := root.attributes.get("version", ""))
    if version is None:
        finding = f"its version is {abbreviate(given)}" if given else "an <sdf> without a version"
        findings.fault(root, finding, 'give the version of SDFormat that the file has, e.g. version="1.9"')
        raise findings.refuse()
    if int(version[1]) < OLDEST[1]:
        findings.fault(root, f"version {given}", "convert it to a version of SDFormat from 1.2 on (gz sdf -p FILE)")
        raise findings.refuse()
    return _File(root, choices, findings, (1, int(version[1]))).read()


class _File:
    """An SDF file during reading."""

    def __init__(self, root: Element, choices: Choices, findings: Findings, version: tuple[int, int]) -> None:
        self._root = root
        self._findings = findings
        worlds = [*root.all("world")]
        if len(worlds) > 1:
            findings.fault(worlds[1], "a second world", "give a file with one")
        self._world = worlds[0] if worlds else root
        self._choices = choices
        self._version = version
        self._draft = Draft(findings, choices)
        self._frames = Frames(version, findings, self._draft.writer)
        self._frames.add(WORLD, self._world)
        tops = [*self._world.all("model")]
        self._prefix = f"{tops[0].attributes.get('name', '')}::" if len(tops) == 1 else ""
        self._name = tops[0].attributes.get("name", "") if len(tops) == 1 else self._world.attributes.get("name", "")
        self._own: dict[str, str] = {WORLD: BASE}  # bodies of links, by key
        self._homes: dict[str, Pose] = {WORLD: self._frames.locate(WORLD)}  # of bodies, in the world
        self._moving: dict[str, str] = {}  # joints about or along one axis: key -> name in the file

    def read(self) -> Imported:
        """Read the file, and complete the model."""
        self._tell_rest()
        links = [*self._frames.all("link")]
        if not links and not self._findings.faults:
            self._findings.fault(self._root, "no link", "give a model with links")
        ends = {joint.key: self._find_ends(joint) for joint in self._frames.all("joint")}
        for entry in self._frames.entries.values():
            self._frames.locate(entry.key)
            self._frames.find_link(entry.key)
        if self._findings.faults:
            raise self._findings.refuse()
        carriers, rest = self._choose_carriers(ends)
        self._add_links(links, carriers, ends)
        for joint in rest:
            self._close(joint, *ends[joint.key])
        for joint in self._frames.all("joint"):
            self._couple(joint)
        self._draft.warn_of_limits()
        gravity = self._read_gravity()
        return self._draft.finish(self._name or "robot", gravity, self._root)

    def _read_gravity(self) -> tuple[float, ...]:
        """Read the gravity of the world, or up to version 1.5 of its physics."""
        profiles = sorted(self._world.all("physics"), key=lambda x: x.attributes.get("default", "") not in _TRUE)
        places = [self._world, *profiles[:1]] if self._version <= GRAVITY_IN_PHYSICS else [self._world]
        found = [element for place in places if (element := place.first("gravity")) is not None]
        if not found:
            if self._choices.gravity is None:
                self._findings.sum_up("no gravity is given: it is 9.8 m/s2 down the z axis, as SDF's default")
            return GRAVITY
        gravity, *others = (
            self._findings.numbers(element, "gravity", GRAVITY, attributes={"gravity": element.text})
            for element in found
        )
        if others and others[0] != gravity:
            self._findings.warn(found[1], f"gravity is already given in line {found[0].line}; this one is left out")
        return gravity

    def _find_ends(self, joint: Entry) -> tuple[str, str]:
        """Return the links, or the world, that a joint connects."""
        found = []
        for tag in ("parent", "child"):
            element = joint.element.first(tag)
            if element is None or not element.text:
                self._findings.fault(joint.element, f"a joint without a {tag}", f"give it <{tag}>LINK</{tag}>")
                found.append(WORLD)
            else:
                key = self._frames.find(element, element.text, joint.scope)
                found.append(WORLD if key is None else self._frames.find_link(key))
        parent, child = found
        if child == WORLD and not self._findings.faults:
            self._findings.fault(joint.element, "its child is the world", "let the world be the parent")
        elif parent == child and not self._findings.faults:
            self._findings.fault(joint.element, "its parent and its child are one link", "name two links")
        return parent, child

    def _choose_carriers(self, ends: dict[str, tuple[str, str]]) -> tuple[dict[str, Entry], list[Entry]]:
        """Return the joints that carry links, by link, and the joints that close loops.

        A joint that would close a loop between two parts that nothing else connects carries one of them instead.
        """
        carriers: dict[str, Entry] = {}
        rest: list[Entry] = []
        roots: dict[str, str] = {}  # links that are carried -> a link on the way to the first one of their chain
        joints = [x for x in self._frames.all("joint") if x.element.attributes.get("type") != "gearbox"]
        for joint in sorted(joints, key=lambda x: _is_loop(x.element)):
            parent, child = ends[joint.key]
            if self._is_static(child) and (parent == WORLD or self._is_static(parent)):
                self._findings.tell(joint.element, "its links are static: it is left out")
            elif child in carriers or _find_root(roots, parent) == child or self._is_static(child):
                rest.append(joint)
            else:
                carriers[child], roots[child] = joint, parent
        tree = _Tree(carriers, ends, self._is_static)
        return carriers, [x for x in rest if _is_loop(x.element) or not tree.connect(x)]

    def _is_static(self, link: str) -> bool:
        """Return whether a link, or the world, is part of a static model."""
        while link != WORLD:
            link = self._frames.entries[link].scope
            if link != WORLD and read_flag(self._frames.entries[link].element, "static"):
                return True
        return False

    # --- links -------------------------------------------------------------------------------------------------------

    def _add_links(self, links: list[Entry], carriers: dict[str, Entry], ends: dict[str, tuple[str, str]]) -> None:
        carried: dict[str, list[str]] = {}
        for link in links:
            above = _find_other(ends[carriers[link.key].key], link.key) if link.key in carriers else WORLD
            carried.setdefault(above, []).append(link.key)
        waiting = carried.get(WORLD, [])[::-1]
        while waiting:
            key = waiting.pop()
            self._add_link(self._frames.entries[key], carriers.get(key), ends)
            waiting += carried.get(key, [])[::-1]

    def _add_link(self, link: Entry, joint: Entry | None, ends: dict[str, tuple[str, str]]) -> None:
        own = here = self._frames.locate(link.key)
        parent = WORLD
        moves: list[Move] = []
        if joint is not None:
            parent = _find_other(ends[joint.key], link.key)
            moves = self._list_moves(joint)
            if parent == ends[joint.key][1]:
                moves = _reverse(moves)
                text = (
                    f"it carries its parent here, {abbreviate(self._show(link))}: its child stands nearer to the base"
                )
                self._findings.tell(joint.element, text)
            here = self._frames.locate(joint.key) if moves else own
        elif not self._is_static(link.key):
            moves = move_freely(link.element, quaternion=self._choices.quaternions)
            self._findings.tell(link.element, "no joint carries it: it moves freely; a fixed joint to world holds it")
        solid = self._read_solid(link.element).seen_from(relate(here, own))
        name = self._show(link)
        pose = relate(self._homes[parent], here)
        body = self._draft.add_body(name, self._own[parent], pose, moves, solid, link.element)
        self._own[link.key], self._homes[link.key] = body, here
        self._draft.add_frame(name, body, relate(here, own), link.element)

    def _show(self, entry: Entry) -> str:
        return entry.key.removeprefix(self._prefix)

    def _read_solid(self, link: Element) -> Solid:
        inertial = link.first("inertial")
        if inertial is None:
            self._findings.tell(link, "it has no <inertial>: 1 kg, and 1 kg m2 about each axis, as SDF's defaults")
        elif inertial.attributes.get("auto", "").lower() in ("true", "1"):
            remedy = "write mass and inertia as numbers (gz sdf --inertial-stats prints them)"
            self._findings.fault(inertial, "an inertial that is computed from shapes", remedy)
        tensor = None if inertial is None else inertial.first("inertia")
        xx, yy, zz = (self._number(tensor, f"i{axes}", 1.0) for axes in ("xx", "yy", "zz"))
        xy, xz, yz = (self._number(tensor, f"i{axes}", 0.0) for axes in ("xy", "xz", "yz"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        solid = Solid(self._number(inertial, "mass", 1.0), np.zeros(3), inertia)
        pose = None if inertial is None else inertial.first("pose")
        if pose is not None and (pose.attributes.get("relative_to") or pose.attributes.get("frame")):
            self._findings.fault(pose, "a pose of an inertial in another frame", "give it in the link's frame")
        return solid if pose is None else solid.seen_from(self._frames.read_pose(pose))

    def _number(self, parent: Element | None, tag: str, default: float) -> float:
        child = None if parent is None else parent.first(tag)
        return default if child is None else self._findings.number(child, tag, default, {tag: child.text})

    # --- joints ------------------------------------------------------------------------------------------------------

    def _find_cut(self, joint: Entry) -> Cut | None:
        kind = joint.element.attributes.get("type", "")
        if kind not in CUTS:
            self._findings.fault(joint.element, f"type is {abbreviate(kind)}", f"give {', '.join(CUTS)}")
        return CUTS.get(kind)

    def _list_moves(self, joint: Entry) -> list[Move]:
        cut, element, name = self._find_cut(joint), joint.element, self._show(joint)
        if cut not in _TWO_AXES and (second := element.first("axis2")) is not None:
            self._findings.warn(second, "a second axis of a joint that has none: it is left out, and all in it")
        match cut:
            case Cut.HINGE | Cut.PRISMATIC:
                motion = Motion.PRISMATIC if cut is Cut.PRISMATIC else Motion.REVOLUTE
                self._moving[joint.key] = name
                return [self._read_move(joint, motion, "axis", name)]
            case Cut.HELICAL:
                self._moving[joint.key] = name
                turned = self._read_move(joint, Motion.REVOLUTE, "axis", name)
                return list_screw(turned, self._read_pitch(element), self._choices)
            case Cut.UNIVERSAL:
                pair = [self._read_move(joint, Motion.REVOLUTE, axis, f"{name}.{axis}") for axis in ("axis", "axis2")]
                return [replace(move, actuated=False, effort=None) for move in pair]
            case Cut.BALL:
                kind = "ball" if self._choices.quaternions else "spherical"
                if not self._choices.quaternions:
                    text = "a ball is turns about z, y, x; the second locks at a quarter turn (else --quaternions)"
                    self._findings.tell(element, text)
                return self._resist(element, list_moves(kind, element, actuated=False))
        return []

    def _resist(self, joint: Element, moves: list[Move]) -> list[Move]:
        """Damp a ball by the damping of its axis: a moment against its angular velocity."""
        axis = joint.first("axis")
        limit, dynamics = (None if axis is None else axis.first(key) for key in ("limit", "dynamics"))
        if limit is not None and any(self._read_limit(limit, key) is not None for key in ("lower", "upper")):
            self._findings.warn(limit, "limits of a ball are left out: it turns about no single axis")
        if dynamics is None:
            return moves
        for key in ("friction", "spring_stiffness"):
            if self._number(dynamics, key, 0.0):
                self._findings.warn(dynamics, f"{key} of a ball is left out")
        damping = self._read_loss(joint, dynamics, "damping")
        if damping and any(move.floats for move in moves):
            self._findings.warn(dynamics, "damping of a joint with a quaternion is left out")
            return moves
        return damp(moves, damping)

    def _read_loss(self, joint: Element, dynamics: Element | None, key: str) -> float:
        value = self._number(dynamics, key, 0.0)
        if value < 0:
            self._findings.fault(joint, f"{key} is {value:g}", "give 0 or more")
        return max(value, 0.0)

    def _read_pitch(self, joint: Element) -> float:
        """Read how far a screw moves for each radian [m/rad]; the older element counts -rad/m."""
        if joint.first("screw_thread_pitch") is not None or joint.first("thread_pitch") is None:
            return self._number(joint, "screw_thread_pitch", 1.0) / (2 * math.pi)
        older = self._number(joint, "thread_pitch", 1.0)
        if older == 0:
            self._findings.fault(joint, "a thread_pitch of 0", "give -2 pi over the shift in a whole turn")
        return -1 / (older or 1.0)

    def _read_move(self, joint: Entry, motion: Motion, tag: str, name: str) -> Move:
        axis = joint.element.first(tag)
        limit, dynamics = (None if axis is None else axis.first(key) for key in ("limit", "dynamics"))
        lower, upper = (self._read_limit(limit, key) for key in ("lower", "upper"))
        if joint.element.attributes.get("type") == "continuous":
            lower = upper = None
        if lower is not None and upper is not None and lower > upper:
            self._findings.fault(joint.element, f"lower is {lower:g}, and upper {upper:g}", "swap them")
        velocity, effort = (self._read_limit(limit, key) for key in ("velocity", "effort"))
        stiffness, rest = (self._number(dynamics, key, 0.0) for key in ("spring_stiffness", "spring_reference"))
        damping, friction = (self._read_loss(joint.element, dynamics, key) for key in ("damping", "friction"))
        speed = self._choices.friction_speed
        if friction:
            self._findings.tell(joint.element, describe_friction(friction, self._choices))
        if effort == 0:
            self._findings.tell(joint.element, "an effort of 0: it has no input")
        return Move(
            motion,
            self._frames.read_axis(joint, axis),
            joint.element,
            name=name,
            lower=lower,
            upper=upper,
            law=make_law(stiffness, rest, damping, friction, speed),
            velocity=velocity if velocity is not None and velocity > 0 else None,
            effort=effort if effort is not None and effort > 0 else None,
            actuated=effort != 0,
        )

    def _read_limit(self, limit: Element | None, key: str) -> float | None:
        """Read a limit; None where it is infinite or missing."""
        element = None if limit is None else limit.first(key)
        return None if element is None else self._findings.bound(element, key, {key: element.text})

    # --- loops -------------------------------------------------------------------------------------------------------

    def _close(self, joint: Entry, parent: str, child: str) -> None:
        """Close a loop by a joint, whose frame both links have in the pose of the file."""
        cut = self._find_cut(joint)
        if cut is None:
            return
        here = self._frames.locate(joint.key)
        first, second = (Spot(self._own[key], relate(self._homes[key], here)) for key in (parent, child))
        axis, axis2 = (
            self._frames.read_axis(joint, joint.element.first(tag)) if is_read else None
            for tag, is_read in (("axis", cut not in _WITHOUT_AXIS), ("axis2", cut in _TWO_AXES))
        )
        pitch = self._read_pitch(joint.element) if cut is Cut.HELICAL else 0.0
        self._draft.closing.closures.append(
            Closure(self._show(joint), cut, first, second, joint.element, axis, axis2, pitch)
        )
        self._findings.tell(joint.element, f"{abbreviate(self._show(joint))} closes a loop: it has no coordinate")
        for tag in ("axis", "axis2"):
            self._tell_unread(joint.element.first(tag))

    def _tell_unread(self, axis: Element | None) -> None:
        """Add a warning for each part of a joint's axis that a loop does not have."""
        dynamics, limit = (None if axis is None else axis.first(key) for key in ("dynamics", "limit"))
        for key in ("damping", "friction", "spring_stiffness"):
            if dynamics is not None and self._number(dynamics, key, 0.0):
                self._findings.warn(dynamics, f"{key} of a joint that closes a loop is left out; cut another joint")
        if limit is not None and any(self._read_limit(limit, key) is not None for key in ("lower", "upper")):
            self._findings.warn(limit, "limits of a joint that closes a loop are left out")

    def _couple(self, joint: Entry) -> None:
        """Couple a joint to the one that it mimics: its q is multiplier (q of the other - reference) + offset."""
        axis = joint.element.first("axis")
        mimic = None if axis is None else axis.first("mimic")
        if mimic is None:
            return
        key = self._frames.find(mimic, mimic.attributes.get("joint", ""), joint.scope)
        if key is None:
            return
        if joint.key not in self._moving or key not in self._moving or mimic.attributes.get("axis", "axis") != "axis":
            self._findings.fault(mimic, "a mimic of joints without a coordinate each", "name a hinge, slide or screw")
            return
        own, other = self._moving[joint.key], self._moving[key]
        if self._choices.mimic != "couple":
            text = f"the joint follows {abbreviate(other)}; here it moves on its own (--lock holds it)"
            self._findings.warn(mimic, text)
            return
        ratio, offset, reference = (self._number(mimic, tag, x) for tag, x in _MIMIC.items())
        offset -= ratio * reference
        held = {own, other} & {name for name, _ in self._choices.locked}
        if held or not self._draft.closing.couple(own, (other, ratio, offset)):
            terms = Term(own, 1.0), Term(other, -ratio)
            self._draft.closing.equations.append(Equation(f"{own} to {other}", terms, -offset, mimic))
        else:
            text = f"no coordinate: its q is {ratio:g} times the q of {abbreviate(other)} + {offset:g}"
            self._findings.tell(mimic, text)

    # --- the rest ----------------------------------------------------------------------------------------------------

    def _tell_rest(self) -> None:
        """Add the warnings of all elements that act on motions and are not read, and one line of all others."""
        found = survey(self._root, choose_vocabulary(self._version), "sdf", self._findings)
        for joint in self._frames.all("joint"):
            if joint.element.attributes.get("type") == "gearbox":
                text = "a gearbox is not part of the model; give a constraint of its two joints"
                self._findings.warn(joint.element, text)
        touching = [x for x in self._world.all("model") if any(one.tag == "collision" for one in x.walk())]
        if len(touching) > 1 or any(read_flag(x.element, "self_collide") for x in self._frames.all("model")):
            text = "contacts of links are not part of the model; describe them under contacts"
            self._findings.sum_up(text, alters=True)
        if found.idle:
            shown = ", ".join(f"{count} {tag[:40]}" for tag, count in sorted(found.idle.items()))
            self._findings.sum_up(f"of no meaning for the dynamics: {shown}")


@dataclass(frozen=True)
class _Tree:
    """Links and the joints that carry them; a joint may carry its parent."""

    carriers: dict[str, Entry]
    ends: Mapping[str, tuple[str, str]]
    is_static: Callable[[str], bool]

    def connect(self, joint: Entry) -> bool:
        """Connect two parts of the tree by a joint; return False where they are connected."""
        parent, child = self.ends[joint.key]
        ways = self._climb(parent), self._climb(child)
        tops = [way[-1] for way in ways]
        stands, other_stands = (x == WORLD or self.is_static(x) for x in tops)
        if tops[0] == tops[1] or (stands and other_stands):
            return False
        turns_fewer = len(ways[1]) <= len(ways[0])  # of the joints that would carry their parents
        hung = child if stands or (turns_fewer and not other_stands) else parent
        self._hang(hung)
        self.carriers[hung] = joint
        return True

    def _climb(self, link: str) -> list[str]:
        """Return the links from one to the first of its part."""
        way = [link]
        while way[-1] in self.carriers:
            way.append(self._find_bearer(way[-1]))
        return way

    def _find_bearer(self, link: str) -> str:
        return _find_other(self.ends[self.carriers[link].key], link)

    def _hang(self, link: str) -> None:
        """Make a link the first one of its part: the joints above it carry the links at their other ends."""
        way: list[tuple[str, Entry]] = []
        while link in self.carriers:
            bearer = self._find_bearer(link)
            way.append((bearer, self.carriers.pop(link)))
            link = bearer
        self.carriers.update(way)


def _find_other(ends: tuple[str, str], link: str) -> str:
    """Return the other end of a joint."""
    parent, child = ends
    return parent if link == child else child


def _reverse(moves: Sequence[Move]) -> list[Move]:
    """Return the joints by which the parent moves in the child, of the same coordinates; of a ball, its own ones."""
    if len(moves) > 2:
        return [*moves]
    turned = [replace(move, axis=-move.axis) for move in moves]
    return turned if any(move.follows for move in moves) else turned[::-1]


_TRUE = ("true", "1")
_MIMIC = {"multiplier": 1.0, "offset": 0.0, "reference": 0.0}


def _find_root(roots: dict[str, str], link: str) -> str:
    """Return the first link of a chain, and shorten the way to it."""
    while link in roots:
        roots[link] = roots.get(roots[link], roots[link])
        link = roots[link]
    return link


def _is_loop(joint: Element) -> bool:
    """Return whether the file says that a joint closes a loop."""
    physics = joint.first("physics")
    return read_flag(None if physics is None else physics.first("simbody"), "must_be_loop_joint")
