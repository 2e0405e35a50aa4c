"""The page of batches: times of the same numbers, in one table with their ratios."""

from __future__ import annotations

import pytest

from benchmarks import batches
from benchmarks.batches import MODELS, Times, measure_model, measure_motions, write_page
from tests.golden import ROOT


def test_a_small_mechanism_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batches, "STATES", 64)
    rows = list(measure_model("pendulum", ROOT / "models" / "double_pendulum.yaml", repeats=2))
    assert [kernel for _, kernel, _, _ in rows] == ["impl", "jac_impl", "exp2", "jac_exp2"]
    assert all(min(times.one, times.rows, times.columns) > 0 for _, _, times, _ in rows)


def test_motions_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batches, "STEPS", 2)
    assert measure_motions(MODELS["arm_pendulum"].with_name("double_pendulum.yaml"), repeats=1) > 0


def test_the_page_compares_the_quicker_lanes() -> None:
    page = write_page([("panda", "impl", Times(90.0, 40.0, 30.0), 6000.0)], {"panda": 2e6})
    assert "| panda | impl | 90.0 | 40.0 | 30.0 | 3.0 | 6000 | 200 |" in page
    assert "| panda | 2.0 |" in page
