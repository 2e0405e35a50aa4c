"""The Procedure: a function as a sequence of stages; an immutable value, checked when it is built.

    z1 = s1(x),  z2 = s2(x, z1),  ...,  y = some of x, z1, z2, ...

A straight-line program is a procedure of one straight stage.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mbsgen.errors import TapeError
from mbsgen.procedure.stages import Arithmetic, Outcome, Stage, Values
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role
from mbsgen.tape.counts import Counts
from mbsgen.tape.interpreter import FLOATS, Numbers
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Tape


@dataclass(frozen=True)
class Procedure:
    """A function of wires: its inputs, its stages in order, and the wires that are its results."""

    function: Function
    inputs: tuple[Wire, ...]
    stages: tuple[Stage, ...]
    outputs: tuple[Wire, ...]

    def __post_init__(self) -> None:
        known = {wire.name: wire for wire in self.inputs}
        for names in ([w.name for w in self.inputs], [s.name for s in self.stages], [w.name for w in self.outputs]):
            if len(set(names)) != len(names):
                raise TapeError(f"{self.name}: names repeat: {names}")
        for stage in self.stages:
            for wire in stage.reads:
                self._check(known, wire, f"stage {stage.name} reads")
            for wire in stage.gives:
                if wire.name in known:
                    raise TapeError(f"{self.name}: stage {stage.name} gives {wire.name}, which is known before")
                known[wire.name] = wire
        for wire in self.outputs:
            self._check(known, wire, "a result is")

    def _check(self, known: Mapping[str, Wire], wire: Wire, reader: str) -> None:
        if wire.name not in known:
            raise TapeError(f"{self.name}: {reader} {wire.name}, which no input or earlier stage gives")
        if known[wire.name] != wire:
            raise TapeError(f"{self.name}: {reader} {wire.name} with another pattern than it is given with")

    @property
    def name(self) -> str:
        """Name the kernel."""
        return self.function.name

    @property
    def can_fail(self) -> bool:
        """Return whether there are arguments for which the status is not 0."""
        return any(stage.can_fail for stage in self.stages)

    def input(self, name: str) -> Wire:
        """Look an input up by name."""
        return next(wire for wire in self.inputs if wire.name == name)

    def output(self, name: str) -> Wire:
        """Look a result up by name."""
        return next(wire for wire in self.outputs if wire.name == name)

    def giving(self, role: Role) -> Wire | None:
        """Return the first result of a role, if there is one."""
        return next((wire for wire in self.outputs if wire.port.role is role), None)

    def rewrite(self, change: Callable[[Tape], Tape], function: Function | None = None) -> Procedure:
        """Change every tape of its stages; the procedure may get another name."""
        stages = tuple(stage.with_tapes([change(tape) for tape in stage.tapes]) for stage in self.stages)
        return replace(self, function=function or self.function, stages=stages)


Computation = Tape | Procedure  # a function of the generated code


def as_procedure(function: Computation) -> Procedure:
    """Return a tape as a procedure of one straight stage."""
    if isinstance(function, Procedure):
        return function
    stage = Straight(function)
    return Procedure(function.function, stage.reads, (stage,), stage.gives)


def straight(function: Computation) -> Tape:
    """Return a function that is a tape, for callers that need one."""
    assert isinstance(function, Tape), f"{function.name} is no straight-line program"
    return function


def interpret(procedure: Procedure, arguments: Values, numbers: Numbers = FLOATS) -> Outcome:
    """Compute what generated code does: a status, and the results where it is 0."""
    return _run(procedure, arguments, Arithmetic(numbers, tested=True))


def evaluate(function: Computation, arguments: Values, numbers: Numbers = FLOATS) -> dict[str, list[Any]]:
    """Compute every result. Guards of straight stages are not tested; TapeError where a solve or an iteration fails."""
    procedure = as_procedure(function)
    outcome = _run(procedure, arguments, Arithmetic(numbers, tested=False))
    if outcome.status:
        raise TapeError(f"{procedure.name} fails with status {outcome.status} at these arguments")
    return {name: list(values) for name, values in outcome.results.items()}


def _run(procedure: Procedure, arguments: Values, arithmetic: Arithmetic) -> Outcome:
    values: dict[str, Sequence[Any]] = {}
    for wire in procedure.inputs:
        values[wire.name] = given = arguments[wire.name]
        if len(given) != wire.sparsity.nnz:
            raise TapeError(
                f"{procedure.name}: input {wire.name} has {wire.sparsity.nnz} nonzeros, {len(given)} were given"
            )
    for stage in procedure.stages:
        outcome = stage.run(values, arithmetic)
        if outcome.status:
            return Outcome(outcome.status, {})
        values.update(outcome.results)
    return Outcome(0, {wire.name: values[wire.name] for wire in procedure.outputs})


def count(function: Computation) -> Counts:
    """Add up the counts of the stages."""
    counts = [stage.count() for stage in as_procedure(function).stages]
    operations: Counter[Any] = sum((Counter(c.operations) for c in counts), Counter())
    return Counts(dict(operations), sum(c.equations for c in counts), sum(c.guards for c in counts))
