"""The rows and variables of links, behind the direct sum of the phases' programs.

    q_to - map(q_from) = 0,    qd_to - d/dt map(q_from) = 0          states of equal names where `map` has no entry
    condition(x_from(T), x_to(0)) within its range,    cost += weight * expression(x_from(T), x_to(0))

With an impact, q and qd of the phase before are replaced by q, and by the velocities after it: see `impacts`. Unknowns
that phases share are variables of links; each phase's own copy is tied to them. Sensors that conditions read are
variables of links too, since each belongs to the kernels of one plant: s - sensors(q) = 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mbsgen.expressions import Expression, Name, Number, names, parse, substitute
from mbsrun.differentiation import differentiate
from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Formula, Indices, Input, KernelResult
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Block, Column, Matrix
from mbsrun.ocp.problem.design import list_fixed_values, order_design, read_design
from mbsrun.ocp.problem.phases import Condition, Map
from mbsrun.ocp.problem.problem import Term
from mbsrun.ocp.transcription.addition import Offsets
from mbsrun.ocp.transcription.layout import Entries
from mbsrun.ocp.transcription.sides import Side, State, spell_coordinates, spell_velocities
from mbsrun.quantities import SENSED, Quantity
from mbsrun.quaternions import find_quaternion, list_quaternions

Impulses = Mapping[str, int]  # the variables of an impact's impulses, by name
Places = tuple[str, int]  # kind and index of a name in a formula
_KERNELS: Mapping[str, KernelResult] = {kind: KernelResult(x.kernel, x.inputs, x.result) for kind, x in SENSED.items()}


@dataclass(frozen=True)
class Defined:
    """Variables of links that some rows give, where the variables before them are known: for a first guess."""

    variables: Indices
    rows: Indices


class Rows:
    """Collects rows, variables, blocks, bounds and descriptions of links."""

    def __init__(self, begin: Offsets, unknowns: Sequence[str], constants: Sequence[str], plants: Sequence[Plant]):
        """Begin behind programs; `plants` are the ones whose kernels the rows read."""
        self.first_variable, self.first_row, self.first_parameter = begin.variables, begin.rows, begin.constants
        self.variables, self.rows = begin.variables, begin.rows
        self.plants = plants
        self.constants = list(constants)
        self.A = Entries()
        self.blocks: list[Block] = []
        self.costs: list[Block] = []
        self.first_weight = self.weights = begin.weights
        self.texts: list[tuple[Indices, str]] = []
        self.defined: list[Defined] = []
        self.variable_bounds: list[tuple[Indices, float, float]] = []
        self.row_bounds: list[tuple[Indices, float, float]] = []
        self.unknowns = dict(zip(unknowns, self.add_variables(len(unknowns)).tolist(), strict=True))
        self.designs = {i: self._add_design(plant) for i, plant in enumerate(plants)}

    def _add_design(self, plant: Plant) -> Indices:
        """Return the variables of a plant's differentiated parameters, if an unknown is among them."""
        names = list(self.unknowns)
        fixed = [self.add_variables(1, value, value) for value in list_fixed_values(names, plant)]
        every = np.array(list(self.unknowns.values()), dtype=np.int64)
        return order_design(names, every, np.concatenate([*fixed, every[:0]]), plant.manifest)

    def add_variables(self, count: int, lower: float = -np.inf, upper: float = np.inf) -> Indices:
        """Number some variables."""
        found = np.arange(self.variables, self.variables + count, dtype=np.int64)
        self.variables += count
        self.variable_bounds.append((found, lower, upper))
        return found

    def add_rows(self, count: int, text: str, lower: float = 0.0, upper: float = 0.0) -> Indices:
        """Number some rows, which a failure describes by `text`."""
        found = np.arange(self.rows, self.rows + count, dtype=np.int64)
        self.rows += count
        self.row_bounds.append((found, lower, upper))
        self.texts.append((found, text))
        return found

    def add_weights(self, count: int) -> Indices:
        """Number some terms of the cost."""
        found = np.arange(self.weights, self.weights + count, dtype=np.int64)
        self.weights += count
        return found

    def matrix(self) -> Matrix:
        """Return the linear part of the rows, (rows of links, all variables)."""
        shape = (self.rows, self.variables)
        whole = self.A.matrix(shape) if self.A.parts else sparse.csc_array(shape)
        return sparse.csc_array(sparse.csr_array(whole)[self.first_row :])

    def apply(
        self,
        function: Formula | KernelResult,
        columns: Sequence[Column],
        rows: Indices,
        *,
        is_cost: bool = False,
        **more: object,
    ) -> None:
        """Apply a function once; the rows of a cost are weights."""
        none = np.zeros(1, dtype=np.int64)
        block = Block(function, tuple(columns), rows[:, None], none, **more)  # type: ignore[arg-type]
        if isinstance(function, KernelResult):
            block = read_design(block, self.designs[block.plant], self.plants[block.plant])
        (self.costs if is_cost else self.blocks).append(block)

    def write_expressions(
        self,
        expressions: Sequence[Expression],
        known: Mapping[str, Places],
        parts: Mapping[str, Column],
        rows: Indices,
        scale: float = 1.0,
        *,
        is_cost: bool = False,
    ) -> None:
        """Write expressions of variables, of unknowns and of constants into rows, or as terms of the cost."""
        known = {
            **{name: ("constants", i) for i, name in enumerate(self.constants)},
            **{name: ("unknowns", i) for i, name in enumerate(self.unknowns)},
            **known,
        }
        parts = {**parts, "unknowns": np.array([*self.unknowns.values()], dtype=np.int64)[:, None]}
        read = {name: known[name] for expression in expressions for name in sorted(names(expression))}
        kinds = {kind for kind, _ in read.values()}
        if not kinds:  # numbers alone: a function needs an input
            kinds = {next(kind for kind, part in parts.items() if _count(part))}
        chosen = [kind for kind in parts if kind in kinds]
        has_constants = "constants" in kinds
        formula = Formula(
            expressions=tuple(expressions),
            names=read,
            inputs=tuple(Input(kind, _count(parts[kind])) for kind in chosen),
            parameters=Input("constants", len(self.constants)) if has_constants else None,
        )
        parameters = self.first_parameter + np.arange(len(self.constants) if has_constants else 0)
        columns = [parts[kind] for kind in chosen]
        self.apply(formula, columns, rows, is_cost=is_cost, parameters=parameters, scale=scale)


