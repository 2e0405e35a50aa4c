"""The equations of motion as expressions: M(q) qdd + c(q, qd) + g(q) = applied, and h(q) = 0 of loops.

The textbook's recursion (Docquier, Bruls, Fisette, 2019, eqs. 12-15) is evaluated in trigonometric sums, and its result
is taken apart: what multiplies accelerations is M, what has a velocity in it belongs to c, springs and weight to g.
Forces of contacts and of force elements are applied forces, in numbers that have names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import sympy as sp
from mpmath import mpf

from mbsgen.assembly import assemble
from mbsgen.equations.named import Forces, Number, name_forces
from mbsgen.equations.sums import LARGEST, MOST, SUMS, Key, SizeError, Sum, variable
from mbsgen.errors import MbsError
from mbsgen.expressions import ExpressionError
from mbsgen.formulations import closure, coupling, impl
from mbsgen.formulations.reductions import NONE
from mbsgen.formulations.results import poses
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Model
from mbsgen.model.tree import Kind, Tree
from mbsgen.roles import Role
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Input, Tape

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class EvaluationError(MbsError):
    """Arguments for which equations have no value."""


@dataclass(frozen=True)
class Naming:
    """The symbols of a tree."""

    q: tuple[sp.Symbol, ...]
    qd: tuple[sp.Symbol, ...]
    qdd: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]  # of the actuated joints
    parameters: tuple[sp.Symbol, ...]
    signals: tuple[sp.Symbol, ...] = ()  # the last entries of w; the time among them
    design: tuple[sp.Symbol, ...] = ()  # differentiated parameters

    @property
    def taken(self) -> set[str]:
        """The names of all symbols that are known here."""
        columns = (self.q, self.qd, self.qdd, self.u, self.parameters, self.signals, self.design)
        return {symbol.name for column in columns for symbol in column}

    def name(self, port: Port, size: int) -> tuple[sp.Symbol, ...]:
        """Return the symbols of the entries of an input."""
        known = {
            Role.COORDINATE: self.q,
            Role.VELOCITY: self.qd,
            Role.ACCELERATION: self.qdd,
            Role.FORCE: self.u,
            Role.PARAMETER: self.parameters,
            Role.DESIGN: self.design,
        }
        given = known.get(port.role, ())
        return given if len(given) == size else self._number(port.name, size)

    def read(self, name: str, numbers: Sequence[float]) -> dict[sp.Symbol, float]:
        """Return the entries of an input, by its name in kernels. Raises EvaluationError for a wrong length."""
        known = {"q": self.q, "qd": self.qd, "qdd": self.qdd, "u": self.u}
        symbols = known[name] if name in known else self._number(name, len(numbers))
        if len(symbols) != len(numbers):
            raise EvaluationError(f"{name} has {len(symbols)} entries; {len(numbers)} are given")
        return dict(zip(symbols, numbers, strict=True))

    def _number(self, name: str, size: int) -> tuple[sp.Symbol, ...]:
        """Number the entries of an input; the last ones of w are signals."""
        last = self.signals if name == "w" else ()
        return (*(_symbol(f"{name}{k + 1}") for k in range(size - len(last))), *last)


@dataclass(frozen=True)
class Line:
    """A named value and its expression."""

    name: sp.Symbol
    expression: sp.Expr


@dataclass(frozen=True)
class Motion:
    """Equations M qdd + c + g = applied, of n joints; with loops, h = 0, and applied has multipliers in it."""

    name: str
    naming: Naming
    M: sp.Matrix  # (n, n)
    c: sp.Matrix  # (n, 1): what velocities cause, damping included
    g: sp.Matrix  # (n, 1): what remains at rest: weight, springs
    applied: sp.Matrix  # (n, 1): forces of the joints, open wrenches, multipliers
    h: sp.Matrix  # (m, 1): what loops leave open
    J: sp.Matrix  # (m, n): Jacobian of h, where hd = J qd
    sensors: tuple[str, ...]
    position: sp.Matrix  # (3, sensors): in the base frame
    terms: int  # of all equations of motion, and of the numbers that they read
    named: tuple[Line, ...] = ()  # numbers of contacts and force elements, or all intermediate values, in order
    values: Mapping[sp.Symbol, float] = field(default_factory=dict)  # of parameters that are symbols

    @cached_property
    def residual(self) -> sp.Matrix:
        """M qdd + c + g - applied, (n, 1)."""
        return self.M * sp.Matrix(self.naming.qdd) + self.c + self.g - self.applied

    def expand(self, value: sp.Basic) -> sp.Basic:
        """Put the expressions of `named` in place of their names."""
        for line in reversed(self.named):
            value = value.subs(line.name, line.expression)
        return value

    def jacobian(self, column: sp.Matrix, by: Sequence[sp.Symbol]) -> sp.Matrix:
        """Differentiate a column by symbols, and through `named`: its names stay in the result."""
        slopes: dict[sp.Symbol, list[sp.Expr]] = {}

        def differentiate(expression: sp.Expr) -> list[sp.Expr]:
            free = expression.free_symbols
            inner = [(sp.diff(expression, name), slope) for name, slope in slopes.items() if name in free]
            outer = [sp.diff(expression, x) if x in free else sp.S.Zero for x in by]
            return [own + sp.Add(*(a * b[k] for a, b in inner)) for k, own in enumerate(outer)]

        for line in self.named:
            slopes[line.name] = differentiate(line.expression)
        return sp.Matrix(column.rows, len(by), [entry for row in column for entry in differentiate(row)])

    def evaluate(self, value: sp.Matrix, **inputs: Sequence[float]) -> NDArray[np.float64]:
        """Evaluate a matrix, with `values` for parameters, and inputs by their names in kernels: q, qd, qdd, u, w, lam.

        Raises EvaluationError for inputs that are too long or too short, or missing.
        """
        import numpy as np  # here alone: whoever prints equations needs no arrays

        given = {symbol: sp.Float(number, _DIGITS) for symbol, number in self.values.items()}
        for name, numbers in inputs.items():
            found = self.naming.read(name, [float(x) for x in numbers])
            given |= {symbol: sp.Float(number, _DIGITS) for symbol, number in found.items()}
        reader = _Reader(given)
        for line in keep_used(self.named, value.free_symbols):
            reader.known[line.name] = reader.read(line.expression)
        entries = [float(reader.read(entry)) for entry in value]
        return np.array(entries, dtype=np.float64).reshape(value.shape)


_DIGITS = 30  # sums of trigonometric functions cancel


class _UnknownError(Exception):
    """Raised for a symbol without a number."""


class _Reader:
    """Evaluates expressions at given numbers, what they share once."""

    def __init__(self, given: Mapping[sp.Symbol, sp.Float]) -> None:
        self.known: dict[sp.Basic, sp.Basic] = dict(given)

    def read(self, expression: sp.Expr) -> sp.Expr:
        """Return a number. Raises EvaluationError for symbols that have none."""
        try:
            return sp.N(self._read(expression), _DIGITS)
        except _UnknownError:
            names = ", ".join(sorted(x.name for x in expression.free_symbols - self.known.keys()))
            raise EvaluationError(f"no number for {names}; give q, qd, qdd, u, w or lam, whichever has it") from None

    def _read(self, node: sp.Basic) -> sp.Basic:
        found = self.known.get(node)
        if found is None:
            if node.is_Symbol:
                raise _UnknownError
            found = node.func(*map(self._read, node.args)) if node.args else node
            if found.is_number and not found.is_Rational:
                found = sp.N(found, _DIGITS)
            self.known[node] = found
        return found


def name_symbols(tree: Tree) -> Naming:
    """Name the coordinates, velocities, accelerations and forces by their joints, and the parameters and signals.

    Symbols of one name would be one symbol, so a name that is taken gets a prefix, or underscores.
    """
    joints, taken = [joint.name for joint in tree.joints], {f"w{k + 1}" for k in range(tree.open_entries)}

    def choose(names: Iterable[str], prefix: str = "") -> tuple[sp.Symbol, ...]:
        found = []
        for name in names:
            free = prefix + name if name in taken else name
            while free in taken:
                free += "_"
            taken.add(free)
            found.append(_symbol(free))
        return tuple(found)

    return Naming(
        choose(tree.coordinates),
        choose(f"{x}_d" for x in joints),
        choose(f"{x}_dd" for x in joints),
        choose(f"u_{joint.name}" for joint in tree.joints if joint.actuated),
        choose((p.name for p in tree.parameters if p.kind is Kind.RUNTIME), "p_"),
        choose(tree.signals, "signal_"),
        choose((p.name for p in tree.parameters if p.kind is Kind.DIFFERENTIATED), "p_"),
    )


def build_symbolic(model: Model) -> Tree:
    """Build the tree of a model in which every named parameter is a symbol, where its rules allow that.

    It is to be read, and has no code: smooth functions stay functions.
    """
    symbolic = {p.name for p in model.parameters}
    for parameter in model.parameters:
        try:
            build_tree(_release(model, {parameter.name}), readable=True)
        except ExpressionError:  # a limit or another number that must be known depends on it
            symbolic.discard(parameter.name)
    return assemble(build_tree(_release(model, symbolic), readable=True))


def build_numeric(model: Model) -> Tree:
    """Build the tree of a model with its numbers, to be read."""
    return assemble(build_tree(model, readable=True))


def derive(tree: Tree, most: int = LARGEST) -> Motion:
    """Derive the equations of motion. Raises SizeError where an equation has more than `most` terms on the way."""
    token = MOST.set(most)
    try:
        return _derive(tree)
    finally:
        MOST.reset(token)


def _derive(tree: Tree) -> Motion:
    naming, forces = name_symbols(tree), name_forces(tree)
    values, named, size = _find_numbers(forces, naming)
    (Phi,) = _evaluate(coupling.write(impl.build, None, forces.tree, NONE), naming, numbers=values)
    n = len(tree.joints)
    accelerations = [_split(row, naming.qdd) for row in Phi]
    rest = [row.get(None, _ZERO) for row in accelerations]
    known = {*naming.q, *naming.qd, *naming.parameters}
    applied = [_part(row, lambda used: bool(used - known)) for row in rest]
    free = [row - a for row, a in zip(rest, applied, strict=True)]
    moving = [_part(row, lambda used: bool(used & set(naming.qd))) for row in free]
    still = [row - a for row, a in zip(free, moving, strict=True)]
    M = sp.Matrix(n, n, [row.get(x, _ZERO).expression for row in accelerations for x in naming.qdd])
    h, J = _derive_loops(tree, naming)
    sensors, position = _derive_positions(tree, naming)
    Q = -_column(applied)
    return Motion(
        name=tree.name,
        naming=naming,
        M=M,
        c=_column(moving),
        g=_column(still),
        applied=Q,
        h=h,
        J=J,
        sensors=sensors,
        position=position,
        terms=size + sum(len(row.terms) for row in Phi),
        values=list_values(tree, naming),
        named=keep_used([Line(name, value.expression) for name, value in named], Q.free_symbols),
    )


def list_values(tree: Tree, naming: Naming) -> dict[sp.Symbol, float]:
    """List the numbers of the parameters that are symbols."""
    columns = ((Kind.RUNTIME, naming.parameters), (Kind.DIFFERENTIATED, naming.design))
    found = [
        (symbol, p.value)
        for kind, symbols in columns
        for symbol, p in zip(symbols, (p for p in tree.parameters if p.kind is kind), strict=True)
    ]
    return dict(found)


def _find_numbers(forces: Forces, naming: Naming) -> tuple[list[Sum], list[tuple[sp.Symbol, Sum]], int]:
    """Find the values of the numbers of forces: names, or expressions in their place; the lines of the names; terms.

    Raises SizeError where they have more terms than an equation may have.
    """
    taken = naming.taken
    values: list[Sum] = []
    direct: list[Sum] = []  # without the names of these
    lines: list[tuple[sp.Symbol, Sum]] = []
    terms = 0
    for k, number in enumerate(forces.numbers):
        before = direct if number.is_direct else values
        given = [*before, *[_ZERO] * (len(forces.numbers) - k)]  # a number reads those before it
        (operands,) = _evaluate(forces.write_operands(k), naming, numbers=given)
        terms += sum(len(x.terms) for x in operands)
        if terms > MOST.get():
            raise SizeError(f"the numbers of contacts and force elements have more than {MOST.get()} terms")
        value = _apply(number, operands)
        direct.append(value)
        if number.name and value.number is None:
            symbol = choose_name(number.name, taken)
            lines.append((symbol, value))
            value = variable(symbol)
        values.append(value)
    return values, lines, terms


def _apply(number: Number, operands: Sequence[Sum]) -> Sum:
    if number.function is None:
        return operands[0]
    return variable(number.function(*(x.expression for x in operands)))


def choose_name(name: str, taken: set[str]) -> sp.Symbol:
    """Make a symbol of a name, or of the name with underscores, that is not taken, and take it."""
    while name in taken:
        name += "_"
    taken.add(name)
    return _symbol(name)


def keep_used(lines: Iterable[Line], used: set[sp.Basic]) -> tuple[Line, ...]:
    """Keep the lines that others, or results with the given symbols, read."""
    kept: list[Line] = []
    needed = set(used)
    for line in reversed([*lines]):
        if line.name in needed:
            kept.append(line)
            needed |= line.expression.free_symbols
    return tuple(reversed(kept))


_ZERO = Sum({}, mpf(0))


def _release(model: Model, names: set[str]) -> Model:
    """Make some parameters symbols."""
    return replace(
        model,
        parameters=tuple(replace(p, kind=Kind.RUNTIME) if p.name in names else p for p in model.parameters),
    )


def _derive_loops(tree: Tree, naming: Naming) -> tuple[sp.Matrix, sp.Matrix]:
    """Derive h(q), and its Jacobian."""
    if not tree.is_constrained:
        return sp.zeros(0, 1), sp.zeros(0, len(naming.qd))
    (h,) = _evaluate(coupling.write(lambda x, _: closure.build(x), None, tree, NONE), naming)
    (hd,) = _evaluate(coupling.write(lambda x, _: closure.build_rates(x), None, tree, NONE), naming)
    slopes = [_split(row, naming.qd) for row in hd]
    J = [row.get(x, _ZERO).expression for row in slopes for x in naming.qd]
    return _column(h), sp.Matrix(len(hd), len(naming.qd), J)


def _derive_positions(tree: Tree, naming: Naming) -> tuple[tuple[str, ...], sp.Matrix]:
    names = tuple(sensor.name for sensor in tree.sensors)
    if not names:
        return (), sp.zeros(3, 0)
    (places,) = _evaluate(coupling.write(lambda x, _: poses.build_sensors(x), None, tree, NONE), naming)
    return names, sp.Matrix(len(names), 3, [x.expression for x in places]).T


def _evaluate(tape: Tape, naming: Naming, *, numbers: Sequence[Sum] = ()) -> list[list[Sum]]:
    """Evaluate dense outputs in trigonometric sums, entry by entry, column by column.

    The last parameters are numbers of forces.
    """

    def give(given: Input) -> list[Sum]:
        own = numbers if given.port.role is Role.PARAMETER else ()
        return [*map(variable, naming.name(given.port, given.sparsity.nnz - len(own))), *own]

    given = {i.name: give(i) for i in tape.inputs}
    found = evaluate(tape, given, SUMS)
    results = []
    for output in tape.outputs:
        entries = dict(zip(output.sparsity.entries, found[output.name], strict=True))
        shape = output.sparsity
        results.append([entries.get((r, c), _ZERO) for c in range(shape.cols) for r in range(shape.rows)])
    return results


def _split(row: Sum, symbols: Sequence[sp.Symbol]) -> dict[sp.Symbol | None, Sum]:
    """Split a sum that is linear in some symbols into their coefficients, and the rest, which is at None."""
    found: dict[sp.Symbol | None, Sum] = {}
    for powers, part in row.collect(tuple(symbols)).items():
        assert [n for _, n in powers] in ([], [1]), "equations are linear in accelerations"
        found[powers[0][0] if powers else None] = part
    return found


def _part(row: Sum, belongs: Callable[[set[sp.Basic]], bool]) -> Sum:
    """Keep the terms whose variables belong."""
    return Sum({key: c for key, c in row.terms.items() if belongs(_list_symbols(key))}, row.scale)


def _list_symbols(key: Key) -> set[sp.Basic]:
    powers, _, angle = key
    return {symbol for x, _ in (*powers, *angle) for symbol in x.free_symbols}


def _column(rows: Sequence[Sum]) -> sp.Matrix:
    return sp.Matrix(len(rows), 1, [row.expression for row in rows])


def _symbol(name: str) -> sp.Symbol:
    return sp.Symbol(name, real=True)
