"""Joints that move nothing: no motion of theirs is felt by any mass, whatever the other joints do.

M would have a zero on its diagonal: at every configuration, or else at almost none. So one configuration tells, chosen
without symmetry.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.model.findings import Finding
from mbsgen.model.model import Model, Placement
from mbsgen.model.topology import sort_bodies
from mbsgen.model.tree import Motion
from mbsgen.model.valuation import Array, Valuation

TOLERANCE = 1e-26  # of what would be felt off the axis: rounding squared, with room
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class _Solid:
    """A body at the chosen configuration, in the base's frame."""

    rotation: Array  # of the body's frame
    origin: Array
    axis: Array  # of its joint
    mass: float
    com: Array
    inertia: Array  # about com, in the body's frame


def check_idle_joints(model: Model) -> Iterator[Finding]:
    """Find the joints whose subtree has no inertia about their axis, or no mass along it."""
    solids = _place_solids(model)
    names = {body.name: i for i, body in enumerate(model.bodies)}
    children: list[list[int]] = [[] for _ in model.bodies]
    for i, body in enumerate(model.bodies):
        if body.parent in names:
            children[names[body.parent]].append(i)
    for i, body in enumerate(model.bodies):
        if not _is_felt(i, solids, children, body.joint.motion):
            what = "inertia about" if body.joint.motion is Motion.REVOLUTE else "mass along"
            finding = f"joint {abbreviate(body.joint.name)} moves nothing: what it carries has no {what} its axis"
            yield Finding(("bodies", i, "joint"), finding, "give a body it carries mass, or take the joint away")


def _is_felt(joint: int, solids: list[_Solid], children: list[list[int]], motion: Motion) -> bool:
    waiting = [joint]
    while waiting:
        i = waiting.pop()
        felt, scale = _weigh(solids[joint], solids[i], motion)
        if not abs(felt) <= TOLERANCE * scale:
            return True
        waiting += children[i]
    return False


def _weigh(carrier: _Solid, body: _Solid, motion: Motion) -> tuple[float, float]:
    """Tell the inertia of a body that a joint feels, and the inertia it would feel if nothing lay on its axis."""
    if motion is Motion.PRISMATIC:
        return body.mass, 0.0
    lever = np.cross(carrier.axis, body.com - carrier.origin)
    about = body.rotation.T @ carrier.axis
    felt = body.mass * (lever @ lever) + about @ body.inertia @ about
    scale = body.mass * (body.com @ body.com + carrier.origin @ carrier.origin) + np.abs(body.inertia).max()
    return float(felt), float(scale)


def _place_solids(model: Model) -> list[_Solid]:
    valuation = Valuation(model.parameters, (), generic=True)
    solids: dict[str, _Solid] = {}
    for rank, i in enumerate(sort_bodies(model)):
        body, place = model.bodies[i], ("bodies", i)
        rotation, origin = np.eye(3), np.zeros(3)
        if body.parent in solids:
            rotation, origin = solids[body.parent].rotation, solids[body.parent].origin
        origin = origin + rotation @ valuation.triple(place, body.joint.placement.position)
        rotation = rotation @ _turn_placement(body.joint.placement, valuation)
        axis = valuation.triple(place, body.joint.axis)
        axis /= np.abs(axis).max()
        axis /= np.linalg.norm(axis)
        q = 0.5 + (rank * GOLDEN) % 1  # radians or metres, no two alike
        turned = rotation @ _turn(axis, q) if body.joint.motion is Motion.REVOLUTE else rotation
        slid = origin if body.joint.motion is Motion.REVOLUTE else origin + rotation @ axis * q
        solids[body.name] = _Solid(
            rotation=turned,
            origin=slid,
            axis=rotation @ axis,
            mass=valuation.number(place, body.mass),
            com=slid + turned @ valuation.triple(place, body.com),
            inertia=np.array([valuation.triple(place, row) for row in body.inertia.rows]),
        )
    return [solids[body.name] for body in model.bodies]


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
