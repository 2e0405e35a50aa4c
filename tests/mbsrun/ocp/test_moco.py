"""Problems of models/moco and models/muscles against closed forms, and against OpenSim Moco where it is installed.

`python -m tests.peers build/peers` installs OpenSim.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from tests import peers
from tests.mbsrun.ocp.muscles import FIBRES, STRENGTHS, TENDONS, pull
from tests.shipped import FOLDER


@pytest.fixture(scope="module")
def moco(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Moco's numbers, from another process, which leaves its log in its own folder."""
    if not (peers.FOLDER / "opensim").exists():
        pytest.skip("python -m tests.peers build/peers installs OpenSim")
    script = Path(__file__).with_name("moco_peer.py")
    path = os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(peers.FOLDER)])
    run = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path_factory.mktemp("moco"),
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return found


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def found(path: Path) -> Solution:
    outcome = solve(*read_problem(path, load_on_demand))
    assert isinstance(outcome, Solution), outcome
    return outcome


def test_the_sliding_mass_takes_the_least_time() -> None:
    """T = 2 sqrt(m d/F): full force forward, and then backward."""
    fastest = found(FOLDER / "moco" / "fastest.ocp.yaml")
    assert fastest.cost.total == pytest.approx(0.4, abs=1e-6)
    assert fastest.trajectory.u[:25] == pytest.approx(np.full((25, 1), 50), abs=1e-2)
    assert fastest.trajectory.u[25:] == pytest.approx(np.full((25, 1), -50), abs=1e-2)


def test_the_sliding_mass_takes_the_least_effort() -> None:
    """u = 12 m d (1/2 - t) in 1 s, at a cost of 12 m^2 d^2."""
    motion = (effort := found(FOLDER / "moco" / "effort.ocp.yaml")).trajectory
    assert effort.cost.total == pytest.approx(48, rel=1e-9)
    assert motion.point_u[..., 0] == pytest.approx(24 * (0.5 - motion.point_t), abs=1e-6)
    assert motion.q[:, 0] == pytest.approx(motion.t**2 * (3 - 2 * motion.t), abs=1e-8)


def test_moco_finds_the_same_sliding_mass(moco: dict[str, Any]) -> None:
    """Its least time has the error of a switch within an interval."""
    assert found(FOLDER / "moco" / "fastest.ocp.yaml").cost.total == pytest.approx(moco["time"], rel=1e-3)
    assert found(FOLDER / "moco" / "effort.ocp.yaml").cost.total == pytest.approx(moco["effort"], rel=1e-7)


def test_muscles_have_opensims_curves(moco: dict[str, Any]) -> None:
    """DeGrooteFregly2016Muscle, to the digits that the model file prints."""
    for x, active, passive in moco["curves"]:
        length, rate = TENDONS[0] + FIBRES[0] * x, 10 * FIBRES[0] * (x - 1)
        for act in (0.0, 0.6):
            tension = float(pull(0, length, rate, act)) / STRENGTHS[0]
            assert tension == pytest.approx(act * active + passive, abs=1e-5)


def test_a_lift_by_activations_costs_as_much_as_in_moco(moco: dict[str, Any], tmp_path: Path) -> None:
    """Activations are controls here, and Moco's grid is another one."""
    text = (FOLDER / "muscles" / "lift.ocp.yaml").read_text("utf-8")
    text = re.sub(r"states:.*?controls:", "controls:", text, flags=re.DOTALL)
    text = text.replace("shoulder_drive", "deltoid").replace("elbow_drive", "brachialis")
    (tmp_path / "arm.yaml").write_text((FOLDER / "muscles" / "arm.yaml").read_text("utf-8"), "utf-8")
    (tmp_path / "lift.ocp.yaml").write_text(text, "utf-8")
    assert found(tmp_path / "lift.ocp.yaml").cost.total == pytest.approx(moco["lift"], rel=1e-4)
