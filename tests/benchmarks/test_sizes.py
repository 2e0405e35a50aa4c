"""The chart of sizes: sentences and marks from numbers, and one run without Pinocchio."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks import sizes
from mbsrun.measuring.fronts import Dot
from mbsrun.measuring.growth import Growth

COSTS = {"A": {1: 1.0, 4: 5.0, 8: 20.0, 16: 90.0}, "B": {1: 3.0, 4: 5.2, 8: 11.0, 16: 22.0}}


def make(*, are_rivals: bool = True) -> Growth:
    dots = tuple(Dot(line, "", size, cost) for line, costs in COSTS.items() for size, cost in costs.items())
    return Growth("?", dots, "joints", "time", rises="ns", are_rivals=are_rivals)


def test_the_size_at_which_another_line_is_the_best_is_marked_and_named() -> None:
    """A is the best up to 4, where B costs a tenth more at most; B from 8 on. Both lines keep all their dots."""
    panel = make()
    assert panel.headline == "Up to 4 joints, A is the fastest; from 8 on, B."
    assert panel.marks == {8: "B"}
    assert [dot.place[0] for dot in panel.join(panel.lines["B"])] == [1, 4, 8, 16]
    assert [dot.line for dot in panel.front] == ["A", "A", "B", "B"]


def test_lines_of_different_results_have_powers_and_no_best() -> None:
    """From 8 to 16, A grows by 4.5 = 2^2.17, and B by 2."""
    panel = make(are_rivals=False)
    assert panel.headline == "Long chains: the cost grows as the number of joints to the power of 2.2 (A), 1.0 (B)."
    assert not panel.marks
    assert not panel.front


def test_sizes_at_which_another_way_is_quicker_are_named_with_a_reason() -> None:
    """EXP2 has a tenth fewer operations and is taken: at 4 joints it takes 1.5 times as long as EXP1, at 8 less."""
    points = [
        sizes.Point(size, sizes.ACCELERATIONS, way, ns, flops)
        for way, flops, times in (("EXP1", 20, {4: 10.0, 8: 30.0}), ("EXP2", 17, {4: 15.0, 8: 25.0}))
        for size, ns in times.items()
    ]
    points.append(sizes.Point(4, sizes.TORQUES, "IMPL", 5.0, 7))
    points.append(sizes.Point(4, sizes.TORQUES, "Pinocchio, RNEA", 50.0))
    assert [gap.times for gap in sizes.find_gaps(points)] == [1.5, 1.0, 1.0]
    _, _, accelerations, torques, _ = sizes.write_gaps(points)
    assert "except 1.5 times EXP1 (4 joints, by EXP2). In EXP2 each joint waits" in accelerations
    assert torques == "- Torques: at most 1 times the quickest way, at every size."
    near = [p if p.way != "EXP2" else sizes.replace(p, flops=19) for p in points]
    assert [gap.own.way for gap in sizes.find_gaps(near)] == ["EXP1", "EXP1", "IMPL"]


def test_sizes_are_measured_without_pinocchio_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two formulations straight, two in loops, two interpreted; all accelerations are exact."""
    monkeypatch.setattr(sizes, "find_includes", lambda: None)
    monkeypatch.setattr(sizes, "LONGEST", {"impl": 2, "exp2": 2})
    run = CliRunner().invoke(sizes.main, ["--size", "2", "--rounds", "2", "-o", str(tmp_path)])
    assert run.exit_code == 0, run.output
    points = json.loads((tmp_path / "sizes.json").read_text(encoding="utf-8"))["points"]
    expected = ("IMPL", "EXP2", "SEMI, in loops", "EXP1, in loops", "IMPL, interpreted", "EXP2, interpreted")
    assert [p["way"] for p in points] == list(expected)
    assert all(p["error"] < 1e-14 for p in points if p["task"] == sizes.ACCELERATIONS)
    assert all(p["flops"] > 0 and p["compiled_s"] > 0 for p in points if p["way"] in sizes.STRAIGHT.values())
    assert (tmp_path / "sizes.md").read_text(encoding="utf-8").count("| 2 | ") == len(points)
    assert (tmp_path / "sizes_narrow.png").read_bytes().startswith(b"\x89PNG")
