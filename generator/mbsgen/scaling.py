"""Cost by size: flops and equations of the formulations for uniform serial chains (the paper's Table 1)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from sympy import Float, Integer

from mbsgen.formulations.catalogue import write_row
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Body, Joint, Matrix, Motion, Tree
from mbsgen.tape.counts import Counts, count

PERIOD = 3  # axes repeat: each body adds as much as the body three places before it
# The best of the standard plans is the same for all sizes; the parts of sums are not.
ONE_PLAN = Reductions(trials=1, share=False, order=False)

_ZERO, _ONE = Integer(0), Integer(1)
_UNIT: Matrix = ((_ONE, _ZERO, _ZERO), (_ZERO, _ONE, _ZERO), (_ZERO, _ZERO, _ONE))


def make_chain(size: int) -> Tree:
    """Make a chain of equal bodies with full inertias; axes z, y, x in turn, links along x, gravity along -z."""
    xx, xy, xz, yy, yz, zz = (Float(x) for x in (0.3, 0.01, 0.02, 0.4, 0.03, 0.5))
    bodies = tuple(
        Body(
            name=f"body{i}",
            parent=i - 1,
            joint=Joint(f"q{i}", Motion.REVOLUTE, (2, 1, 0)[(i - 1) % PERIOD], True, None, None),
            position=(Float(0.7) if i > 1 else _ZERO, _ZERO, _ZERO),
            orientation=_UNIT,
            mass=Float(1.3),
            com=(Float(0.3), Float(0.1), Float(0.2)),
            inertia=((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)),
        )
        for i in range(1, size + 1)
    )
    return Tree(f"chain{size}", (_ZERO, _ZERO, Float(-9.81)), (), bodies, ())


@dataclass(frozen=True)
class Growth:
    """The cost of one formulation, by the number of bodies."""

    formulation: str
    counts: Mapping[int, Counts]

    def degree(self, figure: str) -> int | None:
        """Return the degree of the polynomial of "flops" or "equations", by constant differences; None: it is none."""
        values = [self._figure(n, figure) for n in sorted(self.counts)]
        for degree in range(len(values) - 2):
            rest = differences(values, degree)[-3:]
            if len(set(rest)) == 1 and len(rest) == 3:
                return degree
        return None

    def _figure(self, size: int, figure: str) -> int:
        found = self.counts[size]
        return found.paper if figure == "flops" else found.equations


def differences(values: Sequence[int], order: int) -> list[int]:
    """Take differences of neighbours, `order` times."""
    rest = list(values)
    for _ in range(order):
        rest = [b - a for a, b in pairwise(rest)]
    return rest


def count_chain(formulation: str, size: int) -> Counts:
    """Count a formulation of a chain, all numbers folded."""
    return count(write_row(formulation, make_chain(size), ONE_PLAN))


def grow(formulation: str, sizes: Iterable[int]) -> Growth:
    """Count a formulation for chains of the given sizes."""
    return Growth(formulation, {n: count_chain(formulation, n) for n in sizes})


def find_crossing(slower: Mapping[int, Counts], faster: Mapping[int, Counts]) -> int | None:
    """Return the smallest size from which on `faster` takes fewer flops, among the sizes counted for both."""
    both = sorted(set(slower) & set(faster))
    first = None
    for n in reversed(both):
        if faster[n].paper >= slower[n].paper:
            break
        first = n
    return first
