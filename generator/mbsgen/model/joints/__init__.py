"""Joint types. A type is a class of sections (see `section`) in its own file, and an entry in JOINT_TYPES."""

from __future__ import annotations

from mbsgen.documents import WrongValueError, abbreviate, nearest
from mbsgen.model.joints.cylindrical import CylindricalSection
from mbsgen.model.joints.dh import DhSection
from mbsgen.model.joints.elementary import ElementarySection, FixedSection
from mbsgen.model.joints.floating import FloatingSection
from mbsgen.model.joints.helical import HelicalSection
from mbsgen.model.joints.planar import PlanarSection
from mbsgen.model.joints.quaternions import BallSection, FreeSection
from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.joints.turns import CardanSection, SphericalSection
from mbsgen.model.joints.universal import UniversalSection
from mbsgen.model.model import Body

JOINT_TYPES: tuple[type[JointSection], ...] = (
    ElementarySection,
    FixedSection,
    CardanSection,
    UniversalSection,
    SphericalSection,
    PlanarSection,
    FloatingSection,
    BallSection,
    FreeSection,
    CylindricalSection,
    HelicalSection,
    DhSection,
)


def list_joint_types() -> tuple[str, ...]:
    """List the names of all joint types."""
    return tuple(name for section in JOINT_TYPES for name in section.list_names())


def find_joint_type(name: str) -> type[JointSection]:
    """Find a joint type by its name. Raises ValueError."""
    for section in JOINT_TYPES:
        if name in section.list_names():
            return section
    meant = nearest(name, list_joint_types())
    hint = f"did you mean {meant}? " if meant else ""
    raise WrongValueError(f"no joint type {abbreviate(name)}", f"{hint}give one of {', '.join(list_joint_types())}")


def describe_joint(body: Body) -> Description | None:
    """Describe what carries a body by the first joint type that it is of; None of joints in a row without a name."""
    descriptions = (section.describe(body.name, body.joint) for section in JOINT_TYPES)
    return next((found for found in descriptions if found is not None), None)
