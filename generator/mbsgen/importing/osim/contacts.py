"""Contacts of OpenSim: spheres that press on half spaces and spheres -> contacts with OpenSim's laws.

A half space lies where the x axis of its frame points. With a modulus E, a sphere of radius R has the Hertz stiffness
4/3 k sqrt(R k), k = E^(2/3)/2; the dissipation of the file grows by 3/2. A HuntCrossleyForce presses between all of its
geometry on different bodies: k = k1 k2/(k1 + k2) with k_i = E_i^(2/3), dissipations in shares of the depths, radii
R1 R2/(R1 + R2) of two spheres, and harmonic means of coefficients of friction.

Source: OpenSim's documentation of these forces; Sherman, Seth, Delp (2011), and Simbody's documentation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.expressions import Number
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.forces import is_on
from mbsgen.importing.osim.frames import Frames, Mount
from mbsgen.importing.poses import Pose
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.model import Grip

SMOOTH, BLUNT = "SmoothSphereHalfSpaceForce", "HuntCrossleyForce"
CONTACTS = (SMOOTH, BLUNT)
SPHERE, HALF_SPACE = "ContactSphere", "ContactHalfSpace"
SETS, PARAMETERS = "HuntCrossleyForce::ContactParametersSet", "HuntCrossleyForce::ContactParameters"
_NUMBERS: Mapping[str, float] = {  # of materials, with OpenSim's defaults
    "stiffness": 1.0,
    "dissipation": 0.0,
    "static_friction": 0.0,
    "dynamic_friction": 0.0,
    "viscous_friction": 0.0,
}
_SPEED = ("transition_velocity", 0.01)
_SMOOTHING: Mapping[str, tuple[str, float]] = {
    "rounding": ("constant_contact_force", 1e-5),
    "depth_slope": ("hertz_smoothing", 300.0),
    "speed_slope": ("hunt_crossley_smoothing", 50.0),
}
_POSITIVE = ("stiffness", "radius", _SPEED[0], "hertz_smoothing", "hunt_crossley_smoothing")


@dataclass(frozen=True, eq=False)
class Shape:
    """A sphere, or a half space, on a body of the file."""

    name: str
    mount: Mount
    radius: float | None  # None: a half space

    @property
    def normal(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """Return the normal out of a half space, in the body's frame."""
        return -self.mount.pose.rotation[:, 0]


@dataclass(frozen=True, eq=False)
class Touch:
    """A sphere that presses on another shape."""

    name: str
    element: Element
    sphere: Shape
    other: Shape
    stiffness: float
    dissipation: float
    friction: Grip | None
    law: SphereLaw


@dataclass(frozen=True)
class _Material:
    modulus: float  # to the power of 2/3
    dissipation: float
    frictions: tuple[float, ...]  # static, dynamic, viscous


