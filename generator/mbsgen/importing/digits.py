"""The numbers in a file to import that place its joints and loops: their last digits show how the file is rounded."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mbsgen.importing.findings import read_number
from mbsgen.importing.markup import Element

ATTRIBUTES = ("anchor", "axis", "axisangle", "euler", "pos", "quat", "rpy", "xyaxes", "xyz", "zaxis")
TEXTS = (  # elements of SDF and OpenSim
    *("pose", "xyz", "axis", "location", "location_in_parent", "orientation", "orientation_in_parent", "translation"),
    *("location_body_1", "location_body_2", "orientation_body_1", "orientation_body_2"),
)
AWAY = (  # elements that place no joint
    *("collision", "geom", "inertial", "visual", "ContactGeometrySet", "ForceSet", "MarkerSet", "VisibleObject"),
    "WrapObjectSet",
)


def list_numbers(root: Element) -> Iterator[float]:
    """Yield the numbers of places, axes and angles."""
    waiting = [root]
    while waiting:
        element = waiting.pop()
        if element.tag in AWAY:
            continue
        texts = [element.attributes[name] for name in ATTRIBUTES if name in element.attributes]
        for word in " ".join([*texts, element.text if element.tag in TEXTS else ""]).split():
            if not math.isnan(value := read_number(word)):
                yield value
        waiting += element.children
