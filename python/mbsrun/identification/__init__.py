"""Identification: models and recorded motions with torques -> inertias and frictions with their uncertainty."""

from mbsrun.identification.identify import identify
from mbsrun.identification.result import Base, Identification, Torque, Trace
from mbsrun.identification.settings import KINDS, IdentificationError, Settings

__all__ = ["KINDS", "Base", "Identification", "IdentificationError", "Settings", "Torque", "Trace", "identify"]
