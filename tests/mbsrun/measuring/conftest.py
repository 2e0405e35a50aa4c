"""A small mechanism that has everything: a spring, an open wrench, run-time and differentiated parameters."""

from __future__ import annotations

from pathlib import Path

import pytest

CART = """
name: cart
gravity: [0, 0, -9.81]
parameters:
  k: {value: 7, kind: runtime}
  m: {value: 1.5, kind: differentiated}
bodies:
  - name: cart
    joint: {name: x, type: prismatic, axis: x, stiffness: k, damping: 0.4, limits: [-1, 1]}
    mass: m
  - name: rod
    parent: cart
    joint: {name: turn, type: revolute, axis: y, actuated: false}
    mass: 0.8
    com: [0, 0, -0.4]
    inertia: {xx: 0.04, yy: 0.04, zz: 0}
wrenches:
  - {name: push, body: rod, position: [0, 0, -0.5], force: input}
"""
LOCKED = """
name: locked
gravity: [0, 0, -9.81]
bodies:
  - name: fork
    joint: {name: q1, type: revolute, axis: z}
  - name: cross
    parent: fork
    joint: {name: q2, type: revolute, axis: y, limits: [1.5707963, 1.5707964]}
  - name: body
    parent: cross
    joint: {name: q3, type: revolute, axis: x}
    mass: 1
    com: [0.1, 0.2, 0.3]
    inertia: {xx: 1, yy: 2, zz: 3}
"""


@pytest.fixture
def cart(tmp_path: Path) -> Path:
    """Write the cart's model file."""
    return _write(tmp_path, "cart", CART)


@pytest.fixture
def locked(tmp_path: Path) -> Path:
    """Write the model of a Cardan joint without mass, which stays within 1e-7 rad of its lock."""
    return _write(tmp_path, "locked", LOCKED)


def _write(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return path