class Touching:
    """Reads the contacts of a file."""

    def __init__(self, model: Element, frames: Frames, findings: Findings) -> None:
        self._frames = frames
        self._findings = findings
        held = [model.first(x) for x in ("ContactGeometrySet", "ComponentSet")]
        objects = [x.first("objects") for x in held if x is not None] + [model.first("components")]
        given = [each for x in objects if x is not None for each in x.children if each.tag.startswith("Contact")]
        self._elements = {x.attributes.get("name", ""): x for x in given}
        self._shapes: dict[str, Shape | None] = {}

    def read(self, element: Element) -> list[Touch]:
        """Read a force of CONTACTS; nothing, with a notice or faults, where there is none."""
        if not is_on(element):
            self._findings.tell(element, "it is switched off in the file: left out")
            return []
        before = len(self._findings.faults)
        found = [*(self._read_smooth(element) if element.tag == SMOOTH else self._read_blunt(element))]
        if not found and len(self._findings.faults) == before:
            self._findings.warn(element, "it has no spheres that touch anything on another body: left out")
        return found

    def _read_smooth(self, element: Element) -> Iterator[Touch]:
        names = [self._read_name(element, f"socket_{key}") for key in ("sphere", "half_space")]
        sphere, plane = (self._find(name, element) for name in names)
        if sphere is None or plane is None:
            return
        if sphere.radius is None or plane.radius is not None:
            remedy = "let socket_sphere name a ContactSphere, and socket_half_space a ContactHalfSpace"
            self._findings.fault(element, "it needs a sphere and a half space", remedy)
            return
        material = self._read_material(element)
        numbers = {key: Number(self._number(element, *given)) for key, given in _SMOOTHING.items()}
        k = material.modulus / 2
        name = element.attributes.get("name", "") or sphere.name
        law = SphereLaw("smooth", **numbers)
        yield self._make(element, name, sphere, plane, (k, material.dissipation), material.frictions, law)

    def _read_blunt(self, element: Element) -> Iterator[Touch]:
        materials = [*self._list_materials(element)]
        shapes = [(shape, material) for shape, material in materials if shape is not None]
        for (first, one), (second, two) in itertools.combinations(shapes, 2):
            if first.mount.body == second.mount.body or first.radius is second.radius is None:
                continue
            (sphere, soft), (other, hard) = ((first, one), (second, two))
            if sphere.radius is None:
                (sphere, soft), (other, hard) = (other, hard), (sphere, soft)
            share = hard.modulus / (soft.modulus + hard.modulus)
            loss = soft.dissipation * share + hard.dissipation * (1 - share)
            pairs = zip(soft.frictions, hard.frictions, strict=True)
            frictions = tuple(a if a == b else 2 * a * b / (a + b) for a, b in pairs)
            name = f"{element.attributes.get('name', '') or 'contact'}_{sphere.name}_{other.name}"
            law = SphereLaw("hunt_crossley", share=Number(share))
            yield self._make(element, name, sphere, other, (soft.modulus * share, loss), frictions, law)

    def _list_materials(self, element: Element) -> Iterator[tuple[Shape | None, _Material]]:
        held = element.first(SETS) or element.first("contact_parameters")
        objects = None if held is None else held.first("objects")
        for given in () if objects is None else objects.children:
            material = self._read_material(given)
            for name in self._read_name(given, "geometry", whole=True).split():
                yield self._find(name, given), material

    def _read_material(self, element: Element) -> _Material:
        modulus, dissipation, *frictions = (self._number(element, *pair) for pair in _NUMBERS.items())
        return _Material(abs(modulus) ** (2 / 3), dissipation, tuple(frictions))

    def _make(
        self,
        element: Element,
        name: str,
        sphere: Shape,
        other: Shape,
        press: tuple[float, float],
        frictions: tuple[float, ...],
        law: SphereLaw,
    ) -> Touch:
        """Make a contact by its Hertz modulus and dissipation, and its coefficients of friction."""
        assert sphere.radius is not None, "a sphere"
        (k, loss), r, R = press, sphere.radius, other.radius
        radius = r if R is None else r * R / (r + R)
        static, dynamic, viscous = frictions
        friction = Grip(Number(dynamic), Number(self._number(element, *_SPEED))) if any(frictions) else None
        if friction is not None:
            law = replace(law, static=None if static == dynamic else Number(static), viscous=Number(viscous))
        stiffness = 4 / 3 * k * math.sqrt(radius * k)
        return Touch(name, element, sphere, other, stiffness, 1.5 * loss, friction, law)

    def _find(self, name: str, user: Element) -> Shape | None:
        """Find the geometry of a name; None with a warning or a fault."""
        if name not in self._elements:
            meant = nearest(name, list(self._elements))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name one of the ContactGeometrySet"
            self._findings.fault(user, f"there is no contact geometry {abbreviate(name)}", remedy)
            return None
        if name not in self._shapes:
            self._shapes[name] = self._read_shape(name, self._elements[name])
        return self._shapes[name]

    def _read_shape(self, name: str, element: Element) -> Shape | None:
        if element.tag not in (SPHERE, HALF_SPACE):
            self._findings.warn(element, f"a {element.tag[:40]}, which is not read: it touches nothing")
            return None
        frame, body = element.first("socket_frame"), element.first("body_name")
        if frame is None and body is not None:
            mount = self._frames.find_body(body, element)
        else:
            mount = self._frames.find(frame, element)
        if mount is None:
            return None
        pose = mount.pose @ self._frames.read_pose(element)
        if element.tag == HALF_SPACE:
            return Shape(name, Mount(mount.body, pose), None)
        seat = Pose(np.eye(3), pose.position, ())
        return Shape(name, Mount(mount.body, seat), self._number(element, "radius", 0.0))

    def _read_name(self, element: Element, tag: str, *, whole: bool = False) -> str:
        child = element.first(tag)
        text = "" if child is None else child.text
        return text if whole else text.rsplit("/", 1)[-1]

    def _number(self, element: Element, tag: str, default: float) -> float:
        child = element.first(tag)
        value = default if child is None else self._findings.number(child, tag, default, {tag: child.text})
        if value < 0 or (value == 0 and tag in _POSITIVE):
            least = "more than 0" if tag in _POSITIVE else "0 or more"
            self._findings.fault(child or element, f"{tag} is {value:g}", f"give {least}")
        return value
