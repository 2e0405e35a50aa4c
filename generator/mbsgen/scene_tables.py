"""The evidence for a scene, and its tables for the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbsgen.approximation.choice import Approximation


@dataclass(frozen=True)
class Evidence:
    """The flops that a scene saves, and the deviations that it causes."""

    flops: Mapping[str, Mapping[str, int]]  # of functions, by the parts left out so far
    deviations: Mapping[str, float]  # of functions from the whole model's, relative to the largest result
    approximation: Approximation | None = None  # the numbers left out besides, and their effect


def describe(evidence: Evidence, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Arrange evidence in rows: a title, then a cell for each function."""
    rows = [(title, *(str(flops.get(name, "")) for name in names)) for title, flops in evidence.flops.items()]
    if evidence.deviations:
        rows.append(_tell("differs from the whole by", evidence.deviations, names))
    if evidence.approximation is not None:
        rows.append(_tell("and, by the tolerance, by", evidence.approximation.errors, names))
        if evidence.approximation.slopes:
            rows.append(_tell("its Jacobian, by the tolerance, by", evidence.approximation.slopes, names))
    return rows


def _tell(title: str, found: Mapping[str, float], names: Sequence[str]) -> tuple[str, ...]:
    return title, *(f"{found[n]:.1e}" if n in found else "" for n in names)


def describe_cuts(evidence: Evidence) -> list[tuple[str, ...]]:
    """Arrange the cuts of an approximation in rows: name, value, error of this cut alone, saved flops."""
    if evidence.approximation is None:
        return []
    return [(x.cut.name, x.cut.value, f"{x.error:.1e}", str(x.flops)) for x in evidence.approximation.taken]
