"""A predicted half stride of a human in the plane: periodic, at its speed, and true to the laws of momentum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbsrun import read_problem
from tests.shipped import FOLDER

GAIT = FOLDER / "human" / "gait.ocp.yaml"
SPEED, HALF, WEIGHT = 1.3, 0.55, 75.0 * 9.81
CONTACTS = ("right_heel", "right_toe", "left_heel", "left_toe")


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def test_half_a_stride_keeps_momentum() -> None:
    """Momentum is periodic: so the mean force of the ground is the weight, and nothing along the way; legs exchange."""
    solved = read_problem(GAIT).solve(check=False)
    phase = solved["motion"]
    t, x = phase["t"], phase["q_x"]
    assert x[-1] - x[0] == pytest.approx(SPEED * HALF, abs=1e-8)
    for joint in ("hip", "knee", "ankle"):
        for kind in ("q", "qd"):
            right, left = (phase[f"{kind}_{side}_{joint}"] for side in ("right", "left"))
            assert abs(right[-1] - left[0]) + abs(left[-1] - right[0]) < 1e-7
    forces = {axis: sum(phase[f"f{axis}_{name}"] for name in CONTACTS) for axis in "xz"}
    means = {axis: float(np.trapezoid(force, t)) / HALF for axis, force in forces.items()}
    assert means["z"] == pytest.approx(WEIGHT, rel=0.02)  # the trapezoidal rule on the points of the grid
    assert abs(means["x"]) < 0.02 * WEIGHT
    lowest = min(float(phase[f"normal_{name}"].min()) for name in CONTACTS)
    assert lowest >= 0  # the ground does not pull
