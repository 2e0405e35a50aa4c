"""Limits of a computation of unknown length: a number of steps, and seconds of processor time.

allowance = Allowance(Limits(steps=1000, seconds=10.0))
while solver.status == "running":
    allowance.spend()  # raises LimitError before step 1001, and after 10 s
    solver.step()
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from mbsgen.errors import MbsError


@dataclass(frozen=True)
class Limits:
    """Limits of a computation; math.inf seconds are no limit."""

    steps: int = 10_000_000
    seconds: float = 60.0  # of processor time of one thread: neither a loaded machine nor a compiler counts


class LimitError(MbsError):
    """A computation that has used up its limit."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding, self.remedy = finding, remedy
        super().__init__(f"{finding}; {remedy}")


class Allowance:
    """The rest of the limits of one computation, from its construction on."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._steps, self._start = 0, time.thread_time()

    @property
    def steps(self) -> int:
        """Return the number of steps that remain."""
        return self._limits.steps - self._steps

    def spend(self, steps: int = 1) -> None:
        """Count steps that are about to be taken. Raises LimitError if a limit is exceeded."""
        if steps > self.steps:
            raise LimitError(f"the limit of {self._limits.steps} steps is reached", "raise max_steps")
        if time.thread_time() - self._start >= self._limits.seconds:
            finding = f"the limit of {self._limits.seconds:g} s of processor time is reached"
            raise LimitError(finding, "raise max_seconds, take longer steps, or loosen the tolerance")
        self._steps += steps

    def note(self, steps: int) -> None:
        """Count steps that were taken without asking."""
        self._steps += steps
