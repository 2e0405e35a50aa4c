"""Panels of a cost against the size of a mechanism: lines of methods, and the sizes at which the best one changes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from mbsrun.measuring.fronts import ALIKE, Dot, Panel, write_work


@dataclass(frozen=True)
class Range:
    """Sizes in which one line is the best, or within a factor of the best."""

    line: str
    first: float
    last: float


@dataclass(frozen=True)
class Growth(Panel):
    """A chart of a cost against size: `work` of a dot is the size, and `error` the cost."""

    unit: str = ""  # of the size
    rises: str = ""  # unit of the cost: "s", "ns", or "" for a count or an error
    verb: str = "is the fastest"
    alike: float = ALIKE  # factor within which costs are equal
    are_rivals: bool = True  # lines compute the same, so one is the best

    better: ClassVar[str] = "↓ better"
    worst: ClassVar[float] = math.inf

    @property
    def across(self) -> str:
        """Return the name of the axis across."""
        return self.work

    @property
    def front(self) -> list[Dot]:
        """Return the best dot of each size; none of lines that compute different results."""
        return list(find_best(self.good).values()) if self.are_rivals else []

    @property
    def marks(self) -> dict[float, str]:
        """Return the line that becomes the best, by the size at which it does; nothing for the first one."""
        return {x.first: x.line for x in find_ranges(self.front and self.good, self.alike)[1:]}

    @property
    def headline(self) -> str:
        """State which line is the best up to which size, or how fast each line grows."""
        if not self.are_rivals:
            return state_powers(self.lines)
        return state_ranges(find_ranges(self.good, self.alike), self.verb, self.work)

    def join(self, dots: Sequence[Dot]) -> list[Dot]:
        """Return all dots of a line, by their size."""
        return sorted(dots, key=lambda dot: dot.place)

    def choose_lines(self) -> list[str]:
        """Return all lines."""
        return list(self.lines)

    def write_upwards(self, cost: float) -> str:
        """Write a cost for the axis."""
        return write_work(cost, self.rises) if self.rises else f"{cost:.0e}".replace("e+0", "e").replace("e-0", "e-")


def find_best(dots: Sequence[Dot]) -> dict[float, Dot]:
    """Return the dot of the least cost of each size, from small to large ones."""
    best: dict[float, Dot] = {}
    for dot in sorted((dot for dot in dots if dot.is_good), key=lambda dot: dot.place):
        best.setdefault(dot.place[0], dot)
    return best


def find_ranges(dots: Sequence[Dot], alike: float = ALIKE) -> list[Range]:
    """Divide the sizes into as few ranges as possible, with a line that is within `alike` of the best all along."""
    best = find_best(dots)
    sizes, costs = list(best), {(dot.line, dot.place[0]): dot.place[1] for dot in dots if dot.is_good}
    names = list(dict.fromkeys(line for line, _ in costs))
    ranges: list[Range] = []
    start = 0
    while start < len(sizes):
        ends = {}
        for name in names:
            end = start
            while end < len(sizes) and costs.get((name, sizes[end]), math.inf) <= alike * best[sizes[end]].place[1]:
                end += 1
            ends[name] = end
        line = max(names, key=lambda name: (ends[name], name == best[sizes[start]].line))
        ranges.append(Range(line, sizes[start], sizes[ends[line] - 1]))
        start = ends[line]
    return ranges


def state_ranges(ranges: Sequence[Range], verb: str, size: str) -> str:
    """Write ranges as one sentence: "Up to 6 joints, A is the fastest; from 8 on, B."."""
    if not ranges:
        return "Nothing was measured here."
    first, *others = ranges
    if not others:
        return f"{first.line} {verb} at every size."
    single = size.removesuffix("s") if first.last == 1 else size
    parts = [f"Up to {first.last:g} {single}, {first.line} {verb}"]
    parts += [f"from {x.first:g} to {x.last:g}, {x.line}" for x in others[:-1]]
    return "; ".join([*parts, f"from {others[-1].first:g} on, {others[-1].line}"]) + "."


def state_powers(lines: Mapping[str, Sequence[Dot]]) -> str:
    """Write the power of the size with which each line grows in the last doubling, or further."""
    parts = []
    for name, dots in lines.items():
        if len(dots) > 1:
            (size, cost), (largest, most) = (dot.place for dot in sorted(dots, key=lambda dot: dot.place)[-2:])
            parts.append(f"{math.log(most / cost) / math.log(largest / size):.1f} ({name})")
    return f"Long chains: the cost grows as the number of joints to the power of {', '.join(parts)}." if parts else ""
