"""Closed loops: a predictive controller, a simulated plant and its disturbances in; the motion and its figures out."""

from mbsrun.tracking.controller import Controller, Decision
from mbsrun.tracking.loop import NoPlanError, Sample, Track, track
from mbsrun.tracking.plant import Plant
from mbsrun.tracking.solving import SolvingController
from mbsrun.tracking.trial import Fallback, Horizon, Kick, Measure, Noise, Push, Trial

__all__ = [
    "Controller",
    "Decision",
    "Fallback",
    "Horizon",
    "Kick",
    "Measure",
    "NoPlanError",
    "Noise",
    "Plant",
    "Push",
    "Sample",
    "SolvingController",
    "Track",
    "Trial",
    "track",
]
