"""Functions in double-double arithmetic, made from straight-line functions: see `procedure.double_double`."""

from __future__ import annotations

from collections.abc import Sequence

from mbsgen.procedure.double_double import DoubleDouble
from mbsgen.procedure.procedure import Procedure
from mbsgen.roles import name_precise
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.rewriting import rewrite


def add_double_double(families: Sequence[Family]) -> tuple[Family, ...]:
    """Write each function and derivative once more, in double-double arithmetic; warns as `rewrite` does."""
    return rewrite(families, "in double-double arithmetic", _convert)


def _convert(tape: Tape) -> Procedure:
    stage = DoubleDouble(tape)
    return Procedure(Function(name_precise(tape.name)), stage.reads, (stage,), stage.gives)
