"""The recursion's own lines, for mechanisms whose equations would fill pages: named values, and results of them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from mbsgen.equations.motion import Line, Naming, choose_name, keep_used, name_symbols
from mbsgen.equations.named import Forces, Number, name_forces
from mbsgen.equations.sums import FUNCTIONS, to_number
from mbsgen.formulations import coupling, impl
from mbsgen.formulations.reductions import ALL
from mbsgen.model.tree import Tree
from mbsgen.roles import Role
from mbsgen.tape.counts import named_values
from mbsgen.tape.types import Op, Tape

Given = Mapping[Role, Callable[[int], Sequence[sp.Expr]]]  # inputs by their roles, from their sizes
NOTHING: Given = {}


@dataclass(frozen=True)
class Lines:
    """A function line by line, and the expressions of its results."""

    name: str
    naming: Naming
    lines: tuple[Line, ...]
    results: Mapping[str, sp.Matrix]


def write_lines(tree: Tree) -> Lines:
    """Write the reduced recursion of Phi(q, qd, qdd) - Q, as it is generated, after the numbers of its forces."""
    naming, forces = name_symbols(tree), name_forces(tree)
    writer = Writer(naming)
    values = writer.write_numbers(forces)
    results = writer.write(coupling.write(impl.build, None, forces.tree, ALL), values)
    used = {symbol for value in results.values() for symbol in value.free_symbols}
    return Lines(tree.name, naming, keep_used(writer.lines, used), results)


class Writer:
    """Writes tapes line by line; a line that is there already is not written again."""

    def __init__(self, naming: Naming) -> None:
        self.lines: list[Line] = []
        self._naming, self._taken = naming, naming.taken
        self._known: dict[sp.Expr, sp.Symbol] = {}

    def name(self, number: Number, operands: tuple[sp.Expr, ...]) -> sp.Expr:
        """Return a number of forces: a name, or an expression in its place."""
        value = operands[0] if number.function is None else number.function(*operands)
        if not number.name or value.is_number:
            return value
        symbol = choose_name(number.name, self._taken)
        self.lines.append(Line(symbol, value))
        return symbol

    def write_numbers(self, forces: Forces) -> list[sp.Expr]:
        """Write the numbers of forces; return names, or expressions in their place."""
        values: list[sp.Expr] = []
        for k, number in enumerate(forces.numbers):
            given = [*values, *[sp.Integer(0)] * (len(forces.numbers) - k)]  # a number reads those before it
            operands = self.write(forces.write_operands(k), given)["value"]
            values.append(self.name(number, tuple(operands)))
        return values

    def write(self, tape: Tape, numbers: Sequence[sp.Expr], known: Given = NOTHING) -> dict[str, sp.Matrix]:
        """Write a tape; the last parameters are numbers of forces. Inputs of some roles may be known."""
        values: list[sp.Expr] = []
        for given in tape.inputs:
            own = numbers if given.port.role is Role.PARAMETER else ()
            size, role = given.sparsity.nnz - len(own), given.port.role
            values += [*(known[role](size) if role in known else self._naming.name(given.port, size)), *own]
        self._taken |= {str(x) for x in values if x.is_Symbol}
        values += map(to_number, tape.literals)
        named = named_values(tape)
        for k, (op, a, b) in enumerate(tape.operations, tape.first_operation):
            operands = (values[a],) if b < 0 else (values[a], values[b])
            expression = _OPERATIONS[op](*operands)
            is_long = k in named and not expression.is_Atom
            values.append(self._keep(expression, tape.labels.get(k, "")) if is_long else expression)
        results = {}
        for output in tape.outputs:
            entries = dict(zip(output.sparsity.entries, (values[v] for v in output.values), strict=True))
            shape = (output.sparsity.rows, output.sparsity.cols)
            results[output.name] = sp.Matrix(*shape, lambda r, c, e=entries: e.get((r, c), sp.Integer(0)))
        return results

    def _keep(self, expression: sp.Expr, label: str) -> sp.Symbol:
        if expression not in self._known:
            symbol = sp.Symbol(_choose(label, len(self.lines) + 1, self._taken), real=True)
            self._taken.add(symbol.name)
            self.lines.append(Line(symbol, expression))
            self._known[expression] = symbol
        return self._known[expression]


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
