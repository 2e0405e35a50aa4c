"""Links: the bodies of a tree as the recursions use them, and the wrenches on them.

The frame of body i has its origin at joint i. With the constant placement (dpt0, R0) on the parent and the joint axis
e,

    revolute:  R = R0 Rot(e, q), dpt = dpt0        prismatic:  R = R0, dpt = dpt0 + R0 e q

The inertia of body i is given by its moments about its own origin: mass m, first moment S = m l, and J = In + m (l.l 1
- l lT) (Steiner).
"""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.model.tree import Joint, Motion
from mbsgen.tape.builder import Scalar


@dataclass(frozen=True)
class Link:
    """A body as the recursions use it. Vectors are in the body's frame; `R` and `dpt` lead to the parent's."""

    number: int  # from 1
    parent: int  # 0: the base
    joint: Joint
    R: Matrix[Scalar]  # columns: the body's axes in the parent's frame
    dpt: Vector[Scalar]  # the body's origin from the parent's, in the parent's frame
    slide: Vector[Scalar]  # the displacement along a prismatic joint, in the body's frame
    m: Scalar
    S: Vector[Scalar]
    J: Matrix[Scalar]

    @property
    def is_revolute(self) -> bool:
        """Return whether the joint turns; else it slides."""
        return self.joint.motion is Motion.REVOLUTE


@dataclass(frozen=True)
class AppliedWrench:
    """An external wrench with its numbers."""

    body: int
    position: Vector[Scalar]  # of its point, in the body's frame
    in_base: bool  # components in the base frame; else in the body's
    force: Vector[Scalar]
    moment: Vector[Scalar]
