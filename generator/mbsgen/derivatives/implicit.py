"""Derivatives of the accelerations by the implicit function theorem, from the derivatives of the residual.

Phi(q, qd, u, qdd) = 0 defines y(x) = qdd of x = (q, qd, u, w). With M = dPhi/dqdd, which depends on q alone:

    y = -M^-1 Phi(x, 0),    dy/dx = -M^-1 dPhi/dx,    (dy/dx)T lambda = (dPhi/dx)T mu,    mu = -M^-1 lambda,

and with H the second derivatives of muT Phi, whose block by qdd and qdd vanishes,

    d2(lambdaT y)/dx2 = Hxx + Hxy dy/dx + (Hxy dy/dx)T.

(Carpentier, Mansard, 2018, for the first derivatives; Singh, Russell, Wensing, 2022.) Loops and driven joints add
unknowns and equations: y = (qdd, lam, tau), and

    R(x, y) = (Phi, hdd, qdd - a of the driven joints) = 0,    dR/dy = K = | M  -JT |
                                                                           | J    0 |

where J has a row for each loop's equation and each driven joint. R is linear in y and has no product of two unknowns,
so all of this holds with R for Phi and K for M, and with mu = -K^-T lambda.

The stages `Factor` and `Solve` of `procedure.solve` have the same rules, with A = M and B = -Phi(x, 0). Here they are
written as straight-line programs, which leave out the zeros of M and dPhi/dx; `columns` writes them in stages, for
large trees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from mbsgen.derivatives.kernels import Derivatives
from mbsgen.formulations import exp1, exp2, multipliers, ports
from mbsgen.formulations.multipliers import Bordered, Owner
from mbsgen.formulations.parsimony.elimination import Column, Entries, Factors, factorise
from mbsgen.manifest import FIRST_LENGTH
from mbsgen.procedure import solve as systems
from mbsgen.procedure.patterns import LANES, Tree
from mbsgen.procedure.procedure import Procedure, straight
from mbsgen.procedure.solve import Solve
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Order
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Port, adjoint_port, derivative_port, seed_port
from mbsgen.tape.replay import declare_inputs, replay, replay_guards, replay_lengths
from mbsgen.tape.types import Guard, Input, Sparsity, Tape

ACCELERATIONS, RESIDUAL = ports.ACCELERATIONS.name, ports.RESIDUAL.name
UNKNOWNS = (ports.ACCELERATIONS, ports.MULTIPLIERS, ports.DRIVING_FORCES)  # y, in this order
Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
Inputs = Mapping[str, Sequence[Scalar]]


@dataclass(frozen=True)
class Constraints:
    """The equations beside the residual's, of a tree with loops or driven joints."""

    accelerations: Derivatives | None  # hdd of loops and constraints; without them, joints are driven only
    driven: int  # joints
    owners: tuple[Owner, ...]  # of each equation
    guards: Tape  # of rows that may vanish as a whole
    unrestrained: Tape  # the accelerations of the same tree without these equations, with the guards of its joints


def jacobian(tape: Tape, residual: Derivatives, wrt: Sequence[str], constraints: Constraints | None = None) -> Tape:
    """Write the Jacobian of `tape`: x -> qdd [, lam] [, tau], by the columns `wrt`, from the residual's derivatives.

    The pivots of M have guards that suit its elimination.
    """
    return _write_slopes(_State.declare(tape, residual, constraints), wrt, Order.JACOBIAN)


def linearisation(
    tape: Tape, residual: Derivatives, wrt: Sequence[str], constraints: Constraints | None = None
) -> Tape:
    """Write the accelerations [and forces], and their Jacobian."""
    state = _State.declare(tape, residual, constraints)
    state.write_results()
    return _write_slopes(state, wrt, Order.LINEARISATION)


def columns(tape: Tape, residual: Derivatives, wrt: Sequence[str]) -> Procedure:
    """Write the accelerations and their Jacobian in two stages: dPhi/dx and the factors of M, then the solution.

    For trees without loops and driven joints.
    """
    state = _State.declare(tape, residual)
    state.write_results()
    blocks: list[systems.Block] = []
    right: Block = {}  # of dPhi/dx, transposed
    used, n = 0, state.factors.size
    for x in wrt:
        size = tape.input(x).sparsity.nnz
        blocks.append(systems.Block(Wire.to(state.slope(ports.ACCELERATIONS, x), Sparsity.dense(n, size)), used))
        found = state.right_hand_sides(x)[RESIDUAL].items()
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
    slopes = state.slopes(wrt)
    for o in state.tape.outputs:
        for x in wrt:
            shape = o.sparsity.rows, state.tape.input(x).sparsity.nnz
            state.builder.output_nonzeros(state.slope(o.port, x), *shape, slopes[x][o.port])
    return state.finish(order)


