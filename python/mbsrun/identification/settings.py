"""The choices of an identification: the numbers that are unknown, the treatment of recordings, the estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbsgen.errors import MbsError
from mbsrun.recordings import Treatment
from mbsrun.simulation.recorded import Load

INERTIA, ARMATURE, DAMPING, FRICTION, STRIBECK, OFFSET, MOTOR, ENCODER = (
    "inertia",
    "armature",
    "damping",
    "friction",
    "stribeck",
    "offset",
    "motor",
    "encoder",
)

# Kinds of unknown numbers, each with its meaning.
KINDS: Mapping[str, str] = {
    INERTIA: "mass, first moment and tensor of each body that a joint carries",
    ARMATURE: "inertia of the rotor behind each joint",
    DAMPING: "viscous friction of each joint",
    FRICTION: "dry friction of each joint, torque tanh(qd/speed)",
    STRIBECK: "the excess of dry friction at rest, and the speed at which it fades: more exp(-(qd/fall)^2)",
    OFFSET: "constant error of each measured torque or current",
    MOTOR: "torque for each unit of current",
    ENCODER: "constant error of each measured coordinate",
}
LOSSES = ("squares", "huber")
SPEED = 0.02  # at which 3/4 of dry friction are reached, where the model has none [rad/s, m/s]
FALL = 0.2  # from which the speed of the Stribeck effect is sought [rad/s, m/s]


class IdentificationError(MbsError):
    """Recordings or choices from which nothing can be identified."""


@dataclass(frozen=True)
class Settings:
    """The choices of an identification."""

    unknown: tuple[str, ...] = (INERTIA,)  # of KINDS
    fitted: tuple[str, ...] = ()  # unknown parameters of the model, by name
    bodies: tuple[str, ...] = ()  # whose inertia is unknown; (): all that joints carry
    joints: tuple[str, ...] = ()  # whose friction, rotors, offsets and motors are unknown; (): all
    treatment: Treatment = field(default_factory=Treatment)  # of recorded coordinates; its filter serves torques too
    columns: Mapping[str, str] = field(default_factory=dict)  # of coordinates that have other names
    torques: Mapping[str, str] = field(default_factory=dict)  # the columns of torques that have other names
    currents: Mapping[str, str] = field(default_factory=dict)  # the columns of motor currents, by joint
    motors: Mapping[str, float] = field(default_factory=dict)  # torque for a unit of current [N m/A], by joint
    unmeasured: tuple[str, ...] = ()  # actuated joints without a measured torque
    loads: Mapping[str, Load] | None = None  # the columns of open wrenches
    noise: Mapping[str, float] = field(default_factory=dict)  # of torques, by joint; else by the residuals
    speed: float = SPEED  # of dry friction, in joints where the model has none
    loss: str = LOSSES[0]
    prior: float | None = None  # relative standard deviation of the model's own inertias; None: no opinion
    unphysical: bool = False  # admit bodies that nobody can build
    parts: int = 5  # of a single recording, for the cross validation
    parameters: Mapping[str, float] = field(default_factory=dict)  # of the model, in place of the file's


DEFAULT = Settings()
