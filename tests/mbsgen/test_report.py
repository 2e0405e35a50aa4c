"""The report: counts agree with the tapes, the JSON keeps its form, and no name can break a table."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from mbsgen.formulations.catalogue import list_rows
from mbsgen.formulations.planning import WORTH
from mbsgen.pipeline import Options, Product, make, read_tree, write_families
from mbsgen.report import (
    COLUMNS,
    PUBLISHED,
    SWITCHED,
    Report,
    comparisons,
    identify,
    sections,
    write_json,
    write_markdown,
)
from mbsgen.tape.counts import count
from mbsgen.tape.types import Op

ARM = Path(__file__).parents[2] / "models" / "arm_pendulum.yaml"
ALL_REDUCTIONS = "all reductions (--runtime --lump)"
FLOPS = ("paper", "arithmetic", "add", "mul", "div", "neg", "sqrt", "trig")


@pytest.fixture(scope="module")
def product() -> Product:
    return make(ARM)


@pytest.fixture(scope="module")
def report(product: Product) -> Report:
    return product.report


def test_the_json_has_the_form_that_later_versions_are_compared_by(report: Report) -> None:
    data = json.loads(write_json(report))
    assert data["model"] == "arm_pendulum"
    assert list(data["formulations"]) == list(list_rows())
    entries = [entry for part in ("formulations", "setups", "kernels") for entry in data[part].values()]
    for entry in entries:
        assert set(entry) == {"flops", "equations"}
        assert set(entry["flops"]) == {*FLOPS, "other", "guard"}
        assert all(type(n) is int for n in (*entry["flops"].values(), entry["equations"]))


def test_the_two_conventions_are_sums_of_the_kinds(report: Report) -> None:
    for cost in (*report.formulations.values(), *report.setups.values(), *report.kernels.values()):
        f = cost.flops
        assert f.arithmetic == f.add + f.mul + f.div
        assert f.paper == f.arithmetic + f.neg + f.sqrt + f.trig


def test_kernels_cost_what_their_tapes_do(report: Report) -> None:
    tapes = {tape.name: tape for family in write_families(read_tree(ARM)) for tape in family.tapes}
    assert list(report.kernels) == list(tapes)
    for name, tape in tapes.items():
        cost, counts = report.kernels[name], count(tape)
        assert (cost.flops, cost.equations) == (counts.flops, counts.equations)
        assert cost.flops.paper + cost.flops.other == len(tape.operations)
        assert cost.flops.trig == sum(op in (Op.SIN, Op.COS) for op, _, _ in tape.operations)


def test_files_hold_what_is_reported(product: Product) -> None:
    assert product.files["report.json"] == write_json(product.report)
    assert product.files["report.md"] == write_markdown(product.report)


def test_formulations_that_are_not_counted_leave_the_rest_as_it_is() -> None:
    """The report of the kernels does not change."""
    pendulum = ARM.parent / "pendulum.yaml"
    whole, rest = make(pendulum), make(pendulum, Options(count=False))
    assert rest.report == replace(whole.report, formulations={}, setups={}, folded={})
    assert [name for name in whole.files if whole.files[name] != rest.files[name]] == ["report.md", "report.json"]


def test_a_kernel_stands_with_its_derivatives(report: Report) -> None:
    groups = sections(report)[-1].groups
    assert [name for group in groups for name in group] == list(report.kernels)
    for group in groups:
        first = next(iter(group))
        assert [name for name in group if not name.endswith(first)] == []
        assert not first.startswith(("jac_", "adj1_"))


@pytest.mark.parametrize("name", ["arm", "a|b", "*a*", "<b>", "`x`", "a\\", "[a](b)", "# a"])
def test_a_name_does_not_break_the_markdown(name: str, report: Report) -> None:
    text = write_markdown(replace(report, model=name))
    title, *rows = text.splitlines()
    assert re.sub(r"\\(.)", r"\1", title) == f"# What {name} costs"
    tables = [block.splitlines() for block in "\n".join(rows).split("\n\n") if block.startswith("|")]
    assert len(tables[0][0].split("|")) == len(COLUMNS) + 3
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table}) == 1


def test_a_comparison_tells_what_each_reduction_saves_and_what_was_published() -> None:
    rows = comparisons(make(ARM, Options(compare=True)).report)
    assert set(SWITCHED) < set(rows)
    for name in list_rows():
        saved = {title: rows[title][name] - rows[ALL_REDUCTIONS][name] for title in SWITCHED}
        ordered = saved.pop("sums as they come")  # an order that saves time may cost a few
        assert all(flops >= 0 for flops in saved.values())
        assert ordered >= (1 - WORTH) * rows[ALL_REDUCTIONS][name]
        assert max(saved, key=lambda title: saved[title]) == "no reduction"
        assert 2 * rows[ALL_REDUCTIONS][name] <= rows["published"][name]


def test_published_figures_go_with_the_mechanism_not_with_its_name(tmp_path: Path) -> None:
    """Another arm of that name has none; the same under other names keeps them."""
    text, arm = ARM.read_text(encoding="utf-8"), tmp_path / "arm.yaml"

    def identify_text(changed: str) -> str:
        arm.write_text(changed, encoding="utf-8")
        return identify(read_tree(arm))

    assert identify_text(text) in PUBLISHED
    assert (
        identify_text(text.replace("arm_pendulum", "other").replace("forearm", "ulna").replace("m1", "mass"))
        in PUBLISHED
    )
    for old, new in (
        ("m1: 2.5", "m1: 2.6"),
        ("-9.81", "-1.62"),
        ("axis: z", "axis: x"),
        ("com: [d1, 0, 0]", "com: [0, 0, 0]"),
    ):
        assert old in text
        assert identify_text(text.replace(old, new, 1)) not in PUBLISHED
