"""The made recording of a minute: its motion, and the page of figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mbsrun
from benchmarks.moco.recorded import RATE, record, write_page
from mbsrun.models import INTEGRATED
from mbsrun.recordings import Treatment
from mbsrun.simulation.recorded import analyse

ARM = Path(__file__).parents[2] / "models" / "six_axis.yaml"


def test_the_forces_of_the_made_recording_are_those_of_its_derivatives() -> None:
    """Splines through 100 samples a second know sines of 2 Hz, away from their ends."""
    arm = mbsrun.load(ARM, extent=INTEGRATED)
    recording = record(arm, 2.0)
    found = analyse(recording, arm, Treatment()).forces
    assert np.abs(found.q - recording.values).max() < 1e-12
    h, q = 1 / RATE, recording.values
    qd = (q[:-4] - 8 * q[1:-3] + 8 * q[3:-1] - q[4:]) / (12 * h)
    qdd = (-q[:-4] + 16 * q[1:-3] - 30 * q[2:-2] + 16 * q[3:-1] - q[4:]) / (12 * h**2)
    expected = arm.impl(q=q[2:-2], qd=qd, qdd=qdd, u=np.zeros((len(qd), 6)))["Phi"]
    inner = slice(10, -10)
    assert np.abs(found.u[2:-2][inner] - expected[inner]).max() < 1e-3 * np.abs(expected).max()


def test_the_page_has_times_of_real_time() -> None:
    assert "| mbsrun | 0.500 | 120 |" in write_page([("mbsrun", 0.5)])
