"""Joints whose accelerations are not determined: massless joints, and joints that undo each other's motion.

For these, M is singular at every configuration; else at almost none. So one configuration, chosen without symmetry, is
enough. A joint is massless if neither mass nor a rotor moves with it. Several joints undo each other if a pivot of the
articulated-body recursion vanishes: D_i = S_i . IA_i S_i (Featherstone, 2008, 7.3), which the joints beyond body i have
lowered to 0. A pivot that is small in doubles is computed again, in 60 digits.

Loops, constraints and drives do not help such a joint, although they may determine its motion: accelerations and
multipliers come from the factors of M, so M of the tree must be positive definite.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mbsgen.algebra.dense import (
    Dense,
    Row,
    add,
    apply,
    combine,
    cross,
    dot,
    identity,
    project,
    skew,
    stack,
    subtract,
    times,
    transpose,
)
from mbsgen.documents import Finding, Place, abbreviate
from mbsgen.expressions import Expression
from mbsgen.model.expansion import Expansion, expand
from mbsgen.model.model import Fixed, Joint, Model, Placement, Triple
from mbsgen.model.placements import centre_inertia
from mbsgen.model.symbols import DIGITS
from mbsgen.model.topology import index_parents, walk_bodies
from mbsgen.model.tree import Motion
from mbsgen.model.valuation import Valuation

TOLERANCE = 1e-26  # of the inertia off the axis, or without the joints beyond: rounding squared, with a margin
DOUBTFUL = 1e-9  # of a pivot: below, doubles do not distinguish it from 0
INVOLVED = 1e-6  # of the largest acceleration: those below are rounding
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class _Solid:
    """A body of an expanded model at the chosen configuration, in the base's frame."""

    rotation: Dense  # of the body's frame
    origin: Row
    axis: Row  # of its joint; 0 where it is fixed
    mass: Any
    com: Row
    inertia: Dense  # about com, in the body's frame
    armature: Any  # of its joint

    @property
    def lever(self) -> Row:
        return subtract(self.com, self.origin)


def check_undetermined_joints(model: Model) -> Iterator[Finding]:
    """Find the joints of a checked model whose accelerations nothing determines."""
    expansion = expand(model)
    bodies = expansion.model.bodies
    mechanism = _place(expansion.model, _Doubles(expansion.model))
    massless = [i for i in mechanism.order if isinstance(bodies[i].joint, Joint) and not mechanism.feels(i)]
    is_clear = not massless and not mechanism.find_undone(DOUBTFUL)  # what is not finite is computed in digits
    for i in massless:
        yield _report_massless(i, expansion)
    if massless or is_clear:
        return
    exact = _place(expansion.model, _Digits(expansion.model))
    for i, others in exact.find_undone(TOLERANCE).items():
        yield _report_redundant(i, others, expansion) if others else _report_massless(i, expansion)


def _report_massless(i: int, expansion: Expansion) -> Finding:
    joint = expansion.model.bodies[i].joint
    assert isinstance(joint, Joint), "only joints move"
    what = "inertia about" if joint.motion is Motion.REVOLUTE else "mass along"
    finding = f"joint {abbreviate(joint.name)} moves nothing: what it carries has no {what} its axis"
    remedy = "give a body it carries mass, or take the joint away"
    return Finding(expansion.places[i], finding, remedy + _warn_of_loops(expansion.model))


def _report_redundant(i: int, others: Sequence[int], expansion: Expansion) -> Finding:
    bodies = expansion.model.bodies
    first, *rest = (abbreviate(bodies[k].joint.name) for k in (i, *others))  # type: ignore[union-attr]
    finding = f"joint {first} moves nothing that {' and '.join(rest)} cannot undo: nothing between them has inertia"
    remedy = "give a body between them mass and inertia, or take a joint away"
    return Finding(expansion.places[i], finding, remedy + _warn_of_loops(expansion.model))


def _warn_of_loops(model: Model) -> str:
    held = model.loops or model.constraints or model.driven
    return "; loops do not replace it, since the mass matrix of the joints must be invertible" if held else ""


