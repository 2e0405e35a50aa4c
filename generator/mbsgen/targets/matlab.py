"""Matlab source of a model's kernels, which GNU Octave runs too: one function in one file for each kernel.

Arguments are full matrices: entries outside an input's pattern are not read, entries outside an output's pattern are 0.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

from mbsgen.manifest import Flops
from mbsgen.model.reader import ModelWarning
from mbsgen.tape.counts import count
from mbsgen.tape.types import FUNCTIONS, Input, Op, Output, Sparsity, Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.layout import lay_out
from mbsgen.targets.statements import Result, Syntax, wrap, write_body, write_lines
from mbsgen.targets.unit import Unit

FOLDER = "matlab"  # the folder of the files
_LONGEST_NAME = 63  # characters that Matlab reads of a name
_LINE = 110


def _write_entries(name: str, pattern: Sparsity) -> list[str]:
    if pattern.cols == 1:
        return [f"{name}({row + 1})" for row in pattern.row]
    return [f"{name}({row + 1}, {column + 1})" for row, column in pattern.entries]


# Outside their domain, Matlab's own functions return complex numbers; these raise an error.
_REAL = {Op.SQRT: "realsqrt", Op.LOG: "reallog", Op.ASIN: "realasin", Op.ACOS: "realacos"}
_LOCAL = {Op.ASIN: "asin", Op.ACOS: "acos"}  # the ones that are written into the file

# Keywords of Matlab and Octave, and the functions called here, cannot name variables.
MATLAB = Syntax(
    "{}",
    {op: op.value[0] for op in FUNCTIONS} | _REAL | {Op.ABS: "abs"},
    re.compile(
        "break|case|catch|classdef|continue|do|else|elseif|end.*|enumeration|events|for|function|global|if|methods|"
        "otherwise|parfor|persistent|properties|return|spmd|switch|try|until|unwind_protect.*|while|"
        "(real)?(sqrt|log|asin|acos)|sin|cos|tan|atan2?|exp|tanh|abs|sign|zeros|size|numel|eps|class|error|isequal|any|ans"
    ),
    _write_entries,
)


@dataclass(frozen=True)
class _Argument:
    """An argument of a function."""

    name: str
    shape: str
    note: str
    misfit: str  # true where the argument has another shape


@dataclass(frozen=True)
class _View:
    """A kernel, ready to be laid out."""

    name: str
    signature: tuple[str, ...]
    title: str
    flops: Flops
    inputs: tuple[_Argument, ...]
    outputs: tuple[_Argument, ...]
    lines: tuple[str, ...]
    results: tuple[Result, ...]
    local: tuple[str, ...]  # functions that a function of this file replaces


def write_matlab(unit: Unit) -> dict[str, str]:
    """Write every kernel of `unit` that does not iterate as a Matlab function; return the files, path -> text.

    Python's warnings name the others.
    """
    left = [f.name for family in unit.families for f in family.functions if not isinstance(f, Tape)]
    if left:
        finding = f"matlab: {', '.join(left)}: left out, since functions for Matlab contain no iteration"
        warnings.warn(f"{finding}; --python writes them", ModelWarning, stacklevel=2)
    views = [_view(unit.prefix, family, tape) for family in unit.families for tape in family.tapes]
    common = {"version": unit.version, "model_hash": unit.model_hash}
    return {f"{FOLDER}/{view.name}.m": lay_out("matlab/kernel.m", kernel=view, **common) for view in views}


def _view(prefix: str, family: Family, tape: Tape) -> _View:
    name = f"{prefix}_{tape.name}"
    assert len(name) <= _LONGEST_NAME, f"Matlab would cut the name {name}"
    body = write_body(tape, MATLAB)
    return _View(
        name=name,
        signature=_write_signature(name, tape),
        title=family.describe(tape),
        flops=count(tape).flops,
        inputs=tuple(_describe(i) for i in tape.inputs),
        outputs=tuple(_describe(o) for o in tape.outputs),
        lines=write_lines(
            body,
            "{target} = {expression};",
            "if ~({value} > {tolerance}*eps(class({value}))*{scale})\n"
            "    error('mbsgen:pivot', 'the pivot of joint {joint} is lost in rounding');\nend",
        ),
        results=body.results,
        local=tuple(name for op, name in _LOCAL.items() if any(used is op for used, _, _ in tape.operations)),
    )


def _write_signature(name: str, tape: Tape) -> tuple[str, ...]:
    given = f"{name}({', '.join(i.name for i in tape.inputs)})"
    line = f"function [{', '.join(o.name for o in tape.outputs)}] = {given}"
    if len(line) <= _LINE:
        return (line,)
    results = wrap((o.name for o in tape.outputs), _LINE - 20)
    return ("function [ ...", *(f"    {line} ..." for line in results), f"    ] = {given}")


def _describe(argument: Input | Output) -> _Argument:
    name, rows, cols = argument.name, argument.sparsity.rows, argument.sparsity.cols
    meaning = argument.port.note
    return _Argument(
        name=name,
        shape=f"{rows}, {cols}",
        note=f"{name} ({rows} x {cols})" + (f": {meaning}" if meaning else ""),
        misfit=f"numel({name}) ~= {rows}" if cols == 1 else f"~isequal(size({name}), [{rows}, {cols}])",
    )
