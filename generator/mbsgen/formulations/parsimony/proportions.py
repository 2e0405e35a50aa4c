"""The size of the inertia that regrouping moves, relative to the inertia present: the digits that moving it costs.

The articulated recursion adds to a body's own inertia I the articulated inertia of its children: IA = I + sum Ia.
Regrouping takes a part out of Ia, and puts it into I. With rounding u, the sum is then off by u (1 + growth), where
growth is the largest ratio of the moved inertia to IA, by kinetic energy over all motions. IA is at least I, as joints
only give way, and at least the Ia of the child itself. The moved part lies on the joint's axis, so both bounds hold in
any position. For a body without inertia, Ia of its children is taken in one generic position.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from mbsgen.algebra.dense import (
    Dense,
    Row,
    combine,
    divide_both,
    find_eigen,
    find_largest,
    identity,
    invert_symmetric,
    project,
    skew,
    stack,
    times,
    transpose,
)
from mbsgen.algebra.rotations import axis_rotation
from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.parsimony.segments import Moments, Segment, children, feels_itself
from mbsgen.tape.builder import Scalar

ANGLE = 1.0  # rad: the position of joints beyond a body without inertia
NEGLIGIBLE = 1e-9  # relative to the scale of an entry; smaller values count as none


class Proportions:
    """The inertias of a chain's bodies, as bounds for moved inertia. All numbers of the chain must be literals."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        self._segments = {s.number: s for s in segments}
        self._left: dict[
            int, Dense
        ] = {}  # of each body's least inertia, with its joint free, about the parent's origin
        self._least: dict[int, Dense] = {}
        self._known: dict[int, tuple[_Present, _Present]] = {}  # by the body that moments leave
        for segment in reversed(segments):
            beyond = [s.number for s in children(segments, segment.number)]
            self._least[segment.number] = least = self._bound(segment, beyond)
            self._left[segment.number] = _free(segment, least)

    def _bound(self, segment: Segment, beyond: Sequence[int]) -> Dense:
        """Bound the articulated inertia of a body from below."""
        own = find_spatial(segment.moments)
        if _weakest(own) > NEGLIGIBLE:
            return own
        return reduce(_add, (self._carry(number, ANGLE) for number in beyond), own)

    def _carry(self, number: int, angle: float) -> Dense:
        """Refer the articulated inertia beyond a turned joint to its parent's origin, in the parent's frame."""
        segment = self._segments[number]
        turn = _numbers(segment.turn) if segment.turn and not segment.floats else identity(3)
        if segment.is_revolute:
            turn = times(turn, _rotation(segment.axis, angle))
        none = combine(lambda _: 0.0, turn)
        both = stack(((turn, none), (none, turn)))
        lever = stack(((identity(3), _negate(skew(_vector(segment.d)))), (none, identity(3))))
        carry = times(transpose(lever), both)
        return times(times(carry, self._left[number]), transpose(carry))

    def growth(self, number: int, moved: Moments) -> float:
        """Return the largest ratio of the moments that leave body `number` to the inertia present."""
        inertia = find_spatial(moved)
        if number not in self._known:
            there = self._least[self._segments[number].parent], self._carry(number, 0.0)
            self._known[number] = _Present.of(there[0]), _Present.of(there[1])
        return min(x.compare(inertia) for x in self._known[number])


def _vector(v: Vector[Scalar]) -> Row:
    return tuple(_number(x) for x in v)


def _numbers(A: Matrix[Scalar]) -> Dense:
    return tuple(tuple(_number(x) for x in row) for row in A.rows)


def _number(x: Scalar) -> float:
    assert x.literal is not None, "the numbers of the chain are known"
    return x.literal


def find_spatial(moments: Moments) -> Dense:
    """Make the 6 x 6 inertia: force and moment for the acceleration of the origin and the angular one."""
    m, lever = _number(moments.m), skew(_vector(moments.S))
    weights = combine(lambda one: m * one, identity(3))
    return stack(((weights, _negate(lever)), (lever, turn_moments(_numbers(moments.P)))))


