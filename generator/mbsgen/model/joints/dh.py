"""Joints by their Denavit-Hartenberg parameters: a row of a robot's table.

    modified (Craig)                     T = Rx(alpha) Tx(a) Rz(theta) Tz(d)
    standard (Denavit and Hartenberg)    T = Rz(theta) Tz(d) Tx(a) Rx(alpha)

takes the frame of the body to the frame of its parent; q is added to theta, or to d where the joint slides. The joint's
axis is z of the body's frame where the table is modified, and z of the parent's frame where it is standard. In a
standard table the body's frame is fixed beyond the joint, at `tail` in the frame that the joint moves.

Denavit, Hartenberg, "A kinematic notation for lower-pair mechanisms", J. Appl. Mech. 22, 1955; Craig, "Introduction to
robotics", 1986, section 3.4.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mbsgen.expressions import Expression
from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.model import HERE, UNITS, ZERO, Carrier, Joint, Placement, Rotation
from mbsgen.model.placements import compose
from mbsgen.model.sections import NumberField, SettingSection
from mbsgen.model.tree import Motion


class DhSection(JointSection, SettingSection):
    """A joint by its Denavit-Hartenberg parameters; position and orientation place the whole on the parent."""

    type: Literal["dh"] = Field(examples=["dh"])
    convention: Literal["standard", "modified"] = Field(
        examples=["modified"], description="standard: a and alpha follow the joint; modified (Craig): they precede it"
    )
    motion: Literal["revolute", "prismatic"] = Field(
        "revolute", examples=["revolute"], description="revolute: q adds to theta; prismatic: q adds to d"
    )
    a: NumberField = Field(ZERO, examples=[0.4], description="along x, m")
    alpha: NumberField = Field(ZERO, examples=["pi/2"], description="about x, rad")
    d: NumberField = Field(ZERO, examples=[0.1], description="along z at q = 0, m")
    theta: NumberField = Field(ZERO, examples=[0.0], description="about z at q = 0, rad")

    @property
    def tail(self) -> Placement:
        """The body's frame in the frame that the joint moves."""
        if self.convention == "modified":
            return HERE
        return Placement((self.a, ZERO, ZERO), _turn(0, self.alpha))

    def make(self, body: str) -> Joint:
        """Make the joint."""
        row = Placement((ZERO, ZERO, self.d), _turn(2, self.theta))
        if self.convention == "modified":
            row = compose(Placement((self.a, ZERO, ZERO), _turn(0, self.alpha)), row)
        return self.apply(Joint(Motion(self.motion), UNITS["z"], placement=compose(self.placement, row)))

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe nothing: a writer writes the axis and the place of the joint."""
        return None


def _turn(axis: int, angle: Expression) -> tuple[Rotation, ...]:
    return () if angle == ZERO else (Rotation(axis, angle),)
