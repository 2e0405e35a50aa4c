"""Identification: models and recorded motions with torques -> inertias and frictions with their uncertainty."""

from mbsrun.identification.excitation import Excitation, Wishes, excite
from mbsrun.identification.identify import identify
from mbsrun.identification.result import Base, Identification, Torque, Trace
from mbsrun.identification.settings import KINDS, IdentificationError, Settings

__all__ = [
    "KINDS",
    "Base",
    "Excitation",
    "Identification",
    "IdentificationError",
    "Settings",
    "Torque",
    "Trace",
    "Wishes",
    "excite",
    "identify",
]
