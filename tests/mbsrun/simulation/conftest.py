"""Mechanisms to simulate, loaded once for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun import Mechanism, load

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture(scope="session")
def pendulum() -> Mechanism:
    """Load the damped, driven rod."""
    return load(MODELS / "pendulum.yaml")
