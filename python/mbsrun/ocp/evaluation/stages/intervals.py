"""A program, stage by stage: Program -> the functions of each stage in local numbers, and which stages are alike.

A function belongs to the first stage of which it reads a variable, with two exceptions. Rows that a program assigns to
an interval, which are its equations and its continuity, stay there. A function that reads inputs of two stages belongs
to the second one. Variables and rows have local numbers, so stages with equal functions are found by comparing arrays:

    variables of stage k    states of k, common, inputs of k - 1, inner of k, inputs of k, states of k + 1
    rows of stage k         equations of k, continuity of k, then all others in their order, then rows of copies

Stages may differ in size. A stage without continuity leaves the next states open, as a link between phases does: its
rows decide. Copies of states that rows of other stages read are common variables, behind the program's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Function, Indices
from mbsrun.ocp.ground.program import COMMON, Block, Chain, Column, Program

Mask = NDArray[np.bool_]

LEFT_OUT = -1  # the number of a row that no stage has
TIE = -1  # instead of a program's row: a copy minus the state that it is a copy of
_LATE = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Numbering:
    """Where the local numbers of each group of variables of a stage begin, and of rows."""

    states: int
    common: int  # with copies, which come last
    copied: int
    carried: int  # inputs of the stage before
    inner: int
    inputs: int
    following: int  # states of the next stage
    continuity: int  # rows

    @property
    def before(self) -> int:
        """Where the inputs of the stage before begin."""
        return self.states + self.common

    @property
    def inside(self) -> int:
        """Where inner variables begin."""
        return self.before + self.carried

    @property
    def now(self) -> int:
        """Where the inputs begin."""
        return self.inside + self.inner

    @property
    def after(self) -> int:
        """Where the states of the next stage begin."""
        return self.now + self.inputs

    @property
    def size(self) -> int:
        """Count the local variables."""
        return self.after + self.following

    @property
    def others(self) -> int:
        """Where the rows begin that are neither equations nor continuity."""
        return self.inner + self.continuity


@dataclass(frozen=True)
class Part:
    """A part of the variables: matrix @ variables, or the variables themselves."""

    variables: Indices  # (width,), local
    matrix: Array | None  # (size, width)


@dataclass(frozen=True)
class Application:
    """A function at one place: scale * factor * function(parts, parameters, data)."""

    function: Function
    parts: tuple[Part, ...]
    rows: Indices  # local; of a cost: weights; LEFT_OUT: the result is not needed
    is_cost: bool
    parameters: Indices
    data: Indices  # among the numbers of the stage
    scale: float
    factor: int | None  # local
    plant: int  # whose kernels the function calls


@dataclass(frozen=True)
class Triplets:
    """Constant entries of a matrix in local numbers."""

    row: Indices
    col: Indices
    value: Array


@dataclass(frozen=True)
class Functions:
    """The functions of one stage."""

    numbering: Numbering
    applications: tuple[Application, ...]
    matrix: Triplets  # rows by variables
    quadratic: tuple[tuple[int, Triplets], ...]  # weight, and the Hessian of its term, both triangles
    carried: Indices  # the inputs of the stage before that are read: local numbers from 0
    next_carried: Indices  # the same of the next stage
    others: int  # rows beside equations and continuity
    is_last: bool

    @property
    def is_open(self) -> bool:
        """Return whether the next states are variables that no row of the continuity gives."""
        return self.numbering.following > self.numbering.continuity


@dataclass(frozen=True)
class Intervals:
    """All stages: the functions of each kind, the kind of each stage, and what differs between stages of a kind."""

    chain: Chain
    kinds: tuple[Functions, ...]
    kind_of_stage: tuple[int, ...]
    others: tuple[Indices, ...]  # of each stage: the program's rows beside equations and continuity, or TIE
    numbers: Array  # (stages, count): data of each stage
    fixed: Indices  # (count, 2): a state of the first stage, and the row that is this state


def divide(program: Program, weights: Mask, rows: Mask) -> Intervals:
    """Divide a program into stages; `weights` marks the terms of the cost, and `rows` the rows, that count."""
    return _Division(program, weights, rows).divide()


@dataclass(frozen=True)
class _Group:
    """Elements of one sort, sorted by stage: the features of each, which are equal where stages are alike."""

    order: Indices  # numbers of the elements
    begin: Indices  # (stages + 1,)
    features: NDArray[np.int64]  # (elements, ...), sorted

    def sign(self, k: int) -> bytes:
        """Return what is equal for stages with equal elements."""
        return self.features[self.begin[k] : self.begin[k + 1]].tobytes()

    def at(self, k: int) -> Indices:
        """Return the elements of a stage."""
        return self.order[self.begin[k] : self.begin[k + 1]]


class _Division:
    def __init__(self, program: Program, weights: Mask, rows: Mask) -> None:
        self.program, self.chain, self.weights = program, find_chain(program), weights
        self.N = len(self.chain.parts) - 1
        self.numberings = _count(self.chain)
        self.bases = np.array([_list_bases(numbering) for numbering in self.numberings])
        self.stage, self.offset, self.is_state, self.is_input = _place_variables(self.chain, program.variables)
        self.copy = np.full(program.variables, -1)
        self.copy[self.chain.copied] = self.chain.common.size + np.arange(self.chain.copied.size)
        self.A = sparse.coo_array(program.A)
        self.term_owner = np.full(len(program.H), -1)
        for k, part in enumerate(self.chain.parts):
            self.term_owner[part.terms] = k
        self.wanted = rows.copy()
        self.fixed = self.find_fixed()
        self.wanted[self.fixed[:, 1]] = False

    def divide(self) -> Intervals:
        """Sort everything by stage, and compare stages."""
        self.own_rows()
        groups, blocks = self.sort_blocks()
        matrix, entries = self.sort_matrix()
        squares = self.sort_quadratics()
        every = [*groups, matrix, *(group for _, group, _ in squares)]
        carried = self.find_carried(groups, matrix, entries, squares)
        signs = [
            (
                self.numberings[k],
                *(group.sign(k) for group in every),
                carried[k].tobytes(),
                carried[k + 1].tobytes(),
                len(self.others[k]),
            )
            for k in range(self.N + 1)
        ]
        first: dict[tuple[object, ...], int] = {}
        for k, sign in enumerate(signs):
            first.setdefault((*sign, k == self.N), k)
        number = {sign: i for i, sign in enumerate(first)}
        numbers, places = self.gather_data(groups, blocks)
        kinds = []
        for k in first.values():
            applications = [
                self.apply(block, int(place), places[b][place], is_cost=is_cost)
                for b, (group, (block, is_cost)) in enumerate(zip(groups, blocks, strict=True))
                for place in group.at(k)
            ]
            quadratic = tuple((w, _take(entry, group.at(k))) for w, group, entry in squares if group.at(k).size)
            kinds.append(
                Functions(
                    numbering=self.numberings[k],
                    applications=tuple(applications),
                    matrix=_take(entries, matrix.at(k)),
                    quadratic=quadratic,
                    carried=carried[k],
                    next_carried=carried[k + 1],
                    others=len(self.others[k]),
                    is_last=k == self.N,
                )
            )
        return Intervals(
            self.chain,
            tuple(kinds),
            tuple(number[(*sign, k == self.N)] for k, sign in enumerate(signs)),
            self.others,
            numbers,
            self.fixed,
        )

    # --- rows ---

    def find_fixed(self) -> Indices:
        """Find the rows that are one state of the first stage each, and no two the same."""
        A, found = sparse.csr_array(self.program.A), []
        counts = np.diff(A.indptr)
        used = np.zeros(self.program.constraints, dtype=bool)
        for block in self.program.blocks:
            used[block.rows] = True
        taken: set[int] = set()
        for row in np.flatnonzero(self.wanted & (counts == 1) & ~used):
            variable, value = int(A.indices[A.indptr[row]]), A.data[A.indptr[row]]
            if value == 1.0 and self.is_state[variable] and self.stage[variable] == 0 and variable not in taken:
                taken.add(variable)
                found.append((self.offset[variable], row))
        return np.array(found, dtype=np.int64).reshape(-1, 2)

    def own_rows(self) -> None:
        """Find the stage and the local number of each row."""
        rows = self.program.constraints
        reads = _Reads(rows, self)
        reads.add(self.A.coords[0].astype(np.int64), self.A.coords[1].astype(np.int64))
        for block in self.program.blocks:
            place = _read_places(block, self)
            for row in block.rows:
                reads.merge(row, place)
        owner = reads.owners(self.chain.rows)
        local = np.full(rows, LEFT_OUT)
        for k, part in enumerate(self.chain.parts):
            for given, base in ((part.equations, 0), (part.continuity, self.numberings[k].inner)):
                owner[given] = k
                local[given] = base + np.arange(given.size)
            owner[part.own] = k
        other = np.flatnonzero(self.wanted & (local == LEFT_OUT))
        order = other[np.argsort(owner[other], kind="stable")]
        begin = np.searchsorted(owner[order], np.arange(self.N + 2))
        first = np.array([numbering.others for numbering in self.numberings])
        local[order] = first[owner[order]] + np.arange(order.size) - begin[owner[order]]
        self.row_owner, self.row_local = owner, local
        self.others = tuple(
            np.concatenate((order[a:b], np.full(int((self.stage[self.chain.copied] == k).sum()), TIE)))
            for k, (a, b) in enumerate(pairwise(begin))
        )

    def tie_copies(self) -> tuple[Indices, Triplets]:
        """Write the rows of copies, copy - state, behind the others of their stages; return owners and entries."""
        owner, row, col, value = [], [], [], []
        for k in range(self.N + 1):
            numbering, own = self.numberings[k], self.chain.copied[self.stage[self.chain.copied] == k]
            first = numbering.others + len(self.others[k]) - own.size
            for i, state in enumerate(own):
                owner += [k, k]
                row += [first + i, first + i]
                col += [int(self.offset[state]), numbering.states + int(self.copy[state])]
                value += [-1.0, 1.0]
        entries = Triplets(np.array(row, dtype=np.int64), np.array(col, dtype=np.int64), np.array(value))
        return np.array(owner, dtype=np.int64), entries

    def own_places(self, block: Block, place: int | None = None) -> Indices:
        """Return the stages of the places of a cost, or of one place."""
        if place is not None:
            one = np.array([place])
            columns = tuple(p[:, one] if isinstance(p, np.ndarray) else p.restrict(one) for p in block.columns)
            block = replace(block, columns=columns, rows=block.rows[:, one], stages=block.stages[one])
        given = self.term_owner[block.rows[0]]
        return np.where(given >= 0, given, _read_places(block, self).owners(block.stages))

    # --- elements by stage ---

    def localise(self, variables: Indices, owner: Indices) -> Indices:
        """Number variables by the stages that read them."""
        stage, offset, copy = self.stage[variables], self.offset[variables], self.copy[variables]
        distance, is_state, is_input = stage - owner, self.is_state[variables], self.is_input[variables]
        is_common, is_inner = stage == COMMON, ~(is_state | is_input) & (stage != COMMON)
        bases = np.moveaxis(np.broadcast_to(self.bases[owner], (*variables.shape, self.bases.shape[1])), -1, 0)
        states, common, before, inside, now, after = bases
        choices = (
            (is_state & (copy >= 0), common + copy - offset),
            (is_common, common),
            (is_state & (distance == 0), states),
            (is_state & (distance == 1), after),
            (is_input & (distance == 0), now),
            (is_input & (distance == -1), before),
            (is_inner & (distance == 0), inside),
        )
        local = np.full(variables.shape, -1)
        for chosen, base in choices:
            local[chosen] = (base + offset)[chosen]
        assert (local >= 0).all(), "no row reads more than two stages in sequence"
        return local

    def sort(self, owner: Indices, chosen: Indices, *features: NDArray[np.int64]) -> _Group:
        """Sort some elements by their stages."""
        stacked = np.concatenate([f[:, None] if f.ndim == 1 else f for f in features], axis=1)
        order = np.argsort(owner, kind="stable")
        begin = np.searchsorted(owner[order], np.arange(self.N + 2))
        return _Group(chosen[order], begin, np.ascontiguousarray(stacked[order]))

    def sort_blocks(self) -> tuple[list[_Group], list[tuple[Block, bool]]]:
        """Sort the places of all blocks."""
        groups, blocks = [], []
        self.columns: list[list[Indices]] = []
        for is_cost, given in ((False, self.program.blocks), (True, self.program.costs)):
            for block in given:
                if is_cost:
                    rows = np.where(self.weights[block.rows], block.rows, LEFT_OUT)
                    owner = self.own_places(block)
                else:
                    rows, owner = self.row_local[block.rows], self.row_owner[block.rows[0]]
                    assert (self.row_owner[block.rows] == owner).all(), "the rows of a place are of one stage"
                chosen = np.flatnonzero((rows != LEFT_OUT).any(axis=0))
                which = [part.which[:, None] for part in block.columns if not isinstance(part, np.ndarray)]
                features = [self.localise(_by_places(part), owner[:, None]) for part in block.columns]
                scale = np.ascontiguousarray(block.scales).view(np.int64)[:, None]
                parts = [f[chosen] for f in (*features, *which, rows.T, scale)]
                groups.append(self.sort(owner[chosen], chosen, *parts))
                blocks.append((block, is_cost))
                self.columns.append(features)
        return groups, blocks

    def sort_matrix(self) -> tuple[_Group, Triplets]:
        """Sort the entries of the matrix."""
        row, col = (k.astype(np.int64) for k in self.A.coords)
        chosen = np.flatnonzero((self.row_local[row] != LEFT_OUT) & (self.A.data != 0))
        row, col, value = row[chosen], col[chosen], self.A.data[chosen]
        owner = self.row_owner[row]
        entries = Triplets(self.row_local[row], self.localise(col, owner), value)
        own, ties = self.tie_copies()
        owner, entries = np.concatenate((owner, own)), stack((entries, ties))
        order = np.lexsort((entries.col, entries.row))
        entries = _take(entries, order)
        features = (entries.row, entries.col, entries.value.view(np.int64))
        return self.sort(owner[order], np.arange(order.size), *features), entries

    def sort_quadratics(self) -> list[tuple[int, _Group, Triplets]]:
        """Sort the entries of the quadratic terms that count."""
        found = []
        for weight in np.flatnonzero(self.weights):
            H = sparse.coo_array(self.program.H[weight])
            row, col = (k.astype(np.int64) for k in H.coords)
            reads = _Reads(row.size, self)
            for part in (row, col):
                reads.add(np.arange(row.size), part)
            owner = reads.owners(np.zeros(row.size, dtype=np.int64))
            entries = Triplets(self.localise(row, owner), self.localise(col, owner), H.data.astype(np.float64))
            order = np.lexsort((entries.col, entries.row))
            entries = _take(entries, order)
            features = (entries.row, entries.col, entries.value.view(np.int64))
            found.append((int(weight), self.sort(owner[order], np.arange(order.size), *features), entries))
        return found

    def find_carried(
        self,
        groups: Sequence[_Group],
        matrix: _Group,
        linear: Triplets,
        squares: Sequence[tuple[int, _Group, Triplets]],
    ) -> list[Indices]:
        """Find the inputs of the stage before that each stage reads; and of a stage after the last: none."""
        first, last = (np.array([getattr(x, name) for x in self.numberings]) for name in ("before", "inside"))
        read = np.zeros((self.N + 2, int((last - first).max(initial=0))), dtype=bool)
        for group, features in zip(groups, self.columns, strict=True):
            stage = np.repeat(np.arange(self.N + 1), np.diff(group.begin))
            for columns in features:
                chosen = columns[group.order]
                place, at = np.nonzero((chosen >= first[stage, None]) & (chosen < last[stage, None]))
                read[stage[place], chosen[place, at] - first[stage[place]]] = True
        quadratic = [(group, (entries.row, entries.col)) for _, group, entries in squares]
        for group, parts in [(matrix, (linear.col,)), *quadratic]:
            stage = np.repeat(np.arange(self.N + 1), np.diff(group.begin))
            for part in parts:
                columns = part[group.order]
                (at,) = np.nonzero((columns >= first[stage]) & (columns < last[stage]))
                read[stage[at], columns[at] - first[stage[at]]] = True
        return [np.flatnonzero(mask) for mask in read]

    # --- one place ---

    def gather_data(
        self, groups: Sequence[_Group], blocks: Sequence[tuple[Block, bool]]
    ) -> tuple[Array, list[list[Indices]]]:
        """Lay the data of all places in a row for each stage; return where each place of each block has its data."""
        used = np.zeros(self.N + 1, dtype=np.int64)
        laid: list[tuple[Indices, Indices, Array]] = []
        where: list[list[Indices]] = []
        for group, (block, _) in zip(groups, blocks, strict=True):
            size = 0 if block.data is None else len(block.data)
            at = np.zeros((block.places, size), dtype=np.int64)
            if block.data is not None:
                counts = np.diff(group.begin)
                stage = np.repeat(np.arange(self.N + 1), counts)
                rank = np.arange(stage.size) - group.begin[stage]
                at[group.order] = (used[stage] + rank * size)[:, None] + np.arange(size)
                laid.append((np.repeat(stage, size), at[group.order].ravel(), block.data[:, group.order].T.ravel()))
                used += counts * size
            where.append(list(at))
        numbers = np.zeros((self.N + 1, int(used.max(initial=0))))
        for stage, at_number, values in laid:
            numbers[stage, at_number] = values
        return numbers, where

    def apply(self, block: Block, place: int, data: Indices, *, is_cost: bool) -> Application:
        """Describe a function at one place."""
        rows = block.rows[:, place]
        if is_cost:
            local, owner = np.where(self.weights[rows], rows, LEFT_OUT), int(self.own_places(block, place)[0])
        else:
            local, owner = self.row_local[rows], int(self.row_owner[rows[0]])
        at = np.array([owner])
        parts = []
        for part in block.columns:
            if isinstance(part, np.ndarray):
                parts.append(Part(self.localise(part[:, place], at), None))
            else:
                parts.append(Part(self.localise(part.variables[place], at), part.matrices[part.which[place]]))
        factor = None if block.factor is None else int(self.localise(np.array([block.factor]), at)[0])
        return Application(
            block.function,
            tuple(parts),
            local,
            is_cost,
            block.parameters,
            data,
            float(block.scales[place]),
            factor,
            block.plant,
        )


class _Reads:
    """Of each of some rows: the first and the last stage that it reads, and whether another stage can be its owner."""

    def __init__(self, rows: int, division: _Division) -> None:
        self.division = division
        self.low, self.high = np.full(rows, _LATE), np.full(rows, -1)
        self.variables: list[tuple[Indices, Indices]] = []

    def add(self, row: Indices, variable: Indices) -> None:
        """Add variables that rows read."""
        stage = self.division.stage[variable]
        known = stage != COMMON
        np.minimum.at(self.low, row[known], stage[known])
        np.maximum.at(self.high, row[known], stage[known])
        self.variables.append((row[known], variable[known]))

    def merge(self, row: Indices, other: _Reads) -> None:
        """Add what the places of another one read to one row each."""
        for place, variable in other.variables:
            self.variables.append((row[place], variable))
        np.minimum.at(self.low, row, other.low)
        np.maximum.at(self.high, row, other.high)

    def owners(self, default: Indices) -> Indices:
        """Return the stages of all rows; the default where a row reads common variables alone."""
        by_states = np.ones(self.low.size, dtype=bool)  # of the last stage, states alone are read
        for row, variable in self.variables:
            late = self.division.stage[variable] == self.high[row]
            np.logical_and.at(by_states, row[late], self.division.is_state[variable[late]])
        owner = np.where(by_states | (self.low == self.high), self.low, self.high)
        return np.where(self.high < 0, default, owner)


def _read_places(block: Block, division: _Division) -> _Reads:
    """Read the variables of all places of a block."""
    reads = _Reads(block.places, division)
    for part in block.columns:
        variables = _by_places(part)
        place = np.repeat(np.arange(block.places), variables.shape[1])
        reads.add(place, variables.ravel())
    return reads


def _by_places(part: Column) -> Indices:
    """Return the variables that a part reads, (places, width)."""
    return part.T if isinstance(part, np.ndarray) else part.variables


def _take(entries: Triplets, chosen: Indices) -> Triplets:
    return Triplets(entries.row[chosen], entries.col[chosen], entries.value[chosen])


def stack(parts: Iterable[Triplets]) -> Triplets:
    """Join entries."""
    nothing = np.zeros(0, dtype=np.int64)
    every = [Triplets(nothing, nothing, np.zeros(0)), *parts]
    return Triplets(*(np.concatenate([getattr(t, name) for t in every]) for name in ("row", "col", "value")))


def find_chain(program: Program) -> Chain:
    """Return the stages of a program."""
    if program.chain is not None:
        return program.chain
    assert program.stages is not None, "a program in stages"
    return program.stages.chain


def _count(chain: Chain) -> tuple[Numbering, ...]:
    """Number the groups of each stage.

    A stage that follows no interval has room for inputs before it nevertheless, so that it is like the stages after it.
    """
    parts, found = chain.parts, []
    for k, part in enumerate(parts):
        follows = k > 0 and parts[k - 1].continuity.size == part.states.size
        found.append(
            Numbering(
                states=part.states.size,
                common=chain.common.size + chain.copied.size,
                copied=chain.copied.size,
                carried=(parts[k - 1] if follows else part).inputs.size,
                inner=part.inner.size,
                inputs=part.inputs.size,
                following=parts[k + 1].states.size if k + 1 < len(parts) else 0,
                continuity=part.continuity.size,
            )
        )
    return tuple(found)


def _list_bases(numbering: Numbering) -> tuple[int, ...]:
    return (0, numbering.states, numbering.before, numbering.inside, numbering.now, numbering.after)


def _place_variables(chain: Chain, size: int) -> tuple[Indices, Indices, Mask, Mask]:
    """Return the stage of each variable, its number in its group, and whether it is a state, or an input."""
    stage, offset = np.full(size, COMMON), np.zeros(size, dtype=np.int64)
    is_state, is_input = np.zeros(size, dtype=bool), np.zeros(size, dtype=bool)
    for k, part in enumerate(chain.parts):
        for group in (part.states, part.inputs, part.inner):
            stage[group], offset[group] = k, np.arange(group.size)
        is_state[part.states], is_input[part.inputs] = True, True
    offset[chain.common] = np.arange(chain.common.size)
    return stage, offset, is_state, is_input
