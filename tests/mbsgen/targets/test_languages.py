"""Target languages: a refusal lists the known ones, and a new one is a printer and an entry."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mbsgen.expressions import FLOATS, evaluate, parse
from mbsgen.formulations.catalogue import FUNCTIONS as CATALOGUE
from mbsgen.pipeline import OptionError, Options, generate, make, read_tree
from mbsgen.procedure.procedure import straight
from mbsgen.tape import interpreter
from mbsgen.tape.types import FUNCTIONS
from mbsgen.targets import languages
from mbsgen.targets.languages import TARGETS, Target
from mbsgen.targets.statements import Syntax, write_body, write_lines
from mbsgen.targets.unit import Unit

ROOT = Path(__file__).parents[3]
PENDULUM = ROOT / "models" / "double_pendulum.yaml"
SHEET = Syntax(
    "{}",
    {op: op.value[0] for op in FUNCTIONS},
    re.compile("sin|cos|pi"),
    lambda name, pattern: [f"{name}_{k}" for k in range(pattern.nnz)],
)


def write_sheets(unit: Unit) -> dict[str, str]:
    """Write a file for each function: assignments in the order of their evaluation, a line each."""
    files = {}
    for family in unit.families:
        body = write_body(straight(family.value), SHEET)
        lines = [*write_lines(body, "{target} = {expression}", "{value} > {tolerance}*{scale}")]
        lines += [f"{s.target} = {s.expression}" for result in body.results for s in result.statements]
        files[f"sheets/{family.value.name}.txt"] = "".join(f"{line}\n" for line in lines)
    return files


def calculate(sheet: str, given: dict[str, float]) -> dict[str, float]:
    """Evaluate the assignments of a sheet."""
    known = dict(given)
    for line in sheet.splitlines():
        if " = " in line:
            target, text = line.split(" = ")
            known[target] = evaluate(parse(text), known, FLOATS)
    return known


def test_a_new_language_is_a_printer_and_an_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Generated beside C and Python; its text computes the equations of the tape."""
    monkeypatch.setattr(languages, "TARGETS", (*TARGETS, Target("sheets", "Also write sheets.", write_sheets)))
    options = Options(functions=("impl", "exp1"), derivatives=0, targets=("sheets", "python"))
    product = generate(PENDULUM, tmp_path / "out", options)
    assert {"sheets/impl.txt", "sheets/exp1.txt", "double_pendulum.py"} <= product.files.keys()
    state = {"q": [0.3, -0.4], "qd": [0.7, 0.2], "qdd": [0.1, 0.5], "u": [0.6, -0.3]}
    named = {f"{name}_{k}": x for name, values in state.items() for k, x in enumerate(values)}
    for function, result in (("impl", "Phi"), ("exp1", "qdd")):
        tape = CATALOGUE[function].build(read_tree(PENDULUM), options.reductions)
        given = {i.name: state[i.name][: i.sparsity.rows] for i in tape.inputs}
        sheet = (tmp_path / "out" / "sheets" / f"{function}.txt").read_text(encoding="utf-8")
        found = calculate(sheet, named)
        expected = interpreter.evaluate(tape, given)[result]
        assert [found[f"{result}_{k}"] for k in range(2)] == pytest.approx(expected, rel=1e-14)


def test_an_unknown_target_is_refused() -> None:
    with pytest.raises(OptionError, match="there is no target 'pyhton'; is python meant"):
        make(PENDULUM, Options(targets=("pyhton",)))
    known = "python, cpp, matlab, rust, wasm, julia, lanes, cuda, fmu, bounds, double-double, acados, acados-untimed"
    with pytest.raises(OptionError, match=f"there is no target 'x'; there are {known}"):
        make(PENDULUM, Options(targets=("x",)))
