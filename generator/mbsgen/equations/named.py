"""Numbers of forces that equations name: a tree -> the tree whose forces read them as parameters, and their values.

A contact names its gap, depth, normal force N, slip and drag, a force element its length and tension F. A contact of
spheres also names the distance of their centres, its length; a contact with a box names the parts of its distance, in
the box's axes. A smooth function of the state is such a number too, without a name: its value is the function of its
arguments. Values may depend on the state, and on numbers before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from mbsgen.formulations import coupling
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.reductions import NONE
from mbsgen.formulations.states import declare_state
from mbsgen.model.smooth import SMOOTH
from mbsgen.model.tree import (
    COORDINATE,
    RATE,
    Body,
    Definition,
    Kind,
    Parameter,
    Tree,
    Wrench,
    coordinate_symbol,
    rate_symbol,
)
from mbsgen.roles import Role
from mbsgen.tape.builder import Builder
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Tape

_SHOWN: Mapping[str, str] = {  # by the keys of definitions; the name of the contact or force element follows
    "length": "length_{}",
    "rate": "rate_{}",
    "pull": "F_{}",
    "gap": "gap_{}",
    "depth": "depth_{}",
    "N": "N_{}",
    "drag": "drag_{}",
    **{f"slip.{axis}": f"slip_{{}}_{axis}" for axis in "xyz"},
    **{f"x.{axis}": f"at_{{}}_{axis}" for axis in "xyz"},
    **{f"q.{axis}": f"beyond_{{}}_{axis}" for axis in "xyz"},
    **{f"side.{axis}": f"side_{{}}_{axis}" for axis in "xyz"},
    **{f"slope.{axis}": f"slope_{{}}_{axis}" for axis in "xyz"},
    **{key: f"{key}_{{}}" for key in ("most", "inside", "both", "first")},
    "outside": "outside_{}",
}
_DIRECT = ("slip.x", "slip.y", "slip.z")  # on planes, the rate is written out in them: much of it cancels
_KEPT = (*SMOOTH, sp.Max, sp.Min)
_VALUE = Port("value", Role.RESULT)


@dataclass(frozen=True)
class Number:
    """A number of forces, by the symbol that the tree's forces read it by."""

    symbol: sp.Symbol
    name: str  # "": it is written in its place
    operands: tuple[sp.Expr, ...]  # over the state as forces read it, and numbers before
    function: type[sp.Expr] | None = None  # of the operands; None: there is one, and it is the number
    is_direct: bool = False  # numbers before are written out in it


@dataclass(frozen=True)
class Forces:
    """A tree, and the numbers that are its last parameters."""

    tree: Tree
    numbers: tuple[Number, ...]

    def write_operands(self, k: int) -> Tape:
        """Write the operands of a number: inputs q, qd [, w] [, p]; output value."""
        wanted = self.numbers[k].operands
        return coupling.write(lambda tree, _: _write_values(tree, wanted), None, self.tree, NONE)


def name_forces(tree: Tree) -> Forces:
    """Take the numbers out of a tree that its equations are to name."""
    collector = _Collector()
    definitions = tuple(collector.define(tree.definitions))
    bodies = tuple(collector.bind(body) for body in tree.bodies)
    wrenches = tuple(map(collector.press, tree.wrenches))
    parameters = (*tree.parameters, *(Parameter(x.symbol.name, x.symbol, 1.0, Kind.RUNTIME) for x in collector.numbers))
    named = replace(tree, definitions=definitions, bodies=bodies, wrenches=wrenches, parameters=parameters)
    return Forces(named, tuple(collector.numbers))


class _Collector:
    """Collects the numbers, in an order in which each depends on those before."""

    def __init__(self) -> None:
        self.numbers: list[Number] = []
        self._places: dict[sp.Expr, sp.Symbol] = {}  # of functions

    def define(self, definitions: Sequence[Definition]) -> Iterator[Definition]:
        """Take the numbers out of definitions, and return the rest."""
        lengths = {x.owner: x.symbol for x in definitions if x.key == "length"}
        curved = {x.owner for x in definitions if x.key in ("length", "outside")}
        for definition in definitions:
            value = self.take(definition.value)
            if definition.key not in _SHOWN:
                yield replace(definition, value=value)
                continue
            name = _SHOWN[definition.key].format(definition.owner)
            if definition.key == "pull":  # it is the tension by the length
                tension = self._add(name, (value * lengths[definition.owner],))
                yield replace(definition, value=tension / lengths[definition.owner])
            else:
                is_direct = definition.key in _DIRECT and definition.owner not in curved
                self._add(name, (value,), symbol=definition.symbol, is_direct=is_direct)

    def bind(self, body: Body) -> Body:
        """Take the functions out of the force law of a joint."""
        own = {COORDINATE: coordinate_symbol(body.joint.name), RATE: rate_symbol(body.joint.name)}
        law = body.joint.law
        return replace(body, joint=replace(body.joint, law=self.take(law.xreplace(own)))) if law.has(*_KEPT) else body

    def press(self, wrench: Wrench) -> Wrench:
        """Take the functions out of a wrench."""
        force, moment = (
            None if v is None else (self.take(v[0]), self.take(v[1]), self.take(v[2]))
            for v in (wrench.force, wrench.moment)
        )
        return replace(wrench, force=force, moment=moment)

    def take(self, expression: sp.Expr) -> sp.Expr:
        """Put numbers in place of functions, from the innermost on."""
        while functions := [x for x in expression.atoms(*_KEPT) if not any(y.has(*_KEPT) for y in x.args)]:
            for function in sorted(functions, key=sp.default_sort_key):
                if function not in self._places:
                    self._places[function] = self._add("", function.args, function.func)
            expression = expression.xreplace(self._places)
        return expression

    def _add(
        self,
        name: str,
        operands: tuple[sp.Expr, ...],
        function: type[sp.Expr] | None = None,
        *,
        symbol: sp.Symbol | None = None,
        is_direct: bool = False,
    ) -> sp.Symbol:
        symbol = symbol or sp.Symbol(f"number[{len(self.numbers)}]", real=True)
        self.numbers.append(Number(symbol, name, operands, function, is_direct))
        return symbol


def _write_values(tree: Tree, wanted: Sequence[sp.Expr]) -> Tape:
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False)
    chain = write_chain(tree, builder, state)
    builder.output_dense(_VALUE, [[chain.force(x)] for x in wanted])
    return builder.build("forces")
