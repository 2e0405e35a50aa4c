"""Many problems from neighbour to neighbour: cases in layers -> outcomes.

A case starts from the solutions of its nearest sources, with all multipliers: from a mixture of them that is right to
first order at least, after which the first step of Newton's method is the tangential prediction. Where that has no
solution soon, the case is solved from its own guess. A case does not try where its sources did not save iterations,
unless it is nearer to them than they were to theirs. All of this depends on the ancestors of a case alone, so neither
the order of the list nor the number of threads or processes changes a result.
"""

from __future__ import annotations

import math
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import TypeVar

from mbsrun.ocp.cases.cases import Case, CaseSolver, Outcome
from mbsrun.ocp.cases.layers import Start, weigh
from mbsrun.ocp.methods import mix
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solving.phases import Neighbour

PART = 1.0  # of the iterations of a solve from a guess, the most that a case tries from its neighbours
FEWEST = 6  # iterations that it tries
HOPED = 0.75  # of these iterations, before any try


@dataclass(frozen=True, eq=False)
class Origin:
    """The end of a solve, as the start of its neighbours."""

    neighbour: Neighbour | None  # None: it has no solution, or its method leaves none
    iterations: int  # of the last solve from a guess, among it and its ancestors
    share: float = HOPED  # iterations of a start from neighbours, with all that follow a failure, over these
    distance: float = 0.0  # of the sources of that start
    expected: float = HOPED  # the share of a case that starts here

    @property
    def is_worth_a_try(self) -> bool:
        """Return whether a case starts here."""
        return self.neighbour is not None and self.expected < 1

    @property
    def most_iterations(self) -> int:
        """Return the iterations that a case tries."""
        return max(FEWEST, int(PART * self.iterations))

    def expect(self, distance: float) -> float:
        """Return the share of a start at a distance: smaller where sources are nearer than they were."""
        return self.share * min(1.0, distance / self.distance) if self.distance else self.share

    def lead(self, found: Neighbour | None, tried: int, distance: float) -> Origin:
        """Return the origin after a try that succeeded."""
        return Origin(found, self.iterations, tried / max(1, self.iterations), distance)

    def leave(self, found: Neighbour | None, iterations: int, distance: float) -> Origin:
        """Return the origin after a solve from a guess: after a try that failed, or without one."""
        failed = 1 + self.most_iterations / max(1, iterations)
        return Origin(found, iterations, failed if self.is_worth_a_try else self.expected, distance)


def gather(start: Start, origins: Mapping[int, Origin]) -> Origin | None:
    """Return the origin of the nearest source, with a mixture of the solutions of all sources; None: there is none.

    The expected share is the mean of the ones that the sources expect.
    """
    if start.parent is None:
        return None
    own = origins[start.parent]
    distance = start.distance
    shares = [origins[source.case].expect(distance) for source in start.sources]
    own = replace(own, expected=math.fsum(shares) / len(shares))
    if own.neighbour is None or not own.is_worth_a_try:
        return own
    parts = [(source, origins[source.case].neighbour) for source in start.sources]
    known = [(source, found) for source, found in parts if found is not None and found.near.fits(own.neighbour.near)]
    near = mix([found.near for _, found in known], weigh([source for source, _ in known]))
    return replace(own, neighbour=replace(own.neighbour, near=near))


Found = tuple[Outcome, Origin]
T = TypeVar("T")
Begin = Callable[[Start, Origin | None], "Future[tuple[T, Origin]]"]  # of a solve, on a pool


def solve_beside(solver: CaseSolver, case: Case, start: Start, origin: Origin | None) -> Found:
    """Solve a case from its sources' solutions, or else from its own guess."""
    kept: list[Neighbour] = []
    if origin is not None and origin.neighbour is not None and origin.is_worth_a_try:
        outcome = solver.solve_near(case, origin.neighbour, origin.most_iterations, kept.append)
        if outcome is not None:
            return outcome, origin.lead(kept[-1] if kept else None, outcome.run.iterations, start.distance)
    kept.clear()
    outcome = solver.solve(case, kept.append)
    found, iterations = kept[-1] if kept else None, outcome.run.iterations
    return outcome, Origin(found, iterations) if origin is None else origin.leave(found, iterations, start.distance)


def solve_neighbours(
    cases: Sequence[Case], starts: Sequence[Start], plants: Plants, threads: int = 1
) -> Iterator[tuple[int, Outcome]]:
    """Solve cases in layers; yield the number and the outcome of each as it ends, see `solve_cases`."""
    if threads == 1:
        yield from _go(cases, starts, CaseSolver(plants))
        return
    own = threading.local()

    def begin() -> None:
        own.solver = CaseSolver(plants)

    with ThreadPoolExecutor(threads, initializer=begin) as pool:

        def submit(start: Start, origin: Origin | None) -> Future[Found]:
            return pool.submit(lambda: solve_beside(own.solver, cases[start.case], start, origin))

        try:
            yield from follow(starts, submit)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


class Waiting:
    """Starts that wait for their sources, whose origins are kept as long as one of them does."""

    def __init__(self, starts: Sequence[Start]) -> None:
        self.origins: dict[int, Origin] = {}
        self._users = Counter(source.case for start in starts for source in start.sources)
        self._lacking = {start.case: len(start.sources) for start in starts}
        self._children = defaultdict[int, list[Start]](list)
        for start in starts:
            for source in start.sources:
                self._children[source.case].append(start)

    def gather(self, start: Start) -> Origin | None:
        """Return the origin of a start whose sources have ended."""
        found = gather(start, self.origins)
        for source in start.sources:
            self._users[source.case] -= 1
            if not self._users[source.case]:
                del self.origins[source.case]
        return found

    def end(self, case: int, origin: Origin) -> Iterator[Start]:
        """Keep the origin of a case that has ended, and yield the starts that lack no source any more."""
        if self._users[case]:
            self.origins[case] = origin
        for child in self._children.pop(case, []):
            self._lacking[child.case] -= 1
            if not self._lacking[child.case]:
                yield child


def _go(cases: Sequence[Case], starts: Sequence[Start], solver: CaseSolver) -> Iterator[tuple[int, Outcome]]:
    """Solve one case after the other."""
    waiting = Waiting(starts)
    for start in starts:
        outcome, own = solve_beside(solver, cases[start.case], start, waiting.gather(start))
        for _ in waiting.end(start.case, own):
            pass  # they come in the order of the starts
        yield start.case, outcome


def follow(starts: Sequence[Start], begin: Begin[T]) -> Iterator[tuple[int, T]]:
    """Begin each solve when its sources have ended; yield the number and the outcome of each as it ends."""
    waiting = Waiting(starts)
    under_way = {begin(start, None): start for start in starts if not start.sources}
    while under_way:
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            start = under_way.pop(future)
            outcome, origin = future.result()
            ready = waiting.end(start.case, origin)
            under_way |= {begin(child, waiting.gather(child)): child for child in ready}
            yield start.case, outcome
