"""Mechanisms to simulate, loaded once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mbsrun import Mechanism, load
from mbsrun.models import Extent
from studies.laboratory.mechanisms import SLIDER_AND_BOB

MODELS = Path(__file__).parents[3] / "models"

# At pi/2 the second of three turns makes the others parallel: accelerations are not determined there.
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


def load_texts(factory: pytest.TempPathFactory, extent: Extent) -> Callable[[str], Mechanism]:
    """Return a function that loads a model from its text, each text once."""
    known: dict[str, Mechanism] = {}

    def build(text: str) -> Mechanism:
        if text not in known:
            file = factory.mktemp("model") / "model.yaml"
            file.write_text(text, encoding="utf-8")
            known[text] = load(file, extent=extent)
        return known[text]

    return build


@pytest.fixture(scope="session")
def bench_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the model file of three motions in one."""
    file = tmp_path_factory.mktemp("bench") / "bench.yaml"
    file.write_text(SLIDER_AND_BOB, encoding="utf-8")
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
