"""Chains that are too long for straight C: interpret the equations, and compute matrices of n^2 entries in loops.

In loops, M and c come from the interpreted residual: M e_i = Phi(q, 0, e_i) without gravity, c = Phi(q, qd, 0). EXP1 is
M = LT D L, from the leaves to the base, as the generated kernels have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf

from mbsrun.forms import ACCELERATIONS
from mbsrun.measuring.candidates import Found
from mbsrun.measuring.functions import Precision
from studies.laboratory.digits import Specimen, U
from studies.laboratory.mechanisms import State, States

Array = NDArray[np.float64]

BLOCK = 32  # states that are computed at once: values of all equations are kept for each


class Equations(Protocol):
    """The interface of interpreted equations: results (K, size) for inputs (K, size) by name, and a status."""

    def compute(self, states: States) -> dict[str, Array]: ...

    def find_status(self, state: State) -> int: ...


class LongChain(Specimen):
    """A chain with joints q1 to qN; `impl` and `exp2` are interpreted, and nothing is generated."""

    def __init__(self, model: Path, size: int) -> None:
        """Take a model file with its number of joints."""
        super().__init__(model, ())
        self._model, self._size = model, size

    @property
    def size(self) -> int:
        """Count the joints."""
        return self._size

    def joint(self, status: int) -> str:
        """Name the joint of a status; empty for 0."""
        return f"q{status}" if status > 0 else ""

    def evaluate(self, kernel: str, states: States, precision: Precision = "float64") -> Found:
        """Interpret a kernel on states; return statuses, and results as matrices: none where it fails."""
        assert precision == "float64", "interpreted kernels have double precision"
        equations, count = _write(self._model, kernel, gravity=True), len(states["q"])
        statuses = np.zeros(count, dtype=np.int64)
        if kernel in ACCELERATIONS:
            statuses[:] = [equations.find_status({name: x[k] for name, x in states.items()}) for k in range(count)]
        results: list[dict[str, Array]] = []
        for first in range(0, count, BLOCK):
            found = equations.compute({name: x[first : first + BLOCK] for name, x in states.items()})
            for k in range(min(BLOCK, count - first)):
                is_right = not statuses[first + k]
                results.append({name: x[k][:, None] for name, x in found.items()} if is_right else {})
        return statuses, results

    def _compute_mass(self, state: State) -> Array:
        """Compute M by columns: without gravity, so that nothing is subtracted."""
        n, equations = self.size, _write(self._model, "impl", gravity=False)
        columns = []
        for units in np.array_split(np.eye(n), -(-n // BLOCK)):
            states = {name: np.zeros((len(units), n)) for name in ("qd", "u")}
            states |= {"q": np.tile(state["q"], (len(units), 1)), "qdd": units}
            columns.append(equations.compute(states)["Phi"])
        return np.vstack(columns).T


@dataclass(frozen=True)
class Eliminated:
    """The result of elimination from the leaves."""

    status: int  # the joint whose pivot is lost, by EXP1's bound n u 1000; 0: none
    x: Array | None  # also where a pivot is lost, unless it is no positive number


def eliminate(M: Array, right: Array) -> Eliminated:
    """Solve M x = right by M = LT D L, from the last unknown to the first."""
    n = len(M)
    if not np.isfinite(M).all():
        return Eliminated(n, None)
    factor, failed = dpotrf(M[::-1, ::-1], lower=True)  # of the unknowns in reverse, it is L of LT D L
    if failed:
        return Eliminated(n + 1 - int(failed), None)
    pivots = np.diag(factor)[::-1] ** 2
    lost = np.flatnonzero(~(pivots > 1e3 * n * U["float64"] * np.diag(M)))
    x = solve_triangular(factor, solve_triangular(factor, right[::-1], lower=True), lower=True, trans="T")
    return Eliminated(int(lost[-1]) + 1 if len(lost) else 0, np.asarray(x[::-1]))


@cache
def _write(model: Path, kernel: str, *, gravity: bool) -> Equations:
    from mbsgen.interpreted import Interpreted  # imported late: everything else works without SymPy

    return Interpreted(model, kernel, gravity=gravity)