def _count(part: Column) -> int:
    """Return the size of a part of the variables at one place."""
    return len(part) if isinstance(part, np.ndarray) else part.size


def write_transfer(rows: Rows, text: str, source: State, target: State, given: Map, velocities: Map) -> None:
    """Tie the coordinates and velocities of `target` to the ones of `source`."""
    chosen, speeds = dict(given), dict(velocities)
    turning, plain = list_quaternions(target.manifest), source.coordinates
    known: dict[str, Places] = {name: ("q", i) for name, i in spell_coordinates(source.manifest).items()}
    known |= {name: ("states", i) for i, name in enumerate(source.added)}
    rates: dict[str, Expression] = {}
    for name, i in spell_velocities(source.manifest).items():
        if i in source.velocities:
            rates[name], known[f"@{name}"] = Name(f"@{name}"), ("qd", source.velocities.index(i))
    written: list[tuple[int, Expression, str]] = []
    _copy_attitudes(rows, source, target, text)
    for i, (name, variable) in enumerate(target.coordinates.items()):
        if find_quaternion(turning, i) is not None:
            continue
        if name in chosen:
            if (text_of := chosen[name]) is not None:
                written.append((variable, parse(text_of), name))
        elif name in plain:
            _copy(rows, variable, plain[name], f"{text}: {name}")
    for name, variable in target.added.items():
        if name in chosen:
            if (text_of := chosen[name]) is not None:
                written.append((variable, parse(text_of), name))
        elif name in source.added:
            _copy(rows, variable, source.added[name], f"{text}: {name}")
    for name, variable in target.speeds.items():
        own = f"the velocity of {name}"
        if name in speeds:
            if (text_of := speeds[name]) is not None:
                written.append((variable, substitute(parse(text_of), rates), own))
        elif name in target.coordinates and (text_of := chosen.get(name)) is not None:
            written.append((variable, differentiate(parse(text_of), rates), own))
        elif name in source.speeds:
            _copy(rows, variable, source.speeds[name], f"{text}: {own}")
    if written:
        first = rows.rows
        for variable, _, name in written:
            rows.A.put(rows.add_rows(1, f"{text}: {name}"), [variable], 1.0)
        states = np.array(list(source.added.values()), dtype=np.int64)
        parts = {kind: part[:, None] for kind, part in (("q", source.q), ("qd", source.qd), ("states", states))}
        found = np.arange(first, rows.rows)
        rows.write_expressions([expression for _, expression, _ in written], known, parts, found, scale=-1.0)


