"""Derivatives, in 50 digits, along one random direction: Jacobians and adjoints against central differences.

A Jacobian is compared with differences of its function, an adjoint with the Jacobian, and second derivatives with
differences of the adjoint. So each is compared with something that was compared before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal, localcontext

from mbsgen.formulations import ports
from mbsgen.procedure.procedure import Computation, Procedure, evaluate
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Order, Role
from mbsgen.tape.interpreter import DECIMALS
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Output, Sparsity
from mbsgen.targets.contract import Family
from mbsgen.verification.functions import Comparison, largest
from mbsgen.verification.geometry import ONE, STEP, ZERO, dot, slope
from mbsgen.verification.states import Numbers, draw

Arguments = Callable[[Computation], dict[str, Numbers]]  # the arguments of a function at a state
Vectors = dict[str, Numbers]  # by result or by input

SMALL = Decimal("1e-6")  # of an adjoint beside the others: a far contact gives one in which logarithms lost digits
LOST = Decimal("1e-12")  # of a result: differences over STEP round a derivative that is smaller off below the tolerance
COARSE = 45  # digits
COARSENESS = Decimal(10) ** (1 - COARSE)  # of numbers of COARSE digits
Sizes = Mapping[str, Sequence[Decimal]]  # of the entries of inputs, by their names, where they are not 1
DIRECTION = "direction"  # the name under which its numbers are drawn, with the name of the input


def compare_derivatives(family: Family, arguments: Arguments, sizes: Sizes) -> Iterator[tuple[str, Comparison]]:
    """Compare all derivatives of a function, each under its kernel's name, along a direction of given sizes."""
    if not (family.jac or family.adj1):
        return
    value, way = family.value, _Direction(family, sizes)
    along = slope_of(value, arguments(value), way)
    if family.jac:
        for name, found in _products(family, family.jac, arguments, way):
            yield family.jac.name, Comparison(name, found, along[name], _size(value, arguments, name))
    if family.adj1:
        given = arguments(family.adj1)
        adjoint = evaluate(family.adj1, given, DECIMALS)
        gradient = [dot(adjoint[o.name], way.take(by.name, o.sparsity.nnz)) for o, by in _adjoints(family.adj1)]
        weighted = [dot(given[i.name], along[i.port.of.name]) for i in family.adj1.inputs if i.port.of]
        floor = LOST * largest([_size(value, arguments, i.port.of.name) for i in family.adj1.inputs if i.port.of])
        scale = max(largest(gradient), largest(weighted), floor)
        floors = _lose(family.adj1, given)
        yield family.adj1.name, Comparison("adj", [sum(gradient, ZERO)], [sum(weighted, ZERO)], scale)
        if family.jac_adj1:
            way = _Direction(family, sizes, of_adjoint=True)
            along = slope_of(family.adj1, given, way)
            for name, product in _products(family, family.jac_adj1, arguments, way):
                size = max(largest(adjoint[name]), SMALL * scale, floors[name])
                yield family.jac_adj1.name, Comparison(name, product, along[name], size)


def compare_linearised(lin: Family, plain: Family, arguments: Arguments, sizes: Sizes) -> Iterator[Comparison]:
    """Compare a `lin_` function with the function and with its Jacobian."""
    way = _Direction(plain, sizes)
    along = slope_of(plain.value, arguments(plain.value), way)
    found, expected = (evaluate(f, arguments(f), DECIMALS) for f in (lin.value, plain.value))
    for name in expected:
        yield Comparison(name, found[name], expected[name], _floor(plain.value, name))
    for name, product in _products(plain, lin.value, arguments, way, lin.staged):
        yield Comparison(name, product, along[name], _size(plain.value, arguments, name))


