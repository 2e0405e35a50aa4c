"""The unknowns of reduced forms: joint velocities as sums of independent velocities and of unknowns.

The unknown of a dependent joint is its velocity qd, or, within a group of parallel axes, the *absolute* rate w of its
body about them, so that qd = w - w of the body before. With absolute rates, J and M have fewer terms (`segments`).
Forces on the unknowns follow by virtual power.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.formulations.coupling import Map
from mbsgen.formulations.parsimony.segments import Segment
from mbsgen.roles import Axis
from mbsgen.tape.builder import Builder, Scalar

Form = Mapping[int, Scalar]  # the factor of each unknown or independent velocity, by the entry of qd
Column = dict[int, Scalar]  # by the entry of qd, from 0


@dataclass(frozen=True)
class Unknowns:
    """Velocities of all joints of an uncoupled tree, and the rates that its recursions take forces along."""

    builder: Builder
    velocities: tuple[Form, ...]  # qd of each joint, from 0
    rates: tuple[Form, ...]  # relative or absolute

    @staticmethod
    def relative(map: Map) -> Unknowns:
        """Take the velocities of joints as unknowns; followers have the sum of their leaders', times the ratios."""
        one = map.builder.number(1.0)
        rows = (map.row(Axis.VELOCITIES, i) for i in range(len(map.targets[Axis.VELOCITIES])))
        forms = tuple({k: one if ratio is None else ratio for k, ratio in row} for row in rows)
        return Unknowns(map.builder, forms, forms)

    @staticmethod
    def absolute(builder: Builder, segments: Sequence[Segment], dependent: Collection[int]) -> Unknowns:
        """Take absolute rates as unknowns, of a tree without followers."""
        one = builder.number(1.0)
        velocities: list[Form] = []
        rates: list[Form] = []
        for k, segment in enumerate(segments):
            before = {} if segment.counts_angle else rates[segment.parent - 1]
            own = segment.signed(one)
            if k in dependent and not segment.counts_angle:
                rates.append({k: one})
                velocities.append(_add({k: own}, {i: -(own * x) for i, x in before.items()}))
            else:
                velocities.append({k: one})
                rates.append(_add({k: own}, before))
        return Unknowns(builder, tuple(velocities), tuple(rates))

    @property
    def is_absolute(self) -> bool:
        """Return whether recursions are to take absolute rates."""
        return self.velocities is not self.rates

    def spread(self, column: Mapping[int, Scalar]) -> list[Scalar]:
        """Return the velocities of all joints."""
        return [_sum([x * column[k] for k, x in form.items()]) for form in self.velocities]

    def gather(self, forces: Mapping[int, Scalar], along: Sequence[Form] | None = None) -> Column:
        """Return the forces on the unknowns, from forces along the rates, or along other forms, from 0."""
        total: Column = {}
        forms = self.rates if along is None else along
        for i, force in sorted(forces.items()):
            for k, x in forms[i].items():
                total[k] = total[k] + x * force if k in total else x * force
        return total

    def gather_matrix(self, M: Mapping[tuple[int, int], Scalar]) -> dict[tuple[int, int], Scalar]:
        """Return the matrix of the unknowns, from one of the rates."""
        total: dict[tuple[int, int], Scalar] = {}
        for (i, j), value in sorted(M.items()):
            for k, x in self.rates[i].items():
                for l, y in self.rates[j].items():
                    term = x * value * y
                    total[k, l] = total[k, l] + term if (k, l) in total else term
        return total


def _add(one: Form, other: Form) -> Column:
    total = dict(one)
    for k, x in other.items():
        total[k] = total[k] + x if k in total else x
    return {k: x for k, x in total.items() if not x.is_zero}


def _sum(terms: Sequence[Scalar]) -> Scalar:
    return sum(terms[1:], start=terms[0])
