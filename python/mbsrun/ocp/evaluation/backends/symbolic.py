"""Functions that CasADi evaluates and differentiates, from their serialisation: for both backends.

With k scalar arguments, f has the gradient f' (k,) and the Hessian f'' (k, k), dense, and their patterns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.ground.functions import Array

KEPT = 256  # functions that stay loaded


@dataclass(frozen=True)
class Differentiated:
    """A scalar function with its derivatives, over arrays."""

    function: ca.Function  # (k,) -> f, f', f''
    size: int
    gradient: NDArray[np.bool_]  # (k,): entries that may be nonzero
    hessian: NDArray[np.bool_]  # (k, k)

    def evaluate(self, arguments: Array) -> tuple[Array, Array, Array]:
        """Return f (places,), f' (places, k) and f'' (places, k, k) of arguments (places, k)."""
        f, g, H = (part.full() for part in self.function.map(len(arguments))(arguments.T))
        return f[0], g.T, H.T.reshape(-1, self.size, self.size)


@lru_cache(KEPT)
def load(code: str) -> ca.Function:
    """Make a function from its serialisation, which must be the project's own: files hold none."""
    return ca.Function.deserialize(code)


@lru_cache(KEPT)
def differentiate(code: str) -> Differentiated:
    """Differentiate a function."""
    function = load(code)
    k = function.n_in()
    x = ca.MX.sym("x", k)
    f = function.call(ca.vertsplit(x))[0]
    H, g = ca.hessian(f, x)
    patterns = [np.array(ca.DM(part.sparsity(), 1).full(), dtype=bool) for part in (g, H)]
    together = ca.Function("derivatives", [x], [f, ca.densify(g), ca.densify(H)])
    return Differentiated(together, k, patterns[0].ravel(), patterns[1])


def is_plain(code: str) -> bool:
    """Return whether a function consists of operations on numbers alone, with no table and no call."""
    return bool(load(code).is_a("SXFunction"))
