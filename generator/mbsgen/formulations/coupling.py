"""Joints that follow others, eliminated exactly: tapes of the uncoupled tree -> tapes of the coupled one.

With y the independent coordinates, q = G y + g, qd = G yd and qdd = G ydd. A row of G has one entry, or several where a
joint follows several ones. By
virtual power, forces are GT Q: the residual is GT Phi, the mass matrix GT M G, the bias GT c. G depends on
parameters alone, so derivatives by the state transform likewise: rows as the result, columns as the variable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import TypeGuard

from sympy import Expr, Symbol

from mbsgen.formulations import condition, exp1, exp2, multipliers, ports, semi
from mbsgen.formulations.chain import assign_symbols, joint_forces, write_chain
from mbsgen.formulations.multipliers import Bordered, Equations
from mbsgen.formulations.parsimony.elimination import Factors, factorise
from mbsgen.formulations.parsimony.segments import align, feels_itself, largest_inertias
from mbsgen.formulations.planning import finish
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.states import declare_state
from mbsgen.manifest import FIRST_LENGTH
from mbsgen.model.tree import NO_FORCE, Kind, Parameter, Tree
from mbsgen.roles import Axis, Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.lowering import lower
from mbsgen.tape.passes import keep_results
from mbsgen.tape.ports import Port
from mbsgen.tape.replay import replay, replay_guards, replay_lengths
from mbsgen.tape.types import Input, Op, Tape

Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
_MAPPED = (Axis.COORDINATES, Axis.VELOCITIES)  # the entries that G maps
Build = Callable[[Tree, Reductions], Tape]


def write(build: Build, coupled: Build | None, tree: Tree, reductions: Reductions) -> Tape:
    """Write a function of a tree by a recursion that ignores couplings, or with couplings by `coupled`."""
    if not tree.couplings and (coupled is None or not tree.is_constrained):
        return build(tree, reductions)
    if coupled is not None:
        return coupled(tree, reductions)
    return finish(couple(build(tree.uncoupled, reductions), tree), reductions)


def couple(tape: Tape, tree: Tree) -> Tape:
    """Write a tape of the uncoupled tree for the coupled one: results mapped by G, guards by joint."""
    builder = Builder()
    map, given = Map.take(tree, builder, tape.inputs)
    values = replay(tape, builder, given)
    for o in tape.outputs:
        found = {place: values[v] for place, v in zip(o.sparsity.entries, o.values, strict=True)}
        rows, cols = o.port.rows, o.port.cols
        assert o.port.role is not Role.ACCELERATION, "accelerations of a coupled tree are no projection"
        block = map.gather(found, rows, cols, selected=o.port.role is Role.RATE)  # followers have no separate rate
        shape = map.size(rows, o.sparsity.rows), map.size(cols, o.sparsity.cols)
        if o.sparsity.is_dense:
            builder.output_dense(o.port, [[block[r, c] for c in range(shape[1])] for r in range(shape[0])])
        else:
            builder.output_nonzeros(o.port, *shape, block)
    for guard in tape.guards:
        value = -values[guard.value] if guard.negated else values[guard.value]
        builder.guard(value, values[guard.scale], guard.tolerance, map.joint(guard.joint))
    return builder.build(tape.function)


@dataclass(frozen=True)
class Map:
    """G and g, by the entries of q and of qd: the entries that each follows, with their ratios, and its offset."""

    builder: Builder
    targets: Mapping[Axis, tuple[int, ...]]  # the entry that each one is, or follows first
    ratios: Mapping[Axis, Mapping[int, tuple[tuple[int, Scalar], ...]]]  # of the followers, by the entries they follow
    offsets: Mapping[int, Scalar]

    @staticmethod
    def take(tree: Tree, builder: Builder, inputs: Sequence[Input]) -> tuple[Map, dict[str, list[Scalar]]]:
        """Declare the inputs of the coupled tree; return the map, and these inputs for the uncoupled tree."""
        if all(number.is_number for x in tree.couplings for number in (*(ratio for _, ratio in x.terms), x.offset)):
            map = Map.of(tree, builder, {})
            return map, {i.name: map.expand(i.port, map.declare(i)) for i in inputs}
        unknown = Map.of(tree, builder, None)  # declares inputs, and expands none
        declared = {i.port: unknown.declare(i) for i in inputs}
        for port, kind in ((ports.PARAMETERS, Kind.RUNTIME), (ports.DESIGN, Kind.DIFFERENTIATED)):
            size = sum(x.kind is kind for x in tree.parameters)
            if size and port not in declared:  # the function does not read them, but ratios and offsets may
                declared[port] = builder.vector(port, size)
        p, theta = (declared.get(port, []) for port in (ports.PARAMETERS, ports.DESIGN))
        map = Map.of(tree, builder, assign_symbols(tree, builder, p, theta))
        return map, {port.name: map.expand(port, given) for port, given in declared.items()}

    @staticmethod
    def of(tree: Tree, builder: Builder, symbols: Mapping[Expr, Scalar] | None) -> Map:
        """Make the map for values of the parameters; without any, it has the shapes alone."""

        def write(number: Expr) -> Scalar:
            return builder.zero if symbols is None else lower(number, builder, symbols)

        by_body = {x.follower: x for x in tree.couplings}
        bodies = {Axis.VELOCITIES: list(range(1, len(tree.bodies) + 1)), Axis.COORDINATES: _seat_coordinates(tree)}
        targets, ratios = {}, {}
        for axis, numbers in bodies.items():
            kept = count()
            own = [None if i in by_body else next(kept) for i in numbers]  # a quaternion has several entries
            first = dict(reversed([*zip(numbers, own, strict=True)]))
            targets[axis] = tuple(
                _known(first[by_body[i].leader]) if i in by_body else _known(k)
                for i, k in zip(numbers, own, strict=True)
            )
            ratios[axis] = {
                n: tuple((_known(first[leader]), write(ratio)) for leader, ratio in by_body[i].terms)
                for n, i in enumerate(numbers)
                if i in by_body
            }
        offsets = {n: write(by_body[i].offset) for n, i in enumerate(bodies[Axis.COORDINATES]) if i in by_body}
        return Map(builder, targets, ratios, offsets)

    def joint(self, number: int) -> int:
        """Number the joint, from 1, that a joint of the uncoupled tree is or follows; other statuses stay."""
        if number >= FIRST_LENGTH:
            return number
        return self.targets[Axis.VELOCITIES][number - 1] + 1

    def list_rows(self, tree: Tree) -> list[dict[int, Scalar]]:
        """List the rows J of the couplings: the follower's acceleration less ratios times the leaders' is 0."""
        ratios, one = self.ratios[Axis.VELOCITIES], self.builder.number(1.0)
        return [
            {x.follower - 1: one}
            | {leader - 1: -ratio for (leader, _), (_, ratio) in zip(x.terms, ratios[x.follower - 1], strict=True)}
            for x in tree.couplings
        ]

    def row(self, axis: Axis | None, n: int) -> tuple[tuple[int, Scalar | None], ...]:
        """Return the row n of G: places and ratios, None for 1; an axis that G does not map stays."""
        if not _is_mapped(axis):
            return ((n, None),)
        return self.ratios[axis].get(n) or ((self.targets[axis][n], None),)

    def size(self, axis: Axis | None, otherwise: int) -> int:
        """Count the entries of an axis, in the coupled tree."""
        return max(self.targets[axis]) + 1 if _is_mapped(axis) else otherwise

    def declare(self, given: Input) -> list[Scalar]:
        """Declare an input of the coupled tree."""
        if _is_mapped(given.port.rows):
            return self.builder.vector(given.port, self.size(given.port.rows, 0))
        return self.builder.input(given.port, given.sparsity)

    def expand(self, port: Port, given: Sequence[Scalar]) -> list[Scalar]:
        """Return the entries of the uncoupled tree."""
        axis = port.rows
        if not _is_mapped(axis):
            return list(given)
        rows = (self.row(axis, n) for n in range(len(self.targets[axis])))
        found = [_sum([_scale(given[k], ratio) for k, ratio in row]) for row in rows]
        if port.role is Role.COORDINATE:
            found = [x + self.offsets[n] if n in self.offsets else x for n, x in enumerate(found)]
        return found

    def gather(self, block: Block, rows: Axis | None, cols: Axis | None, *, selected: bool = False) -> Block:
        """Multiply by GT from the left and by G from the right, where G maps the entries of rows and columns."""
        total: Block = {}
        for (r, c), value in block.items():
            if selected and _is_mapped(rows) and r in self.ratios[rows]:
                continue
            for row, along in self.row(rows, r):
                for col, across in self.row(cols, c):
                    scaled = _scale(_scale(value, None if selected else along), across)
                    total[row, col] = total[row, col] + scaled if (row, col) in total else scaled
        return total


def _is_mapped(axis: Axis | None) -> TypeGuard[Axis]:
    return axis in _MAPPED


def _scale(value: Scalar, ratio: Scalar | None) -> Scalar:
    return value if ratio is None else value * ratio


def _sum(terms: Sequence[Scalar]) -> Scalar:
    return sum(terms[1:], start=terms[0])


def _seat_coordinates(tree: Tree) -> list[int]:
    """Return the number of the body of each entry of q of the uncoupled tree."""
    inside = {i: x for x in tree.quaternions for i in x.bodies}
    numbers = []
    for i in range(1, len(tree.bodies) + 1):
        own = inside.get(i)
        numbers += [i] if own is None else [i] * len(own.coordinates) if own.first == i else []
    return numbers


def _known(place: int | None) -> int:
    assert place is not None, "what is followed has a coordinate"
    return place


# -- accelerations ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Coupled:
    """The inputs of an acceleration, and the quantities of the uncoupled tree computed from them."""

    tree: Tree
    reductions: Reductions
    map: Map
    given: Mapping[str, Sequence[Scalar]]  # of the uncoupled tree
    drive: Mapping[str, Block]  # joint forces Q, the numbers of wrenches and gravity, the largest inertias
    firm: frozenset[int]  # the joints of the uncoupled tree whose own bodies have inertia about their axes

    @staticmethod
    def declare(tree: Tree, reductions: Reductions) -> _Coupled:
        drive, firm = _write_drive(tree.uncoupled)
        map, given = Map.take(tree, Builder(), drive.inputs)
        return _Coupled(tree, reductions, map, given, _results(drive, map.builder, given), firm)

    @property
    def size(self) -> int:
        return self.map.size(Axis.VELOCITIES, 0)

    def column(self, name: str) -> list[Scalar]:
        """Return the entries of a quantity that drives the uncoupled tree."""
        return [value for _, value in sorted(self.drive.get(name, {}).items())]

    def weigh(self, number: int, inertia: Scalar) -> tuple[tuple[int, Scalar], ...]:
        """Return the inertia of a joint as felt by the joints that it follows, from 1, or by itself."""
        return tuple(
            (joint + 1, inertia if ratio is None else inertia * ratio * ratio)
            for joint, ratio in self.map.row(Axis.VELOCITIES, number - 1)
        )

    @property
    def scales(self) -> dict[int, Scalar]:
        """Bound the inertia that each joint can feel, including its followers."""
        total: dict[int, Scalar] = {}
        for number, inertia in enumerate(self.column("largest"), 1):
            for joint, felt in self.weigh(number, inertia):
                total[joint] = total[joint] + felt if joint in total else felt
        return total

    @cached_property
    def equations(self) -> Equations:
        """Return the equations of loops, constraints and driven joints, of the uncoupled tree."""
        if not self.tree.is_constrained:
            return Equations((), ())
        return multipliers.write_equations(self.tree.uncoupled, self.map.builder, self.given)

    def finish(self, name: str, qdd: Sequence[Scalar], found: Sequence[Scalar] = ()) -> Tape:
        """Build the tape of accelerations, and of the multipliers of a tree with constraints."""
        self.map.builder.output_dense(ports.ACCELERATIONS, [[x] for x in qdd])
        multipliers.output(self.map.builder, self.tree, found)
        return finish(self.map.builder.build(name), self.reductions)


def write_exp1(tree: Tree, reductions: Reductions) -> Tape:
    """Write `exp1`: GT M G ydd = GT (Q - c - M g''), where g'' is 0, by elimination in GT M G."""
    own = _Coupled.declare(tree, reductions)
    map, builder = own.map, own.map.builder
    terms = _results(semi.build(tree.uncoupled, reductions), builder, own.given)
    M = map.gather(terms["M"], Axis.VELOCITIES, Axis.VELOCITIES)
    upper = {(i + 1, j + 1): value for (i, j), value in M.items() if i <= j and not value.is_zero}
    net = {place: own.drive["Q"][place] - bias for place, bias in terms["c"].items()}
    b = {i + 1: value for (i, _), value in map.gather(net, Axis.VELOCITIES, None).items()}
    factors = factorise(builder, upper, own.size)
    alone = {i for i in own.firm if len(map.row(Axis.VELOCITIES, i - 1)) == 1}  # a sum of joints may stay at rest
    scales, firm = own.scales, {map.joint(i) for i in alone}
    for i in range(own.size, 0, -1):
        if i in firm:
            builder.guard(factors.D[i], upper[i, i], own.size * exp1.PIVOT_TOLERANCE, i)
        else:
            builder.guard(factors.D[i], scales[i], exp1.LOCKING_TOLERANCE, i)
    equations = own.equations
    rows = [map.gather({(0, i): value for i, value in row.items()}, None, Axis.VELOCITIES) for row in equations.rows]
    system = Bordered.of(factors, [{i + 1: value for (_, i), value in row.items()} for row in rows])
    multipliers.guard(builder, multipliers.list_owners(tree), system.A, system.reduced.pivots)
    multipliers.guard_rows(tree, builder, own.given)
    x, found = system.solve(b, equations.right)
    return own.finish("exp1", [x[i] for i in range(1, own.size + 1)], found)


def write_exp2(tree: Tree, reductions: Reductions) -> Tape:
    """Write `exp2`: articulated bodies of the uncoupled tree, and the forces that keep the couplings.

    A coupling has the row J: q'' less ratio times the leader's q'' is 0. The accelerations are a + sum of B lambda,
    with a the accelerations of the uncoupled tree and B = M^-1 JT the accelerations for a unit of each coupling's
    force. The forces solve J B lambda = -J a. Forces of followers act in the joints that they follow, so that a light
    follower is not thrown far.
    """
    own = _Coupled.declare(tree, reductions)
    map, builder = own.map, own.map.builder
    tape = exp2.build(_open(tree.uncoupled), reductions)
    forces = map.gather(own.drive["Q"], Axis.VELOCITIES, None)
    followers = map.ratios[Axis.VELOCITIES]
    n = len(tree.bodies)
    moved = [builder.zero if i in followers else forces[map.targets[Axis.VELOCITIES][i], 0] for i in range(n)]
    a, values = _accelerate(own, tape, own.given["qd"], moved, still=False)
    couplings, equations = map.list_rows(tree), own.equations
    rows = [*couplings, *equations.rows]
    rest = [builder.zero] * n
    B = [_accelerate(own, tape, rest, [row.get(i, builder.zero) for i in range(n)], still=True)[0] for row in rows]
    JB = {(k, l): multipliers.along(rows[k], B[l], builder.zero) for l in range(len(B)) for k in range(l + 1)}
    right = [-multipliers.along(row, a, builder.zero) for row in couplings]
    right += [
        b - multipliers.along(row, a, builder.zero) for b, row in zip(equations.right, equations.rows, strict=True)
    ]
    first = len(couplings)
    if equations.size:
        system = multipliers.eliminate(builder, JB, len(B))
        found, pivots = system.solve(right), system.pivots
    else:
        factors = factorise(builder, {(k + 1, l + 1): value for (k, l), value in JB.items()}, len(B))
        solved = factors.solve(dict(enumerate(right, 1)))
        found, pivots = [solved[k + 1] for k in range(len(B))], {k: factors.D[k + 1] for k in range(len(B))}
    _guard_couplings(own, tape, values, {k + 1: pivots[k] / JB[k, k] for k in range(first)})
    numbers = range(equations.size)
    own_A = {(k, k): JB[first + k, first + k] for k in numbers}
    multipliers.guard(builder, multipliers.list_owners(tree), own_A, {k: pivots[first + k] for k in numbers})
    multipliers.guard_rows(tree, builder, own.given)
    qdd = []
    for i in (i for i in range(n) if i not in followers):
        qdd.append(sum((column[i] * found[k] for k, column in enumerate(B)), start=a[i]))
    return own.finish("exp2", qdd, found[first:])


def write_guards(tree: Tree) -> Tape:
    """Write the guards of rows of J that may vanish as a whole: inputs q [, p], no result."""
    plain, builder = multipliers.write_guards(tree), Builder()
    _, given = Map.take(tree, builder, plain.inputs)
    values = replay(plain, builder, given)
    replay_guards(plain, builder, values)
    return builder.build(plain.function)


def write_unrestrained(name: str, tree: Tree, reductions: Reductions) -> Tape:
    """Write `exp1` or `exp2` of a tree without its loops, constraints and drives: it has the same guards of joints."""
    free = replace(tree, loops=(), constraints=(), driven=(), closure=None)
    return {"exp1": write_exp1, "exp2": write_exp2}[name](free, reductions)


def write_condition(tree: Tree, reductions: Reductions) -> Tape:
    """Write `condition`: the same quantities as for an uncoupled tree, with the cancellations that couplings add.

    EXP1 eliminates in Mr = GT M G, so `elimination` is Mr_ii (Mr^-1)_ii. EXP2 corrects the accelerations a of the
    uncoupled tree, whose roundings remain. The motion y'' = e_i takes the forces Mr e_i in the leaders, hence
    a = M^-1 E Mr e_i, where E places independent coordinates among all. Row i of `articulated` is the sum over the
    joints j of |a_j| times `articulated` of the uncoupled tree, in units of sqrt(Mr_ii / M_jj). The sum over couplings
    of A_kk (A^-1)_kk, with A = J M^-1 JT, multiplies it: the forces of couplings are solved for by elimination.
    """
    builder = Builder()
    plain = condition.build(tree.uncoupled, reductions)
    map, given = Map.take(tree, builder, plain.inputs)
    lost = _results(plain, builder, given)["articulated"]
    inertia = keep_results(semi.build(replace(tree.uncoupled, wrenches=()), reductions), {ports.MASS_MATRIX.name})
    unread = {i.name: [builder.zero] * i.sparsity.nnz for i in inertia.inputs}
    M = _results(inertia, builder, unread | given)[ports.MASS_MATRIX.name]
    Mr = map.gather(M, Axis.VELOCITIES, Axis.VELOCITIES)
    n, size = len(tree.bodies), map.size(Axis.VELOCITIES, 0)
    whole, reduced = _factorise(builder, M, n), _factorise(builder, Mr, size)
    inverse = reduced.invert(range(1, size + 1))
    leaders = {map.targets[Axis.VELOCITIES][j]: j for j in range(n) if j not in map.ratios[Axis.VELOCITIES]}
    spread = _measure_couplings(tree, map, whole)
    rows = []
    for i in range(size):
        a = whole.solve({leaders[k] + 1: Mr[k, i] for k in range(size) if (k, i) in Mr})
        thrown = [_size(a[j + 1]) * builder.apply(Op.SQRT, M[j, j] / Mr[i, i]) for j in range(n)]
        own = [lost[j, 0] for j in range(n) if any(k == i for k, _ in map.row(Axis.VELOCITIES, j))]
        rows.append([sum(own, start=spread * sum(thrown[1:], start=thrown[0]))])
    eliminated = [[_size(Mr[i, i] * inverse[i + 1][i + 1])] for i in range(size)]
    builder.output_dense(plain.output("elimination").port, eliminated)
    builder.output_dense(plain.output("articulated").port, rows)
    return builder.build(plain.function)


def _measure_couplings(tree: Tree, map: Map, whole: Factors) -> Scalar:
    """Return the sum over couplings of A_kk (A^-1)_kk, with A = J M^-1 JT; 1 for a single coupling."""
    rows = map.list_rows(tree)
    B = [whole.solve({i + 1: value for i, value in row.items()}) for row in rows]
    columns = [[x[i] for i in range(1, whole.size + 1)] for x in B]
    A = {(k + 1, l + 1): _along(rows[k], columns[l]) for l in range(len(B)) for k in range(l + 1)}
    inverse = factorise(whole.builder, A, len(B)).invert(range(1, len(B) + 1))
    terms = [_size(A[k, k] * inverse[k][k]) for k in range(1, len(B) + 1)]
    return sum(terms[1:], start=terms[0])


def _factorise(builder: Builder, M: Block, size: int) -> Factors:
    return factorise(builder, {(i + 1, j + 1): x for (i, j), x in M.items() if i <= j and not x.is_zero}, size)


def _size(x: Scalar) -> Scalar:
    return x if x.is_zero else x.builder.apply(Op.ABS, x)


def _accelerate(
    own: _Coupled, tape: Tape, qd: Sequence[Scalar], forces: Sequence[Scalar], *, still: bool
) -> tuple[list[Scalar], list[Scalar]]:
    """Compute accelerations of the uncoupled tree, and all values; `still`: without gravity and wrenches."""
    zero = own.map.builder.zero
    w, gravity = ([zero] * len(own.column(name)) if still else own.column(name) for name in ("w", "gravity"))
    given = {**own.given, "qd": qd, "u": forces, "w": w, "p": [*own.given.get("p", ()), *gravity]}
    values = replay(tape, own.map.builder, {i.name: given[i.name] for i in tape.inputs})
    return [values[v] for v in tape.output("qdd").values], values


def _guard_couplings(own: _Coupled, tape: Tape, values: Sequence[Scalar], lost: Mapping[int, Scalar]) -> None:
    """Guard the pivots of the uncoupled tree, and the remainder of each coupling's row after the rows before it."""
    builder = own.map.builder
    for guard in tape.guards:
        pivot = -values[guard.value] if guard.negated else values[guard.value]
        scale = values[guard.scale]
        if tape.is_pivot(guard):
            ((_, pivot), *_), ((_, scale), *_) = own.weigh(guard.joint, pivot), own.weigh(guard.joint, scale)
        builder.guard(pivot, scale, guard.tolerance, own.map.joint(guard.joint))
    scales = own.scales
    for k, part in lost.items():
        joint = own.map.joint(own.tree.couplings[k - 1].leader)
        builder.guard(part * scales[joint], scales[joint], exp2.LOCKING_TOLERANCE, joint)


