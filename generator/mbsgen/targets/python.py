"""Python source of a model's kernels: the same equations over any number type; under CasADi's SX, the fair peer."""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass

from mbsgen.manifest import Flops
from mbsgen.tape.counts import count
from mbsgen.tape.types import FUNCTIONS, Op, Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.layout import lay_out
from mbsgen.targets.statements import Result, Syntax, write_body, write_lines
from mbsgen.targets.unit import Unit

PYTHON = Syntax(
    "{}",
    {op: f"functions.{op.value[0]}" for op in FUNCTIONS} | {Op.SIGN: "_sign(functions)", Op.ABS: "abs"},
    re.compile("|".join((*keyword.kwlist, "functions", "math", "abs"))),
)


@dataclass(frozen=True)
class _View:
    """A kernel, ready to be laid out."""

    name: str
    inputs: tuple[str, ...]
    title: str
    flops: Flops
    lines: tuple[str, ...]
    results: tuple[Result, ...]


def write_python(unit: Unit) -> str:
    """Write every kernel of `unit` as a function of one Python module."""
    kernels = [_view(family, tape) for family in unit.families for tape in family.tapes]
    return lay_out("python/model.py", kernels=kernels, version=unit.version, model_hash=unit.model_hash)


def _view(family: Family, tape: Tape) -> _View:
    body = write_body(tape, PYTHON)
    return _View(
        name=tape.name,
        inputs=tuple(i.name for i in tape.inputs),
        title=family.describe(tape),
        flops=count(tape).flops,
        lines=write_lines(body, "{target} = {expression}", "_check({joint}, {value}, {tolerance}, {scale}, functions)"),
        results=body.results,
    )