def adjoint(tape: Tape, residual: Derivatives, wrt: Sequence[str], constraints: Constraints | None = None) -> Tape:
    """Write the adjoint of `tape`."""
    state = _State.declare(tape, residual, constraints, seeded=True, sloped=False)
    found = state.replay_weighted(lambda part: straight(part.adj1))
    for given in map(tape.input, wrt):
        pattern, port = given.sparsity, adjoint_port(given.port)
        column = found.get(port.name, _Found({})).column(pattern.nnz, state.builder)
        state.builder.output(port, pattern, state.drive() if given.port == ports.DRIVE else column)
    return state.finish(Order.ADJOINT)


def adjoint_jacobian(
    tape: Tape, residual: Derivatives, wrt: Sequence[str], constraints: Constraints | None = None
) -> Tape:
    """Write the Jacobian of the adjoint of `tape`."""
    state = _State.declare(tape, residual, constraints, seeded=True)
    found = state.replay_weighted(lambda part: part.jac_adj1)
    inputs = {name: tape.input(name).port for name in wrt}

    def block_of(row: str, col: Port) -> Port:
        return derivative_port(adjoint_port(inputs[row]), col)

    def take(row: str, col: Port) -> Block:
        return found.get(block_of(row, col).name, _Found({})).entries

    slopes = state.slopes(wrt)
    mixed = {a: {y: take(a, y) for y in state.unknowns} for a in wrt}
    sizes = {name: tape.input(name).sparsity.nnz for name in wrt}
    for n, a in enumerate(wrt):
        for b in wrt:
            one, other = (a, b) if n >= wrt.index(b) else (b, a)  # each pair is formed once
            block = dict(take(one, inputs[other]))
            for y in state.unknowns:
                _accumulate(block, _product(mixed[one][y], slopes[other][y]))
                _accumulate(block, _transposed(_product(mixed[other][y], slopes[one][y])))
            entries = block if one == a else _transposed(block)
            state.builder.output_nonzeros(block_of(a, inputs[b]), sizes[a], sizes[b], entries)
        for o in tape.outputs:
            block = _transposed(slopes[a][o.port])
            state.builder.output_nonzeros(block_of(a, seed_port(o.port)), sizes[a], o.sparsity.rows, block)
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
    """The common start of all derivatives: the unknowns, by the factors of K."""

    builder: Builder
    tape: Tape
    residual: Derivatives
    constraints: Constraints | None
    inputs: Inputs  # of the residual, with the unknowns that make it vanish
    system: Bordered
    unknowns: Mapping[Port, int]  # their sizes
    weights: Mapping[Port, Sequence[Scalar]]  # mu, by the results of the residual; empty without seeds
    diagonal: Mapping[int, Scalar]  # of M

    @staticmethod
    def declare(
        tape: Tape,
        residual: Derivatives,
        constraints: Constraints | None = None,
        *,
        seeded: bool = False,
        sloped: bool = True,
    ) -> _State:
        builder = Builder()
        given: dict[str, Sequence[Scalar]] = dict(declare_inputs(tape, builder))
        unknowns = {i.port: i.sparsity.nnz for i in residual.tape.inputs if i.port in UNKNOWNS}
        size = unknowns[ports.ACCELERATIONS]
        at_rest = given | {port.name: [builder.zero] * n for port, n in unknowns.items()}
        block = derivative_port(ports.RESIDUAL, ports.ACCELERATIONS).name
        M = _replay(builder, straight(residual.jac), at_rest)[block].entries
        upper: Entries = {(i + 1, j + 1): value for (i, j), value in M.items() if i <= j}
        factors = factorise(builder, upper, size)
        rows, right = _write_rows(builder, constraints, at_rest)
        system = Bordered.of(factors, rows)
        value = residual.bias if sloped else residual.tape  # the slopes hold most of the former
        bias = _replay(builder, value, at_rest)[RESIDUAL].entries
        x, z = system.solve({i + 1: -value for (i, _), value in bias.items()}, right)
        forces = iter(z)
        found = {ACCELERATIONS: [x[i] for i in range(1, size + 1)]}
        found |= {port.name: [next(forces) for _ in range(n)] for port, n in [*unknowns.items()][1:]}
        weights = _weigh(builder, tape, system, unknowns) if seeded else {}
        diagonal = {i: upper[i, i] for i in range(1, size + 1)}
        state = _State(builder, tape, residual, constraints, {**given, **found}, system, unknowns, weights, diagonal)
        state._guard()
        return state

    @property
    def factors(self) -> Factors:
        return self.system.factors

    @property
    def _parts(self) -> Iterator[tuple[Port, Derivatives]]:
        """Yield the parts of R that have derivatives to be replayed."""
        yield ports.RESIDUAL, self.residual
        if self.constraints and self.constraints.accelerations:
            yield ports.CLOSURE_ACCELERATION, self.constraints.accelerations

    def replay_weighted(self, order: Callable[[Derivatives], Tape]) -> dict[str, _Found]:
        """Add up a derivative of muT R over the parts of R, by place."""
        total: dict[str, _Found] = {}
        for port, part in self._parts:
            given = {**self.inputs, seed_port(port).name: self.weights[port]}
            for name, found in _replay(self.builder, order(part), given).items():
                if name in total:
                    _accumulate(total[name].entries, found.entries)
                else:
                    total[name] = found
        return total

    def drive(self) -> list[Scalar]:
        """Return the adjoint by the accelerations of driven joints."""
        return [-x for x in self.weights[ports.DRIVE]]

    def write_results(self) -> None:
        for o in self.tape.outputs:
            self.builder.output_dense(o.port, [[x] for x in self.inputs[o.name]])

    @cached_property
    def _slopes_of_parts(self) -> dict[Port, dict[str, _Found]]:
        return {port: _replay(self.builder, straight(part.jac), self.inputs) for port, part in self._parts}

    def right_hand_sides(self, name: str) -> dict[str, Block]:
        """Return dR/dx by the results of R, with dy/dx = -K^-1 dR/dx."""
        x = self.tape.input(name).port
        blocks = {
            port.name: slopes.get(derivative_port(port, x).name, _Found({})).entries
            for port, slopes in self._slopes_of_parts.items()
        }
        if x == ports.DRIVE:
            blocks[x.name] = {(k, k): -self.builder.number(1.0) for k in range(self.unknowns[ports.DRIVING_FORCES])}
        return blocks

    def slopes(self, wrt: Sequence[str]) -> dict[str, dict[Port, Block]]:
        """Solve for dy/dx, by columns. Unit columns give columns of the inverse of K."""
        return {name: self._solve(self.right_hand_sides(name)) for name in wrt}

    def _solve(self, blocks: Mapping[str, Block]) -> dict[Port, Block]:
        columns: dict[int, dict[int, Scalar]] = {}
        for (r, c), value in blocks[RESIDUAL].items():
            columns.setdefault(c, {})[r + 1] = -value
        lower: dict[int, dict[int, Scalar]] = {}  # of the equations beside the residual's
        first = self.unknowns.get(ports.MULTIPLIERS, 0)
        for name, start in ((ports.CLOSURE_ACCELERATION.name, 0), (ports.DRIVE.name, first)):
            for (r, c), value in blocks.get(name, {}).items():
                lower.setdefault(c, {})[start + r] = -value
        units = {
            c: next(iter(b))
            for c, b in columns.items()
            if c not in lower and len(b) == 1 and _is_one(next(iter(b.values())))
        }
        inverse = self.system.invert(units.values())
        found: dict[Port, Block] = {port: {} for port in self.unknowns}
        count = sum(self.unknowns.values()) - self.factors.size
        for c in [*columns, *(c for c in lower if c not in columns)]:
            right = [lower.get(c, {}).get(k, self.builder.zero) for k in range(count)]
            x, z = inverse[units[c]] if c in units else self.system.solve(columns.get(c, {}), right)
            entries = iter([*(x[i] for i in range(1, len(x) + 1)), *z])
            for port, size in self.unknowns.items():
                column = {(r, c): next(entries) for r in range(size)}
                found[port] |= {place: value for place, value in column.items() if not value.is_zero}
        return found

    def _guard(self) -> None:
        """Guard the pivots of M as EXP1 does, whatever form the values have: elimination loses digits that EXP2 keeps.

        So a joint of EXP2 whose own body has inertia is compared with its entry of M, and any other one with the
        largest inertia.
        """
        of_joints = self.constraints.unrestrained if self.constraints else self.tape
        values = replay(of_joints, self.builder, {i.name: self.inputs[i.name] for i in of_joints.inputs})
        replay_guards(of_joints, self.builder, values, only_early=True)
        replay_lengths(of_joints, self.builder, values)
        pivots = (g for g in of_joints.guards if not g.early and g.joint < FIRST_LENGTH and of_joints.is_pivot(g))
        demands = {
            (g.joint, scale.ref, tolerance): scale for g in pivots for scale, tolerance in [self._demand(g, values)]
        }
        for (joint, _, tolerance), scale in demands.items():
            self.builder.guard(self.factors.D[joint], scale, tolerance, joint)
        if self.constraints:
            system = self.system
            multipliers.guard(self.builder, self.constraints.owners, system.A, system.reduced.pivots)
            rows = self.constraints.guards
            values = replay(rows, self.builder, {i.name: self.inputs[i.name] for i in rows.inputs})
            replay_guards(rows, self.builder, values)

    def _demand(self, guard: Guard, values: Sequence[Scalar]) -> tuple[Scalar, float]:
        """Return the scale and the tolerance of a pivot of M."""
        if guard.tolerance == exp2.OWN_TOLERANCE:
            return self.diagonal[guard.joint], self.factors.size * exp1.PIVOT_TOLERANCE
        tolerance = exp1.LOCKING_TOLERANCE if guard.tolerance in exp2.WITHOUT_MASS else guard.tolerance
        return values[guard.scale], tolerance

    def slope(self, of: Port, name: str) -> Port:
        """Return the port of the derivative of a result by an input."""
        return derivative_port(of, self.tape.input(name).port)

    def finish(self, order: Order) -> Tape:
        return self.builder.build(self.tape.function.to(order))


