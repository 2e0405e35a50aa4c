"""Formulas of variables alone with exact derivatives: Formula -> patterns, and C in CasADi's contract.

The engine's own passes differentiate (see `mbsgen.formulas`). Arguments of the C function are the formula's inputs, its
parameters and data, and for the Hessian weights of the values; its one result holds nonzeros, column by column.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbsgen.expressions import Expression
from mbsgen.manifest import Flops
from mbsgen.roles import Order
from mbsrun.ocp.evaluation.stages.tables import Derivative, Nonzeros
from mbsrun.ocp.ground.functions import Formula

ORDERS: Mapping[Derivative, Order] = {
    Derivative.VALUE: Order.VALUE,
    Derivative.JACOBIAN: Order.JACOBIAN,
    Derivative.HESSIAN: Order.ADJOINT_JACOBIAN,
}


def patterns(formula: Formula) -> tuple[Nonzeros, Nonzeros]:
    """Return the nonzeros of the Jacobian, and of the lower triangle of the Hessian, by all inputs stacked.

    Raises ExpressionError for an expression that has no value whatever the variables are.
    """
    return _find_pattern(formula, Derivative.JACOBIAN), _find_pattern(formula, Derivative.HESSIAN)


def write(formula: Formula, name: str, derivative: Derivative) -> str:
    """Write the C file of a formula or a derivative of it, as the function `name`; equal formulas give equal text.

    Raises ExpressionError for an expression that has no value, or a number beyond the range of a double.
    """
    from mbsgen import formulas as engine

    return engine.write(engine.Formula(*_translate(formula)), name, ORDERS[derivative])


def count_flops(formula: Formula, derivative: Derivative) -> Flops:
    """Count the operations of one call."""
    from mbsgen import formulas as engine

    return engine.count_flops(engine.Formula(*_translate(formula)), ORDERS[derivative])


def _find_pattern(formula: Formula, derivative: Derivative) -> Nonzeros:
    from mbsgen import formulas as engine

    pattern = engine.find_pattern(engine.Formula(*_translate(formula)), ORDERS[derivative])
    entries = np.array(pattern.entries, dtype=np.int64).reshape(-1, 2)
    return Nonzeros((pattern.rows, pattern.cols), entries[:, 0], entries[:, 1])


def _translate(formula: Formula) -> tuple[tuple[Expression, ...], dict[str, tuple[int, int]], tuple[int, ...], int]:
    """Number the vectors of a formula: return the fields of the engine's."""
    assert not formula.calls, "a method that writes C takes no problem with expressions of CasADi"
    assert not formula.computed, "kernels give results to variables, not to formulas"
    place = {part.kind: k for k, part in enumerate(formula.arguments)}
    names = {name: (place[kind], entry) for name, (kind, entry) in formula.names.items()}
    return formula.expressions, names, tuple(part.size for part in formula.arguments), len(formula.inputs)
