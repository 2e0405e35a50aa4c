"""The report: what each formulation and each generated kernel costs, as a table, as Markdown and as JSON.

`formulations` counts the dynamics with every number of the model as a run-time parameter, `setup` apart, as the paper's
Table 4 does; `kernels` counts what was generated.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from mbsgen.formulations.catalogue import FORMULATIONS
from mbsgen.formulations.links import PARAMETERS
from mbsgen.formulations.planning import dynamics_alone
from mbsgen.formulations.reductions import Reductions
from mbsgen.manifest import Flops, Kernel
from mbsgen.model.tree import Tree
from mbsgen.tape.counts import count
from mbsgen.tape.passes import hoist
from mbsgen.tape.types import Tape

LUMPED = Reductions(lump_runtime=True)
COLUMNS = ("flops", "arith", "+ -", "*", "/", "neg", "sqrt", "trig", "other", "eqs")
NOTE = (
    "flops: by the paper's convention, one each for + - * / sqrt sin cos and unary minus. arith: + - * / alone. "
    "other: exp, tanh and the like, in neither. eqs: equations. Formulations have every number of the model at run "
    "time, setup apart; kernels are counted as generated."
)
_DERIVATIVES = ("jac_", "adj1_")  # what the names of kernels that belong to another begin with


@dataclass(frozen=True)
class Cost:
    """What one evaluation costs."""

    flops: Flops
    equations: int

    @property
    def row(self) -> tuple[int, ...]:
        """List the cost in the order of COLUMNS."""
        f = self.flops
        return (f.paper, f.arithmetic, f.add, f.mul, f.div, f.neg, f.sqrt, f.trig, f.other, self.equations)


@dataclass(frozen=True)
class Report:
    """The costs of a model."""

    model: str
    formulations: Mapping[str, Cost]
    setups: Mapping[str, Cost]  # of the formulations, once per change of parameters
    kernels: Mapping[str, Cost]


def make_report(tree: Tree, parametric: Tree, kernels: tuple[Kernel, ...]) -> Report:
    """Count the formulations of `parametric`, whose numbers are run-time parameters, and the generated kernels."""
    formulations, setups = {}, {}
    for name, row in FORMULATIONS.items():
        tape = row.build(dynamics_alone(parametric, driven=row.driven), LUMPED)
        setup, (tape,) = hoist([tape], PARAMETERS, "h")
        formulations[name] = _cost(tape)
        setups[name] = _cost(setup)
    return Report(tree.name, formulations, setups, {k.name: Cost(k.flops, k.equations) for k in kernels})


def _cost(tape: Tape) -> Cost:
    counts = count(tape)
    return Cost(counts.flops, counts.equations)


@dataclass(frozen=True)
class Section:
    """A table of the report: rows in groups, each of what belongs together."""

    title: str
    groups: tuple[Mapping[str, Cost], ...]


def sections(report: Report) -> tuple[Section, ...]:
    """List the tables of a report; a kernel and its derivatives are a group."""
    groups: list[dict[str, Cost]] = []
    for name, cost in report.kernels.items():
        if not groups or not name.startswith(_DERIVATIVES):
            groups.append({})
        groups[-1][name] = cost
    return (
        Section("Formulations, parameters at run time", (report.formulations,)),
        Section("Their setup, once per change of parameters", (report.setups,)),
        Section("Kernels as generated", tuple(groups)),
    )


def write_json(report: Report) -> str:
    """Write `report.json`, the stable form that later versions are compared by."""
    data = {
        "model": report.model,
        "formulations": {name: _entry(cost) for name, cost in report.formulations.items()},
        "setups": {name: _entry(cost) for name, cost in report.setups.items()},
        "kernels": {name: _entry(cost) for name, cost in report.kernels.items()},
    }
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


def _entry(cost: Cost) -> dict[str, object]:
    return {"flops": cost.flops.model_dump(), "equations": cost.equations}


def write_markdown(report: Report) -> str:
    """Write `report.md`."""
    lines = [f"# What {_plain(report.model)} costs", "", NOTE]
    for section in sections(report):
        lines += ["", f"## {section.title}", "", _line(("", *COLUMNS)), _line(["---", *["---:"] * len(COLUMNS)])]
        lines += [_line((f"`{name}`", *map(str, cost.row))) for costs in section.groups for name, cost in costs.items()]
    return "\n".join(lines) + "\n"


def _line(cells: tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _plain(name: str) -> str:
    """Take from a user's name what Markdown would read as its own."""
    return "".join(c if c.isalnum() or c in " -." else f"\\{c}" for c in name)
