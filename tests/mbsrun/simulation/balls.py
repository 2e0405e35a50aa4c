"""Two free bodies that collide: their places, momenta, and laws of contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbsrun.models import Extent
from tests.mbsrun.simulation.extents import choose

Array = NDArray[np.float64]

SIMULATED = choose("exp2", "impl", "energy", "power", "frames", "distances", "rates")
SHOWN = Extent(("exp2", "frames", "rates"), 0)  # for arrows
MASSES, INERTIAS = (2.0, 3.0), (0.02, 0.05)
SPINNING = [0.9, 0.1, 0, 3.0, -2.0, 5.0, -0.3, 0, 0.05, 1.0, 0.0, -4.0]
ELASTIC = "exponent: 1"
ROUGH = "dissipation: 0.5, friction: {coefficient: 0.4, speed: 0.05}"


def stand(a: tuple[float, ...], b: tuple[float, ...]) -> list[float]:
    """Return q with the bodies at two places, without rotation."""
    return [*a, 0, 0, 0, 1, *b, 0, 0, 0, 1]


def momenta(q: Array, v: Array) -> tuple[Array, Array]:
    """Return linear and angular momentum about the origin, of balls whose inertia is a number: (K, 3) each."""
    p, L = np.zeros((len(q), 3)), np.zeros((len(q), 3))
    for k, (m, inertia) in enumerate(zip(MASSES, INERTIAS, strict=True)):
        x, y, z, w = q[:, 7 * k + 3 : 7 * k + 7].T / np.linalg.norm(q[:, 7 * k + 3 : 7 * k + 7], axis=1)
        axes = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        speed, spin = (np.einsum("ijk,kj->ki", axes, v[:, i : i + 3]) for i in (6 * k, 6 * k + 3))
        p += m * speed
        L += np.cross(q[:, 7 * k : 7 * k + 3], m * speed) + inertia * spin
    return p, L
