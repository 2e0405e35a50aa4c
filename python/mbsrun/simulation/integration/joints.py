"""Joints with rigid stops and dry friction: their numbers, by mode, as the C functions take them.

A joint that slides is braked by T(qd) = torque + (static - torque) exp(-(qd/stribeck)^2), or by `torque` alone. The
force that holds a joint at rest is at most `static`, either way; a stop adds any force away from it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Manifest
from mbsrun.simulation.integration.explicit import Brakes
from mbsrun.simulation.motion import FORCE, PLACE, SPEED, Guard, Kind, Mode

Array = NDArray[np.float64]

TOUCH = 1e-12  # m, rad: a joint that is as near to a stop touches it
STILL = 1e-13  # of the fastest velocity: a slower joint rests
SLACK = 2e-14  # of the forces of a joint: by how much the force that holds it may exceed the most that can
RESTS = int(Mode.STICKS)  # the first of the modes in which a joint is at rest


def are_held(modes: ArrayLike) -> NDArray[np.bool_]:
    """Return whether joints rest, by their modes: they stick, or rest on a stop."""
    return np.asarray(modes) >= RESTS


@dataclass(frozen=True, eq=False)
class Joints:
    """Stops and dry friction by joint, (n,) each."""

    manifest: Manifest
    place: tuple[int, ...]  # the entry of q; -1 of a joint with a quaternion
    lower: Array  # infinite where nothing stops the joint
    upper: Array
    restitution: Array
    is_dry: NDArray[np.bool_]
    torque: Array
    static: Array
    stribeck: Array  # 0: none
    one_way: NDArray[np.int_]  # 1, -1: the only way in which a clutch lets the joint move
    is_driven: NDArray[np.bool_]
    driven: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, manifest: Manifest) -> Joints:
        """Read them from a manifest."""
        joints, positions = manifest.coordinates, {name: k for k, name in enumerate(manifest.positions)}
        rigid = [None if c.stops is None or c.stops.restitution is None else c.stops for c in joints]
        dry = [c.friction for c in joints]
        return cls(
            manifest,
            tuple(positions.get(c.name, -1) for c in joints),
            np.array([-np.inf if x is None or x.lower is None else x.lower for x in rigid]),
            np.array([np.inf if x is None or x.upper is None else x.upper for x in rigid]),
            np.array([0.0 if x is None or x.restitution is None else x.restitution for x in rigid]),
            np.array([x is not None for x in dry], dtype=np.bool_),
            np.array([0.0 if x is None else x.torque for x in dry]),
            np.array([0.0 if x is None else x.static for x in dry]),
            np.array([0.0 if x is None or x.stribeck is None else x.stribeck for x in dry]),
            np.array([0 if x is None else x.one_way for x in dry], dtype=np.int_),
            np.isin(np.arange(len(joints)), manifest.driven),
            list(manifest.driven),
        )

    def find_beyond(self, q: Array) -> list[tuple[str, float, float]]:
        """Find joints beyond a stop: the name, the coordinate and the stop."""
        return [
            (self.manifest.coordinates[i].name, float(q[k]), float(stop))
            for i, k in enumerate(self.place)
            for side, stop in ((1, self.lower[i]), (-1, self.upper[i]))
            if np.isfinite(stop) and side * (q[k] - stop) < -TOUCH * max(1.0, abs(stop))
        ]

    @property
    def starting(self) -> Array:
        """The friction of joints that start to slide: the static one where it falls over a Stribeck speed."""
        return np.where(self.stribeck > 0, self.static, self.torque)

    def rub(self, qd: Array) -> Array:
        """Return the friction of sliding joints, at velocities (..., n), against the motion."""
        slowness = np.divide(1.0, self.stribeck, out=np.zeros_like(self.stribeck), where=self.stribeck > 0)
        fall = np.where(self.stribeck > 0, self.static - self.torque, 0.0)
        return np.asarray(self.torque + fall * np.exp(-((qd * slowness) ** 2)))

    def steepen(self, qd: Array) -> Array:
        """Return the derivative of the friction of sliding joints by their velocities (..., n)."""
        slowness = np.divide(1.0, self.stribeck, out=np.zeros_like(self.stribeck), where=self.stribeck > 0)
        return np.asarray(-2 * slowness**2 * qd * (self.rub(qd) - self.torque))

    def brake(self, modes: NDArray[np.int_], forces: Array, locking: NDArray[np.intp]) -> Brakes:
        """Return held joints, and the friction of others, for the C functions.

        `locking` joints hold all joints at rest; others at rest are braked by their constant `forces` (n,).
        """
        slowness = np.divide(1.0, self.stribeck, out=np.zeros_like(self.stribeck), where=self.stribeck > 0)
        fall = np.where(self.stribeck > 0, self.static - self.torque, 0.0)
        sign = np.where(np.abs(modes) == 1, modes, 0).astype(np.float64)
        held = np.isin(np.arange(len(modes)), locking)
        rests = are_held(modes) & ~held
        torque = np.where(rests, -forces, self.torque)
        return Brakes(
            held.astype(int).tolist(), np.where(rests, 1.0, sign), torque, np.where(rests, 0.0, fall), slowness
        )

    def guard(self, modes: NDArray[np.int_], forces: Array, locking: NDArray[np.intp]) -> list[Guard]:
        """List what must hold while the modes last; `forces` hold joints at rest, of which `locking` ones vary."""
        found = []
        for i, mode in enumerate(modes):
            place = self.place[i]
            if mode >= RESTS:
                if i not in locking:
                    continue
                most, slack = self.static[i], SLACK * max(self.static[i], np.abs(forces).max())
                if mode != Mode.LOWER and self.one_way[i] <= 0:
                    found.append(Guard(FORCE, i, place, -1.0, most + slack))
                if mode != Mode.UPPER and self.one_way[i] >= 0:
                    found.append(Guard(FORCE, i, place, 1.0, -most - slack))
                continue
            if abs(mode) == 1:
                found.append(Guard(SPEED, i, place, float(mode), 0.0))
            if np.isfinite(self.lower[i]):
                found.append(Guard(PLACE, i, place, 1.0, float(self.lower[i])))
            if np.isfinite(self.upper[i]):
                found.append(Guard(PLACE, i, place, -1.0, float(self.upper[i])))
        return found

    def touch(self, q: Array) -> NDArray[np.int_]:
        """Return 1 for joints at their lower stops, -1 for joints at their upper ones; put them there exactly, in q."""
        sides = np.zeros(len(self.place), dtype=np.int_)
        for i, k in enumerate(self.place):
            for side, stop in ((1, self.lower[i]), (-1, self.upper[i])):
                if np.isfinite(stop) and side * (q[k] - stop) <= TOUCH * max(1.0, abs(stop)):
                    sides[i], q[k] = side, stop
        return sides

    def press(self, sides: NDArray[np.int_]) -> NDArray[np.int_]:
        """Return the same for clutches too, which let a joint move away from where it is in one way alone."""
        return np.where(self.one_way != 0, self.one_way, sides)

    def find_stops(self, sides: NDArray[np.int_]) -> Array:
        """Return the places of the stops that are touched, else 0."""
        stops = np.where(sides > 0, self.lower, np.where(sides < 0, self.upper, 0.0))
        return np.where(np.isfinite(stops), stops, 0.0)

    def still(self, qd: Array, fastest: float) -> None:
        """Set velocities to 0 that are rounding of rest, where the fastest one was `fastest`."""
        switching = self.is_dry | np.isfinite(self.lower) | np.isfinite(self.upper)
        qd[switching & (np.abs(qd) <= STILL * fastest)] = 0.0


def name_change(old: int, new: int) -> Kind | None:
    """Return the event that a change of a joint's mode is, impacts aside."""
    if old == new:
        return None
    slides = (1, -1)
    if new == Mode.STICKS:
        return Kind.STICK
    if old == Mode.STICKS and new in slides:
        return Kind.SLIP
    if new in (Mode.LOWER, Mode.UPPER):
        return Kind.REST
    if old in (Mode.LOWER, Mode.UPPER):
        return Kind.LEAVE
    return Kind.REVERSE if old in slides and new in slides else None
