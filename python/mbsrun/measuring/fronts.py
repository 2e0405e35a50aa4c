"""Measured settings as lines of work against error, and the findings that a reader acts on, in words.

A dot is one setting of a method, and a line holds the dots of a method. The *front* of some dots is the dots that no
other one beats in both work and error. To *reach* an error means a dot with this error or a smaller one, so no number
is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

ALIKE = 1.1  # works count as equal within a tenth
SHOWN = 7  # lines of a panel that have a name
EXACT = 1e-12  # a larger error is not of rounding alone
DIGIT = 10.0  # errors count as equal to a digit
USELESS = 0.1  # larger errors are of no use to a reader


@dataclass(frozen=True)
class Dot:
    """One setting of a method."""

    line: str  # the method
    setting: str  # its step, tolerance, precision, …
    work: float | None  # None: it failed
    error: float | None
    finding: str = ""  # why it failed
    command: str = ""  # repeats it

    @property
    def is_good(self) -> bool:
        """Return whether it has a work and an error, and did not fail."""
        return self.work is not None and self.error is not None and not self.finding

    @property
    def place(self) -> tuple[float, float]:
        """Return work and error of a good dot."""
        assert self.work is not None, "a good dot has a work"
        assert self.error is not None, "a good dot has an error"
        return self.work, self.error

    @property
    def name(self) -> str:
        """Return method and setting."""
        return f"{self.line}, {self.setting}" if self.setting else self.line


@dataclass(frozen=True)
class Stretch:
    """A range of errors in which one line is the fastest."""

    line: str
    largest: float  # the error from which on it is the fastest
    least: float  # the smallest error that it reaches there


@dataclass(frozen=True)
class Panel:
    """A chart of work against error."""

    question: str  # what a reader decides by it
    dots: tuple[Dot, ...]
    work: str  # the axis across, in words
    error: str  # the axis upwards, in words
    unit: str = "s"  # of the work: "s", "ns", or "" for a count
    asked: float | None = None  # the largest error that is accepted
    choice: Dot | None = None  # the advised setting
    floor: float | None = None  # the reference is no more accurate
    whole: float | None = None  # the work without any reduction
    known: tuple[str, ...] = ()  # methods that have the same colours in several panels

    better: ClassVar[str] = "↙ better"
    worst: ClassVar[float] = 10.0  # larger errors stand there

    @property
    def across(self) -> str:
        """Return the name of the axis across."""
        return f"← {self.work}"

    @property
    def front(self) -> list[Dot]:
        """Return the dots on the front."""
        return find_front(self.good)

    @property
    def marks(self) -> dict[float, str]:
        """Return texts at places of the axis across; none."""
        return {}

    def join(self, dots: Sequence[Dot]) -> list[Dot]:
        """Return the dots of a method that its line joins: the ones on its own front."""
        return find_front(dots)

    def write_upwards(self, error: float) -> str:
        """Write an error for the axis."""
        return write_error(error)

    @property
    def good(self) -> list[Dot]:
        """List the dots that did not fail."""
        return [dot for dot in self.dots if dot.is_good]

    @property
    def lines(self) -> dict[str, list[Dot]]:
        """Return the good dots of each method, in the order of their first one."""
        lines: dict[str, list[Dot]] = {}
        for dot in self.good:
            lines.setdefault(dot.line, []).append(dot)
        return lines

    def choose_lines(self) -> list[str]:
        """Return the methods that get a name: the finding's, the choice's, then the nearest to the front."""
        front = find_front(self.good)
        if self.whole is not None:  # a reduction that saves nothing needs no name
            front = [dot for dot in front if dot.place[0] * ALIKE < self.whole]
            return [dot.line for dot in front[:SHOWN]]
        ranks = {name: min((_distance(dot, front) for dot in dots), default=0.0) for name, dots in self.lines.items()}
        first = [stretch.line for stretch in find_stretches(self.good)]
        first += [self.choice.line] if self.choice is not None else []
        return list(dict.fromkeys([*first[:SHOWN], *sorted(ranks, key=lambda name: ranks[name])]))[:SHOWN]

    @property
    def headline(self) -> str:
        """State the finding in one sentence."""
        if self.whole is not None:
            return state_savings(self.good, self.whole, self.asked)
        return state_finding(self.good, self.floor, "is the fastest" if self.unit else "needs the fewest intervals")

    @property
    def advice(self) -> str:
        """State the advised setting in one sentence; empty where nothing was asked."""
        if self.asked is None or (self.whole is not None and self.choice is None):
            return ""
        if self.choice is None:
            return f"No measured setting has errors up to {write_error(self.asked)}."
        others = f"; {self._peer} is as fast" if self._peer else ""
        return f"For errors up to {write_error(self.asked)}: {self.choice.name}, {write_work(*self._spend())}{others}."

    @property
    def note(self) -> str:
        """State what the picture leaves out."""
        failed = sum(not dot.is_good for dot in self.dots)
        parts = ["grey: the others"] if len(self.lines) > SHOWN else []
        parts += [f"{failed} settings failed" if failed > 1 else "one setting failed"] if failed else []
        if self.floor and any(dot.place[1] < 10 * self.floor for dot in self.good):
            parts.append(f"shaded: the reference errs as much, {write_error(self.floor)}")
        return "; ".join(parts)

    @property
    def _peer(self) -> str:
        """Return the line that the headline names at the asked error, where it is another one than the choice's."""
        assert self.choice is not None, "a choice was made"
        assert self.asked is not None, "an error was asked for"
        asked = max(self.asked, self.floor or 0.0)
        line = next((s.line for s in _list_stretches(self.good, self.floor) if s.least <= asked), self.choice.line)
        works = [dot.place[0] for dot in self.good if dot.line == line and dot.place[1] <= asked]
        is_alike = 1 / ALIKE <= min(works, default=math.inf) / self.choice.place[0] <= ALIKE
        return line if is_alike and line != self.choice.line else ""

    def _spend(self) -> tuple[float, str]:
        assert self.choice is not None, "a choice was made"
        return self.choice.place[0], self.unit


