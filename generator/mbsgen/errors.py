"""Errors that a user can mend.

A `Fault` is one finding in one place of a file; `InputError` carries all faults of a file at once. Every exception that
a user may meet derives from `MbsError`, and the command lines print it without a traceback.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, order=True)
class Fault:
    """One finding: its place, what was found, and what to do."""

    file: str
    line: int  # from 1; 0 for the whole file
    path: str  # e.g. `bodies[2].joint.axis`; empty for the whole file
    finding: str
    remedy: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        path = f" {self.path}:" if self.path else ""
        return f"{place}:{path} {self.finding}; {self.remedy}"


class MbsError(Exception):
    """An error for the user to mend, or a fault of the machine; its text is complete without a traceback."""


class InputError(MbsError):
    """A file that cannot be accepted, with every fault found in it."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        assert faults, "an InputError needs a fault"
        self.faults = tuple(sorted(faults))
        super().__init__("\n".join(map(str, self.faults)))


class TapeError(MbsError):
    """A tape that cannot be built, differentiated or evaluated as asked."""
