"""Geoms of MJCF -> rigid contacts with each other and with planes, if the choices ask for contacts.

- sphere; capsule; box; cylinder: the hull of points of its rims; mesh: its convex hull. Planes stand.
- Two geoms touch if the `contype` of one shares a bit with the `conaffinity` of the other, and no `exclude` names
  their bodies. Geoms that are welded to each other do not touch, nor a body and its carrier, unless the carrier stands
  or `filterparent` is disabled. A `pair` touches in any case.
- The friction is the larger sliding coefficient of both geoms; the one of higher `priority` decides alone; none where
  `condim` is 1. A `pair` may give both.

Other shapes are left out with a warning. MuJoCo's contacts give way, by `solref` and `solimp`; these are rigid, with
the restitution of the choices.

Source: MuJoCo, XML reference, `geom`, `contact`; Computation, collision detection, selection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.expressions import Number
from mbsgen.importing.closing import Spot
from mbsgen.importing.drafting import Draft
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.inheritance import MAIN, Defaults
from mbsgen.importing.mjcf.mesh_solids import MeshError
from mbsgen.importing.poses import Array, Pose, write_axis, write_triple
from mbsgen.model.model import ZERO, Block, Capsule, Contact, Grip, Hull, Other, Placement, Plane, Sphere

RIM = 16  # points of each rim of a cylinder
MOST = 100  # corners of a hull
ROUNDING = 1e-15  # of a normal of length 1
SLIDING = 1.0  # MuJoCo's coefficient of friction where none is given
Measure = Callable[[Element, Mapping[str, str], str], tuple[list[float], Pose]]  # of a shape: its size, and its pose
Enclose = Callable[[Element, Mapping[str, str]], tuple[Array, Pose]]  # of a mesh: the corners of its hull, its pose
Place = Callable[[Element, Mapping[str, str]], Pose]


@dataclass(frozen=True)
class Welded:
    """Bodies that nothing moves relative to each other."""

    number: int = 0  # 0: they stand
    above: int = 0  # the number of the ones that carry them


@dataclass(frozen=True, eq=False)
class Geom:
    """A geom that may touch others."""

    element: Element
    attributes: Mapping[str, str]
    spot: Spot  # the frame of its body, with the frames around it
    body: str  # its body's name in the file; "world"
    welded: Welded

    @property
    def shape(self) -> str:
        """Return its type."""
        return self.attributes.get("type", "sphere")

    @property
    def stands(self) -> bool:
        """Return whether nothing moves it."""
        return self.welded.number == 0

    @property
    def has_masks(self) -> bool:
        """Return whether a mask of it is not 0."""
        return any(self.attributes.get(mask, "1").strip() != "0" for mask in ("contype", "conaffinity"))

    @property
    def name(self) -> str:
        """Return its name, or its body's."""
        return self.attributes.get("name") or self.body or "contact"


@dataclass(frozen=True)
class _Shape:
    """A side of a contact, in the frame of its body."""

    pose: Pose
    radius: float = 0.0
    size: tuple[float, ...] | None = None
    points: tuple[tuple[float, ...], ...] = ()

    def touch(self, body: str, placement: Placement) -> Other:
        """Return the shape as the second side of a contact."""
        if self.size is not None:
            return Block(write_triple(self.size), body, placement)
        if not self.points:
            return Sphere(Number(self.radius), body, placement.position)
        if self.radius:
            return Capsule(Number(self.radius), Number(2 * self.points[1][2]), body, placement)
        return Hull(tuple(map(write_triple, self.points)), ZERO, body, placement)


@dataclass(frozen=True)
class _Pair:
    """Two geoms that may touch; the first one moves, and is not a plane."""

    first: Geom
    other: Geom
    given: tuple[Element, Mapping[str, str]] | None = None  # a `pair` of the file, with its attributes