def find_front(dots: Sequence[Dot]) -> list[Dot]:
    """Return the dots on the front, from the cheapest to the most accurate."""
    front: list[Dot] = []
    for dot in sorted((dot for dot in dots if dot.is_good), key=lambda dot: dot.place):
        if not front or dot.place[1] < front[-1].place[1]:
            front.append(dot)
    return front


def find_stretches(dots: Sequence[Dot]) -> list[Stretch]:
    """Divide the errors, from large to small, into as few stretches as possible.

    The line of a stretch reaches each of its errors, to a digit, with the least work of all lines or a tenth more.
    """
    front = find_front(dots)
    names = list(dict.fromkeys(dot.line for dot in dots if dot.is_good))
    stretches: list[Stretch] = []
    start = 0
    while start < len(front):
        ends = {name: _follow(name, front, start, dots) for name in names}
        best = max(names, key=lambda name: (ends[name], name == front[start].line))
        largest = front[start - 1].place[1] if start else math.inf
        start = ends[best]
        stretches.append(Stretch(best, largest, front[start - 1].place[1]))
    return stretches


def _follow(name: str, front: Sequence[Dot], start: int, dots: Sequence[Dot]) -> int:
    """Return the number of the first dot of the front, from `start` on, that a line does not match."""
    own = [dot.place for dot in dots if dot.line == name and dot.is_good]
    for k, (work, error) in enumerate((dot.place for dot in front[start:]), start):
        if min((w for w, e in own if e <= DIGIT * error), default=math.inf) > ALIKE * work:
            return k
    return len(front)


def _distance(dot: Dot, front: Sequence[Dot]) -> float:
    """Return by which factor a dot is dearer than the front at its own error, as a logarithm."""
    work, error = dot.place
    cheapest = min((w for w, e in (x.place for x in front) if e <= error), default=work)
    return math.log(max(work, 1e-300) / max(cheapest, 1e-300))


