"""Joints whose accelerations are not determined: massless joints, and joints that undo each other's motion.

For these, M is singular at every configuration; else at almost none. So one configuration, chosen without symmetry, is
enough. A joint is massless if neither mass nor a rotor moves with it. Several joints undo each other if a pivot of the
articulated-body recursion vanishes: D_i = S_i . IA_i S_i (Featherstone, 2008, 7.3), which the joints beyond body i have
lowered to 0. A pivot that is small in doubles is computed again, in 60 digits.

Loops, constraints and drives do not help such a joint, although they may determine its motion: accelerations and
multipliers come from the factors of M, so M of the tree must be positive definite.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

Array = NDArray[Any]  # of doubles, or of numbers of 60 digits


@dataclass(frozen=True)
class _Solid:
    """A body of an expanded model at the chosen configuration, in the base's frame."""

    rotation: Array  # of the body's frame
    origin: Array
    axis: Array  # of its joint; 0 where it is fixed
    mass: Any
    com: Array
    inertia: Array  # about com, in the body's frame
    armature: Any  # of its joint

    @property
    def lever(self) -> Array:
        return self.com - self.origin


def check_undetermined_joints(model: Model) -> Iterator[Finding]:
    """Find the joints of a checked model whose accelerations nothing determines."""
    expansion = expand(model)
    bodies = expansion.model.bodies
    mechanism = _place(expansion.model, _Doubles(expansion.model))
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is computed in digits
        massless = [i for i in mechanism.order if isinstance(bodies[i].joint, Joint) and not mechanism.feels(i)]
        is_clear = not massless and not mechanism.find_undone(DOUBTFUL)
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
        mass, com, inertia, rotation = (part[rank : rank + self._sizes[i]] for part in self._rows)
        if carrier.armature:
            return True
        if isinstance(joint, Joint) and joint.motion is Motion.PRISMATIC:
            return bool(np.any(mass != 0))
        about = np.einsum("bij,i->bj", rotation, carrier.axis)
        lever = np.cross(carrier.axis, com - carrier.origin)
        felt = mass * (lever**2).sum(axis=1) + np.einsum("bi,bij,bj->b", about, inertia, about)
        scale = mass * ((com**2).sum(axis=1) + carrier.origin @ carrier.origin) + np.abs(inertia).max(axis=(1, 2))
        return not (np.isfinite(scale).all() and np.all(np.abs(felt) <= TOLERANCE * scale))

    def find_undone(self, tolerance: float) -> dict[int, list[int]]:
        """Find the joints whose pivots vanish, relative to M_ii, each with the joints that undo what it does."""
        articulated, composite = ({i: _inertia(self.solids[i]) for i in self.order} for _ in "ab")
        answers: dict[int, Array] = {}  # the acceleration of a joint for its parent's, to be subtracted
        undone: dict[int, list[int]] = {}
        for i in reversed(self.order):
            solid, S = self.solids[i], self._direction(i)
            if S is not None:
                U = articulated[i] @ S
                pivot = S @ U + solid.armature
                if not abs(pivot) > tolerance * abs(S @ composite[i] @ S + solid.armature):  # or no number
                    undone[i] = self._answer(i, S, answers)
                else:
                    answers[i] = U / pivot
                    articulated[i] = articulated[i] - np.outer(U, U) / pivot
            parent = self.parents[i]
            if parent is not None:
                shift = _shift(solid.origin - self.solids[parent].origin)
                for inertias in (articulated, composite):
                    inertias[parent] = inertias[parent] + shift.T @ inertias[i] @ shift
        return dict(sorted(undone.items()))

    def _answer(self, i: int, S: Array, answers: Mapping[int, Array]) -> list[int]:
        """List the joints that body i carries and that answer a motion of its joint, where no force is needed."""
        moving, amounts = {i: S}, {}
        rank = self._ranks[i]
        for k in self.order[rank + 1 : rank + self._sizes[i]]:
            parent = self.parents[k]
            assert parent is not None, "what a body carries has a parent"
            moving[k] = _shift(self.solids[k].origin - self.solids[parent].origin) @ moving[parent]
            own = self._direction(k)
            if own is not None and k in answers:
                amounts[k] = answers[k] @ moving[k]
                moving[k] = moving[k] - own * amounts[k]
        largest = max(map(abs, amounts.values()), default=0)
        return [k for k, amount in amounts.items() if abs(amount) > INVOLVED * largest]

    def _direction(self, i: int) -> Array | None:
        """The motion of a joint: angular velocity, and velocity of its origin."""
        joint, axis = self.model.bodies[i].joint, self.solids[i].axis
        if not isinstance(joint, Joint):
            return None
        return np.concatenate((axis, 0 * axis) if joint.motion is Motion.REVOLUTE else (0 * axis, axis))

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

    @cached_property
    def _rows(self) -> tuple[Array, Array, Array, Array]:
        solids = [self.solids[i] for i in self.order]
        return (
            np.array([x.mass for x in solids]),
            np.array([x.com for x in solids]),
            np.array([x.inertia for x in solids]),
            np.array([x.rotation for x in solids]),
        )


