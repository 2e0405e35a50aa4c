"""Functions of CasADi's numbers, evaluated in intervals: a function's instructions, one by one, over Arb's balls."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
from flint import arb


def _raise(x: Any, y: Any) -> Any:
    """Return a power; a whole one is a product, since the power of a ball around 0 is no number in Arb."""
    if not (y.is_exact() and y.is_integer()):
        return x**y
    whole = int(y.unique_fmpz())
    product = math.prod([x] * abs(whole), start=arb(1))
    return product if whole >= 0 else 1 / product


_UNARY: Mapping[int, Callable[[Any], Any]] = {
    ca.OP_NEG: lambda x: -x,
    ca.OP_SQ: lambda x: x * x,
    ca.OP_TWICE: lambda x: 2 * x,
    ca.OP_INV: lambda x: 1 / x,
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_SQRT: lambda x: x.sqrt(),
    ca.OP_SIN: lambda x: x.sin(),
    ca.OP_COS: lambda x: x.cos(),
    ca.OP_TAN: lambda x: x.tan(),
    ca.OP_ASIN: lambda x: x.asin(),
    ca.OP_ACOS: lambda x: x.acos(),
    ca.OP_ATAN: lambda x: x.atan(),
    ca.OP_EXP: lambda x: x.exp(),
    ca.OP_LOG: lambda x: x.log(),
    ca.OP_TANH: lambda x: x.tanh(),
    ca.OP_SINH: lambda x: x.sinh(),
    ca.OP_COSH: lambda x: x.cosh(),
    ca.OP_LOG1P: lambda x: x.log1p(),
    ca.OP_EXPM1: lambda x: x.expm1(),
}
_BINARY: Mapping[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: lambda x, y: x + y,
    ca.OP_SUB: lambda x, y: x - y,
    ca.OP_MUL: lambda x, y: x * y,
    ca.OP_DIV: lambda x, y: x / y,
    ca.OP_POW: lambda x, y: _raise(x, y),
    ca.OP_CONSTPOW: lambda x, y: _raise(x, y),
    ca.OP_ATAN2: lambda x, y: arb.atan2(x, y),
}


class UnknownOperationError(Exception):
    """An operation that has no interval here, such as one with a kink."""


@dataclass(frozen=True)
class Instructions:
    """A function of CasADi's SX, taken apart once."""

    steps: tuple[tuple[Any, ...], ...]  # what, from where, to where
    room: int
    sizes: tuple[int, ...]  # numbers of each result

    @classmethod
    def of(cls, function: ca.Function) -> Instructions:
        """Take a function apart. Raises UnknownOperationError."""
        steps: list[tuple[Any, ...]] = []
        for k in range(function.n_instructions()):
            code, source, target = (
                function.instruction_id(k),
                function.instruction_input(k),
                function.instruction_output(k),
            )
            if code == ca.OP_INPUT:
                steps.append(("in", *source, target[0]))
            elif code == ca.OP_OUTPUT:
                steps.append(("out", source[0], *target))
            elif code == ca.OP_CONST:
                steps.append(("number", function.instruction_constant(k), target[0]))
            elif code in _UNARY:
                steps.append(("one", _UNARY[code], source[0], target[0]))
            elif code in _BINARY:
                steps.append(("two", _BINARY[code], source[0], source[1], target[0]))
            else:
                raise UnknownOperationError(f"operation {code} of CasADi")
        sizes = tuple(function.nnz_out(i) for i in range(function.n_out()))
        return cls(tuple(steps), function.sz_w(), sizes)

    def evaluate(self, arguments: Sequence[Sequence[Any]]) -> list[list[Any]]:
        """Return the nonzeros of each result for balls."""
        zero = arb(0)
        work: list[Any] = [zero] * self.room
        results = [[zero] * size for size in self.sizes]
        for step in self.steps:
            match step[0]:
                case "two":
                    work[step[4]] = step[1](work[step[2]], work[step[3]])
                case "one":
                    work[step[3]] = step[1](work[step[2]])
                case "number":
                    work[step[2]] = arb(step[1])
                case "in":
                    work[step[3]] = arguments[step[1]][step[2]]
                case "out":
                    results[step[2]][step[3]] = work[step[1]]
        return results
