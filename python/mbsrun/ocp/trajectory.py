"""A motion on the grid of a collocation: states at its mesh and collocation points, accelerations, inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator


def _read_array(value: Any) -> NDArray[np.float64]:
    array = np.array(value, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError("a number is not finite")
    return array


Array = Annotated[NDArray[np.float64], PlainValidator(_read_array), PlainSerializer(lambda array: array.tolist())]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion; n coordinates, m inputs, N intervals with d points each. Times in s, the rest in SI units."""

    t: Array  # (N + 1,)
    q: Array  # (N + 1, n)
    qd: Array  # (N + 1, n)
    u: Array  # (N, m): constant from t[k] to t[k + 1]
    point_t: Array  # (N, d)
    point_q: Array  # (N, d, n)
    point_qd: Array  # (N, d, n)
    point_qdd: Array  # (N, d, n)

    def __post_init__(self) -> None:
        N, d, n = self.point_q.shape
        shapes = [(N + 1,), (N + 1, n), (N + 1, n), (N, self.u.shape[1]), (N, d), (N, d, n), (N, d, n), (N, d, n)]
        arrays = (self.t, self.q, self.qd, self.u, self.point_t, self.point_q, self.point_qd, self.point_qdd)
        if [array.shape for array in arrays] != shapes:
            raise ValueError("the arrays of a trajectory do not fit together")


def grid(
    horizon: float, intervals: int, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give the times of the mesh points (N + 1,), and of the collocation points (N, d), `points` being in (0, 1]."""
    t = np.linspace(0.0, horizon, intervals + 1)
    return t, t[:-1, None] + points * (horizon / intervals)
