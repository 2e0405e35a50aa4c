"""The front of a chart: the marks that no other mark beats in both time and error, and a sentence about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbsrun.measuring.points import Cost


@dataclass(frozen=True)
class Mark:
    """A point of a chart."""

    series: str
    label: str
    cost: Cost | None
    error: float | None
    marker: str = "o"
    is_failure: bool = False

    @property
    def name(self) -> str:
        """Return series and label; the label alone where it begins with the series."""
        if self.label.startswith(self.series):
            return self.label
        return f"{self.series} ({self.label})" if self.label else self.series


def find_front(marks: Sequence[Mark]) -> list[Mark]:
    """Return the marks on the front, from the fastest to the most accurate; the time is the shortest of the rounds."""
    known = [m for m in marks if m.cost is not None and m.error is not None and not m.is_failure]
    front: list[Mark] = []
    for mark in sorted(known, key=lambda m: (_time(m), _error(m))):
        if not front or _error(mark) < _error(front[-1]):
            front.append(mark)
    return front


def describe_front(marks: Sequence[Mark], unit: str) -> str:
    """Describe both ends of the front in one sentence."""
    front = find_front(marks)
    if not front:
        return "Nothing was measured here."
    first, last = front[0], front[-1]
    if first is last:
        return f"{first.name} is both the fastest and the most accurate: {_write(first, unit)}."
    return f"Fastest: {first.name}, {_write(first, unit)}; most accurate: {last.name}, {_write(last, unit)}."


def _write(mark: Mark, unit: str) -> str:
    error = f"with an error of {_error(mark):.0e}" if _error(mark) else "without error"
    return f"{_time(mark):.3g} {unit} {error}"


def _time(mark: Mark) -> float:
    assert mark.cost is not None, "only marks with a time are compared"
    return mark.cost.shortest


def _error(mark: Mark) -> float:
    assert mark.error is not None, "only marks with an error are compared"
    return mark.error
