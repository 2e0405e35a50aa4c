"""Many problems from neighbour to neighbour: cases in layers -> outcomes.

A case starts from the solutions of its nearest sources, with all multipliers: from a mixture of them that is right to
first order at least, after which the first step of Newton's method is the tangential prediction. Where that has no
solution soon, the case is solved from its own guess. Iterations of tries, with the ones of the solves that follow
failures, are compared with iterations of solves from guesses. A case does not try where its sources did not save a
quarter of them, unless it is nearer to its sources than they were to theirs: a small gain is not sure, and iterations
of a try take longer. As long as no try of its sources succeeded, only probes try: the first cases, and then each second
one. All of this depends on the ancestors of a case alone, so neither the order of the list nor the number of threads or
processes changes a result.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import TypeVar

from scipy import sparse

from mbsrun.ocp.cases.cases import AnyCase, CaseSolver, Found, Outcome, Try, read
from mbsrun.ocp.cases.layers import Source, Start, weigh
from mbsrun.ocp.cases.programs import Programs
from mbsrun.ocp.methods import Near, mix_many
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solving.phases import Neighbour

PART = 1.0  # of the iterations of a solve from a guess, the most that a case tries from its neighbours
FEWEST = 10  # iterations that it tries
BLOCK = 64  # cases that are solved at once, at most
SECONDS = 2.0  # for these, of which nobody hears before all have ended
ENOUGH = 0.75  # of these iterations, the most that a case expects where it tries
HOPED = ENOUGH  # before any try: the first one shows more


@dataclass(frozen=True, eq=False)
class Origin:
    """The end of a solve, as the start of its neighbours."""

    neighbour: Neighbour | None  # None: it has no solution, or its method leaves none
    iterations: int  # of the last solve from a guess, among it and its ancestors
    share: float = HOPED  # iterations of a start from neighbours, with all that follow a failure, over these
    distance: float = 0.0  # of the sources of that start
    expected: float = HOPED  # the share of a case that starts here
    was_led: bool = False  # its own try succeeded
    is_open: bool = True  # a case that starts here is a probe, or a source of it was led

    @property
    def is_worth_a_try(self) -> bool:
        """Return whether a case starts here."""
        return self.neighbour is not None and self.is_open and self.expected <= ENOUGH

    @property
    def most_iterations(self) -> int:
        """Return the iterations that a case tries."""
        return max(FEWEST, int(PART * self.iterations))

    def expect(self, distance: float) -> float:
        """Return the share of a start at a distance: smaller where sources are nearer than they were."""
        return self.share * min(1.0, distance / self.distance) if self.distance else self.share

    def lead(self, found: Neighbour | None, tried: int, distance: float) -> Origin:
        """Return the origin after a try that succeeded."""
        return Origin(found, self.iterations, tried / max(1, self.iterations), distance, was_led=True)

    def leave(self, found: Neighbour | None, iterations: int, distance: float) -> Origin:
        """Return the origin after a solve from a guess: after a try that failed, or without one."""
        failed = 1 + self.most_iterations / max(1, iterations)
        return Origin(found, iterations, failed if self.is_worth_a_try else self.expected, distance)


def gather(start: Start, origins: Mapping[int, Origin]) -> Origin | None:
    """Return the origin of the nearest source, with a mixture of the solutions of all sources; None: there is none.

    The expected share is the mean of the ones that the sources expect.
    """
    return gather_all([start], origins)[0]


def gather_all(starts: Sequence[Start], origins: Mapping[int, Origin]) -> list[Origin | None]:
    """Return the origins of starts whose sources have ended, as `gather` does; all are mixed at once."""
    found = [_inherit(start, origins) for start in starts]
    groups: dict[bytes, list[int]] = {}
    for k, own in enumerate(found):
        if own is not None and own.neighbour is not None and own.is_worth_a_try:
            groups.setdefault(own.neighbour.near.layout, []).append(k)
    for chosen in groups.values():
        mixed = _mix([starts[k] for k in chosen], origins)
        for k, near in zip(chosen, mixed, strict=True):
            own = found[k]
            assert own is not None, "it has a neighbour"
            assert own.neighbour is not None, "it has a neighbour"
            found[k] = replace(own, neighbour=replace(own.neighbour, near=near))
    return found


def _inherit(start: Start, origins: Mapping[int, Origin]) -> Origin | None:
    """Return the origin of the nearest source, with the share that all sources expect."""
    if start.parent is None:
        return None
    sources = [origins[source.case] for source in start.sources]
    shares = [source.expect(start.distance) for source in sources]
    is_open = start.is_probe or any(source.was_led for source in sources)
    return replace(origins[start.parent], expected=math.fsum(shares) / len(shares), is_open=is_open)


def _mix(starts: Sequence[Start], origins: Mapping[int, Origin]) -> list[Near]:
    """Mix the solutions of sources for each start, whose nearest ones have variables of one order."""
    ends: list[Near] = []
    place: dict[int, int] = {}  # of cases among the ends
    columns, weights, first = list[int](), list[float](), [0]
    for start in starts:
        known = _choose(start, origins)
        for source in known:
            if source.case not in place:
                own = origins[source.case].neighbour
                assert own is not None, "it was chosen"
                place[source.case] = len(ends)
                ends.append(own.near)
            columns.append(place[source.case])
        weights += weigh(known).tolist()
        first.append(len(columns))
    # sums go from the nearest source on, whatever is mixed beside: indices stay in this order
    return mix_many(ends, sparse.csr_array((weights, columns, first), shape=(len(starts), len(ends))))


def _choose(start: Start, origins: Mapping[int, Origin]) -> list[Source]:
    """Return the sources whose solutions have the variables of the nearest one."""
    own = origins[start.sources[0].case].neighbour
    assert own is not None, "it is worth a try"
    return [x for x in start.sources if (other := origins[x.case].neighbour) is not None and other.near.fits(own.near)]


T = TypeVar("T")
Begin = Callable[[Start, Origin | None], "Future[tuple[T, Origin]]"]  # of a solve, on a pool


def solve_beside(solver: CaseSolver, case: AnyCase, start: Start, origin: Origin | None) -> tuple[Outcome, Origin]:
    """Solve a case from its sources' solutions, or else from its own guess."""
    found = _try_all(solver, [case], [start], [origin], 1)[0]
    outcome, own = _solve_anew(solver, case, start, origin) if found is None else found
    return read(outcome), own


