"""Spheres on boxes: a ball that falls on a shelf and over its edge, energy, momenta, arrows and shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun import Mechanism, load
from mbsrun.animation import Motion as Shown
from mbsrun.animation import Part, make_film
from mbsrun.animation.film import Kind, Layer
from mbsrun.animation.forces import find_loads
from mbsrun.models import Extent
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold
from tests.mbsrun.simulation.balls import ELASTIC, MASSES, ROUGH, SHOWN, SIMULATED, SPINNING, momenta, stand

CRATE = """\
name: crate
gravity: [0, 0, 0]
parameters:
  edge: {value: 0.3, kind: runtime}
bodies:
  - {name: a, joint: {type: free}, mass: 2, inertia: [0.02, 0.02, 0.02]}
  - {name: b, joint: {type: free}, mass: 3, inertia: [0.05, 0.05, 0.05]}
contacts:
  - {name: hit, body: a, radius: 0.1, box: {body: b, size: [edge, 0.3, 0.3], orientation: [{axis: z, angle: 0.2}]},
     stiffness: 1e4, width: 1e-3, LAW}
"""


def make(folder: Path, law: str, extent: Extent = SIMULATED) -> Mechanism:
    (folder / "crate.yaml").write_text(CRATE.replace("LAW", law))
    return load(folder / "crate.yaml", extent=extent)


def test_a_rough_collision_keeps_momenta_and_loses_the_energy_of_its_work(tmp_path: Path) -> None:
    """Off the centres and with spin: linear and angular momentum stay; energy falls by the work that `power` sums."""
    crate = make(tmp_path, ROUGH)
    settings = Settings(0.2, rtol=1e-10, atol=1e-12, output_step=1e-3)
    motion = simulate(crate, hold([]), stand((-0.35, 0.13, -0.14), (0, 0, 0)), np.array(SPINNING), settings)
    assert crate("distances", q=motion.q)["distance"].min() < -1e-3
    p, L = momenta(motion.q, motion.qd)
    assert np.ptp(p, axis=0) == pytest.approx(np.zeros(3), abs=1e-8)
    assert np.ptp(L, axis=0) == pytest.approx(np.zeros(3), abs=1e-8)
    assert motion.energy is not None
    assert motion.energy.total[-1] < 0.95 * motion.energy.total[0]
    assert np.abs(motion.energy.drift).max() < 1e-6


def test_an_edge_is_a_parameter(tmp_path: Path) -> None:
    crate = make(tmp_path, ELASTIC)
    q = np.array(stand((0.3 * np.cos(0.2), 0.3 * np.sin(0.2), 0), (0, 0, 0)))
    assert crate("distances", q=q)["distance"] == pytest.approx([0.05], abs=1e-6)
    assert crate.with_parameters(edge=0.42)("distances", q=q)["distance"] == pytest.approx([-0.01], abs=1e-6)


def test_arrows_are_the_forces_that_the_kernels_compute(tmp_path: Path) -> None:
    """Of a: m v' + om x (m v) in its own axes, at faces, edges and corners, with another edge at run time."""
    crate, random = make(tmp_path, ROUGH, SHOWN).with_parameters(edge=0.32), np.random.default_rng(2)
    for _ in range(8):
        direction = random.normal(size=3)
        q = np.array(stand(tuple(0.2 * direction / np.abs(direction).max()), (0, 0, 0)))
        qd = random.normal(size=12)
        qdd = crate("exp2", q=q, qd=qd, u=np.zeros(0))["qdd"]
        expected = MASSES[0] * (qdd[:3] + np.cross(qd[3:6], qd[:3]))
        (load,) = find_loads(crate, q[None], crate("rates", q=q, qd=qd)["rate"][None])
        assert load.values[0] == pytest.approx(expected, abs=1e-5)


def test_the_box_is_drawn(tmp_path: Path) -> None:
    crate = make(tmp_path, ELASTIC)
    q = np.array([stand((0.4, 0, 0), (0, 0, 0))] * 2)
    film = make_film([Shown((Part(crate, np.array([0.0, 1.0]), q),))])
    (shown,) = [x for x in film.actors[0].solids if x.layer is Layer.CONTACTS and x.kind is Kind.BOX]
    assert shown.size == pytest.approx((0.3, 0.3, 0.3))
    assert shown.axes[:3] == pytest.approx((np.cos(0.2), np.sin(0.2), 0))
