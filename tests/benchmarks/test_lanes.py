"""The page of kernels alone: times, and instructions counted in machine code."""

from __future__ import annotations

from benchmarks.lanes import Found, measure_model, write_page
from tests.golden import ROOT


def test_a_small_mechanism_is_measured() -> None:
    rows = list(measure_model("pendulum", ROOT / "models" / "double_pendulum.yaml", rounds=1))
    assert [row.kernel for row in rows] == ["impl", "jac_impl", "exp2", "jac_exp2"]
    assert all(min(row.one, row.lanes) > 0 and row.at_stack <= row.instructions for row in rows)


def test_the_page_has_gains_and_the_part_at_the_stack() -> None:
    page = write_page([Found("panda", "impl", 90.0, 15.0, 8, 400, 50)])
    assert "| panda | impl | 90.0 | 15.0 | 6.0 | 8 | 400 | 12 % |" in page
