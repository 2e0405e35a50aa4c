"""The component for Dymos: partials against differences, and an optimum in Dymos against the project's own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import mbsrun
from mbsrun.peers.dymos import make_component
from mbsrun.peers.peer import PeerError
from tests import peers

MODELS = Path(__file__).parents[3] / "models"


@pytest.mark.skipif(not peers.FOLDER.exists(), reason="python -m tests.peers build/peers installs Dymos")
def test_dymos_finds_the_same_optimum(tmp_path: Path) -> None:
    """Inputs of ours are constant over an interval, so costs converge to Dymos's as h^2: extrapolated, to 1e-6."""
    command = [sys.executable, "-m", "tests.peers.swing", str(MODELS / "pendulum.yaml"), "2.0", "1.2"]
    path = os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(peers.FOLDER), str(peers.ROOT)])
    run = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    error, cost = map(float, run.stdout.splitlines()[-1].split())
    assert error <= 1e-8
    swing = mbsrun.problem(
        MODELS / "pendulum.yaml", horizon=1.2, degree=3, end={"pose": {"q1": 2.0}, "velocity": "zero"}
    )
    coarse, fine = (swing.with_changes(intervals=n).solve(check=False).cost for n in (50, 100))
    assert (4 * fine - coarse) / 3 == pytest.approx(cost, rel=1e-6)


def test_a_model_with_more_than_q_and_qd_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openmdao.api", SimpleNamespace(ExplicitComponent=object))
    with pytest.raises(PeerError, match="satellite has quaternions, and Dymos gives it q, qd and u alone"):
        make_component(MODELS / "satellite.yaml")
    monkeypatch.setitem(sys.modules, "openmdao.api", None)
    with pytest.raises(PeerError, match="openmdao is not installed; run pip install dymos"):
        make_component(MODELS / "pendulum.yaml")
