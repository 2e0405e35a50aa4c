"""The stage of a map: one tape, computed over an index, as over columns or bodies.

    z[i] = f(w[places(i)], v),    i = 0, 1, ...

Inputs of the tape are gathered from wires, by a table of places, or are the same wire v for all i. With the derivatives
of f, which are such a map as well,

    push    dz[i]/dx = (df/dw) dw/dx [places(i)] + (df/dv) dv/dx
    pull    wbar[places(i)] += (df/dw)^T zbar[i],  vbar += (df/dv)^T zbar[i]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mbsgen.errors import TapeError
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, TapeStage, Values
from mbsgen.procedure.straight import written
from mbsgen.procedure.wires import Wire
from mbsgen.tape import counts
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import Counts
from mbsgen.tape.forward import Gradient, propagate
from mbsgen.tape.interpreter import run
from mbsgen.tape.passes import keep_results
from mbsgen.tape.replay import declare_inputs, replay, replay_guards
from mbsgen.tape.reverse import sweep
from mbsgen.tape.types import Sparsity

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes


@dataclass(frozen=True)
class Gather:
    """An input of the tape that is different for each i: which nonzeros of a wire it is made of."""

    input: str
    source: Wire
    places: tuple[tuple[int, ...], ...]  # for each i


@dataclass(frozen=True)
class Repeat(TapeStage):
    """A map. A result has a column for each i, the nonzeros of the tape's output."""

    name: str
    times: int
    gathers: tuple[Gather, ...]

    def __post_init__(self) -> None:
        if self.times < 1 or not self.gathers:
            raise TapeError(f"{self.name}: a map is over at least one place, with an input that differs")
        for gather in self.gathers:
            nnz, source = self.tape.input(gather.input).sparsity.nnz, gather.source
            if len(gather.places) != self.times or any(len(row) != nnz for row in gather.places):
                raise TapeError(f"{self.name}: {gather.input} takes {nnz} places for each of {self.times}")
            if any(not 0 <= place < source.sparsity.nnz for row in gather.places for place in row):
                raise TapeError(f"{self.name}: {gather.input} takes places that {source.name} does not have")

    @property
    def shared(self) -> tuple[Wire, ...]:
        """List the wires that are the same for all i."""
        gathered = {gather.input for gather in self.gathers}
        return tuple(Wire.of(i) for i in self.tape.inputs if i.name not in gathered)

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List the gathered wires, and the wires that are the same for all i."""
        return tuple(dict.fromkeys((*(gather.source for gather in self.gathers), *self.shared)))

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the outputs of the tape, a column for each i."""
        return tuple(Wire(o.name, Sparsity.dense(o.sparsity.nnz, self.times)) for o in self.tape.outputs)

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Compute for one i after the other."""
        results: dict[str, list[object]] = {o.name: [] for o in self.tape.outputs}
        for i in range(self.times):
            gathered = {g.input: [given[g.source.name][place] for place in g.places[i]] for g in self.gathers}
            status, found = run(self.tape, {**given, **gathered}, arithmetic.numbers, tested=arithmetic.tested)
            if status:
                return Outcome(status, {})
            for name, values in found.items():
                results[name] += values
        return Outcome(0, dict(results))

    def count(self) -> Counts:
        """Count the operations for all i; equations are written once."""
        once = counts.count(self.tape)
        operations = {op: self.times * number for op, number in once.operations.items()}
        return Counts(operations, once.equations, self.times * once.guards)

    def keep(self, names: frozenset[str]) -> Repeat:
        """Leave out the other outputs of the tape, and what only they need."""
        if all(o.name in names for o in self.tape.outputs):
            return self
        tape = keep_results(self.tape, names)
        return replace(self, tape=tape)

    def _source(self, name: str) -> Wire:
        return next(
            (gather.source for gather in self.gathers if gather.input == name),
            Wire(name, self.tape.input(name).sparsity),
        )

    def _places(self, name: str, i: int) -> Sequence[int]:
        found = [gather.places[i] for gather in self.gathers if gather.input == name]
        return found[0] if found else range(self.tape.input(name).sparsity.nnz)

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Map the derivatives of the tape, and multiply them by the slopes of the gathered wires."""
        wrt = [i for i in self.tape.inputs if slopes.has(self._source(i.name))]
        if not wrt:
            return (self,)
        builder = Builder()
        values = replay(self.tape, builder, declare_inputs(self.tape, builder))
        replay_guards(self.tape, builder, values)
        gradients = propagate(self.tape, builder, values, [i.name for i in wrt])
        columns = [(i, k) for i in self.tape.inputs for k in range(i.sparsity.nnz)]
        local: dict[str, tuple[Wire, list[tuple[int, int]]]] = {}
        for output in self.tape.outputs:
            builder.output(output.name, output.sparsity, [values[v] for v in output.values])
            entries = {(r, c): slope for r, v in enumerate(output.values) for c, slope in gradients[v].items()}
            if entries:
                wire = Wire(slopes.name(f"{output.name}_local"), Sparsity.dense(len(entries), self.times))
                builder.output(wire.name, Sparsity.dense(len(entries)), list(entries.values()))
                local[output.name] = wire, list(entries)
        stage = replace(self, tape=builder.build(self.tape.name))
        sheet = Sheet()
        for result, output in zip(self.gives, self.tape.outputs, strict=True):
            if output.name not in local:
                continue
            total: list[Gradient] = [{} for _ in range(result.sparsity.nnz)]
            wire, places = local[output.name]
            given = sheet.take(wire)
            for i in range(self.times):
                for n, (r, c) in enumerate(places):
                    source, k = columns[c]
                    gradient = slopes.take(sheet, self._source(source.name))[self._places(source.name, i)[k]]
                    _accumulate(total[i * output.sparsity.nnz + r], given[i * len(places) + n], gradient)
            slopes.give(sheet, result, total)
        return (stage, *written(sheet, slopes.name(f"{self.name}_sheet")))

    def pull(self, adjoints: Adjoints) -> Pulled:
        """Map the adjoint of the tape, and scatter what it gives."""
        builder = Builder()
        values = replay(self.tape, builder, declare_inputs(self.tape, builder))
        replay_guards(self.tape, builder, values)
        weights: dict[int, Scalar] = {}
        gathers = [*self.gathers]
        for wire, output in zip(self.gives, self.tape.outputs, strict=True):
            seed = adjoints.find(wire)
            if seed is None:
                continue
            nnz, name = output.sparsity.nnz, adjoints.name(f"adj_{output.name}_each")
            gathers.append(Gather(name, seed, tuple(tuple(range(i * nnz, (i + 1) * nnz)) for i in range(self.times))))
            for value, weight in zip(output.values, builder.input(name, output.sparsity), strict=True):
                weights[value] = weights[value] + weight if value in weights else weight
        found = sweep(self.tape, builder, values, weights)
        columns = [(i, k) for i in self.tape.inputs for k in range(i.sparsity.nnz)]
        active = [v for v in found if adjoints.is_active(self._source(columns[v][0].name))]
        if not active:
            return Pulled((self,), ())
        wire = Wire(adjoints.name(f"{self.name}_local"), Sparsity.dense(len(active), self.times))
        builder.output(wire.name, Sparsity.dense(len(active)), [found[v] for v in active])
        name = adjoints.name(f"{self.name}_back")
        back = Repeat(builder.build(name), name, self.times, tuple(gathers))
        sheet = Sheet()
        given = sheet.take(wire)
        sources = {self._source(columns[v][0].name).name: self._source(columns[v][0].name) for v in active}
        for source in sources.values():
            total = [sheet.builder.zero] * source.sparsity.nnz
            for i in range(self.times):
                for n, v in enumerate(active):
                    owner, k = columns[v]
                    if self._source(owner.name) == source:
                        place = self._places(owner.name, i)[k]
                        total[place] = total[place] + given[i * len(active) + n]
            adjoints.give(sheet, source, total)
        return Pulled((self,), (back, *written(sheet, adjoints.name(f"{self.name}_sheet"))))


def _accumulate(total: Gradient, factor: Scalar, gradient: Gradient) -> None:
    for column, value in gradient.items():
        product = factor * value
        total[column] = total[column] + product if column in total else product
