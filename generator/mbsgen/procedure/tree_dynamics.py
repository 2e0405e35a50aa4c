"""The stages of a large tree's dynamics: recursions over its joints as loops over tables, so that code grows with n.

Spatial vectors are in the axes of the base, and about the joint point of their body. With S the unit motion of joint
i, V and A the velocity and acceleration (less gravity) of its parent there, and sums over all that i carries of the
inertia I, of F = I A + V x* I V, and of D (Wensing, Echeandia, 2020),

    V_S = V x S,    A_S = A x S + V x V_S,    D = -2 |C   0|    C = w~ P + h~ v~,    P, h: second and first moments
                                                     |p~  0|    p: momentum

and for a body i and each body j that carries it, or is it (Singh, Russell, Wensing, 2022),

    M_ij       = S_j . I S_i
    dPhi_i/dq_j  = V_S_j . DT S_i + A_S_j . I S_i       dPhi_j/dq_i  = S_j . (D V_S_i + I A_S_i + S_i x* F_i)
    dPhi_i/dqd_j = S_j . DT S_i + 2 V_S_j . I S_i       dPhi_j/dqd_i = S_j . (D S_i + 2 I V_S_i)

With B = dPhi/dx at the accelerations qdd = -M^-1 Phi(0), dqdd/dx = -M^-1 B, and its adjoints are BT mu with mu = -M^-1
times the seeds. `csrc/mbs_dynamics.h` solves with M by articulated bodies (Featherstone, 1983), in O(n) for a column.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.errors import TapeError
from mbsgen.procedure import patterns
from mbsgen.procedure.patterns import LANES
from mbsgen.procedure.solve import Block
from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, Values
from mbsgen.procedure.wires import Wire
from mbsgen.tape.counts import Counts
from mbsgen.tape.interpreter import find_threshold
from mbsgen.tape.types import LITERALS, Op

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes

PLACEMENT, MOMENTS = 12, 10  # numbers of a body: R by rows, joint point; m, h, P: xx yy zz xy xz yz
# Operations for a body, for a body with one that carries it, and for a column at a body, as the C has them.
_OF_BODY = {Op.MUL: 700, Op.ADD: 650}
_OF_PAIR = {Op.MUL: 60, Op.ADD: 54}
_OF_COLUMN = {Op.MUL: 31, Op.ADD: 36}
_OF_COMPOSITE, _OF_ENTRY = {Op.MUL: 126, Op.ADD: 115}, {Op.MUL: 9, Op.ADD: 8}  # of M alone: for a body, for a pair

T = TypeVar("T")


@dataclass(frozen=True)
class Added:
    """Further nonzeros of the right-hand sides, in a block of columns."""

    wire: Wire
    first: int

    def places(self, width: int) -> Iterator[int]:
        """Yield where each nonzero is added in B, by rows."""
        return (r * width + self.first + c for r, c in self.wire.sparsity.entries)


@dataclass(frozen=True)
class TreeDynamics(Stage):
    """The accelerations qdd with their derivatives, or the residual Phi with its own.

    With `seeds`, adjoints take the place of derivatives.
    """

    name: str
    parents: tuple[int, ...]  # of each body, from 1; 0: the base
    joints: tuple[int, ...]  # the axis of a turn; of a slide, 3 more
    owned: tuple[bool, ...]  # whether a pivot is compared with its entry of M, else with its scale
    tolerances: tuple[float, float]  # of owned pivots, and of others
    placements: Wire
    moments: Wire
    gravity: Wire
    rates: Wire
    rest: Wire  # Phi of the tree without mass, at the given accelerations or at 0
    rotors: Wire  # added to the diagonal of M
    scales: Wire
    added: tuple[Added, ...]
    width: int  # columns of B: by q, by qd, by qdd where it is given, then others
    value: Wire  # qdd, or Phi where accelerations are given
    results: tuple[Block, ...]  # columns of -M^-1 B, or of B where accelerations are given
    accelerations: Wire | None = None  # at which Phi is computed
    seeds: Wire | None = None

    def __post_init__(self) -> None:
        n = self.size
        if any(not 0 <= parent <= k for k, parent in enumerate(self.parents)):
            raise TapeError(f"{self.name}: a body does not follow its parent")
        if not 2 * n <= max(block.last(1 if self.seeds else n) for block in self.results) <= self.width:
            raise TapeError(f"{self.name}: {self.width} columns do not hold the derivatives by q, qd and more")

    @property
    def size(self) -> int:
        """Count the joints."""
        return len(self.parents)

    @cached_property
    def pattern(self) -> patterns.Tree:
        """The pattern of M."""
        rows: list[tuple[int, ...]] = []
        for parent in self.parents:
            rows.append((*rows[parent - 1], parent - 1) if parent else ())
        return patterns.Tree(tuple(rows))

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List all wires of the bodies, the added blocks, the accelerations and the seeds."""
        own = (self.placements, self.moments, self.gravity, self.rates, self.rest, self.rotors, self.scales)
        more = (wire for wire in (self.accelerations, self.seeds) if wire)
        return (*own, *(x.wire for x in self.added), *more)

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the value and the results."""
        return (self.value, *(block.result for block in self.results))

    @property
    def can_fail(self) -> bool:
        """Return whether a pivot may be lost."""
        return self.accelerations is None

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Compute by the factors of M, where the C frees one joint after the other: pivots are the same."""
        zero = arithmetic.numbers.literal(LITERALS.mpf(0))
        n, bodies = self.size, self._place(given, zero)
        M = [[zero] * n for _ in range(n)]
        units = [body.inertia.apply(body.S) for body in bodies[1:]]
        points = [body.r for body in bodies]
        for i, j, unit in _list_pairs(self.parents, units, points):
            M[i][j] = M[j][i] = bodies[j + 1].S.dot(unit)
        if self.accelerations:
            self._accelerate(bodies, given[self.accelerations.name])
            rows = self._differentiate(bodies, given, M)
            found = {b.result.name: [rows[r][c] for r, c in b.entries(n)] for b in self.results}
            return Outcome(0, {self.value.name: self._balance(bodies, given), **found})
        for i, rotor in enumerate(given[self.rotors.name]):
            M[i][i] = M[i][i] + rotor
        factors, _ = self.pattern.factorise(M, -1)
        if arithmetic.tested and (status := self._test(M, factors[1], given, arithmetic)):
            return Outcome(status, {})
        felt = [[x] for x in self._balance(bodies, given)]
        self.pattern.solve(factors, felt)
        qdd = [-x for (x,) in felt]
        self._accelerate(bodies, qdd)
        rows = self._differentiate(bodies, given)
        if self.seeds:
            weights = [[-x] for x in given[self.seeds.name]]
            self.pattern.solve(factors, weights)
            sums = [
                sum((w * x for (w,), x in zip(weights, column, strict=True)), zero)
                for column in zip(*rows, strict=True)
            ]
            found = {b.result.name: sums[b.first : b.last(1)] for b in self.results}
        else:
            self.pattern.solve(factors, rows)
            found = {b.result.name: [-rows[r][c] for r, c in b.entries(n)] for b in self.results}
        return Outcome(0, {self.value.name: qdd, **found})

    def _balance(self, bodies: Sequence[_Body], given: Values) -> list[Any]:
        """Return Phi of the bodies' motion."""
        return [x + body.S.dot(body.F) for x, body in zip(given[self.rest.name], bodies[1:], strict=True)]

    def _test(self, M: patterns.Rows, inverses: Sequence[Any], given: Values, arithmetic: Arithmetic) -> int:
        own, other = (find_threshold(x, arithmetic.numbers) for x in self.tolerances)
        for i in reversed(range(self.size)):
            least = own * M[i][i] if self.owned[i] else other * given[self.scales.name][i]
            if not 1 / inverses[i] > least:
                return i + 1
        return 0

    def _place(self, given: Values, zero: Any) -> list[_Body]:
        """Return the base and the bodies, with the sums of all that each one carries, at qdd = 0."""
        null = Vector(zero, zero, zero)
        one = zero + 1
        x, y, z = given[self.gravity.name]
        still = _Pair(null, null)
        E = Matrix.of([[one, zero, zero], [zero, one, zero], [zero, zero, one]])
        none = Matrix((null, null, null))
        I = _Moments(zero, null, none)
        bodies = [_Body(E, null, still, still, _Pair(null, Vector(-x, -y, -z)), still, I, I, null, none, still)]
        numbers = zip(
            self.parents,
            self.joints,
            _chunk(given[self.placements.name], PLACEMENT),
            _chunk(given[self.moments.name], MOMENTS),
            given[self.rates.name],
            strict=True,
        )
        for parent, joint, placement, moments, rate in numbers:
            bodies.append(_place(bodies[parent], joint, placement, moments, rate))
        for i in reversed(range(1, self.size + 1)):
            if self.parents[i - 1]:
                bodies[self.parents[i - 1]].carry(bodies[i])
        return bodies

    def _accelerate(self, bodies: Sequence[_Body], qdd: Sequence[Any]) -> None:
        more = [bodies[0].S]
        for body, parent, x in zip(bodies[1:], self.parents, qdd, strict=True):
            more.append(more[parent].carried(body.r) + body.S.scale(x))
            body.A = body.A + more[-1]
        forces = [body.own.apply(x) for body, x in zip(bodies, more, strict=True)]
        for i in reversed(range(1, self.size + 1)):
            bodies[i].F = bodies[i].F + forces[i]
            forces[self.parents[i - 1]] = forces[self.parents[i - 1]] + forces[i].taken(bodies[i].r)

    def _differentiate(self, bodies: Sequence[_Body], given: Values, M: patterns.Rows | None = None) -> patterns.Rows:
        """Return B by rows; M is a block of it where accelerations are given."""
        n = self.size
        zero = bodies[0].inertia.m
        B = [[zero] * self.width for _ in range(n)]
        for row, own in zip(B, M or (), strict=False):
            row[2 * n : 3 * n] = own
        A_S = [bodies[0].S]
        for body, parent in zip(bodies[1:], self.parents, strict=True):
            A, V = (x.carried(body.r) for x in (bodies[parent].A, bodies[parent].V))
            A_S.append(A.bracket(body.S) + V.bracket(body.V_S))
        units = [body.inertia.apply(body.S) for body in bodies[1:]]
        turned = [body.turn_back() for body in bodies[1:]]
        points = [body.r for body in bodies]
        for i, j, unit in _list_pairs(self.parents, units, points):
            S, V_S = bodies[j + 1].S, bodies[j + 1].V_S
            B[i][j] = turned[i].dot(V_S.one) + A_S[j + 1].dot(unit)
            B[i][n + j] = turned[i].dot(S.one) + 2 * V_S.dot(unit)
        by_q, by_qd = [], []
        for body, a in zip(bodies[1:], A_S[1:], strict=True):
            by_q.append(body.gyrate(body.V_S) + body.inertia.apply(a) + body.S.turn(body.F))
            by_qd.append(body.gyrate(body.S) + body.inertia.apply(body.V_S.scale(2)))
        for first, forces in ((0, by_q), (n, by_qd)):
            for i, j, force in _list_pairs(self.parents, forces, points):
                B[j][first + i] = bodies[j + 1].S.dot(force)
        for block in self.added:
            for (r, c), value in zip(block.wire.sparsity.entries, given[block.wire.name], strict=True):
                B[r][block.first + c] = B[r][block.first + c] + value
        return B

    def count(self) -> Counts:
        """Count as the C computes: for bodies, for pairs of bodies, and for the columns at bodies."""
        n, pairs = self.size, self.pattern.starts[-1] + self.size
        solved = LANES // 2 + (LANES // 2 if self.seeds else self.width)  # first the accelerations
        columns = 0 if self.accelerations else solved
        total = {op: n * (own + columns * _OF_COLUMN[op]) + pairs * _OF_PAIR[op] for op, own in _OF_BODY.items()}
        total[Op.ADD] += sum(x.wire.sparsity.nnz for x in self.added)
        if self.seeds:
            entries = n * sum(block.result.sparsity.nnz for block in self.results)
            total = {op: number + entries for op, number in total.items()}
        return Counts(total, 0, n)

    def push(self, slopes: Slopes) -> Sequence[Stage]:  # noqa: ARG002  # there are none
        """Refuse: second derivatives are written straight."""
        raise TapeError(f"{self.name} has no derivatives")

    def pull(self, adjoints: Adjoints) -> Pulled:  # noqa: ARG002  # likewise
        """Refuse: second derivatives are written straight."""
        raise TapeError(f"{self.name} has no derivatives")


