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
from mbsgen.model.tree import Closure, Tree

STEPS = 100
LONGEST = 0.5  # of a step, rad or m, so that distant poses are approached slowly
SHORTEST = 1e-9  # of a step: the next one is at the rounding
OPEN = 1e-9  # largest residual of a closed equation, m or rad, where sizes are about 1
RANK = 1e-9  # of the largest singular value: smaller ones are 0
NEAR = 0.005  # rad, or of a loop's size: equations that are open by more along a motion do not follow from others
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
    limits: Array  # of the residuals of a closed pose

    @property
    def is_closed(self) -> bool:
        """Return whether all equations hold, with axes that point the same way."""
        return bool((np.abs(self.h) <= self.limits).all() and (self.senses > 0).all())

    @property
    def gap(self) -> float:
        """Return the largest residual; infinite where one has no value."""
        worst = float(np.abs(self.h).max(initial=0.0))
        return worst if np.isfinite(worst) else float("inf")


def find_pose(mechanism: Mechanism, rough: Array, *, weak: float = RANK, slack: float = OPEN) -> Attempt:
    """Close all loops near a rough pose: from it, then from starts about it. Return the best attempt; see `close`."""
    draw = np.random.default_rng(0)
    best: Attempt | None = None
    for spread in SPREADS[: count_starts(mechanism.operations)]:
        start = rough + spread * mechanism.steps * draw.standard_normal(rough.size)
        found = close(mechanism, start, weak=weak, slack=slack)
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
    mechanism: Mechanism,
    start: Array,
    kept: Sequence[int] | None = None,
    *,
    held: Sequence[int] = (),
    weak: float = RANK,
    slack: float = OPEN,
) -> Attempt:
    """Close all loops, or solve the kept equations alone, by steps of least length; held coordinates stay.

    Directions along which J is weaker than a part of its largest are not followed. Equations that are not kept may stay
    open by `slack`, and all of them where weak directions are left out.
    """
    q = _normalise(mechanism, start)
    own = list(range(len(mechanism.equations))) if kept is None else list(kept)
    for _ in range(STEPS):
        h, H = mechanism.h(q)[own], mechanism.slopes(q)[own]
        H[:, list(held)] = 0.0
        if not (np.isfinite(h).all() and np.isfinite(H).all()):
            break
        step = -np.linalg.lstsq(H, h, rcond=weak)[0] if h.size else np.zeros(q.size)
        length = float(np.abs(step).max(initial=0.0))
        q = _normalise(mechanism, q + mechanism.steps * step * min(1.0, LONGEST / max(length, LONGEST)))
        if length < SHORTEST:
            break
    limits = np.full(len(mechanism.equations), slack)
    limits[own if weak == RANK else []] = OPEN
    return Attempt(q, mechanism.h(q), mechanism.senses(q), limits)


def reach(tree: Tree, wanted: Mapping[int, float]) -> Array | None:
    """Return a closed pose of an assembled tree with given entries of q; None where the way from its pose ends."""
    assert tree.closure is not None, "the tree is assembled"
    mechanism, q = Mechanism(tree), np.array(tree.closure.pose)
    kept, slack = find_solved(tree.closure)
    held = [*wanted]
    start, end = q[held], np.array([*wanted.values()])
    count = max(1, math.ceil(float(np.abs((end - start) / mechanism.steps[held]).max(initial=0.0)) / PACE))
    for part in np.linspace(0.0, 1.0, count + 1)[1:]:
        q[held] = start + part * (end - start)
        found = close(mechanism, q, kept, held=held, slack=slack)
        if not found.is_closed:
            return None
        q = found.q
    return q


def find_solved(closure: Closure) -> tuple[Sequence[int] | None, float]:
    """Return the equations that close loops again, None for all, and by how much the others may be open."""
    return (closure.kept, NEAR) if closure.distance else (None, OPEN)


def walk(mechanism: Mechanism, first: Array, kept: Sequence[int] | None = None, slack: float = OPEN) -> Iterator[Array]:
    """Yield the pose, and closed poses that the mechanism reaches from it, by all equations or the kept ones alone."""
    own = slice(None) if kept is None else list(kept)
    draw = np.random.default_rng(1)
    yield first
    pose = first
    for k in range(WALKS):
        free = null_space(mechanism.slopes(pose)[own])
        if not free.shape[1]:
            return
        direction = free @ draw.standard_normal(free.shape[1])
        direction /= max(float(np.abs(direction).max()), 1e-300)
        found = close(mechanism, pose + STRIDE * mechanism.steps * direction, kept, slack=slack)
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
