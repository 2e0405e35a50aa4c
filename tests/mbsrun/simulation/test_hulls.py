"""Capsules and hulls that touch: a log that rolls down a slope, arrows, and shapes in pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun import load
from mbsrun.animation import Motion as Shown
from mbsrun.animation import Part, make_film
from mbsrun.animation.film import Kind, Layer
from mbsrun.animation.forces import find_loads
from mbsrun.models import Extent
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold
from tests.mbsrun.simulation.balls import MASSES, ROUGH, SHOWN, stand

LOG = """\
name: log
gravity: [0, 0, -9.81]
bodies:
  - name: log
    joint:
      - {type: prismatic, axis: x, name: x, actuated: false}
      - {type: prismatic, axis: z, name: z, actuated: false}
      - {type: revolute, axis: y, name: turn, actuated: false}
    mass: 3
    inertia: [0.2, 0.01, 0.2]
contacts:
  - {name: ends, body: log, radius: 0.1, points: [[0, -0.3, 0], [0, 0.3, 0]], plane: {normal: [0.3, 0, 1]},
     restitution: 0, friction: {coefficient: 0.9}}
"""
PAIR = """\
name: pair
gravity: [0, 0, 0]
parameters:
  long: {value: 0.3, kind: runtime}
bodies:
  - {name: a, joint: {type: free}, mass: 2, inertia: [0.02, 0.02, 0.02]}
  - {name: b, joint: {type: free}, mass: 3, inertia: [0.05, 0.05, 0.05]}
contacts:
  - {name: hit, body: a, SIDES, stiffness: 1e4, width: 1e-3, LAW}
"""
SIDES = {
    "capsule": "radius: 0.1, capsule: {body: b, radius: 0.05, length: long, orientation: [{axis: x, angle: 0.2}]}",
    "points": "radius: 0.05, points: [[0, 0, 0.1], [long, 0, 0], [0, -0.1, 0]], plane: {body: b, normal: [0, 0.1, 1]}",
}


def make(folder: Path, text: str) -> Path:
    file = folder / "model.yaml"
    file.write_text(text)
    return file


def test_a_log_rolls_down_a_slope(tmp_path: Path) -> None:
    """On both of its ends: with the acceleration g sin(slope)/(1 + I/(m r^2)), by steps and from event to event."""
    log = load(make(tmp_path, LOG))
    slope, T, r = np.arctan(0.3), 0.5, 0.1
    start = [r * np.sin(slope), r * np.cos(slope), 0.0]
    way = 9.81 * np.sin(slope) / (1 + 0.01 / (3 * r**2)) * T**2 / 2
    for method in ("moreau", "dop853"):
        motion = simulate(log, hold([]), start, np.zeros(3), Settings(T, method=method, step=1e-3, output_step=0.1))
        moved = motion.q[-1] - motion.q[0]
        assert moved == pytest.approx([way * np.cos(slope), -way * np.sin(slope), way / r], rel=1e-9), method


@pytest.mark.parametrize("side", SIDES)
def test_arrows_are_the_forces_that_the_kernels_compute(side: str, tmp_path: Path) -> None:
    """Of a: m v' + om x (m v) in its own axes, beside a capsule, beyond its ends, and at points, with a new length."""
    text = PAIR.replace("SIDES", SIDES[side]).replace("LAW", ROUGH)
    pair, random = load(make(tmp_path, text), extent=SHOWN).with_parameters(long=0.32), np.random.default_rng(2)
    for _ in range(8):
        way = random.normal(size=3)
        place = 0.13 * way / np.linalg.norm(way) + [0, 0, 0.1 * np.sign(way[2])] if side == "capsule" else 0.05 * way
        q, qd = np.array(stand(tuple(place), (0, 0, 0))), random.normal(size=12)
        qdd = pair("exp2", q=q, qd=qd, u=np.zeros(0))["qdd"]
        expected = MASSES[0] * (qdd[:3] + np.cross(qd[3:6], qd[:3]))
        loads = find_loads(pair, q[None], pair("rates", q=q, qd=qd)["rate"][None])
        assert sum(x.values[0] for x in loads) == pytest.approx(expected, abs=1e-5)
        assert np.abs(expected).max() > 1 or side == "points"


def test_capsules_and_points_are_drawn(tmp_path: Path) -> None:
    """A capsule as a cylinder with two balls, a hull as the balls about its points."""
    q = np.array([stand((0.4, 0, 0), (0, 0, 0))] * 2)
    for side, kinds in (("capsule", [Kind.CYLINDER, *([Kind.ELLIPSOID] * 3)]), ("points", 3 * [Kind.ELLIPSOID])):
        text = PAIR.replace("SIDES", SIDES[side]).replace("LAW", ROUGH)
        pair = load(make(tmp_path, text), extent=Extent(("frames",), derivatives=0))
        film = make_film([Shown((Part(pair, np.array([0.0, 1.0]), q),))])
        shown = [x for x in film.actors[0].solids if x.layer is Layer.CONTACTS]
        assert sorted(x.kind for x in shown) == sorted(kinds)
        if side == "capsule":
            (rod,) = [x for x in shown if x.kind is Kind.CYLINDER]
            assert rod.size == pytest.approx((0.1, 0.1, 0.3))
            assert rod.axes is not None
            assert rod.axes[6:] == pytest.approx((0, -np.sin(0.2), np.cos(0.2)))
        else:
            assert {x.at for x in shown} == {(0.0, 0.0, 0.1), (0.3, 0.0, 0.0), (0.0, -0.1, 0.0)}
