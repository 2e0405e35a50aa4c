"""Frames of OpenSim: bodies, and frames at offsets to them -> the body that carries each, and the pose on it.

Components of version 4 have paths such as /jointset/hip_r/pelvis_offset; a component names another one by its path, or
by the path from itself. Versions 2.3 to 3 name bodies. Orientations are turns about x, y and z, each turned by those
before it.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Array, Pose, place

GROUND = "ground"
OFFSET = "PhysicalOffsetFrame"
_SETS = ("BodySet", "JointSet", "ConstraintSet", "ForceSet", "MarkerSet", "ComponentSet")
_HELD = (*_SETS, "objects", "components", "frames", "Joint")  # elements that only hold components


@dataclass(frozen=True, eq=False)
class Mount:
    """A frame on a body of the file."""

    body: str
    pose: Pose = ORIGIN


@dataclass
class Frames:
    """The bodies and frames of a file, by their paths."""

    model: Element
    findings: Findings
    bodies: dict[str, Element] = field(default_factory=dict)
    paths: dict[int, str] = field(default_factory=dict)  # of elements, by id
    _bodies: dict[str, str] = field(default_factory=dict)  # by path
    _offsets: dict[str, Element] = field(default_factory=dict)  # by path
    _mounts: dict[str, Mount] = field(default_factory=dict)  # of offsets that have been found

    def __post_init__(self) -> None:
        self._bodies[f"/{GROUND}"] = GROUND
        for element, path in _walk(self.model, ""):
            self.paths[id(element)] = path
            name = element.attributes.get("name", "")
            if element.tag == OFFSET:
                self._offsets.setdefault(path, element)
            elif element.tag == "Body":
                if not name:
                    self.findings.fault(element, "a body without a name", "name it")
                elif name in self.bodies:
                    text = f"a second body {abbreviate(name)}: line {self.bodies[name].line} has the first"
                    self.findings.fault(element, text, "rename one")
                elif name != GROUND:
                    self.bodies[name] = element
                    self._bodies[path] = name

    def find_body(self, element: Element | None, source: Element) -> Mount | None:
        """Find the body that an element of version 2 or 3 names; a fault where there is none."""
        name = "" if element is None else element.text
        if name == GROUND or name in self.bodies:
            return Mount(name)
        meant = nearest(name, [GROUND, *self.bodies])
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a body of the file, or ground"
        found = f"there is no body {abbreviate(name)}" if name else "it names no body"
        self.findings.fault(source if element is None else element, found, remedy)
        return None

    def find_named(self, owner: Element, tag: str) -> Mount | None:
        """Find the body that a child of an element names, by its name or its path; a fault where there is none."""
        child = owner.first(tag)
        is_path = child is not None and "/" in child.text
        return self.find(child, owner) if is_path else self.find_body(child, owner)

    def find(self, element: Element | None, owner: Element) -> Mount | None:
        """Find the frame that an element of version 4 names in a component; a fault where there is none."""
        if element is None or not element.text:
            self.findings.fault(owner if element is None else element, "it names no frame", "give the path of one")
            return None
        return self._locate(element, self.paths.get(id(owner), ""), ())

    def _locate(self, element: Element, owner: str, before: tuple[str, ...]) -> Mount | None:
        path = self._complete(element, owner)
        return None if path is None else self._follow(path, element, before)

    def _follow(self, path: str, element: Element, before: tuple[str, ...]) -> Mount | None:
        if path in self._bodies:
            return Mount(self._bodies[path])
        if path in before:
            self.findings.fault(element, "its frames are at offsets to each other, in a circle", "begin at a body")
            return None
        if path not in self._mounts:
            offset = self._offsets[path]
            parent = offset.first("socket_parent")
            if parent is None or not parent.text:
                self.findings.fault(offset, "a frame without a socket_parent", "give the path of the frame it is on")
                return None
            carrier = self._locate(parent, path, (*before, path))
            if carrier is None:
                return None
            self._mounts[path] = Mount(carrier.body, carrier.pose @ self.read_pose(offset, "translation"))
        return self._mounts[path]

    def _complete(self, element: Element, owner: str) -> str | None:
        """Return the whole path of the frame that an element names."""
        there = (*self._bodies, *self._offsets)
        path = posixpath.normpath(posixpath.join(owner or "/", element.text))
        if path in there:
            return path
        alike = [each for each in there if posixpath.basename(each) == posixpath.basename(path)]
        if len(alike) == 1:
            return alike[0]
        meant = nearest(path, list(there))
        if alike:
            remedy = f"give the whole path: {' or '.join(map(abbreviate, alike[:3]))}"
        else:
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "give the path of a body, a frame, or /ground"
        self.findings.fault(element, f"there is no frame {abbreviate(element.text)}", remedy)
        return None

    @property
    def surfaces(self) -> dict[str, tuple[Element, Mount]]:
        """Return the surfaces around which paths may wrap, by name, with the frames that carry them."""
        found: dict[str, tuple[Element, Mount]] = {}
        for owner in _list_carriers(self.model):
            held = owner.first("WrapObjectSet")
            objects = None if held is None else held.first("objects")
            if objects is None or not objects.children:
                continue
            name = owner.attributes.get("name", "")
            path = self.paths.get(id(owner), "")
            mount = self._follow(path, owner, ()) if owner.tag == OFFSET else Mount(name or GROUND)
            if mount is None:
                continue
            for surface in objects.children:
                found.setdefault(surface.attributes.get("name", ""), (surface, mount))
        return found

    def read_pose(self, element: Element, position: str = "location", orientation: str = "orientation") -> Pose:
        """Read the pose that two children of an element give."""
        turns = self.read_vector(element, orientation)
        return place(self.read_vector(element, position), [(k, x) for k, x in enumerate(turns) if x])

    def read_vector(self, element: Element, tag: str) -> tuple[float, ...]:
        """Read three numbers, 0 by default."""
        child = element.first(tag)
        zero = (0.0, 0.0, 0.0)
        return zero if child is None else self.findings.numbers(child, tag, zero, attributes={tag: child.text})


def _list_carriers(element: Element) -> Iterator[Element]:
    """List the bodies, the ground and the offset frames in an element."""
    for child in element.children:
        if child.tag in ("Body", "Ground", OFFSET):
            yield child
        yield from _list_carriers(child)


def _walk(element: Element, path: str) -> Iterator[tuple[Element, str]]:
    """Yield the components in an element, with their paths."""
    for child in element.children:
        own = path
        if child.tag in _SETS:
            own = f"/{child.attributes.get('name', child.tag.lower())}"
        elif child.tag not in _HELD:
            if "name" not in child.attributes and child.tag != "Body":
                continue
            own = f"{path}/{child.attributes.get('name', '')}"
            yield child, own
        yield from _walk(child, own)


def invert(pose: Pose) -> Pose:
    """Return the pose of the other frame in this one."""
    turns = None if pose.turns is None else tuple((axis, -angle) for axis, angle in pose.turns[::-1])
    position: Array = -(pose.rotation.T @ pose.position)
    return Pose(pose.rotation.T, np.where(position == 0, 0.0, position), turns)
