"""The equations of loops in numbers: h, its Jacobians by q and by qd, and cosines between axes, at the model's values.

Tapes are interpreted in double precision. A pose at which an expression has no value has residuals of NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.formulations import closure, ports
from mbsgen.formulations.catalogue import project
from mbsgen.formulations.reductions import ALL
from mbsgen.model.tree import Kind, Tree
from mbsgen.tape import forward
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape

Array = NDArray[np.float64]


class Mechanism:
    """The loops of a tree, with all equations that they have."""

    def __init__(self, tree: Tree, parameters: Sequence[float] | None = None) -> None:
        """Take a tree, and values of its parameters except constants, in its order; None: the model's values."""
        whole = replace(tree, closure=None)
        self.tree = tree
        self.equations = closure.list_equations(tree)
        self._h = _build(closure.build, whole)
        self._slopes = forward.jacobian(self._h, [ports.COORDINATES.name])
        self._jacobian = _build(closure.build_jacobian, whole)
        self._senses = _build(closure.build_senses, whole)
        own = [p for p in tree.parameters if p.kind is not Kind.CONSTANT]
        values = [p.value for p in own] if parameters is None else parameters
        self._given: dict[str, list[float]] = {
            port.name: [x for p, x in zip(own, values, strict=True) if p.kind is kind]
            for port, kind in ((ports.PARAMETERS, Kind.RUNTIME), (ports.DESIGN, Kind.DIFFERENTIATED))
        }
        self.n = len(tree.joints)
        self.senses_of = closure.list_senses(tree)  # of each cosine, the number of its loop

    @property
    def operations(self) -> int:
        """Count the operations of h and dh/dq."""
        return len(self._h.operations) + len(self._slopes.operations)

    def h(self, q: Array) -> Array:
        """Return what is left open, shape (all equations,)."""
        return np.array(self._evaluate(self._h, q)[ports.CLOSURE.name], float)

    def slopes(self, q: Array) -> Array:
        """Return dh/dq, shape (all equations, entries of q)."""
        return self._spread(self._slopes, q)

    def J(self, q: Array) -> Array:
        """Return J, shape (all equations, n)."""
        return self._spread(self._jacobian, q)

    def senses(self, q: Array) -> Array:
        """Return cosines that are positive where axes point the same way, see `closure.build_senses`."""
        return np.array(self._evaluate(self._senses, q)["senses"], float)

    def _spread(self, tape: Tape, q: Array) -> Array:
        found, output = self._evaluate(tape, q), tape.outputs[0]
        full = np.zeros((output.sparsity.rows, output.sparsity.cols))
        for (r, c), value in zip(output.sparsity.entries, found[output.name], strict=True):
            full[r, c] = value
        return full

    def _evaluate(self, tape: Tape, q: Array) -> dict[str, list[float]]:
        given = {**self._given, ports.COORDINATES.name: [float(x) for x in q]}
        arguments = {i.name: given.get(i.name, [0.0] * i.sparsity.nnz) for i in tape.inputs}
        try:
            return evaluate(tape, arguments)
        except (ValueError, OverflowError, ZeroDivisionError):
            return {o.name: [float("nan")] * len(o.values) for o in tape.outputs}


def _build(write: closure.Write, tree: Tree) -> Tape:
    return project(lambda own, _: write(own))(tree, ALL)
