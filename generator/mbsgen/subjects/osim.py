"""A model of OpenSim and factors of its bodies -> the same model with other lengths, masses and inertias.

Everything that is fixed on a body is stretched along the axes of the frame that it is in, by the factors of the body:
offsets of frames, centres of mass, points of paths, markers, surfaces, pictures. Translations of a CustomJoint are
stretched by the factors of the parent, except axes whose amount is a coordinate. Inertias scale as the mass and the
square of the length where the three factors are equal; else a body is taken as a cylinder along the axis of its least
moment of inertia.

Source: OpenSim 4.6's documentation of Model::scale and of its ScaleTool; tests compare with its results. OpenSim takes
the sum of a_k f_k for the axis a of a translation; here it is the sum of a_k^2 f_k over |a|^2, which is 1 for factors
of 1, and the same for axes of the frame.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.frames import GROUND, OFFSET, Frames
from mbsgen.importing.osim.functions import FUNCTIONS
from mbsgen.importing.poses import Array
from mbsgen.importing.rotations import turn

Triple = tuple[float, float, float]
Change = Callable[[Element], Element]

SLIDES = ("translation1", "translation2", "translation3")
RADII = ("WrapCylinder", "WrapSphere", "WrapEllipsoid", "WrapTorus")
LENGTHS: Mapping[str, tuple[str, ...]] = {  # of lines, which scale as the line: elements of the kinds that have them
    "Ligament": ("resting_length",),
    "Blankevoort1991Ligament": ("slack_length",),
    "PathSpring": ("resting_length",),
    "ClutchedPathSpring": ("resting_length",),
}
MUSCLE_LENGTHS = ("optimal_fiber_length", "tendon_slack_length")
_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_UNEQUAL = 1e-14  # of factors that count as equal
_EMPTY: Mapping[str, str] = MappingProxyType({})


@dataclass
class Edits:
    """Changes of elements of one tree, applied together."""

    changes: dict[int, list[Change]] = field(default_factory=dict)  # by the id of an element

    def add(self, element: Element, change: Change) -> None:
        """Change an element; further changes of it follow."""
        self.changes.setdefault(id(element), []).append(change)

    def write(self, element: Element, text: str) -> None:
        """Replace the text of an element."""
        self.add(element, lambda x: replace(x, text=text))

    def apply(self, element: Element) -> Element:
        """Return the changed tree."""
        changed = element
        if element.children:
            changed = replace(element, children=tuple(map(self.apply, element.children)))
        for change in self.changes.get(id(element), ()):
            changed = change(changed)
        return changed


@dataclass(frozen=True)
class Masses:
    """The treatment of masses."""

    total: float | None = None  # of the scaled model [kg]; None: what follows from the factors
    keeps_distribution: bool = True  # the mass of no body follows its factors


def scale_osim(root: Element, factors: Mapping[str, Triple], masses: Masses) -> Element:
    """Scale all but the lengths of muscles and springs, which follow from the scaled model: `scale_lines`."""
    model = find_model(root)
    return _Scaling(model, factors, masses).run().apply(root)


def find_model(root: Element) -> Element:
    """Return the model of a file that has been read as one."""
    model = root.first("Model")
    assert model is not None, "the file has been imported"
    return model


def list_objects(model: Element, name: str) -> tuple[Element, ...]:
    """List the objects of a set of the model."""
    found = model.first(name)
    objects = None if found is None else found.first("objects")
    return () if objects is None else objects.children


def scale_lines(root: Element, ratios: Mapping[str, float]) -> Element:
    """Scale the lengths of fibres, slack tendons and slack springs of lines, by name."""
    edits = Edits()
    for line in list_objects(find_model(root), "ForceSet"):
        ratio = ratios.get(line.attributes.get("name", ""))
        for tag in LENGTHS.get(line.tag, MUSCLE_LENGTHS):
            child = line.first(tag)
            if ratio is not None and child is not None:
                edits.write(child, _write([_number(child) * ratio]))
    return edits.apply(root)


def list_lines(root: Element) -> dict[str, Element]:
    """List the muscles, springs and ligaments of a file whose lengths scale, by name."""
    return {
        line.attributes.get("name", ""): line
        for line in list_objects(find_model(root), "ForceSet")
        if line.tag in LENGTHS or line.first(MUSCLE_LENGTHS[0]) is not None
    }


def list_markers(root: Element) -> dict[str, Element]:
    """List the markers of a file, by name."""
    return {x.attributes.get("name", ""): x for x in list_objects(find_model(root), "MarkerSet") if x.tag == "Marker"}


def is_fixed(marker: Element) -> bool:
    """Return whether a file says that a marker must not be moved on its body."""
    child = marker.first("fixed")
    return child is not None and child.text.lower() in ("true", "1")


def move_markers(root: Element, shifts: Mapping[str, Sequence[float]]) -> Element:
    """Shift markers in their frames, by name [m]."""
    edits = Edits()
    for name, marker in list_markers(root).items():
        child = marker.first("location")
        if name in shifts and child is not None:
            edits.write(child, _write([a + b for a, b in zip(_numbers(child), shifts[name], strict=True)]))
    return edits.apply(root)


def list_bodies(root: Element) -> dict[str, Element]:
    """List the bodies of a file, without the ground, by name."""
    return Frames(find_model(root), Findings(root.file)).bodies


def read_mass(body: Element) -> float:
    """Return the mass of a body [kg]."""
    mass = body.first("mass")
    return 0.0 if mass is None else _number(mass)


def read_default(root: Element, coordinate: str) -> float:
    """Return the default value of a coordinate [rad or m]; 0 without one."""
    for element in root.walk():
        if element.tag == "Coordinate" and element.attributes.get("name", "") == coordinate:
            child = element.first("default_value")
            return 0.0 if child is None else _number(child)
    return 0.0


def set_solid(
    root: Element, name: str, mass: float | None, centre: Array | None, moments: Sequence[float] | None
) -> Element:
    """Set the mass of a body, its centre and its inertia about it; without moments, they grow with the mass."""
    edits, body = Edits(), list_bodies(root)[name]
    old, children = _read_moments(body)
    held, place = body.first("mass"), body.first("mass_center")
    if mass is not None and held is not None:
        edits.write(held, _write([mass]))
        moments = [x * mass / _number(held) for x in old] if moments is None else moments
    if centre is not None and place is not None:
        edits.write(place, _write(centre.tolist()))
    _write_moments(edits, children, old if moments is None else moments)
    return edits.apply(root)


class _Scaling:
    """The changes of one file."""

    def __init__(self, model: Element, factors: Mapping[str, Triple], masses: Masses) -> None:
        self._model, self._factors, self._masses = model, factors, masses
        self._frames = Frames(model, Findings(model.file))
        self._edits = Edits()

    def run(self) -> Edits:
        """List all changes."""
        for element in self._model.walk():
            self._scale_component(element)
        for joint, body in self._list_joints():
            self._scale_joint(joint, body)
        for body in self._frames.bodies.values():
            self._scale_solid(body)
        self._fix_total()
        return self._edits

    def _of(self, body: str) -> Triple:
        return self._factors.get(body, (1.0, 1.0, 1.0))

    def _stretch(self, holder: Element, tag: str, body: str) -> None:
        """Multiply the three numbers of a child of an element by the factors of a body."""
        child = holder.first(tag)
        if child is not None and child.text:
            self._edits.write(child, _write([a * b for a, b in zip(_numbers(child), self._of(body), strict=True)]))

    def _find(self, element: Element | None, owner: Element) -> str:
        mount = None if element is None else self._frames.find(element, owner)
        return "" if mount is None else mount.body

    def _scale_component(self, element: Element) -> None:
        """Scale what is fixed on a body, apart from joints and inertias."""
        name = element.attributes.get("name", "")
        if element.tag == OFFSET:
            body = self._find(element.first("socket_parent"), element)
            self._stretch(element, "translation", body)
            self._dress(element, body)
            self._scale_surfaces(element, body)
        elif element.tag in ("Body", "Ground"):
            body = name or GROUND
            self._stretch(element, "mass_center", body)
            self._dress(element, body)
            self._scale_surfaces(element, body)
        elif element.tag in ("Marker", "PathPoint", "ConditionalPathPoint", "Station", "MovingPathPoint"):
            socket, old = element.first("socket_parent_frame"), element.first("body")
            body = self._find(socket, element) if old is None else old.text
            self._stretch(element, "location", body)
            if element.tag == "MovingPathPoint":
                self._scale_functions(element, body)
        elif element.tag in ("WeldConstraint", "PointConstraint"):
            for k in (1, 2):
                old = element.first(f"body_{k}")
                if old is not None:
                    self._stretch(element, f"location_body_{k}", old.text)

    def _scale_functions(self, point: Element, body: str) -> None:
        for axis, factor in zip("xyz", self._of(body), strict=True):
            holder = point.first(f"{axis}_location")
            if holder is not None and factor != 1:
                self._edits.add(holder, functools.partial(_multiply, factor=factor))

    def _dress(self, element: Element, body: str) -> None:
        """Stretch the pictures on a frame, in proportion to the frame."""
        held = [x for tag in ("attached_geometry", "VisibleObject") for x in element.all(tag)]
        shown = [child for x in held for child in ((x,) if x.tag == "VisibleObject" else x.children)]
        for geometry in shown:
            if geometry.first("scale_factors") is not None:
                self._stretch(geometry, "scale_factors", body)
            elif self._of(body) != (1.0, 1.0, 1.0):
                added = replace(
                    geometry, tag="scale_factors", attributes=_EMPTY, children=(), text=_write(self._of(body))
                )
                self._edits.add(geometry, functools.partial(_append, child=added))

    def _scale_surfaces(self, element: Element, body: str) -> None:
        held = element.first("WrapObjectSet")
        objects = None if held is None else held.first("objects")
        for surface in () if objects is None else objects.children:
            self._scale_surface(surface, body)

    def _scale_surface(self, surface: Element, body: str) -> None:
        self._stretch(surface, "translation", body)
        turns = surface.first("xyz_body_rotation")
        R = np.eye(3)
        for k, angle in enumerate(() if turns is None or not turns.text else _numbers(turns)):
            R = R @ turn(np.eye(3)[k], angle)
        along = np.linalg.norm(np.array(self._of(body))[:, None] * R, axis=0)  # of x, y, z of the surface
        round_, all_ = float(along[:2].mean()), float(np.mean(self._of(body)))
        own: Mapping[str, Mapping[str, float]] = {
            "WrapCylinder": {"radius": round_, "length": float(along[2])},
            "WrapSphere": {"radius": all_},
            "WrapTorus": {"inner_radius": round_, "outer_radius": round_},
        }
        for tag, factor in own.get(surface.tag, {}).items():
            child = surface.first(tag)
            if child is not None:
                self._edits.write(child, _write([_number(child) * factor]))
        dimensions = surface.first("dimensions")
        if surface.tag == "WrapEllipsoid" and dimensions is not None:
            sizes = [a * b for a, b in zip(_numbers(dimensions), along.tolist(), strict=True)]
            self._edits.write(dimensions, _write(sizes))

    # --- joints ------------------------------------------------------------------------------------------------------

    def _list_joints(self) -> list[tuple[Element, Element | None]]:
        """List joints, and the bodies that they stand in."""
        found: list[tuple[Element, Element | None]] = [(x, None) for x in list_objects(self._model, "JointSet")]
        for body in self._frames.bodies.values():
            holder = body.first("Joint")
            found += [(x, body) for x in (() if holder is None else holder.children)]
        return found

    def _scale_joint(self, joint: Element, body: Element | None) -> None:
        if body is None:
            parent = self._find(joint.first("socket_parent_frame"), joint)
        else:
            held = joint.first("parent_body")
            parent = "" if held is None else held.text
            self._stretch(joint, "location_in_parent", parent)
            self._stretch(joint, "location", body.attributes.get("name", ""))
        transform = joint.first("SpatialTransform")
        for axis in () if transform is None else transform.all("TransformAxis"):
            if axis.attributes.get("name") in SLIDES:
                self._scale_slide(axis, self._of(parent))

    def _scale_slide(self, axis: Element, factors: Triple) -> None:
        holder = axis.first("function")
        function = next((x for x in (axis if holder is None else holder).children if x.tag in FUNCTIONS), None)
        if function is None or _is_coordinate(function):
            return
        child = axis.first("axis")
        direction = np.array([1.0, 0.0, 0.0] if child is None else _numbers(child)) ** 2
        factor = float(direction @ factors / direction.sum())
        if factor != 1:
            self._edits.add(axis if holder is None else holder, functools.partial(_multiply, factor=factor))

    # --- masses ------------------------------------------------------------------------------------------------------

    def _scale_solid(self, body: Element) -> None:
        factors, mass = self._of(body.attributes.get("name", "")), body.first("mass")
        m = 0.0 if mass is None else _number(mass)
        moments, children = _read_moments(body)
        grown = 1.0 if self._masses.keeps_distribution else abs(math.prod(factors))
        if mass is not None:
            self._edits.write(mass, _write([m * grown]))
        _write_moments(self._edits, children, scale_moments(m, moments, factors, grown))

    def _fix_total(self) -> None:
        if self._masses.total is None:
            return
        grown = [
            _number(self._edits.apply(mass))
            for x in self._frames.bodies.values()
            if (mass := x.first("mass")) is not None
        ]
        ratio = self._masses.total / sum(grown)
        for body in self._frames.bodies.values():
            mass, children = body.first("mass"), _read_moments(body)[1]
            for child in [] if mass is None else [mass, *children]:
                self._edits.add(child, functools.partial(_enlarge, ratio=ratio))


def scale_moments(m: float, moments: Sequence[float], factors: Triple, grown: float) -> tuple[float, ...]:
    """Scale xx, yy, zz, xy, xz, yz about the centre of mass, of a body of mass m; `grown` is the factor of the mass."""
    x, y, z = map(abs, factors)
    if m * grown <= np.finfo(float).eps:
        return (0.0,) * 6
    if max(x, y, z) - min(x, y, z) <= _UNEQUAL:
        return tuple(a * grown * x * x for a in moments)
    about = int(np.argmin(moments[:3]))  # the axis of a cylinder
    other = 1 if about == 0 else 0
    squared = max(2 * moments[about] / m, 0.0)  # its radius
    length = math.sqrt(max(12 * (moments[other] - 0.25 * m * squared) / m, 0.0)) * factors[about]
    across = squared * math.prod(f for k, f in enumerate(factors) if k != about)
    wide = m * grown * (length * length / 12 + 0.25 * across)
    diagonal = [0.5 * m * grown * across if k == about else wide for k in range(3)]
    pairs = ((0, 1), (0, 2), (1, 2))
    return (*diagonal, *(a * grown * factors[i] * factors[j] for a, (i, j) in zip(moments[3:], pairs, strict=True)))


def _read_moments(body: Element) -> tuple[list[float], list[Element]]:
    """Return the moments of a body, and the elements that have them: one, or six."""
    whole = body.first("inertia")
    if whole is not None:
        return _numbers(whole), [whole]
    children = [x for key in _MOMENTS if (x := body.first(f"inertia_{key}")) is not None]
    found = {x.tag.removeprefix("inertia_"): _number(x) for x in children}
    return [found.get(key, 0.0) for key in _MOMENTS], children


def _write_moments(edits: Edits, children: Sequence[Element], moments: Sequence[float]) -> None:
    for child in children:
        own = moments if child.tag == "inertia" else [moments[_MOMENTS.index(child.tag.removeprefix("inertia_"))]]
        edits.write(child, _write(own))


def _is_coordinate(function: Element) -> bool:
    """Return whether the amount of an axis is a coordinate itself, which no factor changes."""
    child = function.first("coefficients")
    if function.tag != "LinearFunction":
        return False
    return child is None or _numbers(child)[:2] == [1.0, 0.0]


def _enlarge(element: Element, ratio: float) -> Element:
    return replace(element, text=_write([x * ratio for x in _numbers(element)]))


def _append(element: Element, child: Element) -> Element:
    return replace(element, children=(*element.children, child))


def _multiply(holder: Element, factor: float) -> Element:
    """Return an element whose function is multiplied by a factor."""
    place = next(k for k, x in enumerate(holder.children) if x.tag in FUNCTIONS)
    function = holder.children[place]
    scale = function.first("scale")
    if function.tag == "MultiplierFunction" and scale is not None:
        new = replace(scale, text=_write([_number(scale) * factor]))
        changed = replace(function, children=tuple(new if x is scale else x for x in function.children))
    else:
        inner = replace(function, tag="function", attributes=_EMPTY, children=(function,), text="")
        scale = replace(function, tag="scale", attributes=_EMPTY, children=(), text=_write([factor]))
        changed = replace(function, tag="MultiplierFunction", children=(inner, scale), text="")
    return replace(holder, children=(*holder.children[:place], changed, *holder.children[place + 1 :]))


def _numbers(element: Element) -> list[float]:
    return [float(x) for x in element.text.split()]


def _number(element: Element) -> float:
    return float(element.text)


def _write(numbers: Sequence[float]) -> str:
    return " ".join(map(repr, map(float, numbers)))
