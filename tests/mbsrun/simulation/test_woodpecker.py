"""The woodpecker toy: a sleeve that slides down a pole and jams on it, and a bird on a spring that pecks at the pole.

Numbers, small angles, and the state in which the limit cycle is entered are the published ones: Glocker, "Dynamik von
Starrkoerpersystemen mit Reibung und Stoessen" (1995); Leine, Glocker, van Campen, "Nonlinear dynamics of the woodpecker
toy", ASME DETC (2001). Lengths in place of angles make their linear equations exact: lever = l_M times the angle of the
sleeve, bird = l_G times the angle of the bird, and points that follow them in proportion.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbsrun import load
from mbsrun.simulation import Kind, Settings, simulate
from mbsrun.simulation.drive import hold
from tests.mbsrun.simulation.planar import NEEDED

LEVER, ARM = 0.010, 0.015  # l_M, l_G
JAMMED = -0.0006 / 0.0058  # angle of the sleeve that touches the pole
WOODPECKER = """
name: woodpecker
gravity: [0, 0, -9.81]
parameters: {l_M: 0.010, l_G: 0.015, l_S: 0.0201, h_M: 0.0058, h_S: 0.02, r_M: 0.0031, r_0: 0.0025}
bodies:
  - {name: sleeve, joint: {name: y, type: prismatic, axis: z, actuated: false}, mass: 0.0003}
  - name: lever
    parent: sleeve
    joint: {name: lever, type: prismatic, axis: z, actuated: false, armature: 5e-9/l_M**2}
  - name: bird
    parent: lever
    joint: {name: bird, type: prismatic, axis: z, actuated: false, armature: 7e-7/l_G**2}
    mass: 0.0045
  - {name: half, mass: 1e-18, joint: {name: coil_M, type: prismatic, axis: x, follows: {joint: lever, ratio: 1/l_M}}}
  - name: coil
    parent: half
    mass: 1e-18
    joint: {name: coil_S, type: prismatic, axis: x, follows: {joint: bird, ratio: -1/l_G}}
  - name: beak
    mass: 1e-18
    parent: lever
    joint:
      - {name: beak_z, type: prismatic, axis: z, follows: {joint: bird, ratio: (l_G - l_S)/l_G}}
      - {name: beak_x, type: prismatic, axis: x, follows: {joint: bird, ratio: -h_S/l_G}}
  - name: top
    mass: 1e-18
    parent: sleeve
    joint:
      - {name: top_z, type: prismatic, axis: z, follows: {joint: lever, ratio: r_M/l_M}}
      - {name: top_x, type: prismatic, axis: x, follows: {joint: lever, ratio: h_M/l_M}}
  - name: bottom
    mass: 1e-18
    parent: sleeve
    joint:
      - {name: bottom_z, type: prismatic, axis: z, follows: {joint: lever, ratio: r_M/l_M}}
      - {name: bottom_x, type: prismatic, axis: x, follows: {joint: lever, ratio: -h_M/l_M}}
forces:
  - {name: spring, from: {body: base, position: [-10, 0, 0]}, to: {body: coil}, stiffness: 0.0056, rest: 10}
contacts:
  - name: beak
    body: beak
    position: [l_M + l_G - l_S - r_0, 0, 0]
    plane: {normal: [1, 0, 0]}
    restitution: 0.5
    friction: {coefficient: 0.3}
  - name: top
    body: top
    position: [r_M - r_0, 0, 0]
    plane: {normal: [1, 0, 0]}
    restitution: 0
    friction: {coefficient: 0.3}
  - name: bottom
    body: bottom
    position: [r_M - r_0, 0, 0]
    plane: {normal: [1, 0, 0]}
    restitution: 0
    friction: {coefficient: 0.3}
"""
CYCLE = [
    ("top", Kind.STICK),  # the sleeve jams, and the bird swings out and back
    ("top", Kind.SLIP),
    ("top", Kind.LEAVE),  # it is free, and both fall
    ("bottom", Kind.IMPACT),
    ("beak", Kind.IMPACT),
    ("bottom", Kind.IMPACT),
    ("bottom", Kind.REST),
    ("bottom", Kind.LEAVE),
    ("top", Kind.IMPACT),
    ("top", Kind.IMPACT),
    ("top", Kind.REST),  # it jams again
]


def test_a_woodpecker_goes_through_its_published_cycle(tmp_path: Path) -> None:
    """From the published state of the cycle it returns there, to 1 % of its velocities, and as much lower as it loses.

    The published numbers are of time stepping: their sleeve is 1 micrometre within the pole.
    """
    file = tmp_path / "model.yaml"
    file.write_text(WOODPECKER, encoding="utf-8")
    toy, start = load(file, extent=NEEDED), ([0, JAMMED * LEVER, -0.2788 * ARM], [-0.3411, 0, -7.4583 * ARM])
    motion = simulate(toy, hold([]), *start, Settings(0.15, "rk45", rtol=1e-10, atol=1e-10, output_step=1e-4))
    assert motion.halt is None
    assert [(event.joint, event.kind) for event in motion.events] == CYCLE
    assert all(motion[f"gap_{name}"].min() > -1e-15 for name in ("beak", "top", "bottom"))
    returns = int(np.flatnonzero((motion.t > 0.13) & (motion.q[:, 2] < -0.2788 * ARM))[0])
    fall, lever, bird = motion.qd[returns] / [1, LEVER, ARM]
    assert abs(fall / -0.3411 - 1) < 0.01
    assert abs(lever) < 1e-12
    assert abs(bird / -7.4583 - 1) < 0.01
    assert abs(motion.q[returns, 1] - start[0][1]) < 1e-15
    energy = motion.energy
    assert energy is not None
    assert energy.friction is not None
    assert energy.impacts is not None
    assert (np.diff(energy.friction) > -1e-15).all()
    assert (np.diff(energy.impacts) >= 0).all()
    assert np.abs(energy.drift).max() < 1e-8 * (energy.friction[-1] + energy.impacts[-1])