@dataclass(frozen=True)
class TreeMatrix(Stage):
    """M, by composite bodies."""

    name: str
    parents: tuple[int, ...]  # of each body, from 1; 0: the base
    joints: tuple[int, ...]  # the axis of a turn; of a slide, 3 more
    placements: Wire
    moments: Wire
    rotors: Wire  # added to the diagonal
    matrix: Wire  # in full

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List the wires of the bodies."""
        return (self.placements, self.moments, self.rotors)

    @property
    def gives(self) -> tuple[Wire, ...]:
        """Return M."""
        return (self.matrix,)

    @property
    def can_fail(self) -> bool:
        """Return False: nothing is divided."""
        return False

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Compute as the C does."""
        zero = arithmetic.numbers.literal(LITERALS.mpf(0))
        null, one = Vector(zero, zero, zero), zero + 1
        rotations, points = [Matrix.of([[one, zero, zero], [zero, one, zero], [zero, zero, one]])], [null]
        motions, inertias = [_Pair(null, null)], [_Moments(zero, null, Matrix((null, null, null)))]
        placements = _chunk(given[self.placements.name], PLACEMENT)
        moments = _chunk(given[self.moments.name], MOMENTS)
        for parent, joint, placement, own in zip(self.parents, self.joints, placements, moments, strict=True):
            E = rotations[parent].times(Matrix.of(_chunk(placement[:9], 3)))
            points.append(rotations[parent].apply(Vector.of(placement[9:])))
            rotations.append(E)
            motions.append(_move(E, joint))
            inertias.append(_turn(E, own))
        for i in reversed(range(1, len(inertias))):
            if self.parents[i - 1]:
                inertias[self.parents[i - 1]] = inertias[self.parents[i - 1]].joined(inertias[i], points[i])
        M = dict.fromkeys(self.matrix.sparsity.entries, zero)
        units = [inertia.apply(motion) for inertia, motion in zip(inertias[1:], motions[1:], strict=True)]
        for i, j, unit in _list_pairs(self.parents, units, points):
            M[i, j] = M[j, i] = motions[j + 1].dot(unit)
        for i, rotor in enumerate(given[self.rotors.name]):
            M[i, i] = M[i, i] + rotor
        return Outcome(0, {self.matrix.name: [M[entry] for entry in self.matrix.sparsity.entries]})

    def count(self) -> Counts:
        """Count as the C computes: for bodies, and for pairs of them."""
        n, pairs = len(self.parents), count_pairs(self.parents)
        return Counts({op: n * own + pairs * _OF_ENTRY[op] for op, own in _OF_COMPOSITE.items()}, 0, 0)

    def push(self, slopes: Slopes) -> Sequence[Stage]:  # noqa: ARG002  # there are none
        """Refuse: M has no derivatives."""
        raise TapeError(f"{self.name} has no derivatives")

    def pull(self, adjoints: Adjoints) -> Pulled:  # noqa: ARG002  # likewise
        """Refuse: M has no derivatives."""
        raise TapeError(f"{self.name} has no derivatives")


