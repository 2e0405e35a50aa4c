"""Geoms of MJCF -> rigid contacts of moving bodies with planes that stand, if the choices ask for contacts.

- sphere; capsule: two spheres; box; cylinder: points of its rims; mesh: the corners of its convex hull.
- Two geoms touch if the `contype` of one shares a bit with the `conaffinity` of the other, and no `exclude` names their
  bodies. The friction is the larger sliding coefficient of both geoms; the one of higher `priority` decides alone;
  none where `condim` is 1.

What else may touch is left out with a warning: bodies among themselves, standing shapes other than planes, ellipsoids.
MuJoCo's contacts give way, by `solref` and `solimp`; these are rigid, with the restitution of the choices.

Source: MuJoCo, XML reference, `geom`; Computation, contact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from mbsgen.expressions import Number
from mbsgen.importing.closing import Spot
from mbsgen.importing.drafting import Draft
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.mesh_solids import MeshError
from mbsgen.importing.poses import Array, Pose, write_axis, write_triple
from mbsgen.model.model import ZERO, Contact, Grip, Plane

RIM = 16  # points of each rim of a cylinder
MOST = 100  # corners of a hull
ROUNDING = 1e-15  # of a normal of length 1
SLIDING = 1.0  # MuJoCo's coefficient of friction where none is given
Measure = Callable[[Element, Mapping[str, str], str], tuple[list[float], Pose]]  # of a shape: its size, and its pose
Enclose = Callable[[Element, Mapping[str, str]], tuple[Array, Pose]]  # of a mesh: the corners of its hull, its pose
Place = Callable[[Element, Mapping[str, str]], Pose]


@dataclass(frozen=True, eq=False)
class Geom:
    """A geom that may touch others."""

    element: Element
    attributes: Mapping[str, str]
    spot: Spot  # the frame of its body, with the frames around it
    body: str  # its body's name in the file; "world"
    stands: bool  # nothing moves it

    @property
    def shape(self) -> str:
        """Return its type."""
        return self.attributes.get("type", "sphere")


@dataclass(frozen=True)
class _Shape:
    """The first side of a contact, in the frame of its body."""

    pose: Pose
    radius: float = 0.0
    size: tuple[float, ...] | None = None
    points: tuple[tuple[float, ...], ...] = ()


@dataclass
class Contacts:
    """Collects the geoms of a file that may touch, and adds their contacts to a draft."""

    draft: Draft
    findings: Findings
    measure: Measure  # raises MeshError
    enclose: Enclose  # likewise
    place: Place
    geoms: list[Geom] = field(default_factory=list)

    def note(self, geom: Geom) -> None:
        """Note a geom, unless both its masks are 0."""
        if any(geom.attributes.get(mask, "1").strip() != "0" for mask in ("contype", "conaffinity")):
            self.geoms.append(geom)

    @property
    def moving(self) -> list[Geom]:
        """List the geoms of bodies of the file."""
        return [x for x in self.geoms if x.body != "world"]

    def add(self, root: Element) -> None:
        """Add the contacts with planes; notices say what is left out."""
        excluded = {
            frozenset((x.attributes.get("body1", ""), x.attributes.get("body2", "")))
            for section in root.all("contact")
            for x in section.all("exclude")
        }
        movers, planes = ([x for x in self.geoms if x.stands == stands] for stands in (False, True))
        others = [x for x in planes if x.shape != "plane"]
        planes = [x for x in planes if x.shape == "plane"]
        made = 0
        for geom in movers:
            met = [plane for plane in planes if self._meet(geom, plane, excluded)]
            shape = self._describe(geom) if met else None
            for plane in met if shape is not None else ():
                assert shape is not None, "it has one"
                self._add(geom, shape, plane)
                made += 1
        if made:
            text = f"{made} contacts of geoms with planes are rigid: MuJoCo's give way, by solref and solimp"
            self.findings.sum_up(text, alters=True)
        else:
            self.findings.sum_up("no geom of a body may touch a plane: no contacts are made")
        apart = sum(
            self._meet(x, y, excluded) for i, x in enumerate(movers) for y in movers[:i] if x.spot.body != y.spot.body
        )
        apart += sum(self._meet(x, y, excluded) for x in movers for y in others)
        if apart:
            text = f"{apart} pairs of geoms may touch besides: they pass through; contacts are made with planes alone"
            self.findings.sum_up(text, alters=True)

    def _meet(self, geom: Geom, other: Geom, excluded: set[frozenset[str]]) -> bool:
        """Return whether two geoms may touch."""
        (a, b), (c, d) = (
            [int(self._number(x, mask, 1.0)) for mask in ("contype", "conaffinity")] for x in (geom, other)
        )
        return bool((a & d) | (c & b)) and frozenset((geom.body, other.body)) not in excluded

    def _describe(self, geom: Geom) -> _Shape | None:
        """Describe the shape of a geom; None, and a warning, for one that has no contacts here."""
        try:
            return self._find_shape(geom)
        except MeshError as error:
            self.findings.warn(geom.element, f"it passes through planes: {error.finding}")
            return None

    def _find_shape(self, geom: Geom) -> _Shape:
        around, shape = geom.spot.pose, geom.shape
        if shape == "mesh":
            corners, own = self.enclose(geom.element, geom.attributes)
            if len(corners) > MOST:
                text = f"the hull of its mesh has {len(corners)} corners, where {MOST} are allowed"
                raise MeshError(text, "give the body a simpler geom")
            return _Shape(around @ own, points=tuple(map(tuple, corners.tolist())))
        if shape not in ("sphere", "capsule", "box", "cylinder"):
            raise MeshError(f"contacts of the type {shape[:40]} are not made", "give the body another geom")
        half, own = self.measure(geom.element, geom.attributes, shape)
        pose = around @ own
        match shape:
            case "sphere":
                return _Shape(pose, radius=half[0])
            case "box":
                return _Shape(pose, size=tuple(2 * x for x in half))
            case "capsule":
                return _Shape(pose, radius=half[0], points=((0.0, 0.0, -half[1]), (0.0, 0.0, half[1])))
        text = f"a cylinder touches planes by {RIM} points of each rim"
        self.findings.tell(geom.element, text)
        return _Shape(pose, points=tuple(_list_rims(*half)))

    def _add(self, geom: Geom, shape: _Shape, plane: Geom) -> None:
        seat = plane.spot.pose @ self.place(plane.element, plane.attributes)
        normal = np.where(np.abs(seat.rotation[:, 2]) < ROUNDING, 0.0, seat.rotation[:, 2])
        writer, restitution = self.draft.writer, self.draft.choices.contacts
        assert restitution is not None, "the choices ask for contacts"
        friction = self._combine(geom, plane)
        contact = Contact(
            name=geom.attributes.get("name") or geom.body or "contact",
            body=geom.spot.body,
            stiffness=ZERO,
            placement=writer.placement(shape.pose),
            radius=Number(shape.radius),
            size=None if shape.size is None else write_triple(shape.size),
            other=Plane(plane.spot.body, write_triple(seat.position), write_axis(normal)),
            friction=None if friction is None else Grip(Number(friction), None),
            restitution=Number(restitution),
            points=tuple(map(write_triple, shape.points)),
        )
        self.draft.add_contact(contact, geom.element)

    def _combine(self, geom: Geom, plane: Geom) -> float | None:
        """Return the coefficient of sliding friction between two geoms; None without friction."""
        numbers = [
            (self._number(x, "priority", 0.0), self._number(x, "condim", 3.0), self._slide(x)) for x in (geom, plane)
        ]
        first = max(priority for priority, _, _ in numbers)
        taken = [(condim, sliding) for priority, condim, sliding in numbers if priority == first]
        coefficient = max(sliding for _, sliding in taken)
        return coefficient if max(condim for condim, _ in taken) > 1 and coefficient > 0 else None

    def _slide(self, geom: Geom) -> float:
        words = geom.attributes.get("friction", "").split()
        if not words:
            return SLIDING
        return self.findings.number(geom.element, "friction", SLIDING, {"friction": words[0]})

    def _number(self, geom: Geom, key: str, usual: float) -> float:
        return self.findings.number(geom.element, key, usual, geom.attributes)


def _list_rims(radius: float, half: float) -> Iterator[tuple[float, ...]]:
    for z in (-half, half):
        for k in range(RIM):
            angle = 2 * math.pi * k / RIM
            yield radius * math.cos(angle), radius * math.sin(angle), z
