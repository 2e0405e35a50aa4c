"""The page of a GPU: figures from an emulated one in a table, and none where there is no GPU."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from benchmarks import gpu
from benchmarks.gpu import Row, measure_frax, write_page
from mbsrun.cuda import driver
from tests.golden import ROOT
from tests.mbsrun.cuda.emulation import emulate


def test_nothing_is_written_without_a_gpu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    driver.find_driver.cache_clear()
    monkeypatch.setattr(driver, "LIBRARY", "libno_such_driver.so.1")
    monkeypatch.setattr(sys, "argv", ["gpu", "--out", str(tmp_path / "gpu.md")])
    gpu.main()
    assert capsys.readouterr().out.startswith("Nothing is measured, and no page is written: there is no GPU here")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_a_small_mechanism_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("STATES", 300), ("LAUNCHES", 2), ("RUNS", 1)):
        monkeypatch.setattr(gpu, name, value)
    with emulate(tmp_path) as emulated:
        rows = gpu.measure_model(emulated.driver, "pendulum", ROOT / "models" / "double_pendulum.yaml")
    assert [row.kernel for row in rows] == ["impl", "jac_impl", "exp2", "jac_exp2"]
    assert all(min(row.ours.values()) > 0 and not row.frax for row in rows)


def test_frax_needs_a_gpu_too() -> None:
    assert measure_frax("rnea", "float32") is None


def test_the_page_names_the_card() -> None:
    row = Row("panda", "impl", {"float32": 5000.4, "float64": 2500.0}, {"float32": 99.6})
    page = write_page("Card (sm_90)", [row])
    assert "wrote this page: Card (sm_90)." in page
    assert "| panda | impl | 5000 | 2500 | 100 |  |" in page
