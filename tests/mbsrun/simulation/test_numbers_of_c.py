"""Numbers that Python and C share have one value: the header's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mbsrun.simulation import motion
from mbsrun.simulation.integration import explicit

CSRC = Path(__file__).parents[3] / "csrc"
DEFINED = re.compile(r"^#define MBS_(\w+) \(?(-?\d+)\)?(?: |$)", re.MULTILINE)
STATUSES = ("RUNAWAY", "STOPPED", "SHORT", "OPEN", "BRANCHED", "DEPENDENT", "EVENT", "LOADED")


def list_defined(header: str) -> dict[str, int]:
    return {name: int(value) for name, value in DEFINED.findall((CSRC / header).read_text("utf-8"))}


@pytest.mark.parametrize("name", STATUSES)
def test_statuses_are_the_ones_of_the_header(name: str) -> None:
    assert getattr(explicit, name) == list_defined("mbs_explicit.h")[name]


@pytest.mark.parametrize("name", ["PLACE", "SPEED", "FORCE"])
def test_kinds_of_guards_are_the_ones_of_the_header(name: str) -> None:
    assert getattr(motion, name) == list_defined("mbs_explicit.h")[name]


def test_ways_of_keeping_loops_closed_are_the_ones_of_the_header() -> None:
    known = list_defined("mbs_explicit.h")
    assert {way.name: number for way, number in explicit.KEEPING.items()} == {
        name: known[name] for name in ("PROJECTION", "MASS_PROJECTION", "PARTITIONING", "BAUMGARTE")
    }
