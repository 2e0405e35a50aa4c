"""Closures of loops in 50 digits, from the poses of bodies; their derivatives are differences of these.

The equations follow from the definition of each kind of loop, in the base frame. They share with the generated
equations only their order, their units, and the frame that positions are resolved in.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from decimal import Decimal
from functools import cached_property

from mbsgen.formulations.closure import kept_equations
from mbsgen.model.tree import Cut, Loop, Tree
from mbsgen.tape.interpreter import DECIMALS
from mbsgen.tape.types import Op
from mbsgen.verification.geometry import (
    STEP,
    ZERO,
    Mechanism,
    Pose,
    add,
    bend,
    displace,
    dot,
    slope,
    times,
    transpose,
)
from mbsgen.verification.states import Numbers

Value = Callable[[Sequence[Decimal]], Numbers]  # of constraints, at the coordinates of all joints


class Closures:
    """The loops and constraints of an uncoupled tree at one state, by displacements of its joints."""

    def __init__(
        self, tree: Tree, mechanism: Mechanism, q: Numbers, constraints: Value, size: Decimal = Decimal(1)
    ) -> None:
        """Take the tree, its numbers, the coordinates of all joints, the values of its constraints, and the unit of
        shifts.
        """
        self.tree, self._mechanism, self._q, self._constraints = tree, mechanism, q, constraints
        self.size = size

    @cached_property
    def h(self) -> Numbers:
        """Return what is left open."""
        return self._close(None)

    def rate(self, qd: Numbers) -> Numbers:
        """Return the rate of h for velocities of all joints."""
        return slope(*(self._close([step * x for x in qd]) for step in (STEP, -STEP)))

    def accelerate(self, qd: Numbers, qdd: Numbers) -> Numbers:
        """Return the second time derivative of h."""
        return bend(self.tree, self._close, qd, qdd, self.size)

    def push(self, number: int, beyond: Collection[int], way: int) -> Numbers:
        """Return the rate of h as some bodies move rigidly, along or about an axis through the origin of one of them.

        Ways 0 to 2 are along x, y and z, 3 to 5 about them.
        """
        poses = self._mechanism.poses(self._q)
        return slope(*(self._gather(displace(poses, number, beyond, way, step), None) for step in (STEP, -STEP)))

    def _close(self, displacement: Numbers | None) -> Numbers:
        return self._gather(self._mechanism.poses(self._q, displacement), displacement)

    def _gather(self, poses: Sequence[Pose], displacement: Numbers | None) -> Numbers:
        """Return the equations that are kept, of bodies at given poses and joints that are displaced."""
        found = {(k, n): x for k, loop in enumerate(self.tree.loops) for n, x in enumerate(self._open(loop, k, poses))}
        moved = [a + b for a, b in zip(self._joints, displacement or [ZERO] * len(self.tree.bodies), strict=True)]
        first = len(self.tree.loops)
        found |= {(first + k, 0): x for k, x in enumerate(self._constraints(moved))}
        every = [found[place] for place in sorted(found)]
        closure = self.tree.closure
        kept = range(len(every)) if closure is None else closure.kept
        assert len(kept) == len(kept_equations(self.tree)), "the generated code has the same equations"
        return [every[i] for i in kept]

    @cached_property
    def _joints(self) -> Numbers:
        """Return the coordinate of each joint; 0 for the joints of quaternions."""
        by_name = dict(zip(self.tree.coordinates, self._q, strict=True))
        return [by_name.get(body.joint.name, ZERO) for body in self.tree.bodies]

    def _open(self, loop: Loop, k: int, poses: Sequence[Pose]) -> Iterator[Decimal]:
        """Yield the gaps of a loop, in the order of its equations."""
        first, second = (self._place(f"{k}_{end}", x.body, poses) for end, x in enumerate((loop.first, loop.second)))
        number = self._find_carrier(loop.first.body, loop.second.body)
        axes = times(poses[number].R, self._mechanism.matrix(f"axes_{number}")) if number else poses[0].R
        (x1, y1, z1), (x2, _, z2) = transpose(first.R), transpose(second.R)
        d = add(second.p, [-x for x in first.p])
        (value,) = self._mechanism.vector(f"loop_{k}")
        if loop.cut is Cut.ROD:
            yield (dot(d, d) - value * value) / (2 * value)
        elif loop.cut in (Cut.BALL, Cut.HINGE, Cut.UNIVERSAL, Cut.SOLID):
            yield from (dot(d, axis) for axis in transpose(axes))
        else:
            yield from [dot(d, z1)] if loop.cut is Cut.PLANAR else [dot(d, x1), dot(d, y1)]
        if loop.cut is Cut.UNIVERSAL:
            yield dot(z1, z2) - value
        elif loop.cut not in (Cut.ROD, Cut.BALL):
            yield from (dot(x1, z2), dot(y1, z2))
        if loop.cut in (Cut.PRISMATIC, Cut.SOLID):
            yield dot(y1, x2)
        if loop.cut is Cut.HELICAL:
            s, c = (DECIMALS.functions[op](dot(d, z1) / value) for op in (Op.SIN, Op.COS))
            yield 2 * value * (s * dot(x1, x2) - c * dot(y1, x2)) / (1 + c * dot(x1, x2) + s * dot(y1, x2))

    def _place(self, end: str, body: int, poses: Sequence[Pose]) -> Pose:
        pose = poses[body]
        return Pose(
            pose.place(self._mechanism.vector(f"end_{end}")), times(pose.R, self._mechanism.matrix(f"frame_{end}"))
        )

    def _find_carrier(self, one: int, other: int) -> int:
        """Number the last body that carries both."""

        def climb(body: int) -> list[int]:
            return [body, *climb(self.tree.bodies[body - 1].parent)] if body else [0]

        above = set(climb(other))
        return next(body for body in climb(one) if body in above)
