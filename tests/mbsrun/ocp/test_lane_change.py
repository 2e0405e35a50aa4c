"""A car changes lanes and back in the least time, at the limit of its tyres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun import read_problem

FILE = Path(__file__).parents[3] / "models" / "vehicles" / "lane_change.ocp.yaml"
FRICTION = 1.1  # more than the tyres have at these loads
REAR = 1.2 / 2.6  # of the load


def test_a_lane_change_takes_what_the_tyres_give() -> None:
    """The car stays between the lines, and drives near the limit of friction, nowhere beyond it."""
    solution = read_problem(FILE).solve()
    trajectory = solution.solution.trajectory
    x, y = trajectory.q[:, 0], trajectory.q[:, 1]
    gates = [(y[(x > 50) & (x < 65)] - 3.5).min(), -y[x < 10].max(), -y[x > 100].max()]
    assert min(gates) > -0.5
    yaw, (x2, y2) = trajectory.point_q[..., 2], np.moveaxis(trajectory.point_qdd[..., :2], -1, 0)
    forward = (x2 * np.cos(yaw) + y2 * np.sin(yaw)) / 9.81
    assert 0.8 < forward.max() / REAR < FRICTION  # the rear wheel drives
    assert np.hypot(x2, y2).max() < FRICTION * 9.81
    assert solution.horizon == pytest.approx(4.06, abs=0.02)  # without the price of inputs: 4.06 s on finer grids, too