@dataclass(frozen=True, slots=True)
class _Pair:
    """A motion (angular, linear), or a force (moment, force)."""

    one: Vector[Any]
    two: Vector[Any]

    def __add__(self, other: _Pair) -> _Pair:
        return _Pair(self.one + other.one, self.two + other.two)

    def scale(self, factor: Any) -> _Pair:
        return _Pair(self.one.scale(factor), self.two.scale(factor))

    def dot(self, other: _Pair) -> Any:
        return self.one.dot(other.one) + self.two.dot(other.two)

    def carried(self, r: Vector[Any]) -> _Pair:
        """Return a motion about a point at r."""
        return _Pair(self.one, self.two + self.one.cross(r))

    def taken(self, r: Vector[Any]) -> _Pair:
        """Return a force, known about a point at r, about the point that r leads from."""
        return _Pair(self.one + r.cross(self.two), self.two)

    def bracket(self, other: _Pair) -> _Pair:
        """Return V x X of two motions."""
        return _Pair(self.one.cross(other.one), self.one.cross(other.two) + self.two.cross(other.one))

    def turn(self, force: _Pair) -> _Pair:
        """Return V x* F."""
        return _Pair(self.one.cross(force.one) + self.two.cross(force.two), self.one.cross(force.two))


@dataclass(frozen=True, slots=True)
class _Moments:
    """Mass, and first and second moments."""

    m: Any
    h: Vector[Any]
    P: Matrix[Any]

    def apply(self, motion: _Pair) -> _Pair:
        """Return the momentum of a motion."""
        w, v, P = motion.one, motion.two, self.P
        turning = w.scale(P[0, 0] + P[1, 1] + P[2, 2]) - P.apply(w)
        return _Pair(turning + self.h.cross(v), v.scale(self.m) + w.cross(self.h))

    def joined(self, other: _Moments, r: Vector[Any]) -> _Moments:
        """Add moments that are known about a point at r."""
        h = other.h + r.scale(other.m)
        return _Moments(self.m + other.m, self.h + h, self.P + other.P + outer(other.h, r) + outer(r, h))


