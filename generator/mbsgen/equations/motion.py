"""The equations of motion as expressions: M(q) qdd + c(q, qd) + g(q) = applied, and h(q) = 0 of loops.

The textbook's recursion (Docquier, Bruls, Fisette, 2019, eqs. 12-15) is evaluated in trigonometric sums, and its result
is taken apart: what multiplies accelerations is M, what has a velocity in it belongs to c, springs and weight to g.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import sympy as sp
from mpmath import mpf

from mbsgen.assembly import assemble
from mbsgen.equations.sums import LARGEST, MOST, SUMS, Key, Sum, variable
from mbsgen.expressions import ExpressionError
from mbsgen.formulations import closure, impl, poses
from mbsgen.formulations.reductions import NONE
from mbsgen.model.model import Model
from mbsgen.model.reduction import build_tree
from mbsgen.model.tree import Kind, Tree
from mbsgen.roles import Role
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Tape


@dataclass(frozen=True)
class Naming:
    """The symbols of a tree."""

    q: tuple[sp.Symbol, ...]
    qd: tuple[sp.Symbol, ...]
    qdd: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]  # of the actuated joints
    parameters: tuple[sp.Symbol, ...]
    signals: tuple[sp.Symbol, ...] = ()  # the last entries of w; the time among them

    def name(self, port: Port, size: int) -> tuple[sp.Symbol, ...]:
        """Return the symbols of the entries of an input."""
        known = {
            Role.COORDINATE: self.q,
            Role.VELOCITY: self.qd,
            Role.ACCELERATION: self.qdd,
            Role.FORCE: self.u,
            Role.PARAMETER: self.parameters,
        }
        given = known.get(port.role, ())
        if len(given) == size:
            return given
        last = self.signals if port.role is Role.WRENCH else ()
        return (*(_symbol(f"{port.name}{k + 1}") for k in range(size - len(last))), *last)


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
    terms: int  # of all equations of motion

    @cached_property
    def residual(self) -> sp.Matrix:
        """M qdd + c + g - applied, (n, 1)."""
        return self.M * sp.Matrix(self.naming.qdd) + self.c + self.g - self.applied


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
    )


def build_symbolic(model: Model) -> Tree:
    """Build the tree of a model in which every named parameter is a symbol, where its rules allow that."""
    symbolic = {p.name for p in model.parameters}
    for parameter in model.parameters:
        try:
            build_tree(_release(model, {parameter.name}))
        except ExpressionError:  # a limit or another number that must be known depends on it
            symbolic.discard(parameter.name)
    return assemble(build_tree(_release(model, symbolic)))


def derive(tree: Tree, most: int = LARGEST) -> Motion:
    """Derive the equations of motion. Raises SizeError where an equation has more than `most` terms on the way."""
    token = MOST.set(most)
    try:
        return _derive(tree)
    finally:
        MOST.reset(token)


def _derive(tree: Tree) -> Motion:
    naming = name_symbols(tree)
    (Phi,) = _evaluate(impl.build(tree, NONE), naming)
    n = len(tree.joints)
    accelerations = [_split(row, naming.qdd) for row in Phi]
    rest = [row.get(None, _ZERO) for row in accelerations]
    moving = [_part(row, lambda used: bool(used & set(naming.qd))) for row in rest]
    known = {*naming.q, *naming.qd, *naming.parameters}
    applied = [_part(row, lambda used: bool(used - known)) for row in rest]
    still = [row - a - b for row, a, b in zip(rest, moving, applied, strict=True)]
    M = sp.Matrix(n, n, [row.get(x, _ZERO).expression for row in accelerations for x in naming.qdd])
    h, J = _derive_loops(tree, naming)
    sensors, position = _derive_positions(tree, naming)
    return Motion(
        name=tree.name,
        naming=naming,
        M=M,
        c=_column(moving),
        g=_column(still),
        applied=-_column(applied),
        h=h,
        J=J,
        sensors=sensors,
        position=position,
        terms=sum(len(row.terms) for row in Phi),
    )


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
    (h,) = _evaluate(closure.build(tree), naming)
    (hd,) = _evaluate(closure.build_rates(tree), naming)
    slopes = [_split(row, naming.qd) for row in hd]
    J = [row.get(x, _ZERO).expression for row in slopes for x in naming.qd]
    return _column(h), sp.Matrix(len(hd), len(naming.qd), J)


def _derive_positions(tree: Tree, naming: Naming) -> tuple[tuple[str, ...], sp.Matrix]:
    names = tuple(sensor.name for sensor in tree.sensors)
    if not names:
        return (), sp.zeros(3, 0)
    tape = poses.build_sensors(tree)
    places = _evaluate(tape, naming, "position")[0]
    return names, sp.Matrix(len(names), 3, [x.expression for x in places]).T


def _evaluate(tape: Tape, naming: Naming, *wanted: str) -> list[list[Sum]]:
    """Evaluate dense outputs in trigonometric sums, entry by entry, column by column."""
    given = {i.name: list(map(variable, naming.name(i.port, i.sparsity.nnz))) for i in tape.inputs}
    found = evaluate(tape, given, SUMS)
    results = []
    for output in tape.outputs:
        if not wanted or output.name in wanted:
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
