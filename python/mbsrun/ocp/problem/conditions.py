"""Conditions on the start and the end of a motion with closed loops: which of them are independent, and the rest.

Loops relate coordinates, so a start or a target may give too much. Of the values given, in order, the first ones that
can have any value are kept. Newton's method finds all other coordinates. A given value that differs from the value
found is reported, with the difference. So no state has more conditions than it can meet, and conditions are independent
of each other and of the loops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.closure import INDEPENDENT, Array, Closure, Gap
from mbsrun.ocp.problem.problem import Problem
from mbsrun.quaternions import list_quaternions

ASIDE = 0.1  # how far poses are moved to leave a singular one [rad, m]
SAME = 1e-6  # the difference from a given value that counts as rounding [rad, m, 1/s]


@dataclass(frozen=True)
class Stray:
    """A given value that the loops contradict."""

    index: int
    given: float
    found: float

    @property
    def distance(self) -> float:
        """Return the difference."""
        return abs(self.given - self.found)


@dataclass(frozen=True)
class Completion:
    """All coordinates, or all velocities, that belong to some given ones."""

    values: Array  # (n,)
    kept: tuple[int, ...]  # entries that are conditions; the loops give the others
    strays: tuple[Stray, ...] = ()
    gap: Gap | None = None  # of loops that do not close


def complete_pose(closure: Closure, near: Array, given: Mapping[int, float], usual: Sequence[int]) -> Completion:
    """Complete a pose; entries of `usual` keep their values of the pose `near` where given ones leave them free.

    A quaternion is given whole.
    """
    q = np.array(near, dtype=np.float64)
    q[list(given)] = list(given.values())
    kept = closure.choose_places(closure.close(q), [*given, *(i for i in usual if i not in given)])
    found = closure.close(q, kept)
    if not closure.is_closed(found):
        return Completion(found, tuple(kept), (), closure.find_gap(found))
    return find_strays(Completion(found, tuple(kept)), given)


def complete_velocities(closure: Closure, q: Array, given: Mapping[int, float], usual: Sequence[int]) -> Completion:
    """Complete velocities in a closed pose; entries of `usual` are 0 where given ones leave them free."""
    kept = closure.choose(q, [*given, *(i for i in usual if i not in given)])
    found = closure.complete_velocities(q, kept, np.array([given.get(i, 0.0) for i in kept]))
    return find_strays(Completion(found, tuple(kept)), given)


def find_surplus(closure: Closure, q: Array, chosen: Sequence[int]) -> list[int]:
    """Find chosen entries of qd that follow from the ones before, in the pose q and in another one near it.

    In a singular pose loops keep entries that are free elsewhere.
    """
    return _list_surplus(closure, q, chosen, closure.choose)


def find_surplus_places(closure: Closure, q: Array, chosen: Sequence[int]) -> list[int]:
    """Find chosen entries of q likewise. A quaternion that follows in part is among them, too."""
    return _list_surplus(closure, q, chosen, closure.choose_places)


def _list_surplus(
    closure: Closure, q: Array, chosen: Sequence[int], choose: Callable[[Array, Sequence[int]], list[int]]
) -> list[int]:
    other = closure.close(q + ASIDE * np.cos(np.arange(q.size)))
    kept = max((choose(pose, chosen) for pose in (q, other)), key=len)
    return [i for i in chosen if i not in kept]


def find_divided_attitudes(closure: Closure, q: Array, kept: Sequence[int], surplus: Sequence[int]) -> list[str]:
    """Name the joints whose quaternions are among `surplus`, and of which loops and kept entries leave a part free."""
    unit, found = np.eye(q.size), []
    held = np.concatenate((closure.slopes(q[None])[0], unit[list(kept)]))
    for x in list_quaternions(closure.manifest):
        if set(x.entries) <= set(surplus):
            own = np.concatenate((held, [q[x.entries] @ unit[x.entries]]))
            whole = np.concatenate((own, unit[x.entries]))
            before, after = (np.linalg.matrix_rank(rows, tol=INDEPENDENT) for rows in (own, whole))
            found += [x.joint] if after > before else []
    return found


def list_lengths(problem: Problem, closure: Closure | None) -> tuple[str, ...]:
    """List the unknowns of a problem that change the loops."""
    chosen = {unknown.name for unknown in problem.unknowns}
    return () if closure is None else tuple(name for name in closure.parameters if name in chosen)


def find_strays(completion: Completion, given: Mapping[int, float]) -> Completion:
    """Add the given values that a completion contradicts."""
    if completion.gap is not None:
        return completion
    pairs = ((i, x, float(completion.values[i])) for i, x in given.items())
    return replace(completion, strays=tuple(Stray(i, x, y) for i, x, y in pairs if abs(x - y) > SAME))


def find_open_states(problem: Problem, closure: Closure) -> Iterator[tuple[str, str, str]]:
    """Find the part of a problem whose state the loops contradict: part, finding, remedy."""
    q, qd, nq = np.array(problem.start_q), np.array(problem.start_qd), len(problem.start_q)
    free = set(problem.free_start)
    given = [i for i in range(nq) if i not in free]
    speeds = [i for i in range(len(qd)) if nq + i not in free]
    lengths = ", ".join(list_lengths(problem, closure))
    for key, is_whole in (("start_q", len(given) == nq), ("start_qd", len(speeds) == len(qd) and qd.any())):
        if lengths and is_whole:
            finding = f"all entries are given, and {lengths} changes the ones that loops give"
            yield key, finding, "free these: free_start"
    if len(given) == nq:
        if not closure.is_closed(q):
            yield "start_q", str(closure.find_gap(q)), "close it: ocp.conditions.complete_pose"
            return
        if len(speeds) == len(qd) and closure.measure_rates(q[None], qd[None]) > SAME:
            gap = f"the loops open at {closure.measure_rates(q[None], qd[None]):.3g} m/s or 1/s"
            yield "start_qd", gap, "give velocities that keep them closed: ocp.conditions.complete_velocities"
    positions, velocities = closure.manifest.positions, [c.name for c in closure.manifest.coordinates]
    for key, names, chosen, find in (
        ("free_start", positions, given if len(given) < nq else [], find_surplus_places),
        ("free_start", velocities, speeds if len(speeds) < len(qd) else [], find_surplus),
        ("end.coordinates", positions, [i for i, _ in problem.end.coordinates], find_surplus_places),
        ("end.velocities", velocities, [i for i, _ in problem.end.velocities], find_surplus),
        ("end.accelerations", velocities, [i for i, _ in problem.end.accelerations], find_surplus),
    ):
        if surplus := find(closure, q, chosen):
            named = ", ".join(names[i] for i in surplus)
            yield key, f"{named} follows from the others by the loops", "leave it out"
