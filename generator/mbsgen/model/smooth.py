"""Smooth functions that stay functions, for equations to be read: SymPy's own expressions would fill lines.

Code is generated of the definitions in `expressions`. These classes know their definition, value and derivatives.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

import sympy as sp


class softplus(sp.Function):  # type: ignore[misc]  # SymPy has no types  # noqa: N801
    """The function w log(1 + exp(x/w)), a smooth max(x, 0) of width w."""

    def doit(self, **hints: Any) -> sp.Expr:
        """Write the definition out, so that nothing overflows."""
        x, w = (argument.doit(**hints) for argument in self.args)
        return sp.Max(x, 0) + w * sp.log(1 + sp.exp(-sp.Abs(x) / w))

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Differentiate by x or w."""
        x, w = self.args
        return step(x, w) if argindex == 1 else (softplus(x, w) - x * step(x, w)) / w

    def _eval_evalf(self, prec: int) -> sp.Expr:
        return sp.N(self.doit(), sp.core.evalf.prec_to_dps(prec))


class step(sp.Function):  # type: ignore[misc]  # SymPy has no types  # noqa: N801
    """The function 1/(1 + exp(-x/w)), a smooth step from 0 to 1 of width w."""

    def doit(self, **hints: Any) -> sp.Expr:
        """Write the definition out, so that nothing overflows."""
        x, w = (argument.doit(**hints) for argument in self.args)
        return (1 + sp.tanh(x / (2 * w))) / 2

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Differentiate by x or w."""
        x, w = self.args
        slope = step(x, w) * (1 - step(x, w)) / w
        return slope if argindex == 1 else -x / w * slope

    def _eval_evalf(self, prec: int) -> sp.Expr:
        return sp.N(self.doit(), sp.core.evalf.prec_to_dps(prec))


class bezier(sp.Function):  # type: ignore[misc]  # SymPy has no types  # noqa: N801
    """The value at x of a quintic Bezier curve from (x0, y0) to (x1, y1), tangents meeting at (xc, yc), curviness c."""

    def _eval_evalf(self, prec: int) -> sp.Expr:
        if not all(argument.is_number for argument in self.args):
            return self
        x, x0, y0, xc, yc, x1, y1, c = (sp.N(argument, sp.core.evalf.prec_to_dps(prec)) for argument in self.args)
        weights = [sp.binomial(5, k) for k in range(6)]
        points = [(x0, y0), *2 * [(x0 + c * (xc - x0), y0 + c * (yc - y0))]]
        points += [*2 * [(x1 + c * (xc - x1), y1 + c * (yc - y1))], (x1, y1)]
        low, high = sp.Integer(0), sp.Integer(1)
        for _ in range(prec + 4):
            u = (low + high) / 2
            terms = [w * u**k * (1 - u) ** (5 - k) for k, w in enumerate(weights)]
            place, value = (sum(w * point[i] for w, point in zip(terms, points, strict=True)) for i in (0, 1))
            low, high = (u, high) if place < x else (low, u)
        return sp.N(value, sp.core.evalf.prec_to_dps(prec))


SMOOTH: tuple[type[sp.Function], ...] = (softplus, step, bezier)
READ = {"softplus": softplus, "step": step, "max": sp.Max, "min": sp.Min}  # by their names in expressions


def print_source(function: type[sp.Function]) -> str:
    """Return the definition of a function as Python, for modules with `import sympy as sp`."""
    text = re.sub(r"  #.*", "", inspect.getsource(function)).rstrip()
    text = re.sub(r": [\w.]+( = )?(?=.*\) ->)", lambda found: "=" if found[1] else "", text)
    return re.sub(r" -> [\w.]+", "", text)
