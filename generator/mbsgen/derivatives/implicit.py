"""Derivatives of the accelerations by the implicit function theorem, from the derivatives of the residual.

Phi(q, qd, u, qdd) = 0 defines y(x) = qdd of x = (q, qd, u, w). With M = dPhi/dqdd, which depends on q alone:

    y = -M^-1 Phi(x, 0),    dy/dx = -M^-1 dPhi/dx,    (dy/dx)T lambda = (dPhi/dx)T mu,    mu = -M^-1 lambda,

and with H the second derivatives of muT Phi, whose block by qdd and qdd vanishes,

    d2(lambdaT y)/dx2 = Hxx + Hxy dy/dx + (Hxy dy/dx)T.

(Carpentier, Mansard, 2018, for the first derivatives; Singh, Russell, Wensing, 2022.) The stages `Factor` and `Solve`
of `procedure.solve` have the same rules, with A = M and B = -Phi(x, 0). Here they are written as straight-line
programs, which leave out the zeros of M and dPhi/dx; `columns` writes them in stages, for large trees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from mbsgen.derivatives.kernels import Derivatives
from mbsgen.formulations import ports
from mbsgen.formulations.parsimony.elimination import Entries, Factors, factorise
from mbsgen.procedure import solve as systems
from mbsgen.procedure.patterns import LANES, Tree
from mbsgen.procedure.procedure import Procedure, straight
from mbsgen.procedure.solve import Solve
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Order
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Port, adjoint_port, derivative_port, seed_port
from mbsgen.tape.replay import declare_inputs, replay, replay_guards
from mbsgen.tape.types import Input, Sparsity, Tape

ACCELERATIONS, RESIDUAL = ports.ACCELERATIONS.name, ports.RESIDUAL.name
Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
Inputs = Mapping[str, Sequence[Scalar]]


def jacobian(tape: Tape, residual: Derivatives, wrt: Sequence[str]) -> Tape:
    """Write the Jacobian of `tape`: x -> qdd, by the columns `wrt`, from the derivatives of the residual.

    The pivots of M have the guards of `tape`.
    """
    return _write_slopes(_State.declare(tape, residual), wrt, Order.JACOBIAN)


def linearisation(tape: Tape, residual: Derivatives, wrt: Sequence[str]) -> Tape:
    """Write the accelerations, and their Jacobian."""
    state = _State.declare(tape, residual)
    state.builder.output_dense(ports.ACCELERATIONS, [[x] for x in state.inputs[ACCELERATIONS]])
    return _write_slopes(state, wrt, Order.LINEARISATION)


def columns(tape: Tape, residual: Derivatives, wrt: Sequence[str]) -> Procedure:
    """Write the accelerations and their Jacobian in two stages: dPhi/dx and the factors of M, then the solution."""
    state = _State.declare(tape, residual)
    state.builder.output_dense(ports.ACCELERATIONS, [[x] for x in state.inputs[ACCELERATIONS]])
    blocks: list[systems.Block] = []
    right: Block = {}  # of dPhi/dx, transposed
    used, n = 0, state.size
    for x in wrt:
        size = tape.input(x).sparsity.nnz
        blocks.append(systems.Block(Wire.to(state.slope(x), Sparsity.dense(n, size)), used))
        found = state.right_hand_sides(x).items()
        right |= {(used + c, r): value for (r, c), value in found if not value.is_zero}
        used += size
    width, factors = -(-used // LANES) * LANES, state.factors
    pattern = Tree(tuple(tuple(i - 1 for i in factors.ancestors(k)) for k in range(1, n + 1)))
    entries = [factors.L[i + 1, k] for k, row in enumerate(pattern.ancestors, 1) for i in row]
    lower, inverses = Wire("lower", Sparsity.dense(len(entries))), Wire("inverses", Sparsity.dense(n))
    rows = Wire("columns", Sparsity.of(width, n, right))
    state.builder.output(lower.name, lower.sparsity, entries)
    state.builder.output(inverses.name, inverses.sparsity, [factors.inverses[k] for k in range(1, n + 1)])
    state.builder.output(rows.name, rows.sparsity, [right[place] for place in rows.sparsity.entries])
    function = tape.function.to(Order.LINEARISATION)
    before = Straight(state.builder.build(f"columns_{function.name}"))
    solve = Solve(f"solve_{function.name}", pattern, (lower, inverses), rows, tuple(blocks), negated=True)
    return Procedure(function, before.reads, (before, solve), (before.gives[0], *solve.gives))


def _write_slopes(state: _State, wrt: Sequence[str], order: Order) -> Tape:
    for x, block in state.slopes(wrt).items():
        state.builder.output_nonzeros(state.slope(x), state.size, state.tape.input(x).sparsity.nnz, block)
    return state.finish(order)


def adjoint(tape: Tape, residual: Derivatives, wrt: Sequence[str]) -> Tape:
    """Write the adjoint of `tape`."""
    state = _State.declare(tape, residual, seeded=True)
    found = state.replay(residual.adj1, {**state.inputs, seed_port(ports.RESIDUAL).name: state.multipliers})
    for given in map(tape.input, wrt):
        pattern, port = given.sparsity, adjoint_port(given.port)
        state.builder.output(port, pattern, found[port.name].column(pattern.nnz, state.builder))
    return state.finish(Order.ADJOINT)


def adjoint_jacobian(tape: Tape, residual: Derivatives, wrt: Sequence[str]) -> Tape:
    """Write the Jacobian of the adjoint of `tape`."""
    state = _State.declare(tape, residual, seeded=True)
    assert residual.jac_adj1, "second derivatives are made of the residual's"
    found = state.replay(residual.jac_adj1, {**state.inputs, seed_port(ports.RESIDUAL).name: state.multipliers})
    inputs = {name: tape.input(name).port for name in wrt}

    def block_of(row: str, col: Port) -> Port:
        return derivative_port(adjoint_port(inputs[row]), col)

    slopes = state.slopes(wrt)
    mixed = {a: found[block_of(a, ports.ACCELERATIONS).name].entries for a in wrt}
    sizes = {name: tape.input(name).sparsity.nnz for name in wrt}
    for n, a in enumerate(wrt):
        for b in wrt:
            one, other = (a, b) if n >= wrt.index(b) else (b, a)  # each pair is formed once
            block = dict(found[block_of(one, inputs[other]).name].entries)
            _accumulate(block, _product(mixed[one], slopes[other]))
            _accumulate(block, _transposed(_product(mixed[other], slopes[one])))
            entries = block if one == a else _transposed(block)
            state.builder.output_nonzeros(block_of(a, inputs[b]), sizes[a], sizes[b], entries)
        port = block_of(a, seed_port(ports.ACCELERATIONS))
        state.builder.output_nonzeros(port, sizes[a], state.size, _transposed(slopes[a]))
    return state.finish(Order.ADJOINT_JACOBIAN)


def _product(A: Block, B: Block) -> Block:
    rows: dict[int, list[tuple[int, Scalar]]] = {}
    for (r, c), value in B.items():
        rows.setdefault(r, []).append((c, value))
    total: Block = {}
    for (r, k), left in A.items():
        _accumulate(total, {(r, c): left * right for c, right in rows.get(k, [])})
    return total


def _accumulate(total: Block, more: Block) -> None:
    for place, value in more.items():
        total[place] = total[place] + value if place in total else value


def _transposed(block: Block) -> Block:
    return {(c, r): value for (r, c), value in block.items()}


@dataclass(frozen=True)
class _Found:
    """An output of a tape that was replayed."""

    entries: Block

    def column(self, size: int, builder: Builder) -> list[Scalar]:
        return [self.entries.get((k, 0), builder.zero) for k in range(size)]


@dataclass(frozen=True)
class _State:
    """The common start of all derivatives: the accelerations, by the factors of M."""

    builder: Builder
    tape: Tape
    residual: Derivatives
    inputs: Inputs  # of the residual, with the accelerations that make it vanish
    factors: Factors
    multipliers: list[Scalar]  # mu; empty without seeds

    @staticmethod
    def declare(tape: Tape, residual: Derivatives, *, seeded: bool = False) -> _State:
        builder = Builder()
        given: dict[str, Sequence[Scalar]] = dict(declare_inputs(tape, builder))
        size = tape.output(ACCELERATIONS).sparsity.rows
        at_rest = given | {ACCELERATIONS: [builder.zero] * size}
        block = derivative_port(ports.RESIDUAL, ports.ACCELERATIONS).name
        M = _replay(builder, straight(residual.jac), at_rest)[block].entries
        upper: Entries = {(i + 1, j + 1): value for (i, j), value in M.items() if i <= j}
        factors = factorise(builder, upper, size)
        bias = _replay(builder, residual.tape, at_rest)[RESIDUAL].entries
        qdd = factors.solve({i + 1: -value for (i, _), value in bias.items()})
        multipliers: list[Scalar] = []
        if seeded:
            seeds = builder.input(seed_port(ports.ACCELERATIONS), tape.output(ACCELERATIONS).sparsity)
            mu = factors.solve({i: -seed for i, seed in enumerate(seeds, 1)})
            multipliers = [mu[i] for i in range(1, size + 1)]
        inputs = given | {ACCELERATIONS: [qdd[i] for i in range(1, size + 1)]}
        state = _State(builder, tape, residual, inputs, factors, multipliers)
        state._guard()
        return state

    @property
    def size(self) -> int:
        return self.factors.size

    def replay(self, tape: Tape, inputs: Inputs) -> dict[str, _Found]:
        return _replay(self.builder, tape, inputs)

    @cached_property
    def _slopes_of_residual(self) -> dict[str, _Found]:
        return self.replay(straight(self.residual.jac), self.inputs)

    def right_hand_sides(self, name: str) -> Block:
        """Return dPhi/dx, with dy/dx = -M^-1 dPhi/dx."""
        return self._slopes_of_residual[derivative_port(ports.RESIDUAL, self.tape.input(name).port).name].entries

    def slopes(self, wrt: Sequence[str]) -> dict[str, Block]:
        """Solve for dy/dx, by columns. Unit columns give columns of the inverse of M."""
        found: dict[str, Block] = {}
        for name in wrt:
            columns: dict[int, dict[int, Scalar]] = {}
            for (r, c), value in self.right_hand_sides(name).items():
                columns.setdefault(c, {})[r + 1] = -value
            units = {c: next(iter(b)) for c, b in columns.items() if len(b) == 1 and _is_one(next(iter(b.values())))}
            inverse = self.factors.invert(units.values())
            found[name] = {
                (i - 1, c): value
                for c, b in columns.items()
                for i, value in (inverse[units[c]] if c in units else self.factors.solve(b)).items()
                if not value.is_zero
            }
        return found

    def _guard(self) -> None:
        """Guard the pivots by the scales and tolerances of the tape's own."""
        values = replay(self.tape, self.builder, self.inputs)
        replay_guards(self.tape, self.builder, values, only_early=True)
        for guard in (g for g in self.tape.guards if not g.early):
            pivot = self.factors.D[guard.joint]
            self.builder.guard(pivot, values[guard.scale], guard.tolerance, guard.joint)

    def slope(self, name: str) -> Port:
        """Return the port of the derivative of the accelerations by an input."""
        return derivative_port(ports.ACCELERATIONS, self.tape.input(name).port)

    def finish(self, order: Order) -> Tape:
        return self.builder.build(self.tape.function.to(order))


def _is_one(value: Scalar) -> bool:
    return value.literal == 1.0


def _replay(builder: Builder, tape: Tape, inputs: Inputs) -> dict[str, _Found]:
    """Replay a tape, and give its outputs by place."""
    values = replay(tape, builder, {i.name: _nonzeros(i, inputs) for i in tape.inputs})
    replay_guards(tape, builder, values, only_early=True)
    return {
        o.name: _Found({place: values[v] for place, v in zip(o.sparsity.entries, o.values, strict=True)})
        for o in tape.outputs
    }


def _nonzeros(given: Input, inputs: Inputs) -> Sequence[Scalar]:
    return inputs[given.name]
