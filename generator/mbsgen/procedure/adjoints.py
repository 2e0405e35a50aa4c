"""Adjoints: the derivatives of a weighted sum of all results by wires, as reverse differentiation passes the stages.

The adjoint of a wire has the wire's pattern. A wire that several stages read gathers what each of them gives: a new
wire holds the sum so far.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from mbsgen.procedure.naming import Names
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Scalar


class Adjoints:
    """The adjoints that are known so far."""

    def __init__(self, active: Collection[str], matrices: Mapping[str, Wire], names: Names) -> None:
        self.name = names.make
        self._active = active  # wires that depend on the inputs that derivatives are taken by
        self._sums: dict[str, Wire] = {}
        self._matrices = matrices

    def has(self, wire: Wire) -> bool:
        """Return whether the results depend on a wire, by the stages that were passed."""
        return wire.name in self._sums

    def is_active(self, wire: Wire) -> bool:
        """Return whether the adjoint of a wire is asked for."""
        return wire.name in self._active

    def find(self, wire: Wire) -> Wire | None:
        """Return the adjoint of a wire so far."""
        return self._sums.get(wire.name)

    def seed(self, wire: Wire, seed: Wire) -> None:
        """Start the adjoint of a wire with another wire."""
        self._sums[wire.name] = seed

    def take(self, sheet: Sheet, wire: Wire) -> list[Scalar]:
        """Read the adjoint of each nonzero of a wire; zeros where nothing depends on it."""
        found = self.find(wire)
        return sheet.take(found) if found else [sheet.builder.zero] * wire.sparsity.nnz

    def give(self, sheet: Sheet, wire: Wire, values: Sequence[Scalar]) -> None:
        """Add to the adjoint of a wire, if it is asked for."""
        if not self.is_active(wire) or all(value.is_zero for value in values):
            return
        known = self.take(sheet, wire)
        total = Wire(self.name(f"adj_{wire.name}_sum"), wire.sparsity)
        sheet.give(total, [a + b for a, b in zip(known, values, strict=True)])
        self._sums[wire.name] = total

    def matrix(self, factors: Sequence[Wire]) -> Wire | None:
        """Return the matrix that wires are the factors of, where a stage of the procedure factorised it."""
        return self._matrices.get(factors[0].name)