def _copy(rows: Rows, target: int, source: int, text: str) -> None:
    row = rows.add_rows(1, text)
    rows.A.put(row, [target], 1.0)
    rows.A.put(row, [source], -1.0)


def _copy_attitudes(rows: Rows, source: State, target: State, text: str) -> None:
    """Tie quaternions by their attitudes: three equations; the length at a free start is set by itself."""
    known = {quaternion.joint: quaternion for quaternion in list_quaternions(source.manifest)}
    for quaternion in list_quaternions(target.manifest):
        if quaternion.joint in known:
            found = rows.add_rows(3, f"{text}: the attitude of {quaternion.joint}")
            parts = (target.q[quaternion.entries], source.q[known[quaternion.joint].entries])
            rows.apply(formulas.compare_two_attitudes(), [part[:, None] for part in parts], found)


def write_conditions(
    rows: Rows, text: str, conditions: Sequence[Condition], before: Side, after: Side, impulses: Impulses
) -> Indices:
    """Write the conditions of a link; return their rows."""
    found = np.concatenate(
        [rows.add_rows(1, f"{text}: {condition.expression}") for condition in conditions] or [np.zeros(0, np.int64)]
    )
    _write_both_sides(rows, [condition.expression for condition in conditions], before, after, impulses, found)
    return found


def write_costs(rows: Rows, terms: Sequence[Term], before: Side, after: Side, impulses: Impulses) -> Indices:
    """Write the terms of the cost of a link; return their weights' numbers."""
    found = rows.add_weights(len(terms))
    texts = [term.expression for term in terms]
    _write_both_sides(rows, texts, before, after, impulses, found, is_cost=True)
    return found


def _write_both_sides(
    rows: Rows,
    texts: Sequence[str],
    before: Side,
    after: Side,
    impulses: Impulses,
    found: Indices,
    *,
    is_cost: bool = False,
) -> None:
    """Write expressions of both sides of a link, and of its impulses."""
    if not texts:
        return
    expressions = [parse(text) for text in texts]
    read = sorted(set().union(*(names(expression) for expression in expressions)))
    known: dict[str, Places] = {}
    parts: dict[str, Column] = {}
    numbers: dict[str, Expression] = {}
    for side in (before, after):
        wanted = {name: side.readable[name] for name in read if name in side.readable}
        if side.prefix + "T" in wanted and isinstance(side.horizon, float):
            numbers[side.prefix + "T"] = Number(side.horizon)
        _place(rows, side, wanted, known, parts)
    hit = [name for name in read if name in impulses]
    if hit:
        known |= {name: ("impulses", i) for i, name in enumerate(hit)}
        parts["impulses"] = np.array([[impulses[name]] for name in hit], dtype=np.int64)
    rows.write_expressions([substitute(e, numbers) for e in expressions], known, parts, found, is_cost=is_cost)


def _place(
    rows: Rows, side: Side, wanted: Mapping[str, Quantity], known: dict[str, Places], parts: dict[str, Column]
) -> None:
    """Place the quantities of one side that are read; sensors become variables."""
    state, prefix = side.state, side.prefix
    own = dict(side.parts)
    if not isinstance(side.horizon, float):
        own["T"] = np.array([[side.horizon]], dtype=np.int64)
    for name, x in wanted.items():
        if x.kind in own:
            index = state.velocities.index(x.index) if x.kind == "qd" else x.index
            known[name] = (prefix + x.kind, index)
    parts |= {prefix + kind: part for kind, part in own.items() if _count(part)}
    for kind, kernel in _KERNELS.items():
        entries = sorted({x.index for x in wanted.values() if x.kind == kind})
        if not entries:
            continue
        variables = rows.add_variables(len(entries))
        found = rows.add_rows(len(entries), f"{prefix.rstrip('_')}: sensors")
        rows.A.put(found, variables, 1.0)
        function = KernelResult(kernel.kernel, kernel.inputs, kernel.result, tuple(entries))
        rows.apply(function, [own[part] for part in kernel.inputs], found, scale=-1.0, plant=state.plant)
        rows.defined.append(Defined(variables, found))
        parts[prefix + kind] = variables[:, None]
        known |= {name: (prefix + kind, entries.index(x.index)) for name, x in wanted.items() if x.kind == kind}
