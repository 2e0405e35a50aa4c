"""The table of tolerances on a page: it has the counts of the present code."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.tolerances import PAGE, SIX_AXIS, count_flops, fill


def test_the_page_has_the_counts_of_the_smallest_model(tmp_path: Path) -> None:
    """The robots' rows take longer, and are renewed together with this one."""
    row = " | ".join(map(str, count_flops(SIX_AXIS, tmp_path)))
    text = PAGE.read_text("utf-8")
    assert f"| `models/six_axis.yaml` | {row} |" in text
    assert "| d | 4 | 3 | 2 | 1 |" in fill(text, {"d": [4, 3, 2, 1]})


def test_a_table_is_replaced_and_no_other_text() -> None:
    page = fill("a\n\n| | whole | 0.1 |\n|---|---:|---:|\n| b | 1 | 2 |\n\nc\n", {"d": [4, 3, 2, 1]})
    assert page.splitlines()[-3] == "| d | 4 | 3 | 2 | 1 |"
    assert (page[:3], page[-4:]) == ("a\n\n", "\n\nc\n")
    with pytest.raises(ValueError, match="no table"):
        fill("a\n", {"d": [4, 3, 2, 1]})
