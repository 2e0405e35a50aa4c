"""The comparison of methods: tasks, the rest of an interrupted run, and the page."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.ocp import methods
from benchmarks.ocp.methods import SHIPPED, Solve, list_targets, read, summarise, write_page


def made(task: str, method: str, iterations: int, cost: float, status: str = "Solve_Succeeded") -> Solve:
    return Solve(SHIPPED, task, method, status, iterations, cost)


def test_a_summary_counts_optima_and_ratios() -> None:
    """Two equal optima, a lower one, a failure: the ratio is of the equal ones alone."""
    pairs = [
        (made("a", "mbs", 20, 1.0), made("a", "ipopt", 10, 1.0 + 1e-9)),
        (made("b", "mbs", 10, 2.0), made("b", "ipopt", 20, 2.0)),
        (made("c", "mbs", 99, 3.0), made("c", "ipopt", 1, 4.0)),
        (made("d", "mbs", 9, 3.0), made("d", "ipopt", 5, math.nan, "Infeasible_Problem_Detected")),
    ]
    summary = summarise(pairs)
    assert (summary.tasks, summary.solved, summary.iterations, summary.lower) == (4, (4, 3), (30, 30), (1, 0))
    assert summary.ratio == pytest.approx(1.0)
    assert summary.difference == pytest.approx(1e-9, rel=1e-3)
    page = write_page([solve for pair in pairs for solve in pair])
    assert f"| {SHIPPED} | 4 | 4, 3 | 30, 30 | 1.00 | 1e-09 | 1, 0 |" in page
    assert f"| {SHIPPED}, d | Solve_Succeeded, 9 | Infeasible_Problem_Detected, 5 |" in page


def test_targets_cover_the_cylinder() -> None:
    """The whole grid has 33 different targets; the first three lie apart."""
    names = [name for name, _ in list_targets(33)]
    assert len(set(names)) == 33
    assert list_targets(3) == list_targets(33)[:3]
    assert all(math.hypot(x, y) == pytest.approx(methods.RADIUS) for _, (x, y, _) in list_targets(33))


def test_a_run_continues_after_its_last_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that was cut is solved again, and nothing else, except where the run starts anew."""
    tasks = [made(task, method, 10, 1.0) for task in "ab" for method in methods.METHODS]
    solved: list[Solve] = []

    def solve_all(_: argparse.Namespace, done: set[tuple[str, str, str]]) -> Iterator[Solve]:
        for task in tasks:
            if (task.group, task.task, task.method) not in done:
                solved.append(task)
                yield task

    monkeypatch.setattr(methods, "solve_all", solve_all)
    methods.main(["--out", str(tmp_path)])
    file = tmp_path / "methods.jsonl"
    assert read(file) == solved == tasks
    file.write_text(file.read_text("utf-8")[:-30], "utf-8")
    assert read(file) == tasks[:3]
    methods.main(["--out", str(tmp_path)])
    assert read(file) == tasks
    assert solved == [*tasks, tasks[3]]
    methods.main(["--out", str(tmp_path), "--again"])
    assert len(solved) == 9
    assert "2, 2" in (tmp_path / "methods.md").read_text("utf-8")