@dataclass
class Contacts:
    """Collects the geoms of a file that may touch, and adds their contacts to a draft."""

    draft: Draft
    findings: Findings
    defaults: Defaults
    measure: Measure  # raises MeshError
    enclose: Enclose  # likewise
    place: Place
    filters_parents: bool  # a body does not touch the one that carries it
    geoms: list[Geom] = field(default_factory=list)
    _shapes: dict[Geom, _Shape | None] = field(default_factory=dict)

    def note(self, geom: Geom) -> None:
        """Note a geom; a plane or a height field that moves is a fault."""
        if geom.shape in ("plane", "hfield") and not geom.stands:
            text = f"a geom of the type {geom.shape} moves with its body, which MuJoCo refuses"
            self.findings.fault(geom.element, text, "give the body a box, or the world the plane")
        self.geoms.append(geom)

    @property
    def moving(self) -> list[Geom]:
        """List the geoms of bodies of the file that may touch others."""
        return [x for x in self.geoms if x.body != "world" and x.has_masks]

    def add(self, root: Element) -> None:
        """Add the contacts; notices say what is left out."""
        pairs = [*self._list_given(root), *self._list_masked(root)]
        if self.draft.choices.contacts_of == "planes":
            apart = sum(x.other.shape != "plane" for x in pairs)
            pairs = [x for x in pairs if x.other.shape == "plane"]
            if apart:
                text = f"{apart} pairs of geoms may touch besides: they pass through; planes alone were asked for"
                self.findings.sum_up(text, alters=True)
        made = [pair for pair in pairs if self._add(pair)]
        if not made:
            self.findings.sum_up("no geom of a body may touch another: no contacts are made")
            return
        text = f"{len(made)} contacts of geoms are rigid: MuJoCo's give way, by solref and solimp"
        self.findings.sum_up(text, alters=True)
        if among := sum(_is_of_solids(self._shapes[x.first], x.other) for x in made):
            text = f"{among} contacts are of solids with each other: only the method moreau simulates them"
            self.findings.sum_up(f"{text}; --contacts-of planes leaves them out")

    def _list_given(self, root: Element) -> Iterator[_Pair]:
        """List the pairs that the file gives by the names of their geoms."""
        known = {x.attributes["name"]: x for x in self.geoms if "name" in x.attributes}
        for element in (x for section in root.all("contact") for x in section.all("pair")):
            attributes = self.defaults.resolve(element, element.attributes.get("class", MAIN))
            names = [attributes.get(key, "") for key in ("geom1", "geom2")]
            if lacking := [x for x in names if x not in known]:
                self.findings.fault(element, f"there is no geom {abbreviate(lacking[0])}", "name two geoms")
                continue
            first, other = (known[x] for x in names)
            if first.welded.number == other.welded.number:
                self.findings.warn(element, "a pair of geoms is left out: they do not move relative to each other")
                continue
            if len(set(attributes.get("friction", "").split()[:2])) == 2:
                self.findings.warn(element, "friction that differs by direction is not made: the first one is used")
            yield _order(first, other, (element, attributes))

    def _list_masked(self, root: Element) -> Iterator[_Pair]:
        """List the pairs that touch by their masks, and have no `pair`."""
        sections = [*root.all("contact")]
        excluded = {
            frozenset(x.attributes.get(key, "") for key in ("body1", "body2"))
            for section in sections
            for x in section.all("exclude")
        }
        given = {
            frozenset(x.attributes.get(key, "") for key in ("geom1", "geom2"))
            for section in sections
            for x in section.all("pair")
        }
        geoms = [x for x in self.geoms if x.has_masks]
        for i, geom in enumerate(geoms):
            for other in geoms[:i]:
                names = {x.attributes.get("name") for x in (other, geom)}
                if names not in given and self._meet(other, geom, excluded):
                    yield _order(other, geom)

    def _meet(self, geom: Geom, other: Geom, excluded: set[frozenset[str]]) -> bool:
        """Return whether two geoms may touch by their masks."""
        first, second = geom.welded, other.welded
        if first.number == second.number or frozenset((geom.body, other.body)) in excluded:
            return False
        carried = first.number == second.above or second.number == first.above
        if self.filters_parents and carried and not (geom.stands or other.stands):
            return False
        (a, b), (c, d) = (
            [int(self._number(x, mask, 1.0)) for mask in ("contype", "conaffinity")] for x in (geom, other)
        )
        return bool((a & d) | (c & b))

    def _describe(self, geom: Geom) -> _Shape | None:
        """Describe the shape of a geom; None, and one warning, for one that has no contacts here."""
        if geom not in self._shapes:
            try:
                self._shapes[geom] = self._find_shape(geom)
            except MeshError as error:
                self.findings.warn(geom.element, f"it passes through all others: {error.finding}")
                self._shapes[geom] = None
        return self._shapes[geom]

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
        text = f"a cylinder touches others by the hull of {RIM} points of each rim"
        self.findings.tell(geom.element, text)
        return _Shape(pose, points=tuple(_list_rims(*half)))

    def _add(self, pair: _Pair) -> bool:
        """Add the contact of two geoms; return False, after a warning, where a shape has no contacts here."""
        geom, shape, other = pair.first, self._describe(pair.first), self._touch(pair.other)
        if shape is None or other is None:
            return False
        writer, restitution = self.draft.writer, self.draft.choices.contacts
        assert restitution is not None, "the choices ask for contacts"
        friction = self._combine(pair)
        is_plane = isinstance(other, Plane)
        contact = Contact(
            name=geom.name if is_plane else f"{geom.name}.{pair.other.name}",
            body=geom.spot.body,
            stiffness=ZERO,
            placement=writer.placement(shape.pose),
            radius=Number(shape.radius),
            size=None if shape.size is None else write_triple(shape.size),
            other=other,
            friction=None if friction is None else Grip(Number(friction), None),
            restitution=Number(restitution),
            points=tuple(map(write_triple, shape.points)),
        )
        self.draft.add_contact(contact, geom.element)
        return True

    def _touch(self, geom: Geom) -> Other | None:
        """Return a geom as the second side of contacts."""
        if geom.shape == "plane":
            seat = geom.spot.pose @ self.place(geom.element, geom.attributes)
            normal = np.where(np.abs(seat.rotation[:, 2]) < ROUNDING, 0.0, seat.rotation[:, 2])
            return Plane(geom.spot.body, write_triple(seat.position), write_axis(normal))
        shape = self._describe(geom)
        return None if shape is None else shape.touch(geom.spot.body, self.draft.writer.placement(shape.pose))

    def _combine(self, pair: _Pair) -> float | None:
        """Return the coefficient of sliding friction between two geoms; None without friction."""
        numbers = [
            (self._number(x, "priority", 0.0), self._number(x, "condim", 3.0), self._slide(x.element, x.attributes))
            for x in (pair.first, pair.other)
        ]
        first = max(priority for priority, _, _ in numbers)
        taken = [(condim, sliding) for priority, condim, sliding in numbers if priority == first]
        condim, coefficient = max(condim for condim, _ in taken), max(sliding for _, sliding in taken)
        if pair.given is not None:
            element, attributes = pair.given
            condim = self.findings.number(element, "condim", condim, attributes)
            if "friction" in attributes:
                coefficient = self._slide(element, attributes)
        return coefficient if condim > 1 and coefficient > 0 else None

    def _slide(self, element: Element, attributes: Mapping[str, str]) -> float:
        words = attributes.get("friction", "").split()
        if not words:
            return SLIDING
        return self.findings.number(element, "friction", SLIDING, {"friction": words[0]})

    def _number(self, geom: Geom, key: str, usual: float) -> float:
        return self.findings.number(geom.element, key, usual, geom.attributes)


def _order(first: Geom, other: Geom, given: tuple[Element, Mapping[str, str]] | None = None) -> _Pair:
    """Put first the geom that moves, and that is not a plane; then a sphere, which all methods simulate."""
    is_better = other.shape == "sphere" and first.shape != "sphere" and not other.stands
    if first.stands or first.shape == "plane" or is_better:
        first, other = other, first
    return _Pair(first, other, given)


def _is_of_solids(shape: _Shape | None, other: Geom) -> bool:
    """Return whether two solids touch at points that follow from their pose."""
    if shape is None or other.shape == "plane":
        return False
    return shape.size is not None or bool(shape.points) or other.shape in ("mesh", "cylinder")


def _list_rims(radius: float, half: float) -> Iterator[tuple[float, ...]]:
    for z in (-half, half):
        for k in range(RIM):
            angle = 2 * math.pi * k / RIM
            yield radius * math.cos(angle), radius * math.sin(angle), z
