"""The functions of a stage as functions of entries of (x, v) alone: local numbers -> variables and rows of the tables.

Each state of the next stage that a row of this stage reads becomes an inner variable y, with its continuity row as the
equation and y as the dynamics. Of the other states, a continuity row a (next - d(x, v)) gives the dynamics d. Each
combination of variables, and each result of a kernel that an expression reads, becomes an inner variable as well:

    y - C (x, v) = 0,        y - kernel(x, v) = 0

A stage that leaves the next states open has them as inputs, and its rows decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.evaluation.stages.intervals import LEFT_OUT, Application, Functions, Part, Triplets, stack
from mbsrun.ocp.ground.functions import Array, Formula, Function, Indices, Input, KernelResult


class Vector(Enum):
    """A result of a stage."""

    COST = "f"
    EQUATIONS = "e"
    DYNAMICS = "d"
    INEQUALITIES = "g"


@dataclass(frozen=True)
class Targets:
    """Results that go to one vector: row += coefficient * result. Of the cost, the row is a weight."""

    vector: Vector
    result: Indices
    row: Indices
    coefficient: Array


@dataclass(frozen=True)
class Use:
    """A function of variables of the stage."""

    function: Function  # computes nothing itself
    columns: tuple[Indices, ...]  # variables
    parameters: Indices
    data: Indices
    factor: int | None
    targets: tuple[Targets, ...]
    plant: int  # whose kernels it calls


@dataclass(frozen=True)
class Stage:
    """The functions of a stage of the tables."""

    nx: int
    nv: int
    ne: int
    nd: int
    ng: int
    uses: tuple[Use, ...]
    linear: Mapping[Vector, Triplets]
    quadratic: tuple[tuple[int, Triplets], ...]
    combined: Triplets  # variables of these tables alone that are combinations of others
    variables: Indices  # the local number of each variable; -1: of these tables alone
    rows_e: Indices  # the local number of each row; -1: of these tables alone
    rows_d: Indices

    @property
    def rows(self) -> Mapping[Vector, int]:
        """Count the rows."""
        return {Vector.EQUATIONS: self.ne, Vector.DYNAMICS: self.nd, Vector.INEQUALITIES: self.ng}


def lift(functions: Functions) -> Stage:
    """Write the functions of a stage in variables of the tables."""
    return _Lifting(functions).lift()


Key = tuple[int, str, str, tuple[str, ...], bytes]  # of a kernel's result: its plant, names, and inputs


class _Lifting:
    """Variables are numbered as they are made: local numbers, then lifted ones; `lift` puts them in order."""

    def __init__(self, functions: Functions) -> None:
        self.functions, self.numbering = functions, functions.numbering
        self.lifted = 0
        self.combinations: dict[tuple[bytes, bytes], int] = {}
        self.equations: list[tuple[Indices, Array]] = []  # lifted combinations: variables, coefficients
        self.combined: list[int] = []  # lifted variables
        self.computed: dict[Key, dict[int, int]] = {}
        self.kernels: dict[Key, tuple[KernelResult, tuple[Indices, ...]]] = {}
        self.formulas: dict[int, Formula] = {}
        self.uses: list[tuple[Application, Function, tuple[Indices, ...]]] = []

    def lift(self) -> Stage:
        """Write everything."""
        for application in self.functions.applications:
            columns = tuple(self.find_part(part) for part in application.parts)
            function = application.function
            if isinstance(function, Formula):
                function, columns = self.compute(function, columns, application.plant)
            self.uses.append((application, function, columns))
        copied, explicit = self.choose_dynamics()
        variables = self.order_variables(copied)
        at = np.full(self.numbering.size + self.lifted, -1)
        at[variables[variables >= 0]] = np.flatnonzero(variables >= 0)
        numbering = self.numbering
        rows = self.order_rows(copied, explicit)
        inner = len(rows) + self.lifted
        targets = self.place_rows(rows, explicit)
        uses = [self.use(*item, at, targets) for item in self.uses]
        linear: dict[Vector, list[Triplets]] = {vector: [] for vector in Vector}
        self.write_matrix(linear, at, targets)
        self.write_identities(linear, at, copied)
        uses += self.write_lifted(linear, at, len(rows))
        nx = numbering.before + len(self.functions.carried)
        known = np.where(variables < numbering.size, variables, -1)
        shared = numbering.common - numbering.copied
        nd = 0 if self.functions.is_last else self.first_state + numbering.following + shared
        rows_d = np.full(nd, -1)
        for row, (place, _) in explicit.items():
            rows_d[place] = row
        return Stage(
            nx=nx,
            nv=len(variables) - nx,
            ne=inner,
            nd=nd,
            ng=self.functions.others,
            uses=tuple(uses),
            linear={vector: stack(parts) for vector, parts in linear.items()},
            quadratic=tuple((w, Triplets(at[t.row], at[t.col], t.value)) for w, t in self.functions.quadratic),
            combined=self.list_combined(at),
            variables=known,
            rows_e=np.concatenate((np.array(rows, dtype=np.int64), np.full(self.lifted, -1))),
            rows_d=rows_d,
        )

    # --- lifted variables ---

    def make(self) -> int:
        """Number a new variable."""
        self.lifted += 1
        return self.numbering.size + self.lifted - 1

    def find_part(self, part: Part) -> Indices:
        """Return the variables that hold a part."""
        if part.matrix is None:
            return part.variables
        return np.array([self.combine(part.variables, row) for row in part.matrix], dtype=np.int64)

    def combine(self, variables: Indices, coefficients: Array) -> int:
        """Return the variable that is a combination of others."""
        (chosen,) = np.nonzero(coefficients)
        variables, coefficients = variables[chosen], coefficients[chosen]
        if chosen.size == 1 and coefficients[0] == 1.0:
            return int(variables[0])
        key = (variables.tobytes(), coefficients.tobytes())
        if key not in self.combinations:
            self.combinations[key] = self.make()
            self.equations.append((variables, coefficients))
            self.combined.append(self.combinations[key])
        return self.combinations[key]

    def compute(self, formula: Formula, columns: Sequence[Indices], plant: int) -> tuple[Formula, tuple[Indices, ...]]:
        """Replace what kernels compute for a formula by variables; drop the inputs that it does not read itself."""
        given = dict(zip((part.kind for part in formula.inputs), columns, strict=True))
        read = {kind for kind, _ in formula.names.values()}
        kept = {part.kind: given[part.kind] for part in formula.inputs if part.kind in read}
        for kind, result in formula.computed:
            entries = _list_entries(formula, kind)
            if entries:
                inputs = tuple(given[name] for name in result.inputs)
                found = [self.find_result(result, inputs, i, plant) for i in entries]
                kept[kind] = np.array(found, dtype=np.int64)
        return self.rewrite(formula), tuple(kept.values())

    def rewrite(self, formula: Formula) -> Formula:
        """Write what kernels compute as inputs; once for each formula."""
        if id(formula) not in self.formulas:
            self.formulas[id(formula)] = rewrite(formula)
        return self.formulas[id(formula)]

    def find_result(self, result: KernelResult, inputs: tuple[Indices, ...], entry: int, plant: int) -> int:
        """Return the variable that is an entry of a kernel's result."""
        key = (plant, result.kernel, result.result, result.inputs, np.concatenate(inputs).tobytes())
        self.kernels.setdefault(key, (result, inputs))
        entries = self.computed.setdefault(key, {})
        if entry not in entries:
            entries[entry] = self.make()
        return entries[entry]

    def list_combined(self, at: Indices) -> Triplets:
        """List the coefficients of combinations, in the variables of the tables."""
        return _gather(
            [
                (int(at[variable]), int(at[j]), float(c))
                for variable, (read, coefficients) in zip(self.combined, self.equations, strict=True)
                for j, c in zip(read, coefficients, strict=True)
            ]
        )

    # --- dynamics ---

    @property
    def first_state(self) -> int:
        """Where the next states begin among the dynamics: copies and inputs that are carried come first."""
        return self.numbering.copied + len(self.functions.next_carried)

    def choose_dynamics(self) -> tuple[list[int], dict[int, tuple[int, float]]]:
        """Choose the next states that are inner variables too.

        Return them; and of each continuity row that gives dynamics, the place of its state and its coefficient.
        """
        if self.functions.is_last:
            return [], {}
        numbering, A = self.numbering, self.functions.matrix
        copied: set[int] = set()
        for variables in self.list_read():
            copied.update(int(i) for i in variables if i >= numbering.after)
        targets: dict[int, tuple[int, float]] = {}
        owners: dict[int, int] = {}
        for row in range(numbering.inner, numbering.others):
            at = np.flatnonzero((A.row == row) & (A.col >= numbering.after))
            if at.size == 1 and int(A.col[at[0]]) not in owners:
                owners[int(A.col[at[0]])] = row
                targets[row] = (int(A.col[at[0]]), float(A.value[at[0]]))
            else:
                copied.update(A.col[at].tolist())
        copied.update(A.col[(A.col >= numbering.after) & ~_between(A.row, numbering.inner, numbering.others)].tolist())
        explicit = {
            row: (self.first_state + state - numbering.after, value)
            for row, (state, value) in targets.items()
            if state not in copied
        }
        chosen = sorted(state for state in copied if state < numbering.size)
        if self.functions.is_open:
            return list(range(numbering.after, numbering.size)), {}
        assert len(chosen) + len(explicit) == numbering.following, (
            "each next state follows from the rows of its interval"
        )
        return chosen, explicit

    def list_read(self) -> Iterable[Indices]:
        """List the variables that functions read, in groups."""
        for _, _, columns in self.uses:
            yield from columns
        yield from (variables for variables, _ in self.equations)
        for _, inputs in self.kernels.values():
            yield from inputs
        for _, entries in self.functions.quadratic:
            yield entries.col

    def order_variables(self, copied: Sequence[int]) -> Indices:
        """List the variables: states, inner ones, inputs.

        Copies of states come first, as nothing within the horizon reads them, then inputs that are carried: few
        equations of an interval read these. The solver skips such columns.
        """
        numbering = self.numbering
        shared = numbering.before - numbering.copied
        copies = range(shared, numbering.before)
        states = [*copies, *(numbering.before + self.functions.carried), *range(shared)]
        inner = [*range(numbering.inside, numbering.now)]
        lifted = range(numbering.size, numbering.size + self.lifted)
        inputs = [*range(numbering.now, numbering.after)]
        (inputs if self.functions.is_open else inner).extend(copied)
        return np.array([*states, *inner, *lifted, *inputs], dtype=np.int64)

    def order_rows(self, copied: Sequence[int], explicit: Mapping[int, object]) -> list[int]:
        """List the equations by their local numbers, without the lifted ones."""
        numbering = self.numbering
        continuity = [row for row in range(numbering.inner, numbering.others) if row not in explicit]
        assert self.functions.is_open or len(continuity) == len(copied), "a copied state has an equation"
        return [*range(numbering.inner), *continuity]

    def place_rows(
        self, rows: Sequence[int], explicit: Mapping[int, tuple[int, float]]
    ) -> list[tuple[Vector, int, float]]:
        """Return where each local row goes: vector, row and factor."""
        numbering = self.numbering
        places = [(Vector.INEQUALITIES, i - numbering.others, 1.0) for i in range(numbering.others)]
        for i, row in enumerate(rows):
            places[row] = (Vector.EQUATIONS, i, 1.0)
        for row, (place, value) in explicit.items():
            places[row] = (Vector.DYNAMICS, place, -1.0 / value)
        return places + [(Vector.INEQUALITIES, i, 1.0) for i in range(self.functions.others)]

    # --- functions ---

    def use(
        self,
        application: Application,
        function: Function,
        columns: tuple[Indices, ...],
        at: Indices,
        places: Sequence[tuple[Vector, int, float]],
    ) -> Use:
        """Write a function in the variables and rows of the tables."""
        results = [i for i, row in enumerate(application.rows) if row != LEFT_OUT]
        if application.is_cost:
            found = [(Vector.COST, i, int(application.rows[i]), application.scale) for i in results]
        else:
            found = []
            for i in results:
                vector, row, factor = places[application.rows[i]]
                found.append((vector, i, row, factor * application.scale))
        factor = None if application.factor is None else int(at[application.factor])
        read = tuple(at[part] for part in columns)
        return Use(function, read, application.parameters, application.data, factor, _group(found), application.plant)

    def write_matrix(
        self, linear: dict[Vector, list[Triplets]], at: Indices, places: Sequence[tuple[Vector, int, float]]
    ) -> None:
        """Write constant entries; entries of a next state that the dynamics give are left out."""
        found: dict[Vector, list[tuple[int, int, float]]] = {vector: [] for vector in Vector}
        A = self.functions.matrix
        for i, j, value in zip(A.row.tolist(), A.col.tolist(), A.value.tolist(), strict=True):
            vector, row, factor = places[i]
            if vector is Vector.DYNAMICS and j >= self.numbering.after:
                continue
            found[vector].append((row, int(at[j]), factor * value))
        for vector, entries in found.items():
            linear[vector].append(_gather(entries))

    def write_identities(self, linear: dict[Vector, list[Triplets]], at: Indices, copied: Sequence[int]) -> None:
        """Write the dynamics of copied states, common variables and inputs that are carried."""
        if self.functions.is_last:
            return
        numbering = self.numbering
        first = self.first_state
        copies, shared = numbering.copied, numbering.common - numbering.copied
        pairs = [(i, numbering.states + shared + i) for i in range(copies)]
        pairs += [(copies + r, numbering.now + int(i)) for r, i in enumerate(self.functions.next_carried)]
        pairs += [(first + state - numbering.after, state) for state in copied]
        pairs += [(first + numbering.following + i, numbering.states + i) for i in range(shared)]
        linear[Vector.DYNAMICS].append(_gather([(row, int(at[variable]), 1.0) for row, variable in pairs]))

    def write_lifted(self, linear: dict[Vector, list[Triplets]], at: Indices, first: int) -> list[Use]:
        """Write the equations of lifted variables; their rows follow the others in the order of the variables."""
        numbering, entries, uses = self.numbering, [], []
        for variable in range(numbering.size, numbering.size + self.lifted):
            entries.append((first + variable - numbering.size, int(at[variable]), 1.0))
        for variable, (read, coefficients) in zip(self.combined, self.equations, strict=True):
            row = first + variable - numbering.size
            entries += [(row, int(at[j]), -float(c)) for j, c in zip(read, coefficients, strict=True)]
        linear[Vector.EQUATIONS].append(_gather(entries))
        nothing = np.zeros(0, dtype=np.int64)
        for key, (result, inputs) in self.kernels.items():
            found = self.computed[key]
            every = range(max(found) + 1) if result.entries is None else result.entries
            function = replace(result, entries=tuple(every[i] for i in found))
            rows = [first + variable - numbering.size for variable in found.values()]
            targets = _group([(Vector.EQUATIONS, i, row, -1.0) for i, row in enumerate(rows)])
            uses.append(Use(function, tuple(at[part] for part in inputs), nothing, nothing, None, targets, key[0]))
        return uses


