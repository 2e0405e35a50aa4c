"""Derivatives of procedures, stage by stage, by the rules of their kinds.

    jacobian    jac_<out>_<in>, forward
    adjoint     adj_<in> = sum over results of (d out / d in)^T adj_<out>, backward

Either is a procedure, so that second derivatives are the Jacobian of the adjoint.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from mbsgen.procedure.adjoints import Adjoints
from mbsgen.procedure.fusion import fuse
from mbsgen.procedure.naming import Names
from mbsgen.procedure.procedure import Procedure
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.slopes import Slopes
from mbsgen.procedure.solve import Factor
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.straight import written
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Order
from mbsgen.tape.ports import adjoint_port, derivative_port, seed_port
from mbsgen.tape.types import Sparsity


def jacobian(procedure: Procedure, wrt: Sequence[str], *, with_values: bool = False) -> Procedure:
    """Differentiate every result by the inputs `wrt`. Blocks that are zero are left out.

    with_values: the results come first, as in a linearisation.
    """
    own = procedure.function
    order = Order.ADJOINT_JACOBIAN if own.order is Order.ADJOINT else Order.JACOBIAN
    slopes = Slopes([procedure.input(x) for x in wrt], _find_matrices(procedure), _list_names(procedure))
    stages = [stage for given in procedure.stages for stage in given.push(slopes)]
    sheet, outputs = Sheet(), [*procedure.outputs] if with_values else []
    for output, x in product(procedure.outputs, wrt):
        if x in (found := slopes.find(output)):
            wire, port = found[x], derivative_port(output.port, procedure.input(x).port)
            block = Wire.to(port, wire.sparsity if wire else _unit(output))
            if wire is None or wire.name != block.name:  # an input that is a result, or a name that was taken
                sheet.give(block, sheet.take(wire) if wire else [sheet.builder.number(1.0)] * output.sparsity.nnz)
            outputs.append(block)
    stages += written(sheet, slopes.name("renamed"))
    order = Order.LINEARISATION if with_values else order
    return fuse(Procedure(own.to(order), procedure.inputs, tuple(stages), tuple(outputs)))


def adjoint(procedure: Procedure, wrt: Sequence[str]) -> Procedure:
    """Carry weights `adj_<out>`, further inputs, back to the inputs `wrt`."""
    names = _list_names(procedure)
    seeds = {output.name: Wire.to(seed_port(output.port), output.sparsity) for output in procedure.outputs}
    results = [Wire.to(adjoint_port(x.port), x.sparsity) for x in map(procedure.input, wrt)]
    names.take(wire.name for wire in (*seeds.values(), *results))
    active = set(wrt)
    for stage in procedure.stages:
        if any(wire.name in active for wire in stage.reads):
            active |= {wire.name for wire in stage.gives}
    adjoints = Adjoints(active, _find_matrices(procedure), names)
    for output in procedure.outputs:
        adjoints.seed(output, seeds[output.name])
    onward: list[Stage] = []
    back: list[Stage] = []
    for stage in reversed(procedure.stages):
        is_passed = any(map(adjoints.has, stage.gives)) and any(map(adjoints.is_active, stage.reads))
        pulled = stage.pull(adjoints) if is_passed else None
        onward = [*(pulled.onward if pulled else (stage,)), *onward]
        back += pulled.back if pulled else ()
    sheet = Sheet()
    for result, x in zip(results, wrt, strict=True):
        sheet.give(result, adjoints.take(sheet, procedure.input(x)))
    stages = (*onward, *back, *written(sheet, names.make("sums")))
    return fuse(
        Procedure(procedure.function.to(Order.ADJOINT), (*procedure.inputs, *seeds.values()), stages, tuple(results))
    )


def _unit(wire: Wire) -> Sparsity:
    return Sparsity.of(wire.numel, wire.numel, [(k, k) for k in wire.places])


def _find_matrices(procedure: Procedure) -> dict[str, Wire]:
    """Map each wire that holds factors to the matrix that they are of."""
    return {w.name: s.matrix for s in procedure.stages if isinstance(s, Factor) for w in s.gives}


def _list_names(procedure: Procedure) -> Names:
    """List the names of all wires and stages."""
    wires = [wire.name for wire in procedure.inputs] + [wire.name for s in procedure.stages for wire in s.gives]
    return Names([*wires, *(stage.name for stage in procedure.stages)])
