"""The usual sequences of joints: what a file calls them, and the elementary joints that they are.

A label tells what a joint does: `x` slides along x, `rx` turns about it, each in the frame that those before it moved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from mbsgen.expressions import Number
from mbsgen.model.model import HERE, Joint, Placement, Triple
from mbsgen.model.tree import Motion

UNITS: Mapping[str, Triple] = MappingProxyType(
    {
        sign + axis: (Number(length * (axis == "x")), Number(length * (axis == "y")), Number(length * (axis == "z")))
        for sign, length in (("", 1.0), ("-", -1.0))
        for axis in "xyz"
    }
)


@dataclass(frozen=True)
class Compound:
    """A sequence of joints that has a name."""

    type: str
    order: str  # of rotations; of a planar joint, the plane
    labels: tuple[str, ...]
    actuated: bool = True  # unless a model says otherwise
    floats: bool = False  # a quaternion turns their frame; the joints have its velocities alone


def _turn(order: str) -> tuple[str, ...]:
    return tuple(f"r{axis}" for axis in order)


_PAIRS = ("xy", "xz", "yx", "yz", "zx", "zy")
_TRIPLES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
_PLANES = {"xy": "z", "xz": "y", "yz": "x"}  # with their normals

_ALL = (
    *(Compound("cardan", order, _turn(order)) for order in _PAIRS),
    *(Compound("universal", order, _turn(order)) for order in _PAIRS),
    *(Compound("spherical", order, _turn(order)) for order in _TRIPLES),
    *(Compound("planar", plane, (*plane, f"r{normal}"), actuated=False) for plane, normal in _PLANES.items()),
    Compound("ball", "xyz", _turn("xyz"), floats=True),
    Compound("free", "xyz", ("x", "y", "z", *_turn("xyz")), actuated=False, floats=True),
    *(Compound("floating", order, ("x", "y", "z", *_turn(order)), actuated=False) for order in _TRIPLES),
)
COMPOUNDS: Mapping[tuple[str, str], Compound] = MappingProxyType({(c.type, c.order): c for c in _ALL})


def make_joints(compound: Compound, placement: Placement = HERE, *, actuated: bool | None = None) -> tuple[Joint, ...]:
    """Make the joints of a compound; the first one stands on the parent as `placement` tells."""
    first, *rest = (
        Joint(
            Motion.REVOLUTE if label.startswith("r") else Motion.PRISMATIC,
            UNITS[label[-1]],
            actuated=compound.actuated if actuated is None else actuated,
            floats=compound.floats,
        )
        for label in compound.labels
    )
    return (replace(first, placement=placement), *rest)


def recognise(joints: Sequence[Joint]) -> Compound | None:
    """Find the compound whose joints move as these do, whatever their names, limits and forces."""
    if any(joint.placement != HERE for joint in joints[1:]):
        return None
    return _KNOWN.get(_list_motions(joints))


def _list_motions(joints: Sequence[Joint]) -> tuple[tuple[Motion, Triple, bool], ...]:
    return tuple((joint.motion, joint.axis, joint.floats) for joint in joints)


_KNOWN: Mapping[tuple[tuple[Motion, Triple, bool], ...], Compound] = MappingProxyType(
    {_list_motions(make_joints(compound)): compound for compound in reversed(_ALL)}  # of two alike, the first
)
