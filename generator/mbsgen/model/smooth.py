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


SMOOTH: tuple[type[sp.Function], ...] = (softplus, step)
READ = {"softplus": softplus, "step": step, "max": sp.Max, "min": sp.Min}  # by their names in expressions


def print_source(function: type[sp.Function]) -> str:
    """Return the definition of a function as Python, for modules with `import sympy as sp`."""
    text = re.sub(r"  #.*", "", inspect.getsource(function)).rstrip()
    text = re.sub(r": [\w.]+( = )?(?=.*\) ->)", lambda found: "=" if found[1] else "", text)
    return re.sub(r" -> [\w.]+", "", text)
