"""Functions in double-double arithmetic, made from straight-line functions: see `procedure.double_double`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from mbsgen.model.reader import ModelWarning
from mbsgen.procedure.double_double import DoubleDouble
from mbsgen.procedure.procedure import Procedure
from mbsgen.roles import name_precise
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family


def add_double_double(families: Sequence[Family]) -> tuple[Family, ...]:
    """Write each function and derivative once more, in double-double arithmetic.

    Python's warnings name functions that iterate or are computed in stages, which are left out.
    """
    others = [f.name for family in families for f in family.functions if f not in family.tapes]
    if others:
        end = "is left out, as it is" if len(others) == 1 else "are left out, as they are"
        finding = f"double-double: {', '.join(others)} {end} no straight-line program"
        warnings.warn(finding, ModelWarning, stacklevel=2)
    return tuple(
        Family(_convert(tape), title=f"{tape.name}, in double-double arithmetic")
        for family in families
        for tape in family.tapes
    )


def _convert(tape: Tape) -> Procedure:
    stage = DoubleDouble(tape)
    return Procedure(Function(name_precise(tape.name)), stage.reads, (stage,), stage.gives)
