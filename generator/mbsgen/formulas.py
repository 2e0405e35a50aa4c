"""Expressions as one function with exact derivatives: Formula -> tapes -> C in CasADi's contract.

With the differentiated arguments stacked into one vector a, y = F(a) and weights w,

    value              y                                  evaluation in a tape's builder
    jacobian           dy/da                              forward, equation by equation
    adjoint_jacobian   lower triangle of d2(w . y)/da2    forward over reverse

Griewank, Walther, "Evaluating derivatives", SIAM 2008, chapters 3 and 5. The derivative of |x| is the sign of x, and 0
at 0; of max(x, y) the larger one is differentiated. Results are the structural nonzeros, column by column. A
function returns 1 where a result is not finite.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from mbsgen.errors import TapeError
from mbsgen.expressions import Algebra, Expression, ExpressionError, evaluate
from mbsgen.expressions import write as write_expression
from mbsgen.manifest import Flops
from mbsgen.procedure.procedure import as_procedure
from mbsgen.roles import Order
from mbsgen.tape import reverse
from mbsgen.tape.arithmetic import make_algebra
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count
from mbsgen.tape.forward import propagate
from mbsgen.tape.replay import declare_inputs, replay
from mbsgen.tape.types import Sparsity, Tape
from mbsgen.targets.c.stages import write_stages
from mbsgen.targets.layout import lay_out

_TITLES = {
    Order.VALUE: "values of expressions",
    Order.JACOBIAN: "first derivatives of expressions",
    Order.ADJOINT_JACOBIAN: "second derivatives of a weighted sum of expressions, lower triangle",
}


@dataclass(frozen=True)
class Formula:
    """Expressions of the entries of some vectors, of which the first few are differentiated by."""

    expressions: tuple[Expression, ...]
    names: Mapping[str, tuple[int, int]]  # the vector and the entry that a name means
    sizes: tuple[int, ...]  # of the vectors
    differentiated: int

    @property
    def variables(self) -> int:
        """Count the entries that the formula is differentiated by."""
        return sum(self.sizes[: self.differentiated])


def build(formula: Formula, order: Order) -> Tape:
    """Return the tape of a formula or of a derivative of it: inputs a0, a1, ..., for the Hessian adj_y; one result.

    Raises ExpressionError for an expression that has no value whatever the variables are.
    """
    value = _build_value(formula)
    match order:
        case Order.VALUE:
            return value
        case Order.JACOBIAN:
            return _build_jacobian(value, formula)
    assert order is Order.ADJOINT_JACOBIAN, f"formulas have no {order.value}"
    return _build_hessian(value, formula)


def find_pattern(formula: Formula, order: Order) -> Sparsity:
    """Return the nonzeros of the result."""
    (output,) = build(formula, order).outputs
    return output.sparsity


def count_flops(formula: Formula, order: Order) -> Flops:
    """Count the operations of one call."""
    return count(build(formula, order)).flops


@dataclass(frozen=True)
class _Array:
    """An argument of the C function: its name, its place in `arg` or `res`, and its size."""

    name: str
    place: int
    size: int


def write(formula: Formula, name: str, order: Order) -> str:
    """Write the C file of a formula or a derivative of it, as the function `name`; equal formulas give equal text.

    Arguments are the vectors, and for the Hessian weights; there is one result. Raises ExpressionError for an
    expression that has no value, or a number beyond the range of a double.
    """
    assert re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII), f"{name!r} is no name of C"
    tape = build(formula, order)
    inputs = [_Array(i.name, place, i.sparsity.nnz) for place, i in enumerate(tape.inputs)]
    (output,) = tape.outputs
    try:
        stages = write_stages(as_procedure(tape))
    except TapeError as error:
        raise ExpressionError(f"an expression contains {error}", "give numbers that a double can hold") from None
    return lay_out(
        "c/formula.c",
        name=name,
        title=_TITLES[order],
        flops=count(tape).flops,
        stages=stages,
        inputs=[array for array in inputs if array.size],
        result=_Array(output.name, 0, output.sparsity.nnz),
        zeros=max((1, *(array.size for array in inputs))),
        unwanted=max(1, output.sparsity.nnz),
    )


# --- tapes ---------------------------------------------------------------------------------------------------------


def _build_value(formula: Formula) -> Tape:
    builder = Builder()
    vectors = [builder.vector(f"a{place}", size) for place, size in enumerate(formula.sizes)]
    names = {name: vectors[place][entry] for name, (place, entry) in formula.names.items()}
    algebra = make_algebra(builder)
    values = [_lower(expression, names, algebra) for expression in formula.expressions]
    builder.output("y", Sparsity.dense(len(values)), values)
    return builder.build("formula")


def _build_jacobian(value: Tape, formula: Formula) -> Tape:
    builder = Builder()
    values = replay(value, builder, declare_inputs(value, builder))
    gradients = propagate(value, builder, values, _list_inputs(formula))
    (result,) = value.outputs
    entries = {(row, col): slope for row, v in enumerate(result.values) for col, slope in gradients[v].items()}
    builder.output_nonzeros("J", len(result.values), formula.variables, entries)
    return builder.build(value.function.to(Order.JACOBIAN))


def _build_hessian(value: Tape, formula: Formula) -> Tape:
    inputs = _list_inputs(formula)
    gradient = reverse.adjoint(value, inputs)
    builder = Builder()
    values = replay(gradient, builder, declare_inputs(gradient, builder))
    slopes = propagate(gradient, builder, values, inputs)
    rows = [v for output in gradient.outputs for v in output.values]
    entries = {(row, col): slope for row, v in enumerate(rows) for col, slope in slopes[v].items() if col <= row}
    builder.output_nonzeros("H", formula.variables, formula.variables, entries)
    return builder.build(value.function.to(Order.ADJOINT_JACOBIAN))


def _list_inputs(formula: Formula) -> list[str]:
    """Name the inputs of the tape by which a formula is differentiated: they are the first."""
    return [f"a{place}" for place in range(formula.differentiated)]


# --- expressions ---------------------------------------------------------------------------------------------------


def _lower(expression: Expression, names: Mapping[str, Scalar], algebra: Algebra[Scalar]) -> Scalar:
    try:
        return evaluate(expression, names, algebra)
    except TapeError as error:
        finding = f"{write_expression(expression)} has no value: {error}"
        raise ExpressionError(finding, "keep to what its functions are defined for") from None
