"""Joints that move nothing: no motion of theirs is felt by any mass, whatever the other joints do, nor by a rotor.

M would have a zero on its diagonal: at every configuration, or else at almost none. So one configuration tells, chosen
without symmetry.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.model.expansion import expand
from mbsgen.model.findings import Finding
from mbsgen.model.model import Fixed, Joint, Model, Placement
from mbsgen.model.topology import index_parents, walk_bodies
from mbsgen.model.tree import Motion
from mbsgen.model.valuation import Array, Valuation

TOLERANCE = 1e-26  # of what would be felt off the axis: rounding squared, with room
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class _Solid:
    """A body of an expanded model at the chosen configuration, in the base's frame."""

    rotation: Array  # of the body's frame
    origin: Array
    axis: Array  # of its joint; 0 where it is fixed
    mass: float
    com: Array
    inertia: Array  # about com, in the body's frame
    armature: float  # of its joint


def check_idle_joints(model: Model) -> Iterator[Finding]:
    """Find the joints whose subtree has no inertia about their axis, or no mass along it."""
    expansion = expand(model)
    model = expansion.model
    parents, order = index_parents(model), walk_bodies(model)
    solids = _place_solids(model, parents, order)
    row = _Row.of([solids[i] for i in order])
    carried = [1] * len(order)  # bodies of each subtree
    for i in reversed(order):
        parent = parents[i]
        if parent is not None:
            carried[parent] += carried[i]
    for rank, i in enumerate(order):
        joint = model.bodies[i].joint
        if not isinstance(joint, Joint):
            continue
        subtree = slice(rank, rank + carried[i])
        if not solids[i].armature and not _is_felt(solids[i], row, subtree, joint.motion):
            what = "inertia about" if joint.motion is Motion.REVOLUTE else "mass along"
            finding = f"joint {abbreviate(joint.name)} moves nothing: what it carries has no {what} its axis"
            yield Finding(expansion.places[i], finding, "give a body it carries mass, or take the joint away")


@dataclass(frozen=True)
class _Row:
    """Solids in a row, the bodies of any subtree next to each other: (bodies, ...)."""

    mass: Array
    com: Array
    inertia: Array
    rotation: Array

    @staticmethod
    def of(solids: list[_Solid]) -> _Row:
        return _Row(
            np.array([x.mass for x in solids]),
            np.array([x.com for x in solids]),
            np.array([x.inertia for x in solids]),
            np.array([x.rotation for x in solids]),
        )


def _is_felt(carrier: _Solid, row: _Row, bodies: slice, motion: Motion) -> bool:
    """Compare what each body brings with what it would bring if nothing lay on the axis; sums would hide light ones."""
    mass, com, inertia = row.mass[bodies], row.com[bodies], row.inertia[bodies]
    if motion is Motion.PRISMATIC:
        return bool(np.any(mass != 0))
    about = np.einsum("bij,i->bj", row.rotation[bodies], carrier.axis)
    lever = np.cross(carrier.axis, com - carrier.origin)
    felt = mass * (lever**2).sum(axis=1) + np.einsum("bi,bij,bj->b", about, inertia, about)
    scale = mass * ((com**2).sum(axis=1) + carrier.origin @ carrier.origin) + np.abs(inertia).max(axis=(1, 2))
    return not np.all(np.abs(felt) <= TOLERANCE * scale)


def _place_solids(model: Model, parents: list[int | None], order: list[int]) -> dict[int, _Solid]:
    valuation = Valuation(model.parameters, (), generic=True)
    solids: dict[int, _Solid] = {}
    for rank, i in enumerate(order):
        body, place, parent = model.bodies[i], ("bodies", i), parents[i]
        joint = body.joint
        assert not isinstance(joint, tuple), "an expanded model has no sequences"
        rotation, origin = np.eye(3), np.zeros(3)
        if parent is not None:
            rotation, origin = solids[parent].rotation, solids[parent].origin
        origin = origin + rotation @ valuation.triple(place, joint.placement.position)
        rotation = rotation @ _turn_placement(joint.placement, valuation)
        turned, slid, axis = rotation, origin, np.zeros(3)
        if not isinstance(joint, Fixed):
            axis = valuation.triple(place, joint.axis)
            axis /= np.abs(axis).max()
            axis /= np.linalg.norm(axis)
            q = 0.5 + (rank * GOLDEN) % 1  # radians or metres, no two alike
            if joint.motion is Motion.REVOLUTE:
                turned = rotation @ _turn(axis, q)
            else:
                slid = origin + rotation @ axis * q
        solids[i] = _Solid(
            rotation=turned,
            origin=slid,
            axis=rotation @ axis,
            mass=valuation.number(place, body.mass),
            com=slid + turned @ valuation.triple(place, body.com),
            inertia=np.array([valuation.triple(place, row) for row in body.inertia.rows]),
            armature=0.0 if isinstance(joint, Fixed) else valuation.number(place, joint.armature),
        )
    return solids


def _turn_placement(placement: Placement, valuation: Valuation) -> Array:
    rotation = np.eye(3)
    for step in placement.orientation:
        rotation = rotation @ _turn(np.eye(3)[step.axis], valuation.number((), step.angle))
    return rotation


def _turn(axis: Array, angle: float) -> Array:
    """Rotate about a unit vector (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return turned