def _inertia(solid: _Solid) -> Array:
    """The spatial inertia about the origin of a body, in the base's axes: what velocities are to be multiplied by."""
    m, c = solid.mass, _cross(solid.lever)
    about = solid.rotation @ solid.inertia @ solid.rotation.T - m * (c @ c)
    return np.block([[about, m * c], [-m * c, m * np.eye(3, dtype=int)]])


def _shift(d: Array) -> Array:
    """Take a velocity to a point that is further by d."""
    one = np.eye(3, dtype=int)
    return np.block([[one, 0 * one], [-_cross(d), one]])


def _cross(v: Array) -> Array:
    x, y, z = v
    return np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])


# --- numbers ---------------------------------------------------------------------------------------------------------


class _Doubles:
    """Numbers of a model in doubles."""

    def __init__(self, model: Model) -> None:
        self._valuation = Valuation(model.parameters, (), generic=True)

    def number(self, place: Place, expression: Expression) -> Any:
        return self._valuation.number(place, expression)

    def sine_cosine(self, angle: Any) -> tuple[Any, Any]:
        return np.sin(angle), np.cos(angle)

    def root(self, number: Any) -> Any:
        return np.sqrt(number)

    def triple(self, place: Place, triple: Triple) -> Array:
        return np.array([self.number((*place, k), component) for k, component in enumerate(triple)])


class _Digits(_Doubles):
    """Numbers of a model in 60 digits."""

    def number(self, place: Place, expression: Expression) -> Any:
        return self._valuation.digits(place, expression)

    def sine_cosine(self, angle: Any) -> tuple[Any, Any]:
        return DIGITS.sin(angle), DIGITS.cos(angle)

    def root(self, number: Any) -> Any:
        return DIGITS.sqrt(number)


def _place(model: Model, numbers: _Doubles) -> _Mechanism:
    """Place the bodies of an expanded model, every joint somewhere else."""
    parents, order = index_parents(model), walk_bodies(model)
    solids: dict[int, _Solid] = {}
    for rank, i in enumerate(order):
        body, place, parent = model.bodies[i], ("bodies", i), parents[i]
        joint = body.joint
        assert not isinstance(joint, tuple), "an expanded model has no sequences"
        rotation, origin = np.eye(3, dtype=int), np.zeros(3, dtype=int)
        if parent is not None:
            rotation, origin = solids[parent].rotation, solids[parent].origin
        origin = origin + rotation @ numbers.triple(place, joint.placement.position)
        rotation = rotation @ _turn_placement(joint.placement, numbers)
        turned, slid, axis = rotation, origin, np.zeros(3, dtype=int)
        if not isinstance(joint, Fixed):
            axis = numbers.triple(place, joint.axis)
            axis = axis / max(abs(component) for component in axis)
            axis = axis / numbers.root(axis @ axis)
            q = 0.5 + (rank * GOLDEN) % 1  # radians or metres, no two alike
            if joint.motion is Motion.REVOLUTE:
                turned = rotation @ _turn(axis, q, numbers)
            else:
                slid = origin + rotation @ axis * q
        solids[i] = _Solid(
            rotation=turned,
            origin=slid,
            axis=rotation @ axis,
            mass=numbers.number(place, body.mass),
            com=slid + turned @ numbers.triple(place, body.com),
            inertia=np.array([numbers.triple(place, row) for row in centre_inertia(body).rows]),
            armature=0.0 if isinstance(joint, Fixed) else numbers.number(place, joint.armature),
        )
    return _Mechanism(model, parents, order, solids)


def _turn_placement(placement: Placement, numbers: _Doubles) -> Array:
    rotation: Array = np.eye(3, dtype=int)
    for step in placement.orientation:
        rotation = rotation @ _turn(np.eye(3, dtype=int)[step.axis], numbers.number((), step.angle), numbers)
    return rotation


def _turn(axis: Array, angle: Any, numbers: _Doubles) -> Array:
    """Rotate about a unit vector (Rodrigues)."""
    cross, (sine, cosine) = _cross(axis), numbers.sine_cosine(angle)
    turned: Array = np.eye(3, dtype=int) + sine * cross + (1 - cosine) * (cross @ cross)
    return turned
