"""The page of batches: times of the same numbers, in one table with their ratios."""

from __future__ import annotations

import pytest

from benchmarks import batches, step_gradients
from benchmarks.batches import MODELS, Times, Told, measure_model, measure_motions, read_answer, write_page
from benchmarks.step_gradients import Steps, measure_steps
from tests.golden import ROOT


def test_a_small_mechanism_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batches, "STATES", 64)
    rows = list(measure_model("pendulum", ROOT / "models" / "double_pendulum.yaml", repeats=2))
    assert [kernel for _, kernel, _ in rows] == ["impl", "jac_impl", "exp2", "jac_exp2"]
    assert all(min(times.one, times.rows, times.columns) > 0 for _, _, times in rows)


def test_motions_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batches, "STEPS", 2)
    assert measure_motions(MODELS["arm_pendulum"].with_name("double_pendulum.yaml"), repeats=1) > 0


def test_steps_and_their_gradients_are_those_of_rollouts_and_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_gradients, "STATES", 64)
    steps = list(measure_steps(ROOT / "models" / "cart_pole.yaml", repeats=1))
    assert {found.method for found in steps} == {"semi-implicit Euler", "RK4"}
    assert all(min(found.alone, found.with_gradient) > 0 for found in steps)


def test_peers_are_read_with_their_reasons() -> None:
    assert read_answer('a remark\n{"impl": 2.5, "exp2": "no batch"}\n', "") == {"impl": 2.5, "exp2": "no batch"}
    assert read_answer("", "Traceback\nImportError: none") == dict.fromkeys(("impl", "exp2"), "ImportError: none")


def test_the_page_compares_the_quicker_lanes() -> None:
    rows = [("panda", "impl", Times(90.0, 40.0, 30.0)), ("panda", "exp2", Times(180.0, 50.0, 60.0))]
    peers: dict[str, dict[str, Told]] = {"panda": {"frax": {"impl": 6000.0, "exp2": "no wheel"}}}
    page = write_page(rows, {"panda": 2e6}, [Steps("RK4", 8, 5.0, 1.75)], peers)
    assert "| panda | impl | 90.0 | 40.0 | 30.0 | 3.0 |" in page
    assert "| panda | 2.0 |" in page
    assert "| RK4 | 8 | 5.0 | 1.8 |" in page
    assert "| panda | impl | 30 | 6000 (200) |" in page
    assert "- frax: exp2 of panda: no wheel" in page
