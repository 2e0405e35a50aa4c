"""The page of a GPU: figures from an emulated one in a table, and none where there is no GPU."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import gpu
from benchmarks.gpu import Contest, Row, write_page
from benchmarks.gpu_peers import PANDA, Numbers, Prepare, Work, list_peers, prepare_mjx, prepare_warp
from mbsrun import load
from mbsrun.cuda import CudaError, driver, nvrtc
from mbsrun.models import Extent
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


@pytest.fixture
def _briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("STATES", 300), ("LAUNCHES", 2), ("RUNS", 1)):
        monkeypatch.setattr(gpu, name, value)


@pytest.mark.usefixtures("_briefly")
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_a_small_mechanism_is_measured(tmp_path: Path) -> None:
    with emulate(tmp_path) as emulated:
        rows = list(gpu.measure_model(emulated.driver, "pendulum", ROOT / "models" / "double_pendulum.yaml"))
    assert [row.kernel for row in rows] == ["impl", "jac_impl", "exp2", "jac_exp2"]
    assert all(min(row.rates.values()) > 0 for row in rows)


@pytest.mark.usefixtures("_briefly")
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_a_peer_is_compared_before_it_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that computes as we do is measured; wrong results end the run."""
    kernels = load(PANDA, extent=Extent(tuple(gpu.FUNCTIONS), 0))

    def prepare(function: str, q: Numbers, qd: Numbers, last: Numbers) -> Work:
        third, result = gpu.FUNCTIONS[function]
        inputs = {"q": q, "qd": qd, third: last} | ({"u": 0 * q} if function == "impl" else {})
        return Work(lambda: None, lambda: None, lambda: kernels.batch(function, **inputs)[0][result])

    assert list_peers() == {}  # without a GPU
    monkeypatch.setattr(gpu, "list_peers", lambda: {"peer": (prepare, ("float64",))})
    with emulate(tmp_path) as emulated:
        rows = [Row("panda", name, {"float32": 1e9, "float64": 1e8}) for name in gpu.FUNCTIONS]
        contests = list(gpu.measure_peers(emulated.driver, rows))
        found = [(c.function, c.dtype, list(c.peers)) for c in contests if c.peers]
        assert found == [("impl", "float64", ["peer"]), ("exp2", "float64", ["peer"])]
        wrong = Work(lambda: None, lambda: None, lambda: np.zeros((300, 7)))
        monkeypatch.setattr(gpu, "list_peers", lambda: {"peer": (lambda *_: wrong, ("float64",))})
        with pytest.raises(AssertionError, match="peer impl"):
            list(gpu.measure_peers(emulated.driver, rows))


@pytest.mark.parametrize(
    ("module", "prepare", "dtype"), [("jax", prepare_mjx, "float64"), ("warp", prepare_warp, "float32")]
)
def test_peers_compute_our_panda(module: str, prepare: Prepare, dtype: str) -> None:
    """On the processor, to rounding: MJX in double, MuJoCo Warp in single precision."""
    pytest.importorskip(module)
    pytest.importorskip("mujoco.mjx" if module == "jax" else "mujoco_warp")
    q, qd, last = np.random.default_rng(0).uniform(0.1, 0.6, (3, 5, 7)).astype(dtype)
    work = prepare("impl", q, qd, last)
    work.start()
    work.finish()
    exact = {name: x.astype(float) for name, x in {"q": q, "qd": qd, "qdd": last}.items()}
    expected = load(PANDA, extent=Extent(("impl",), 0)).impl(**exact, u=0 * exact["q"])["Phi"]
    np.testing.assert_allclose(work.read(), expected, rtol=0, atol=100 * np.finfo(dtype).eps * np.abs(expected).max())


def test_the_page_names_the_card() -> None:
    rows = [Row("panda", "impl", {"float32": 5000.4, "float64": 2500.0})]
    contests = [
        Contest("impl", "float32", 5000.4, {"frax": 100.0, "MJX": 1.25}),
        Contest("impl", "float64", 2500.0, {}),
    ]
    page = write_page("Card (sm_90)", rows, contests)
    assert "wrote this page: Card (sm_90)." in page
    assert "| panda | impl | 5000 | 2500 |" in page
    assert "| impl | float32 | 5000 | 100 | 50 | 1.25 | 4000 |" in page
    assert "| impl | float64 | 2500 |  |  |  |  |" in page
    assert "No peer found the GPU." in write_page("Card", rows, [])


def test_registers_are_written_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        nvrtc.find_nvrtc()
    except CudaError as fault:
        pytest.skip(str(fault))
    monkeypatch.setattr(gpu, "MODELS", {"pendulum": ROOT / "models" / "double_pendulum.yaml"})
    monkeypatch.setattr(sys, "argv", ["gpu", "--registers", str(tmp_path / "page.md")])
    gpu.main()
    assert re.search(r"\| pendulum \| impl \|( \d+, 0 \|){4}", (tmp_path / "page.md").read_text("utf-8"))
