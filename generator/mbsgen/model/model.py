"""The Model: a mechanism as its author describes it, in expressions over named parameters; checked, then frozen.

Bodies stand in any order and name their parents; joints turn about, or slide along, any axis. Lengths are in m, angles
in rad, masses in kg. `reduction.build_tree` makes of it the Tree that the recursions read.
"""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.expressions import Expression
from mbsgen.model.tree import Kind, Motion

BASE = "base"  # the name of what does not move

Triple = tuple[Expression, Expression, Expression]


@dataclass(frozen=True)
class Parameter:
    """A named number; `value` may use constant parameters that stand before it."""

    name: str
    value: Expression
    kind: Kind


@dataclass(frozen=True)
class Rotation:
    """A rotation about coordinate axis 0, 1 or 2."""

    axis: int
    angle: Expression


@dataclass(frozen=True)
class Placement:
    """Where a frame stands in another: its origin, and rotations in turn, each about the axes turned so far."""

    position: Triple
    orientation: tuple[Rotation, ...]


@dataclass(frozen=True)
class Joint:
    """One degree of freedom between a body and its parent."""

    name: str
    motion: Motion
    axis: Triple  # a direction of any length, in the body's frame
    placement: Placement  # of the body's frame at q = 0, in the parent's
    actuated: bool
    lower: Expression | None  # None: unbounded
    upper: Expression | None


@dataclass(frozen=True)
class Inertia:
    """The inertia tensor about the centre of mass, in the body's axes."""

    xx: Expression
    yy: Expression
    zz: Expression
    xy: Expression
    xz: Expression
    yz: Expression

    @property
    def rows(self) -> tuple[Triple, Triple, Triple]:
        """The tensor as a symmetric matrix."""
        return (self.xx, self.xy, self.xz), (self.xy, self.yy, self.yz), (self.xz, self.yz, self.zz)


@dataclass(frozen=True)
class Body:
    """A rigid body, and the joint that carries it."""

    name: str
    parent: str  # a body's name, or `BASE`
    joint: Joint
    mass: Expression
    com: Triple  # centre of mass, in the body's frame
    inertia: Inertia


@dataclass(frozen=True)
class Frame:
    """A named frame on a body, of which the pose is wanted."""

    name: str
    body: str
    placement: Placement


@dataclass(frozen=True)
class Model:
    """A mechanism as its author describes it."""

    name: str
    gravity: Triple  # in the base's frame [m/s2]
    parameters: tuple[Parameter, ...]
    bodies: tuple[Body, ...]
    frames: tuple[Frame, ...]
    allow_unphysical: bool  # take inertias that no body can have
