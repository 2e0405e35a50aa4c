"""Pseudo-random states in 50 digits: the states of the C check program, and parameters near their values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import count

from mbsgen.formulations import ports
from mbsgen.model.tree import Kind, Motion, Tree

Numbers = list[Decimal]
START = Decimal("0.01")  # by which dependent coordinates differ from the closed pose, rad or m
ORDINARY = (1 / 32, 32.0)  # m: sizes of mechanisms whose shifts are drawn between -1 m and 1 m
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
    sizes: Mapping[str, Sequence[Decimal]] = field(default_factory=dict)  # of drawn entries, where they are not 1

    @property
    def unit(self) -> Decimal:
        """Return the size of drawn shifts; 1 of mechanisms of ordinary size."""
        return next((x for sizes in self.sizes.values() for x in sizes if x != 1), Decimal(1))

    def take(self, name: str, size: int) -> Numbers:
        """Return the numbers of an input."""
        if name in self.parameters:
            return self.parameters[name]
        if name == ports.COORDINATES.name and self.coordinates is not None:
            return list(self.coordinates)
        if self.is_still and name in (ports.VELOCITIES.name, ports.INDEPENDENT_VELOCITIES.name):
            return [Decimal(0)] * size
        drawn = draw(name, size, self.number)
        return [x * more for x, more in zip(drawn, self.sizes.get(name, [Decimal(1)] * size), strict=True)]


def draw_states(tree: Tree, *, still: bool) -> Iterator[State]:
    """Draw states without end: the first with all parameters at their values, the others with parameters near them."""
    sizes = _size_states(tree)
    for number in count():
        yield State(number, _draw_parameters(tree, number), still, sizes=sizes)


def draw_states_nearby(tree: Tree, *, still: bool) -> Iterator[State]:
    """Draw states likewise near the closed pose, where equations have no value elsewhere."""
    sizes = _size_states(tree)
    for number in count():
        coordinates = draw_start(tree, number)
        yield State(number, _draw_parameters(tree, number), still, coordinates, sizes)


def has_own_states(tree: Tree) -> bool:
    """Return whether states differ from the check program's, which draws all numbers between -1 and 1."""
    return bool(_size_states(tree))


def _size_states(tree: Tree) -> dict[str, list[Decimal]]:
    """Return the sizes of drawn shifts, in the order of mechanisms that are much smaller or larger than 1 m."""
    size = 1.0 if tree.closure is None else tree.closure.size
    if ORDINARY[0] <= size <= ORDINARY[1]:
        return {}
    one, unit = Decimal(1), Decimal(2) ** round(math.log2(size))
    shifts = [unit if joint.motion is Motion.PRISMATIC else one for joint in tree.joints]
    own = [shifts[i] for i in (tree.closure.independent if tree.closure else ())]
    places = {name for x in tree.quaternions if x.is_free for name in x.coordinates[:3]}
    places |= {joint.name for joint in tree.joints if joint.motion is Motion.PRISMATIC}
    return {
        ports.COORDINATES.name: [unit if name in places else one for name in tree.coordinates],
        **dict.fromkeys((ports.VELOCITIES.name, ports.ACCELERATIONS.name), shifts),
        **dict.fromkeys((ports.INDEPENDENT_VELOCITIES.name, ports.INDEPENDENT_ACCELERATIONS.name), own),
    }


def draw_start(tree: Tree, number: int = 0) -> tuple[Decimal, ...]:
    """Draw coordinates near the closed pose, at which the dependent ones can be found."""
    closure, names = tree.closure, [joint.name for joint in tree.joints]
    assert closure is not None, "a tree with loops is assembled"
    fixed = {names[k] for k in closure.independent}
    drawn = draw("start", len(closure.pose), number)
    sizes = _size_states(tree).get(ports.COORDINATES.name, [Decimal(1)] * len(drawn))
    pairs = zip(tree.coordinates, closure.pose, drawn, sizes, strict=True)
    return tuple(Decimal(x) if name in fixed else Decimal(x) + START * more * size for name, x, more, size in pairs)


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
