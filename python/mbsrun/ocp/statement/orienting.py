"""Orientations of sensors at the end: directions of a sensor's axes -> conditions that are linear in these axes.

With r_k the axes of a sensor and t_k their directions, a whole orientation is

    1/2 sum of t_k x r_k = 0,    sum of t_k . r_k >= 1,

sin(a) n = 0 and 1 + 2 cos(a) >= 1 for a turn by the angle a about n from the one to the other. The equations alone hold
for half turns too. One axis r along a direction t, with two directions p and q across it, is

    p.r = 0,    q.r = 0,    t.r >= 0.

An entry of an axis that the mechanism cannot change is a number: equations without any other are left out if they hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Aims, Range
from mbsrun.quaternions import neutral

Array = NDArray[np.float64]
Weights = Mapping[tuple[int, int], float]  # of components of axes: by axis and component

AXES = "xyz"
ROUNDED = 1e-14  # a weight that stands for 0
HOLDS = 1e-9  # the error of an equation that counts as rounding


@dataclass(frozen=True)
class Condition:
    """A sum of components of axes within a range."""

    expression: str
    range: Range


def turn_by(roll: float, pitch: float, yaw: float) -> Aims:
    """Return the axes after turns about x, then y, then z of the base."""
    (a, b, c), (d, e, f) = ([function(x) for x in (roll, pitch, yaw)] for function in (math.cos, math.sin))
    x = (c * b, f * b, -e)
    y = (c * e * d - f * a, f * e * d + c * a, b * d)
    z = (c * e * a + f * d, f * e * a - c * d, b * a)
    return ((0, x), (1, y), (2, z))


def turn_to(x: float, y: float, z: float, w: float) -> Aims | None:
    """Return the axes after the turn of a quaternion of any length; None for 0."""
    length = math.hypot(x, y, z, w)
    if not length:
        return None
    x, y, z, w = (part / length for part in (x, y, z, w))
    return (
        (0, (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))),
        (1, (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w))),
        (2, (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y))),
    )


def point(directions: Mapping[int, Sequence[float]]) -> Aims | None:
    """Return one axis along a direction, or all axes where two have directions; None where these make no frame."""
    units = {k: np.array(v) / np.linalg.norm(v) for k, v in directions.items() if np.linalg.norm(v) > 0}
    if len(units) < len(directions) or len(units) > 2:
        return None
    if len(units) == 2:
        (i, a), (j, b) = sorted(units.items())
        if abs(a @ b) > HOLDS:
            return None
        k = 3 - i - j
        units[k] = np.cross(a, b) if (i, j) != (0, 2) else np.cross(b, a)
    return tuple((k, _triple(units[k])) for k in sorted(units))


def _triple(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(part) for part in v)
    return x, y, z


def list_conditions(aims: Aims, sensor: int, name: str, plant: Plant) -> Iterator[Condition | float]:
    """Yield the conditions of a sensor, by its number and its name in expressions.

    In place of a condition that no coordinate changes, its error is yielded, if it does not hold.
    """
    held = _find_held(plant, sensor)
    for weights, (lower, upper) in _weigh(aims):
        fixed = sum(weight * held[place] for place, weight in weights.items() if place in held)
        moved = {place: weight for place, weight in weights.items() if place not in held and abs(weight) > ROUNDED}
        if moved:
            parts = [f"{weight!r}*{AXES[k]}{AXES[j]}_{name}" for (k, j), weight in sorted(moved.items())]
            yield Condition(" + ".join(parts).replace("+ -", "- "), (lower - fixed, upper - fixed))
        elif not lower - HOLDS <= fixed <= upper + HOLDS:
            yield max(lower - fixed, fixed - upper)


def _find_held(plant: Plant, sensor: int) -> dict[tuple[int, int], float]:
    """Return the components of a sensor's axes that no coordinate changes."""
    found = np.asarray(plant("attitudes", q=neutral(plant.manifest))["attitude"])[:, 3 * sensor : 3 * sensor + 3]
    slopes = next((a for a in plant.describe("jac_attitudes").outputs if a.name == "jac_attitude_q"), None)
    moved = set() if slopes is None else set(range(slopes.rows) if slopes.row is None else slopes.row)
    places = ((k, j) for k in range(3) for j in range(3) if 9 * sensor + 3 * k + j not in moved)
    return {(k, j): float(found[j, k]) for k, j in places}


def _weigh(aims: Aims) -> Iterator[tuple[Weights, Range]]:
    """Yield the weights of components of axes in each condition, and its range."""
    targets = {k: np.array(target) for k, target in aims}
    if len(targets) == 1:
        ((k, t),) = targets.items()
        for p in _find_across(t):
            yield {(k, j): float(p[j]) for j in range(3)}, (0.0, 0.0)
        yield {(k, j): float(t[j]) for j in range(3)}, (0.0, math.inf)
        return
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3  # (t x r)_i = t_a r_b - t_b r_a
        weights = {(k, b): float(t[a]) / 2 for k, t in targets.items()}
        yield weights | {(k, a): -float(t[b]) / 2 for k, t in targets.items()}, (0.0, 0.0)
    yield {(k, j): float(t[j]) for k, t in targets.items() for j in range(3)}, (1.0, math.inf)


def _find_across(t: Array) -> tuple[Array, Array]:
    """Return two directions across a unit vector; the first one across the coordinate axis farthest from it, too."""
    p = np.cross(t, np.eye(3)[int(np.abs(t).argmin())])
    p /= np.linalg.norm(p)
    return p, np.cross(t, p)
