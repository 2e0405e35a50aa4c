"""The programs of a problem and its variants: each structure is transcribed once, and the latest are kept."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager

from mbsrun.ocp.problem.phases import Link, PhasedProblem, Plants
from mbsrun.ocp.problem.structure import Structure, structure
from mbsrun.ocp.solving.phases import PhasedSolver

KEPT = 8


class Programs:
    """Solvers by the structure of their problems, of the same models."""

    def __init__(self) -> None:
        self._solvers: OrderedDict[tuple[tuple[Structure, ...], tuple[Link, ...]], PhasedSolver] = OrderedDict()
        self._lent = threading.Lock()

    @contextmanager
    def lend(self) -> Iterator[Programs]:
        """Lend the programs to one user at a time, for solves of many cases; who comes meanwhile gets new ones."""
        is_free = self._lent.acquire(blocking=False)
        try:
            yield self if is_free else Programs()
        finally:
            if is_free:
                self._lent.release()

    def look(self, problem: PhasedProblem) -> PhasedSolver | None:
        """Return the solver of a structure, if it was made."""
        return self._solvers.get(identify(problem))

    def find(self, problem: PhasedProblem, plants: Plants) -> PhasedSolver:
        """Return the solver of a structure, and make it where there is none.

        Raises ProblemError as `PhasedSolver` does.
        """
        key = identify(problem)
        if key not in self._solvers:
            self._solvers[key] = PhasedSolver(problem, plants)
        self._solvers.move_to_end(key)
        while len(self._solvers) > KEPT:
            self._solvers.popitem(last=False)
        return self._solvers[key]


def identify(problem: PhasedProblem) -> tuple[tuple[Structure, ...], tuple[Link, ...]]:
    """Return what problems of one program share."""
    return tuple(structure(phase.problem) for phase in problem.phases), problem.links