def rewrite(formula: Formula) -> Formula:
    """Write what kernels compute for a formula as inputs of the entries that are read; drop inputs that are not."""
    entries = {kind: _list_entries(formula, kind) for kind, _ in formula.computed}
    names = {
        name: (kind, entries[kind].index(i) if kind in entries else i) for name, (kind, i) in formula.names.items()
    }
    read = {kind for kind, _ in names.values()}
    inputs = [part for part in formula.inputs if part.kind in read]
    inputs += [Input(kind, len(chosen)) for kind, chosen in entries.items() if chosen]
    return replace(formula, names=names, inputs=tuple(inputs), computed=())


def _list_entries(formula: Formula, kind: str) -> list[int]:
    """List the entries of a kind that a formula reads."""
    return sorted({i for of, i in formula.names.values() if of == kind})


def _group(found: Sequence[tuple[Vector, int, int, float]]) -> tuple[Targets, ...]:
    """Gather results by their vectors."""
    targets = []
    for vector in Vector:
        chosen = [(result, row, factor) for of, result, row, factor in found if of is vector]
        if chosen:
            result, row, factor = (list(part) for part in zip(*chosen, strict=True))
            targets.append(
                Targets(vector, np.array(result, dtype=np.int64), np.array(row, dtype=np.int64), np.array(factor))
            )
    return tuple(targets)


def _gather(entries: Sequence[tuple[int, int, float]]) -> Triplets:
    row, col, value = zip(*entries, strict=True) if entries else ((), (), ())
    return Triplets(np.array(row, dtype=np.int64), np.array(col, dtype=np.int64), np.array(value, dtype=np.float64))


def _between(values: Indices, first: int, end: int) -> NDArray[np.bool_]:
    return (values >= first) & (values < end)
