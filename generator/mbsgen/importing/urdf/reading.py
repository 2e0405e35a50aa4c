"""URDF -> Draft of a model: one body a link, in the link's own frame.

A link's frame is its joint's frame, as in URDF, so a model has the coordinates of the file. Bodies are listed depth
first, joints in the file's order. `urdf_loops` reads the loops.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.choices import Choices, Imported
from mbsgen.importing.drafting import (
    GRAVITY,
    Draft,
    Move,
    damp,
    describe_friction,
    list_moves,
    list_screw,
    make_law,
    move_freely,
)
from mbsgen.importing.findings import UNEXPANDED, Findings, is_xacro, read_number
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Pose
from mbsgen.importing.solids import NOTHING, Solid
from mbsgen.importing.urdf.frames import read_axis, read_origin, tilt_z
from mbsgen.importing.urdf.loops import add_loops, has_loops, is_dependent
from mbsgen.importing.urdf.vocabulary import VOCABULARY
from mbsgen.importing.vocabulary import Survey, survey
from mbsgen.model.model import BASE
from mbsgen.model.tree import Motion

ONE_AXIS = ("revolute", "continuous", "prismatic")
KINDS = (*ONE_AXIS, "fixed", "floating", "planar", "spherical")
JOINT, DRAKE = "joint", "drake:joint"
DRAKE_KINDS = ("ball", "planar", "universal", "screw")  # of <drake:joint>
RATIOS = ("mechanicalReduction", "drake:gear_ratio")
ROTORS = ("rotorInertia", "motorInertia", "drake:rotor_inertia")
XACRO = "xacro:"


def read_urdf(root: Element, choices: Choices, findings: Findings) -> Imported:
    """Make a model of a URDF file. Raises InputError with all its faults."""
    for element in root.walk():
        if element.tag.startswith(XACRO):
            findings.fault(element, f"{element.tag[:40]} is xacro", "run `xacro FILE > robot.urdf`, and import that")
    for element in root.all(JOINT, DRAKE, "link"):
        for key, text in _list_names(element):
            if is_xacro(text):
                findings.fault(element, f"{key} is {abbreviate(text)}", UNEXPANDED)
    if findings.faults:
        raise findings.refuse()
    return _Robot(root, choices, findings).read()


def _list_names(whole: Element) -> Iterator[tuple[str, str]]:
    """Yield the names that a joint or a link has or mentions."""
    for element in (whole, *whole.all("parent", "child", "mimic")):
        for key in ("name", "type", "link", "joint"):
            if key in element.attributes:
                yield f"{element.tag} {key}" if element is not whole else key, element.attributes[key]


class _Robot:
    """A URDF file during reading."""

    def __init__(self, root: Element, choices: Choices, findings: Findings) -> None:
        self._root = root
        self._choices = choices
        self._findings = findings
        self._is_closed = has_loops(root)
        self._leaders = self._read_leaders()
        self._draft = Draft(findings, replace(choices, locked=(*choices.locked, *self._hold_followers())))
        self._lossy = 0  # joints with damping or friction, which are part of the model
        self._rotors: defaultdict[str, float] = defaultdict(float)  # rotor inertia at joints, from transmissions

    def _read_leaders(self) -> dict[str, tuple[str, float, float]]:
        """Read which joints follow others: the other's name, ratio and offset, by their own names."""
        moving = {
            joint.attributes.get("name", ""): joint
            for joint in self._root.all(JOINT)
            if joint.attributes.get("type") in ONE_AXIS
        }
        found = {}
        for name, joint in moving.items():
            mimic = joint.first("mimic")
            if mimic is None or name in dict(self._choices.locked):
                continue
            leader = mimic.attributes.get("joint", "")
            if leader not in moving and self._choices.mimic == "couple":
                meant = nearest(leader, list(moving))
                remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a joint that moves about one axis"
                finding = f"it follows {abbreviate(leader)}, which does not move so"
                self._findings.fault(mimic, finding, f"{remedy}, or give --mimic free or lock")
                continue
            found[name] = (
                leader,
                self._findings.number(mimic, "multiplier", 1.0),
                self._findings.number(mimic, "offset", 0.0),
            )
        return found

    def _hold_followers(self) -> Iterator[tuple[str, float]]:
        """Yield the fixed followers with their coordinates: followers of held joints, or all, by the choices."""
        held = dict(self._choices.locked)
        for name in self._leaders if self._choices.mimic != "free" else ():
            chain = [name]
            while chain[-1] in self._leaders and chain[-1] not in held and self._leaders[chain[-1]][0] not in chain:
                chain.append(self._leaders[chain[-1]][0])
            at = held.get(chain[-1], 0.0 if self._choices.mimic == "lock" else None)
            for follower in chain[-2::-1]:
                _, ratio, offset = self._leaders[follower]
                at = offset if ratio == 0 else None if at is None else ratio * at + offset
            if at is not None:
                yield name, at

    def read(self) -> Imported:
        """Read the file, and complete the model."""
        self._tell_ignored(survey(self._root, VOCABULARY, "robot", self._findings))
        links = self._index("link")
        joints = self._index(JOINT, DRAKE)
        self._read_transmissions(joints)
        carried: dict[str, list[tuple[Element, str]]] = {name: [] for name in links}
        carriers: dict[str, Element] = {}
        for joint in self._root.all(JOINT, DRAKE):
            parent, child = (self._find_link(joint, key, links) for key in ("parent", "child"))
            if child is not None and child in carriers:
                line = carriers[child].line
                remedy = "a tree has one; close the loop by a <loop> between frames of the two links"
                self._findings.fault(joint, f"link {abbreviate(child)} has a second joint, after line {line}", remedy)
            elif parent is not None and child is not None:
                carriers[child] = joint
                carried[parent].append((joint, child))
        roots = [name for name in links if name not in carriers]
        if len(roots) != 1 and not self._findings.faults:
            shown = ", ".join(map(abbreviate, roots[:5]))
            finding = f"{len(roots)} links stand on no joint: {shown}" if roots else "no link to begin with"
            self._findings.fault(self._root, finding, "let exactly one link be no joint's child")
        if self._findings.faults:
            raise self._findings.refuse()
        bodies = self._add_links(roots[0], links, carried)
        add_loops(self._root, bodies, carriers, self._draft)
        self._tell_conventions(roots[0], carried)
        self._draft.warn_of_limits()
        return self._draft.finish(self._root.attributes.get("name", "robot"), GRAVITY, self._root)

    def _index(self, *tags: str) -> dict[str, Element]:
        found: dict[str, Element] = {}
        for element in self._root.all(*tags):
            name = element.attributes.get("name", "")
            if not name:
                self._findings.fault(element, f"a {tags[0]} without a name", "give it one")
            elif name in found:
                finding = f"{tags[0]} {abbreviate(name)} is already in line {found[name].line}"
                self._findings.fault(element, finding, "give one of them another name")
            found.setdefault(name, element)
        return found

    def _find_link(self, joint: Element, key: str, links: dict[str, Element]) -> str | None:
        element = joint.first(key)
        name = None if element is None else element.attributes.get("link")
        if name is None or element is None:
            self._findings.fault(joint, f"a joint without a {key}", f'give it <{key} link="..."/>')
            return None
        if name not in links:
            meant = nearest(name, list(links))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a link of the file"
            self._findings.fault(element, f"there is no link {abbreviate(name)}", remedy)
            return None
        return name

    def _add_links(
        self, root: str, links: dict[str, Element], carried: dict[str, list[tuple[Element, str]]]
    ) -> dict[str, str]:
        """Add all links; return their bodies."""
        first = links[root]
        moves = move_freely(first, quaternion=self._choices.quaternions) if self._choices.base == "floating" else []
        waiting: list[tuple[str, str, Pose, list[Move]]] = [(root, BASE, ORIGIN, moves)]
        bodies: dict[str, str] = {}
        while waiting:
            name, parent, pose, moves = waiting.pop()
            own = bodies[name] = self._draft.add_body(
                name, parent, pose, moves, self._read_solid(links[name]), links[name]
            )
            self._draft.add_frame(name, own, ORIGIN, links[name])
            for joint, child in reversed(carried[name]):
                waiting.append((child, own, self._read_origin(joint), [*self._read_moves(joint)]))
        if self._choices.base == "fixed" and self._read_solid(first).mass:
            self._findings.tell(first, "the root link stands fast on the base; --base floating frees it")
        for name in links.keys() - bodies.keys():
            self._findings.fault(links[name], "it hangs in a loop of joints", "let its chain begin at the root link")
        return bodies

    # --- parts of links ----------------------------------------------------------------------------------------------

    def _read_origin(self, element: Element) -> Pose:
        return read_origin(element, self._findings, self._draft.writer)

    def _read_solid(self, link: Element) -> Solid:
        inertial = link.first("inertial")
        if inertial is None:
            return NOTHING
        mass, tensor = inertial.first("mass"), inertial.first("inertia")
        for element, tag in ((mass, "mass"), (tensor, "inertia")):
            if element is None:
                self._findings.fault(inertial, f"an inertial without <{tag}>", "give it one, or leave the inertial out")
        if mass is None or tensor is None:
            return NOTHING
        xx, yy, zz, xy, xz, yz = (
            self._findings.number(tensor, f"i{axes}", 0.0) for axes in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        own = Solid(self._findings.number(mass, "value", 0.0), np.zeros(3), inertia)
        return own.seen_from(self._read_origin(inertial))

    # --- joints ------------------------------------------------------------------------------------------------------

    def _read_moves(self, joint: Element) -> Iterator[Move]:
        kind = joint.attributes.get("type", "")
        name = joint.attributes.get("name", "")
        if joint.tag == DRAKE:
            yield from self._read_drake(joint, kind, name)
            return
        match kind:
            case "revolute" | "continuous" | "prismatic":
                yield self._read_move(joint, kind, name)
                return
            case "floating":
                yield from self._resist(joint, move_freely(joint, quaternion=self._choices.quaternions))
            case "planar":
                yield from self._list_plane(joint)
            case "spherical":
                yield from self._resist(joint, self._list_ball(joint))
            case "fixed":
                pass
            case _:
                self._findings.fault(joint, f"type is {abbreviate(kind)}", f"give {', '.join(KINDS)}")
        self._refuse_mimic(joint)

    def _read_drake(self, joint: Element, kind: str, name: str) -> Iterator[Move]:
        """Read a <drake:joint>: a ball, a plane, turns about x and then y, or a screw."""
        self._refuse_mimic(joint)
        match kind:
            case "ball":
                yield from self._resist(joint, self._list_ball(joint))
            case "planar":
                yield from self._list_plane(joint)
            case "universal":
                yield from self._resist(joint, list_moves("universal", joint, actuated=False))
            case "screw":
                pitch = joint.first("drake:screw_thread_pitch")
                if pitch is None:
                    self._findings.fault(joint, "a screw without a pitch", "give it <drake:screw_thread_pitch>")
                    return
                advance = self._findings.number(pitch, "value", 0.0) / (2 * math.pi)
                yield from list_screw(self._read_move(joint, kind, name), advance, self._choices)
            case _:
                self._findings.fault(joint, f"type is {abbreviate(kind)}", f"give {', '.join(DRAKE_KINDS)}")

    def _list_ball(self, joint: Element) -> list[Move]:
        kind = "ball" if self._choices.quaternions else "spherical"
        if not self._choices.quaternions:
            text = "a ball is turns about z, y, x; the second locks at a quarter turn (else --quaternions)"
            self._findings.tell(joint, text)
        return list_moves(kind, joint, actuated=False)

    def _list_plane(self, joint: Element) -> list[Move]:
        """List two slides across the axis, and a turn about it.

        Drake has three numbers for damping: along x and y of the frame whose z axis turns to the axis the shortest way,
        and about the axis.
        """
        normal = read_axis(joint, self._findings)
        x, y, z = map(float, normal)
        moves = list_moves("planar", joint, actuated=False, normal=[x, y, z])
        dynamics = joint.first("dynamics")
        if dynamics is None or len(dynamics.attributes.get("damping", "").split()) != 3:
            return self._resist(joint, moves)
        losses = self._findings.numbers(dynamics, "damping", (0.0, 0.0, 0.0))
        if min(losses) < 0:
            self._findings.fault(dynamics, f"damping is {min(losses):g}", "give 0 or more")
        if losses[0] != losses[1]:
            tilt = tilt_z(normal)
            moves = [replace(move, axis=axis) for move, axis in zip(moves, tilt.T, strict=True)]
        self._lossy += any(losses)
        kept = self._resist(joint, moves, is_damped=True)
        return [replace(move, law=make_law(damping=max(d, 0.0))) for move, d in zip(kept, losses, strict=True)]

    def _resist(self, joint: Element, moves: list[Move], *, is_damped: bool = False) -> list[Move]:
        """Add the damping of a joint of several freedoms, but neither friction nor rotors.

        Drake and MuJoCo have the same damping along and about each axis.
        """
        if (limit := joint.first("limit")) is not None:
            add = self._findings.tell if limit.attributes.keys().isdisjoint(("lower", "upper")) else self._findings.warn
            add(joint, "its limits are left out: it has several coordinates")
        dynamics = joint.first("dynamics")
        if dynamics is None:
            return moves
        damping = 0.0 if is_damped else self._read_loss(dynamics, "damping")
        friction = self._read_loss(dynamics, "friction")
        if self._read_armature(dynamics):
            self._findings.warn(dynamics, "the rotor of a joint of several freedoms is left out")
        if any(move.floats for move in moves):
            if damping or friction:
                self._findings.warn(dynamics, "damping and friction of a joint with a quaternion are left out")
            return moves
        if friction:
            self._findings.warn(dynamics, f"dry friction of {friction:g} of a joint of several freedoms is left out")
        self._lossy += bool(damping)
        return damp(moves, damping)

    def _read_move(self, joint: Element, kind: str, name: str) -> Move:
        lower = upper = velocity = effort = None
        limit = joint.first("limit")
        if limit is None and kind != "continuous":
            self._findings.tell(joint, "it has no <limit>: it is unbounded")
        if limit is not None:
            if kind != "continuous" and not limit.attributes.keys().isdisjoint(("lower", "upper")):
                lower, upper = (
                    self._findings.bound(limit, key) if key in limit.attributes else 0.0 for key in ("lower", "upper")
                )
                if lower is not None and upper is not None and lower > upper:
                    self._findings.fault(limit, f"lower is {lower:g}, and upper {upper:g}", "swap them")
            elif kind != "continuous":
                self._findings.tell(limit, "it has neither lower nor upper: the joint is unbounded")
            velocity, effort = (self._findings.bound(limit, key) for key in ("velocity", "effort"))
        follows = self._read_mimic(joint, name)
        is_free = follows is None
        if self._is_closed and is_dependent(joint, self._findings):
            self._draft.closing.dependent.add(name)
            self._findings.tell(joint, "it depends on others: it has no input")
            is_free = False
        dynamics = joint.first("dynamics")
        damping = friction = 0.0
        armature = self._rotors[name]
        if dynamics is not None:
            damping, friction = (self._read_loss(dynamics, key) for key in ("damping", "friction"))
            armature += self._read_armature(dynamics)
        if friction:
            self._findings.tell(joint, describe_friction(friction, self._choices, follows=follows is not None))
        self._lossy += bool(damping or (friction and not self._choices.dry_friction))
        return Move(
            Motion.PRISMATIC if kind == "prismatic" else Motion.REVOLUTE,
            read_axis(joint, self._findings),
            joint,
            name=name,
            lower=lower,
            upper=upper,
            law=make_law(damping=damping, friction=friction, speed=self._choices.friction_speed),
            armature=armature,
            velocity=velocity,
            effort=effort if is_free else None,
            actuated=is_free,
            follows=follows,
        )

    def _read_loss(self, dynamics: Element, key: str) -> float:
        value = self._findings.number(dynamics, key, 0.0)
        if value < 0:
            self._findings.fault(dynamics, f"{key} is {value:g}", "give 0 or more")
            return 0.0
        return value

    def _read_armature(self, dynamics: Element) -> float:
        """Read extensions of URDF for rotors: inertia at the joint, gears included."""
        total = 0.0
        for key in ("armature", "rotor_inertia"):
            if value := self._read_loss(dynamics, key):
                self._findings.tell(dynamics, f"{key} {value:g} is the joint's armature: no gear ratio is applied")
                total += value
        return total

    def _read_mimic(self, joint: Element, name: str) -> tuple[str, float, float] | None:
        mimic = joint.first("mimic")
        if mimic is None or name not in self._leaders or any(held == name for held, _ in self._draft.choices.locked):
            return None
        leader, ratio, offset = self._leaders[name]
        if self._choices.mimic == "free":
            self._findings.warn(mimic, f"the joint follows {abbreviate(leader)}; here it moves on its own")
            return None
        shown = f" + {offset:g}" if offset else ""
        self._findings.tell(mimic, f"no coordinate: its q is {ratio:g} times the q of {abbreviate(leader)}{shown}")
        return leader, ratio, offset

    def _refuse_mimic(self, joint: Element) -> None:
        if joint.first("mimic") is not None:
            self._findings.tell(joint, "a mimic of a joint that turns or slides about no single axis has no meaning")

    # --- the rest ----------------------------------------------------------------------------------------------------

    def _read_transmissions(self, joints: Mapping[str, Element]) -> None:
        """Compute rotor inertias at joints, for transmissions that lead from one actuator to one joint."""
        for transmission in self._root.all("transmission"):
            parts = [*transmission.walk()]
            ratios = [element for element in parts if element.tag in RATIOS]
            rotors = [element for element in parts if element.tag in ROTORS]
            names = {element.attributes.get("name", "") for element in parts if element.tag == "joint"}
            for element in (x for x in parts if is_xacro(x.attributes.get("name", "") + x.text)):
                self._findings.warn(element, f"the transmission is left out, as it stands: {UNEXPANDED}")
            for element in ratios:
                if self._read_value(element) != 1:
                    ratio = abbreviate(element.attributes.get("value", element.text))
                    self._findings.tell(transmission, f"gear ratio {ratio}: the input u is the force at the joint")
            gears, inertias = ([*map(self._read_value, elements)] for elements in (ratios, rotors))
            gear, inertia = (values[0] if len(values) == 1 else None for values in (gears or [1.0], inertias))
            if gear is not None and inertia is not None and len(names) == 1 and names <= joints.keys():
                armature = inertia * gear**2
                (name,) = names
                self._rotors[name] += armature
                self._findings.tell(rotors[0], f"with its gear, armature {armature:g} of joint {abbreviate(name)}")
            else:
                for element in rotors:
                    text = f"rotor inertia {abbreviate(element.attributes.get('value', element.text))} is left out"
                    self._findings.warn(
                        element, f"{text}: it does not belong to exactly one gear and one joint of the file"
                    )

    def _read_value(self, element: Element) -> float | None:
        """Read the number of an element, as its text or its value; None for any other text."""
        text = element.attributes.get("value", element.text)
        value = read_number(text)
        return None if math.isnan(value) else value

    def _tell_conventions(self, root: str, carried: dict[str, list[tuple[Element, str]]]) -> None:
        """Add a notice where the equations differ from Pinocchio's for the same file."""
        if self._lossy:
            joints = "1 joint" if self._lossy == 1 else f"{self._lossy} joints"
            self._findings.sum_up(
                f"damping and friction of {joints} are part of the equations; Pinocchio's recursions have none"
            )
        ours, theirs = (self._order(root, carried, by_name=by_name) for by_name in (False, True))
        if ours != theirs:
            self._findings.sum_up("joints have the order of the file; Pinocchio sorts the joints of a link by name")

    def _order(self, root: str, carried: dict[str, list[tuple[Element, str]]], *, by_name: bool) -> list[str]:
        """List the joints depth first; the joints of a link in the order of the file, or by name."""
        found: list[str] = []
        waiting = [("", root)]
        while waiting:
            name, link = waiting.pop()
            found.append(name)
            pairs = [(joint.attributes.get("name", ""), child) for joint, child in carried[link]]
            waiting += reversed(sorted(pairs) if by_name else pairs)
        return found

    def _tell_ignored(self, found: Survey) -> None:
        packaged = {
            element.attributes["filename"]
            for element in self._root.walk()
            if element.tag == "mesh" and "filename" in element.attributes
        }
        if found.idle:
            counts = ", ".join(f"{count} {tag[:40]}" for tag, count in sorted(found.idle.items()))
            meshes = f"; {len(packaged)} mesh files, package:// among them, were not looked for" if packaged else ""
            self._findings.sum_up(f"of no meaning for the dynamics: {counts}{meshes}")
