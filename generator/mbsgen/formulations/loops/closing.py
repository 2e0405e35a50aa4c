"""Closing: coordinates, velocities and accelerations that keep loops closed, from the independent ones.

    close                  q of h(q) = 0, its independent entries kept
    close_rates            qd = Z yd
    close_accelerations    qdd = Z ydd + d

The dependent coordinates are solved for block by block, in the order of the block triangular form of dh/dq
(`partition`): linear blocks at once, other ones in closed form (`dyads`) where they have one that takes less than three
iterations, else by Newton's method. All start from the given q, so the solution is the one on its side.

A quaternion is started from: with x the steps of its velocities, q <- q + rates(q, x), made a unit quaternion at the
end. Entries of x that are independent are 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from mbsgen.formulations import closure, coupling, ports, rates
from mbsgen.formulations.loops import dyads
from mbsgen.formulations.loops.partition import Partition, Place, find_blocks
from mbsgen.formulations.loops.projection import normalise
from mbsgen.formulations.loops.reduced import Reduced, known_closure
from mbsgen.formulations.reductions import ALL
from mbsgen.model.tree import Motion, Tree
from mbsgen.procedure.fusion import fuse
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import General
from mbsgen.procedure.procedure import Computation, Procedure
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape import forward
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count
from mbsgen.tape.passes import drop_unused_inputs
from mbsgen.tape.ports import Function
from mbsgen.tape.replay import replay, replay_guards
from mbsgen.tape.types import Sparsity, Tape

FUNCTION = Function("close")
ITERATIONS = 3  # the fewest that Newton's method takes from a start nearby
_UNKNOWN = "y"  # the dependent entries: coordinates, or steps of a quaternion's velocities


def build(tree: Tree) -> Computation:
    """Write `close`: inputs q [, theta] [, p]; output closed, shape of q. Fails at the loop that does not close."""
    procedure = _Closing(tree).write()
    (stage, *more) = procedure.stages
    return procedure if more or not isinstance(stage, Straight) else _declare(stage.tape, procedure.inputs)


def build_iterated(tree: Tree) -> Procedure:
    """Write `close` with an iteration for each block, from the closed form if there is one.

    So its derivatives follow from the equations, not from the closed form, which depends on the start.
    """
    return _Closing(tree, is_iterated=True).write()


def build_rates(tree: Tree) -> Tape:
    """Write `close_rates`: inputs q, yd [, theta] [, p]; output qd, shape (n,)."""
    own = Reduced(tree, ALL, [], wrenches=False, by_columns=False)
    own.builder.output_dense(ports.CLOSED_VELOCITIES, [[x] for x in own.select(own.velocities)])
    return own.builder.build("close_rates")


def build_accelerations(tree: Tree) -> Tape:
    """Write `close_accelerations`: inputs q, yd, ydd [, theta] [, p]; output qdd, shape (n,)."""
    own = Reduced(tree, ALL, [ports.INDEPENDENT_ACCELERATIONS], wrenches=False, by_columns=False)
    given = own.given_accelerations
    found = given | own.partition.follow(given, own.bias)
    own.builder.output_dense(ports.CLOSED_ACCELERATIONS, [[x] for x in own.select(found)])
    return own.builder.build("close_accelerations")


def _declare(tape: Tape, inputs: Sequence[Wire]) -> Tape:
    """Return a tape with all inputs of the function, in its order."""
    builder = Builder()
    values = replay(tape, builder, {x.name: builder.input(x.port, x.sparsity) for x in inputs})
    replay_guards(tape, builder, values)
    for o in tape.outputs:
        builder.output(o.port, o.sparsity, [values[v] for v in o.values])
    return builder.build(FUNCTION)


# -- positions ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Block:
    """Some equations, to be solved for as many unknowns."""

    number: int
    place: Place
    residual: Tape  # of q, y and the unknowns solved for before; outputs g and dg/dy
    start: Wire
    solution: Wire

    @property
    def status(self) -> int:
        """Return the status of the loop of the first equation."""
        return min(self.place.statuses)

    @property
    def wires(self) -> list[Wire]:
        """List what the equations depend on besides the unknowns."""
        return [Wire.of(i) for i in self.residual.inputs if i.name != _UNKNOWN]

    @cached_property
    def is_linear(self) -> bool:
        """Return whether the slopes do not depend on the unknowns."""
        slopes = replace(self.residual, outputs=self.residual.outputs[1:])
        return _UNKNOWN not in {i.name for i in drop_unused_inputs(_rebuild(slopes)).inputs}

    @cached_property
    def newton(self) -> Newton:
        """Iterate from the start."""
        size = len(self.place.rows)
        name = f"close_{self.number}"
        return Newton(name, self.residual, _UNKNOWN, self.start, self.solution, General(size), self.status)

    def write_straight(self, result: Wire) -> Straight | None:
        """Write the block without an iteration, if it has such a form that takes less."""
        solve = None if self.is_linear else dyads.find(self.residual, _UNKNOWN)
        if not (self.is_linear or solve):
            return None
        sheet = Sheet()
        y = sheet.take(self.start)
        steps = self._solve_at(sheet, y, solve)
        sheet.give(result, [a + b for a, b in zip(y, steps, strict=True)])
        found = Straight(sheet.finish(f"form_{self.number}"))
        return found if count(found.tape).paper <= ITERATIONS * self.newton.count().paper else None

    def _solve_at(self, sheet: Sheet, y: Sequence[Scalar], solve: dyads.Solve | None) -> list[Scalar]:
        b, size = sheet.builder, len(y)
        curved = size == 1 and solve is not None
        tape = _differentiate(self.residual) if curved else self.residual
        values = replay(tape, b, {w.name: sheet.take(w) for w in self.wires} | {_UNKNOWN: y})
        g = [values[v] for v in tape.outputs[0].values]
        slopes = {x: values[v] for x, v in zip(tape.outputs[1].sparsity.entries, tape.outputs[1].values, strict=True)}
        if solve is None:
            rows = [{c: slopes[r, c] for c in range(size) if (r, c) in slopes} for r in range(size)]
            found = Partition(b, rows, self.place.statuses, range(size)).solve([-x for x in g])
            return [found[c] for c in range(size)]
        columns = tuple(tuple(slopes.get((r, c), b.zero) for r in range(size)) for c in range(size))
        curvature = values[tape.outputs[2].values[0]] if curved else None
        return solve(dyads.Start(b, self.status, tuple(g), columns, curvature))


class _Closing:
    """The blocks of a tree's loops, and the stages that solve them in turn."""

    def __init__(self, tree: Tree, *, is_iterated: bool = False) -> None:
        self.tree, self._is_iterated = tree, is_iterated
        found = known_closure(tree)
        self.dependent = found.dependent
        self.seats = _seat(tree)
        self._gaps = _write_gaps(tree, self.dependent, self.seats)
        self._q = Wire.to(ports.COORDINATES, Sparsity.dense(len(tree.coordinates)))
        self._solved: dict[int, tuple[Wire, int]] = {}  # by the place in `dependent`

    def write(self) -> Procedure:
        """Write all stages."""
        inputs = tuple(Wire.of(i) for i in self._gaps.inputs if i.name != _UNKNOWN)
        stages = [stage for block in self._list_blocks() for stage in self._solve(block)]
        result = Wire.to(ports.CLOSED, self._q.sparsity)
        return fuse(Procedure(FUNCTION, inputs, (*stages, self._assemble(result)), (result,)))

    def _list_blocks(self) -> Iterator[_Block]:
        statuses = closure.list_statuses(self.tree)
        pattern = forward.jacobian(self._gaps, [_UNKNOWN]).outputs[0].sparsity
        rows = [[c for r, c in pattern.entries if r == k] for k in range(pattern.rows)]
        for number, place in enumerate(find_blocks(rows, statuses), 1):
            column = Sparsity.dense(len(place.rows))
            start, solution = Wire(f"start_{number}", column), Wire(f"solution_{number}", column)
            yield _Block(number, place, self._select(place), start, solution)
            self._solved |= {c: (solution, k) for k, c in enumerate(place.columns)}

    def _select(self, place: Place) -> Tape:
        """Write the equations of a block, and their slopes."""
        sheet = Sheet()
        unknown = sheet.builder.vector(_UNKNOWN, len(place.columns))
        y = [
            unknown[place.columns.index(c)]
            if c in place.columns
            else sheet.take(self._solved[c][0])[self._solved[c][1]]
            if c in self._solved
            else sheet.builder.zero
            for c in range(len(self.dependent))
        ]
        given = {i.name: y if i.name == _UNKNOWN else sheet.take(Wire.of(i)) for i in self._gaps.inputs}
        values = replay(self._gaps, sheet.builder, given)
        found = self._gaps.outputs[0].values
        sheet.builder.output_dense("g", [[values[found[r]]] for r in place.rows])
        return _with_slopes(drop_unused_inputs(sheet.finish("gaps")), len(place.columns))

    def _solve(self, block: _Block) -> Iterator[Stage]:
        sheet = Sheet()
        q = sheet.take(self._q)
        own = [self.dependent[c] for c in block.place.columns]
        b, units = sheet.builder, _find_units(self.tree, own)
        starts = [b.zero if self.seats[k] is None else q[self.seats[k] or 0] for k in own]
        sheet.give(block.start, [b.number(1 / unit) * x for x, unit in zip(starts, units, strict=True)])
        yield Straight(sheet.finish(f"begin_{block.number}"))
        near = Wire(f"near_{block.number}", block.start.sparsity)
        form = block.write_straight(near if self._is_iterated else block.solution)
        if form:
            yield form
        if self._is_iterated or not form:
            yield replace(block.newton, start=near) if form else block.newton

    def _assemble(self, result: Wire) -> Straight:
        """Write all coordinates, with unit quaternions. Axes that a loop keeps in one direction may not be opposite."""
        sheet = Sheet()
        b, q = sheet.builder, sheet.take(self._q)
        y = [sheet.take(self._solved[c][0])[self._solved[c][1]] for c in range(len(self.dependent))]
        found = normalise(self.tree, b, _move(self.tree, b, q, y, self.dependent, self.seats))
        sheet.give(result, found)
        tape = coupling.write(lambda own, _: closure.build_senses(own), None, self.tree, ALL)
        given = {i.name: found if i.name == ports.COORDINATES.name else sheet.take(Wire.of(i)) for i in tape.inputs}
        values = replay(tape, b, given)
        for v, loop in zip(tape.outputs[0].values, closure.list_senses(self.tree), strict=True):
            b.guard(values[v], b.number(1.0), 1.0, closure.find_status(self.tree, loop))
        return Straight(sheet.finish("closing"))


