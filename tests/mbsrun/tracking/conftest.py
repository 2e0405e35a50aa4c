"""A puck on a rail: x'' = (u + w) / 2, so that every motion has a closed form."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun import Mechanism
from mbsrun.tracking.mechanisms import load_simulated

PUCK = """
name: puck
gravity: [0, 0, 0]
bodies:
  - name: puck
    joint: {name: x, type: prismatic, axis: x}
    mass: m
parameters: {m: 2}
frames:
  - {name: middle, body: puck}
"""
PUSHED = PUCK + "wrenches:\n  - {name: push, body: puck, force: input}\n"


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the puck, and the same with an external force."""
    folder = tmp_path_factory.mktemp("puck")
    (folder / "puck.yaml").write_text(PUCK, encoding="utf-8")
    (folder / "pushed.yaml").write_text(PUSHED, encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def puck(folder: Path) -> Mechanism:
    """Load the puck."""
    return load_simulated(folder / "puck.yaml")


@pytest.fixture(scope="session")
def pushed(folder: Path) -> Mechanism:
    """Load the puck with an external force."""
    return load_simulated(folder / "pushed.yaml")
