"""Starts of motions with closed loops: the given coordinates and velocities, completed such that h(q) = 0, J qd = 0.

A pose far from a closed one is reached by continuation: given coordinates move there step by step, and the others
follow, in the same assembly of the loops.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import Closure, Gap, OpenError
from mbsrun.kernel import Kernels
from mbsrun.simulation.course import Course, place_driven

Array = NDArray[np.float64]

OPEN = 1e-9  # of h and of J qd relative to 1 + |qd|: more is an open loop, less is rounding of the caller's
ROUGH = 1e-3  # of h: a given pose that is open by less is closed
PARTING = 1e-6  # least singular value of J relative to the largest: with less, loops may go on in several ways


@dataclass(frozen=True, eq=False)
class Start:
    """A start, as it was given."""

    base: Array  # (nq,): a pose near which loops close
    q: Array  # (nq,): the same with the given coordinates
    qd: Array  # (n,)
    placed: frozenset[int]  # the given entries of q
    moving: frozenset[int]  # and of qd


def close_start(kernels: Kernels, start: Start, course: Course) -> tuple[Array, Array, str]:
    """Return q and qd with closed loops, and a note where given coordinates were changed.

    Given entries are kept, and the others follow. Where these leave freedoms, independent joints stay where they are,
    or at rest; in a pose they move too where the loops do not close else. A pose that is nearly closed is moved as a
    whole. Raises OpenError where the loops stay open.
    """
    manifest, closure = kernels.manifest, Closure(kernels)
    q, qd, placed, moving = start.q.copy(), start.qd.copy(), place_driven(manifest), list(manifest.driven)
    q[placed], qd[moving], _ = course.at(0.0)
    note = ""
    if not manifest.owners:
        return q, qd, note
    given = sorted(start.placed | set(placed))
    try:
        closed = _move(closure, start.base, given, q)
    except OpenError:
        if closure.measure(q) > ROUGH:
            raise
        closed = closure.close(q, placed)
        if not closure.is_closed(closed):
            raise closure.tell_open(closed) from None
    change = float(np.abs(closed - q)[given].max(initial=0.0))
    if change > OPEN:
        note = f"the loops were not closed at the given start: coordinates were changed by up to {change:.2g}"
    still = closure.list_held(closed, sorted(start.moving | set(moving)))
    return closed, complete_velocities(closure, closed, qd, still), note


def _move(closure: Closure, base: Array, given: list[int], q: Array) -> Array:
    """Return a closed pose with given entries as in q, and if possible with the independent ones that are left, too."""
    held = closure.list_held_places(base, given)
    try:
        return closure.move(base, held, q[held])
    except OpenError:
        if held == given:
            raise
        return closure.move(base, given, q[given])


def complete_velocities(closure: Closure, q: Array, qd: Array, given: Collection[int]) -> Array:
    """Return velocities with J qd = 0, with the entries `given` as in qd; the others have the least norm.

    Raises OpenError where the given ones contradict each other.
    """
    given = sorted(given)
    found = closure.complete_velocities(q, given, qd[given])
    worst = _find_open(closure, closure.rates(q, found), found)
    if worst and closure.measure_strength(q) < PARTING:
        finding = "the pose is a change point, where its equations depend on each other, and it may go on in more ways"
        raise OpenError(worst.name, finding, "give all coordinates and velocities, or start beside it")
    if worst:
        finding = f"the given velocities open it at a rate of {worst.size:.3g}"
        raise OpenError(worst.name, finding, "give independent joints only")
    return found


def check_closed(kernels: Kernels, q: Array, qd: Array) -> None:
    """Check that a state is on the loops' equations. Raises OpenError with the largest gap."""
    closure = Closure(kernels)
    for gaps, unit in ((closure.gaps(q), "is open by"), (closure.rates(q, qd), "opens at")):
        if worst := _find_open(closure, gaps, qd):
            remedy = "close it with close and complete_velocities of mbsrun.closure.Closure"
            raise OpenError(worst.name, f"it {unit} {worst.size:.3g} at the start", remedy)


def _find_open(closure: Closure, gaps: Array, qd: Array) -> Gap | None:
    """Find the loop with the largest one of some gaps or rates (m,), if that is more than rounding."""
    worst = closure.find_worst(gaps) if gaps.size else None
    is_open = worst is not None and not worst.size <= OPEN * (1 + np.abs(qd).max(initial=0.0))
    return worst if is_open else None
