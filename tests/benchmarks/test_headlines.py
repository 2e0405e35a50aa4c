"""Sentences of the README: they have the numbers of the pages."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.headlines import PageError, describe_methods, describe_mpc, read_number, read_tables, write_headlines

METHODS = """# Methods

| group | tasks | solved | mean ratio |
|---|---|---|---|
| one | 3 | 3, 2 | 1.5 |
| **all** | 7 | 6, 5 | 0.25 |

| another | table |
|---|---|
| 1 | 2 |
"""
CONTROL = """# Control

| N | solver | cold: iterations, ms | by ours |
|---:|---|---:|---:|
| 20 | mbs | 15, 3.00 | 1.0 |
| 20 | fatrop | 18, 9.00 | 10.2 |
| 20 | acados | 4, 2.00 | 2.1 |
| 100 | fatrop | 18, 80.52 | 70.4 |

## In real time

| N | preparation | feedback |
|---:|---:|---:|
| 20 | 150 | 17 |
"""


def test_tables_are_read_by_their_headings() -> None:
    """Of two tables under one heading, the first counts."""
    assert list(read_tables(METHODS)) == ["Methods"]
    assert read_tables(METHODS)["Methods"][1] == {"group": "all", "tasks": "7", "solved": "6, 5", "mean ratio": "0.25"}
    assert read_number("> 114.5") == 114.5
    assert read_number("28.9 · 27.7") == 28.9


def test_sentences_have_the_numbers_of_their_pages() -> None:
    assert "solves 6 of 7 tasks, IPOPT 5; IPOPT takes 4 times as many iterations" in describe_methods(METHODS)
    more = describe_methods(METHODS.replace("0.25", "1.52"))
    assert "IPOPT 5; it takes 1.5 times as many iterations as IPOPT" in more
    control = describe_mpc(CONTROL)
    assert "is 10 times faster than fatrop's and 2.1 times faster than acados'" in control
    assert "A first solve, without a plan, is 1.5 times faster with acados" in control
    assert "is 2 times slower with acados" in describe_mpc(CONTROL.replace("4, 2.00", "4, 6.00"))


@pytest.mark.parametrize(
    "removed", ["| 20 | acados | 4, 2.00 | 2.1 |\n", "| 20 | 150 | 17 |", "| 20 | fatrop | 18, 9.00 | 10.2 |\n"]
)
def test_a_page_without_a_number_is_named(tmp_path: Path, removed: str) -> None:
    """Nothing is written where a page lacks what a sentence needs."""
    results = Path(__file__).parents[2] / "benchmarks" / "results"
    for page in results.glob("*.md"):
        (tmp_path / page.name).write_text(page.read_text("utf-8"), "utf-8")
    assert write_headlines(tmp_path) == write_headlines(results)
    (tmp_path / "mpc.md").write_text(CONTROL.replace(removed, ""), "utf-8")
    with pytest.raises(PageError, match=r"mpc\.md"):
        write_headlines(tmp_path)