# --- the mechanism at one configuration ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Mechanism:
    """Solids, and which carries which."""

    model: Model
    parents: Sequence[int | None]
    order: Sequence[int]  # parents before what they carry, the bodies of any subtree next to each other
    solids: Mapping[int, _Solid]

    def feels(self, i: int) -> bool:
        """Compare each body's inertia with its inertia if nothing were on the axis; sums would hide light bodies."""
        carrier, joint = self.solids[i], self.model.bodies[i].joint
        rank = self._ranks[i]
        carried = (self.solids[k] for k in self.order[rank : rank + self._sizes[i]])
        if carrier.armature:
            return True
        if isinstance(joint, Joint) and joint.motion is Motion.PRISMATIC:
            return any(solid.mass != 0 for solid in carried)
        return any(_is_felt(solid, carrier) for solid in carried)

    def find_undone(self, tolerance: float) -> dict[int, list[int]]:
        """Find the joints whose pivots vanish, relative to M_ii, each with the joints that undo what it does."""
        articulated, composite = ({i: _inertia(self.solids[i]) for i in self.order} for _ in "ab")
        answers: dict[int, Row] = {}  # the acceleration of a joint for its parent's, to be subtracted
        undone: dict[int, list[int]] = {}
        for i in reversed(self.order):
            solid, S = self.solids[i], self._direction(i)
            if S is not None:
                U = apply(articulated[i], S)
                pivot = dot(S, U) + solid.armature
                if not abs(pivot) > tolerance * abs(dot(S, apply(composite[i], S)) + solid.armature):  # or no number
                    undone[i] = self._answer(i, S, answers)
                else:
                    answers[i] = tuple(x / pivot for x in U)
                    articulated[i] = project(articulated[i], U, pivot)
            parent = self.parents[i]
            if parent is not None:
                d = subtract(solid.origin, self.solids[parent].origin)
                for inertias in (articulated, composite):
                    inertias[parent] = combine(operator.add, inertias[parent], _move(inertias[i], d))
        return dict(sorted(undone.items()))

    def _answer(self, i: int, S: Row, answers: Mapping[int, Row]) -> list[int]:
        """List the joints that body i carries and that answer a motion of its joint, where no force is needed."""
        moving, amounts = {i: S}, {}
        rank = self._ranks[i]
        for k in self.order[rank + 1 : rank + self._sizes[i]]:
            parent = self.parents[k]
            assert parent is not None, "what a body carries has a parent"
            moving[k] = _carry(moving[parent], subtract(self.solids[k].origin, self.solids[parent].origin))
            own = self._direction(k)
            if own is not None and k in answers:
                amounts[k] = dot(answers[k], moving[k])
                moving[k] = tuple(x - y * amounts[k] for x, y in zip(moving[k], own, strict=True))
        largest = max(map(abs, amounts.values()), default=0)
        return [k for k, amount in amounts.items() if abs(amount) > INVOLVED * largest]

    def _direction(self, i: int) -> Row | None:
        """The motion of a joint: angular velocity, and velocity of its origin."""
        joint, axis = self.model.bodies[i].joint, self.solids[i].axis
        if not isinstance(joint, Joint):
            return None
        zero = tuple(0 * x for x in axis)
        return (*axis, *zero) if joint.motion is Motion.REVOLUTE else (*zero, *axis)

    @cached_property
    def _ranks(self) -> dict[int, int]:
        return {i: rank for rank, i in enumerate(self.order)}

    @cached_property
    def _sizes(self) -> dict[int, int]:
        """Count the bodies of each subtree."""
        sizes = dict.fromkeys(self.order, 1)
        for i in reversed(self.order):
            parent = self.parents[i]
            if parent is not None:
                sizes[parent] += sizes[i]
        return sizes


def _is_felt(solid: _Solid, carrier: _Solid) -> bool:
    """Return whether a body has inertia about the axis of its carrier; true where the numbers are not finite."""
    about = apply(transpose(solid.rotation), carrier.axis)
    lever = cross(carrier.axis, subtract(solid.com, carrier.origin))
    felt = solid.mass * dot(lever, lever) + dot(about, apply(solid.inertia, about))
    reach = dot(solid.com, solid.com) + dot(carrier.origin, carrier.origin)
    scale = solid.mass * reach + max(abs(x) for row in solid.inertia for x in row)
    return not (math.isfinite(scale) and abs(felt) <= TOLERANCE * scale)


def _inertia(solid: _Solid) -> Dense:
    """The spatial inertia about the origin of a body, in the base's axes: what velocities are to be multiplied by."""
    m, c = solid.mass, skew(solid.lever)
    turned = times(times(solid.rotation, solid.inertia), transpose(solid.rotation))
    about = combine(lambda x, y: x - m * y, turned, times(c, c))
    moments = combine(lambda x: m * x, c)
    return stack(((about, moments), (transpose(moments), combine(lambda x: m * x, identity(3)))))


