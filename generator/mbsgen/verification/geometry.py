"""Positions of bodies, in 50 digits, by products of rotations: Tree, numbers, state -> poses and velocities.

Velocities are differences of poses, so no equation of a generated function is used. A quaternion's frame is displaced
along its angular velocity w by 1 + h w~ + (h w~)2 / 2; a central difference needs no more terms.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

from sympy import Expr

from mbsgen.formulations import ports
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Body, Motion, RigidPart, Tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DECIMALS, evaluate
from mbsgen.tape.types import Op
from mbsgen.verification.states import Numbers

Vector = list[Decimal]
Matrix = list[Vector]  # rows

STEP = Decimal("1e-16")  # of differences, whose error is of the order of its square, 1e-32
SECOND_STEP = Decimal("1e-9")  # of coordinates, in second differences of fourth order: rounding and error below 1e-31
ZERO, ONE = Decimal(0), Decimal(1)
UNIT: Matrix = [[ONE, ZERO, ZERO], [ZERO, ONE, ZERO], [ZERO, ZERO, ONE]]


@dataclass(frozen=True)
class Pose:
    """Origin and axes, as columns, in the base frame."""

    p: Vector
    R: Matrix

    def place(self, r: Vector) -> Vector:
        """Return the position of a point that is given in this frame."""
        return add(self.p, apply(self.R, r))


@dataclass(frozen=True)
class Mass:
    """A part of a body with mass: its number in the tree, and mass, centre and inertia in the body's frame."""

    body: int
    m: Decimal
    com: Vector
    inertia: Matrix


class Mechanism:
    """A tree with numbers for its parameters."""

    def __init__(self, tree: Tree, numbers: Mapping[str, Numbers]) -> None:
        """Take the numbers of `write_numbers` for the tree."""
        self.tree, self._found = tree.uncoupled, numbers
        self.gravity = self.vector("gravity")
        self.masses = tuple(
            Mass(i, self._found[f"m_{i}_{k}"][0], self.vector(f"com_{i}_{k}"), self.matrix(f"In_{i}_{k}"))
            for i, body in enumerate(tree.bodies, 1)
            for k in range(1 + len(body.parts))
        )

    def vector(self, name: str) -> Vector:
        """Return a vector by name."""
        return list(self._found[name])

    def matrix(self, name: str) -> Matrix:
        """Return a matrix by name; it is stored by columns."""
        entries = self._found[name]
        return [[entries[r + 3 * c] for c in range(3)] for r in range(3)]

    def poses(self, q: Numbers, displacement: Numbers | None = None) -> list[Pose]:
        """Place the base and all bodies, each joint displaced along its velocity if a displacement is given."""
        quaternions = {x.first: x for x in self.tree.quaternions}
        inside = {i for x in self.tree.quaternions for i in x.bodies}
        moved, entries, poses = displacement or [ZERO] * len(self.tree.bodies), iter(q), [Pose([ZERO] * 3, UNIT)]
        for i, body in enumerate(self.tree.bodies, 1):
            parent = poses[body.parent]
            frame = Pose(parent.place(self.vector(f"dpt_{i}")), times(parent.R, self.matrix(f"R_{i}")))
            if i in quaternions:
                size = 7 if quaternions[i].is_free else 4
                ways = [moved[k - 1] for k in quaternions[i].bodies]
                frame = _float(frame, [next(entries) for _ in range(size)], ways)
            angle = ZERO if i in inside else next(entries) + moved[i - 1]
            poses.append(_join(frame, body.joint.motion, body.joint.axis, angle))
        return poses

    def speed(self, q: Numbers, qd: Numbers) -> tuple[list[Pose], list[tuple[Vector, Vector]]]:
        """Return all poses, and the velocity of each origin with the angular velocity, in the base frame."""
        here = self.poses(q)
        ahead, behind = (self.poses(q, [h * x for x in qd]) for h in (STEP, -STEP))
        return here, [velocity(*three) for three in zip(here, ahead, behind, strict=True)]


