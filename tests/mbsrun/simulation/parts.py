"""Stops and dry friction for mechanisms of tests."""

from __future__ import annotations

import copy

from mbsgen.manifest import Friction, Stops
from mbsrun import Mechanism

Part = Stops | Friction


def equip(kernels: Mechanism, **joints: Part | tuple[Part, ...]) -> Mechanism:
    """Return a mechanism with rigid stops and dry friction, of which the kernels know nothing."""
    found, equipped = [], copy.copy(kernels)
    for coordinate in kernels.manifest.coordinates:
        given = joints.get(coordinate.name, ())
        parts = given if isinstance(given, tuple) else (given,)
        change = {"stops" if isinstance(part, Stops) else "friction": part for part in parts}
        found.append(coordinate.model_copy(update=change))
    equipped.manifest = kernels.manifest.model_copy(update={"coordinates": tuple(found)})
    return equipped


def rub(torque: float, static: float | None = None) -> Friction:
    return Friction(torque=torque, static=torque if static is None else static, stribeck=None)


def stop(lower: float | None, upper: float | None, restitution: float) -> Stops:
    return Stops(lower=lower, upper=upper, restitution=restitution)
