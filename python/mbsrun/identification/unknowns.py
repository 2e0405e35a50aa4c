"""The unknown numbers of an identification: a mechanism with its present numbers, and settings -> a list with names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import abbreviate, nearest
from mbsgen.manifest import Manifest, Seat
from mbsgen.roles import MOMENTS
from mbsrun.identification.settings import (
    ARMATURE,
    DAMPING,
    ENCODER,
    FALL,
    FRICTION,
    INERTIA,
    KINDS,
    MOTOR,
    OFFSET,
    STRIBECK,
    IdentificationError,
    Settings,
)

Array = NDArray[np.float64]

FALLS, PARAMETER = "fall", "parameter"  # further kinds: the speed of the Stribeck effect; a number of the model
NONLINEAR = (FALLS, ENCODER, PARAMETER)  # kinds by which the equations are not linear
TENSOR = ("Jzz", "Jxx", "Jxy", "Jxz", "Jyz", "Jyy")  # in the order in which they are preferred
UNITS = {"m": "kg", "S": "kg m", "J": "kg m2"}


@dataclass(frozen=True)
class Unknown:
    """A number to be found."""

    name: str  # e.g. "Jzz[forearm]", "damping[elbow]"
    kind: str
    value: float  # the present one
    unit: str
    owner: str  # a body, a joint, or the parameter
    joint: int = -1  # entry of qd, of a joint's number
    body: int = -1  # frame of the manifest, of an inertia
    moment: int = -1  # of `roles.MOMENTS`
    column: tuple[float, ...] = ()  # of an inertia: the moments of a unit of it about the origin of that frame

    @property
    def is_linear(self) -> bool:
        """Return whether forces are linear in it."""
        return self.kind not in NONLINEAR


def list_unknowns(manifest: Manifest, numbers: Any, settings: Settings) -> tuple[Unknown, ...]:
    """List the unknown numbers, in the order in which they give base parameters their names.

    `numbers` is an `mbsgen.renumbering.Numbers`. Raises IdentificationError for names that the model does not have.
    """
    parameters = {p.name: p.value for p in (*manifest.parameters, *manifest.design)} | dict(settings.parameters)
    joints = [c.name for c in manifest.coordinates]
    bodies = {body.name: body for body in numbers.bodies}
    for word in settings.unknown:
        _check_name(word, [*KINDS], "kind of unknown numbers")
    for word in settings.fitted:
        _check_name(word, [*parameters], "parameter")
    for name in settings.bodies:
        _check_name(name, list(bodies), "body")
    for name in (*settings.joints, *settings.noise, *settings.currents, *settings.motors, *settings.unmeasured):
        _check_name(name, joints, "joint")
    chosen = [i for i, name in enumerate(joints) if not settings.joints or name in settings.joints]
    known = {x.name: x for x in numbers.joints}
    found: list[Unknown] = []
    for kind in (x for x in KINDS if x in settings.unknown and x != INERTIA):
        for i in chosen:
            found += _list_of_joint(kind, i, manifest, known, settings)
    found += [Unknown(x, PARAMETER, parameters[x], "", x) for x in settings.fitted]
    if INERTIA in settings.unknown:
        wanted = settings.bodies or tuple(x.name for x in numbers.bodies if x.is_carried and any(x.moments))
        frames = [(seat, bodies[seat.name]) for seat in _list_seats(manifest) if seat.name in wanted]
        if missing := [name for name in wanted if name not in [seat.name for seat, _ in frames]]:
            raise IdentificationError(f"{', '.join(missing)} cannot move: choose bodies that joints carry")
        found = _arrange(found, frames)
    elif settings.bodies:
        raise IdentificationError(f"bodies are named, but {INERTIA} is not unknown; add it to the unknown numbers")
    if not found:
        determined = f"no number is unknown: no joint of {manifest.model} has {' or '.join(settings.unknown) or 'any'}"
        raise IdentificationError(f"{determined}; choose some of {', '.join(KINDS)}")
    return tuple(found)


def _list_seats(manifest: Manifest) -> list[Seat]:
    """List the frames of bodies that move, in the frames of the manifest, from the base on."""
    seats = manifest.appearance.bodies if manifest.appearance is not None else ()
    return sorted((seat for seat in seats if seat.frame >= 0), key=lambda seat: seat.frame)


def place_moments(seat: Seat) -> Array:
    """Return the moments about the origin of the manifest's frame of each unit in a body's own frame, (10, 10)."""
    d, R = np.array(seat.at), np.array(seat.axes).reshape(3, 3).T
    upper, columns = np.triu_indices(3), []
    for unit in np.eye(10):
        m, S, J = unit[0], R @ unit[1:4], np.zeros((3, 3))
        J[upper] = unit[4:]
        J = R @ (J + np.triu(J, 1).T) @ R.T
        J = J + (m * (d @ d) + 2 * (d @ S)) * np.eye(3) - m * np.outer(d, d) - np.outer(d, S) - np.outer(S, d)
        columns.append([m, *(S + m * d), *J[upper]])
    return np.array(columns).T


def _arrange(own: Sequence[Unknown], frames: Sequence[tuple[Seat, Any]]) -> list[Unknown]:
    """Put tensors and first moments, from the base on, before rotors, and masses last: these become parts of others."""
    inertias = [[_make_inertia(k, body, name) for name in (*TENSOR, "Sx", "Sy", "Sz")] for k, body in frames]
    masses = [_make_inertia(k, body, "m") for k, body in frames]
    rotors = [x for x in own if x.kind == ARMATURE]
    return [*(x for x in own if x.kind != ARMATURE), *(x for each in inertias for x in each), *rotors, *masses]


def _make_inertia(seat: Seat, body: Any, name: str) -> Unknown:
    k, column = MOMENTS.index(name), place_moments(seat)
    return Unknown(
        f"{name}[{body.name}]",
        INERTIA,
        body.moments[k],
        UNITS[name[0]],
        body.name,
        body=seat.frame,
        moment=k,
        column=tuple(column[:, k].tolist()),
    )


def _list_of_joint(kind: str, i: int, manifest: Manifest, known: Any, settings: Settings) -> list[Unknown]:
    joint = manifest.coordinates[i]
    own, force, place = known.get(joint.name), joint.force_unit, joint.unit
    has_law = own is not None and manifest.positions.count(joint.name) == 1
    has_torque = i in manifest.actuated and joint.name not in settings.unmeasured
    per_speed = "N m s" if place == "rad" else "N s/m"

    def make(kind: str, value: float, unit: str) -> Unknown:
        return Unknown(f"{kind}[{joint.name}]", kind, value, unit, joint.name, joint=i)

    match kind:
        case "armature" if has_law:
            return [make(ARMATURE, own.armature, "kg m2" if place == "rad" else "kg")]
        case "damping" if has_law:
            return [make(DAMPING, own.damping, per_speed)]
        case "friction" if has_law:
            return [make(FRICTION, own.torque, force)]
        case "stribeck" if has_law:
            return [make(STRIBECK, 0.0, force), make(FALLS, FALL, f"{place}/s")]
        case "offset" if has_torque:
            return [make(OFFSET, 0.0, force)]
        case "motor" if joint.name in settings.currents:
            return [make(MOTOR, settings.motors.get(joint.name, 0.0), f"{force}/A")]
        case "encoder" if has_law:
            return [make(ENCODER, 0.0, place)]
    return []


def _check_name(name: str, known: Sequence[str], kind: str) -> None:
    if name in known:
        return
    meant = nearest(name, list(known))
    remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {', '.join(known) or 'none'}"
    raise IdentificationError(f"no {kind} is named {abbreviate(name)}; {remedy}")


def list_speeds(manifest: Manifest, numbers: Any, settings: Settings) -> Array:
    """Return the speed of dry friction of each joint, (n,)."""
    known = {x.name: x.speed for x in numbers.joints}
    return np.array([known.get(c.name) or settings.speed for c in manifest.coordinates])