def write_numbers(tree: Tree, parameters: Mapping[str, Numbers]) -> dict[str, Numbers]:
    """Compute every number of a tree from its parameters."""
    builder = Builder()
    chain = write_chain(
        tree, builder, declare_state(tree.uncoupled, builder, rates=False, accelerations=False, forces=False)
    )

    def put(name: str, rows: Iterable[Iterable[Expr]]) -> None:
        builder.output_dense(name, [[chain.scalar(x) for x in row] for row in rows])

    put("gravity", [[x] for x in tree.gravity])
    for i, body in enumerate(tree.bodies, 1):
        put(f"dpt_{i}", [[x] for x in body.position])
        put(f"R_{i}", body.orientation)
        put(f"axes_{i}", body.axes)
        put(f"rotor_{i}", [[body.joint.armature]])
        parts: tuple[Body | RigidPart, ...] = (body, *body.parts)
        for k, part in enumerate(parts):
            put(f"m_{i}_{k}", [[part.mass]])
            put(f"com_{i}_{k}", [[x] for x in part.com])
            put(f"In_{i}_{k}", part.inertia)
    for k, sensor in enumerate(tree.sensors):
        put(f"place_{k}", [[x] for x in sensor.position])
        put(f"turn_{k}", sensor.orientation)
    for k, loop in enumerate(tree.loops):
        put(f"loop_{k}", [[loop.value]])
        for n, end in enumerate((loop.first, loop.second)):
            put(f"end_{k}_{n}", [[x] for x in end.position])
            put(f"frame_{k}_{n}", end.axes)
    for k, wrench in enumerate(tree.wrenches):
        put(f"point_{k}", [[x] for x in wrench.position])
        put(f"axes_of_{k}", wrench.orientation)
    for k, probe in enumerate(tree.probes):
        put(f"probe_{k}", [[x] for x in probe.point])
    tape = builder.build("numbers")
    given = {i.name: parameters.get(i.name, [ZERO] * i.sparsity.nnz) for i in tape.inputs}
    assert all(given[port.name] for port in (ports.PARAMETERS, ports.DESIGN) if port.name in given), (
        "all parameters have a value"
    )
    return evaluate(tape, given, DECIMALS)


def _join(frame: Pose, motion: Motion, axis: int, q: Decimal) -> Pose:
    if motion is Motion.PRISMATIC:
        return Pose(add(frame.p, [row[axis] * q for row in frame.R]), frame.R)
    s, c = DECIMALS.functions[Op.SIN](q), DECIMALS.functions[Op.COS](q)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    turn = [list(row) for row in UNIT]
    turn[j][j] = turn[k][k] = c
    turn[k][j], turn[j][k] = s, -s
    return Pose(frame.p, times(frame.R, turn))


def _float(frame: Pose, q: Numbers, ways: Numbers) -> Pose:
    """Place the frame of a quaternion, displaced along its velocities, which are in its own axes."""
    *place, x, y, z, s = q
    turned = times(frame.R, rotation([x, y, z], s))
    p = frame.place(place) if place else frame.p
    if place:
        p = add(p, apply(turned, ways[:3]))
    return Pose(p, times(turned, _small_turn(ways[-3:])))


def rotation(v: Vector, s: Decimal) -> Matrix:
    """Return the rotation by the unit quaternion along (v, s): (s2 - v.v) 1 + 2 v vT + 2 s v~."""
    length = (dot(v, v) + s * s).sqrt()
    v, s = [x / length for x in v], s / length
    skew = cross_matrix(v)
    return [
        [(s * s - dot(v, v)) * UNIT[r][c] + 2 * v[r] * v[c] + 2 * s * skew[r][c] for c in range(3)] for r in range(3)
    ]


def _small_turn(w: Vector) -> Matrix:
    skew = cross_matrix(w)
    square = times(skew, skew)
    return [[UNIT[r][c] + skew[r][c] + square[r][c] / 2 for c in range(3)] for r in range(3)]


