"""A car on four double wishbones: its corners, its rest, and a lane change in the least time with closed loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun import Mechanism, load, read_problem
from mbsrun.models import Extent

Array = NDArray[np.float64]

MODELS = Path(__file__).parents[3] / "models"
KERNELS = Extent(("close", "exp1_red", "loops"), 0)
FRICTION = 1.1  # more than the tyres have at these loads
FRONT, BASE, HEIGHT = 1.2, 2.6, 0.55  # of the centre of mass: to the front axle; wheelbase; above the ground


@pytest.fixture(scope="module")
def car() -> Mechanism:
    return load(MODELS / "vehicles" / "wishbone_car.yaml", extent=KERNELS)


def pose(mechanism: Mechanism, **given: float) -> dict[str, float]:
    """Close the loops at given coordinates; return all by name."""
    names = mechanism.manifest.positions
    q = np.array(mechanism.manifest.pose)
    for name, value in given.items():
        q[names.index(name)] = value
    return dict(zip(names, mechanism.close(q=q)["closed"].tolist(), strict=True))


@pytest.mark.parametrize(("lower", "rack"), [(0.15, 0.02), (-0.12, -0.03), (0.05, 0.0)])
def test_corners_move_as_the_single_one(car: Mechanism, lower: float, rack: float) -> None:
    """Left as `wishbone.yaml`, right as its mirror image; the rear ones are not steered."""
    corner = load(MODELS / "wishbone.yaml", extent=KERNELS)
    alone, straight = pose(corner, lower=lower, rack=rack), pose(corner, lower=lower, rack=0)
    left = pose(car, lower_fl=lower, rack=rack, lower_rl=lower)
    right = pose(car, lower_fr=-lower, rack=-rack, lower_rr=-lower)
    for found, side, sign in ((left, "left", 1), (right, "right", -1)):
        for end, expected in (("front", alone), ("rear", straight)):
            own = f"{end[0]}{side[0]}"
            assert found[f"upper_{own}"] == pytest.approx(sign * expected["upper"], abs=1e-12)
            for axis, turned in (("rz", sign), ("ry", 1), ("rx", sign)):
                angle = turned * expected[f"knuckle.{axis}"]
                assert found[f"{end} {side} knuckle.{axis}"] == pytest.approx(angle, abs=1e-12)


def test_the_car_stands_where_its_problems_start(car: Mechanism) -> None:
    """But its wheels begin to turn: the Magic Formula has a small force without slip."""
    q = np.array([*pose(car, heave=0.29727, pitch=8.7e-4).values()])
    independent = [car.manifest.positions[k] for k in car.manifest.independent]
    found = car.exp1_red(q=q, yd=np.zeros(len(independent)), u=np.zeros(5))["ydd"]
    moved = dict(zip(independent, found.tolist(), strict=True))
    assert max(abs(x) for name, x in moved.items() if not name.startswith("spin")) < 0.2


def test_a_lane_change_takes_what_the_tyres_give(car: Mechanism) -> None:
    """Closed loops at all points, between the lines, and never faster than friction and moved load permit."""
    solution = read_problem(MODELS / "vehicles" / "wishbone_lane_change.ocp.yaml").solve()
    trajectory = solution.solution.trajectory
    assert max(np.abs(car.loops(q=q)["gap"]).max() for q in trajectory.q) < 1e-9
    x, y = trajectory.q[:, 0], trajectory.q[:, 1]
    gates = [(y[(x > 50) & (x < 65)] - 3.5).min(), -y[x < 10].max(), -y[x > 100].max()]
    assert min(gates) > -0.5
    yaw, (x2, y2) = trajectory.point_q[..., 2], np.moveaxis(trajectory.point_qdd[..., :2], -1, 0)
    forward = (x2 * np.cos(yaw) + y2 * np.sin(yaw)) / 9.81
    most = FRICTION * FRONT / (BASE - FRICTION * HEIGHT)  # the rear wheels drive
    assert 0.8 * FRONT / BASE < forward.max() < most
    assert np.hypot(x2, y2).max() < FRICTION * 9.81
    assert solution.horizon == pytest.approx(4.02, abs=0.02)  # 4.06 with one wheel for each axle
