"""Model files: the shipped ones, and two written here."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

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


ROOT = Path(__file__).parents[3]
MODELS = sorted(file for file in (ROOT / "models").glob("*.yaml") if not file.name.endswith(".ocp.yaml"))


def reread(model: Model) -> Model:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "model.yaml"
        file.write_text(write_model(model), encoding="utf-8")
        return read_model(file)
