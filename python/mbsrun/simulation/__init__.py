"""Forward simulation: a model, its inputs over time and a state in; the motion, its energy and pictures out."""

from mbsrun.simulation.drive import Drive, control
from mbsrun.simulation.methods import METHODS, Formulation
from mbsrun.simulation.motion import Motion, Settings
from mbsrun.simulation.simulate import simulate

__all__ = ["METHODS", "Drive", "Formulation", "Motion", "Settings", "control", "simulate"]
