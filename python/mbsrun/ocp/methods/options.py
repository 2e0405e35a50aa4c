"""Options of NLP methods: what a value must be.

A problem file comes from anywhere, and solvers have options that write files or load libraries: a method passes on only
the options in its table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Setting = float | int | str
Settings = Mapping[str, Setting]


@dataclass(frozen=True)
class Amount:
    """An option that is a number within a range; `whole` asks for a whole one."""

    least: float
    most: float
    whole: bool = False

    @property
    def wanted(self) -> str:
        """Describe the values that are admitted."""
        return f"a {'whole ' if self.whole else ''}number from {self.least:g} to {self.most:g}"

    def admits(self, value: object) -> bool:
        """Return whether a value is admitted."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return self.least <= value <= self.most and (not self.whole or value == int(value))


@dataclass(frozen=True)
class Choice:
    """An option that is one of some words."""

    words: tuple[str, ...]

    @property
    def wanted(self) -> str:
        """Describe the values that are admitted."""
        return f"one of {', '.join(self.words)}"

    def admits(self, value: object) -> bool:
        """Return whether a value is admitted."""
        return value in self.words


Option = Amount | Choice

POSITIVE = Amount(1e-20, 1e20)
FRACTION = Amount(0.0, 1.0)
COUNT = Amount(0, 100_000, whole=True)
SWITCH = Choice(("yes", "no"))
