"""The size of the inertia that regrouping moves, relative to the inertia present: the digits that moving it costs.

The articulated recursion adds to a body's own inertia I the articulated inertia of its children: IA = I + sum Ia.
Regrouping takes a part out of Ia, and puts it into I. With rounding u, the sum is then off by u (1 + growth), where
growth is the largest ratio of the moved inertia to IA, by kinetic energy over all motions. IA is at least I, as joints
only give way, and at least the Ia of the child itself. The moved part lies on the joint's axis, so both bounds hold in
any position. For a body without inertia, Ia of its children is taken in one generic position.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.parsimony.segments import Moments, Segment, children, feels_itself
from mbsgen.tape.builder import Scalar

Array = NDArray[np.float64]

ANGLE = 1.0  # rad: the position of joints beyond a body without inertia
NEGLIGIBLE = 1e-9  # relative to the scale of an entry; smaller values count as none


class Proportions:
    """The inertias of a chain's bodies, as bounds for moved inertia. All numbers of the chain must be literals."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        self._segments = {s.number: s for s in segments}
        self._left: dict[
            int, Array
        ] = {}  # of each body's least inertia, with its joint free, about the parent's origin
        self._least: dict[int, Array] = {}
        for segment in reversed(segments):
            beyond = [s.number for s in children(segments, segment.number)]
            self._least[segment.number] = least = self._bound(segment, beyond)
            self._left[segment.number] = _free(segment, least)

    def _bound(self, segment: Segment, beyond: Sequence[int]) -> Array:
        """Bound the articulated inertia of a body from below."""
        own = find_spatial(segment.moments)
        if _weakest(own) > NEGLIGIBLE:
            return own
        return own + sum((self._carry(number, ANGLE) for number in beyond), np.zeros((6, 6)))

    def _carry(self, number: int, angle: float) -> Array:
        """Refer the articulated inertia beyond a turned joint to its parent's origin, in the parent's frame."""
        segment = self._segments[number]
        turn = _numbers(segment.turn) if segment.turn and not segment.floats else np.eye(3)
        if segment.is_revolute:
            turn = turn @ _rotation(segment.axis, angle)
        both = np.kron(np.eye(2), turn)
        lever = np.eye(6)
        lever[:3, 3:] = -_cross(_vector(segment.d))
        carried: Array = lever.T @ both @ self._left[number] @ both.T @ lever
        return carried

    def growth(self, number: int, moved: Moments) -> float:
        """Return the largest ratio of the moments that leave body `number` to the inertia present."""
        inertia = find_spatial(moved)
        there = self._least[self._segments[number].parent], self._carry(number, 0.0)
        return min(_ratio(inertia, x) for x in there)


def _vector(v: Vector[Scalar]) -> Array:
    return np.array([_number(x) for x in v])


def _numbers(A: Matrix[Scalar]) -> Array:
    return np.array([[_number(x) for x in row] for row in A.rows])


def _number(x: Scalar) -> float:
    assert x.literal is not None, "the numbers of the chain are known"
    return x.literal


def find_spatial(moments: Moments) -> Array:
    """Make the 6 x 6 inertia: force and moment for the acceleration of the origin and the angular one."""
    P, lever = _numbers(moments.P), _cross(_vector(moments.S))
    J = np.trace(P) * np.eye(3) - P
    return np.block([[_number(moments.m) * np.eye(3), -lever], [lever, J]])


def _cross(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _rotation(axis: int, angle: float) -> Array:
    """Make the rotation about a coordinate axis: columns are the turned axes."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = np.cos(angle)
    R[k, j] = np.sin(angle)
    R[j, k] = -R[k, j]
    return R


def _free(segment: Segment, inertia: Array) -> Array:
    """Free a joint: subtract U UT / D."""
    along = segment.axis + (3 if segment.is_revolute else 0)
    pivot = inertia[along, along]
    felt = inertia[:, along]
    return inertia - np.outer(felt, felt) / pivot if pivot > 0 else inertia


def _scale(inertia: Array) -> Array:
    diagonal = np.sqrt(np.abs(np.diag(inertia)))
    return np.where(diagonal > 0, diagonal, 1.0)


def _weakest(inertia: Array) -> float:
    """Find the smallest eigenvalue, with the diagonal scaled to 1."""
    scale = _scale(inertia)
    return float(np.linalg.eigvalsh(inertia / np.outer(scale, scale)).min())


def _ratio(moved: Array, there: Array) -> float:
    """Find the largest ratio of one inertia to another over all motions, in magnitude."""
    scale = np.outer(_scale(there), _scale(there))
    values, vectors = np.linalg.eigh(there / scale)
    felt = vectors.T @ (moved / scale) @ vectors
    is_there = values > NEGLIGIBLE
    rest = felt[~is_there]
    if np.abs(rest).max(initial=0.0) > NEGLIGIBLE * np.abs(felt).max():
        return np.inf
    size = np.sqrt(values[is_there])
    ratios = np.linalg.eigvalsh(felt[np.ix_(is_there, is_there)] / np.outer(size, size))
    return float(np.abs(ratios).max(initial=0.0))


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
    least = inertia[mine, mine]
    if any(s.is_revolute != segment.is_revolute for s in passed):
        least = least - inertia[mine, other] @ np.linalg.pinv(inertia[other, other]) @ inertia[other, mine]
    return max(float(np.linalg.eigvalsh(least)[0]), 0.0)
