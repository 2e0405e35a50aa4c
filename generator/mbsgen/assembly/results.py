"""Values of assembly: findings about loops for the report, the error of impossible loops, a tree without its loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mbsgen.documents import Finding
from mbsgen.errors import MbsError
from mbsgen.model.tree import Tree


class AssemblyError(MbsError):
    """Loops that cannot be computed with; the findings have places in the model."""

    def __init__(self, name: str, findings: Sequence[Finding]) -> None:
        self.findings = tuple(findings)
        super().__init__("\n".join(f"model {name}: {found.finding}; {found.remedy}" for found in findings))


@dataclass(frozen=True)
class Findings:
    """The loops of a tree, in names and numbers."""

    redundant: tuple[str, ...]  # equations that follow from others
    kept: int  # equations that remain
    coordinates: int  # entries of qd
    independent: tuple[str, ...]
    is_chosen: bool  # by the author
    regularity: float  # the least singular value of the dependent columns of J, as a part of J's largest
    assemblies: tuple[tuple[float, ...], ...]  # poses with the same independent coordinates; the first is computed with
    distance: float = 0.0  # within which the redundant equations hold: in rad, or of the size of a loop

    @property
    def freedoms(self) -> int:
        """Count the degrees of freedom, driven joints included."""
        return self.coordinates - self.kept


def release(tree: Tree) -> Tree:
    """Return a tree without its loops and constraints."""
    return replace(tree, loops=(), constraints=(), chosen=(), rough=())
