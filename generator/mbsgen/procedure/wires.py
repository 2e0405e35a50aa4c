"""Wires: the matrices that pass between the stages of a procedure, by their nonzeros."""

from __future__ import annotations

from dataclasses import dataclass, field

from mbsgen.roles import Role
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Input, Output, Sparsity


@dataclass(frozen=True)
class Wire:
    """A matrix that passes between stages: its name and its nonzero pattern."""

    name: str
    sparsity: Sparsity
    is_whole: bool = False  # whole numbers, such as places; nothing is differentiated by them
    declared: Port | None = field(default=None, compare=False)  # of an argument of the function

    @staticmethod
    def of(argument: Input | Output) -> Wire:
        """Make the wire of an argument of a tape."""
        return Wire(argument.name, argument.sparsity, declared=argument.port)

    @staticmethod
    def to(port: Port, sparsity: Sparsity) -> Wire:
        """Make the wire of an argument of a function."""
        return Wire(port.name, sparsity, declared=port)

    @property
    def port(self) -> Port:
        """Return the port of an argument; wires between stages alone have none."""
        return self.declared or Port(self.name, Role.RESULT)

    @property
    def numel(self) -> int:
        """Count the entries, zeros included."""
        return self.sparsity.rows * self.sparsity.cols

    @property
    def places(self) -> tuple[int, ...]:
        """List the place of each nonzero among all entries, column by column."""
        return tuple(r + c * self.sparsity.rows for r, c in self.sparsity.entries)
