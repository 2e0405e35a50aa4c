"""The front page's sentences and chart: they have the numbers of the pages."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks.front import READERS, Bar, draw_front, draw_narrow, list_bars, write_front
from benchmarks.headlines import PageError

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


def test_bars_have_the_numbers_of_their_pages(tmp_path: Path) -> None:
    for page in READERS:
        shutil.copy(RESULTS / page, tmp_path)
    text = (tmp_path / "mpc.md").read_text("utf-8")
    row = next(line for line in text.splitlines() if line.startswith("| 20 | acados"))
    (tmp_path / "mpc.md").write_text(
        text.replace(row, "| 20 | acados | 4, 2.11 | 0.9 | 3, 1.85 | 7.25 | 0.6 | 1e-05 |")
    )
    bars = {bar.work: bar for bar in list_bars(tmp_path)}
    assert bars["Next step of a Panda's control"].least == 7.25
    summary = (tmp_path / "summary.md").read_text("utf-8")
    (tmp_path / "summary.md").write_text(summary.replace("| Panda, 7 joints | 1.35", "| Panda, 7 joints | 77"))
    bars = {bar.work: bar for bar in list_bars(tmp_path)}
    assert bars["Torques of a motion"].most == 77
    assert "**7.2 times faster** than acados" in write_front(list_bars(tmp_path))


def test_bars_are_sorted_and_drawn(tmp_path: Path) -> None:
    bars = list_bars(RESULTS)
    assert [bar.least for bar in bars] == sorted((bar.least for bar in bars), reverse=True)
    assert Bar("a", "b", 2.0, 2.0, "c").label == "2 times"
    assert Bar("a", "b", 2.04, 11.2, "c").label == "2 to 11 times"
    for draw in (draw_front, draw_narrow):
        for name in ("a.png", "b.png"):
            draw(bars, tmp_path / name)
        assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("page", READERS)
def test_a_page_without_its_numbers_is_named(tmp_path: Path, page: str) -> None:
    for name in READERS:
        shutil.copy(RESULTS / name, tmp_path)
    (tmp_path / page).write_text("# Nothing\n")
    with pytest.raises(PageError, match=page):
        list_bars(tmp_path)
