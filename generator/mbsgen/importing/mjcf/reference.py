"""Bodies and joints in one pose -> the inertia that each coordinate feels there.

A coordinate feels 1 / (M^-1)_ii: the force for a unit of acceleration, where all other joints are free. M is the sum of
composite bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2), at the origin of the world.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbsgen.importing.poses import Array, Pose
from mbsgen.importing.solids import Solid


@dataclass(frozen=True, eq=False)
class Degree:
    """A degree of freedom: a turn about a line of the world, or a slide along it."""

    is_turn: bool
    axis: Array  # of length 1
    point: Array  # on the line
    armature: float = 0.0

    @property
    def screw(self) -> Array:
        """Return angular velocity, and velocity at the origin of the world, of a unit of speed."""
        if self.is_turn:
            return np.concatenate([self.axis, np.cross(self.point, self.axis)])
        return np.concatenate([np.zeros(3), self.axis])


@dataclass
class Reference:
    """The bodies of a tree in one pose, each after its parent, and their degrees of freedom."""

    _parents: dict[str, str] = field(default_factory=dict)
    _inertias: dict[str, Array] = field(default_factory=dict)  # of each body alone, 6 by 6
    _degrees: list[tuple[str, Degree]] = field(default_factory=list)

    def add_body(self, name: str, parent: str, home: Pose, solid: Solid) -> None:
        """Add a body on another one, with its solid and the pose of its frame in the world."""
        here = solid.seen_from(home)
        x, y, z = here.com
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turning = here.inertia - here.mass * cross @ cross
        self._parents[name] = parent
        self._inertias[name] = np.block([[turning, here.mass * cross], [-here.mass * cross, here.mass * np.eye(3)]])

    def add_degree(self, body: str, degree: Degree) -> int:
        """Add a degree of freedom of a body, and return its number."""
        self._degrees.append((body, degree))
        return len(self._degrees) - 1

    def find_inertias(self) -> Array:
        """Return the inertia of each degree of freedom [kg m2 or kg]; infinite where M is singular."""
        composites = dict(self._inertias)
        for name in reversed(self._parents):
            if self._parents[name] in composites:
                composites[self._parents[name]] = composites[self._parents[name]] + composites[name]
        screws = np.array([degree.screw for _, degree in self._degrees])
        M = np.zeros((len(screws), len(screws)))
        for j, (body, _) in enumerate(self._degrees):
            momentum = composites[body] @ screws[j]
            carriers = self._list_carriers(body)
            for i, (other, _) in enumerate(self._degrees):
                if other in carriers:
                    M[i, j] = M[j, i] = screws[i] @ momentum
        M += np.diag([degree.armature for _, degree in self._degrees])
        try:
            found: Array = 1.0 / np.diag(np.linalg.inv(M))
        except np.linalg.LinAlgError:
            found = np.full(len(M), np.inf)
        return found

    def _list_carriers(self, body: str) -> set[str]:
        found = set[str]()
        while body in self._parents:
            found.add(body)
            body = self._parents[body]
        return found
