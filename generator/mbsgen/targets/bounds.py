"""Functions with bounds of their rounding errors, made from straight-line functions: see `tape.rounding`."""

from __future__ import annotations

from collections.abc import Sequence

from mbsgen.tape.rounding import add_bounds
from mbsgen.targets.contract import Family
from mbsgen.targets.rewriting import rewrite


def add_bounded(families: Sequence[Family]) -> tuple[Family, ...]:
    """Write each function and derivative once more, with a bound beside every result; warns as `rewrite` does."""
    return rewrite(families, "with bounds of the rounding errors", add_bounds)