def _move(inertia: Dense, d: Row) -> Dense:
    """Refer a spatial inertia to a point that is nearer by d."""
    rows = tuple(_lift(row, d) for row in inertia)
    return transpose(tuple(_lift(column, d) for column in transpose(rows)))


def _lift(force: Row, d: Row) -> Row:
    """Refer a moment and a force to a point that is nearer by d."""
    moment, force = force[:3], force[3:]
    return (*add(moment, cross(d, force)), *force)


def _carry(velocity: Row, d: Row) -> Row:
    """Take an angular velocity and a velocity to a point that is further by d."""
    angular, velocity = velocity[:3], velocity[3:]
    return (*angular, *subtract(velocity, cross(d, angular)))


# --- numbers ---------------------------------------------------------------------------------------------------------


class _Doubles:
    """Numbers of a model in doubles."""

    def __init__(self, model: Model) -> None:
        self._valuation = Valuation(model.parameters, (), generic=True)

    def number(self, place: Place, expression: Expression) -> Any:
        return self._valuation.number(place, expression)

    def sine_cosine(self, angle: Any) -> tuple[Any, Any]:
        return math.sin(angle), math.cos(angle)

    def root(self, number: Any) -> Any:
        return math.sqrt(number)

    def triple(self, place: Place, triple: Triple) -> Row:
        return tuple(self.number((*place, k), component) for k, component in enumerate(triple))


class _Digits(_Doubles):
    """Numbers of a model in 60 digits."""

    def number(self, place: Place, expression: Expression) -> Any:
        return self._valuation.digits(place, expression)

    def sine_cosine(self, angle: Any) -> tuple[Any, Any]:
        return DIGITS.sin(angle), DIGITS.cos(angle)

    def root(self, number: Any) -> Any:
        return DIGITS.sqrt(number)


_ORIGIN: Row = (0, 0, 0)


def _place(model: Model, numbers: _Doubles) -> _Mechanism:
    """Place the bodies of an expanded model, every joint somewhere else."""
    parents, order = index_parents(model), walk_bodies(model)
    solids: dict[int, _Solid] = {}
    for rank, i in enumerate(order):
        body, place, parent = model.bodies[i], ("bodies", i), parents[i]
        joint = body.joint
        assert not isinstance(joint, tuple), "an expanded model has no sequences"
        rotation, origin = identity(3), _ORIGIN
        if parent is not None:
            rotation, origin = solids[parent].rotation, solids[parent].origin
        origin = add(origin, apply(rotation, numbers.triple(place, joint.placement.position)))
        rotation = times(rotation, _turn_placement(joint.placement, numbers))
        turned, slid, axis = rotation, origin, _ORIGIN
        if not isinstance(joint, Fixed):
            axis = numbers.triple(place, joint.axis)
            largest = max(abs(component) for component in axis)
            axis = tuple(component / largest for component in axis)
            length = numbers.root(dot(axis, axis))
            axis = tuple(component / length for component in axis)
            q = 0.5 + (rank * GOLDEN) % 1  # radians or metres, no two alike
            if joint.motion is Motion.REVOLUTE:
                turned = times(rotation, _turn(axis, q, numbers))
            else:
                slid = add(origin, (x * q for x in apply(rotation, axis)))
        solids[i] = _Solid(
            rotation=turned,
            origin=slid,
            axis=apply(rotation, axis),
            mass=numbers.number(place, body.mass),
            com=add(slid, apply(turned, numbers.triple(place, body.com))),
            inertia=tuple(numbers.triple(place, row) for row in centre_inertia(body).rows),
            armature=0.0 if isinstance(joint, Fixed) else numbers.number(place, joint.armature),
        )
    return _Mechanism(model, parents, order, solids)


def _turn_placement(placement: Placement, numbers: _Doubles) -> Dense:
    rotation = identity(3)
    for step in placement.orientation:
        rotation = times(rotation, _turn(identity(3)[step.axis], numbers.number((), step.angle), numbers))
    return rotation


def _turn(axis: Row, angle: Any, numbers: _Doubles) -> Dense:
    """Rotate about a unit vector (Rodrigues)."""
    first, (sine, cosine) = skew(axis), numbers.sine_cosine(angle)
    return combine(lambda one, x, y: one + sine * x + (1 - cosine) * y, identity(3), first, times(first, first))
