"""Frames of SDF: names in their scopes -> poses in the world and links that carry them.

A link's pose is given in its model, a joint's in its child, a frame's in the frame that it is attached to, and a
model's in the model or world around it; `relative_to` names another frame. A model's pose may be the one of a frame in
it, its `placement_frame`. A joint's axis is given in the joint's
frame; `expressed_in` names another one. Up to version 1.4, and with `use_parent_model_frame` in 1.5 and 1.6, axes are
in the model's frame. Roll, pitch and yaw are turns about z by yaw, about y by pitch, about x by roll.

Source: the specification of SDFormat and its pages on poses (sdformat.org).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Array, Pose, Writer, place
from mbsgen.importing.rotations import turn_quaternion
from mbsgen.importing.sdf.vocabulary import AXES_BY_FLAG

WORLD = "world"
MODEL = "__model__"
SEPARATOR = "::"
NOISE = 1e-15  # of the largest entry: the rounding of products of rotations
IN_MODEL = (1, 4)  # the last version with axes in the model's frame
FLATTENED = (1, 7)  # the last version whose names may contain ::, of models that were in the model
_SCOPED = ("model", "link", "joint", "frame")


def read_text(parent: Element | None, tag: str, default: str = "") -> str:
    """Return the text of a child of an element."""
    child = None if parent is None else parent.first(tag)
    return default if child is None else child.text


def read_flag(parent: Element | None, tag: str) -> bool:
    """Return whether a child of an element is true."""
    return read_text(parent, tag).lower() in ("true", "1")


def relate(outer: Pose, inner: Pose) -> Pose:
    """Return the pose of one frame in another one, from the poses of both in the world."""
    rotation = outer.rotation.T @ inner.rotation
    near = np.rint(rotation)
    rotation = np.where(np.abs(rotation - near) <= NOISE, near, rotation)
    far = max(np.abs(outer.position).max(), np.abs(inner.position).max())
    position = outer.rotation.T @ (inner.position - outer.position)
    if far:
        position = np.round(position, min(300, 15 - math.ceil(math.log10(far))))
    return Pose(rotation, position, () if np.array_equal(rotation, np.eye(3)) else None)


@dataclass(frozen=True)
class Entry:
    """A named element, and the model or world that it is in."""

    element: Element
    scope: str  # the key of the model, or the world
    key: str


@dataclass
class Frames:
    """The frames of a file by their keys: names behind the names of all models around them."""

    version: tuple[int, int]
    findings: Findings
    writer: Writer
    entries: dict[str, Entry] = field(default_factory=dict)
    _poses: dict[str, Pose] = field(default_factory=dict)
    _links: dict[str, str] = field(default_factory=lambda: {WORLD: WORLD})  # that carry frames
    _first: dict[str, str] = field(default_factory=dict)  # the first link of each model, itself in no model inside
    _inner: dict[str, str] = field(default_factory=dict)  # the first model in each model
    _placed: dict[str, Pose] = field(default_factory=dict)  # frames that the poses of models place, in their models

    def __post_init__(self) -> None:
        self._poses[WORLD] = ORIGIN

    def add(self, scope: str, root: Element) -> None:
        """Add all that a model or world contains, and the models in it."""
        for element in root.all(*_SCOPED):
            name = element.attributes.get("name", "")
            key = join(scope, name)
            if not name or (SEPARATOR in name and self.version > FLATTENED) or name in (WORLD, MODEL):
                finding = f"the name {abbreviate(name)}" if name else f"a {element.tag} without a name"
                remedy = f"give a name other than {WORLD} and {MODEL}, without ::, which versions up to 1.7 may have"
                self.findings.fault(element, finding, remedy)
                continue
            if key in self.entries:
                finding = f"{abbreviate(name)} is already in line {self.entries[key].element.line}"
                self.findings.fault(element, finding, "give one of them another name")
                continue
            self.entries[key] = Entry(element, scope, key)
            if element.tag == "link":
                self._first.setdefault(scope, key)
            if element.tag == "model":
                self._inner.setdefault(scope, key)
                self.add(key, element)

    def all(self, tag: str) -> Iterator[Entry]:
        """Yield the entries of one kind, in the order of the file."""
        return (entry for entry in self.entries.values() if entry.element.tag == tag)

    def find(self, element: Element, name: str, scope: str) -> str | None:
        """Return the key of a name that an element mentions; a fault where there is none."""
        if name == MODEL and scope != WORLD:
            return scope
        if name == WORLD:
            return WORLD
        key = join(scope, name)
        if key in self.entries:
            return key
        inner = self.entries.get(key.removesuffix(f"{SEPARATOR}{MODEL}"))
        if inner is not None and inner.element.tag == "model":
            return inner.key
        inside = len(join(scope, ""))
        meant = nearest(name, [x[inside:] for x in self.entries if x.startswith(join(scope, ""))])
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a link, joint, frame or model beside it"
        self.findings.fault(element, f"there is no frame {abbreviate(name)}", remedy)
        return None

    def locate(self, key: str) -> Pose:
        """Return the pose of a frame in the world, in the pose of the file."""
        chain: dict[str, None] = {}  # ordered; no recursion, since files may be deep
        while key not in self._poses:
            if key in chain:
                remedy = "let relative_to, attached_to and child not circle"
                self.findings.fault(self.entries[key].element, "its pose depends on itself", remedy)
                self._poses[key] = ORIGIN
                break
            chain[key] = None
            key = self._find_outer(self.entries[key])
        pose = self._poses[key]
        for inner in reversed(chain):
            given = self.entries[inner].element.first("pose")
            pose = pose if given is None else pose @ self.read_pose(given)
            pose = self._poses[inner] = pose @ relate(self._find_placed(self.entries[inner]), ORIGIN)
        return pose

    def _find_placed(self, entry: Entry) -> Pose:
        """Return the pose, in its model, of the frame that a model's pose places: the model's own unless it says so."""
        name = entry.element.attributes.get("placement_frame", "")
        if not name or entry.element.tag != "model":
            return ORIGIN
        if entry.key not in self._placed:
            key = self.find(entry.element, name, entry.key)
            alone = replace(self, _poses={WORLD: ORIGIN, entry.key: ORIGIN})
            self._placed[entry.key] = ORIGIN if key is None else alone.locate(key)
        return self._placed[entry.key]

    def _find_outer(self, entry: Entry) -> str:
        """Return the frame in which the pose of an element is given."""
        given = entry.element.first("pose")
        if given is not None and given.attributes.get("frame"):
            remedy = "give relative_to, in version 1.7 or later"
            self.findings.fault(given, "a pose with a frame, which SDF never defined", remedy)
        if given is not None and (name := given.attributes.get("relative_to", "")):
            return self.find(given, name, entry.scope) or WORLD
        return self._find_default(entry) or WORLD

    def find_link(self, key: str) -> str:
        """Return the key of the link that carries a frame, or the world."""
        seen: dict[str, None] = {}
        while key not in self._links and self.entries[key].element.tag != "link":
            entry = self.entries[key]
            if key in seen:
                self.findings.fault(entry.element, "it is attached to itself", "let attached_to lead to a link")
                key = WORLD
                break
            seen[key] = None
            key = (self._find_canonical(entry) if entry.element.tag == "model" else self._find_default(entry)) or WORLD
        key = self._links.get(key, key)
        self._links.update(dict.fromkeys(seen, key))
        return key

    def _find_default(self, entry: Entry) -> str | None:
        """Return the frame that an element's pose is in unless it says otherwise, and that the element moves with."""
        match entry.element.tag:
            case "joint":
                child = entry.element.first("child")
                return None if child is None else self.find(child, child.text, entry.scope)
            case "frame" if name := entry.element.attributes.get("attached_to", ""):
                return self.find(entry.element, name, entry.scope)
        return entry.scope

    def _find_canonical(self, entry: Entry) -> str | None:
        """Return the link that a model's frame is attached to: its first link, else the first model's in it."""
        if name := entry.element.attributes.get("canonical_link", ""):
            return self.find(entry.element, name, entry.key)
        return self._first.get(entry.key, self._inner.get(entry.key, WORLD))

    def read_pose(self, element: Element) -> Pose:
        """Read a <pose>: a position, then roll, pitch and yaw, or a quaternion x, y, z, w."""
        form = self.findings.choice(element, "rotation_format", ("euler_rpy", "quat_xyzw"), element.attributes)
        text = {"pose": element.text or "0 0 0 0 0 0"}
        if form == "quat_xyzw":
            *position, x, y, z, w = self.findings.numbers(element, "pose", (0.0,) * 6 + (1.0,), attributes=text)
            if not any((x, y, z, w)):
                self.findings.fault(element, "a quaternion of length 0", "give x, y, z, w")
                return place(position)
            return Pose(turn_quaternion((w, x, y, z)), np.array(position))
        *position, roll, pitch, yaw = self.findings.numbers(element, "pose", (0.0,) * 6, attributes=text)
        if element.attributes.get("degrees", "").lower() in ("true", "1"):
            roll, pitch, yaw = map(math.radians, (roll, pitch, yaw))
        turns = ((2, self.writer.snap(yaw)), (1, self.writer.snap(pitch)), (0, self.writer.snap(roll)))
        return place(position, [(axis, angle) for axis, angle in turns if angle])

    def read_axis(self, joint: Entry, axis: Element | None) -> Array:
        """Read the direction of an <axis> or <axis2> in the joint's frame."""
        given = None if axis is None else axis.first("xyz")
        if axis is None or given is None:
            return np.array([0.0, 0.0, 1.0])
        direction = np.array(self.findings.numbers(given, "xyz", (0.0, 0.0, 1.0), attributes={"xyz": given.text}))
        if not direction.any():
            self.findings.fault(given, "an axis without direction", "give a nonzero one, e.g. 0 0 1")
            return np.array([0.0, 0.0, 1.0])
        name = given.attributes.get("expressed_in", "")
        if name:
            key = self.find(given, name, joint.scope)
        elif self.version <= IN_MODEL or (self.version <= AXES_BY_FLAG and read_flag(axis, "use_parent_model_frame")):
            key = joint.scope
        else:
            return direction
        turned: Array = relate(self.locate(joint.key), self.locate(key or joint.key)).rotation @ direction
        return turned


def join(scope: str, name: str) -> str:
    """Return the key of a name in a scope."""
    return name if scope == WORLD else f"{scope}{SEPARATOR}{name}"
