"""Poses and velocities on the loops' equations: h(q) = 0 and J qd = 0, by Newton's method from given entries.

    J_f dq_f = -h,    J_f qd_f = -J_g qd_g        f: free entries, g: given ones

Both are solved for the change of least norm, so that J may lose its rank. A pose far from a closed one is reached by
continuation: given coordinates move there step by step, and the others follow, in the same assembly of the loops.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest
from mbsrun.kernel import Kernels
from mbsrun.simulation.course import Course, place_driven

Array = NDArray[np.float64]

GAP = "gap"  # the name of h among the kernels' results
CLOSED = 1e-12  # of h, relative to 1 + |q|
OPEN = 1e-9  # of h and of J qd relative to 1 + |qd|: more is an open loop, less is rounding of the caller's
ROUGH = 1e-3  # of h: a given pose that is open by less is closed
RANK = 1e-8  # of singular values, relative to the first
ITERATIONS = 30
SHORTEST = 1e-3  # of a continuation's steps, relative to the whole way


class OpenError(MbsError):
    """A loop that cannot be closed from the given entries."""

    def __init__(self, loop: str, finding: str, remedy: str) -> None:
        self.loop, self.finding, self.remedy = loop, finding, remedy
        super().__init__(f"loop {loop}: {finding}; {remedy}")


def find_gaps(kernels: Kernels, q: Array) -> Array:
    """Return h of poses (..., nq)."""
    return kernels("loops", q=q)[GAP]


def measure_gaps(kernels: Kernels, q: Array, qd: Array) -> tuple[Array, Array]:
    """Return the largest |h| and |J qd| of states (K, ...), shape (K,) each; 0 without loops."""
    if not kernels.manifest.owners:
        return np.zeros(len(q)), np.zeros(len(q))
    h, hd = find_gaps(kernels, q), kernels("loop_rates", q=q, qd=qd)["hd"]
    return np.abs(h).max(axis=1), np.abs(hd).max(axis=1)


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

    Given entries are kept, the others follow. A pose that is nearly closed is moved as a whole. Raises
    OpenError where the loops stay open.
    """
    manifest = kernels.manifest
    q, qd, placed, moving = start.q.copy(), start.qd.copy(), place_driven(manifest), list(manifest.driven)
    q[placed], qd[moving], _ = course.at(0.0)
    note = ""
    if not manifest.owners:
        return q, qd, note
    given = sorted(start.placed | set(placed))
    try:
        closed = close_pose(kernels, start.base, given, q[given])
    except OpenError:
        if np.abs(find_gaps(kernels, q)).max() > ROUGH:
            raise
        closed = close_near(kernels, q)
    change = float(np.abs(closed - q)[given].max(initial=0.0))
    if change > OPEN:
        note = f"the loops were not closed at the given start: coordinates were changed by up to {change:.2g}"
    return closed, complete_velocities(kernels, closed, qd, start.moving | set(moving)), note


def close_pose(kernels: Kernels, pose: Array, given: Collection[int], values: Array) -> Array:
    """Return the closed pose near `pose`, with the entries `given` of q at `values`.

    Raises OpenError where the others cannot close the loops.
    """
    given = sorted(given)
    q, way, length = pose.copy(), 0.0, 1.0
    start = pose[given]
    while way < 1:
        length = min(length, 1 - way)
        trial = q.copy()
        trial[given] = start + (way + length) * (values - start)
        try:
            q = _settle(kernels, trial, given, limit=0.5)
        except OpenError:
            length /= 2
            if length < SHORTEST:
                raise
            continue
        way, length = way + length, 2 * length
    return q


def close_near(kernels: Kernels, q: Array) -> Array:
    """Return the closed pose nearest to q, with driven joints where they are. Raises OpenError."""
    return _settle(kernels, q, place_driven(kernels.manifest), limit=np.inf)


def _settle(kernels: Kernels, q: Array, given: Collection[int], limit: float) -> Array:
    """Solve h = 0 by Newton's method, with changes of at most `limit` in all."""
    manifest, q = kernels.manifest, q.copy()
    free = [i for i in range(len(manifest.positions)) if i not in given]
    rest, start = np.zeros(len(manifest.coordinates)), q.copy()
    for _ in range(ITERATIONS):
        h = find_gaps(kernels, q)
        J = kernels("loop_jacobian", q=q, qd=rest)["J"] @ _invert_rates(kernels, q)
        change = -np.linalg.lstsq(J[:, free], h, rcond=RANK)[0]
        q[free] += change
        if not np.isfinite(q).all() or np.abs(q - start).max() > limit * (1 + np.abs(start).max()):
            break
        if np.abs(change).max(initial=0.0) <= CLOSED * (1 + np.abs(q).max()):
            break
    h = find_gaps(kernels, q) if np.isfinite(q).all() else h
    worst = int(np.abs(h).argmax())
    if not abs(h[worst]) <= OPEN:
        finding = f"it stays open by {abs(h[worst]):.3g}"
        raise OpenError(_name_loop(manifest, worst), finding, "give other coordinates, or fewer of them")
    return q


def _invert_rates(kernels: Kernels, q: Array) -> Array:
    """Return the velocities (n, nq) of rates of the coordinates: the inverse, or pseudo-inverse, of q' = E(q) qd."""
    n = len(kernels.manifest.coordinates)
    if not kernels.manifest.configuration:
        return np.eye(n)
    return np.asarray(np.linalg.pinv(kernels("jac_rates", q=q, qd=np.zeros(n))["jac_rate_qd"]))


def complete_velocities(kernels: Kernels, q: Array, qd: Array, given: Collection[int]) -> Array:
    """Return velocities with J qd = 0, with the entries `given` as in qd; the others have the least norm.

    Raises OpenError where the given ones contradict each other.
    """
    manifest = kernels.manifest
    free = [i for i in range(len(qd)) if i not in given]
    found = np.where(np.isin(np.arange(len(qd)), sorted(given)), qd, 0.0)
    J = kernels("loop_jacobian", q=q, qd=found)["J"]
    for _ in range(2):  # the second time for rounding
        found[free] -= np.linalg.lstsq(J[:, free], J @ found, rcond=RANK)[0]
    left = J @ found
    worst = int(np.abs(left).argmax())
    if not abs(left[worst]) <= OPEN * (1 + np.abs(found).max()):
        finding = f"the given velocities open it at a rate of {abs(left[worst]):.3g}"
        raise OpenError(_name_loop(manifest, worst), finding, "give independent joints only")
    return found


def check_closed(kernels: Kernels, q: Array, qd: Array) -> None:
    """Check that a state is on the loops' equations. Raises OpenError with the largest gap."""
    if not kernels.manifest.owners:
        return
    rates = kernels("loop_rates", q=q, qd=qd)["hd"]
    for gaps, unit in ((find_gaps(kernels, q), "is open by"), (rates, "opens at")):
        left = np.abs(gaps)
        worst = int(left.argmax())
        if not left[worst] <= OPEN * (1 + np.abs(qd).max(initial=0.0)):
            finding = f"it {unit} {left[worst]:.3g} at the start"
            remedy = "close it with close_pose and complete_velocities of mbsrun.simulation"
            raise OpenError(_name_loop(kernels.manifest, worst), finding, remedy)


def _name_loop(manifest: Manifest, entry: int) -> str:
    """Name the loop of an entry of h."""
    return manifest.loops[manifest.owners[entry]].name
