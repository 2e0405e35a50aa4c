"""Many problems from neighbour to neighbour: cases in trees -> outcomes.

A case starts from the solution of its parent in the tree, with all multipliers, so the first step of Newton's method is
the tangential prediction. Where that has no solution soon, the case is solved from its own guess, and the next
generations below it do not try unless they are nearer to their parents: one after the first failure, two after the
second, then four. All of this depends on the ancestors of a case alone, so neither the order of the list nor the number
of threads or processes changes a result.
"""

from __future__ import annotations

import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mbsrun.ocp.cases.cases import Case, CaseSolver, Outcome
from mbsrun.ocp.cases.tree import Edge
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solving.phases import Neighbour

PART = 0.75  # of the iterations of a solve from a guess, the most that a case tries from its neighbour
FEWEST = 6  # iterations that it tries
NEARER = 0.5  # of the distance at which a try failed, below which the next one is made at once


@dataclass(frozen=True, eq=False)
class Origin:
    """The end of a solve, as the start of its neighbours."""

    neighbour: Neighbour | None  # None: it has no solution, or its method leaves none
    iterations: int  # of the last solve from a guess, among it and its ancestors
    failures: int = 0  # tries that failed since the last one that succeeded
    rest: int = 0  # generations that do not try
    failed: float = np.inf  # the distance of the last failure

    def is_near(self, distance: float) -> bool:
        """Return whether a case at a distance tries to start here."""
        return self.neighbour is not None and (self.rest == 0 or distance < NEARER * self.failed)

    @property
    def most_iterations(self) -> int:
        """Return the iterations that a case tries."""
        return max(FEWEST, int(PART * self.iterations))

    def lead(self, found: Neighbour | None) -> Origin:
        """Return the origin after a try that succeeded."""
        return Origin(found, self.iterations)

    def leave(self, found: Neighbour | None, iterations: int, distance: float, *, has_tried: bool) -> Origin:
        """Return the origin after a solve from a guess: after a try that failed, or without one."""
        if not has_tried:
            return Origin(found, iterations, self.failures, max(0, self.rest - 1), self.failed)
        return Origin(found, iterations, self.failures + 1, 2**self.failures, distance)


Found = tuple[Outcome, Origin]
T = TypeVar("T")
Begin = Callable[[Edge, Origin | None], "Future[tuple[T, Origin]]"]  # of a solve, on a pool


def solve_beside(solver: CaseSolver, case: Case, edge: Edge, origin: Origin | None) -> Found:
    """Solve a case from its parent's solution, or else from its own guess."""
    kept: list[Neighbour] = []
    has_tried = origin is not None and origin.is_near(edge.distance)
    if origin is not None and origin.neighbour is not None and has_tried:
        outcome = solver.solve_near(case, origin.neighbour, origin.most_iterations, kept.append)
        if outcome is not None:
            return outcome, origin.lead(kept[-1] if kept else None)
    kept.clear()
    outcome = solver.solve(case, kept.append)
    found, iterations = kept[-1] if kept else None, outcome.run.iterations
    before = Origin(None, iterations) if origin is None else origin
    return outcome, before.leave(found, iterations, edge.distance, has_tried=has_tried)


def solve_neighbours(
    cases: Sequence[Case], edges: Sequence[Edge], plants: Plants, threads: int = 1
) -> Iterator[tuple[int, Outcome]]:
    """Solve cases along trees; yield the number and the outcome of each as it ends, see `solve_cases`."""
    if threads == 1:
        yield from _go(cases, edges, CaseSolver(plants))
        return
    own = threading.local()

    def begin() -> None:
        own.solver = CaseSolver(plants)

    with ThreadPoolExecutor(threads, initializer=begin) as pool:

        def submit(edge: Edge, origin: Origin | None) -> Future[Found]:
            return pool.submit(lambda: solve_beside(own.solver, cases[edge.case], edge, origin))

        try:
            yield from follow(edges, submit)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _go(cases: Sequence[Case], edges: Sequence[Edge], solver: CaseSolver) -> Iterator[tuple[int, Outcome]]:
    """Solve one case after the other; origins are kept as long as cases wait for them."""
    waiting, origins = Counter(edge.parent for edge in edges), dict[int | None, Origin]()
    for edge in edges:
        outcome, own = solve_beside(solver, cases[edge.case], edge, origins.get(edge.parent))
        if waiting[edge.case]:
            origins[edge.case] = own
        waiting[edge.parent] -= 1
        if not waiting[edge.parent]:
            origins.pop(edge.parent, None)
        yield edge.case, outcome


def follow(edges: Sequence[Edge], begin: Begin[T]) -> Iterator[tuple[int, T]]:
    """Begin each solve when its parent has ended; yield the number and the outcome of each as it ends."""
    waiting = _list_children(edges)
    under_way = {begin(edge, None): edge for edge in waiting.pop(None, [])}
    while under_way:
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            edge = under_way.pop(future)
            outcome, origin = future.result()
            under_way |= {begin(child, origin): child for child in waiting.pop(edge.case, [])}
            yield edge.case, outcome


def _list_children(edges: Sequence[Edge]) -> dict[int | None, list[Edge]]:
    """List the edges below each case; None: of roots."""
    found = defaultdict[int | None, list[Edge]](list)
    for edge in edges:
        found[edge.parent].append(edge)
    return found
