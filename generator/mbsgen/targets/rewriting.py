"""Functions written once more in another way, made from straight-line functions."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

from mbsgen.model.reader import ModelWarning
from mbsgen.procedure.procedure import Computation
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family


def rewrite(families: Sequence[Family], what: str, change: Callable[[Tape], Computation]) -> tuple[Family, ...]:
    """Write each function and derivative once more, by `change`; `what` says for readers how they differ.

    Python's warnings name functions that iterate or are computed in stages, which are left out.
    """
    others = [f.name for family in families for f in family.functions if f not in family.tapes]
    if others:
        end = "is left out, as it is" if len(others) == 1 else "are left out, as they are"
        warnings.warn(f"{what}: {', '.join(others)} {end} no straight-line program", ModelWarning, stacklevel=3)
    return tuple(Family(change(tape), title=f"{tape.name}, {what}") for family in families for tape in family.tapes)
