"""Spheres that collide: closed forms, momentum, energy; the status of centres that coincide; arrows and shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun import Mechanism, load
from mbsrun.animation import Motion as Shown
from mbsrun.animation import Part, make_film
from mbsrun.animation.film import Layer
from mbsrun.animation.forces import find_loads
from mbsrun.kernel import KernelError
from mbsrun.models import Extent
from mbsrun.simulation import Motion, Settings, simulate
from mbsrun.simulation.drive import hold
from tests.mbsrun.simulation.balls import ELASTIC, MASSES, ROUGH, SHOWN, SIMULATED, SPINNING, Array, momenta, stand

BALLS = """\
name: balls
gravity: [0, 0, 0]
parameters:
  R: {value: 0.15, kind: runtime}
bodies:
  - {name: a, joint: {type: free}, mass: 2, inertia: [0.02, 0.02, 0.02]}
  - {name: b, joint: {type: free}, mass: 3, inertia: [0.05, 0.05, 0.05]}
contacts:
  - {name: hit, body: a, radius: 0.1, sphere: {body: b, radius: R}, stiffness: 1e4, width: 1e-5, LAW}
"""


def make(folder: Path, law: str, extent: Extent = SIMULATED) -> Mechanism:
    (folder / "balls.yaml").write_text(BALLS.replace("LAW", law))
    return load(folder / "balls.yaml", extent=extent)


def collide(balls: Mechanism, a: tuple[float, ...], qd: Array, duration: float) -> Motion:
    """Simulate a collision with a body that is at the origin."""
    settings = Settings(duration, rtol=1e-10, atol=1e-12, output_step=1e-4)
    return simulate(balls, hold([]), stand(a, (0, 0, 0)), qd, settings)


def test_a_straight_elastic_collision_has_its_closed_form(tmp_path: Path) -> None:
    """Linear contact: half a period pi sqrt(m/k) of the reduced mass; velocities by momentum and energy."""
    balls, v = make(tmp_path, ELASTIC), 0.8
    qd = np.zeros(12)
    qd[0] = v
    motion = collide(balls, (-0.35, 0, 0), qd, 0.2)
    total = sum(MASSES)
    expected = [v * (MASSES[0] - MASSES[1]) / total, 2 * v * MASSES[0] / total]
    assert motion.qd[-1, [0, 6]] == pytest.approx(expected, rel=1e-4)
    touching = balls("distances", q=motion.q)["distance"][:, 0] < 0
    lasts = np.pi * np.sqrt(MASSES[0] * MASSES[1] / total / 1e4)
    assert np.count_nonzero(touching) * 1e-4 == pytest.approx(lasts, abs=3e-4)


def test_a_rough_collision_keeps_momenta_and_loses_the_energy_of_its_work(tmp_path: Path) -> None:
    """Off the centres and with spin: linear and angular momentum stay; energy falls by the work that `power` sums."""
    balls = make(tmp_path, ROUGH)
    motion = collide(balls, (-0.3, 0.05, -0.04), np.array(SPINNING), 0.2)
    p, L = momenta(motion.q, motion.qd)
    assert np.ptp(p, axis=0) == pytest.approx(np.zeros(3), abs=1e-8)
    assert np.ptp(L, axis=0) == pytest.approx(np.zeros(3), abs=1e-8)
    assert motion.energy is not None
    assert motion.energy.total[-1] < 0.95 * motion.energy.total[0]
    assert np.abs(motion.energy.drift).max() < 1e-6


def test_a_radius_is_a_parameter(tmp_path: Path) -> None:
    balls = make(tmp_path, ELASTIC)
    q = np.array(stand((0.3, 0, 0), (0, 0, 0)))
    assert balls("distances", q=q)["distance"] == pytest.approx([0.05])
    larger = balls.with_parameters(R=0.22)
    assert larger("distances", q=q)["distance"] == pytest.approx([-0.02])


def test_centres_that_coincide_are_an_error_with_the_name_of_the_contact(tmp_path: Path) -> None:
    balls, q = make(tmp_path, ROUGH), np.array(stand((0.1, 0.2, 0.3), (0.1, 0.2, 0.3)))
    for name, given in (("exp2", {"qd": np.zeros(12), "u": np.zeros(0)}), ("distances", {})):
        with pytest.raises(KernelError, match="contact hit, whose centres coincide"):
            balls(name, q=q, **given)


def test_arrows_are_the_forces_that_the_kernels_compute(tmp_path: Path) -> None:
    """Of a: m v' + om x (m v) in its own axes, at states in which the spheres press each other."""
    balls, random = make(tmp_path, ROUGH, SHOWN), np.random.default_rng(2)
    for _ in range(5):
        direction = random.normal(size=3)
        q = np.array(stand(tuple(0.23 * direction / np.linalg.norm(direction)), (0, 0, 0)))
        qd = random.normal(size=12)
        qdd = balls("exp2", q=q, qd=qd, u=np.zeros(0))["qdd"]
        expected = MASSES[0] * (qdd[:3] + np.cross(qd[3:6], qd[:3]))
        (load,) = find_loads(balls, q[None], balls("rates", q=q, qd=qd)["rate"][None])
        assert np.linalg.norm(expected) > 1
        assert load.values[0] == pytest.approx(expected, abs=1e-5)


def test_both_spheres_are_drawn_once(tmp_path: Path) -> None:
    """Of two contacts with one sphere: the two that touch it, and itself."""
    text = BALLS.replace("LAW", ELASTIC)
    text += (
        "  - {name: too, body: a, position: [0.3, 0, 0], radius: 0.02, sphere: {body: b, radius: R}, stiffness: 1}\n"
    )
    (tmp_path / "balls.yaml").write_text(text)
    balls = load(tmp_path / "balls.yaml", extent=Extent(("frames",), derivatives=0))
    q = np.array([stand((0.4, 0, 0), (0, 0, 0))] * 2)
    film = make_film([Shown((Part(balls, np.array([0.0, 1.0]), q),))])
    shown = [solid.size for solid in film.actors[0].solids if solid.layer is Layer.CONTACTS]
    assert sorted(size[0] for size in shown) == pytest.approx([0.04, 0.2, 0.3])
