"""Equations of motion in 50 digits, by the textbook's recursion: the reference for generated kernels.

    Phi(q, qd, qdd) - J^T lam - D tau = Q,    J qdd + gamma = 0,    D^T qdd = a

The recursion has no reduction, and its numbers are the model's, before any of them is folded. So an error against it
includes everything that a kernel loses: by its form, by its coefficients, and by arithmetic. J and gamma of closed
loops are derivatives of the generator's h(q), which is compared with the poses of bodies wherever code is generated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbsgen.assembly import assemble
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.chain import joint_forces, write_chain
from mbsgen.formulations.coupling import couple
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.states import declare_state
from mbsgen.formulations.textbook import residual
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.procedure.procedure import straight
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape

Numbers = list[Any]


class Oracle:
    """The equations of motion of a model file."""

    driven: tuple[int, ...]  # entries of qd whose motion is given
    independent: tuple[int, ...]  # entries of qd that determine the others; all of them without loops

    def __init__(self, model: Path) -> None:
        """Read a model file. Raises InputError with every fault in it, AssemblyError for loops that do not close."""
        tree = assemble(build_tree(read_model(model)))
        joints = tree.joints
        self.driven = tuple(joints.index(tree.bodies[number - 1].joint) for number in tree.driven)
        self.independent = tree.closure.independent if tree.closure else tuple(range(len(joints)))
        self._tape = _write_motion(tree)
        has_loops = bool(tree.loops or tree.constraints)
        self._loops = straight(FUNCTIONS["loop_jacobian"].build(tree, ALL)) if has_loops else None

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs: q, qd, qdd, u, and w, theta and p where the model has them."""
        return tuple(i.name for i in self._tape.inputs)

    def evaluate(self, arguments: Mapping[str, Sequence[Any]]) -> dict[str, Numbers]:
        """Compute Phi and Q, (n,) each, N m or N, of numbers that mpmath can take in exactly."""
        return _evaluate(self._tape, arguments)

    def close(self, arguments: Mapping[str, Sequence[Any]]) -> tuple[list[Numbers], Numbers]:
        """Compute J, (m, n) by rows, and gamma, (m,), likewise; neither has a row without loops."""
        if self._loops is None:
            return [], []
        found, pattern = _evaluate(self._loops, arguments), self._loops.output(ports.CLOSURE_JACOBIAN.name).sparsity
        J = [[DIGITS.literal(0)] * pattern.cols for _ in range(pattern.rows)]
        for (r, c), value in zip(pattern.entries, found[ports.CLOSURE_JACOBIAN.name], strict=True):
            J[r][c] = value
        return J, found[ports.CLOSURE_BIAS.name]


def _write_motion(tree: Tree) -> Tape:
    """Write Phi and Q."""
    builder = Builder()
    state = declare_state(tree.uncoupled, builder)
    chain = write_chain(tree.uncoupled, builder, state)
    Phi = residual(chain, state.qd, chain.accelerate(state.qdd))
    for port, column in ((ports.RESIDUAL, Phi), (ports.JOINT_FORCES, joint_forces(chain))):
        builder.output_dense(port, [[entry] for entry in column])
    return couple(builder.build("equations"), tree)


def _evaluate(tape: Tape, arguments: Mapping[str, Sequence[Any]]) -> dict[str, Numbers]:
    given = {i.name: [DIGITS.literal(x) for x in arguments[i.name]] for i in tape.inputs}
    return evaluate(tape, given, DIGITS)