@dataclass
class _Body:
    """A body; the last four are summed over all that it carries."""

    E: Matrix[Any]
    r: Vector[Any]
    S: _Pair
    V: _Pair
    A: _Pair
    V_S: _Pair
    own: _Moments
    inertia: _Moments
    p: Vector[Any]
    C: Matrix[Any]
    F: _Pair

    def carry(self, other: _Body) -> None:
        """Add the sums of a body that this one carries."""
        r = other.r
        self.inertia = self.inertia.joined(other.inertia, r)
        self.p = self.p + other.p
        self.C = self.C + other.C + _skew_product(r, other.p)
        self.F = self.F + other.F.taken(r)

    def gyrate(self, motion: _Pair) -> _Pair:
        """Return D X."""
        w = motion.one.scale(-2)
        return _Pair(self.C.apply(w), self.p.cross(w))

    def turn_back(self) -> Vector[Any]:
        """Return the angular part of DT S; the other one vanishes."""
        return (self.p.cross(self.S.two) - self.C.transposed.apply(self.S.one)).scale(2)


def _place(parent: _Body, joint: int, placement: Sequence[Any], moments: Sequence[Any], rate: Any) -> _Body:
    E = parent.E.times(Matrix.of(_chunk(placement[:9], 3)))
    r = parent.E.apply(Vector.of(placement[9:]))
    S = _move(E, joint)
    V = parent.V.carried(r)
    V_S = V.bracket(S)
    V, A = V + S.scale(rate), parent.A.carried(r) + V_S.scale(rate)
    inertia = _turn(E, moments)
    momentum = inertia.apply(V)
    C = _skew(V.one).times(inertia.P) + _skew_product(inertia.h, V.two)
    return _Body(E, r, S, V, A, V_S, inertia, inertia, momentum.two, C, inertia.apply(A) + V.turn(momentum))