def velocity(here: Pose, ahead: Pose, behind: Pose) -> tuple[Vector, Vector]:
    """Return the velocity of the origin, and the angular velocity: R' RT = w~."""
    v = slope(ahead.p, behind.p)
    W = times([slope(a, b) for a, b in zip(ahead.R, behind.R, strict=True)], transpose(here.R))
    return v, [(W[2][1] - W[1][2]) / 2, (W[0][2] - W[2][0]) / 2, (W[1][0] - W[0][1]) / 2]


def displace(poses: Sequence[Pose], number: int, beyond: Collection[int], way: int, step: Decimal) -> list[Pose]:
    """Move some bodies rigidly by a step: along (0 to 2) or about (3 to 5) an axis through the origin of one body."""
    along, about = ([step * int(way == k) for k in ways] for ways in (range(3), range(3, 6)))
    turn, at = _small_turn(about), poses[number].p

    def move(pose: Pose) -> Pose:
        arm = apply(turn, add(pose.p, [-x for x in at]))
        return Pose(add(add(at, arm), along), times(turn, pose.R))

    return [move(pose) if i in beyond else pose for i, pose in enumerate(poses)]


def bend(
    tree: Tree, value: Callable[[Numbers | None], Numbers], qd: Numbers, qdd: Numbers, size: Decimal = ONE
) -> Numbers:
    """Return the second time derivative of a function of displacements along all joints of an uncoupled tree.

    Velocities of a free body are in its own, turning axes. `size` is the unit of shifts. The error of a second
    difference, relative to the square of the speed, grows by the fourth power of the way per step. Velocities are large
    where loops are almost singular: there, a step of fixed time is too long.
    """
    curve = list(qdd)
    for x in tree.quaternions:
        if x.is_free:
            a, b, c, d, e, f = (qd[i - 1] for i in x.bodies)
            for i, more in zip(x.bodies, (e * c - f * b, f * a - d * c, d * b - e * a), strict=False):
                curve[i - 1] += more
    own = [size if body.joint.motion is Motion.PRISMATIC else ONE for body in tree.bodies]
    speeds, changes = ([abs(x) / unit for x, unit in zip(v, own, strict=True)] for v in (qd, curve))
    time, here = SECOND_STEP / max(ONE, *speeds, *(a.sqrt() for a in changes)), value(None)

    def differ(step: Decimal) -> Numbers:
        moved = (value([h * v + h * h / 2 * a for v, a in zip(qd, curve, strict=True)]) for h in (step, -step))
        return [(x + y - 2 * z) / step**2 for x, y, z in zip(*moved, here, strict=True)]

    coarse, fine = differ(2 * time), differ(time)
    return [(4 * y - x) / 3 for x, y in zip(coarse, fine, strict=True)]


def slope(ahead: Sequence[Decimal], behind: Sequence[Decimal]) -> Vector:
    """Return the central difference over one step each way."""
    return [(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)]


def add(a: Vector, b: Vector) -> Vector:
    """Add two vectors."""
    return [x + y for x, y in zip(a, b, strict=True)]


def dot(a: Sequence[Decimal], b: Sequence[Decimal]) -> Decimal:
    """Form the scalar product."""
    return sum((x * y for x, y in zip(a, b, strict=True)), ZERO)


def cross(a: Vector, b: Vector) -> Vector:
    """Form the vector product."""
    return apply(cross_matrix(a), b)


def apply(A: Matrix, v: Vector) -> Vector:
    """Multiply a matrix by a vector."""
    return [dot(row, v) for row in A]


def times(A: Matrix, B: Matrix) -> Matrix:
    """Multiply two matrices."""
    columns = transpose(B)
    return [[dot(row, column) for column in columns] for row in A]


def transpose(A: Matrix) -> Matrix:
    """Exchange rows and columns."""
    return [list(column) for column in zip(*A, strict=True)]


def cross_matrix(v: Vector) -> Matrix:
    """Return v~, with v~ w = v x w."""
    x, y, z = v
    return [[ZERO, -z, y], [z, ZERO, -x], [-y, x, ZERO]]
