"""Functions with bounds of their rounding errors, made from straight-line functions: see `tape.rounding`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from mbsgen.model.reader import ModelWarning
from mbsgen.tape.rounding import add_bounds
from mbsgen.targets.contract import Family


def add_bounded(families: Sequence[Family]) -> tuple[Family, ...]:
    """Write each function and derivative once more, with a bound beside every result.

    Python's warnings name functions that iterate or are computed in stages, which have no bounds.
    """
    others = [f.name for family in families for f in family.functions if f not in family.tapes]
    if others:
        finding = f"bounds: {', '.join(others)} have none, since they are no straight-line programs"
        warnings.warn(finding, ModelWarning, stacklevel=2)
    return tuple(
        Family(add_bounds(tape), title=f"{tape.name}, with bounds of the rounding errors")
        for family in families
        for tape in family.tapes
    )
