"""A mechanism between independent coordinates and everything else: closed loops, driven joints, sensors, accelerations.

Only the kernels that `mechanisms` and `loops` examine are called; loops are closed by Newton's method of this module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.fuzz.formulas import Drive
from tests.fuzz.own_motion import NoMotionError
from tests.fuzz.problem_names import Mechanical, spell

Array = NDArray[np.float64]
Known = dict[str, Array]

CLOSED = 1e-13  # the change of the last step of Newton's method, relative
STEPS = 40


@dataclass(frozen=True)
class Acceleration:
    """Accelerations of all coordinates, and forces of driven joints."""

    qdd: Array
    tau: Array


class Mechanism:
    """The mechanism of a problem; `numbers` are what motions of driven joints read beside the time."""

    def __init__(
        self, own: Mechanical, plant: Any, drives: Mapping[str, Drive], numbers: Mapping[str, float | Array]
    ) -> None:
        self.own, self.plant, self.numbers = own, plant, numbers
        names = own.velocities
        self.drives = [drives[names[i]] for i in own.driven]
        self.places = [own.positions.index(names[i]) for i in own.driven]
        free = own.independent if own.is_closed else range(len(names))
        self.carried = [i for i in free if i not in own.driven]
        named = {names[i] for i in self.carried}
        self.carried_places = [i for i, name in enumerate(own.positions) if name in named or name in own.turning]
        if not own.is_closed:
            self.carried_places = [i for i in range(len(own.positions)) if i not in self.places]

    def drive(self, t: Array) -> tuple[Array, Array, Array]:
        """Return coordinates, velocities and accelerations of driven joints, (places, d) each."""
        known = {**self.numbers, "t": t}
        every = [(x, x.rate, x.second) for x in self.drives]
        found = [[np.broadcast_to(x.evaluate(known), t.shape) for x in orders] for orders in every]
        return tuple(np.array([x[k] for x in found]).reshape(len(every), len(t)).T for k in range(3))  # type: ignore[return-value]

    def expand(self, y: Array, yd: Array, t: Array) -> tuple[Array, Array]:
        """Return coordinates and velocities of all joints at some places."""
        own = self.own
        q, qd = np.tile(np.array(own.pose), (len(y), 1)), np.zeros((len(y), len(own.velocities)))
        q[:, self.carried_places], qd[:, self.carried] = y, yd
        q[:, self.places], qd[:, list(own.driven)], _ = self.drive(t)
        return self.close(q, qd)

    def close(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Find the dependent coordinates and velocities. Raises NoMotionError."""
        own = self.own
        if not own.is_closed:
            return q, qd
        q, qd, dependent = q.copy(), qd.copy(), list(own.dependent)
        places = [own.positions.index(own.velocities[i]) for i in dependent]
        for _ in range(STEPS):
            J = self.plant("loop_jacobian", q=q, qd=qd)["J"].reshape(len(q), len(dependent), -1)
            h = self.plant("loops", q=q)["gap"]
            step = np.linalg.solve(J[:, :, dependent], h[:, :, None])[:, :, 0]
            q[:, places] -= np.clip(step, -0.3, 0.3)
            if not np.isfinite(q).all():
                break
            if abs(step).max(initial=0) <= CLOSED * (1 + abs(q).max()):
                J = self.plant("loop_jacobian", q=q, qd=qd)["J"].reshape(len(q), len(dependent), -1)
                qd[:, dependent] = 0.0
                right = (J @ qd[:, :, None])[:, :, 0]
                qd[:, dependent] = -np.linalg.solve(J[:, :, dependent], right[:, :, None])[:, :, 0]
                return q, qd
        raise NoMotionError("the loops do not close")

    def accelerate(self, q: Array, qd: Array, u: Array, w: Array, a: Array) -> Acceleration:
        """Return accelerations and forces where driven joints have the accelerations a."""
        given = {"q": q, "qd": qd, "u": u} | ({"w": w} if w.shape[1] else {}) | ({"a": a} if a.shape[1] else {})
        found = self.plant("exp1", **{key: np.ascontiguousarray(x) for key, x in given.items()})
        return Acceleration(found["qdd"], found.get("tau", np.zeros((len(q), 0))))

    def know(self, q: Array, qd: Array) -> Known:
        """Name coordinates, velocities and sensors."""
        own = self.own
        known = {f"q_{spell(x)}": q[:, i] for i, x in enumerate(own.positions)}
        known |= {f"qd_{spell(x)}": qd[:, i] for i, x in enumerate(own.velocities)}
        if own.sensors:
            places, speeds = self.plant("sensors", q=q)["position"], self.plant("motion", q=q, qd=qd)["v"]
            for i, name in enumerate(own.sensors):
                for j, axis in enumerate("xyz"):
                    known[f"{axis}_{spell(name)}"] = places[:, j, i]
                    known[f"v{axis}_{spell(name)}"] = speeds[:, j, i]
        return known

    def find_quaternions(self) -> list[int]:
        """List the first entries of quaternions."""
        return [i for i, x in enumerate(self.own.positions) if x.endswith(".qx")]

    def turn(self, q: Array, qd: Array) -> Array:
        """Return the derivatives of coordinates: of a quaternion, half its product with the angular velocity.

        A free body has its velocity along its own axes.
        """
        own, rates = self.own, np.zeros_like(q)
        for i, name in enumerate(own.positions):
            if name not in own.turning:
                rates[:, i] = qd[:, own.velocities.index(name)]
        for first in self.find_quaternions():
            joint = own.positions[first].removesuffix(".qx")
            omega = qd[:, [own.velocities.index(f"{joint}.r{x}") for x in "xyz"]]
            v, s = q[:, first : first + 3], q[:, first + 3 : first + 4]
            rates[:, first : first + 3] = (s * omega + np.cross(v, omega)) / 2
            rates[:, first + 3] = -(v * omega).sum(axis=1) / 2
            if f"{joint}.x" in own.positions:
                rates[:, first - 3 : first] = rotate(v, s, rates[:, first - 3 : first])
        return rates


def rotate(v: Array, s: Array, x: Array) -> Array:
    """Turn vectors (places, 3) by quaternions of any length."""
    t = 2 * np.cross(v, x) / ((v**2).sum(axis=1, keepdims=True) + s**2)
    return np.asarray(x + s * t + np.cross(v, t))
