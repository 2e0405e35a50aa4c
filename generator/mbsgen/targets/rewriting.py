"""Functions written once more in another way, made from straight-line functions."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

from mbsgen.model.reader import ModelWarning
from mbsgen.procedure.procedure import Computation
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family

GIVEN = "given_"  # before the name of an input that a result has, too


def rewrite(families: Sequence[Family], what: str, change: Callable[[Tape], Computation]) -> tuple[Family, ...]:
    """Write each function and derivative once more, by `change`; `what` says for readers how they differ.

    Python's warnings name functions that iterate or are computed in stages, which are left out.
    """
    others = [f.name for family in families for f in family.functions if f not in family.tapes]
    if others:
        end = "is left out, as it is" if len(others) == 1 else "are left out, as they are"
        warnings.warn(f"{what}: {', '.join(others)} {end} no straight-line program", ModelWarning, stacklevel=3)
    tapes = [tape for family in families for tape in family.tapes]
    return tuple(Family(change(_separate(tape)), title=f"{tape.name}, {what}") for tape in tapes)


def _separate(tape: Tape) -> Tape:
    """Name inputs anew that have the name of a result, as the run-time parameters p of `frames` do.

    Elsewhere a setup reads these parameters; here each function reads them itself.
    """
    taken = {output.name for output in tape.outputs}
    inputs = tuple(
        replace(i, port=replace(i.port, name=f"{GIVEN}{i.name}")) if i.name in taken else i for i in tape.inputs
    )
    return replace(tape, inputs=inputs)
