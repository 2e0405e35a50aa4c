"""Mass and inertia of the primitive shapes of MJCF, of uniform density."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from mbsgen.importing.poses import Array
from mbsgen.importing.solids import Solid

Shape = tuple[float, Array]  # volume [m3], moments of inertia of unit mass about the axes through the centre [m2]


def make_solid(shape: str, size: Sequence[float], *, mass: float | None, density: float) -> Solid:
    """Make the solid of a shape in its own frame, from a mass or a density."""
    volume, moments = SHAPES[shape](size)
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