def _write_rows(
    builder: Builder, constraints: Constraints | None, at_rest: Inputs
) -> tuple[list[Column], list[Scalar]]:
    """Write J by rows, and the values that J qdd must have: -gamma of loops, and a of the driven joints."""
    if constraints is None:
        return [], []
    rows: list[Column] = []
    right: list[Scalar] = []
    if constraints.accelerations:
        block = derivative_port(ports.CLOSURE_ACCELERATION, ports.ACCELERATIONS).name
        J = _replay(builder, straight(constraints.accelerations.jac), at_rest)[block].entries
        bias = _replay(builder, constraints.accelerations.tape, at_rest)[ports.CLOSURE_ACCELERATION.name].entries
        rows = [{} for _ in bias]
        for (r, c), value in J.items():
            rows[r][c + 1] = value
        right = [-bias[k, 0] for k in range(len(rows))]
    if constraints.driven:
        joints = [owner.status for owner in constraints.owners[-constraints.driven :]]
        rows += [{number: builder.number(1.0)} for number in joints]
        right += at_rest[ports.DRIVE.name]
    return rows, right


def _weigh(
    builder: Builder, tape: Tape, system: Bordered, unknowns: Mapping[Port, int]
) -> dict[Port, Sequence[Scalar]]:
    """Declare seeds; solve KT mu = -seeds. With KT (x, -z) = (b, -c) where K (x, z) = (b, c), mu = (x, -z)."""
    seeds: dict[Port, list[Scalar]] = {port: [builder.zero] * n for port, n in unknowns.items()}
    for o in tape.outputs:
        seeds[o.port] = builder.input(seed_port(o.port), o.sparsity)
    first, *others = seeds.values()
    x, z = system.solve({i: -seed for i, seed in enumerate(first, 1)}, [seed for own in others for seed in own])
    m = unknowns.get(ports.MULTIPLIERS, 0)
    lower = [-force for force in z]
    weights: dict[Port, Sequence[Scalar]] = {ports.RESIDUAL: [x[i] for i in range(1, len(x) + 1)]}
    return {**weights, ports.CLOSURE_ACCELERATION: lower[:m], ports.DRIVE: lower[m:]}


def _is_one(value: Scalar) -> bool:
    return value.literal == 1.0


def _replay(builder: Builder, tape: Tape, inputs: Inputs) -> dict[str, _Found]:
    """Replay a tape, and give its outputs by place."""
    values = replay(tape, builder, {i.name: _nonzeros(i, inputs) for i in tape.inputs})
    replay_guards(tape, builder, values, only_early=True)
    replay_lengths(tape, builder, values)
    return {
        o.name: _Found({place: values[v] for place, v in zip(o.sparsity.entries, o.values, strict=True)})
        for o in tape.outputs
    }


def _nonzeros(given: Input, inputs: Inputs) -> Sequence[Scalar]:
    return inputs[given.name]
