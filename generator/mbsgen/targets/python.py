"""Python source of a model's kernels: the same equations over any number type; under CasADi's SX, the fair peer."""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass

import jinja2

from mbsgen import resources
from mbsgen.manifest import Flops
from mbsgen.tape.counts import count
from mbsgen.tape.types import Op, Tape
from mbsgen.targets.c import Unit
from mbsgen.targets.statements import Body, Syntax, write_body

PYTHON = Syntax(
    "{}",
    {op: f"functions.{op.value[0]}" for op in (Op.SQRT, Op.SIN, Op.COS)},
    re.compile("|".join((*keyword.kwlist, "functions", "math"))),
)


@dataclass(frozen=True)
class _View:
    """A kernel, ready to be laid out."""

    name: str
    inputs: tuple[str, ...]
    title: str
    flops: Flops
    body: Body


def write_python(unit: Unit) -> str:
    """Write every kernel of `unit` as a function of one Python module."""
    tapes = [
        (tape, family.title)
        for family in unit.families
        for tape in (family.value, family.jac, family.adj1, family.jac_adj1)
        if tape is not None
    ]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(resources.folder("templates") / "python"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    kernels = [_view(tape, title) for tape, title in tapes]
    template = environment.get_template("model.py.j2")
    return template.render(kernels=kernels, version=unit.version, model_hash=unit.model_hash)


def _view(tape: Tape, title: str) -> _View:
    return _View(tape.name, tuple(i.name for i in tape.inputs), title, count(tape).flops, write_body(tape, PYTHON))
