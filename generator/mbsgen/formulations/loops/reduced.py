"""Reduced forms: the equations of motion of the independent coordinates, on closed poses.

    qd = Z yd,    qdd = Z ydd + d,    ZT (Phi(q, qd, qdd) - Q) = M ydd + c = 0
    M = ZT Mt Z,    c = ZT (ct + Mt d - Q)

with Mt, ct of the tree, and Z and d from the equations of its loops (`partition`): J Z = 0, J d + Jd qd = 0, and the
independent entries of d are 0. Multipliers do no work along Z and drop out (Wehage and Haug, 1982; Samin and Fisette,
2003, 4.3). q holds all coordinates, with the loops closed.

Driven joints are independent. Residuals take their forces tau; `exp1_red` takes their accelerations, and gives tau.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from mbsgen.formulations import closure, exp1, multipliers, ports
from mbsgen.formulations.chain import Chain, joint_forces, write_chain
from mbsgen.formulations.coupling import Map
from mbsgen.formulations.loops.partition import Partition
from mbsgen.formulations.loops.unknowns import Column, Unknowns
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.formulations.semi import terms
from mbsgen.formulations.states import State, share_out
from mbsgen.model.tree import Closure, Kind, Tree
from mbsgen.tape import forward
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_paper
from mbsgen.tape.ports import Port
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Input, Sparsity, Tape


def build_residual(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `impl_red`: inputs q, yd, ydd [, tau], u [, w] [, p]; output Phi, shape (f,)."""
    ways = (_write_by_columns, _write_by_multipliers)
    return min((write(tree, reductions) for write in ways), key=count_paper)


def _write_by_columns(tree: Tree, reductions: Reductions) -> Tape:
    """Write the residual by the columns of Z."""
    own = Reduced(tree, reductions, [ports.INDEPENDENT_ACCELERATIONS, ports.DRIVING_FORCES, ports.FORCES])
    return own.finish_residual(own.project(own.residual(own.combine(own.given_accelerations, own.drift))))


def _write_by_multipliers(tree: Tree, reductions: Reductions) -> Tape:
    """Write the residual by the multipliers that leave no residual of the dependent coordinates."""
    given = [ports.INDEPENDENT_ACCELERATIONS, ports.DRIVING_FORCES, ports.FORCES]
    own = Reduced(tree, reductions, given, by_columns=False)
    accelerations = own.given_accelerations
    r = own.residual(accelerations | own.partition.follow(accelerations, own.bias))
    lam = own.partition.solve_transposed(r)
    rows = own.partition.rows
    Phi = []
    for k in own.independent:
        forces = [row[k] * force for row, force in zip(rows, lam, strict=True) if k in row]
        Phi.append(sum((-x for x in forces), start=r[k]))
    return own.finish_residual(Phi)


