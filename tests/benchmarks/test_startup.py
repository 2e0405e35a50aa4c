"""The tasks of the benchmark of commands: their model is one, their processes run, and the page shows the shortest."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from benchmarks.startup import ROOT, Row, Task, list_tasks, measure, write_page, write_tree
from mbsgen.pipeline import read_tree


def test_the_tree_is_a_model_of_random_joints(tmp_path: Path) -> None:
    """Bodies are positive, no inertia is refused, and equal seeds give equal files."""
    file = tmp_path / "tree.yaml"
    file.write_text(write_tree(3, 7), encoding="utf-8")
    tree = read_tree(file)
    assert len(tree.bodies) == 7
    assert write_tree(3, 7) == write_tree(3, 7)
    assert write_tree(4, 7) != write_tree(3, 7)


def test_tasks_run_in_turn_and_the_shortest_counts(tmp_path: Path) -> None:
    """A task that only sums takes some time in each checkout; the first run, which warms up, is not counted."""
    assert len([*list_tasks(tmp_path, 3)]) >= 7
    (row,) = measure([Task("sum", ("-c", "sum(range(10**6))"), rounds=2)], {"before": ROOT, "now": ROOT})
    assert {name: len(runs) for name, runs in row.seconds.items()} == {"before": 2, "now": 2}
    assert np.isfinite(row.shortest("now"))
    assert row.shortest("now") > 0
    page = write_page([Row("a", {"before": [4.0, 3.0], "now": [1.5, 2.0]})], {"before": ROOT, "now": ROOT}, 0.0)
    assert "| a | 3.00 | 1.50 | 2.00 |" in page
    assert sys.executable not in page
