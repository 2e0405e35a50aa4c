"""Expressions of a problem evaluated along a motion: arrays of its parts -> an array of values for each expression.

The names are the ones of `quantities`; the program evaluates the same expressions by its backends, with derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Program, names, parse
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.given import list_texts, order_given, place_unknown
from mbsrun.ocp.problem.problem import Problem, list_names
from mbsrun.quantities import SENSED, lay_out, list_quantities, name_components
from mbsrun.recordings import references
from mbsrun.simulation.drive import ARRAYS

Array = NDArray[np.float64]
Parts = Mapping[str, Array]  # (B, size) by kind: t, T, q, qd, qdd, u, w, states, controls, unknowns


class Values:
    """Expressions of one problem, ready to be evaluated at many places at once."""

    def __init__(self, texts: Sequence[str], problem: Problem, plant: Plant) -> None:
        """Parse the expressions. Raises ExpressionError for one that cannot be read."""
        self._expressions = [parse(text) for text in texts]
        self._program = Program(self._expressions, ARRAYS)
        self._plant, self._problem = plant, problem
        named = frozenset[str]().union(*map(names, self._expressions))
        self._functions = [function for function in problem.functions if function.name in named]
        read = frozenset[str]().union(*(list_names(text, problem.functions) for text in texts))
        known = list_quantities(plant.manifest, problem.added)
        self._read = {name: known[name] for name in sorted(read) if name in known}
        self._references = sorted(read & references.list_names(problem.references).keys())

    @property
    def kinds(self) -> frozenset[str]:
        """Return the kinds of quantities that the expressions read."""
        return frozenset(quantity.kind for quantity in self._read.values())

    def __call__(self, parts: Parts) -> Array:
        """Return the values (B, expressions).

        Kinds that no expression reads may be left out. Where an expression has no value, the number is not finite.
        """
        found, B = dict(parts), len(parts["t"])
        for kind, sensed in SENSED.items():
            if kind in self.kinds:
                given: dict[str, Any] = {name: parts[name] for name in sensed.inputs}
                found[kind] = lay_out(self._plant(sensed.kernel, **given)[sensed.result])
        numbers = {name: found[quantity.kind][:, quantity.index] for name, quantity in self._read.items()}
        numbers |= {name: np.full(1, value) for name, value in self._problem.constants}
        t, T = parts["t"][:, 0], float(parts["T"][0, 0])
        for name in self._references:
            numbers[name] = references.evaluate(name, self._problem.references, t / T, T)
        for function in self._functions:
            arguments = [np.broadcast_to(numbers[name], B) for name in function.reads]
            from mbsrun.ocp.evaluation.backends.symbolic import load  # loads CasADi

            numbers[function.name] = load(function.code).map(B)(*arguments).full()[0]
        with np.errstate(all="ignore"):
            columns = [np.broadcast_to(column, B) for column in self._program.evaluate(numbers)]
        return np.stack(columns, axis=1) if columns else np.zeros((B, 0))


class GivenValues:
    """The inputs and components of wrenches that expressions of a problem give."""

    def __init__(self, problem: Problem, plant: Plant) -> None:
        """Put them in order."""
        self._levels, _ = order_given(problem, plant.manifest)
        self._values = [Values(texts, problem, plant) for texts in list_texts(self._levels)]
        self._w = np.zeros(len(name_components(plant.manifest)))
        for i, value in place_unknown(problem, plant.manifest).items():
            self._w[i] = value

    @property
    def is_empty(self) -> bool:
        """Return whether no expression gives an input."""
        return not self._levels

    @property
    def kinds(self) -> frozenset[str]:
        """Return the kinds of quantities that the expressions read."""
        return frozenset[str]().union(*(values.kinds for values in self._values))

    def __call__(self, parts: Parts) -> dict[str, Array]:
        """Return the parts with given components put into u and w; unknown components keep w, or their guess."""
        found, B = dict(parts), len(parts["t"])
        found["u"] = parts["u"].copy()
        found["w"] = parts["w"].copy() if "w" in parts else np.tile(self._w, (B, 1))
        for level, values in zip(self._levels, self._values, strict=True):
            numbers = values(found)
            for part, column in zip(level, numbers.T, strict=True):
                found[part.kind][:, part.index] = column
        return found
