"""Recorded motions: files of CSV, TRC, MOT and STO -> Recording -> splines; and the poses that fit recorded points."""

from __future__ import annotations

from mbsrun.recordings.reading import READERS, find_column, name_coordinate, read_column, read_recording, spell
from mbsrun.recordings.recording import AXES, Column, Recording
from mbsrun.recordings.splines import SplineError, Track, Treatment, fit, fit_all, stack

__all__ = [
    "AXES",
    "READERS",
    "Column",
    "Recording",
    "SplineError",
    "Track",
    "Treatment",
    "find_column",
    "fit",
    "fit_all",
    "name_coordinate",
    "read_column",
    "read_recording",
    "spell",
    "stack",
]
