"""Readings of loops from rounded numbers: which equations follow from the others, within a distance.

A file rounds axes and places, so a planar loop in it is planar within some 1e-6 only, and its equations across the
plane hold exactly at single poses, if at all. A reading takes the weak singular values of J as zeros: those below a
gap. It solves as many equations as strong values are left, and measures along the mechanism by how much the other
equations stay open, in rad or relative to the size of a loop. They follow from the solved ones if this distance stays
small wherever the mechanism moves, and if the weak values, the distance per rad, are small too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.assembly.choice import choose_rows
from mbsgen.assembly.mechanism import Array, Mechanism, name_equations
from mbsgen.assembly.poses import NEAR, RANK, Attempt, close, find_pose, walk

GAP = 10.0  # between the least strong singular value and the largest weak one


@dataclass(frozen=True)
class Reading:
    """Closed poses along the mechanism, the first one first; the equations that are solved; the others' distance."""

    places: tuple[Array, ...]
    poses: tuple[Array, ...]  # J of all equations
    kept: tuple[int, ...]
    distance: float

    @property
    def freedoms(self) -> int:
        """Count the degrees of freedom."""
        return int(self.poses[0].shape[1]) - len(self.kept)

    def name_redundant(self, mechanism: Mechanism) -> tuple[str, ...]:
        """Name the equations that follow from others."""
        return name_equations(mechanism.tree, (i for i in range(len(mechanism.equations)) if i not in self.kept))


def is_weak(mechanism: Mechanism, poses: Sequence[Array], rank: int) -> bool:
    """Return whether a singular value of J is weak at all poses, but not zero."""
    strengths = _find_strengths(mechanism, poses)[:rank]
    return any(strengths[count] > RANK for count in _list_gaps(strengths))


def list_readings(mechanism: Mechanism, rough: Array, rank: int | None) -> Iterator[Reading]:
    """Yield the readings with fewer independent equations than a rank, and degrees of freedom; the nearest first.

    None: all equations together do not close.
    """
    attempt = find_pose(mechanism, rough, weak=NEAR, slack=NEAR)
    if not attempt.is_closed:
        return
    strengths = _find_strengths(mechanism, [mechanism.J(attempt.q)])[:rank]
    for count in _list_gaps(strengths):
        found = _read(mechanism, attempt, count)
        if found is not None:
            yield found


def _find_strengths(mechanism: Mechanism, poses: Sequence[Array]) -> Array:
    """Return the largest singular values of J at any pose, by their places, relative to the largest one or 1."""
    values = [np.linalg.svd(mechanism.gauge(J), compute_uv=False) for J in poses]
    found: Array = np.max([x / max(float(x.max(initial=0.0)), 1.0) for x in values], axis=0)
    return found


def _list_gaps(strengths: Array) -> Iterator[int]:
    """Yield numbers of equations before a gap of weak singular values, the largest number first."""
    for count in reversed(range(len(strengths))):
        strong, weak = strengths[count - 1] if count else 1.0, max(strengths[count], RANK)
        if weak <= NEAR and strong >= GAP * weak:
            yield count


def _read(mechanism: Mechanism, attempt: Attempt, count: int) -> Reading | None:
    """Solve as many equations as count from an attempt on; None where they do not close, or leave the others open."""
    kept = _choose(mechanism, [mechanism.J(attempt.q)], count)
    first = close(mechanism, attempt.q, kept, slack=NEAR)
    if not first.is_closed or count >= mechanism.n:
        return None
    places = tuple(walk(mechanism, first.q, kept, NEAR))
    poses = tuple(mechanism.J(q) for q in places)
    weak = float(_find_strengths(mechanism, poses)[count])
    distance = max(weak, *(float(mechanism.distances(q).max(initial=0.0)) for q in places))
    if len(places) < 2 or not distance <= NEAR:
        return None
    return Reading(places, poses, _choose(mechanism, poses, count), distance)


def _choose(mechanism: Mechanism, poses: Sequence[Array], count: int) -> tuple[int, ...]:
    """Choose rows by their sizes, so that no weak one stands for a strong one."""
    return choose_rows([mechanism.gauge(J) for J in poses], count, 1.0)
