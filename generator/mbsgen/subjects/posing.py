"""A model at a pose -> places and attitudes of its sensors, and lengths of the lines of its forces.

Free joints stand where the start puts them, or at 0; followers and explicit equations give all others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.comparison import evaluate_tape
from mbsgen.expressions import FLOATS, Expression, Number, evaluate, find_first_name, names, substitute
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.following import list_joints
from mbsgen.model.model import Joint, Model
from mbsgen.model.tree import Kind
from mbsgen.procedure.procedure import straight

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Posed:
    """A model at a pose."""

    places: Mapping[str, Array]  # of sensors, in the base [m]
    attitudes: Mapping[str, Array]  # of sensors, (3, 3): their axes as columns, in the base
    lengths: Mapping[str, float]  # of force elements [m]

    def rename(self, labels: Mapping[str, str]) -> Posed:
        """Return the same under other names, as far as there are any."""
        return Posed(*({labels.get(name, name): x for name, x in part.items()} for part in self._parts))

    @property
    def _parts(self) -> tuple[Mapping[str, Any], ...]:
        return self.places, self.attitudes, self.lengths


def pose(model: Model, start: Mapping[str, float]) -> Posed:
    """Compute places and lengths where free joints have the coordinates `start`, by name [rad or m]. No loops."""
    joints = {step.name: step.joint for step in list_joints(model)}
    explicit = {first: x.equation for x in model.constraints if (first := find_first_name(x.equation)) in joints}
    values: dict[str, float] = {}
    for parameter in model.parameters:
        values[parameter.name] = evaluate(parameter.value, values, FLOATS)
    constants = tuple(replace(x, kind=Kind.CONSTANT) for x in model.parameters)
    tree = build_tree(replace(model, parameters=constants, constraints=(), loops=(), independent=(), assembly=()))
    order = [x.joint.name for x in tree.bodies if joints[x.joint.name].follows is None]
    q = np.array([_find(name, start, joints, explicit, values) for name in order])

    def compute(name: str) -> dict[str, Array]:
        tape = straight(FUNCTIONS[name].build(tree, replace(ALL, trials=1)))
        return evaluate_tape(tape, {i.name: q if i.name == "q" else np.zeros(i.sparsity.nnz) for i in tape.inputs})

    frames = [x.name for x in model.frames if x.is_sensor]
    places = compute("sensors")["position"] if frames else np.zeros((3, 0))
    axes = compute("attitudes")["attitude"] if frames else np.zeros((3, 0))
    lengths = compute("lengths")["length"].tolist() if tree.elements else []
    return Posed(
        dict(zip(frames, np.reshape(places, (3, -1)).T, strict=True)),
        {name: axes[:, 3 * k : 3 * k + 3] for k, name in enumerate(frames)},
        dict(zip(tree.elements, np.reshape(lengths, -1).tolist(), strict=True)),
    )


def has_loops(model: Model) -> bool:
    """Return whether a pose of the model has to be closed first."""
    joints = {step.name for step in list_joints(model)}
    return bool(model.loops) or any(find_first_name(x.equation) not in joints for x in model.constraints)


def _find(
    name: str,
    start: Mapping[str, float],
    joints: Mapping[str, Joint],
    explicit: Mapping[str, Expression],
    values: Mapping[str, float],
) -> float:
    """Return the coordinate of a joint."""
    if name in explicit:
        rest = substitute(explicit[name], {name: Number(0.0)})
        others = {x: _find(x, start, joints, explicit, values) for x in names(rest) if x in joints}
        return -evaluate(rest, {**values, **others}, FLOATS)
    follows = joints[name].follows
    if follows is None:
        return start.get(name, 0.0)
    ratio, offset = (evaluate(x, values, FLOATS) for x in (follows.ratio, follows.offset))
    return ratio * _find(follows.joint, start, joints, explicit, values) + offset
