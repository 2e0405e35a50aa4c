"""Joints with a quaternion: a ball, and a body that moves freely.

The coordinates are a unit quaternion, before it the place of a free body; the velocities are along the body's axes, so
that the motion subspace is constant: S = [1 0]^T of a ball, S = 1 of a free body. Elementary joints about and along
x, y, z stand for those velocities: at any instant they are at 0, on a frame that the quaternion turns.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal

from pydantic import Field

from mbsgen.model.expansion import label_joints
from mbsgen.model.joints.compound import is_alike, slide, stand
from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.joints.turns import make_turns
from mbsgen.model.model import Carrier, Joint

_TURNS = tuple(replace(joint, floats=True) for joint in make_turns("xyz"))
_ALL = (*(replace(slide(axis), floats=True) for axis in "xyz"), *_TURNS)


def is_pure(joints: Sequence[Joint]) -> bool:
    """Return whether joints stand for one quaternion, without names, limits, forces and rotors."""
    driven, placement = tuple(replace(joint, actuated=True) for joint in joints), joints[0].placement
    return any(driven == stand(known, placement, actuated=True) for known in (_TURNS, _ALL))


class QuaternionSection(JointSection):
    """A joint that turns in any direction, by a quaternion."""

    DRIVEN: ClassVar[bool] = True  # whether it takes inputs unless the file says otherwise

    actuated: bool | None = Field(None, examples=[True], description="whether it takes inputs u, along the body's axes")

    @classmethod
    @abstractmethod
    def list_joints(cls) -> tuple[Joint, ...]:
        """List the joints that have its velocities."""

    def make(self, body: str) -> tuple[Joint, ...]:
        """Make the joints that have its velocities."""
        actuated = self.DRIVEN if self.actuated is None else self.actuated
        return stand(self.list_joints(), self.placement, actuated=actuated)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe the joints that have its velocities."""
        if not isinstance(carrier, tuple) or not is_alike(carrier, cls.list_joints()):
            return None
        (name,) = cls.list_names()
        axes = dict(zip(label_joints(carrier), carrier, strict=True))
        return Description(name, {}, carrier[0].placement, axes=axes, actuated=cls.DRIVEN)


class BallSection(QuaternionSection):
    """A joint that turns in any direction: a unit quaternion, and the angular velocity along the body's axes."""

    type: Literal["ball"] = Field(examples=["ball"])

    @classmethod
    def list_joints(cls) -> tuple[Joint, ...]:
        """List the turns about the body's axes."""
        return _TURNS


class FreeSection(QuaternionSection):
    """A body that moves freely: its place, a unit quaternion, and velocities along its axes; passive by default."""

    DRIVEN: ClassVar[bool] = False

    type: Literal["free"] = Field(examples=["free"])

    @classmethod
    def list_joints(cls) -> tuple[Joint, ...]:
        """List the slides along the body's axes, and the turns about them."""
        return _ALL
