"""The interface of an import: choices in, a model with notices out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from mbsgen.importing.findings import Notice
from mbsgen.model.model import Model

Mimic = Literal["couple", "free", "lock"]


@dataclass(frozen=True)
class Choices:
    """Choices that a file leaves open, or that a model needs."""

    name: str | None = None  # of the model; None: the file's
    base: Literal["fixed", "floating"] = "fixed"  # whether the root link of URDF is fixed to the base
    gravity: tuple[float, float, float] | None = None  # None: the file's, or 9.81 m/s2 down the z axis
    sensors: tuple[str, ...] = ()  # links, bodies and sites that become frames
    locked: tuple[tuple[str, float], ...] = ()  # joints that are held, with their coordinates [rad or m]
    lock_massless: bool = False  # hold joints whose accelerations nothing determines, at 0
    mimic: Mimic = "couple"  # the treatment of joints that follow others
    loop_tolerance: float | None = None  # of equations that follow from others; None: by the digits of the file
    rigid_tendons: bool = False  # of muscles, whatever the file says
    degroote: bool = False  # curves of all muscles, whatever the file says
    opened: tuple[str, ...] = ()  # links and bodies with a wrench that a use gives, and a sensor
    quaternions: bool = False  # for balls and free bodies; else turns about z, y, x
    friction_speed: float = 0.01  # at which 3/4 of dry friction are reached [rad/s or m/s]
    dry_friction: bool = False  # joints stick and slide, in simulations; else friction is smoothed
    stops: float | None = None  # the restitution of rigid stops at all limits; None: no stops
    contacts: float | None = None  # the restitution of rigid contacts of the geoms of MJCF; None: no contacts
    contacts_of: Literal["all", "planes"] = "all"  # the pairs of geoms that have contacts
    quarter_turns: float = 1e-11  # angles nearer than this to a quarter turn are rounded to it [rad]
    allow_unphysical: bool = False  # accept inertias that no body can have
    root: Path | None = None  # the folder that holds all files which the file names; None: the file's own


@dataclass(frozen=True)
class FileCoordinate:
    """A coordinate of the file: ratio times the coordinate of a joint of the model, plus offset."""

    name: str
    joint: str  # "": it stands still, at the offset
    ratio: float
    offset: float


@dataclass(frozen=True)
class Imported:
    """A model of a file in another format, and the notices about it."""

    model: Model
    notices: tuple[Notice, ...]  # changes and omissions; effects on the motion first
    visible: tuple[str, ...] = ()  # names in the file of possible sensors
    labels: Mapping[str, str] = field(default_factory=dict)  # of sensors and forces: names in the file
    coordinates: tuple[FileCoordinate, ...] = ()  # of a file whose joints have several
    balls: tuple[tuple[str, str, str], ...] = ()  # coordinates whose speeds in the file are angular velocities


class MasslessError(Exception):
    """Raised where the choices ask that joints be held which move nothing: their names in the file."""

    def __init__(self, joints: Sequence[str]) -> None:
        self.joints = joints
        super().__init__(", ".join(joints))