def _seat(tree: Tree) -> list[int | None]:
    """Return the entry of q of each entry of qd; None of a quaternion's velocities."""
    inside = {tree.bodies[i - 1].joint.name for x in tree.quaternions for i in x.bodies}
    places = {name: k for k, name in enumerate(tree.coordinates)}
    return [None if joint.name in inside else places[joint.name] for joint in tree.joints]


def _write_gaps(tree: Tree, dependent: Sequence[int], seats: Sequence[int | None]) -> Tape:
    """Write h of q and y, the dependent entries."""
    tape = coupling.write(lambda own, _: closure.build(own), None, tree, ALL)
    builder = Builder()
    given = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs}
    y = builder.vector(_UNKNOWN, len(dependent))
    moved = _move(tree, builder, given[ports.COORDINATES.name], y, dependent, seats)
    values = replay(tape, builder, {**given, ports.COORDINATES.name: moved})
    builder.output_dense("g", [[values[v]] for v in tape.outputs[0].values])
    return builder.build("gaps")


def _move(
    tree: Tree,
    builder: Builder,
    q: Sequence[Scalar],
    y: Sequence[Scalar],
    dependent: Sequence[int],
    seats: Sequence[int | None],
) -> list[Scalar]:
    """Return all coordinates, with y, in units of iterations, in the place of the dependent ones."""
    moved = list(q)
    y = [builder.number(unit) * x for x, unit in zip(y, _find_units(tree, dependent), strict=True)]
    if any(seats[k] is None for k in dependent):
        steps = [builder.zero] * len(seats)
        for k, x in zip(dependent, y, strict=True):
            steps[k] = x if seats[k] is None else builder.zero
        tape = coupling.write(lambda own, _: rates.build(own), None, tree, ALL)
        given = {ports.COORDINATES.name: q, ports.VELOCITIES.name: steps}
        values = replay(
            tape, builder, {i.name: given.get(i.name, [builder.zero] * i.sparsity.nnz) for i in tape.inputs}
        )
        moved = [a + values[v] for a, v in zip(q, tape.outputs[0].values, strict=True)]
    for k, x in zip(dependent, y, strict=True):
        seat = seats[k]
        if seat is not None:
            moved[seat] = x
    return moved


