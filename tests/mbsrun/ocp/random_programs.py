"""Random programs of some stages, and what they compute: written once more in CasADi, term by term.

    f = sum_i p_i (1/2 x' H_i x + results of cost blocks in term i),    g = A x + results of blocks

Rows read the stages that a program permits: one stage, common variables, and either the states of the next stage or
the inputs of the one before. Most blocks are alike at all stages; places have other scales, data and combinations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from mbsgen.expressions import parse
from mbsrun.ocp.ground.functions import Array, Formula, Indices, Input
from mbsrun.ocp.ground.program import Block, Chain, Column, Combination, Program, Stages

Monomial = tuple[float, tuple[tuple[str, str], ...]]  # a coefficient, and a function and a name for each factor
FUNCTIONS = {"": lambda x: x, "sin": ca.sin, "cos": ca.cos, "exp": ca.exp}


@dataclass(frozen=True)
class Drawn:
    """A program, and what its formulas compute."""

    program: Program
    results: dict[int, tuple[tuple[Monomial, ...], ...]]  # by the identity of a formula
    N: int

    def express(self, x: Any, p: Any) -> tuple[Any, Any, Any]:
        """Return the terms of the cost, f and g as expressions of x and p."""
        program = self.program
        g = ca.mtimes(_dense(program.A), x)
        terms = [ca.bilin(_dense(H), x, x) / 2 for H in program.H]
        rows = [g[i] for i in range(program.constraints)]
        for blocks, sums in ((program.blocks, rows), (program.costs, terms)):
            for block in blocks:
                for place in range(block.places):
                    self._add(block, place, x, p, sums)
        return ca.vertcat(*terms), sum(p[i] * term for i, term in enumerate(terms)), ca.vertcat(*rows)

    def _add(self, block: Block, place: int, x: Any, p: Any, sums: list[Any]) -> None:
        formula = block.function
        assert isinstance(formula, Formula)
        values: dict[str, Any] = {}
        for part, column in zip(formula.inputs, block.columns, strict=True):
            values |= {f"{part.kind}{i}": v for i, v in enumerate(_read(column, place, x))}
        values |= {f"p{i}": p[int(k)] for i, k in enumerate(block.parameters)}
        if block.data is not None:
            values |= {f"d{i}": v for i, v in enumerate(block.data[:, place])}
        factor = 1 if block.factor is None else x[block.factor]
        for row, monomials in zip(block.rows[:, place], self.results[id(formula)], strict=True):
            result = 0
            for coefficient, factors in monomials:
                term = coefficient
                for function, name in factors:
                    term = term * FUNCTIONS[function](values[name])
                result = result + term
            sums[int(row)] = sums[int(row)] + float(block.scales[place]) * factor * result


def _dense(matrix: Any) -> Any:
    return ca.DM(matrix.toarray())


def _read(column: Column, place: int, x: Any) -> list[Any]:
    if isinstance(column, np.ndarray):
        return [x[int(i)] for i in column[:, place]]
    matrix, variables = column.matrices[column.which[place]], column.variables[place]
    return [sum(float(c) * x[int(j)] for c, j in zip(row, variables, strict=True)) for row in matrix]


class _Drawing:
    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        rng = self.rng
        self.N, self.nx, self.m = (int(rng.integers(a, b)) for a, b in ((2, 5), (1, 4), (1, 3)))
        inner, common = (int(rng.integers(0, b)) for b in (3, 3))
        self.groups = 2
        sizes = [(self.N + 1) * self.nx, self.N * self.m, self.N * self.groups * inner, common]
        order = rng.permutation(sum(sizes))
        parts = np.split(order, np.cumsum(sizes)[:-1])
        self.states, self.inputs = parts[0].reshape(self.N + 1, self.nx), parts[1].reshape(self.N, self.m)
        self.inner, self.common = parts[2].reshape(self.N, self.groups, inner), parts[3]
        self.variables = int(order.size)
        self.others = int(rng.integers(2, 6))  # families of further rows
        counts = [self.N * self.groups * inner, self.N * self.nx, self.others * (self.N + 1)]
        rows = np.split(rng.permutation(sum(counts)), np.cumsum(counts)[:-1])
        self.equations = rows[0].reshape(self.inner.shape)
        self.continuity, self.families = rows[1].reshape(self.N, self.nx), rows[2].reshape(self.others, self.N + 1)
        self.constraints = sum(counts)
        self.weights, self.constants = int(rng.integers(1, 4)), int(rng.integers(0, 3))
        self.entries: dict[tuple[int, int], float] = {}
        self.blocks: list[Block] = []
        self.costs: list[Block] = []
        self.results: dict[int, tuple[tuple[Monomial, ...], ...]] = {}

    # --- what a row of a stage may read ---

    def own(self, k: int) -> list[int]:
        """List the variables of a stage, and common ones."""
        parts = [self.states[k], self.common]
        if k < self.N:
            parts += [self.inputs[k], self.inner[k].ravel()]
        return [int(i) for part in parts for i in part]

    def near(self, k: int, way: str) -> list[int]:
        """List the variables of a stage and of one beside it."""
        beside = {"next": self.states[min(k + 1, self.N)], "before": self.inputs[max(k - 1, 0)], "own": ()}[way]
        return [*self.own(k), *(int(i) for i in beside)]

    # --- blocks ---

    def formula(self, sizes: Sequence[int], results: int, data: int) -> Formula:
        """Draw a formula of inputs a, b, ..., parameters p and data d; each name occurs."""
        rng, kinds = self.rng, "abc"[: len(sizes)]
        inputs = tuple(Input(kind, size) for kind, size in zip(kinds, sizes, strict=True))
        parameters = Input("p", self.weights + self.constants) if rng.random() < 0.5 else None
        given = Input("d", data) if data else None
        parts = [part for part in (*inputs, parameters, given) if part is not None]
        names = {f"{part.kind}{i}": (part.kind, i) for part in parts for i in range(part.size)}
        found = []
        for _ in range(results):
            count = int(rng.integers(1, 4))
            found.append(tuple(self.monomial([*names]) for _ in range(count)))
        left = [name for name in names if not any(n == name for r in found for _, f in r for _, n in f)]
        found[0] = (*found[0], *((0.5, (("", name),)) for name in left))
        texts = [" + ".join(_write(x) for x in monomials) for monomials in found]
        made = Formula(tuple(map(parse, texts)), names, inputs, parameters, given)
        self.results[id(made)] = tuple(found)
        return made

    def monomial(self, names: Sequence[str]) -> Monomial:
        """Draw a product of functions of names."""
        rng = self.rng
        chosen = rng.choice(len(names), int(rng.integers(1, 4)))
        return round(float(rng.uniform(0.3, 2.0)), 2), tuple(
            (str(rng.choice(["", "", "sin", "cos", "exp"])), names[int(i)]) for i in chosen
        )

    def block(self, stages: Sequence[int], rows: Indices, way: str, *, is_cost: bool) -> None:
        """Draw a block at some stages whose places read alike; rows is (results, places)."""
        rng, places = self.rng, len(stages)
        universe = np.array([self.near(k, way) for k in stages])  # (places, width): alike by column
        columns: list[Column] = []
        for _ in range(int(rng.integers(1, 4))):
            if rng.random() < 0.6:
                chosen = rng.choice(universe.shape[1], int(rng.integers(1, 3)))
                columns.append(universe[:, chosen].T.copy())
                continue
            width = int(rng.integers(1, min(4, universe.shape[1]) + 1))
            matrices = rng.integers(-2, 3, (2, int(rng.integers(1, 3)), width)) * 0.5
            matrices[0, 0] = np.eye(width)[0]  # a variable as it is
            which = np.zeros(places, dtype=np.int64) if rng.random() < 0.5 else rng.integers(0, 2, places)
            chosen = rng.choice(universe.shape[1], width, replace=False)
            columns.append(Combination(matrices, which, universe[:, chosen]))
        data = int(rng.integers(0, 3))
        sizes = [len(c) if isinstance(c, np.ndarray) else c.size for c in columns]
        function = self.formula(sizes, len(rows), data)
        nothing = np.zeros(0, dtype=np.int64)
        made = Block(
            function,
            tuple(columns),
            rows,
            np.array(stages),
            parameters=nothing if function.parameters is None else rng.permutation(function.parameters.size),
            data=rng.uniform(0.5, 1.5, (data, places)) if data else None,
            scale=rng.uniform(0.5, 2.0, places) if rng.random() < 0.5 else float(rng.choice([1.0, 1.0, 0.75])),
            factor=int(self.common[0]) if self.common.size and rng.random() < 0.4 else None,
        )
        (self.costs if is_cost else self.blocks).append(made)

    # --- the whole ---

    def put(self, row: int, variables: Sequence[int]) -> None:
        """Draw linear entries of a row."""
        for i in variables:
            if self.rng.random() < 0.4:
                self.entries[row, int(i)] = float(self.rng.choice([1.0, -1.0, 0.5, 3.0]))

    def draw(self) -> Drawn:
        """Draw everything."""
        rng, N = self.rng, self.N
        every = list(range(N))
        for i, j in np.ndindex(self.inner.shape[1:]):
            for k in every:
                self.put(int(self.equations[k, i, j]), self.own(k))
            self.block(every, self.equations[:, i, j][None], "own", is_cost=False)
        for i in range(self.nx):
            value = float(rng.choice([1.0, 1.0, -2.0]))
            for k in every:
                self.put(int(self.continuity[k, i]), self.own(k))
                self.entries[int(self.continuity[k, i]), int(self.states[k + 1, i])] = value
            self.block(every, self.continuity[:, i][None], "own", is_cost=False)
        for family in self.families:
            way = str(rng.choice(["own", "next", "before"]))
            stages = {"own": [*every, N], "next": every, "before": every[1:]}[way]
            if rng.random() < 0.3:
                stages = [k for k in stages if rng.random() < 0.7] or stages[-1:]
            kept = [k for k in stages if not (way == "own" and k == N)]
            for k in stages:
                if rng.random() < 0.7:
                    self.put(int(family[k]), self.own(k) if way == "own" else self.near(k, way))
            if kept:
                self.block(kept, family[kept][None], way, is_cost=False)
            if way == "own" and N in stages:
                self.block([N], family[[N]][None], way, is_cost=False)
        for _ in range(int(rng.integers(1, 4))):
            way = str(rng.choice(["own", "next", "before"]))
            stages = every[1:] if way == "before" else every
            rows = rng.integers(0, self.weights, (int(rng.integers(1, 3)), 1))
            self.block(stages, np.tile(rows, len(stages)), way, is_cost=True)
        return Drawn(self.program(), self.results, N)

    def program(self) -> Program:
        """Put everything together."""
        squares = []
        for _ in range(self.weights):
            H = np.zeros((self.variables, self.variables))
            for k in range(self.N + 1):
                own = self.near(k, "next") if k < self.N else self.own(k)
                i, j = self.rng.choice(own, 2)
                value = float(self.rng.choice([1.0, 0.5, -1.5]))
                H[i, j] += value
                H[j, i] += value
            squares.append(sparse.csc_array(H))
        stage = np.zeros(self.constraints, dtype=np.int64)
        for part in (self.equations, self.continuity):
            stage[part] = np.arange(self.N).reshape(-1, *[1] * (part.ndim - 1))
        stage[self.families] = np.arange(self.N + 1)
        row, col = np.array([*self.entries], dtype=np.int64).reshape(-1, 2).T
        A = sparse.coo_array(([*self.entries.values()], (row, col)), shape=(self.constraints, self.variables)).tocsc()
        stages = Stages(self.states, self.inputs, self.inner, self.equations, self.continuity, self.common, stage)
        return Program(A, tuple(squares), tuple(self.blocks), tuple(self.costs), self.constants, stages)


def _write(monomial: Monomial) -> str:
    coefficient, factors = monomial
    return "*".join([f"{coefficient:g}", *(f"{function}({name})" if function else name for function, name in factors)])


def draw(seed: int) -> Drawn:
    """Draw a program."""
    return _Drawing(seed).draw()


def with_copies(drawn: Drawn, rng: np.random.Generator) -> Drawn:
    """Add a row to the last stage that reads states of all stages, of which tables then need copies."""
    program = drawn.program
    assert program.stages is not None
    chain = program.stages.chain
    copied = rng.permutation([int(rng.choice(part.states)) for part in chain.parts[:-1]])
    last = int(rng.choice(chain.parts[-1].states))
    row = np.zeros((1, program.variables))
    row[0, [*copied, last]] = rng.uniform(0.5, 2.0, copied.size + 1)
    A = sparse.vstack((program.A, sparse.csc_array(row)), format="csc")
    rows = np.append(chain.rows, drawn.N)
    parts = (*chain.parts[:-1], replace(chain.parts[-1], own=np.array([program.constraints])))
    own = Chain(parts, chain.common, rows, copied=copied)
    return replace(drawn, program=replace(program, A=A, chain=own))


def at_random(program: Program, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw a point and parameters."""
    return rng.uniform(0.3, 1.0, program.variables), rng.uniform(0.5, 1.5, program.parameters)
