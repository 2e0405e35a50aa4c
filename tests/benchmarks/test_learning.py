"""The benchmark of calls inside JAX and PyTorch runs; small numbers of it, since no test measures time."""

from __future__ import annotations

import pytest


def test_every_line_is_measured(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The motions of both programs are compared, too."""
    for library in ("jax", "torch", "mujoco"):
        pytest.importorskip(library)
    from benchmarks import learning

    for name, value in {"BATCH": 8, "TURNS": 3, "ROUNDS": 1, "CARTS": 4, "STEPS": 20}.items():
        monkeypatch.setattr(learning, name, value)
    monkeypatch.setattr(learning, "FUNCTIONS", {"cart_pole": "exp1"})
    learning.main(["--quick"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert "exp1 of cart_pole: a call in compiled JAX" in lines[1]
