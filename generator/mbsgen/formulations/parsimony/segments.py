"""Segments: the bodies of a Tree in aligned frames, with their moments of mass.

A body's frame is turned such that it is parallel to the parent's frame at q = 0, wherever their axes are at right
angles. Then a joint's axis is a coordinate axis of both bodies, up to its sense. Consecutive joints with parallel axes
form a *group*; their common axis is constant in all frames of the group.

Moments are about the body's own origin, its joint:

    m = int dm,    S = int r dm,    P = int r rT dm = 1/2 tr(J) 1 - J,    J = tr(P) 1 - P

In this form mass moves between bodies by sums alone (Wittenburg, 2008, 3.1, for J and P).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sympy import Expr

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.chain import Chain
from mbsgen.formulations.links import AppliedWrench
from mbsgen.model.tree import Body, Motion, RigidPart
from mbsgen.tape.builder import Builder, Scalar


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Moments:
    """Mass, first and second moment about a body's origin."""

    m: Scalar
    S: Vector[Scalar]
    P: Matrix[Scalar]

    def __add__(self, other: Moments) -> Moments:
        return Moments(self.m + other.m, self.S + other.S, self.P + other.P)


@dataclass(frozen=True)
class Segment:
    """A body, aligned. Vectors are in its own frame; `d` is in the parent's."""

    number: int  # from 1
    parent: int  # 0: the base
    is_revolute: bool
    axis: int
    sense: int  # +1 or -1: the joint turns about, or slides along, sense * axis
    turn: Matrix[Scalar] | None  # columns: axes at q = 0 in the parent's frame; None: the unit matrix
    opens_group: bool  # its axis differs from its predecessor's
    counts_angle: bool  # in absolute rates, relative to its parent: it opens a group, or has a rotor
    d: Vector[Scalar]  # its origin, at q = 0, from the parent's
    moments: Moments
    wrenches: tuple[AppliedWrench, ...]
    frame: Matrix[Scalar]  # columns: the axes of the body of the Tree
    floats: bool = False  # a quaternion sets turn and d: no inertia that they move belongs to the parent

    @property
    def across(self) -> tuple[int, int]:
        """Return the two axes after the joint's, in cyclic order."""
        return (self.axis + 1) % 3, (self.axis + 2) % 3

    def signed(self, value: Scalar) -> Scalar:
        """Return a joint's quantity with the sense of the axis."""
        return value if self.sense > 0 else -value


def align(chain: Chain, *, group: bool = True) -> tuple[Segment, ...]:
    """Make the segments of a tree; without `group`, every joint opens its own group."""
    unit = unit_matrix(chain.builder)
    turned = {0: unit}  # columns: the axes of each body of the Tree in the aligned frame
    segments: list[Segment] = []
    for number, body in enumerate(chain.tree.bodies, 1):
        placed = turned[body.parent].times(chain.orientation(number))
        floats = number in chain.state.frames
        steps = None if floats else _right_angles(body, turned[body.parent], placed)
        if steps is None:
            turned[number], turn, axis, sense = unit, placed, body.joint.axis, 1
        else:
            turned[number], turn = placed, None
            axis, sense = next((r, s) for r, s in enumerate(steps[body.joint.axis]) if s)
        is_revolute = body.joint.motion is Motion.REVOLUTE
        before = segments[body.parent - 1] if body.parent else None
        continues = group and before and is_revolute and before.is_revolute and turn is None and before.axis == axis
        d = turned[body.parent].apply(chain.position(number))
        moments = _moments(chain, body, turned[number])
        for part in body.parts:
            moments = moments + _moments(chain, part, turned[number])
        wrenches = _wrenches(chain, number, turned[number])
        counts = not continues or not chain.armatures[number - 1].is_zero
        place = (number, body.parent, is_revolute, axis, sense, turn, not continues, counts)
        segments.append(Segment(*place, d, moments, wrenches, turned[number], floats))
    return tuple(segments)


def _right_angles(body: Body, parent: Matrix[Scalar], placed: Matrix[Scalar]) -> list[list[int]] | None:
    """Read `placed` as a matrix of 0, 1 and -1, by columns; None if it holds anything else."""
    if not all(_is_step(entry) for row in body.orientation for entry in row):
        return None
    one = parent[0, 0].builder.number(1.0).ref
    steps = [[{0: 0, one: 1, -one: -1}.get(placed[r, c].ref) for r in range(3)] for c in range(3)]
    return [[s for s in column if s is not None] for column in steps] if all(None not in c for c in steps) else None


def _is_step(entry: Expr) -> bool:
    return bool(entry.is_number) and entry in (0, 1, -1)


def _moments(chain: Chain, part: Body | RigidPart, frame: Matrix[Scalar]) -> Moments:
    m, l, In = chain.scalar(part.mass), frame.apply(chain.vector(part.com)), chain.matrix(part.inertia)
    half_trace = (In[0, 0] + In[1, 1] + In[2, 2]) * chain.builder.number(0.5)
    central = unit_matrix(chain.builder).scale(half_trace) - In
    S = l.scale(m)
    return Moments(m, S, frame.times(central).times(frame.transposed) + outer(S, l))


def _wrenches(chain: Chain, number: int, frame: Matrix[Scalar]) -> tuple[AppliedWrench, ...]:
    """List the external wrenches on a body; components in the base frame stay."""

    def turn(wrench: AppliedWrench) -> AppliedWrench:
        force, moment = (v if wrench.in_base else frame.apply(v) for v in (wrench.force, wrench.moment))
        return replace(wrench, position=frame.apply(wrench.position), force=force, moment=moment)

    return tuple(turn(wrench) for wrench in chain.wrenches if wrench.body == number)


def unit_vector(builder: Builder, axis: int) -> Vector[Scalar]:
    """Make a coordinate axis."""
    zero, one = builder.zero, builder.number(1.0)
    return Vector.of(one if k == axis else zero for k in range(3))


def unit_matrix(builder: Builder) -> Matrix[Scalar]:
    """Make the unit matrix."""
    return Matrix.of(unit_vector(builder, k) for k in range(3))


def children(segments: Sequence[Segment], number: int) -> tuple[Segment, ...]:
    """List the segments that body `number` carries."""
    return tuple(s for s in segments if s.parent == number)


def largest_inertias(chain: Chain, segments: Sequence[Segment]) -> dict[int, Scalar]:
    """Bound the inertia that each joint can feel, with everything beyond it stretched out: moment of inertia, or mass.

    Uses parameters alone, and the triangle inequality in the norm (integral of r2 dm)^1/2. The displacement of
    prismatic joints is left out.
    """
    b = chain.builder
    bounds: dict[int, Scalar] = {}
    second: dict[int, Scalar] = {}
    mass: dict[int, Scalar] = {}
    for s in reversed(segments):
        P = s.moments.P
        total, m = P[0, 0] + P[1, 1] + P[2, 2], s.moments.m
        for child in children(segments, s.number):
            reach = b.sqrt(second[child.number]) + b.sqrt(child.d.dot(child.d) * mass[child.number])
            total, m = total + reach * reach, m + mass[child.number]
        second[s.number], mass[s.number] = total, m
        bounds[s.number] = total if s.is_revolute else m
    return bounds


def feels_itself(segment: Segment) -> bool:
    """Return whether a joint's own body, without the bodies beyond it, has inertia along the joint's motion."""
    if not segment.is_revolute:
        return not segment.moments.m.is_zero
    return not all(segment.moments.P[k, k].is_zero for k in segment.across)
