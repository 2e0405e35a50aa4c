"""The equalities of MJCF -> loops, equations and followers of a draft.

- connect: two points coincide: a ball. Of an anchor in one body, the other body has the point in the pose of the file.
- weld: two frames coincide: a solid loop, or a ball at the anchor where `torquescale` is 0. Without `relpose`, the
  frames of the bodies keep their relative pose in the pose of the file.
- joint: y - y0 = c0 + c1 (x - x0) + ... + c4 (x - x0)^4 of the coordinates y, x of two joints, which are y0, x0 in the
  pose of the file; of one joint alone, y - y0 = c0.

Source: MuJoCo, XML reference, `equality`. MuJoCo's equalities are soft; loops and equations are exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.closing import Closure, Equation, Spot, Term
from mbsgen.importing.drafting import Draft
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.inheritance import MAIN, Defaults
from mbsgen.importing.poses import ORIGIN, Array, Pose, place
from mbsgen.importing.rotations import turn_quaternion
from mbsgen.model.model import BASE
from mbsgen.model.tree import Cut

T = TypeVar("T")

WORLD = "world"
SITES = ("site1", "site2")
SOFT = ("solref", "solimp")
NOISE = 1e-15  # m, and of a direction: the rounding of a 0 by poses in a row
_NO_POSE = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # MuJoCo's default: the quaternion is 0


@dataclass(frozen=True, eq=False)
class Place:
    """A body of the file."""

    spot: Spot
    home: Pose  # of its frame in the world, in the pose of the file


@dataclass(frozen=True)
class Coordinate:
    """A hinge or a slide of the file."""

    start: float  # its coordinate in the pose of the file
    is_driven: bool  # an actuator names it


@dataclass
class Register:
    """The bodies, joints and needed sites of a file, by name."""

    bodies: dict[str, Place] = field(default_factory=lambda: {WORLD: Place(Spot(BASE, ORIGIN), ORIGIN)})
    sites: dict[str, Spot] = field(default_factory=dict)
    coordinates: dict[str, Coordinate] = field(default_factory=dict)


def list_sites(root: Element) -> Iterator[str]:
    """Yield the names of the sites that equalities need."""
    for element in (element for section in root.all("equality") for element in section.children):
        yield from (element.attributes[key] for key in SITES if key in element.attributes)


def add_equalities(
    root: Element, register: Register, draft: Draft, defaults: Defaults, findings: Findings, *, are_disabled: bool
) -> None:
    """Close a draft as the sections `equality` of a file say, unless the file disables them."""
    reader = _Reader(register, draft, defaults, findings)
    elements = [element for section in root.all("equality") for element in section.children]
    if are_disabled:
        if elements:
            findings.tell(elements[0], "the file disables its equalities: they are left out")
        return
    if sum(reader.read(element) for element in elements):
        findings.sum_up("equalities are exact here, and soft in MuJoCo")


@dataclass(frozen=True)
class _Reader:
    """Reads one equality at a time."""

    register: Register
    draft: Draft
    defaults: Defaults
    findings: Findings

    def read(self, element: Element) -> bool:
        """Read an equality; return whether it closes the draft."""
        attributes = self.defaults.resolve(element, MAIN, "equality")
        known = {"connect": self._connect, "weld": self._weld, "joint": self._couple}
        if element.tag not in known:
            self.findings.warn(element, f"{element.tag[:40]} (equality) is not part of a model")
            return False
        if self.findings.choice(element, "active", ("true", "false"), attributes) == "false":
            self.findings.tell(element, "it is not active in the file: left out")
            return False
        if soft := [key for key in SOFT if key in attributes]:
            self.findings.tell(element, f"{' and '.join(soft)}: left out, since it is exact here")
        known[element.tag](element)
        return True

    # --- loops -------------------------------------------------------------------------------------------------------

    def _connect(self, element: Element) -> None:
        if (ends := self._find_points(element)) is not None:
            self._close(element, Cut.BALL, *ends)

    def _find_points(self, element: Element) -> tuple[Spot, Spot] | None:
        if _has_sites(element):
            sites = self._find_sites(element)
            return None if sites is None else _strip(sites)
        bodies = self._find_bodies(element)
        if "anchor" not in element.attributes:
            self.findings.fault(element, "a connect without an anchor", "give its point in body1: anchor")
        if bodies is None:
            return None
        one, other = bodies
        anchor = place(self.findings.numbers(element, "anchor", (0.0, 0.0, 0.0)))
        return _attach(one, anchor), _attach(other, place(_seen(other, one.home @ anchor).position))

    def _weld(self, element: Element) -> None:
        attributes = self.defaults.resolve(element, MAIN, "equality")
        ends = self._find_sites(element) if _has_sites(element) else self._find_frames(element)
        if ends is None:
            return
        cut = Cut.SOLID
        if "torquescale" in attributes:
            if self.findings.number(element, "torquescale", 1.0, attributes) == 0:
                cut = Cut.BALL
                ends = _strip(ends)
                self.findings.tell(element, "torquescale is 0: only the points of the anchor are kept together")
            else:
                self.findings.tell(element, "torquescale: left out, since it is exact here")
        self._close(element, cut, *ends)

    def _find_frames(self, element: Element) -> tuple[Spot, Spot] | None:
        bodies = self._find_bodies(element)
        if bodies is None:
            return None
        one, other = bodies
        anchor = place(self.findings.numbers(element, "anchor", (0.0, 0.0, 0.0)))
        relative = self._read_relative(element)
        relative = _seen(one, other.home @ anchor) if relative is None else relative
        return _attach(one, relative), _attach(other, anchor)

    def _read_relative(self, element: Element) -> Pose | None:
        """Read the pose of the second body, with the anchor as its origin, in the first; None without one."""
        *position, w, x, y, z = self.findings.numbers(element, "relpose", _NO_POSE)
        if not any((w, x, y, z)):
            return None
        rotation = turn_quaternion((w, x, y, z))
        return Pose(rotation, np.array(position), () if np.array_equal(rotation, np.eye(3)) else None)

    def _close(self, element: Element, cut: Cut, first: Spot, second: Spot) -> None:
        name = element.attributes.get("name", "") or f"{first.body} to {second.body}"
        self.draft.closing.closures.append(Closure(name, cut, first, second, element))

    def _find_bodies(self, element: Element) -> tuple[Place, Place] | None:
        given = element.attributes
        if "body1" not in given:
            self.findings.fault(element, f"a {element.tag} without body1", "name body1, and body2 or the world")
            return None
        return self._find(element, "body", given["body1"], given.get("body2", WORLD), self.register.bodies)

    def _find_sites(self, element: Element) -> tuple[Spot, Spot] | None:
        first, second = (element.attributes.get(key, "") for key in SITES)
        return self._find(element, "site", first, second, self.register.sites)

    def _find(self, element: Element, what: str, first: str, second: str, there: Mapping[str, T]) -> tuple[T, T] | None:
        for name in (first, second):
            if name not in there:
                meant = nearest(name, list(there))
                remedy = f"did you mean {abbreviate(meant)}?" if meant else f"name a {what} of the file"
                self.findings.fault(element, f"there is no {what} {abbreviate(name)}", remedy)
        return (there[first], there[second]) if first in there and second in there else None

    # --- coordinates -------------------------------------------------------------------------------------------------

    def _couple(self, element: Element) -> None:
        names = [element.attributes[key] for key in ("joint1", "joint2") if key in element.attributes]
        coefficients = self._read_polynomial(element)
        if "joint1" not in element.attributes:
            self.findings.fault(element, "a joint equality without joint1", "name the joint that depends on joint2")
        found = [self._is_coordinate(element, name) for name in names]
        if "joint1" not in element.attributes or not all(found):
            return
        own, *other = names
        if own in other:
            self.findings.fault(element, f"{abbreviate(own)} depends on itself", "name another joint as joint2")
            return
        if not (other and self._follow(element, own, other[0], coefficients)):
            self._equate(element, own, other, coefficients)

    def _read_polynomial(self, element: Element) -> tuple[float, ...]:
        """Read the five coefficients; the last ones that the file leaves out have their defaults."""
        given = element.attributes.get("polycoef", "").split()
        text = {"polycoef": " ".join([*given, *["0", "1", "0", "0", "0"][len(given) :]])}
        return self.findings.numbers(element, "polycoef", (0.0, 1.0, 0.0, 0.0, 0.0), attributes=text)

    def _is_coordinate(self, element: Element, name: str) -> bool:
        there = self.register.coordinates
        if name not in there:
            meant = nearest(name, list(there))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a hinge or a slide of the file"
            self.findings.fault(element, f"there is no hinge or slide {abbreviate(name)}", remedy)
        return name in there

    def _follow(self, element: Element, own: str, other: str, coefficients: tuple[float, ...]) -> bool:
        """Couple the two joints where the rule is linear; return False where neither can follow the other."""
        c0, c1, *rest = coefficients
        if any(rest) or not c1 or {own, other} & {name for name, _ in self.draft.choices.locked}:
            return False
        y, x = (self.register.coordinates[name] for name in (own, other))
        if y.is_driven and x.is_driven:
            return False
        if y.is_driven:
            own, other, c0, c1, y, x = other, own, -c0 / c1, 1 / c1, x, y
        offset = y.start + c0 - c1 * x.start
        if not self.draft.closing.couple(own, (other, c1, offset)):
            return False
        shown = f" + {offset:g}" if offset else ""
        text = f"joint {abbreviate(own)} has no coordinate: its q is {c1:g} times the q of {abbreviate(other)}{shown}"
        self.findings.tell(element, text)
        return True

    def _equate(self, element: Element, own: str, other: list[str], coefficients: tuple[float, ...]) -> None:
        start = self.register.coordinates[own].start
        terms = [Term(own, 1.0)]
        terms += [
            Term(name, -c, self.register.coordinates[name].start, power)
            for name in other
            for power, c in enumerate(coefficients[1:], 1)
        ]
        name = element.attributes.get("name", "") or " to ".join([own, *other])
        self.draft.closing.equations.append(Equation(name, tuple(terms), -start - coefficients[0], element))


def _has_sites(element: Element) -> bool:
    return any(key in element.attributes for key in SITES)


def _strip(ends: tuple[Spot, Spot]) -> tuple[Spot, Spot]:
    """Return the points of two frames."""
    first, second = (Spot(spot.body, place(spot.pose.position)) for spot in ends)
    return first, second


def _attach(body: Place, inner: Pose) -> Spot:
    """Return a frame on a body from its pose in the body's frame of the file."""
    return Spot(body.spot.body, _clean(body.spot.pose @ inner))


def _seen(body: Place, home: Pose) -> Pose:
    """Return a pose in the world as a pose in a body's frame of the file."""
    R = body.home.rotation
    return Pose(R.T @ home.rotation, R.T @ (home.position - body.home.position))


def _clean(pose: Pose) -> Pose:
    """Remove the rounding of zeros."""
    rotation, position = (_remove_noise(x) for x in (pose.rotation, pose.position))
    return Pose(rotation, position, () if np.array_equal(rotation, np.eye(3)) else pose.turns)


def _remove_noise(numbers: Array) -> Array:
    near = np.rint(numbers)
    return np.where(np.abs(numbers - near) <= NOISE, near, numbers)