def _move(E: Matrix[Any], joint: int) -> _Pair:
    """Return the unit motion of a joint; `joint` is its axis, and 3 more where it slides."""
    axis = E.column(joint % 3)
    null = axis - axis
    return _Pair(axis, null) if joint < 3 else _Pair(null, axis)


def _turn(E: Matrix[Any], moments: Sequence[Any]) -> _Moments:
    """Return the moments of a body in the axes of the base."""
    xx, yy, zz, xy, xz, yz = moments[4:]
    P = E.times(Matrix.of([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])).times(E.transposed)
    return _Moments(moments[0], E.apply(Vector.of(moments[1:4])), P)


def count_pairs(parents: Sequence[int]) -> int:
    """Count the pairs of a body with one that carries it, or with itself: entries of M's triangle."""
    depths = [0]
    for parent in parents:
        depths.append(depths[parent] + 1)
    return sum(depths)


def _list_pairs(
    parents: Sequence[int], forces: Sequence[_Pair], points: Sequence[Vector[Any]]
) -> Iterator[tuple[int, int, _Pair]]:
    """Yield each body, from 0, and each that carries it, with a force on the first about the other's point.

    `points` lead from the parent's point to the body's, from the base on.
    """
    for i, force in enumerate(forces):
        j = i + 1
        while j:
            yield i, j - 1, force
            force, j = force.taken(points[j]), parents[j - 1]


def _skew(v: Vector[Any]) -> Matrix[Any]:
    zero = v.x - v.x
    return Matrix.of([[zero, -v.z, v.y], [v.z, zero, -v.x], [-v.y, v.x, zero]])


def _skew_product(a: Vector[Any], b: Vector[Any]) -> Matrix[Any]:
    """Return a~ b~ = b aT - (a.b) 1."""
    return _skew(a).times(_skew(b))


def _chunk(values: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    return (values[k : k + size] for k in range(0, len(values), size))