class _Direction:
    """The direction: numbers for every input that derivatives are taken by."""

    def __init__(self, family: Family, sizes: Sizes, *, of_adjoint: bool = False) -> None:
        self._family, self._sizes, self._of_adjoint = family, sizes, of_adjoint

    def wrt(self) -> set[str]:
        """Return the inputs that derivatives are taken by."""
        written = self._family.adj1 or self._family.jac
        assert written is not None, "there is something to compare"
        found = {o.port.by.name for o in written.outputs if o.port.by}
        seeds = {i.name for i in written.inputs if i.port.role is Role.SEED}
        return found | seeds if self._of_adjoint else found

    def take(self, name: str, size: int) -> Numbers:
        drawn = draw(f"{DIRECTION} {name}", size, 0)
        return [x * more for x, more in zip(drawn, self._sizes.get(name, [ONE] * size), strict=True)]


def _adjoints(adj1: Computation) -> Iterator[tuple[Output | Wire, Port]]:
    """List the results of an adjoint, each with the input that it is the derivative by."""
    for o in adj1.outputs:
        assert o.port.by, "an adjoint is by an input"
        yield o, o.port.by


def slope_of(tape: Computation, given: Mapping[str, Numbers], way: _Direction) -> Vectors:
    """Differentiate a tape along a direction, by a central difference."""
    ends = []
    wrt = way.wrt()
    for h in (STEP, -STEP):
        moved = {
            name: [a + h * b for a, b in zip(x, way.take(name, len(x)), strict=True)] if name in wrt else x
            for name, x in given.items()
        }
        ends.append(evaluate(tape, moved, DECIMALS))
    return {name: slope(ends[0][name], ends[1][name]) for name in ends[0]}


def _products(
    family: Family,
    derived: Computation,
    arguments: Arguments,
    way: _Direction,
    staged: Mapping[str, Procedure] | None = None,
) -> Iterator[tuple[str, Numbers]]:
    """Multiply the blocks of a Jacobian by the direction, for each result; once more in stages, if it has some."""
    of_adjoint = family.adj1 if derived.function.order is Order.ADJOINT_JACOBIAN else None
    in_stages = (family.staged if staged is None else staged).get(derived.name)
    for written in (derived, in_stages) if in_stages else (derived,):
        blocks = evaluate(written, arguments(written), DECIMALS)
        found = {o.port: (o.sparsity, blocks[o.name]) for o in written.outputs}
        yield from _multiply(of_adjoint or family.value, found, way)


def _multiply(
    function: Computation, blocks: Mapping[Port, tuple[Sparsity, Sequence[Decimal]]], way: _Direction
) -> Iterator[tuple[str, Numbers]]:
    """Yield J v for every result of `function`, in its storage order. Missing blocks are zero."""
    for o in function.outputs:
        size = o.sparsity.rows * o.sparsity.cols
        total = [ZERO] * size
        for port, (pattern, values) in blocks.items():
            if port.of == o.port and port.by:
                direction = way.take(port.by.name, pattern.cols)
                for (r, c), value in zip(pattern.entries, values, strict=True):
                    total[r] += value * direction[c]
        places = [c * o.sparsity.rows + r for r, c in o.sparsity.entries]
        yield o.name, [total[k] for k in places]


def _size(tape: Computation, arguments: Arguments, name: str) -> Decimal:
    given = arguments(tape)
    return max(_floor(tape, name), largest(evaluate(tape, given, DECIMALS)[name]), _lose(tape, given)[name])


def _lose(tape: Computation, given: Mapping[str, Numbers]) -> dict[str, Decimal]:
    """Return LOST of the terms of each result, whose size fewer digits show: terms may cancel to nothing."""
    fine = evaluate(tape, given, DECIMALS)
    with localcontext(prec=COARSE):
        coarse = evaluate(tape, given, DECIMALS)
    return {
        name: LOST * largest([a - b for a, b in zip(fine[name], coarse[name], strict=True)]) / COARSENESS
        for name in fine
    }


def _floor(tape: Computation, name: str) -> Decimal:
    """Return the least size of a result: 1 rad or 1 m of closed coordinates, which may be rounding about 0."""
    return ONE if any(o.name == name and o.port is ports.CLOSED for o in tape.outputs) else ZERO
