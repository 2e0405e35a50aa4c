"""Whipple's bicycle: published poles, and the same by time stepping; wheels in compliant contacts and files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun import Mechanism, load
from mbsrun.linearisation import BalanceError, roll
from mbsrun.models import Extent
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold

Array = NDArray[np.float64]

FILE = Path(__file__).parents[3] / "models" / "switching" / "bicycle.yaml"
REAR, FRONT = 0.3, 0.35  # radii [m]

# Meijaard, Papadopoulos, Ruina, Schwab (2007): M q'' + v C1 q' + (g K0 + v^2 K2) q = 0 of roll and steer
M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
C1 = np.array([[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
K0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
K2 = np.array([[0.0, 76.59734589573222], [0.0, 2.65431523794604]])
# the same paper, table 2: poles at speeds in m/s
POLES = {
    5: (-14.078389692798219, -0.322866429004087, -0.775341882195845 + 4.464867713788229j),
    10: (-24.624596350174044, 0.161053386531725, -3.720168404372873 + 10.906811394762872j),
}


@pytest.fixture(scope="module")
def bicycle() -> Mechanism:
    return load(FILE, extent=Extent(("impl", "touching", "distances", "energy", "power", "frames", "exp2"), 1))


def ride(speed: float) -> tuple[Array, Array]:
    """Return the state of a bicycle that rides straight on."""
    q, qd = np.zeros(9), np.zeros(9)
    q[2], qd[0], qd[6], qd[8] = REAR, speed, speed / REAR, speed / FRONT
    return q, qd


def test_the_bicycle_has_its_published_poles(bicycle: Mechanism) -> None:
    """To the digits of the published matrices and poles, at all speeds of the table."""
    for speed in range(11):
        found = roll(bicycle, *ride(speed)).poles
        lower = -np.linalg.solve(M, np.hstack((9.81 * K0 + speed**2 * K2, speed * C1)))
        expected = np.linalg.eigvals(np.vstack((np.eye(2, 4, 2), lower)))
        for pole in (*expected, *POLES.get(speed, ())):
            assert np.abs(found - pole).min() < 5e-14 * max(10.0, abs(pole))
    assert roll(bicycle, *ride(5.0)).multipliers[[2, 5]].sum() == pytest.approx(94 * 9.81)


def test_the_bicycle_rides_by_time_stepping_as_its_poles_say(bicycle: Mechanism) -> None:
    """At 5 m/s it steers itself upright: a small roll follows the linear equations, and the wheels do not slip."""
    q, qd = ride(5.0)
    qd[4] = 1e-4
    motion = simulate(bicycle, hold([]), q, qd, Settings(1.0, "moreau", step=1e-3))
    assert motion.is_complete
    linear = roll(bicycle, *ride(5.0))
    change = np.concatenate((np.zeros(9), linear.Z.T @ (motion.qd[1] - ride(5.0)[1])))
    values, vectors = np.linalg.eig(linear.A)
    later = (vectors * np.exp(values * (motion.t[-1] - motion.t[1]))) @ np.linalg.solve(vectors, change.astype(complex))
    assert motion.q[-1, [4, 7]] == pytest.approx(later.real[[4, 7]], abs=2e-7)
    slip = bicycle("touching", q=motion.q[-1])["slide"] @ motion.qd[-1]
    assert np.abs(slip).max() < 1e-4


DISC = """
name: disc
gravity: [0, 0, -9.81]
bodies:
  - {name: disc, joint: {type: free}, mass: 2, inertia: [0.01, 0.02, 0.01]}
contacts:
  - {name: rim, body: disc, radius: 0.02, wheel: {radius: 0.1}, restitution: 0, friction: {coefficient: 0.8}}
"""


def test_a_torus_has_the_distance_of_its_lowest_point(tmp_path: Path) -> None:
    """A wheel that leans by a: height - R cos(a) - r; one that lies flat is refused by a status."""
    file = tmp_path / "disc.yaml"
    file.write_text(DISC, encoding="utf-8")
    disc, a = load(file, extent=Extent(("touching", "distances"), 0)), 0.4
    found = disc("touching", q=[0, 0, 0.5, math.sin(a / 2), 0, 0, math.cos(a / 2)])
    assert found["clearance"] == pytest.approx(0.5 - 0.1 * math.cos(a) - 0.02, abs=1e-15)
    with pytest.raises(Exception, match="rim"):
        disc("touching", q=[0, 0, 0.5, math.sin(math.pi / 4), 0, 0, math.cos(math.pi / 4)])
    copy = tmp_path / "copy.yaml"
    copy.write_text(write_model(read_model(file)), encoding="utf-8")
    assert read_model(copy) == read_model(file)
    for more, message in (
        ("size: [1, 1, 1]", "a wheel with a size"),
        ("sphere: {radius: 1}", "a wheel touches a plane alone"),
    ):
        copy.write_text(DISC.replace("restitution", f"{more}, restitution"), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            read_model(copy)


def test_a_motion_that_does_not_roll_is_refused(bicycle: Mechanism) -> None:
    q, qd = ride(5.0)
    with pytest.raises(BalanceError, match=r"contact rear slips with 1\.5 m/s"):
        roll(bicycle, q, np.where(np.arange(9) == 6, qd - 5.0, qd))
    with pytest.raises(BalanceError, match=r"contact rear is 0\.1 m from the other side"):
        roll(bicycle, np.where(np.arange(9) == 2, q + 0.1, q), qd)
    with pytest.raises(BalanceError, match="the motion is not steady"):
        roll(bicycle, np.where(np.arange(9) == 4, 0.1, q) - [0, 0, REAR * (1 - math.cos(0.1)), *[0] * 6], np.zeros(9))
