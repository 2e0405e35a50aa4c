"""A kind of stages is a class and an entry in the rules of each language: a toy kind passes through all of them."""

from __future__ import annotations

import ctypes
import importlib.util
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mbsgen.procedure.adjoints import Adjoints
from mbsgen.procedure.differentiation import adjoint, jacobian
from mbsgen.procedure.procedure import Procedure, as_procedure, count, evaluate
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.slopes import Slopes
from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, Values
from mbsgen.procedure.straight import Straight, written
from mbsgen.procedure.wires import Wire
from mbsgen.tape.counts import Counts
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Op, Sparsity
from mbsgen.targets.c import stages as c_stages
from mbsgen.targets.c.files import write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.python import stages as python_stages
from mbsgen.targets.python.module import write_python
from mbsgen.targets.unit import Unit
from tests.mbsgen.procedure.examples import X


@dataclass(frozen=True)
class Sum(Stage):
    """z = w0 + w1 + ..."""

    name: str
    given: Wire
    total: Wire

    @property
    def reads(self) -> tuple[Wire, ...]:
        return (self.given,)

    @property
    def gives(self) -> tuple[Wire, ...]:
        return (self.total,)

    @property
    def can_fail(self) -> bool:
        return False

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        assert arithmetic.numbers.epsilon > 0
        return Outcome(0, {self.total.name: [sum(given[self.given.name])]})

    def count(self) -> Counts:
        return Counts({Op.ADD: self.given.numel - 1}, 1)

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        sheet, total = Sheet(), {}
        for gradient in slopes.take(sheet, self.given):
            for column, value in gradient.items():
                total[column] = total[column] + value if column in total else value
        slopes.give(sheet, self.total, [total])
        return (self, *written(sheet, slopes.name(f"{self.name}_slopes")))

    def pull(self, adjoints: Adjoints) -> Pulled:
        sheet = Sheet()
        adjoints.give(sheet, self.given, adjoints.take(sheet, self.total) * self.given.numel)
        return Pulled((self,), written(sheet, adjoints.name(f"{self.name}_back")))


def write_sum_in_c(writer: c_stages.Writer, stage: Sum) -> None:
    terms = " + ".join(f"{writer.name(stage.given)}[{k}]" for k in range(stage.given.numel))
    writer.read.add(stage.given.name)
    writer.lines.append(f"{writer.name(stage.total)}[0] = {terms};")


def write_sum_in_python(stage: Sum, _: str) -> list[str]:
    return [f"{stage.total.name} = [sum({stage.given.name})]"]


def sum_of_sines() -> Procedure:
    """Return z = (sin x0 + sin x1 + sin x2)^2."""
    sines, total, z = Wire("sines", Sparsity.dense(3)), Wire("total", Sparsity.dense(1)), Wire("z", Sparsity.dense(1))
    before, after = Sheet(), Sheet()
    before.give(sines, [before.builder.sin(x) for x in before.take(X)])
    (s,) = after.take(total)
    after.give(z, [s * s])
    stages = (Straight(before.finish("before")), Sum("sum", sines, total), Straight(after.finish("after")))
    return Procedure(Function("sum_of_sines"), (X,), stages, (z,))


def test_a_toy_kind_is_generated_and_differentiated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """(sum sin x)^2 has the gradient 2 sum sin x cos x; interpreted, compiled and imported."""
    monkeypatch.setitem(c_stages.RULES, Sum, write_sum_in_c)
    monkeypatch.setitem(python_stages.RULES, Sum, write_sum_in_python)
    procedure = sum_of_sines()
    family = Family(procedure, jacobian(procedure, ["x"]), adjoint(procedure, ["x"]))
    x = np.array([0.3, 0.7, 1.1])
    gradient = 2 * np.sin(x).sum() * np.cos(x)
    expected = {"z": [np.sin(x).sum() ** 2], "jac_z_x": gradient, "adj_x": gradient}
    assert count(procedure).operations == {Op.SIN: 3, Op.ADD: 2, Op.MUL: 1}

    unit = Unit("toy", "0", "0", (family,))
    sources = write_c(unit)
    for file, text in {**sources.files, **write_python(unit)}.items():
        (tmp_path / file).write_text(text)
    files = [tmp_path / file for file in sources.sources]
    command: list[str | Path] = ["gcc", "-std=c99", "-shared", "-fPIC", *files, "-lm", "-o", tmp_path / "toy.so"]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(tmp_path / "toy.so"))
    spec = importlib.util.spec_from_file_location("toy", tmp_path / "toy.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    for function in map(as_procedure, family.functions):
        given = {"x": x, "adj_z": np.ones(1)}
        arguments = {i.name: given[i.name] for i in function.inputs}
        (result,) = function.outputs
        np.testing.assert_allclose(evaluate(function, arguments)[result.name], expected[result.name], rtol=1e-14)
        found = getattr(module, function.name)(**{name: list(values) for name, values in arguments.items()})
        np.testing.assert_allclose(found[result.name], expected[result.name], rtol=1e-14)
        values = np.zeros(result.sparsity.nnz)
        pointers = [v.ctypes.data_as(ctypes.c_void_p) for v in (*arguments.values(), values)]
        assert library[f"toy_compute_{function.name}"](*pointers) == 0
        np.testing.assert_allclose(values, expected[result.name], rtol=1e-14)