def _find_units(tree: Tree, dependent: Sequence[int]) -> list[float]:
    """Return the units of dependent entries of qd: lengths are counted such that they are of order 1."""
    unit, joints = known_closure(tree).unit, tree.joints
    return [unit if joints[k].motion is Motion.PRISMATIC else 1.0 for k in dependent]


def _with_slopes(tape: Tape, size: int) -> Tape:
    """Add dg/dy to the outputs."""
    builder = Builder()
    given = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs}
    values = replay(tape, builder, given)
    gradients = forward.propagate(tape, builder, values, [_UNKNOWN])
    first = _first(tape)
    found = tape.outputs[0].values
    builder.output_dense("g", [[values[v]] for v in found])
    entries = {(r, c - first): x for r, v in enumerate(found) for c, x in gradients[v].items()}
    builder.output_nonzeros("slopes", size, size, entries)
    return builder.build(tape.function)


def _differentiate(tape: Tape) -> Tape:
    """Add d2g/dy2, of one unknown, to the outputs."""
    builder = Builder()
    given = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs}
    values = replay(tape, builder, given)
    gradients = forward.propagate(tape, builder, values, [_UNKNOWN])
    for o in tape.outputs:
        builder.output(o.port, o.sparsity, [values[v] for v in o.values])
    (slope,) = tape.outputs[1].values
    builder.output_dense("curvature", [[gradients[slope].get(_first(tape), builder.zero)]])
    return builder.build(tape.function)


def _first(tape: Tape) -> int:
    """Return the place of the unknown's first entry among all input nonzeros."""
    place = 0
    for i in tape.inputs:
        if i.name == _UNKNOWN:
            return place
        place += i.sparsity.nnz
    return place


def _rebuild(tape: Tape) -> Tape:
    """Drop the operations that no output needs."""
    builder = Builder()
    values = replay(tape, builder, {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs})
    for o in tape.outputs:
        builder.output(o.port, o.sparsity, [values[v] for v in o.values])
    return builder.build(tape.function)
