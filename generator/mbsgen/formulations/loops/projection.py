"""Projection: coordinates and velocities, put on closed poses by the least change.

    q  <- q - W^-1 JT lam,    h(q) = 0         J and W at the given q; lam by Newton's method
    qd <- qd - W^-1 JT lam,   J qd = 0         J and W at the new q

with W = 1 (`project_plain`), or the mass matrix (`project`), in whose norm the change is the least (Hairer, Lubich,
Wanner, 2006, IV.4; Lubich, 1991). Where W = 1, a shift of 1 m counts as a turn of 1 rad; in loops that are much smaller
or larger, a shift of their size does: loops of kilometres would rather turn their bodies than shift them. The changes
of q are along velocities, so quaternions turn: q <- q + rates(q, x), made unit quaternions at the end. Driven joints
keep their coordinates and velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mbsgen.formulations import closure, coupling, multipliers, ports, rates, semi
from mbsgen.formulations.multipliers import Row
from mbsgen.formulations.parsimony.elimination import Column, factorise
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Motion, Tree
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import General
from mbsgen.procedure.procedure import Procedure
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape import forward
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.passes import drop_unused_inputs, keep_results
from mbsgen.tape.ports import Function
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Sparsity, Tape

_LAMBDA = "lam"


def build(tree: Tree, reductions: Reductions, *, weighted: bool) -> Procedure:
    """Write `project` or `project_plain`: inputs q, qd [, theta] [, p]; outputs closed, shape of q, and closed_qd.

    Fails at a loop whose equations depend on others, or, at the first one, where the iteration does not converge.
    """
    return _Projection.of(tree, reductions, weighted=weighted).write("project" if weighted else "project_plain")


@dataclass(frozen=True)
class _Projection:
    """The tapes of a tree that a projection evaluates."""

    tree: Tree
    gaps: Tape
    jacobian: Tape
    rates: Tape | None
    mass: Tape | None  # None: W = 1
    free: tuple[int, ...]  # the entries of qd that are not driven
    units: tuple[float, ...]  # of the multipliers that are iterated

    @staticmethod
    def of(tree: Tree, reductions: Reductions, *, weighted: bool) -> _Projection:
        def write(build: closure.Write) -> Tape:
            return coupling.write(lambda own, _: build(own), None, tree, reductions)

        mass = coupling.write(semi.build, None, tree, reductions) if weighted else None
        driven = {tree.bodies[number - 1].joint.name for number in tree.driven}
        return _Projection(
            tree,
            write(closure.build),
            write(lambda own: drop_unused_inputs(closure.write_jacobian(own))),
            write(rates.build) if tree.quaternions else None,
            drop_unused_inputs(keep_results(mass, {ports.MASS_MATRIX.name})) if mass else None,
            tuple(k for k, joint in enumerate(tree.joints) if joint.name not in driven),
            _choose_units(tree, weighted=weighted),
        )

    def write(self, name: str) -> Procedure:
        """Write the stages: the directions W^-1 JT, the multipliers, the results."""
        q = Wire.to(ports.COORDINATES, Sparsity.dense(len(self.tree.coordinates)))
        qd = Wire.to(ports.VELOCITIES, Sparsity.dense(len(self.tree.joints)))
        m = len(closure.kept_equations(self.tree))
        n, column = len(self.tree.joints), Sparsity.dense(m)
        entries = [(r, c) for r in self.free for c in range(m)]
        directions = Wire("directions", Sparsity.of(n, m, entries))
        start, found = Wire("still", column), Wire("forces", column)
        sheet = Sheet()
        solved = self._solve(sheet, sheet.take(q))
        sheet.give(directions, [solved.columns[c][r] for r, c in directions.sparsity.entries])
        sheet.give(start, [sheet.builder.zero] * m)
        first = Straight(sheet.finish("directions_of_projection"))
        residual = self._write_residual(q, directions)
        newton = Newton("projection", residual, _LAMBDA, start, found, General(m), n + 1)
        last = self._write_results(q, qd, directions, found)
        inputs = (q, qd, *(Wire.of(i) for i in self.gaps.inputs if i.name != q.name))
        outputs = Wire.to(ports.CLOSED, q.sparsity), Wire.to(ports.PROJECTED_VELOCITIES, qd.sparsity)
        return Procedure(Function(name), inputs, (first, newton, last), outputs)

    def _replay(self, tape: Tape, sheet: Sheet, q: Sequence[Scalar], qd: Sequence[Scalar] = ()) -> list[Scalar]:
        given = {ports.COORDINATES.name: q, ports.VELOCITIES.name: qd}
        known = {i.name: given[i.name] if i.name in given else sheet.take(Wire.of(i)) for i in tape.inputs}
        return replay(tape, sheet.builder, known)

    def _solve(self, sheet: Sheet, q: Sequence[Scalar]) -> _Solved:
        """Solve W x = JT for the entries that are not driven."""
        b, values = sheet.builder, self._replay(self.jacobian, sheet, q)
        rows: list[Row] = [{} for _ in range(self.jacobian.outputs[0].sparsity.rows)]
        for (r, c), value in closure.jacobian_entries(self.jacobian, values).items():
            rows[r][c] = value
        if self.mass is None:
            return _Solved(b, rows, [{k: self._ease(k, row.get(k, b.zero)) for k in self.free} for row in rows])
        values = self._replay(self.mass, sheet, q)
        output = self.mass.outputs[0]
        M = {place: values[v] for place, v in zip(output.sparsity.entries, output.values, strict=True)}
        numbers = {k: i for i, k in enumerate(self.free, 1)}
        upper = {
            (numbers[i], numbers[j]): x
            for (i, j), x in M.items()
            if i <= j and i in numbers and j in numbers and not x.is_zero
        }
        factors = factorise(b, upper, len(numbers))
        columns: list[Column] = []
        for row in rows:
            x = factors.solve({numbers[k]: value for k, value in row.items() if k in numbers})
            columns.append({k: x[numbers[k]] for k in self.free})
        return _Solved(b, rows, columns)

    def _ease(self, k: int, force: Scalar) -> Scalar:
        """Return the shift or turn by a force along a velocity where W = 1 in the unit of the loops."""
        known, is_shift = self.tree.closure, self.tree.joints[k].motion is Motion.PRISMATIC
        unit = known.unit if known is not None and is_shift else 1.0
        return force if unit == 1.0 else force * force.builder.number(unit * unit)

    def _move(self, sheet: Sheet, q: Sequence[Scalar], x: Mapping[int, Scalar]) -> list[Scalar]:
        """Return the coordinates after a step along velocities."""
        b = sheet.builder
        steps = [x.get(k, b.zero) for k in range(len(self.tree.joints))]
        if self.rates is not None:
            values = self._replay(self.rates, sheet, q, steps)
            steps = [values[v] for v in self.rates.outputs[0].values]
        return [a + step for a, step in zip(q, steps, strict=True)]

    def _write_residual(self, q: Wire, directions: Wire) -> Tape:
        """Write h after a step, of lam, and its slopes."""
        m = directions.sparsity.cols
        sheet = Sheet()
        lam = sheet.builder.vector(_LAMBDA, m)
        moved = self._move(sheet, sheet.take(q), _combine(sheet.place(directions), self._scale(lam)))
        values = self._replay(self.gaps, sheet, moved)
        sheet.builder.output_dense("g", [[values[v]] for v in self.gaps.outputs[0].values])
        tape = sheet.finish("projection_gaps")
        builder = Builder()
        given = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs}
        values = replay(tape, builder, given)
        gradients = forward.propagate(tape, builder, values, [_LAMBDA])
        found = tape.outputs[0].values
        builder.output_dense("g", [[values[v]] for v in found])
        entries = {(r, c): x for r, v in enumerate(found) for c, x in gradients[v].items()}  # lam is the first input
        builder.output_nonzeros("slopes", m, m, entries)
        return builder.build(tape.function)

    def _scale(self, lam: Sequence[Scalar]) -> list[Scalar]:
        """Return the multipliers of iterated numbers: at any size, these are of order 1."""
        return [x.builder.number(unit) * x for x, unit in zip(lam, self.units, strict=True)]

    def _write_results(self, q: Wire, qd: Wire, directions: Wire, found: Wire) -> Straight:
        sheet = Sheet()
        b = sheet.builder
        closed = self._move(sheet, sheet.take(q), _combine(sheet.place(directions), self._scale(sheet.take(found))))
        closed = normalise(self.tree, b, closed)
        solved, velocities = self._solve(sheet, closed), sheet.take(qd)
        lam = solved.balance(
            [multipliers.along(row, velocities, b.zero) for row in solved.rows],
            multipliers.list_owners(self.tree)[: len(solved.rows)],
        )
        for k in self.free:
            parts = [column[k] * x for column, x in zip(solved.columns, lam, strict=True)]
            velocities[k] = sum((-x for x in parts), start=velocities[k])
        sheet.give(Wire.to(ports.CLOSED, q.sparsity), closed)
        sheet.give(Wire.to(ports.PROJECTED_VELOCITIES, qd.sparsity), velocities)
        return Straight(sheet.finish("projected"))


@dataclass(frozen=True)
class _Solved:
    """J by rows, and W^-1 JT by columns."""

    builder: Builder
    rows: Sequence[Row]
    columns: Sequence[Column]

    def balance(self, right: Sequence[Scalar], owners: Sequence[multipliers.Owner]) -> list[Scalar]:
        """Solve J W^-1 JT lam = right."""
        zero = self.builder.zero
        rows = [{k: x for k, x in row.items() if k in self.columns[0]} for row in self.rows]
        A = {(k, l): multipliers.along(rows[k], self.columns[l], zero) for l in range(len(rows)) for k in range(l + 1)}
        system = multipliers.eliminate(self.builder, A, len(rows))
        multipliers.guard(self.builder, owners, A, system.pivots)
        return system.solve(right)


def _choose_units(tree: Tree, *, weighted: bool) -> tuple[float, ...]:
    found = tree.closure and (tree.closure.pulls if weighted else tree.closure.plain_pulls)
    return found or (1.0,) * len(closure.kept_equations(tree))


def _combine(directions: Mapping[tuple[int, int], Scalar], lam: Sequence[Scalar]) -> dict[int, Scalar]:
    """Return -W^-1 JT lam."""
    total: dict[int, Scalar] = {}
    for (r, c), x in sorted(directions.items()):
        step = -(x * lam[c])
        total[r] = total[r] + step if r in total else step
    return total


def normalise(tree: Tree, builder: Builder, q: Sequence[Scalar]) -> list[Scalar]:
    """Return coordinates with unit quaternions."""
    found = list(q)
    for x in tree.quaternions:
        first = tree.coordinates.index(x.coordinates[-4])
        own = range(first, first + 4)
        inverse = builder.number(1.0) / builder.sqrt(sum((found[k] * found[k] for k in own), start=builder.zero))
        for k in own:
            found[k] = found[k] * inverse
    return found
