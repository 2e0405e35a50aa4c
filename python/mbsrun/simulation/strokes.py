"""Strokes: how far each joint of a mechanism can move, as its loops and the limits of joints allow.

One joint leads, step by step from a pose, and Newton's method finds the others near their last places. Of a mechanism
with several freedoms, further independent joints stay where they are. The way ends where a joint meets a limit, where
the loops cannot be closed any farther, which is a dead centre, or after a whole turn. Ends are found by halving steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import Closure
from mbsrun.kernel import Kernels

Array = NDArray[np.float64]

STEP = 0.02  # rad or m: the longest step
NEAR = 0.2  # rad or m: what the other coordinates may move in a step
SHORTEST = 1e-10  # rad or m: how exactly ends are found
TURN = 2 * np.pi
LONGEST = 10.0  # m: where the way of a slide is given up


@dataclass(frozen=True)
class End:
    """An end of a stroke."""

    value: float  # of the joint that leads [rad, m]
    cause: str


@dataclass(frozen=True, eq=False)
class Stroke:
    """The poses of a mechanism as one joint leads, from its lowest to its highest value."""

    joint: str
    held: tuple[str, ...]  # joints that stay where they are
    q: Array  # (K, nq)
    lower: End
    upper: End

    def __repr__(self) -> str:
        """Return the joint and its ends."""
        return f"Stroke({self.joint}: from {self.lower.value:.6g} ({self.lower.cause}) to {self.upper.value:.6g})"


def find_strokes(kernels: Kernels, pose: Array) -> list[Stroke]:
    """Find the strokes of all joints that can move from a closed pose (nq,)."""
    names = kernels.manifest.positions
    found = (find_stroke(kernels, pose, c.name) for c in kernels.manifest.coordinates if c.name in names)
    return [stroke for stroke in found if stroke is not None]


def find_stroke(kernels: Kernels, pose: Array, joint: str) -> Stroke | None:
    """Find how far a joint can move from a closed pose (nq,); None for a joint that loops keep where it is."""
    manifest, closure = kernels.manifest, Closure(kernels)
    place = manifest.positions.index(joint)
    candidates = [place, *(i for i in closure.places_independent if i != place), *range(closure.places)]
    held = closure.choose_places(pose, list(dict.fromkeys(candidates))) if closure.count else [place]
    if place not in held:
        return None
    way = _Way(kernels, closure, place, held)
    (below, lower), (above, upper) = (way.go(pose, sense) for sense in (-1, 1))
    names = tuple(manifest.positions[i] for i in held if i != place)
    return Stroke(joint, names, np.array([*reversed(below), pose, *above]), lower, upper)


class _Way:
    """The poses that a mechanism goes through as one coordinate leads."""

    def __init__(self, kernels: Kernels, closure: Closure, place: int, held: list[int]) -> None:
        self.closure, self.place, self.held = closure, place, held
        self.names = kernels.manifest.positions
        joints = {c.name: c for c in kernels.manifest.coordinates}
        self.turns = joints[self.names[place]].motion == "revolute"
        limits = [(joints[x].lower, joints[x].upper) if x in joints else (None, None) for x in self.names]
        self.lower = np.array([-np.inf if low is None else low for low, _ in limits])
        self.upper = np.array([np.inf if high is None else high for _, high in limits])

    def go(self, pose: Array, sense: int) -> tuple[list[Array], End]:
        """Go one way; return the poses, and why they end."""
        poses, step, cause = list[Array](), STEP, self._find_limit(pose, pose)
        last, far = pose, TURN if self.turns else LONGEST
        while cause == "" or step > SHORTEST:
            step = min(step, far - abs(last[self.place] - pose[self.place]))
            if step <= SHORTEST:
                return poses, End(float(last[self.place]), "a whole turn" if self.turns else f"no end within {far:g} m")
            trial = last.copy()
            trial[self.place] += sense * step
            found = self.closure.close(trial, self.held) if self.closure.count else trial
            cause = self._judge(last, found)
            if cause:
                step /= 2
            else:
                poses.append(found)
                last, step = found, min(2 * step, STEP)
        return poses, End(float(last[self.place]), cause)

    def _judge(self, last: Array, found: Array) -> str:
        """Return why a pose is no next one; nothing if it is."""
        if self.closure.count and not self.closure.is_closed(found):
            return f"loop {self.closure.find_gap(found).name} is at a dead centre"
        if np.abs(found - last).max() > NEAR:
            return "the other joints move without end: a dead centre"
        return self._find_limit(last, found)

    def _find_limit(self, last: Array, found: Array) -> str:
        """Name the joint that goes beyond a limit, or farther beyond it."""
        beyond = np.maximum(self.lower - found, found - self.upper)
        before = np.maximum(np.maximum(self.lower - last, last - self.upper), 0.0)
        k = int((beyond - before).argmax())
        return f"limit of {self.names[k]}" if beyond[k] > before[k] else ""


def tabulate(stroke: Stroke, kernels: Kernels) -> tuple[list[str], Array]:
    """Return the names of columns with units, and the numbers: coordinates, and places of sensors."""
    manifest = kernels.manifest
    units = {c.name: c.unit for c in manifest.coordinates}
    header = [f"q[{name}] [{units.get(name, '-')}]" for name in manifest.positions]
    sensors = [(i, frame.name) for i, frame in enumerate(manifest.frames) if frame.sensor]
    header += [f"{axis}[{name}] [m]" for _, name in sensors for axis in "xyz"]
    p = kernels("frames", q=stroke.q)["p"][:, :, [i for i, _ in sensors]]
    return header, np.concatenate((stroke.q, p.transpose(0, 2, 1).reshape(len(stroke.q), -1)), axis=1)


def list_extremes(stroke: Stroke, kernels: Kernels) -> Iterator[tuple[str, float, float]]:
    """Yield the least and the largest value of each coordinate on the way."""
    for name, values in zip(kernels.manifest.positions, stroke.q.T, strict=True):
        yield name, float(values.min()), float(values.max())
