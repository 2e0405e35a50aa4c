"""A sheet: a straight stage while it is written; wires are declared when they are first read."""

from __future__ import annotations

from collections.abc import Sequence

from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


class Sheet:
    """A builder, with the wires that it reads and gives."""

    def __init__(self) -> None:
        self.builder = Builder()
        self._read: dict[str, list[Scalar]] = {}
        self._given: set[str] = set()

    def take(self, wire: Wire) -> list[Scalar]:
        """Read the nonzeros of a wire."""
        if wire.name not in self._read:
            self._read[wire.name] = self.builder.input(wire.declared or wire.name, wire.sparsity)
        return self._read[wire.name]

    def place(self, wire: Wire) -> dict[tuple[int, int], Scalar]:
        """Read a wire by row and column."""
        return dict(zip(wire.sparsity.entries, self.take(wire), strict=True))

    def give(self, wire: Wire, values: Sequence[Scalar]) -> None:
        """Write the nonzeros of a wire."""
        self.builder.output(wire.declared or wire.name, wire.sparsity, values)
        self._given.add(wire.name)

    @property
    def is_empty(self) -> bool:
        """Return whether no wire is written."""
        return not self._given

    def finish(self, name: str) -> Tape:
        """Build the tape."""
        return self.builder.build(name)
