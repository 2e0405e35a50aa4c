"""The common part of all kinds of stages: the wires between them, and the rules that a kind states.

A stage reads wires and writes wires. A wire holds the nonzeros of a matrix, column by column, and is written once. For
a stage z = s(w) with w(x), the rules of its kind return further stages:

    push    dz/dx of dw/dx               forward differentiation
    pull    (dz/dw)T zbar of zbar        reverse differentiation

So a kind of stages is one file: a subclass of `Stage`. The rule that prints it is in the module of the language.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

from mbsgen.procedure.wires import Wire
from mbsgen.tape.counts import Counts
from mbsgen.tape.interpreter import Numbers
from mbsgen.tape.types import Tape

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes

Values = Mapping[str, Sequence[Any]]  # by wire: the nonzeros


@dataclass(frozen=True)
class Outcome:
    """The results of a stage or a procedure: a status, which is 0 unless it failed, and the wires by name."""

    status: int
    results: dict[str, Sequence[Any]]


@dataclass(frozen=True)
class Arithmetic:
    """The setting of a run: a number type, and whether guards that fail decide the status."""

    numbers: Numbers
    tested: bool


class Stage(ABC):
    """One step of a procedure. Each kind states these rules once."""

    name: str  # unique in its procedure

    @property
    @abstractmethod
    def reads(self) -> tuple[Wire, ...]:
        """List the wires that it reads."""

    @property
    @abstractmethod
    def gives(self) -> tuple[Wire, ...]:
        """List the wires that it writes."""

    @property
    @abstractmethod
    def can_fail(self) -> bool:
        """Return whether there are arguments for which its status is not 0."""

    @abstractmethod
    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Compute what it gives."""

    @abstractmethod
    def count(self) -> Counts:
        """Count operations, equations and guards."""

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """List the straight-line programs within the stage."""
        return ()

    def with_tapes(self, tapes: Sequence[Tape]) -> Stage:
        """Return the stage with others in their place."""
        assert not tapes, f"stage {self.name} holds no tape"
        return self

    def keep(self, names: frozenset[str]) -> Stage:
        """Leave out what it gives besides these wires, as far as that is possible."""
        assert not names.isdisjoint(wire.name for wire in self.gives), f"nothing needs stage {self.name}"
        return self

    @abstractmethod
    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Return stages that give the same, and the slopes of it; register them in `slopes`."""

    @abstractmethod
    def pull(self, adjoints: Adjoints) -> Pulled:
        """Return stages with the same results, and stages that propagate the adjoints of the results to the inputs."""


@dataclass(frozen=True)
class TapeStage(Stage):
    """A stage that holds one straight-line program."""

    tape: Tape

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """Return the tape."""
        return (self.tape,)

    def with_tapes(self, tapes: Sequence[Tape]) -> Self:
        """Replace the tape."""
        (tape,) = tapes
        return replace(self, tape=tape)

    @property
    def can_fail(self) -> bool:
        """Return whether the tape has guards."""
        return bool(self.tape.guards)


@dataclass(frozen=True)
class Pulled:
    """A stage, in both directions of a reverse sweep."""

    onward: tuple[Stage, ...]  # in the place of the stage
    back: tuple[Stage, ...]  # after all stages, in the opposite order