def _open(tree: Tree) -> Tree:
    """Turn gravity, wrenches and the forces of all joints into inputs; the lengths of forces are guarded with these."""
    gravity = [
        Parameter(f"gravity {axis}", Symbol(f"gravity {axis}"), 0.0, Kind.RUNTIME) if number != 0 else None
        for axis, number in zip("xyz", tree.gravity, strict=True)
    ]
    x, y, z = (number if p is None else p.symbol for p, number in zip(gravity, tree.gravity, strict=True))
    joints = (replace(body.joint, actuated=True, law=NO_FORCE) for body in tree.bodies)
    return replace(
        tree,
        gravity=(x, y, z),
        parameters=(*tree.parameters, *(p for p in gravity if p)),
        bodies=tuple(replace(body, joint=joint) for body, joint in zip(tree.bodies, joints, strict=True)),
        wrenches=tuple(replace(wrench, force=None, moment=None) for wrench in tree.wrenches),
        definitions=(),
        probes=(),
        signals=(),
    )


def _write_drive(tree: Tree) -> tuple[Tape, frozenset[int]]:
    """Write the quantities that drive an uncoupled tree: Q of all joints, components of wrenches, nonzero gravity.

    Added are the largest inertias that joints can feel, from parameters alone. Also return the joints that cannot lock.
    """
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, drive=True)
    chain = write_chain(tree, builder, state)
    own = iter(state.w)
    wrenches = [
        x
        for wrench in tree.wrenches
        for v in (wrench.force, wrench.moment)
        for x in ([next(own) for _ in "xyz"] if v is None else chain.components(v))
    ]
    gravity = [chain.scalar(number) for number in tree.gravity if number != 0]
    segments = align(chain, group=False)
    felt = largest_inertias(chain, segments)
    largest = [felt[i] for i in range(1, len(tree.bodies) + 1)]
    for name, column in (("Q", joint_forces(chain)), ("w", wrenches), ("gravity", gravity), ("largest", largest)):
        if column:
            builder.output_dense(name, [[x] for x in column])
    return builder.build("drive"), frozenset(s.number for s in segments if feels_itself(s))


def _along(row: Mapping[int, Scalar], column: Sequence[Scalar]) -> Scalar:
    return _sum([x * column[i] for i, x in row.items()])


def _results(tape: Tape, builder: Builder, given: Mapping[str, Sequence[Scalar]]) -> dict[str, Block]:
    """Replay a tape; return its results by position."""
    values = replay(tape, builder, {i.name: given[i.name] for i in tape.inputs})
    replay_lengths(tape, builder, values)
    return {
        o.name: {place: values[v] for place, v in zip(o.sparsity.entries, o.values, strict=True)} for o in tape.outputs
    }
