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
from mbsgen.model.model import HERE, UNITS, ZERO, Carrier, Joint, Placement, Rotation, Row
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
    def row(self) -> Row:
        """The numbers of the row."""
        return Row(self.convention == "standard", self.placement, self.a, self.alpha, self.d, self.theta)

    def make(self, body: str) -> Joint:
        """Make the joint."""
        return self.apply(Joint(Motion(self.motion), UNITS["z"], placement=place_joint(self.row), row=self.row))

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe nothing: a writer writes the axis and the place of the joint."""
        return None


def place_joint(row: Row) -> Placement:
    """Place the frame that the joint moves on the body that carries it."""
    place = Placement((ZERO, ZERO, row.d), _turn(2, row.theta))
    return compose(row.base, place if row.is_standard else compose(_link(row), place))


def place_tail(row: Row) -> Placement:
    """Place the body's frame in the frame that the joint moves."""
    return _link(row) if row.is_standard else HERE


def _link(row: Row) -> Placement:
    return Placement((row.a, ZERO, ZERO), _turn(0, row.alpha))


def _turn(axis: int, angle: Expression) -> tuple[Rotation, ...]:
    return () if angle == ZERO else (Rotation(axis, angle),)
