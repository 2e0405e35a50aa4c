"""States at which functions are compared: within the joints' limits, the same on any machine."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mbsgen.model.tree import Joint, Motion, Tree

SPEED, ACCELERATION, WRENCH = 3.0, 10.0, 10.0  # of unbounded quantities: rad/s or m/s, rad/s2 or m/s2, N or N m
TURN, SLIDE = 2 * math.pi, 2.0  # the range of coordinates without limits, rad and m

Array = NDArray[np.float64]
States = Mapping[str, Array]  # (count, size) for each of q, qd, qdd, w


def draw(tree: Tree, count: int, seed: int, *, motion: bool = True) -> dict[str, Array]:
    """Draw states of a tree; without motion, its velocities are 0.

    Coordinates lie within their limits. In every second state each velocity and acceleration is at one end of its
    range, where quadratic terms are largest.
    """
    source = random.Random(seed)
    drawn = [dict(_draw(tree, source, at_ends=k % 2 == 1, motion=motion)) for k in range(count)]
    return {name: np.array([state[name] for state in drawn]).reshape(count, -1) for name in drawn[0]}


def _draw(tree: Tree, source: random.Random, *, at_ends: bool, motion: bool) -> Iterator[tuple[str, list[float]]]:
    def draw_rate(size: float) -> float:
        return source.choice((-size, size)) if at_ends else source.uniform(-size, size)

    speeds = [SPEED if joint.max_speed is None else joint.max_speed for joint in tree.joints]
    yield "q", list(_draw_coordinates(tree, source))
    yield "qd", [draw_rate(speed) if motion else 0.0 for speed in speeds]
    yield "qdd", [draw_rate(ACCELERATION) for _ in tree.joints]
    yield "w", [source.uniform(-WRENCH, WRENCH) for _ in range(tree.open_entries)]


def _draw_coordinates(tree: Tree, source: random.Random) -> Iterator[float]:
    beginnings = {x.first: x for x in tree.quaternions}
    inside = {i for x in tree.quaternions for i in x.bodies}
    for i, body in enumerate(tree.bodies, 1):
        if i in beginnings:
            yield from (source.uniform(-SLIDE / 2, SLIDE / 2) for _ in range(3 * beginnings[i].is_free))
            turn = [source.gauss(0.0, 1.0) for _ in range(4)]
            yield from (x / math.hypot(*turn) for x in turn)
        elif i not in inside and i not in tree.followers:
            yield source.uniform(*_find_range(body.joint))


def _find_range(joint: Joint) -> tuple[float, float]:
    """Return a joint's range; without limits, one turn, or two metres."""
    width = TURN if joint.motion is Motion.REVOLUTE else SLIDE
    if joint.lower is not None:
        return joint.lower, joint.lower + width if joint.upper is None else joint.upper
    return (-width / 2, width / 2) if joint.upper is None else (joint.upper - width, joint.upper)
