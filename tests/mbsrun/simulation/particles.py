"""Particles on flat floors, in place of a mechanism: what contacts need of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.course import stand
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.formulation import Formulation

Array = NDArray[np.float64]

UP = (0.0, 1.0)  # of coordinates x, z


@dataclass(frozen=True)
class Floor:
    """A point whose distance from the other side is row q + offset; with another way across."""

    row: tuple[float, ...] = UP
    along: tuple[float, ...] = ()  # velocities in x, by qd; the normal is z
    offset: float = 0.0
    restitution: float = 0.0
    coefficient: float = 0.0
    hold: float = 0.0
    name: str = "floor"
    is_stop: bool = False
    is_coupling: bool = False


@dataclass(frozen=True)
class Kernels:
    """Kernels of flat floors."""

    floors: tuple[Floor, ...]
    calls: list[str] = field(default_factory=list)

    @property
    def manifest(self) -> Any:
        """Return the contacts."""
        return SimpleNamespace(rigid=self.floors)

    def __call__(self, name: str, q: Array) -> dict[str, Array]:
        self.calls.append(name)
        K, n, count = len(q), q.shape[1], len(self.floors)
        if name == "jac_touching":
            return {
                "jac_slide_q": np.zeros((K, n, count, 3, n)),
                "jac_direction_q": np.zeros((K, count, 3, n)),
            }
        rows = np.array([floor.row for floor in self.floors])
        slide = np.zeros((K, count, 3, n))
        slide[:, :, 2] = rows
        slide[:, :, 0] = [floor.along or np.zeros(n) for floor in self.floors]
        normal = np.zeros((K, 3, count))
        normal[:, 2] = 1
        return {"clearance": q @ rows.T + [x.offset for x in self.floors], "direction": normal, "slide": slide}


@dataclass(frozen=True)
class Particles:
    """M qdd = force(q, qd) + the forces of floors."""

    kernels: Kernels
    M: Array
    force: Callable[[Array, Array], Array]  # (K, n) twice -> (K, n)
    formulation: Any = Formulation.SEMI
    effort: Any = field(default_factory=lambda: SimpleNamespace(steps=0, rejected=None))
    kept: dict[str, Any] = field(default_factory=dict)
    course: Any = field(default_factory=lambda: stand([]))

    @property
    def size(self) -> int:
        """Count the velocities."""
        return len(self.M)

    places = size

    def rates(self, _q: Array, qd: Array) -> Array:
        """Return the rates of coordinates."""
        return qd

    def mass_matrix(self, q: Array, _qd: Array, _v: Array) -> Array:
        """Return the mass matrix, as often as there are states."""
        return np.broadcast_to(self.M, (*q.shape[:-1], *self.M.shape))

    def residual(self, q: Array, qd: Array, qdd: Array, _v: Array) -> Array:
        """Return what is missing to the equations."""
        return qdd @ self.M - self.force(q, qd)

    def solve(self, M: Array, right: Array) -> Array:
        """Return M^-1 right."""
        return np.asarray(np.linalg.solve(M, right[..., None])[..., 0])


def drop(*floors: Floor, pull: Sequence[float] = (0.0, -10.0), M: Sequence[Sequence[float]] | None = None) -> Any:
    """Make particles under constant forces."""
    given = np.array(pull)
    mass = np.eye(len(pull)) if M is None else np.array(M)
    return Particles(Kernels(floors or (Floor(),)), mass, lambda q, _: np.broadcast_to(given, q.shape))


def wait(start: float, end: float) -> Piece:
    """Return a piece without inputs."""
    return Piece(start, end, lambda t: np.zeros((len(t), 0)), True)
