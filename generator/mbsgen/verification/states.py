"""Pseudo-random states in 50 digits: the states of the C check program, and parameters near their values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal

from mbsgen.formulations import ports
from mbsgen.model.tree import Kind, Tree

Numbers = list[Decimal]
START = Decimal("0.01")  # by which dependent coordinates differ from the closed pose, rad or m
SPREAD = Decimal(
    "0.1"
)  # by which part of themselves parameters differ from their values; by which amount, if these are 0


@dataclass(frozen=True)
class State:
    """Arguments by name, drawn when they are asked for: the same name and size give the same numbers."""

    number: int  # 0: with all parameters at their values
    parameters: Mapping[str, Numbers]  # by the name of the input that holds them
    is_still: bool  # velocities are 0
    coordinates: tuple[Decimal, ...] | None = None  # None: drawn

    def take(self, name: str, size: int) -> Numbers:
        """Return the numbers of an input."""
        if name in self.parameters:
            return self.parameters[name]
        if name == ports.COORDINATES.name and self.coordinates is not None:
            return list(self.coordinates)
        if self.is_still and name in (ports.VELOCITIES.name, ports.INDEPENDENT_VELOCITIES.name):
            return [Decimal(0)] * size
        return list(draw(name, size, self.number))


def draw_states(tree: Tree, *, still: bool) -> Iterator[State]:
    """Draw states without end: the first with all parameters at their values, the others with parameters near them."""
    number = 0
    while True:
        yield State(number, _draw_parameters(tree, number), still)
        number += 1


def draw_start(tree: Tree) -> tuple[Decimal, ...]:
    """Draw coordinates near the closed pose, at which the dependent ones can be found."""
    closure, names = tree.closure, [joint.name for joint in tree.joints]
    assert closure is not None, "a tree with loops is assembled"
    fixed = {names[k] for k in closure.independent}
    drawn = draw("start", len(closure.pose), 0)
    pairs = zip(tree.coordinates, closure.pose, drawn, strict=True)
    return tuple(Decimal(x) if name in fixed else Decimal(x) + START * more for name, x, more in pairs)


def _draw_parameters(tree: Tree, number: int) -> dict[str, Numbers]:
    found = {}
    for port, kind in ((ports.PARAMETERS, Kind.RUNTIME), (ports.DESIGN, Kind.DIFFERENTIATED)):
        values = [Decimal(x.value) for x in tree.parameters if x.kind is kind]
        changes = draw(port.name, len(values), number)
        if number:
            values = [x + SPREAD * (x if x else 1) * change for x, change in zip(values, changes, strict=True)]
        found[port.name] = values
    return found


def draw(name: str, size: int, state: int) -> tuple[Decimal, ...]:
    """Draw numbers between -1 and 1 as `draw` in csrc/mbs_check.c does: 23 bits, by a congruential generator."""
    x = 2166136261 + state
    for letter in name.encode():
        x = ((x ^ letter) * 16777619) & 0xFFFFFFFF
    drawn = []
    for _ in range(size):
        x = (x * 1664525 + 1013904223) & 0xFFFFFFFF
        drawn.append(Decimal(x >> 8) / 8388608 - 1)
    return tuple(drawn)
