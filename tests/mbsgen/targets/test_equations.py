"""Equations and guards as they are counted, against a parser of the C that was written."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from mbsgen.formulations import exp1, impl
from mbsgen.pipeline import Options, make
from mbsgen.scaling import ONE_PLAN, make_chain
from mbsgen.targets.c.files import write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.unit import Unit
from tests.mbsgen.targets.guarded import guarded_tape
from tests.sample import sample_families

MODELS = Path(__file__).parents[3] / "models"
ASSIGNMENT = re.compile(r"(?:const mbs_real |mbs_kept->)?(\w+)(?:\[\d+\])? = ([^;{]*);")
ATOM = re.compile(r"\w+(?:\[\d+\])?|MBS_C\(-?[\w.+-]+\)|mbs_kept->\w+")


def body_of(text: str) -> str:
    """Take the functions that compute out of a C file: what stands before CasADi's face, comments apart."""
    return re.sub(r"/\*.*?\*/", "", text.split("/* The same in CasADi's contract. */")[0], flags=re.DOTALL)


def count_equations(text: str) -> int:
    """Count assignments of sines and cosines, and of all that is more than a name or a number."""
    found = 0
    for target, value in ASSIGNMENT.findall(body_of(text)):
        is_turn = value.startswith(("mbs_sines", "mbs_cosines"))
        found += not target.startswith("mbs_") and (is_turn or not ATOM.fullmatch(value)) and not value.startswith("&")
    return found


def count_guards(text: str) -> int:
    """Count the products of the tests, and the signs that they take."""
    tests = re.findall(r"if \(!MBS_EXCEEDS\((-?).*?, MBS_THRESHOLD\(.*?\) \* ", body_of(text))
    return len(tests) + sum(map(len, tests))


def chain_unit() -> Unit:
    """Write a chain that is long enough for functions in parts."""
    families = (Family(impl.build(make_chain(30), ONE_PLAN)), Family(exp1.build(make_chain(5), ONE_PLAN)))
    return Unit("chain", "0", "0", families)


UNITS: Mapping[str, Callable[[], Unit]] = {
    "chain": chain_unit,
    "sample": lambda: Unit("sample", "0", "0", sample_families()),
    "guarded": lambda: Unit("guarded", "0", "0", (Family(guarded_tape()),)),
}


@pytest.mark.parametrize("name", UNITS)
def test_counts_are_those_of_the_c(name: str) -> None:
    unit = UNITS[name]()
    written = write_c(unit)
    for kernel in written.kernels:
        text = written.files[kernel.sources[0]]
        assert count_equations(text) == kernel.equations, kernel.name
        assert count_guards(text) == kernel.flops.guard, kernel.name
        assert f"equations {kernel.equations}\n" in text
    if unit.prefix == "chain":
        assert any("mbs_part1" in text for text in written.files.values())


@pytest.mark.parametrize("runtime", [False, True])
def test_counts_of_a_model_are_those_of_its_c(runtime: bool) -> None:
    product = make(MODELS / "cart_pole.yaml", Options(runtime=runtime))
    for kernel in product.manifest.kernels:
        text = product.files[kernel.sources[0]]
        assert count_equations(text) == kernel.equations, kernel.name
        assert count_guards(text) == kernel.flops.guard, kernel.name
    assert any(kernel.flops.guard for kernel in product.manifest.kernels)
