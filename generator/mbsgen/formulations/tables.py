"""Trees as tables, which loops of the generated code read: Tree -> `semi` in two stages, with code of O(n).

A straight stage places each body beside its parent, and computes the bias. The recursion of `procedure.tree_dynamics`
computes M (Walker, Orin, 1982).
"""

from __future__ import annotations

from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.links import Link
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Kind, Tree
from mbsgen.procedure.procedure import Procedure
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.tree_dynamics import MOMENTS, PLACEMENT, TreeMatrix, count_pairs
from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Sparsity


def can_loop(tree: Tree, size: int) -> bool:
    """Return whether tables describe a tree, and it has `size` pairs of a body with one that carries it, or itself.

    It has no closed loops, couplings, driven joints, quaternions, nor parameters that are differentiated by.
    """
    special = tree.is_constrained or tree.couplings or tree.quaternions
    design = any(parameter.kind is Kind.DIFFERENTIATED for parameter in tree.parameters)
    return not (special or design) and count_pairs([body.parent for body in tree.bodies]) >= size


def write_semi(tree: Tree, reductions: Reductions) -> Procedure:
    """Write `semi`: inputs q, qd [, w] [, p]; outputs M, shape (n, n), and c, shape (n,)."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False)
    chain = write_chain(tree, builder, state)
    segments = align(chain, group=reductions.share_frames)
    writing = begin(chain, segments, find_plans(tree, reductions).bias, reductions)
    builder.output_dense(ports.BIAS, [[x] for x in residual(writing, state.qd, chain.drift)])
    tables = {
        "placements": list_placements(chain),
        "moments": list_moments(chain, builder),
        "rotors": list(chain.armatures),
    }
    for name, values in tables.items():
        builder.output(name, Sparsity.dense(len(values)), values)
    before = Straight(finish(builder.build("place_semi"), reductions))
    wires = {wire.name: wire for wire in before.gives}
    n = len(tree.bodies)
    matrix = TreeMatrix(
        name="matrix_semi",
        parents=tuple(link.parent for link in chain.links),
        joints=list_joints(chain),
        placements=wires["placements"],
        moments=wires["moments"],
        rotors=wires["rotors"],
        matrix=Wire.to(ports.MASS_MATRIX, Sparsity.dense(n, n)),
    )
    return Procedure(Function("semi"), before.reads, (before, matrix), (matrix.matrix, wires[ports.BIAS.name]))


def list_joints(chain: Chain) -> tuple[int, ...]:
    """List the axis of each joint, and 3 more where it slides."""
    return tuple(link.joint.axis + (0 if link.is_revolute else 3) for link in chain.links)


def list_placements(chain: Chain) -> list[Scalar]:
    """List the rotation of each body to its parent by rows, then its joint point."""
    return [x for link in chain.links for x in _place(link)]


def list_moments(chain: Chain, builder: Builder) -> list[Scalar]:
    """List the mass, the first and the second moments of each body."""
    return [x for link in chain.links for x in _weigh(link, builder)]


def _place(link: Link) -> list[Scalar]:
    """List the rotation to the parent by rows, then the joint point."""
    placed = [*(x for row in link.R.rows for x in row), *link.dpt]
    assert len(placed) == PLACEMENT, "as the recursion reads it"
    return placed


def _weigh(link: Link, builder: Builder) -> list[Scalar]:
    """List mass, first moments, and second moments tr(J)/2 1 - J."""
    J, half = link.J, builder.number(0.5)
    trace = (J[0, 0] + J[1, 1] + J[2, 2]) * half
    second = [*(trace - J[k, k] for k in range(3)), *(-J[r, c] for r, c in ((0, 1), (0, 2), (1, 2)))]
    found = [link.m, *link.S, *second]
    assert len(found) == MOMENTS, "as the recursion reads it"
    return found
