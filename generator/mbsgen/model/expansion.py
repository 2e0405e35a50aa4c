"""Sequences of joints -> one joint per body: massless bodies are inserted, and all joints get names.

Unnamed joints of a sequence are named after their body and their axis: `trunk.x` slides along x, `trunk.rz` turns about
z, and a second one of the same kind is `trunk.rz2`. The body between `trunk.x` and the next joint is called `trunk.x`
too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from mbsgen.documents import Place
from mbsgen.expressions import Number
from mbsgen.model.model import Body, Fixed, Joint, Model, Triple
from mbsgen.model.tree import Motion


@dataclass(frozen=True)
class Step:
    """One joint of a Model, with its names and its place."""

    joint: Joint
    name: str  # of the joint
    mover: str  # of the body that it moves
    place: Place


@dataclass(frozen=True)
class Expansion:
    """A Model whose bodies have at most one joint, and where the joint of each is in the original."""

    model: Model
    places: tuple[Place, ...]


def expand(model: Model) -> Expansion:
    """Put massless bodies between the joints of a sequence."""
    bodies: list[Body] = []
    places: list[Place] = []
    for i, body in enumerate(model.bodies):
        if isinstance(body.joint, Fixed):
            bodies.append(body)
            places.append(("bodies", i, "joint"))
            continue
        carrier = body.parent
        for step in list_steps(i, body):
            joint = replace(step.joint, name=step.name)
            last = step.mover == body.name
            bodies.append(replace(body, joint=joint, parent=carrier) if last else Body(step.mover, joint, carrier))
            places.append(step.place)
            carrier = step.mover
    return Expansion(replace(model, bodies=tuple(bodies)), tuple(places))


def list_steps(i: int, body: Body) -> Iterator[Step]:
    """List the joints of body i, from the parent on."""
    if isinstance(body.joint, Joint):
        name = body.name if body.joint.name is None else body.joint.name
        yield Step(body.joint, name, body.name, ("bodies", i, "joint"))
        return
    labels = label_joints(body.joints)
    for k, (joint, label) in enumerate(zip(body.joints, labels, strict=True)):
        derived = f"{body.name}.{label}"
        name = derived if joint.name is None else joint.name
        yield Step(joint, name, derived if k < len(labels) - 1 else body.name, ("bodies", i, "joint", k))


def label_joints(joints: Sequence[Joint]) -> list[str]:
    """Name the joints of a sequence by their motion: x, ry, ...; t or r for any other axis."""
    seen: Counter[str] = Counter()
    labels = []
    for joint in joints:
        label = ("r" if joint.motion is Motion.REVOLUTE else "") + _name_axis(joint.axis)
        label = label or "t"
        seen[label] += 1
        labels.append(label if seen[label] == 1 else f"{label}{seen[label]}")
    return labels


def _name_axis(axis: Triple) -> str:
    """Name the coordinate axis that a direction lies on, if it says so in numbers."""
    letters = [letter for letter, component in zip("xyz", axis, strict=True) if component != Number(0.0)]
    return letters[0] if len(letters) == 1 and all(isinstance(component, Number) for component in axis) else ""
