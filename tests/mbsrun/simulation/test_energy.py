"""The motion between two states, at which work and friction are added up: polynomials through both ends."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from mbsrun.simulation.integration.energy import NODES, WEIGHTS, connect, interpolate


def test_nodes_and_weights_are_gauss_legendre_s() -> None:
    """Of as many nodes, on [0, 1]: all moments up to the degree 2 n - 1."""
    n = len(NODES)
    moments = [float(WEIGHTS @ NODES**k) for k in range(2 * n)]
    assert moments == pytest.approx([1 / (k + 1) for k in range(2 * n)], rel=1e-13)


@pytest.mark.parametrize("degree", range(6))
def test_quintics_through_both_ends_are_exact(degree: int, rng: np.random.Generator) -> None:
    """Coordinates, velocities and accelerations of a polynomial of degree 5 give it back, over steps of any length."""
    times = np.array([-0.3, 0.4, 2.0])
    every = [Polynomial(rng.normal(size=degree + 1)) for _ in range(2)]
    q, qd, qdd = (np.stack([p.deriv(k)(times) for p in every], axis=1) for k in range(3))
    place, rate = interpolate(np.diff(times), q, qd, qdd)
    at = times[:-1, None] + np.diff(times)[:, None] * NODES
    for found, k in ((place, 0), (rate, 1)):
        assert found == pytest.approx(np.stack([p.deriv(k)(at) for p in every], axis=2), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("degree", range(4))
def test_cubics_through_both_ends_are_exact(degree: int, rng: np.random.Generator) -> None:
    """Velocities and accelerations of a polynomial of degree 3 give it back, over steps of any length."""
    times = np.array([-0.3, 0.4, 2.0])
    every = [Polynomial(rng.normal(size=degree + 1)) for _ in range(2)]
    qd, qdd = (np.stack([p.deriv(k)(times) for p in every], axis=1) for k in range(2))
    found = connect(np.diff(times), qd, qdd)
    at = times[:-1, None] + np.diff(times)[:, None] * NODES
    assert found == pytest.approx(np.stack([p(at) for p in every], axis=2), rel=1e-12, abs=1e-12)
