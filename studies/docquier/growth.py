"""Growth of the cost of the formulations with the length of a chain: Docquier, Brüls, Fisette, Table 1."""

from __future__ import annotations

from dataclasses import dataclass

SIZES = tuple(range(3, 25, 3))  # joints; axes repeat after three, and so do the operations that a joint adds


@dataclass(frozen=True)
class Growth:
    """The flops of one formulation, by the number of joints."""

    formulation: str
    flops: tuple[tuple[int, int], ...]
    degree: int | None  # of the polynomial in N, by constant differences; None: there is none


def count_growth(sizes: tuple[int, ...] = SIZES) -> tuple[Growth, ...]:
    """Count all formulations for chains of equal bodies with full inertias."""
    from mbsgen.scaling import grow  # imported late: everything else works without SymPy

    found = []
    for formulation in ("IMPL", "SEMI", "EXP1", "EXP2"):
        growth = grow(formulation, sizes)
        flops = tuple((n, growth.counts[n].paper) for n in sorted(growth.counts))
        found.append(Growth(formulation, flops, growth.degree("flops")))
    return tuple(found)
