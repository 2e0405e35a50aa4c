"""A nonlinear program as data: matrices, blocks of functions, bounds apart, and its stages in time.

    minimise    f(x) = sum_i w_i c_i(x),  c_i(x) = 1/2 x' H_i x + sum over cost blocks and places of their results
    subject to  lower <= g(x) <= upper,   g(x) = A x + sum over blocks and places of their results

A block applies a function F at many places, to entries of x or to linear combinations of them; its results go to rows
of g, or of c. Parameters p are the weights w, then constants that functions may read. Everything here is arrays, and
names of kernels: `backends` makes functions with derivatives of it.

The stages of direct transcription are (Betts, "Practical methods for optimal control", SIAM 2010, section 4.6):

    e_k(x_k, u_k, y_k) = 0                 the equations of interval k, which give its inner variables y_k
    x_(k+1) = F_k(x_k, u_k, y_k)           the rows that carry the state on
    r_k(x_k, u_k, y_k, x_(k+1), c)         all others; no row reads more than two stages in sequence, and common c

So the KKT matrix, ordered by stages, is block tridiagonal, bordered by the common variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Function, Indices

Matrix = sparse.csc_array

COMMON = -1  # the stage of variables that belong to none

_NO_PARAMETERS: Indices = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Combination:
    """A part of x at each place: matrices[which[k]] @ x[variables[k]] at place k."""

    matrices: Array  # (kinds, size, width)
    which: Indices  # (places,)
    variables: Indices  # (places, width)

    @property
    def size(self) -> int:
        """Size of the part at one place."""
        return int(self.matrices.shape[1])

    def pick(self, entries: Sequence[int]) -> Combination:
        """Keep some entries of the part."""
        return replace(self, matrices=self.matrices[:, list(entries)])

    def restrict(self, chosen: Indices) -> Combination:
        """Keep some places."""
        return Combination(self.matrices, self.which[chosen], self.variables[chosen])

    def evaluate(self, x: Array) -> Array:
        """Compute the part at every place, (places, size)."""
        return np.asarray((self.matrices[self.which] @ x[self.variables][:, :, None])[:, :, 0])

    def matrix(self, variables: int) -> Matrix:
        """Return the matrix, (places * size, variables), whose product with x holds the parts, place by place."""
        places = len(self.which)
        kind, i, j = np.nonzero(self.matrices)
        chosen = [np.flatnonzero(kind == k) for k in range(len(self.matrices))]
        entries = np.concatenate([_NO_PARAMETERS, *(chosen[k] for k in self.which)])
        place = np.repeat(np.arange(places), [chosen[k].size for k in self.which])
        row, col = place * self.size + i[entries], self.variables[place, j[entries]]
        value = self.matrices[kind[entries], i[entries], j[entries]]
        matrix = sparse.coo_array((value, (row, col)), shape=(places * self.size, variables)).tocsc()
        matrix.sum_duplicates()
        return matrix


Column = Indices | Combination  # (size, places) indices into x, or a combination of entries of x


@dataclass(frozen=True)
class Block:
    """A function with one vector of results, applied at several places: scale * x[factor] * F(parts of x, p, data)."""

    function: Function
    columns: tuple[Column, ...]  # the parts of x, F's first inputs
    rows: Indices  # (size of the result, places) indices into g, or into the weights
    stages: Indices  # (places,): each place reads variables of its stage and the next one, and common ones
    parameters: Indices = field(default_factory=_NO_PARAMETERS.copy)  # F's next input, if any: indices into p
    data: Array | None = None  # F's last input, if any: numbers, (size, places)
    scale: Array | float = 1.0  # (places,), or one for all
    factor: int | None = None  # the variable that multiplies all results, if there is one
    plant: int = 0  # whose kernels the function calls: its number among the plants of the program

    @property
    def places(self) -> int:
        """Count the places."""
        return int(self.rows.shape[1])

    @property
    def scales(self) -> Array:
        """Return the scale of every place."""
        return np.broadcast_to(np.asarray(self.scale, dtype=np.float64), self.places)

    def restrict(self, at: Indices) -> Block | None:
        """Keep the places whose rows have a new number in `at`, which is negative for the others."""
        rows = at[self.rows]
        (chosen,) = np.nonzero((rows >= 0).all(axis=0))
        assert (np.delete(rows, chosen, axis=1) < 0).all(), "the results of a place stay together"
        if not chosen.size:
            return None
        columns = tuple(
            part[:, chosen] if isinstance(part, np.ndarray) else part.restrict(chosen) for part in self.columns
        )
        return replace(
            self,
            columns=columns,
            rows=rows[:, chosen],
            stages=self.stages[chosen],
            data=None if self.data is None else self.data[:, chosen],
            scale=self.scales[chosen],
        )


@dataclass(frozen=True)
class Stages:
    """Which variables and rows belong to which interval k < N, and how intervals are coupled; the end is stage N."""

    states: Indices  # (N + 1, nx) variables
    inputs: Indices  # (N, m) variables
    inner: Indices  # (N, S, s) variables, which the equations of the interval give
    equations: Indices  # (N, S, s) rows, which read states, inputs and inner variables of their interval, and common
    continuity: Indices  # (N, nx) rows: states[k + 1] minus a function of the variables of interval k
    common: Indices  # variables of no stage: what the whole horizon shares
    rows: Indices  # (constraints,): the stage of each row
    nested: int = 0  # how many of an interval's last inner variables its last equations give, whatever the others are
    is_triangular: bool = False  # equations[:, j] are inner[:, j] minus a function of inner[:, :j], states and inputs

    @property
    def chain(self) -> Chain:
        """Return the stages one by one."""
        N, none = len(self.inputs), np.zeros(0, dtype=np.int64)
        inner, equations = self.inner.reshape(N, -1), self.equations.reshape(N, -1)
        parts = [Part(self.states[k], self.inputs[k], inner[k], equations[k], self.continuity[k]) for k in range(N)]
        return Chain((*parts, Part(self.states[N], none, none, none, none)), self.common, self.rows)

    def variables(self, size: int) -> Indices:
        """Return the stage of each of `size` variables."""
        stage = np.full(size, COMMON)
        for part in (self.states, self.inputs, self.inner):
            stage[part] = np.arange(len(part)).reshape(-1, *[1] * (part.ndim - 1))
        return stage


@dataclass(frozen=True)
class Part:
    """The variables and rows of one stage; a stage without continuity leaves the next states open."""

    states: Indices
    inputs: Indices
    inner: Indices  # as many as equations, which give them
    equations: Indices
    continuity: Indices
    own: Indices = field(default_factory=_NO_PARAMETERS.copy)  # rows that belong here, whatever they read
    terms: Indices = field(default_factory=_NO_PARAMETERS.copy)  # of the cost: likewise


@dataclass(frozen=True)
class Chain:
    """Stages of different sizes, one after the other.

    Rows may also read `copied` states of any stage: copies of these are common, and are tied to them there.
    """

    parts: tuple[Part, ...]
    common: Indices  # variables of no stage
    rows: Indices  # (constraints,): the stage of each row that reads common variables alone
    copied: Indices = field(default_factory=_NO_PARAMETERS.copy)  # states


@dataclass(frozen=True)
class Solved:
    """Intervals whose inner variables are no unknowns of the solver: their equations are solved for them."""

    stages: Stages
    plant: int = 0  # whose kernels the equations call


@dataclass(frozen=True)
class Program:
    """The program; shapes: A (constraints, variables), each H_i (variables, variables) and symmetric."""

    A: Matrix
    H: tuple[Matrix, ...]  # one for each weight
    blocks: tuple[Block, ...]
    costs: tuple[Block, ...] = ()
    constants: int = 0  # how many parameters follow the weights
    stages: Stages | None = None
    chain: Chain | None = None  # stages of different sizes; by default the ones of `stages`
    solved: tuple[Solved, ...] = ()

    @property
    def variables(self) -> int:
        """Count the entries of x."""
        return int(self.A.shape[1])

    @property
    def constraints(self) -> int:
        """Count the entries of g."""
        return int(self.A.shape[0])

    @property
    def parameters(self) -> int:
        """Count the entries of p."""
        return len(self.H) + self.constants

    @cached_property
    def kept(self) -> Indices:
        """Variables that a solver sees."""
        inner = (part.stages.inner.ravel() for part in self.solved)
        return np.setdiff1d(np.arange(self.variables), np.concatenate([_NO_PARAMETERS, *inner]))

    @cached_property
    def kept_rows(self) -> Indices:
        """Rows that a solver sees."""
        equations = (part.stages.equations.ravel() for part in self.solved)
        return np.setdiff1d(np.arange(self.constraints), np.concatenate([_NO_PARAMETERS, *equations]))

    def restrict(self, rows: Indices, *, with_cost: bool = False) -> Program:
        """Keep some rows of g, in the order given, and the cost or none; the stages are left out."""
        at = np.full(self.constraints, -1)
        at[rows] = np.arange(rows.size)
        blocks = tuple(kept for block in self.blocks if (kept := block.restrict(at)) is not None)
        A = sparse.csr_array(self.A)[rows].tocsc()
        part = replace(self, A=A, blocks=blocks, stages=None, chain=None, solved=())
        if with_cost:
            return part
        return replace(part, H=tuple(sparse.csc_array(H.shape) for H in self.H), costs=())

    def list_variables(self, block: Block) -> NDArray[np.bool_]:
        """Mark the variables that a block reads."""
        read = np.zeros(self.variables, dtype=bool)
        for part in block.columns:
            read[part if isinstance(part, np.ndarray) else part.variables] = True
        if block.factor is not None:
            read[block.factor] = True
        return read
