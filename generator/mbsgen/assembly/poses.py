"""Closed poses: from a rough pose by Gauss and Newton's steps of least length, and along the mechanism from a pose.

    q <- q - H+ h(q),    H = dh/dq

H+ is the pseudo-inverse, so redundant equations do no harm (Nikravesh, 1988, ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.assembly.mechanism import Array, Mechanism
from mbsgen.model.tree import Tree

STEPS = 100
LONGEST = 0.5  # of a step, rad or m, so that distant poses are approached slowly
SHORTEST = 1e-9  # of a step: the next one is at the rounding
OPEN = 1e-9  # largest residual of a closed equation, m or rad, where sizes are about 1
RANK = 1e-9  # of the largest singular value: smaller ones are 0
SPREADS = (0.0, *(0.1,) * 4, *(0.3,) * 8, *(1.0,) * 16, *(3.0,) * 32)  # of the starts, about the rough pose
EFFORT = 100_000_000  # operations of all attempts together, so that a large model is refused in a quarter of a minute
FEWEST = 3  # attempts, however large the model is
WALKS = 8  # poses that are looked at besides the first one
STRIDE = 0.4  # between them, rad or m
PACE = 0.1  # of given coordinates on the way to their values, rad or m


@dataclass(frozen=True)
class Attempt:
    """Where the steps ended, and what is open there."""

    q: Array
    h: Array
    senses: Array

    @property
    def is_closed(self) -> bool:
        """Return whether all equations hold, with axes that point the same way."""
        return self.gap <= OPEN and bool((self.senses > 0).all())

    @property
    def gap(self) -> float:
        """Return the largest residual; infinite where one has no value."""
        worst = float(np.abs(self.h).max(initial=0.0))
        return worst if np.isfinite(worst) else float("inf")


def find_pose(mechanism: Mechanism, rough: Array) -> Attempt:
    """Close all loops near a rough pose: from it, then from starts about it. Return the best attempt."""
    draw = np.random.default_rng(0)
    best: Attempt | None = None
    for spread in SPREADS[: count_starts(mechanism.operations)]:
        found = close(mechanism, rough + spread * draw.standard_normal(rough.size))
        if found.is_closed:
            return found
        if best is None or found.gap < best.gap:
            best = found
    assert best is not None, "some start was tried"
    return best


def count_starts(operations: int) -> int:
    """Return from how many starts loops are closed, given the operations of one step."""
    return max(FEWEST, min(len(SPREADS), EFFORT // (STEPS * operations + 1)))


def close(
    mechanism: Mechanism, start: Array, kept: Sequence[int] | None = None, *, held: Sequence[int] = ()
) -> Attempt:
    """Close all loops, or solve the kept equations alone, by steps of least length; held coordinates stay."""
    q = _normalise(mechanism, start)
    own = list(range(len(mechanism.equations))) if kept is None else list(kept)
    for _ in range(STEPS):
        h, H = mechanism.h(q)[own], mechanism.slopes(q)[own]
        H[:, list(held)] = 0.0
        if not (np.isfinite(h).all() and np.isfinite(H).all()):
            break
        step = -np.linalg.lstsq(H, h, rcond=RANK)[0] if h.size else np.zeros(q.size)
        length = float(np.abs(step).max(initial=0.0))
        q = _normalise(mechanism, q + step * min(1.0, LONGEST / max(length, LONGEST)))
        if length < SHORTEST:
            break
    return Attempt(q, mechanism.h(q), mechanism.senses(q))


def reach(tree: Tree, wanted: Mapping[int, float]) -> Array | None:
    """Return a closed pose of an assembled tree with given entries of q; None where the way from its pose ends."""
    assert tree.closure is not None, "the tree is assembled"
    mechanism, q = Mechanism(tree), np.array(tree.closure.pose)
    held = [*wanted]
    start, end = q[held], np.array([*wanted.values()])
    count = max(1, math.ceil(float(np.abs(end - start).max(initial=0.0)) / PACE))
    for part in np.linspace(0.0, 1.0, count + 1)[1:]:
        q[held] = start + part * (end - start)
        found = close(mechanism, q, held=held)
        if not found.is_closed:
            return None
        q = found.q
    return q


def walk(mechanism: Mechanism, first: Array) -> Iterator[Array]:
    """Yield the pose, and closed poses that the mechanism reaches from it."""
    draw = np.random.default_rng(1)
    yield first
    pose = first
    for k in range(WALKS):
        free = null_space(mechanism.slopes(pose))
        if not free.shape[1]:
            return
        direction = free @ draw.standard_normal(free.shape[1])
        direction /= max(float(np.abs(direction).max()), 1e-300)
        found = close(mechanism, pose + STRIDE * direction)
        if found.is_closed:
            yield found.q
        pose = found.q if found.is_closed and k % 4 != 3 else first


def rank(J: Array) -> int:
    """Count the singular values that are not rounding."""
    values = np.linalg.svd(J, compute_uv=False) if J.size else np.zeros(0)
    return int((values > RANK * max(float(values.max(initial=0.0)), 1e-300)).sum())


def null_space(H: Array) -> Array:
    """Return orthonormal directions, as columns, along which a Jacobian vanishes."""
    if not H.size:
        return np.eye(H.shape[1])
    _, values, rows = np.linalg.svd(H)
    count = int((values > RANK * max(float(values.max(initial=0.0)), 1e-300)).sum())
    return rows[count:].T


def _normalise(mechanism: Mechanism, q: Array) -> Array:
    """Return the coordinates with quaternions of length 1."""
    names = mechanism.tree.coordinates
    for x in mechanism.tree.quaternions:
        first = names.index(x.coordinates[-4])
        length = float(np.linalg.norm(q[first : first + 4]))
        q = q.copy()
        q[first : first + 4] = q[first : first + 4] / length if length > 0 else (0.0, 0.0, 0.0, 1.0)
    return q
