"""Reference results in 50 digits by the textbook recursion: residual, mass matrix, accelerations, derivatives.

    M e_i = Phi(q, 0, e_i) - Phi(q, 0, 0),    c = Phi(q, qd, 0),    M qdd = Q - c

Derivatives of r = Phi - Q are central differences with a step of 1e-15: in 50 digits their error is about 1e-28.
Derivatives of accelerations follow from the implicit function theorem. The reference shares no code with kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Arguments = Mapping[str, Sequence[Any]]
Equations = Callable[[Arguments], dict[str, list[Any]]]  # the state -> Phi and Q

DIGITS = 50
STEP = "1e-15"  # of central differences; the error is of second order


class Reference:
    """The equations of motion of a model file, in 50 digits."""

    def __init__(self, model: Path) -> None:
        """Read a model file. Raises InputError with all faults."""
        from mbsgen.oracle import Oracle  # imported late: everything else works without SymPy

        self._oracle = Oracle(model)
        self.context = mpmath.MPContext()
        self.context.dps = DIGITS

    def at(self, state: Mapping[str, Array]) -> Moment:
        """Return the equations at one state: q, qd, qdd (n,), u (m,), and the other inputs of the model."""
        exact = {name: [self.context.mpf(float(x)) for x in state[name]] for name in self._oracle.inputs}
        return Moment(exact, self._oracle.evaluate, self.context)


@dataclass(frozen=True)
class Moment:
    """One state. Matrices are lists of rows; all numbers have 50 digits."""

    state: Arguments
    equations: Equations
    context: Any

    def residual(self, **changes: Sequence[Any]) -> list[Any]:
        """Compute Phi - Q here, or with other values of some inputs."""
        found = self.equations({**self.state, **changes})
        return [a - b for a, b in zip(found["Phi"], found["Q"], strict=True)]

    @property
    def size(self) -> int:
        """Count the coordinates."""
        return len(self.state["q"])

    @cached_property
    def forces(self) -> list[Any]:
        """Compute Q: inputs, springs, dampers, friction."""
        return self.equations(self.state)["Q"]

    @cached_property
    def bias(self) -> list[Any]:
        """Compute c, the residual without accelerations and Q."""
        return self.equations({**self.state, "qdd": [0] * self.size})["Phi"]

    @cached_property
    def M(self) -> list[list[Any]]:
        """Compute the mass matrix."""
        n = self.size
        still = self.residual(qd=[0] * n, qdd=[0] * n)
        columns = [self.residual(qd=[0] * n, qdd=_unit(n, i)) for i in range(n)]
        return [[columns[j][i] - still[i] for j in range(n)] for i in range(n)]

    @cached_property
    def qdd(self) -> list[Any]:
        """Solve for the accelerations."""
        return self.solve([Q - c for Q, c in zip(self.forces, self.bias, strict=True)])

    def solve(self, right: Sequence[Any]) -> list[Any]:
        """Solve M x = right."""
        return list(self.context.lu_solve(self.context.matrix(self.M), self.context.matrix(list(right))))

    def slopes(self, name: str, qdd: Sequence[Any]) -> list[list[Any]]:
        """Differentiate the residual at accelerations `qdd` by an input: a row for each entry of the input."""
        step = self.context.mpf(STEP)
        state = {**self.state, "qdd": qdd}
        rows = []
        for k in range(len(self.state[name])):
            low, high = list(state[name]), list(state[name])
            low[k], high[k] = low[k] - step, high[k] + step
            ends = self.residual(**{**state, name: high}), self.residual(**{**state, name: low})
            rows.append([(b - a) / (2 * step) for b, a in zip(*ends, strict=True)])
        return rows

    def scale(self, qdd: Sequence[Any]) -> Array:
        """Compute |M| |qdd| + |c| + |Q|, the scale of the residual, entry by entry."""
        terms = [sum(abs(a) * abs(b) for a, b in zip(row, qdd, strict=True)) for row in self.M]
        parts = zip(terms, self.bias, self.forces, strict=True)
        return np.array([float(t + abs(c) + abs(Q)) for t, c, Q in parts])


def _unit(n: int, i: int) -> list[int]:
    return [int(k == i) for k in range(n)]
