"""A car on tyres: its steady cornering is the single-track model's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun import load
from mbsrun.models import Extent
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import control

Array = NDArray[np.float64]

FILE = Path(__file__).parents[2] / "models" / "vehicles" / "car.yaml"
RADIUS, STIFFNESS = 0.313, {"f": 5e4, "r": 7e4}


def write_brush(axle: str) -> str:
    """Write the law of a tyre whose friction never limits it."""
    brush = f"{{longitudinal: 8e4, lateral: {STIFFNESS[axle]}, friction: 1e3}}"
    return f"wheel: {{radius: {RADIUS}}}, stiffness: 2.1e5, exponent: 1, tyre: {{brush: {brush}}}}}"


def test_a_car_understeers_as_the_single_track_model(tmp_path: Path) -> None:
    """angle = L/R + m/L (b/Cf - a/Cr) V^2/R, with the stiffnesses C of both axles, up to squares of the angle."""
    lines = FILE.read_text(encoding="utf-8").splitlines()
    for k, line in enumerate(lines):
        if "file: road.tir" in line:
            lines[k] = line.split("wheel:")[0] + write_brush(line.split("tyre_")[1][0])
    file = tmp_path / "car.yaml"
    file.write_text("\n".join(lines), encoding="utf-8")
    car = load(file, extent=Extent(("exp2", "impl", "energy", "power", "frames"), 1))
    q, qd, V, angle = np.zeros(15), np.zeros(15), 20.0, 1e-3
    q[3], qd[0], qd[[8, 10, 12, 14]] = 0.297, V, V / RADIUS  # height; wheels

    def steer(_: float, q: Array, qd: Array) -> Array:
        drive = 800 * (V - qd[0] * np.cos(q[2]) - qd[1] * np.sin(q[2]))
        return np.array([3e4 * (angle - q[7]) - 600 * qd[7], 0, 0, drive, drive])

    motion = simulate(car, control(steer), q, qd, Settings(6.0))
    assert motion.is_complete
    q, qd = motion.q[-1], motion.qd[-1]
    speed = qd[0] * np.cos(q[2]) + qd[1] * np.sin(q[2])
    mass, shift = 1200 + 2 * (38 + 36), 2 * (38 * 1.2 - 36 * 1.4)
    a, b = 1.2 - shift / mass, 1.4 + shift / mass
    gradient = mass / (a + b) * (b / (2 * STIFFNESS["f"]) - a / (2 * STIFFNESS["r"]))
    expected = (a + b + gradient * speed**2) * qd[2] / speed
    assert q[7] == pytest.approx(expected, rel=5e-4)  # the body pitches by 1e-3, which moves its centre of mass
    assert speed == pytest.approx(V, rel=1e-3)
