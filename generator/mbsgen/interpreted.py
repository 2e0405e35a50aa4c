"""A formulation of a model file in double precision, without a compiler: for mechanisms too large for straight C.

The equations are the same as in generated kernels, except for common factors, which take long to find in large ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sympy import Integer

from mbsgen.assembly import assemble
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.procedure.procedure import straight
from mbsgen.tape.interpreter import evaluate, find_failure

Array = NDArray[np.float64]

ONE_PLAN = Reductions(trials=1, factor=False)
_NOWHERE = (Integer(0), Integer(0), Integer(0))


class Interpreted:
    """A function of a model file, with its gravity or without."""

    def __init__(self, model: Path, name: str, *, gravity: bool = True) -> None:
        """Write the equations. Raises InputError with every fault in the model."""
        tree = assemble(build_tree(read_model(model)))
        self._tape = straight(FUNCTIONS[name].build(tree if gravity else replace(tree, gravity=_NOWHERE), ONE_PLAN))

    def compute(self, states: Mapping[str, Array]) -> dict[str, Array]:
        """Compute all results, (K, size) by name, for inputs (K, size) by name. Guards are not tested."""
        given = {i.name: list(states[i.name].T) for i in self._tape.inputs}
        count = len(next(iter(states.values())))
        found = evaluate(self._tape, given)
        return {name: np.array([np.broadcast_to(x, count) for x in values]).T for name, values in found.items()}

    def find_status(self, state: Mapping[str, Array]) -> int:
        """Return the joint at which the kernel fails for inputs (size,) by name, or 0."""
        return find_failure(self._tape, {i.name: state[i.name].tolist() for i in self._tape.inputs})
