"""The recursion's own lines, for mechanisms whose equations would fill pages: named values, and results of them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import sympy as sp

from mbsgen.equations.motion import Naming, name_symbols
from mbsgen.equations.sums import FUNCTIONS, to_number
from mbsgen.formulations import impl
from mbsgen.model.tree import Tree
from mbsgen.tape.counts import named_values
from mbsgen.tape.types import Op, Tape


@dataclass(frozen=True)
class Line:
    """A named value and its expression."""

    name: sp.Symbol
    expression: sp.Expr


@dataclass(frozen=True)
class Lines:
    """A function line by line, and the expressions of its results."""

    name: str
    naming: Naming
    lines: tuple[Line, ...]
    results: Mapping[str, sp.Matrix]


def write_lines(tree: Tree) -> Lines:
    """Write the reduced recursion of Phi(q, qd, qdd) - Q, as it is generated."""
    return _write(impl.build(tree), name_symbols(tree), tree.name)


def _write(tape: Tape, naming: Naming, name: str) -> Lines:
    values: list[sp.Expr] = [x for i in tape.inputs for x in naming.name(i.port, i.sparsity.nnz)]
    values += map(to_number, tape.literals)
    taken, named = {str(x) for x in values}, named_values(tape)
    lines: list[Line] = []
    for number, (op, a, b) in enumerate(tape.operations, tape.first_operation):
        operands = (values[a],) if b < 0 else (values[a], values[b])
        expression = _OPERATIONS[op](*operands)
        if number in named and not expression.is_Atom:
            symbol = sp.Symbol(_choose(tape.labels.get(number, ""), len(lines) + 1, taken), real=True)
            taken.add(symbol.name)
            lines.append(Line(symbol, expression))
            values.append(symbol)
        else:
            values.append(expression)
    results = {}
    for output in tape.outputs:
        entries = dict(zip(output.sparsity.entries, (values[v] for v in output.values), strict=True))
        shape = (output.sparsity.rows, output.sparsity.cols)
        results[output.name] = sp.Matrix(*shape, lambda r, c, e=entries: e.get((r, c), sp.Integer(0)))
    return Lines(name, naming, tuple(lines), results)


def _choose(label: str, number: int, taken: set[str]) -> str:
    """Take the label of a value as its name, or a number."""
    if label and label not in taken:
        return label
    while f"t{number}" in taken:
        number += 1
    return f"t{number}"


_OPERATIONS: Mapping[Op, Callable[..., sp.Expr]] = {
    Op.ADD: operator.add,
    Op.SUB: operator.sub,
    Op.MUL: operator.mul,
    Op.DIV: operator.truediv,
    Op.NEG: operator.neg,
    Op.ATAN2: sp.atan2,
    **FUNCTIONS,
}
