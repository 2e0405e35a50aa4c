"""The programs of a problem and its variants: each structure is transcribed once, and the latest are kept."""

from __future__ import annotations

from collections import OrderedDict

from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.structure import Structure, structure

KEPT = 8


class Programs:
    """Solvers by the structure of their problems."""

    def __init__(self) -> None:
        self._solvers: OrderedDict[Structure, Solver] = OrderedDict()

    def look(self, problem: Problem) -> Solver | None:
        """Return the solver of a structure, if it was made."""
        return self._solvers.get(structure(problem))

    def find(self, problem: Problem, plant: Plant) -> Solver:
        """Return the solver of a structure, and make it where there is none. Raises ProblemError as `Solver` does."""
        key = structure(problem)
        if key not in self._solvers:
            self._solvers[key] = Solver(problem, plant)
        self._solvers.move_to_end(key)
        while len(self._solvers) > KEPT:
            self._solvers.popitem(last=False)
        return self._solvers[key]