def _try_all(
    solver: CaseSolver,
    cases: Sequence[AnyCase],
    starts: Sequence[Start],
    origins: Sequence[Origin | None],
    threads: int,
) -> list[tuple[Found, Origin] | None]:
    """Solve cases from their sources' solutions; None where that does not succeed soon, or is not tried."""
    found: list[tuple[Found, Origin] | None] = [None] * len(cases)
    tries, numbers = list[Try](), list[int]()
    for k, (case, origin) in enumerate(zip(cases, origins, strict=True)):
        if origin is not None and origin.neighbour is not None and origin.is_worth_a_try:
            tries.append(Try(case, origin.neighbour, origin.most_iterations))
            numbers.append(k)
    for k, near in zip(numbers, solver.solve_near(tries, threads), strict=True):
        origin = origins[k]
        if near is not None and origin is not None:
            led = origin.lead(near.neighbour, near.found.run.iterations, starts[k].distance)
            found[k] = near.found, led
    return found


def _solve_anew(solver: CaseSolver, case: AnyCase, start: Start, origin: Origin | None) -> tuple[Found, Origin]:
    """Solve a case from its own guess."""
    kept: list[Neighbour] = []
    outcome = solver.solve(case, kept.append)
    found, iterations = kept[-1] if kept else None, outcome.run.iterations
    return outcome, Origin(found, iterations) if origin is None else origin.leave(found, iterations, start.distance)


def solve_neighbours(
    cases: Sequence[AnyCase],
    starts: Sequence[Start],
    plants: Plants,
    threads: int,
    programs: Programs | None = None,
) -> Iterator[tuple[int, Found]]:
    """Solve cases in layers; yield the number and the outcome of each as it ends, see `solve_cases`."""
    own, solver = threading.local(), CaseSolver(plants, programs or Programs())

    def begin() -> None:
        own.solver = CaseSolver(plants) if threads > 1 else solver

    with ThreadPoolExecutor(threads, initializer=begin) as pool:
        waiting, pace = Waiting(starts), Pace(threads)
        try:
            for block in split(starts, pace):
                begun = time.perf_counter()
                given = [cases[start.case] for start in block]
                origins = waiting.gather_all(block)
                found = _try_all(solver, given, block, origins, threads)
                later = {
                    k: pool.submit(lambda *asked: _solve_anew(own.solver, *asked), given[k], block[k], origins[k])
                    for k, one in enumerate(found)
                    if one is None
                }
                pace.learn(time.perf_counter() - begun, len(block) - len(later))
                for k, start in enumerate(block):
                    outcome, origin = found[k] or later[k].result()
                    for _ in waiting.end(start.case, origin):
                        pass  # they come in the order of the starts
                    yield start.case, outcome
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


class Pace:
    """The number of cases that are solved at once: fewer where each takes long. No result depends on it."""

    def __init__(self, least: int) -> None:
        self.least, self.most = least, BLOCK

    def learn(self, seconds: float, count: int) -> None:
        """Choose by the time that some cases took."""
        if count:
            self.most = max(self.least, min(BLOCK, int(SECONDS * count / max(seconds, 1e-9))))


def split(starts: Sequence[Start], pace: Pace) -> Iterator[list[Start]]:
    """Split starts into blocks of which none has sources in itself, each as long as it can be, within the pace."""
    block, own = list[Start](), set[int]()
    for start in starts:
        if block and (len(block) >= pace.most or any(source.case in own for source in start.sources)):
            yield block
            block, own = [], set()
        block.append(start)
        own.add(start.case)
    if block:
        yield block


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
        return self.gather_all([start])[0]

    def gather_all(self, starts: Sequence[Start]) -> list[Origin | None]:
        """Return the origins of starts whose sources have ended."""
        found = gather_all(starts, self.origins)
        for source in (source for start in starts for source in start.sources):
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
