"""The tables of a program in stages, as data: `csrc/program` evaluates them, `csrc/stages` solves.

Stage k has states x and variables v, the inner ones first: the first `inner` equations of a stage give them. See
`csrc/stages/mbs_stages.h` for the problem and `csrc/program/mbs_program.h` for scripts; names are the same.

Whatever reads another stage was rewritten: common variables are states that stay as they are, and inputs of the stage
before are carried as states. Combinations of variables, and kernels' results that expressions read, are inner variables
with their own equations, so every call reads entries of x and v.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from mbsrun.ocp.ground.functions import Array, Formula, Indices
from mbsrun.ocp.ground.program import Matrix


class Derivative(Enum):
    """Which function of CasADi's contract a call means."""

    VALUE = "value"
    JACOBIAN = "jac"
    HESSIAN = "jac_adj1"


@dataclass(frozen=True)
class KernelFunction:
    """A kernel, or a derivative of it."""

    kernel: str
    derivative: Derivative
    plant: int = 0


@dataclass(frozen=True)
class FormulaFunction:
    """Expressions of variables alone (`computed` is empty), as one function with one argument for each of its inputs,
    parameters and data, or a derivative of it.

    Results: VALUE the values; JACOBIAN the nonzeros of the derivatives by all inputs, stacked into one vector, column
    by column; HESSIAN, which takes weights of the values as its last argument, the nonzeros of the lower triangle of
    the second derivatives of the weighted sum. `stages.formulas` gives their patterns.
    """

    formula: Formula
    derivative: Derivative


CalledFunction = KernelFunction | FormulaFunction


@dataclass(frozen=True)
class Terms:
    """W[to] += coefficient * W[from_], and with `by` also times W[by]; all (count,)."""

    to: Indices
    from_: Indices
    coefficient: Array
    by: Indices | None = None


@dataclass(frozen=True)
class Call:
    """A call of functions[function]; places in W where arguments and results begin, -1 for none."""

    function: int
    arguments: tuple[int, ...]
    results: tuple[int, ...]


@dataclass(frozen=True)
class Step:
    """Terms, then a call."""

    terms: Terms | None
    call: Call | None


@dataclass(frozen=True)
class Script:
    """The program that computes values, Jacobians or the Hessian of one stage."""

    steps: tuple[Step, ...]
    start: Array  # the numbers that constants and results begin with
    size: int  # of W
    results: tuple[int, ...]


@dataclass(frozen=True)
class Nonzeros:
    """The pattern of a matrix, column by column."""

    shape: tuple[int, int]
    row: Indices
    col: Indices


@dataclass(frozen=True)
class Kind:
    """Stages that are alike: sizes, patterns by (x, v), and scripts."""

    nx: int
    nv: int
    ne: int
    ng: int
    inner: int
    de: Nonzeros
    dd: Nonzeros
    dg: Nonzeros
    hessian: Nonzeros  # lower triangle
    values: Script
    jacobians: Script
    second: Script

    @property
    def scripts(self) -> tuple[Script, ...]:
        """Return all scripts."""
        return self.values, self.jacobians, self.second


@dataclass(frozen=True)
class Given:
    """An argument that the kernels of a model fill: run-time parameters, or what follows from them."""

    kernel: str
    name: str
    size: int
    plant: int = 0


@dataclass(frozen=True)
class StageProgram:
    """A whole program in stages; and how its vectors follow from the vectors of the program that it was made of.

    All equations give inner variables, and are 0. All other rows are inequalities, some with equal bounds. A row that
    is one state of the first stage is no row of these tables, but gives bounds of that state.
    """

    kinds: tuple[Kind, ...]
    kind_of_stage: tuple[int, ...]
    functions: tuple[CalledFunction, ...]
    parameters: int  # entries of p, as in the program
    given: tuple[Given, ...]  # follow p
    numbers: Array  # (stages, count): numbers of each stage
    variables: Indices  # of each variable (stage by stage, x before v): the program's, -1: an inner one of these tables
    bounded: Indices  # the same, but -1 where bounds are another copy's
    rows_e: Indices  # of each equation of a stage: the program's row, -1: one of these tables
    rows_d: Indices  # of each row of the dynamics, stage by stage: likewise
    rows_g: Indices  # of each inequality, stage by stage: the program's row, -1: one of these tables, which is 0
    fixed: Indices  # (count, 2): a variable, and the program's row whose bounds it has as well
    lifted: Indices  # variables y of these tables alone, whose equation is y - f(x, v) = 0
    lifted_rows: Indices  # these equations, by their numbers among all equations
    combined: Matrix  # (variables, variables): the lifted ones that are combinations of variables

    def place(self, x: Array) -> Array:
        """Return the variables of the tables from the program's; lifted ones are 0, or combinations."""
        w = np.where(self.variables < 0, 0.0, x[self.variables])
        return np.asarray(w + self.combined @ w)
