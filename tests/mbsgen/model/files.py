"""Model files: the shipped ones, and three written here."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from mbsgen.errors import Fault, InputError
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model

GOOD = """\
name: crane
gravity: [0, 0, -g]
parameters:
  g: 9.81
  l: 2
  m: {value: 3, kind: runtime}
bodies:
  - name: cart
    joint: {name: q1, type: prismatic, axis: x, limits: [-1, 1]}
    mass: 10
  - name: boom
    parent: cart
    joint:
      type: revolute
      axis: [0, 0.6, 0.8]
      position: [0, 0, l/2]
      orientation: [{axis: z, angle: pi/2}]
      actuated: false
    mass: m
    com: [l/2, 0, 0]
    inertia: {xx: 0.1, yy: 1, zz: 1, xy: 0.05}
  - name: hook
    parent: boom
    joint: {type: revolute, axis: -y, position: [l, 0, 0]}
    mass: 0.5
    com: [0, 0, -0.1]
    inertia: [1e-3, 1e-3, 1e-3]
frames:
  - {name: tip, body: boom, position: [l, 0, 0]}
"""
WALKER = """\
name: walker
gravity: [0, 0, -9.81]
parameters:
  k: 50
  push: {value: 2, kind: runtime}
bodies:
  - name: trunk
    joint:
      type: floating
      order: xyz
      axes: {rz: {limits: [-1, 1], damping: 2}}
    mass: 10
    inertia: [1, 1, 1]
  - name: pack
    parent: trunk
    joint: {type: fixed, position: [-0.2, 0, 0.1]}
    mass: 2
  - name: leg
    parent: trunk
    joint:
      - {type: revolute, axis: x, stiffness: k, rest: 0.1}
      - {type: prismatic, axis: z, friction: {torque: 1, speed: 0.01}, force: -k*q**3}
    mass: 1
    com: [0, 0.1, -0.3]
    inertia: [0.1, 0.1, 0.01]
  - name: arm
    parent: pack
    joint: {type: cardan, position: [0, 0.3, 0]}
    mass: 1
    com: [0, 0.3, 0]
    inertia: [0.1, 0.01, 0.1]
frames:
  - {name: toe, body: leg}
wrenches:
  - {name: ground, body: leg, position: [0, 0, -0.5], frame: base, force: input}
  - name: wind
    body: pack
    frame: body
    force: [push, 0, 0]
"""
LINKAGE = """\
name: linkage
gravity: [0, 0, -9.81]
parameters:
  a: 0.2
  m: {value: 3, kind: runtime}
bodies:
  - name: crank
    joint: {name: q1, type: revolute, axis: y, actuated: false}
    mass: 1
    com: [0, 0, a/2]
  - name: coupler
    parent: crank
    joint: {name: q2, type: revolute, axis: y, position: [0, 0, a], actuated: false}
    mass: 1
    com: [0.2, 0, 0]
  - name: rocker
    joint: {name: q3, type: revolute, axis: y, position: [0.4, 0, 0], actuated: false}
    mass: 1
    com: [0, 0, 0.1]
  - name: slider
    joint: {name: q4, type: prismatic, axis: x, position: [0.8, 0, 0.2]}
    mass: m
  - {name: bolt, parent: slider, joint: {type: fixed, position: [0, 0, 0.1]}, mass: 0.1}
  - {name: post, joint: {type: fixed, position: [1, 0, 0]}, mass: 1}
  - {name: ball, parent: slider, joint: {type: ball}, mass: 1, inertia: [1, 1, 1]}
loops:
  - name: knee
    type: hinge
    from: {body: coupler, position: [0.4, 0, 0]}
    to: {body: rocker, position: [0, 0, 0.2], orientation: [{axis: y, angle: 0.3}]}
    axis: y
  - {name: strut, type: rod, from: {body: rocker, position: [0, 0, 0.2]}, to: {body: slider}, length: 0.4}
constraints:
  - {name: cam, equation: q4 - a*sin(q1)}
driven: [q1]
independent: [q1]
assembly: {q2: 0.1, ball.rx: pi/2}
"""


ROOT = Path(__file__).parents[3]


def reread(model: Model) -> Model:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "model.yaml"
        file.write_text(write_model(model), encoding="utf-8")
        return read_model(file)


def find_faults(text: str, folder: Path) -> tuple[Fault, ...]:
    """Read a model file that is refused, and return its faults."""
    file = folder / "model.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_model(file)
    return caught.value.faults