def build_terms(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `semi_red`: inputs q, yd [, w] [, p]; outputs M, shape (f, f), and c, shape (f,): M ydd + c = ZT Q."""
    own = Reduced(tree, reductions, [])
    M, c = own.project_terms()
    at = range(len(own.independent))
    own.builder.output_dense(ports.REDUCED_MASS_MATRIX, [[M[min(i, j), max(i, j)] for j in at] for i in at])
    own.builder.output_dense(ports.REDUCED_BIAS, [[x] for x in c])
    return finish(own.builder.build("semi_red"), reductions)


def build_accelerations(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `exp1_red`: inputs q, yd, u [, a] [, w] [, p]; outputs ydd, shape (f,) [, tau].

    Fails at the loop whose equations do not determine the dependent velocities, or at the joint whose pivot is lost.
    """
    own = Reduced(tree, reductions, [ports.FORCES, ports.DRIVE])
    M, c = own.project_terms()
    Q = own.project(own.Q)
    net = [force - bias for force, bias in zip(Q, c, strict=True)]
    size = len(net)
    given = dict(zip(own.driven, own.given.get(ports.DRIVE.name, []), strict=True))
    free = [i for i in range(size) if i not in given]

    def inertia(i: int, ydd: Mapping[int, Scalar]) -> list[Scalar]:
        return [M[min(i, k), max(i, k)] * x for k, x in sorted(ydd.items())]

    right = [sum((-x for x in inertia(i, given)), start=net[i]) for i in free]
    A = {(r, s): M[free[r], free[s]] for s in range(len(free)) for r in range(s + 1)}
    system = multipliers.eliminate(own.builder, A, len(free))
    found = system.solve(right)
    for r, i in enumerate(free):
        own.builder.guard(system.pivots[r], A[r, r], len(free) * exp1.PIVOT_TOLERANCE, own.independent[i] + 1)
    ydd = given | {i: found[r] for r, i in enumerate(free)}
    own.builder.output_dense(ports.INDEPENDENT_ACCELERATIONS, [[ydd[i]] for i in range(size)])
    if given:
        own.builder.output_dense(ports.DRIVING_FORCES, [[sum(inertia(i, ydd), start=-net[i])] for i in given])
    return finish(own.builder.build("exp1_red"), reductions)


class Reduced:
    """A tree in a builder, moved by its independent velocities. Columns are by the entries of qd, of unknowns."""

    def __init__(
        self,
        tree: Tree,
        reductions: Reductions,
        more: Sequence[Port],
        *,
        by_columns: bool = True,
        wrenches: bool = True,
    ) -> None:
        """Declare q and yd, the inputs `more`, w, theta and p; by_columns: write velocities by the columns of Z."""
        self.tree, self.reductions, self._by_columns = tree, reductions, by_columns
        self._bodies = tree.uncoupled if wrenches else replace(tree.uncoupled, wrenches=())
        self.builder = Builder(cancel=True)
        self._map, self.given = Map.take(tree, self.builder, list(_list_inputs(tree, more, wrenches=wrenches)))
        found = known_closure(tree)
        self.independent, self.dependent = found.independent, found.dependent
        numbers = [tree.joints.index(tree.bodies[i - 1].joint) for i in tree.driven]
        self.driven = [self.independent.index(k) for k in numbers]  # places among the independent entries

    # -- the motion ---------------------------------------------------------------------------------------------

    @cached_property
    def partition(self) -> Partition:
        """Return the equations of the loops, to solve for dependent entries with."""
        unknowns, tree = self.unknowns, self.tree.uncoupled
        tape = closure.write_jacobian(tree, self._take_absolute() if unknowns.is_absolute else None)
        values = replay(tape, self.builder, {i.name: self.given[i.name] for i in tape.inputs})
        entries = closure.jacobian_entries(tape, values)
        rows: list[Column] = [{} for _ in range(tape.outputs[0].sparsity.rows)]
        for r, row in enumerate(rows):
            own = {c: x for (k, c), x in entries.items() if k == r}
            row |= own if unknowns.is_absolute else unknowns.gather(own)
        multipliers.guard_rows(self.tree, self.builder, self.given)
        return Partition(self.builder, rows, closure.list_statuses(self.tree), self.dependent)

    def _take_absolute(self) -> Callable[[Builder, Sequence[Scalar]], list[Scalar]]:
        """Return how joint velocities follow from the unknowns, in any builder."""
        forms = [{k: x.literal or 0.0 for k, x in form.items()} for form in self.unknowns.velocities]

        def spread(builder: Builder, unknowns: Sequence[Scalar]) -> list[Scalar]:
            terms = ([builder.number(x) * unknowns[k] for k, x in form.items()] for form in forms)
            return [sum(own[1:], start=own[0]) for own in terms]

        return spread

    @cached_property
    def columns(self) -> dict[int, Column]:
        """Return the dependent entries of each column of Z, by the independent entry."""
        one = self.builder.number(1.0)
        return {k: self.partition.follow({k: one}) for k in self.independent}

    @cached_property
    def velocities(self) -> Column:
        """Return the independent velocities and the unknowns."""
        yd = dict(zip(self.independent, self.given[ports.INDEPENDENT_VELOCITIES.name], strict=True))
        return self.combine(yd) if self._by_columns else yd | self.partition.follow(yd)

    @cached_property
    def bias(self) -> list[Scalar]:
        """Return Jd qd, in the way with fewer operations."""
        ways = [self._differentiate_along()]
        if self.unknowns.is_absolute and not self.tree.quaternions:
            ways.append(self._sum_curvatures())
        entries = [x for row in self.partition.rows for x in row.values()]
        return min(ways, key=lambda values: self.builder.cost([*entries, *values]))

    def _sum_curvatures(self) -> list[Scalar]:
        """Sum up the derivatives of J by pairs of unknowns: in planar loops, most of these are 0."""
        tape = closure.write_jacobian(self.tree.uncoupled, self._take_absolute())
        values = replay(tape, self.builder, {i.name: self.given[i.name] for i in tape.inputs})
        gradients = forward.propagate(tape, self.builder, values, [ports.COORDINATES.name])
        first = list(itertools.accumulate((i.sparsity.nnz for i in tape.inputs), initial=0))
        places = {i.name: place for i, place in zip(tape.inputs, first, strict=False)}
        output, v = tape.outputs[0], self.velocities
        total = [self.builder.zero] * output.sparsity.rows
        pairs: dict[tuple[int, int, int], Scalar] = {}
        for (r, k), value in zip(output.sparsity.entries, output.values, strict=True):
            joints = {c - places[ports.COORDINATES.name]: x for c, x in gradients[value].items()}
            for l, x in self.unknowns.gather(joints, self.unknowns.velocities).items():
                pair = (r, min(k, l), max(k, l))
                pairs[pair] = pairs[pair] + x if pair in pairs else x
        for (r, k, l), x in sorted(pairs.items()):
            total[r] = total[r] + x * (v[k] * v[l])
        return total

    def _differentiate_along(self) -> list[Scalar]:
        """Differentiate J qd along the motion."""
        tape = closure.build_accelerations(self.tree.uncoupled)
        zeros = [self.builder.zero] * len(self.tree.bodies)
        given = {**self.given, ports.VELOCITIES.name: self.all_velocities, ports.ACCELERATIONS.name: zeros}
        values = replay(tape, self.builder, {i.name: given[i.name] for i in tape.inputs})
        return [values[v] for v in tape.outputs[0].values]

    @cached_property
    def drift(self) -> Column:
        """Return the dependent accelerations at ydd = 0."""
        return self.partition.solve([-x for x in self.bias])

    @property
    def given_accelerations(self) -> Column:
        """Return ydd."""
        return dict(zip(self.independent, self.given[ports.INDEPENDENT_ACCELERATIONS.name], strict=True))

    def combine(self, y: Mapping[int, Scalar], drift: Mapping[int, Scalar] | None = None) -> Column:
        """Form Z y, plus a drift of the dependent entries."""
        found = dict(y)
        for k in self.dependent:
            parts = [self.columns[i][k] * x for i, x in y.items()] + ([drift[k]] if drift else [])
            found[k] = sum(parts[1:], start=parts[0])
        return found

    @cached_property
    def all_velocities(self) -> list[Scalar]:
        """Return the velocities of all joints."""
        return self.unknowns.spread(self.velocities)

    def select(self, column: Mapping[int, Scalar]) -> list[Scalar]:
        """Return the velocities or accelerations of the joints that follow no other."""
        followers, every = self.tree.followers, self.unknowns.spread(column)
        return [x for i, x in enumerate(every, 1) if i not in followers]

    # -- forces ---------------------------------------------------------------------------------------------------

    @cached_property
    def unknowns(self) -> Unknowns:
        """Return the unknowns of the dependent joints."""
        if self.tree.couplings or not self.reductions.absolute:
            return Unknowns.relative(self._map)
        segments = align(self._write_chain([]), group=self.reductions.share_frames)
        return Unknowns.absolute(self.builder, segments, self.dependent)

    @cached_property
    def chain(self) -> Chain:
        """Return the uncoupled tree in motion."""
        return self._write_chain(self.all_velocities)

    def _write_chain(self, qd: list[Scalar]) -> Chain:
        tree = self._bodies if qd else self._bodies.without_readings
        q, frames = share_out(tree, self.builder, self.given[ports.COORDINATES.name])

        def take(port: Port) -> list[Scalar]:
            return list(self.given.get(port.name, []))

        u, w, theta, p = map(take, (ports.FORCES, ports.WRENCHES, ports.DESIGN, ports.PARAMETERS))
        return write_chain(tree, self.builder, State(q, qd, [], u, w, theta, p, frames=frames))

    @cached_property
    def Q(self) -> Column:
        """Return the forces of the joints, on the unknowns."""
        return self.unknowns.gather(dict(enumerate(joint_forces(self.chain))), self.unknowns.velocities)

    def project(self, forces: Mapping[int, Scalar]) -> list[Scalar]:
        """Form ZT times forces on the entries of qd."""
        return [
            sum((self.columns[k][d] * forces[d] for d in self.dependent), start=forces[k]) for k in self.independent
        ]

    def residual(self, accelerations: Mapping[int, Scalar]) -> Column:
        """Return Phi - Q on the unknowns."""
        chain, unknowns = self.chain, self.unknowns
        plan = find_plans(self.tree.uncoupled, self.reductions).residual
        segments = align(chain, group=self.reductions.share_frames)
        writing = begin(chain, segments, plan, self.reductions)
        qdd = chain.accelerate(unknowns.spread(accelerations))
        Phi = residual(writing, self.all_velocities, qdd, absolute=unknowns.is_absolute)
        return {k: x - self.Q[k] for k, x in unknowns.gather(dict(enumerate(Phi))).items()}

    def project_terms(self) -> tuple[dict[tuple[int, int], Scalar], list[Scalar]]:
        """Return one triangle of M, and c without Q, by places among the independent entries."""
        plans, unknowns = find_plans(self.tree.uncoupled, self.reductions), self.unknowns
        plan = plans.elimination if unknowns.is_absolute else plans.mass_matrix
        state = self.chain.state
        triangle, bias = terms(self.chain, state, plan, self.reductions, absolute=unknowns.is_absolute)
        whole = {(i - 1, j - 1): x for (i, j), x in triangle.items()} | {
            (j - 1, i - 1): x for (i, j), x in triangle.items()
        }
        zero = self.builder.zero
        M = unknowns.gather_matrix(whole)
        c = unknowns.gather(dict(enumerate(bias)))
        images = {k: self._load(M, k) for k in self.independent}  # (M Z) of the dependent entries
        columns, found = self.columns, dict[tuple[int, int], Scalar]()
        for s, k in enumerate(self.independent):
            for r, i in enumerate(self.independent[: s + 1]):
                value = M.get((i, k), zero)
                if r == s:
                    parts = [columns[k][d] * (images[k][d] + M.get((d, k), zero)) for d in self.dependent]
                else:
                    parts = [columns[i][d] * images[k][d] for d in self.dependent]
                    parts += [M.get((i, d), zero) * columns[k][d] for d in self.dependent]
                found[r, s] = sum(parts, start=value)
        projected = self.project(c)
        moved = [
            sum((images[k][d] * self.drift[d] for d in self.dependent), start=c)
            for k, c in zip(self.independent, projected, strict=True)
        ]
        return found, moved

    def _load(self, M: Mapping[tuple[int, int], Scalar], k: int) -> Column:
        zero = self.builder.zero
        return {
            d: sum((M.get((d, e), zero) * self.columns[k][e] for e in self.dependent), start=M.get((d, k), zero))
            for d in self.dependent
        }

    def finish_residual(self, Phi: Sequence[Scalar]) -> Tape:
        """Build the tape of the residual, less the forces of driven joints."""
        tau = dict(zip(self.driven, self.given.get(ports.DRIVING_FORCES.name, []), strict=True))
        zero = self.builder.zero
        self.builder.output_dense(ports.REDUCED_RESIDUAL, [[x - tau.get(i, zero)] for i, x in enumerate(Phi)])
        return finish(self.builder.build("impl_red"), self.reductions)


def known_closure(tree: Tree) -> Closure:
    """Return the closure of an assembled tree."""
    assert tree.closure is not None, f"{tree.name} has loops, and is not assembled"
    return tree.closure


def _list_inputs(tree: Tree, more: Sequence[Port], *, wrenches: bool) -> Iterator[Input]:
    """List the inputs of a reduced form, for the uncoupled tree: q, yd, `more`, w, theta, p."""
    f = len(known_closure(tree).independent)
    sizes = {
        ports.COORDINATES: len(tree.uncoupled.coordinates),
        ports.INDEPENDENT_VELOCITIES: f,
        ports.INDEPENDENT_ACCELERATIONS: f,
        ports.DRIVING_FORCES: len(tree.driven),
        ports.FORCES: sum(body.joint.actuated for body in tree.bodies),
        ports.DRIVE: len(tree.driven),
        ports.WRENCHES: tree.open_entries if wrenches else 0,
        ports.DESIGN: sum(x.kind is Kind.DIFFERENTIATED for x in tree.parameters),
        ports.PARAMETERS: sum(x.kind is Kind.RUNTIME for x in tree.parameters),
    }
    always = (ports.COORDINATES, ports.INDEPENDENT_VELOCITIES)
    if_any = (ports.WRENCHES, ports.DESIGN, ports.PARAMETERS)
    for port in (*always, *more, *if_any):
        if sizes[port] or port in (*always, ports.FORCES, ports.INDEPENDENT_ACCELERATIONS):
            yield Input(port, Sparsity.dense(sizes[port]))