def turn_moments(P: Dense) -> Dense:
    """Return the inertia tensor of second moments of mass: tr(P) 1 - P."""
    trace = sum(P[k][k] for k in range(3))
    return combine(lambda one, x: trace * one - x, identity(3), P)


def _add(A: Dense, B: Dense) -> Dense:
    return combine(operator.add, A, B)


def _negate(A: Dense) -> Dense:
    return combine(operator.neg, A)


def _rotation(axis: int, angle: float) -> Dense:
    """Make the rotation about a coordinate axis: columns are the turned axes."""
    c, s = math.cos(angle), math.sin(angle)
    return tuple(map(tuple, axis_rotation(axis, s, c, 0.0, 1.0).rows))


def _free(segment: Segment, inertia: Dense) -> Dense:
    """Free a joint: subtract U UT / D."""
    along = segment.axis + (3 if segment.is_revolute else 0)
    felt = inertia[along]
    pivot = felt[along]
    if not pivot > 0:
        return inertia
    return project(inertia, felt, pivot)


def _scale(inertia: Dense) -> Row:
    diagonal = (math.sqrt(abs(row[k])) for k, row in enumerate(inertia))
    return tuple(x if x > 0 else 1.0 for x in diagonal)


def _weakest(inertia: Dense) -> float:
    """Find the smallest eigenvalue, with the diagonal scaled to 1."""
    return find_eigen(divide_both(inertia, _scale(inertia)))[0][0]


@dataclass(frozen=True)
class _Present:
    """An inertia, by its scales, and the eigenvalues and eigenvectors of the scaled matrix."""

    scale: Row
    values: Row
    vectors: Dense

    @staticmethod
    def of(inertia: Dense) -> _Present:
        scale = _scale(inertia)
        return _Present(scale, *find_eigen(divide_both(inertia, scale)))

    def compare(self, moved: Dense) -> float:
        """Find the largest ratio of another inertia to this one over all motions, in magnitude."""
        values, vectors = self.values, self.vectors
        felt = times(times(vectors, divide_both(moved, self.scale)), transpose(vectors))
        first = sum(value <= NEGLIGIBLE for value in values)  # of the motions that have inertia
        if find_largest(felt[:first]) > NEGLIGIBLE * find_largest(felt):
            return math.inf
        size = tuple(math.sqrt(value) for value in values[first:])
        ratios, _ = find_eigen(divide_both(tuple(row[first:] for row in felt[first:]), size))
        return max(map(abs, ratios), default=0.0)


def find_least(segments: Sequence[Segment], segment: Segment) -> float:
    """Return the inertia about the axis of a joint's own body, or the least of the next body that has inertia.

    Where joints of both kinds lie between, this body is free to turn while it is moved, and the other way round.
    """
    passed = [segment]
    while not feels_itself(passed[-1]):
        following = children(segments, passed[-1].number)
        if len(following) != 1:
            return 0.0
        passed.append(following[0])
    body = passed[-1]
    moments = body.moments
    if body is segment:
        own = (moments.P[k, k] for k in segment.across) if segment.is_revolute else (moments.m,)
        return sum(x.literal or 0.0 for x in own)
    inertia = find_spatial(moments)
    mine, other = (slice(3, 6), slice(0, 3)) if segment.is_revolute else (slice(0, 3), slice(3, 6))
    least = tuple(row[mine] for row in inertia[mine])
    if any(s.is_revolute != segment.is_revolute for s in passed):
        across = tuple(row[other] for row in inertia[mine])
        beyond = invert_symmetric(tuple(row[other] for row in inertia[other]))
        least = combine(operator.sub, least, times(times(across, beyond), transpose(across)))
    return max(find_eigen(least)[0][0], 0.0)
