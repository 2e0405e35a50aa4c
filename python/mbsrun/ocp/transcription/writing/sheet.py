"""Sheets: a structure and its plant -> the layout of the variables, and the rows and blocks that are written so far.

Every row and every place of a block has a stage: the interval whose variables it reads, and perhaps the next state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbsgen.expressions import Expression
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.functions import Array, Indices, KernelResult
from mbsrun.ocp.ground.integrators import Integrator
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Block, Column
from mbsrun.ocp.ground.schemes import Scheme
from mbsrun.ocp.problem import contacts, design
from mbsrun.ocp.problem.driving import derive
from mbsrun.ocp.problem.problem import Form, list_names
from mbsrun.ocp.problem.structure import Structure
from mbsrun.ocp.transcription import closing
from mbsrun.ocp.transcription.layout import Entries, ExtraSizes, Places, at_mesh, at_points, lay_out
from mbsrun.ocp.transcription.quantities import formulate
from mbsrun.quantities import find_component
from mbsrun.quaternions import list_quaternions
from mbsrun.recordings import references


class Sheet:
    """The layout of a program, and its rows and blocks so far; rows are numbered in the order of writing."""

    def __init__(self, shape: Structure, plant: Plant, scheme: Scheme, integrator: Integrator) -> None:
        """Lay out the variables."""
        self.shape, self.plant, self.manifest = shape, plant, plant.manifest
        self.quaternions = list_quaternions(plant.manifest)
        self.scheme, self.integrator, self.equations = scheme, integrator, shape.representation.equations
        self.motions = closing.list_motions(shape, plant.manifest)
        self.components = order_components(shape, plant.manifest)
        self.held = contacts.list_held(shape.contacts, plant.manifest)
        self.kernel = _read_forces(self.equations.write(shape.loops), plant)
        has_slopes = shape.takes_slopes or (shape.form is not Form.STANDARD and bool(self.quaternions))
        is_ode = shape.form is Form.STANDARD or has_slopes  # accelerations follow from the state, and are no variables
        self.layout = lay_out(
            self.motions,
            len(plant.manifest.actuated),
            shape.grid,
            len(integrator.stages.c),
            has_states=shape.form is Form.STANDARD,
            has_slopes=has_slopes,
            has_accelerations=self.equations.has_accelerations or not is_ode,
            horizon_is_free=shape.horizon is None,
            added=ExtraSizes(
                states=len(shape.rates),
                controls=len(shape.added.controls),
                given=tuple(i for i, _ in shape.forces),
                wrenches=len(self.components),
                steady=shape.steady,
            ),
            unknowns=len(shape.added.unknowns) + design.count_fixed(shape.added.unknowns, plant.manifest),
            has_constant_inputs=shape.inputs == "constant",
            closed=0 if shape.form is Form.STANDARD else len(integrator.closed.c),
            begins_interval=scheme.begins_interval,
        )
        chosen, fixed = np.split(self.layout.unknowns, [len(shape.added.unknowns)])
        theta = design.order_design(shape.added.unknowns, chosen, fixed, plant.manifest)
        self.layout = replace(self.layout, unknowns=chosen, design=theta)
        self.h = shape.grid.lengths(
            1.0 if shape.horizon is None else shape.horizon
        )  # (N,); times T, where that is free
        self.points = at_points(self.layout, integrator, self.h)
        self.last = at_mesh(self.layout, integrator, [shape.intervals])
        self.A = Entries()
        self.blocks: list[Block] = []
        self.stages: list[Indices] = []  # of the rows
        self.size = 0
        self.weights = 2 + len(shape.running) + len(shape.terminal) + len(shape.priced_controls)
        self.parameters = self.weights + len(shape.constants)  # and then attitudes, where they are written

    def take(self, stages: Indices | int, *shape: int) -> Indices:
        """Number some rows; `stages` is broadcast to their shape from the left."""
        first, self.size = self.size, self.size + int(np.prod(shape))
        given = np.asarray(stages, dtype=np.int64)
        self.stages.append(
            np.broadcast_to(given.reshape(*given.shape, *[1] * (len(shape) - given.ndim)), shape).ravel()
        )
        return np.arange(first, self.size).reshape(shape)

    def list_independent(self) -> tuple[int, ...]:
        """List the entries of qd that determine all others, without driven ones."""
        every = self.motions.independent if self.shape.loops is None else self.manifest.independent
        return tuple(i for i in every if i not in self.motions.driven)

    def find_velocities(self, which: Sequence[int]) -> list[int]:
        """Find entries of qd among the velocities that are variables."""
        return [self.motions.velocities.index(i) for i in which]

    @property
    def found_rows(self) -> int:
        """Count the rows of loops and of given motions at a point."""
        return self.loop_rows + len(self.motions.driven_states)

    @property
    def loop_rows(self) -> int:
        """Count the rows of loops at a point, with the lengths of quaternions that loops give."""
        return self.closing_rows + len(self.motions.lengths)

    @property
    def closing_rows(self) -> int:
        """Count the rows of coordinates, and of velocities where all are variables."""
        if self.shape.loops is None:
            return 0
        m = len(self.manifest.dependent)
        return 2 * m if len(self.motions.velocities) == len(self.manifest.coordinates) else m

    def list_given(self) -> list[str | Expression]:
        """List the expressions that give inputs, components of wrenches, and accelerations of driven joints."""
        forces, components = (text for _, text in self.shape.forces), (x for x in self.components if x is not None)
        return [*forces, *components, *(derive(text)[2] for text in self.shape.driven)]

    def place_given(self) -> Indices:
        """Return the variables (N, S, ...) that expressions give."""
        extras = self.layout.extras
        chosen = [i for i, text in enumerate(self.components) if text is not None]
        return np.concatenate((extras.forces, extras.wrenches[:, :, chosen], self.layout.drives), axis=2)

    def choose_accelerations(self, which: Sequence[int]) -> KernelResult:
        """Return the kernel with the rows, or accelerations, of some entries of qd."""
        moved = self.motions.moved
        if not self.equations.is_explicit or tuple(which) == moved:
            return self.kernel
        return replace(self.kernel, entries=tuple(moved.index(i) for i in which))

    def write_states(self, states: Indices, stage: int) -> Indices:
        """Write some states, whose rows the bounds give a value."""
        rows = self.take(stage, states.size)
        self.A.put(rows, states, 1.0)
        return rows

    @property
    def first(self) -> Places:
        """Return the start."""
        return at_mesh(self.layout, self.integrator, [0])

    def apply(
        self,
        texts: Sequence[str | Expression],
        places: Places,
        rows: Indices,
        stages: Indices,
        scale: Array | float = 1.0,
    ) -> Block:
        """Apply expressions at some places."""
        shape, layout = self.shape, self.layout
        computed = {"qdd": self.kernel} if shape.representation.is_ode else {}
        read = find_references(texts, shape)
        formula = formulate(
            texts,
            shape.constants,
            self.manifest,
            self.motions,
            computed,
            shape.horizon,
            shape.added,
            read,
            shape.functions,
        )
        parts = dict(places.parts)
        if layout.horizon is not None:
            parts["T"] = np.full((1, places.s.size), layout.horizon)
        parts["unknowns"] = np.repeat(layout.unknowns[:, None], places.s.size, axis=1)
        return Block(
            function=formula,
            columns=tuple(parts[part.kind] for part in formula.inputs),
            rows=rows,
            stages=stages,
            parameters=self.weights + np.arange(0 if formula.parameters is None else formula.parameters.size),
            data=None if formula.data is None else self.tabulate(read, places.s),
            scale=scale,
        )

    def tabulate(self, names: Sequence[str], s: Array) -> Array:
        """Return the numbers that are given at places: their time over the horizon, and references."""
        shape = self.shape
        return np.stack([s, *(references.evaluate(name, shape.references, s, shape.horizon) for name in names)])


def find_components(shape: Structure, manifest: Manifest) -> tuple[int, ...]:
    """Return the entry of w of each component of a wrench that the problem has."""
    found = (find_component(manifest, name, component) for name, component, _ in shape.wrenches)
    return tuple(i for i in found if i is not None)


def order_components(shape: Structure, manifest: Manifest) -> tuple[str | None, ...]:
    """Return the expression of each entry of w; None for one that is unknown."""
    found: dict[int, str | None] = {}
    for wrench, component, text in shape.wrenches:
        i = find_component(manifest, wrench, component)
        assert i is not None, "components are checked before"
        found[i] = text
    return tuple(found[i] for i in sorted(found))


def _read_forces(kernel: KernelResult, plant: Plant) -> KernelResult:
    """Return a kernel that reads components of open wrenches, and accelerations or forces of driven joints, if any."""
    if not plant.manifest.open_entries and not plant.manifest.driven:
        return kernel
    order = [a.name for a in plant.describe(kernel.kernel).inputs]
    inputs = {*kernel.inputs, *({"w", "a", "tau"} & set(order))}
    return replace(kernel, inputs=tuple(sorted(inputs, key=order.index)))


def find_references(texts: Sequence[str | Expression], shape: Structure) -> list[str]:
    """List the names of references that expressions read."""
    named = references.list_names(shape.references)
    read = frozenset[str]().union(*(list_names(text, shape.functions) for text in texts)) if named else frozenset()
    return sorted(name for name in read if name in named)


def pick(places: Places, kernel: KernelResult) -> tuple[Column, ...]:
    """Pick the inputs of a kernel."""
    return tuple(places.parts[name] for name in kernel.inputs)
