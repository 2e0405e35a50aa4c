"""Slopes: how far the Jacobians of the reduced functions are from the whole tree's.

A block is the derivative of one result by one input. The error of an entry is its largest difference at the compared
states, divided by the largest entry that its row of the block has there; a row of zeros errs by nothing or infinitely.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbsgen.approximation.effects import Comparison, Results
from mbsgen.derivatives.kernels import differentiable
from mbsgen.tape.forward import jacobian
from mbsgen.tape.types import Tape

ROUNDING = 1e-12  # relative to a block's largest entry: smaller differences are ignored


def measure(comparison: Comparison, whole: Mapping[str, Tape], reduced: Mapping[str, Tape]) -> dict[str, float]:
    """Return the error of the Jacobian of each function that has inputs to differentiate by."""
    return {
        name: _differ(*(comparison.evaluate(name, jacobian(x[name], wrt)) for x in (whole, reduced)))
        for name in whole
        if name in comparison.compared and (wrt := differentiable(whole[name]))
    }


def _differ(whole: Results, reduced: Results) -> float:
    worst = 0.0
    for block, expected in whole.items():
        off = np.abs(reduced[block] - expected).max(axis=(0, 1), initial=0.0)
        largest = np.abs(expected).max(axis=(0, 1, 3), initial=0.0)[:, None]
        off[off <= ROUNDING * largest.max(initial=0.0)] = 0.0
        with np.errstate(all="ignore"):
            ratio = np.where(off == 0.0, 0.0, off / largest)
        worst = max(worst, float(np.where(np.isnan(ratio), np.inf, ratio).max(initial=0.0)))
    return worst
