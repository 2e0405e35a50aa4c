"""Numbers of a mechanism that a problem changes: values of its parameters, and unknowns that the solver chooses.

An unknown with the name of a differentiated parameter takes its place: kernels read it by their input theta,

    Phi(q, qd, qdd, u, theta) = 0,    positions and velocities of sensors likewise,

and are differentiated by it. All entries of theta are variables then; the other ones are bounded by their values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mbsgen.manifest import Manifest
from mbsgen.roles import Role
from mbsrun.ocp.ground.functions import Formula, Indices, Input, KernelResult
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Block
from mbsrun.ocp.ground.trajectory import Array
from mbsrun.ocp.problem.problem import Problem

SomePlant = TypeVar("SomePlant", bound=Plant)


def lists_design(names: Iterable[str], manifest: Manifest) -> bool:
    """Return whether a name is a differentiated parameter's."""
    return not {p.name for p in manifest.design}.isdisjoint(names)


def count_fixed(unknowns: Sequence[str], manifest: Manifest) -> int:
    """Count the entries of theta that are variables without being unknowns."""
    return len(_list_fixed(unknowns, manifest))


def list_fixed_values(unknowns: Sequence[str], plant: Plant) -> tuple[float, ...]:
    """Return the values of these entries."""
    return tuple(plant.parameters[name] for name in _list_fixed(unknowns, plant.manifest))


def order_design(unknowns: Sequence[str], variables: Indices, fixed: Indices, manifest: Manifest) -> Indices:
    """Return the variable of each entry of theta; none where no unknown is among them."""
    if not lists_design(unknowns, manifest):
        return np.zeros(0, dtype=np.int64)
    at = dict(zip([*unknowns, *_list_fixed(unknowns, manifest)], [*variables, *fixed], strict=True))
    return np.array([at[p.name] for p in manifest.design], dtype=np.int64)


def read_design(block: Block, design: Indices, plant: Plant) -> Block:
    """Return a block whose kernels read theta from variables."""
    if not design.size:
        return block
    column = np.repeat(design[:, None], block.places, axis=1)
    function = block.function
    if isinstance(function, KernelResult):
        own = _take(function, plant)
        return block if own is function else replace(block, function=own, columns=(*block.columns, column))
    computed = tuple((kind, _take(result, plant)) for kind, result in function.computed)
    if computed == function.computed:
        return block
    theta = next(
        result.inputs[-1] for (_, result), (_, old) in zip(computed, function.computed, strict=True) if result != old
    )
    formula: Formula = replace(function, inputs=(*function.inputs, Input(theta, design.size)), computed=computed)
    return replace(block, function=formula, columns=(*block.columns, column))


def equip(plant: SomePlant, problem: Problem, values: Array | None = None) -> SomePlant:
    """Return the kernels with a problem's parameters; of unknowns, with given values, or their guesses."""
    given = [unknown.guess for unknown in problem.unknowns] if values is None or not values.size else values.tolist()
    every = dict(problem.parameters) | dict(zip((x.name for x in problem.unknowns), given, strict=True))
    changes = {name: value for name, value in every.items() if plant.parameters.get(name, value) != value}
    return plant.with_parameters(**changes) if changes else plant


def _take(result: KernelResult, plant: Plant) -> KernelResult:
    """Add theta to the inputs of a kernel that takes it."""
    theta = [a.name for a in plant.describe(result.kernel).inputs if a.role is Role.DESIGN]
    return replace(result, inputs=(*result.inputs, *theta)) if theta else result


def _list_fixed(unknowns: Sequence[str], manifest: Manifest) -> list[str]:
    if not lists_design(unknowns, manifest):
        return []
    return [p.name for p in manifest.design if p.name not in unknowns]


def list_changeable(manifest: Manifest) -> Mapping[str, bool]:
    """Return the parameters that may be given values, and whether kernels are differentiated by each."""
    return {p.name: False for p in manifest.parameters} | {p.name: True for p in manifest.design}