def state_finding(dots: Sequence[Dot], floor: float | None = None, verb: str = "is the fastest") -> str:
    """Name the lines that are the fastest over most digits, one or two.

    Errors below `floor` are not distinguished; errors above a tenth count where there are no others.
    """
    stretches = _list_stretches(dots, floor)
    if not stretches:
        return "Nothing was measured here."
    if len(stretches) == 1:
        alone = len({dot.line for dot in dots if dot.is_good}) == 1
        return f"{stretches[0].line} {'is the only way that was measured' if alone else f'{verb} at every error'}."
    first, second = sorted(stretches, key=_measure, reverse=True)[:2]
    text = f"{_locate(first, stretches).capitalize()}, {first.line} {verb}"
    if second.line == first.line:
        return f"{text}."
    return f"{text}; {_locate(second, stretches)}, {second.line}."


def _list_stretches(dots: Sequence[Dot], floor: float | None) -> list[Stretch]:
    """Divide the errors that are of use and that the reference distinguishes."""
    good = [replace(dot, error=max(dot.place[1], floor or 0.0)) for dot in dots if dot.is_good]
    return find_stretches([dot for dot in good if dot.place[1] <= USELESS] or good)


def _measure(stretch: Stretch) -> float:
    """Return the digits of a stretch; from a tenth on, and down to 1e-17."""
    return math.log10(min(stretch.largest, USELESS) / max(stretch.least, 1e-17))


def _locate(stretch: Stretch, stretches: Sequence[Stretch]) -> str:
    """Write the errors of a stretch."""
    if stretch is stretches[0]:
        return f"above {write_error(stretch.least)}"
    if stretch is stretches[-1]:
        return f"below {write_error(stretch.largest)}"
    return f"between {write_error(stretch.largest)} and {write_error(stretch.least)}"


def state_savings(dots: Sequence[Dot], whole: float, asked: float | None = None) -> str:
    """Name the fastest reductions: one without an error, and one with an error up to `asked` or a tenth."""
    limit = 0.1 if asked is None else asked
    useful = [dot for dot in dots if dot.is_good and dot.place[0] * ALIKE < whole]
    exact = min((d for d in useful if d.place[1] < EXACT), key=lambda d: d.place[0], default=None)
    rough = min((d for d in useful if d.place[1] <= limit), key=lambda d: d.place[0], default=None)
    if rough is None:
        none = f"no reduction with errors up to {write_error(limit)} is {ALIKE:g} times faster"
        best = min(useful, key=lambda d: d.place[1], default=None)
        return f"N{none[1:]}." if best is None else f"N{none[1:]}; {_write_saving(best, whole)}."
    first = _write_saving(rough if exact is None else exact, whole)
    first = first[:1].upper() + first[1:]
    return f"{first}." if exact is None or rough is exact else f"{first}; {_write_saving(rough, whole)}."


def _write_saving(dot: Dot, whole: float) -> str:
    work, error = dot.place
    price = "without an error" if error < EXACT else f"with errors of {write_error(error)}"
    return f"{dot.line} is {_write_short(whole / work)} times faster, {price}"


def write_error(error: float) -> str:
    """Write an error with one digit, as engineers say it: 1e-6, 3e-12, 0.04."""
    if error == 0:
        return "0"
    digits, power = f"{error:.0e}".split("e")
    return f"{float(f'{error:.0e}'):g}" if -2 <= int(power) <= 2 else f"{digits}e{int(power)}"


def write_work(work: float, unit: str) -> str:
    """Write a time with two digits, and the unit that fits: 48 ns, 3.7 ms, 1.2 s; without a unit, write a count."""
    if not unit:
        return f"{work:g}"
    ns = work * {"ns": 1.0, "s": 1e9}[unit]
    for size, name in ((1e9, "s"), (1e6, "ms"), (1e3, "µs")):
        if float(f"{ns:.2g}") >= size:
            return f"{_write_short(ns / size)} {name}"
    return f"{_write_short(ns)} ns"


def _write_short(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
