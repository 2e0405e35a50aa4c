"""Forward simulation: a model, its inputs over time and a state in; the motion, its energy and pictures out."""

from mbsrun.closure import OpenError
from mbsrun.simulation.course import Course, follow, stand
from mbsrun.simulation.drive import Drive, control
from mbsrun.simulation.integration.methods import METHODS, Formulation
from mbsrun.simulation.motion import Event, Impacts, Keeping, Kind, Latch, Mode, Motion, Settings
from mbsrun.simulation.saltation import Sensitivity, differentiate
from mbsrun.simulation.simulate import simulate

__all__ = [
    "METHODS",
    "Course",
    "Drive",
    "Event",
    "Formulation",
    "Impacts",
    "Keeping",
    "Kind",
    "Latch",
    "Mode",
    "Motion",
    "OpenError",
    "Sensitivity",
    "Settings",
    "control",
    "differentiate",
    "follow",
    "simulate",
    "stand",
]
