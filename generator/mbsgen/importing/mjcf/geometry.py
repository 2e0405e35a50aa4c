"""Mass and inertia of the primitive shapes of MJCF: of uniform density, or of uniform density per area on the surface.

A moment of inertia is the sum of two second moments of place, which surfaces have in closed form. The shell of an
ellipsoid is MuJoCo's: a layer by which each half axis grows by a micrometre, and the area by Thomsen's formula.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from mbsgen.importing.poses import Array
from mbsgen.importing.solids import Solid

Shape = tuple[float, Array]  # volume [m3], moments of inertia of unit mass about the axes through the centre [m2]


LAYER = 1e-6  # m, of the shell of an ellipsoid
THOMSEN = 1.6075


def make_solid(
    shape: str, size: Sequence[float], *, mass: float | None, density: float, is_shell: bool = False
) -> Solid:
    """Make the solid of a shape in its own frame, from a mass or a density, per area of a shell."""
    volume, moments = (SHELLS if is_shell else SHAPES)[shape](size)
    weight = density * volume if mass is None else mass
    return Solid(weight, np.zeros(3), np.diag(moments * weight))


def _measure_sphere(size: Sequence[float]) -> Shape:
    r = size[0]
    return 4 / 3 * math.pi * r**3, np.full(3, 2 / 5 * r * r)


def _measure_box(size: Sequence[float]) -> Shape:
    a, b, c = size
    return 8 * a * b * c, np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 3


def _measure_ellipsoid(size: Sequence[float]) -> Shape:
    a, b, c = size
    return 4 / 3 * math.pi * a * b * c, np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 5


def _measure_cylinder(size: Sequence[float]) -> Shape:
    r, h = size  # half its length
    across = (3 * r * r + 4 * h * h) / 12
    return 2 * math.pi * r * r * h, np.array([across, across, r * r / 2])


def _measure_capsule(size: Sequence[float]) -> Shape:
    """Measure a cylinder between two halves of a sphere, whose centres of mass are 3/8 r beyond its ends."""
    r, h = size
    tube, ball = 2 * math.pi * r * r * h, 4 / 3 * math.pi * r**3
    whole = tube + ball
    along = (tube * r * r / 2 + ball * 2 / 5 * r * r) / whole
    across = tube * (3 * r * r + 4 * h * h) / 12 + ball * (2 / 5 * r * r + h * h + 3 / 4 * h * r)
    return whole, np.array([across / whole, across / whole, along])


def _add_places(x: float, y: float, z: float) -> Array:
    """Return moments of inertia from second moments of place."""
    return np.array([y + z, x + z, x + y])


def _cover_sphere(size: Sequence[float]) -> Shape:
    r = size[0]
    return 4 * math.pi * r * r, np.full(3, 2 / 3 * r * r)


def _cover_box(size: Sequence[float]) -> Shape:
    faces = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    places = np.square(size) * (1 + 2 * faces / faces.sum()) / 3  # on two faces all is as far as it can be
    return 8 * float(faces.sum()), _add_places(*places)


def _cover_ellipsoid(size: Sequence[float]) -> Shape:
    inner, outer = np.array(size), np.array(size) + LAYER
    places = (outer.prod() * outer**2 - inner.prod() * inner**2) / (5 * (outer.prod() - inner.prod()))
    a, b, c = size
    mean = ((a * b) ** THOMSEN + (a * c) ** THOMSEN + (b * c) ** THOMSEN) / 3
    return 4 * math.pi * float(mean ** (1 / THOMSEN)), _add_places(*places)


def _cover_cylinder(size: Sequence[float]) -> Shape:
    r, h = size
    tube, disks = 4 * math.pi * r * h, 2 * math.pi * r * r
    across = (tube / 2 + disks / 4) * r * r / (tube + disks)
    return tube + disks, _add_places(across, across, (tube / 3 + disks) * h * h / (tube + disks))


def _cover_capsule(size: Sequence[float]) -> Shape:
    r, h = size
    tube, ball = 4 * math.pi * r * h, 4 * math.pi * r * r
    across = (tube / 2 + ball / 3) * r * r / (tube + ball)
    along = (tube * h * h / 3 + ball * (h * h + h * r + r * r / 3)) / (tube + ball)
    return tube + ball, _add_places(across, across, along)


SHELLS: Mapping[str, Callable[[Sequence[float]], Shape]] = MappingProxyType(  # with areas [m2]
    {
        "sphere": _cover_sphere,
        "capsule": _cover_capsule,
        "ellipsoid": _cover_ellipsoid,
        "cylinder": _cover_cylinder,
        "box": _cover_box,
    }
)
SHAPES: Mapping[str, Callable[[Sequence[float]], Shape]] = MappingProxyType(
    {
        "sphere": _measure_sphere,
        "capsule": _measure_capsule,
        "ellipsoid": _measure_ellipsoid,
        "cylinder": _measure_cylinder,
        "box": _measure_box,
    }
)
SIZES: Mapping[str, int] = MappingProxyType({"sphere": 1, "capsule": 2, "ellipsoid": 3, "cylinder": 2, "box": 3})
SPANNED = ("capsule", "cylinder", "ellipsoid", "box")  # shapes that may be given by two points
WEIGHTLESS = ("plane", "hfield")
