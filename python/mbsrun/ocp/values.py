"""Expressions of a problem evaluated along a motion: arrays of its parts -> an array of values for each expression.

The names are the ones of `quantities`; the program evaluates the same expressions by its backends, with derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import evaluate, names, parse
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem
from mbsrun.quantities import list_quantities
from mbsrun.simulation.drive import ARRAYS

Array = NDArray[np.float64]


class Values:
    """Expressions of one problem, ready to be evaluated at many places at once."""

    def __init__(self, texts: Sequence[str], problem: Problem, plant: Plant) -> None:
        """Parse the expressions. Raises ExpressionError for one that cannot be read."""
        self._expressions = [parse(text) for text in texts]
        self._plant, self._constants = plant, dict(problem.constants)
        read = frozenset().union(*map(names, self._expressions)) - set(self._constants)
        known = list_quantities(plant.manifest, problem.added)
        self._read = {name: known[name] for name in sorted(read)}

    @property
    def kinds(self) -> frozenset[str]:
        """Return the kinds of quantities that the expressions read."""
        return frozenset(quantity.kind for quantity in self._read.values())

    def __call__(self, parts: Mapping[str, Array]) -> Array:
        """Return the values (B, expressions); parts are (B, size) by kind: t, T, q, qd, qdd, u, w, states, controls.

        Kinds that no expression reads may be left out. Where an expression has no value, the number is not finite.
        """
        found, B = dict(parts), len(parts["t"])
        for kind, kernel, inputs in (("position", "sensors", ("q",)), ("v", "motion", ("q", "qd"))):
            if kind in self.kinds:
                given: dict[str, Any] = {name: parts[name] for name in inputs}
                vectors = self._plant(kernel, **given)[kind]
                found[kind] = vectors.swapaxes(1, 2).reshape(B, -1)
        numbers = {name: found[quantity.kind][:, quantity.index] for name, quantity in self._read.items()}
        constants = {name: np.full(1, value) for name, value in self._constants.items()}
        with np.errstate(all="ignore"):
            columns = [
                np.broadcast_to(evaluate(expression, {**constants, **numbers}, ARRAYS), B)
                for expression in self._expressions
            ]
        return np.stack(columns, axis=1) if columns else np.zeros((B, 0))
