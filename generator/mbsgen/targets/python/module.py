"""Python source of a model's kernels: the same equations over any number type; under CasADi's SX, the fair peer."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass

from mbsgen.manifest import Flops
from mbsgen.procedure.procedure import Computation, Procedure, count
from mbsgen.tape.types import FUNCTIONS, Op, Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.layout import lay_out
from mbsgen.targets.python.stages import Written, list_functions, write_stages
from mbsgen.targets.statements import Result, Syntax, write_body, write_lines
from mbsgen.targets.unit import Unit

PYTHON = Syntax(
    "{}",
    {op: f"functions.{op.value[0]}" for op in FUNCTIONS} | {Op.SIGN: "_sign(functions)", Op.ABS: "abs"},
    re.compile("|".join((*keyword.kwlist, "functions", "math", "abs"))),
)


@dataclass(frozen=True)
class _Part:
    """A tape as a function, ready to be laid out."""

    name: str
    inputs: tuple[str, ...]
    lines: tuple[str, ...]
    results: tuple[Result, ...]


@dataclass(frozen=True)
class _View:
    """A kernel, ready to be laid out."""

    name: str
    inputs: tuple[str, ...]
    title: str
    flops: Flops
    lines: tuple[str, ...]
    results: tuple[Result, ...] | None  # None: the last of the lines return them


def write_python(unit: Unit) -> dict[str, str]:
    """Write every kernel of `unit` as a function of one Python module; return the file, path -> text."""
    written = [(family, function) for family in unit.families for function in family.functions]
    in_stages = {f.name: write_stages(f) for _, f in written if isinstance(f, Procedure)}
    text = lay_out(
        "python/model.py",
        kernels=[_view(family, function, in_stages) for family, function in written],
        parts=[_write_part(part.name, part.tape) for stages in in_stages.values() for part in stages.parts],
        staged=lay_out("python/stages.py", functions=list_functions()) if in_stages else "",
        version=unit.version,
        model_hash=unit.model_hash,
    )
    return {f"{unit.prefix}.py": text}


def _view(family: Family, function: Computation, in_stages: Mapping[str, Written]) -> _View:
    whole = _write_part(function.name, function) if isinstance(function, Tape) else None
    return _View(
        name=function.name,
        inputs=tuple(i.name for i in function.inputs),
        title=family.describe(function),
        flops=count(function).flops,
        lines=whole.lines if whole else in_stages[function.name].lines,
        results=whole.results if whole else None,
    )


def _write_part(name: str, tape: Tape) -> _Part:
    body = write_body(tape, PYTHON)
    lines = write_lines(body, "{target} = {expression}", "_check({joint}, {value}, {tolerance}, {scale}, functions)")
    return _Part(name, tuple(i.name for i in tape.inputs), lines, body.results)
