"""Equations of motion in 50 digits, by the textbook's recursion: the reference for generated kernels.

The recursion has no reduction, and its numbers are the model's, before any of them is folded. So an error against it
includes everything that a kernel loses: by its form, by its coefficients, and by arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbsgen.formulations import ports
from mbsgen.formulations.coupling import couple
from mbsgen.formulations.links import declare_state, joint_forces, write_chain
from mbsgen.formulations.textbook import residual
from mbsgen.model.reader import read_model
from mbsgen.model.reduction import build_tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DIGITS, evaluate


class Oracle:
    """The equations of motion of a model file: Phi(q, qd, qdd) = Q(q, qd, u)."""

    def __init__(self, model: Path) -> None:
        """Read a model file. Raises InputError with every fault in it."""
        tree, builder = build_tree(read_model(model)), Builder()
        state = declare_state(tree.uncoupled, builder)
        chain = write_chain(tree.uncoupled, builder, state)
        Phi = residual(chain, state.qd, chain.accelerate(state.qdd))
        for port, column in ((ports.RESIDUAL, Phi), (ports.JOINT_FORCES, joint_forces(chain))):
            builder.output_dense(port, [[entry] for entry in column])
        self._tape = couple(builder.build("equations"), tree)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs: q, qd, qdd, u, and w, theta and p where the model has them."""
        return tuple(i.name for i in self._tape.inputs)

    def evaluate(self, arguments: Mapping[str, Sequence[Any]]) -> dict[str, list[Any]]:
        """Compute Phi and Q, (n,) each, N m or N, of numbers that mpmath can take in exactly."""
        given = {name: [DIGITS.literal(x) for x in arguments[name]] for name in self.inputs}
        return evaluate(self._tape, given, DIGITS)
