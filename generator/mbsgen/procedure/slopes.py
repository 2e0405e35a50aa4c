"""Slopes: the derivatives of wires by the inputs `wrt`, as forward differentiation passes the stages.

The slope of a wire w by an input x is the wire jac_<w>_<x>, of numel(w) rows and numel(x) columns. An input's slope by
itself is the unit matrix, for which there is no wire.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mbsgen.procedure.naming import Names
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Scalar
from mbsgen.tape.forward import Gradient
from mbsgen.tape.types import Sparsity


class Slopes:
    """The slopes that are known so far. Columns of all inputs `wrt` are numbered in one row."""

    def __init__(self, wrt: Sequence[Wire], matrices: Mapping[str, Wire], names: Names) -> None:
        self.name = names.make
        self._blocks: dict[str, dict[str, Wire | None]] = {x.name: {x.name: None} for x in wrt}  # None: the unit matrix
        self._matrices = matrices  # of which a wire holds factors
        self._first: dict[str, int] = {}
        self.sizes: dict[str, int] = {}
        self.places = {x.name: x.places for x in wrt}  # entries that are not zero
        for x in wrt:
            self._first[x.name] = sum(self.sizes.values())
            self.sizes[x.name] = x.numel

    def has(self, wire: Wire) -> bool:
        """Return whether a wire depends on an input."""
        return bool(self._blocks.get(wire.name))

    def by(self, wire: Wire) -> tuple[str, ...]:
        """List the inputs that a wire depends on."""
        return tuple(self._blocks.get(wire.name, ()))

    def find(self, wire: Wire) -> Mapping[str, Wire | None]:
        """Return the slopes of a wire by the names of the inputs."""
        return self._blocks.get(wire.name, {})

    def column(self, x: str, k: int) -> int:
        """Return the column of an entry of an input among the columns of all."""
        return self._first[x] + k

    def take(self, sheet: Sheet, wire: Wire) -> list[Gradient]:
        """Read the slope of each nonzero of a wire."""
        gradients: list[Gradient] = [{} for _ in range(wire.sparsity.nnz)]
        numbers = {place: k for k, place in enumerate(wire.places)}
        for x, block in self.find(wire).items():
            if block is None:
                for k, place in enumerate(wire.places):
                    gradients[k][self.column(x, place)] = sheet.builder.number(1.0)
                continue
            for (row, c), value in sheet.place(block).items():
                gradients[numbers[row]][self.column(x, c)] = value
        return gradients

    def give(self, sheet: Sheet, wire: Wire, gradients: Sequence[Gradient]) -> None:
        """Write the slope of a wire, from the gradients of its nonzeros."""
        for x, size in self.sizes.items():
            first = self._first[x]
            entries: dict[tuple[int, int], Scalar] = {
                (place, column - first): value
                for place, gradient in zip(wire.places, gradients, strict=True)
                for column, value in gradient.items()
                if first <= column < first + size and not value.is_zero
            }
            if entries:
                pattern = Sparsity.of(wire.numel, size, entries)
                block = self.register(wire, x, pattern)
                sheet.give(block, [entries[place] for place in pattern.entries])

    def register(self, wire: Wire, x: str, pattern: Sparsity) -> Wire:
        """Name the slope of a wire by an input, for a stage to write it."""
        block = Wire(self.name(f"jac_{wire.name}_{x}"), pattern)
        self._blocks.setdefault(wire.name, {})[x] = block
        return block

    def matrix(self, factors: Sequence[Wire]) -> Wire | None:
        """Return the matrix that wires are the factors of, where a stage of the procedure factorised it."""
        return self._matrices.get(factors[0].name)
