"""Mechanisms to simulate, loaded once for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun import Mechanism, load

MODELS = Path(__file__).parents[3] / "models"

# Three motions that do not meet: a point mass of 1 kg on a massless rod of 1 m (IFToMM's A01), which a force can push;
# a spring and a damper with 0.3 kg; and a mass whose own force drives it away, x'' = b x^3.
BENCH = """
name: bench
gravity: [0, -9.81, 0]
parameters:
  k: {value: 40, kind: runtime}
  c: {value: 0, kind: runtime}
  b: {value: 0, kind: runtime}
bodies:
  - name: bob
    joint: {type: revolute, axis: z, actuated: false}
    mass: 1
    com: [0, -1, 0]
  - name: slider
    joint: {type: prismatic, axis: x, stiffness: k, damping: c, limits: [-1, 1]}
    mass: 0.3
  - name: runner
    joint: {type: prismatic, axis: x, actuated: false, force: b*q**3}
    mass: 1
frames:
  - {name: tip, body: bob, position: [0, -1, 0]}
wrenches:
  - {name: push, body: bob, position: [0, -1, 0], frame: base, force: input}
"""

# The second of three turns makes the others parallel at pi/2: no acceleration can be told there.
LOCK = """
name: lock
gravity: [0, 0, 0]
bodies:
  - name: first
    joint: {type: revolute, axis: z}
  - name: second
    parent: first
    joint: {type: revolute, axis: y}
  - name: third
    parent: second
    joint: {type: revolute, axis: x}
    mass: 1
    com: [0.1, 0.2, 0.3]
    inertia: [1, 2, 2.9]
"""


@pytest.fixture(scope="session")
def bench_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the model file of three motions in one."""
    file = tmp_path_factory.mktemp("bench") / "bench.yaml"
    file.write_text(BENCH, encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def bench(bench_file: Path) -> Mechanism:
    """Load the three motions in one."""
    return load(bench_file)


@pytest.fixture(scope="session")
def lock(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """Load three turns about one point, which can lock."""
    file = tmp_path_factory.mktemp("lock") / "lock.yaml"
    file.write_text(LOCK, encoding="utf-8")
    return load(file)


@pytest.fixture(scope="session")
def pendulum() -> Mechanism:
    """Load the damped, driven rod."""
    return load(MODELS / "pendulum.yaml")


@pytest.fixture(scope="session")
def double_pendulum() -> Mechanism:
    """Load two rods that move each other."""
    return load(MODELS / "double_pendulum.yaml")
