"""URDF -> Draft of a model: one body a link, in the link's own frame.

A link's frame is its joint's frame, as in URDF, so a model has the coordinates of the file. Bodies are listed depth
first, joints in the file's order. `urdf_loops` reads the loops.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.drafting import GRAVITY, Choices, Draft, Imported, Move, list_moves, make_law, move_freely
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Pose
from mbsgen.importing.solids import NOTHING, Solid
from mbsgen.importing.urdf_frames import read_axis, read_origin
from mbsgen.importing.urdf_loops import READERS, add_loops, has_loops, is_dependent
from mbsgen.model.model import BASE
from mbsgen.model.tree import Motion

KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
READ = frozenset(
    {
        *("robot", "link", "joint", "inertial", "mass", "inertia", "origin", "axis", "limit", "dynamics", "mimic"),
        *("parent", "child", "transmission"),
        *READERS,
    }
)
_XACRO = ("include", "property", "macro", "arg", "if", "unless", "insert_block", "call")
RATIOS = ("mechanicalReduction", "drake:gear_ratio")
ROTORS = ("rotorInertia", "motorInertia", "drake:rotor_inertia")
MACROS = frozenset(f"xacro:{word}" for word in _XACRO)


def read_urdf(root: Element, choices: Choices, findings: Findings) -> Imported:
    """Make a model of a URDF file. Raises InputError with all its faults."""
    for element in root.walk():
        if element.tag in MACROS:
            findings.fault(element, f"{element.tag} is xacro", "run `xacro FILE > robot.urdf`, and import that")
    if findings.faults:
        raise findings.refuse()
    return _Robot(root, choices, findings).read()


class _Robot:
    """A URDF file during reading."""

    def __init__(self, root: Element, choices: Choices, findings: Findings) -> None:
        self._root = root
        self._choices = choices
        self._findings = findings
        self._is_closed = has_loops(root)
        self._leaders = self._read_leaders()
        self._draft = Draft(findings, replace(choices, locked=(*choices.locked, *self._hold_followers())))
        self._rotors: defaultdict[str, float] = defaultdict(float)  # rotor inertia at joints, from transmissions

    def _read_leaders(self) -> dict[str, tuple[str, float, float]]:
        """Read which joints follow others: the other's name, ratio and offset, by their own names."""
        moving = {
            joint.attributes.get("name", ""): joint
            for joint in self._root.all("joint")
            if joint.attributes.get("type") in ("revolute", "continuous", "prismatic")
        }
        found = {}
        for name, joint in moving.items():
            mimic = joint.first("mimic")
            if mimic is None or name in dict(self._choices.locked):
                continue
            leader = mimic.attributes.get("joint", "")
            if leader not in moving:
                meant = nearest(leader, list(moving))
                remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a joint that moves about one axis"
                self._findings.fault(mimic, f"it follows {abbreviate(leader)}, which does not move so", remedy)
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
        links = self._index("link")
        joints = self._index("joint")
        self._read_transmissions(joints)
        carried: dict[str, list[tuple[Element, str]]] = {name: [] for name in links}
        carriers: dict[str, Element] = {}
        for joint in self._root.all("joint"):
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
        self._tell_ignored()
        self._tell_conventions(roots[0], carried)
        return self._draft.finish(self._root.attributes.get("name", "robot"), GRAVITY, self._root)

    def _index(self, tag: str) -> dict[str, Element]:
        found: dict[str, Element] = {}
        for element in self._root.all(tag):
            name = element.attributes.get("name", "")
            if not name:
                self._findings.fault(element, f"a {tag} without a name", "give it one")
            elif name in found:
                finding = f"{tag} {abbreviate(name)} is already in line {found[name].line}"
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
        match kind:
            case "fixed":
                self._refuse_mimic(joint)
            case "floating":
                self._refuse_mimic(joint)
                yield from move_freely(joint, quaternion=self._choices.quaternions)
            case "planar":
                self._refuse_mimic(joint)
                yield from list_moves(
                    "planar", joint, actuated=False, normal=[*map(float, read_axis(joint, self._findings))]
                )
            case "revolute" | "continuous" | "prismatic":
                yield self._read_move(joint, kind, name)
            case _:
                self._findings.fault(joint, f"type is {abbreviate(kind)}", f"give {', '.join(KINDS)}")

    def _read_move(self, joint: Element, kind: str, name: str) -> Move:
        lower = upper = velocity = effort = None
        limit = joint.first("limit")
        if limit is None and kind != "continuous":
            self._findings.tell(joint, "it has no <limit>: it is unbounded")
        if limit is not None:
            if kind != "continuous" and not limit.attributes.keys().isdisjoint(("lower", "upper")):
                lower, upper = (self._findings.number(limit, key, 0.0) for key in ("lower", "upper"))
                if lower > upper:
                    self._findings.fault(limit, f"lower is {lower:g}, and upper {upper:g}", "swap them")
            elif kind != "continuous":
                self._findings.tell(limit, "it has neither lower nor upper: the joint is unbounded")
            velocity, effort = (
                self._findings.number(limit, key, 0.0) if key in limit.attributes else None
                for key in ("velocity", "effort")
            )
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
            speed = self._choices.friction_speed
            self._findings.tell(joint, f"dry friction of {friction:g}, smoothed: tanh(qd/{speed:g})")
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
            for element in ratios:
                if self._read_value(element, 1.0) != 1:
                    ratio = abbreviate(element.attributes.get("value", element.text))
                    self._findings.tell(transmission, f"gear ratio {ratio}: the input u is the force at the joint")
            if len(ratios) <= 1 and len(rotors) == 1 and len(names) == 1 and names <= joints.keys():
                gear = self._read_value(ratios[0], 1.0) if ratios else 1.0
                armature = self._read_value(rotors[0], 0.0) * gear**2
                (name,) = names
                self._rotors[name] += armature
                self._findings.tell(rotors[0], f"with its gear, armature {armature:g} of joint {abbreviate(name)}")
            else:
                for element in rotors:
                    text = f"rotor inertia {abbreviate(element.attributes.get('value', element.text))} is left out"
                    self._findings.warn(element, f"{text}: of no single rotor, gear and joint of the file")

    def _read_value(self, element: Element, default: float) -> float:
        """Read the number of an element, as its text or its value."""
        value = {"value": text} if (text := element.attributes.get("value", element.text)) else {}
        return self._findings.number(element, "value", default, value)

    def _tell_conventions(self, root: str, carried: dict[str, list[tuple[Element, str]]]) -> None:
        """Add a notice where the equations differ from Pinocchio's for the same file."""
        damped = sum(any(d.attributes.get(key, "0") != "0" for key in ("damping", "friction")) for d in self._losses())
        if damped:
            joints = "1 joint" if damped == 1 else f"{damped} joints"
            self._findings.sum_up(
                f"damping and friction of {joints} are part of the equations; Pinocchio's recursions have none"
            )
        ours, theirs = (self._order(root, carried, by_name=by_name) for by_name in (False, True))
        if ours != theirs:
            self._findings.sum_up("joints have the order of the file; Pinocchio sorts the joints of a link by name")

    def _losses(self) -> Iterator[Element]:
        return (found for joint in self._root.all("joint") if (found := joint.first("dynamics")) is not None)

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

    def _tell_ignored(self) -> None:
        seen: Counter[str] = Counter()
        packaged = set()
        for element in self._root.walk():
            if element.tag == "mesh" and "filename" in element.attributes:
                packaged.add(element.attributes["filename"])
        for parent in (self._root, *self._root.all("link", "joint")):
            seen.update(child.tag for child in parent.children if child.tag not in READ)
        if seen:
            counts = ", ".join(f"{count} {tag[:40]}" for tag, count in sorted(seen.items()))
            meshes = f"; {len(packaged)} mesh files, package:// among them, were not looked for" if packaged else ""
            self._findings.sum_up(f"of no meaning for the dynamics: {counts}{meshes}")
