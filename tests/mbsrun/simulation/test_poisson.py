"""Impacts by Poisson's hypothesis beside Newton's: closed forms of a rod and of balls in a row, and energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun import Mechanism, load
from mbsrun.simulation import Impacts, Motion, Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.integration.methods import find_refusals
from tests.mbsrun.simulation.planar import HALF, NEEDED, ROD, grip

ROW = """
name: row
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: prismatic, axis: x, actuated: false}, mass: 1}
  - {name: b, joint: {type: prismatic, axis: x, actuated: false}, mass: 1}
  - {name: c, joint: {type: prismatic, axis: x, actuated: false}, mass: 1}
stops:
  - {name: ab, quantity: q_b - q_a, limits: [0, null], restitution: FIRST}
  - {name: bc, quantity: q_c - q_b, limits: [0, null], restitution: 1}
"""


@pytest.fixture(scope="module")
def rod(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    file: Path = tmp_path_factory.mktemp("model") / "rod.yaml"
    file.write_text(ROD, encoding="utf-8")
    return load(file, extent=NEEDED).with_parameters(gx=0.0, gz=0.0)


def strike(rod: Mechanism, angle: float, friction: float, e: float, qd: list[float], law: Impacts) -> Motion:
    """Hit the ground with the tip of a rod at an angle, at once."""
    q = [0, HALF * np.cos(angle), angle]
    return simulate(grip(rod, friction, e), hold([]), q, qd, Settings(1e-3, impacts=law, output_step=1e-3))


def lose(motion: Motion) -> float:
    assert motion.halt is None
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    return float(motion.energy.impacts[-1] / motion.energy.kinetic[0])


def test_a_rod_that_sticks_rebounds_by_its_impulses(rod: Mechanism) -> None:
    """Compression ends the motion of the tip; e of its impulse moves it away, and friction holds it on its way."""
    angle, e, qd = 0.6, 0.7, np.array([-0.8, -1.0, 0.2])
    s, c, inertia = HALF * np.sin(angle), HALF * np.cos(angle), HALF**2 / 3
    v = np.array([qd[0] - c * qd[2], qd[1] + s * qd[2]])  # of the tip: along, and normal
    A = np.array([[1 + c**2 / inertia, -c * s / inertia], [-c * s / inertia, 1 + s**2 / inertia]])
    pressed = np.linalg.solve(A, -v)
    expanded = np.array([-A[0, 1] / A[0, 0], 1.0]) * e * pressed[1]
    friction = 2 * max(abs(pressed[0] / pressed[1]), abs(expanded[0] / expanded[1]))
    motion = strike(rod, angle, friction, e, qd.tolist(), Impacts.POISSON)
    along, normal = pressed + expanded
    after = qd + np.array([along, normal, (s * normal - c * along) / inertia])
    assert motion.qd[-1] == pytest.approx(after, abs=1e-12)
    ratio = (after[1] + s * after[2]) / -v[1]
    assert abs(ratio - e) > 0.05  # Newton's law has e


def test_newtons_law_creates_energy_with_friction_and_poissons_does_not(rod: Mechanism) -> None:
    """Kane's paradox: in some impacts of a rod in which its slip ends."""
    lost = {law: list[float]() for law in Impacts}
    for seed in range(24):
        rng = np.random.default_rng(seed)
        angle, friction, e = rng.uniform(-1.3, 1.3), rng.uniform(0.1, 2), rng.random()
        qd = rng.normal(size=3)
        qd *= -np.sign(qd[1] + HALF * np.sin(angle) * qd[2])
        for law in Impacts:
            lost[law].append(lose(strike(rod, angle, friction, e, qd.tolist(), law)))
    assert min(lost[Impacts.NEWTON]) < -0.02
    assert min(lost[Impacts.POISSON]) > -1e-12


@pytest.mark.parametrize(
    ("law", "first", "speeds"),
    [
        (Impacts.NEWTON, 1.0, (-1 / 3, 2 / 3, 2 / 3)),
        (Impacts.POISSON, 1.0, (-1 / 3, 2 / 3, 2 / 3)),
        (Impacts.NEWTON, 0.5, (0, 1 / 2, 1 / 2)),
        (Impacts.POISSON, 0.5, (0, 1 / 3, 2 / 3)),
    ],
)
def test_balls_in_a_row_by_both_laws(law: Impacts, first: float, speeds: tuple[float, ...], tmp_path: Path) -> None:
    """In compression all three get 1/3, by impulses of 2/3 and 1/3; with one restitution both laws are the same."""
    file = tmp_path / "row.yaml"
    file.write_text(ROW.replace("FIRST", str(first)), encoding="utf-8")
    motion = simulate(
        load(file, extent=NEEDED), hold([]), [-0.1, 0, 0], [1, 0, 0], Settings(0.2, impacts=law, output_step=0.1)
    )
    assert motion.qd[-1] == pytest.approx(speeds, abs=1e-12)


def test_poissons_law_needs_rigid_contacts_from_event_to_event(rod: Mechanism) -> None:
    for method, count in (("dop853", 0), ("moreau", 1)):
        found = [key for key, *_ in find_refusals(Settings(1.0, method, impacts=Impacts.POISSON), rod.manifest)]
        assert found == ["impacts"] * count
