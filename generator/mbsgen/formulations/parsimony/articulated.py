"""Order-N accelerations (EXP2): qdd = nu(q, qd, Q) by articulated bodies, in three recursions.

Schwertassek, Rulka (1989); Featherstone (1983; 2008, 7.3). Loads and accelerations of a body are about its origin,
where the body is written: F = M a + B OMp, N = BT a + J OMp. With IA = [M B; BT J], the joint's unit motion e, its
rotor, and the bias load p of the Newton-Euler recursion at qdd = 0, from the leaves to the base:

    U = IA e,    D = e.U + rotor,    K = U / D,    u = Q - e.p
    IA_parent += X (IA - K UT) XT,    p_parent += X (p + K u)

and from the base to the leaves, with the acceleration a' on top of the bias (`Increment`): qdd = u / D - K.a'. Since a'
counts from the bias motion, the product of articulated inertia and bias acceleration never arises. Along the joint's
axis, p + K u is the joint's force, so that it is not computed.

The accelerations of the bias motion are free to choose. If the plan has it so, each joint that is eliminated alone is
*at rest*: it takes back the acceleration c that the bodies before carry along its axis. So most products with angular
acceleration vanish, and qdd = u / D - K.a' - c. The rotor turns with this joint: its moment rotor c is added to Q.

Joints near the base may be eliminated *together*, in absolute angles: by their part of the mass matrix, in which
articulated bodies beyond are met by the motions of these joints. This takes fewer operations where axes are parallel.

A point mass behind two joints may be in *series* with the rotor between them (`series`).

A rotor feels only its joint's own acceleration. So the pivot D contains its inertia, and the rotor takes the fraction
`rotor_share` = rotor / D of the joint's force. The bodies take the rest. Along the axis, the parent then feels
`rotor_share` times the bodies' inertia; without a rotor, nothing.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.chain import Chain, check_pivot
from mbsgen.formulations.parsimony.angles import absolute_forces, relative_acceleration
from mbsgen.formulations.parsimony.elimination import Solution, solve
from mbsgen.formulations.parsimony.mass_matrix import (
    Freed,
    Inertia,
    Motion,
    bring_all,
    cross_matrix,
    is_met,
    link,
    mass_matrix,
    meet_hooked,
    own_inertia,
)
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Load, join_loads, unloaded
from mbsgen.formulations.parsimony.segments import Segment, children
from mbsgen.formulations.parsimony.series import Line, Series, follow, join, passes, split
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar


@dataclass(frozen=True)
class Body:
    """The terms of a body in the elimination."""

    parts: tuple[Inertia, ...]  # its own inertia, and the articulated inertia beyond each of its joints
    pivot: Scalar  # D: the inertia that its own joint feels
    rotor_share: Scalar  # the part of the pivot that is the rotor's inertia
    KF: Vector[Scalar]  # K: load for a unit force of its joint
    KN: Vector[Scalar]
    left: Inertia  # the articulated inertia that its parent feels, with its joint free
    whole: Inertia  # ... with its joint locked
    U: Load  # for a unit acceleration of its joint
    inverse: Scalar  # of the pivot
    halves: tuple[Line, Inertia] | None = None  # the part of this that may be in series with a rotor, and the rest
    series: Series | None = None  # how the joint feels a point mass beyond it

    def free(self, segment: Segment, kinematics: Kinematics) -> Freed:
        """Free the joint for the motions of the joints before it."""
        is_apart = kinematics.plan.turns_apart and self.series is None and self.rotor_share.is_zero
        return Freed(segment.axis, segment.is_revolute, self.left, self.whole, self.U, self.inverse, is_apart)


@dataclass(frozen=True)
class Increment:
    """Acceleration on top of the bias: of the origin, and angular."""

    a: Vector[Scalar]
    OMp: Vector[Scalar]


@dataclass(frozen=True)
class Accelerations:
    """The accelerations of the joints, and the terms of their elimination."""

    qdd: list[Scalar]
    bodies: dict[int, Body]  # with joints that are eliminated one by one
    pivots: dict[int, Scalar]  # of every joint


def accelerations(
    writing: Writing, qd: Sequence[Scalar], Q: Sequence[Scalar], *, absolute: bool = True
) -> Accelerations:
    """Compute qdd. With `absolute`, the joints that the plan eliminates together have absolute angles."""
    kinematics, inertias = writing.kinematics, writing.inertias
    segments, together = kinematics.segments, find_together(kinematics)
    still = {s.number for s in segments} - together if kinematics.plan.at_rest else set()
    movements = kinematics.move(writing.chain.gravity, qd, writing.chain.drift, still)
    carried = {i: movements[i].carried for i in still}
    bodies = articulate(writing, together)
    forces = absolute_forces(segments, Q) if absolute else [s.signed(x) for s, x in zip(segments, Q, strict=True)]
    force_residual: dict[int, Scalar] = {}  # u = Q - e.p: the joint force residual of the bias motion
    loads: dict[int, Load] = {}
    followed: dict[int, Scalar] = {}  # the acceleration of the point mass that a joint feels in series
    met: dict[int, tuple[Load, Load]] = {}  # bias and hooked, of bodies that the motions of the joints before them meet
    for segment in reversed(segments):
        i = segment.number
        slack = segment.parent in bodies and _is_joined(bodies[segment.parent], i)
        bias = join_loads(kinematics, segment, inertias[i], movements[i], loads, slack=slack)
        if i in together:
            turning = bias.alone if absolute else bias.N
            force_residual[i] = forces[i - 1] - (turning if segment.is_revolute else bias.F)[segment.axis]
            loads[i] = bias
            continue
        force = segment.signed(Q[i - 1])
        if i in still:
            force = force + writing.chain.armatures[i - 1] * carried[i]
        force_residual[i] = force - (bias.N if segment.is_revolute else bias.F)[segment.axis]
        if series := bodies[i].series:
            point = series.point
            followed[i] = follow(kinematics, segments[point - 1], inertias[point], movements[point])
            loads[i] = _tighten(segment, bias, series.tighten(followed[i], force_residual[i]), force)
        else:
            loads[i] = kinematics.builder.remember(
                ("hook", force_residual[i].ref, force.ref),
                (segment, bias, bodies[i]),
                partial(_hook, segment, bias, bodies[i], force_residual[i], force),
            )
        if _meets(kinematics, segment, together):
            met[i], loads[i] = (bias, loads[i]), unloaded(kinematics.builder, bias.momentum)
    for i, (bias, hooked) in met.items():
        at, freed = segments[i - 1], bodies[i].free(segments[i - 1], kinematics)
        for j, work in meet_hooked(kinematics, at, bias, hooked, force_residual[i], freed, absolute=absolute).items():
            force_residual[j] = force_residual[j] - work
    solution = _solve_together(writing, bodies, force_residual, together, absolute=absolute)
    qdd = _accelerate(kinematics, bodies, force_residual, solution.x, carried, followed, absolute=absolute)
    return Accelerations(qdd, bodies, {i: x.pivot for i, x in bodies.items()} | solution.pivots)


def _meets(kinematics: Kinematics, segment: Segment, together: Container[int]) -> bool:
    """Return whether the load and the acceleration of a body are by the motions of the joints before it."""
    return kinematics.plan.by_motions and segment.parent in together and is_met(kinematics, segment)


def find_together(kinematics: Kinematics) -> frozenset[int]:
    """Find the joints that the plan eliminates together: few enough joints are before them."""
    return frozenset(i for i, depth in find_depths(kinematics.segments).items() if depth <= kinematics.plan.together)


def find_depths(segments: Sequence[Segment]) -> dict[int, int]:
    """Count the joints from the base to each body."""
    depths: dict[int, int] = {}
    for s in segments:
        depths[s.number] = depths.get(s.parent, 0) + 1
    return depths


def _solve_together(
    writing: Writing,
    bodies: Mapping[int, Body],
    force_residual: Mapping[int, Scalar],
    together: frozenset[int],
    *,
    absolute: bool,
) -> Solution:
    """Solve for the accelerations of joints near the base, with all joints beyond them free."""
    segments, tree = writing.kinematics.segments, writing.chain.tree
    kinematics = writing.kinematics
    beyond = {
        s.number: bodies[s.number].free(s, kinematics) for s in segments if s.number in bodies and s.parent in together
    }
    numbers = dict(enumerate(sorted(together), 1))
    places = {number: k for k, number in numbers.items()}
    M = mass_matrix(writing, absolute=absolute, freed=beyond) if together else {}
    found = solve(
        writing.chain.builder,
        {(places[i], places[j]): value for (i, j), value in M.items()},
        {k: x if absolute else segments[i - 1].signed(x) for k, i in numbers.items() for x in [force_residual[i]]},
        len(numbers),
        lambda k, pivot: check_pivot(tree, numbers[k], pivot),
    )
    return Solution(*({numbers[k]: x for k, x in column.items()} for column in (found.x, found.pivots)))


def articulate(writing: Writing, together: Container[int] = ()) -> dict[int, Body]:
    """Compute the articulated inertia of each body and eliminate its joint, from the leaves; except for `together`."""
    kinematics = writing.kinematics
    bodies: dict[int, Body] = {}
    for segment in reversed(kinematics.segments):
        if segment.number in together:
            continue
        inertia, beyond = writing.inertias[segment.number], children(kinematics.segments, segment.number)
        parts = (*(bodies[c.number] for c in beyond), *(kinematics.frames[c.number] for c in beyond))
        bodies[segment.number] = kinematics.builder.remember(
            ("articulate", kinematics.plan.in_series, kinematics.plan.shift_first),
            (segment, inertia, kinematics.frames[segment.number], *parts),
            lambda: _eliminate(writing, segment, bodies),  # noqa: B023  # now
        )
    return bodies


def _eliminate(writing: Writing, segment: Segment, bodies: dict[int, Body]) -> Body:
    """Eliminate a joint; a point mass beyond it may be in series with the rotor about the joint's axis."""
    kinematics, inertia = writing.kinematics, writing.inertias[segment.number]
    parts = _gather(kinematics, segment, inertia, bodies)
    body = _free(writing.chain, segment, parts)
    if not kinematics.plan.in_series:
        return body
    halves = split(kinematics, segment, inertia, parts[0])
    if halves and passes(kinematics, segment):
        line, own = halves
        return replace(body, halves=(line, _free(writing.chain, segment, (own, *parts[1:])).left))
    beyond = children(kinematics.segments, segment.number)
    points = {c.number: halves for c in beyond if (halves := bodies[c.number].halves)}
    if len(points) != 1 or not writing.chain.armatures[segment.number - 1].is_zero:
        return body
    ((point, (line, rest)),) = points.items()
    others = (part for c, part in zip(beyond, parts[1:], strict=True) if c.number != point)
    rest = reduce(_add, (parts[0], *others), rest)
    series = join(segment, point, line, rest)
    if series is None:
        return body
    left = _add(_clear(segment, rest), series.left.inertia)
    return replace(body, series=series, left=left, pivot=series.pivot)


def _clear(segment: Segment, inertia: Inertia) -> Inertia:
    """Take the moment of inertia about a joint's axis out of an inertia that the joint feels only so."""
    e, zero = segment.axis, inertia.J[0, 0].builder.zero
    J = Matrix.of([zero if r == c == e else inertia.J[r, c] for c in range(3)] for r in range(3))
    return Inertia(inertia.M, inertia.B, J)


def _is_joined(body: Body, number: int) -> bool:
    return body.series is not None and body.series.point == number


def _gather(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, bodies: dict[int, Body]
) -> tuple[Inertia, ...]:
    """List a body's own inertia, and the articulated inertia beyond each of its joints."""
    b = kinematics.builder
    axes = kinematics.frames[segment.number].directions
    S = kinematics.fixed(segment.number, inertia.S)
    M = Matrix.of([inertia.m if r == c else b.zero for c in range(3)] for r in range(3))
    parts = [Inertia(M, cross_matrix(b, -S), own_inertia(b, segment, inertia, axes))]
    for child in children(kinematics.segments, segment.number):
        beyond, is_along = bodies[child.number].left, kinematics.plan.shift_first and _is_along(child)
        if is_along:  # a shift along the axis leaves fewer entries to turn about it
            beyond = _shift(b, beyond, child.d)
        M, B, J = (kinematics.depart_tensor(child, x, faithful=True) for x in (beyond.M, beyond.B, beyond.J))
        turned = Inertia(M, B, J)
        parts.append(turned if is_along else _shift(b, turned, link(kinematics, child)))
    return tuple(parts)


def _is_along(child: Segment) -> bool:
    """Return whether the link to a body is along the axis of its joint."""
    return child.is_revolute and child.turn is None and all(child.d[r].is_zero for r in child.across)


def _add(first: Inertia, second: Inertia) -> Inertia:
    return Inertia(first.M + second.M, first.B + second.B, first.J + second.J)


def _shift(builder: Builder, inertia: Inertia, d: Vector[Scalar]) -> Inertia:
    """Refer an inertia to a point; its own reference point is at d from there."""
    lever = cross_matrix(builder, d)
    B = inertia.B - inertia.M.times(lever)
    first, second = lever.times(inertia.B), lever.times(B)
    upper = {(r, c): inertia.J[r, c] + first[c, r] + second[r, c] for r in range(3) for c in range(r, 3)}
    return Inertia(inertia.M, B, symmetric(upper))


def _free(chain: Chain, segment: Segment, parts: tuple[Inertia, ...]) -> Body:
    """Eliminate a joint: its shares of a load, and the articulated inertia that its parent feels."""
    e, rotor, whole = segment.axis, chain.armatures[segment.number - 1], reduce(_add, parts)
    if segment.is_revolute:
        UF, UN = whole.B.column(e), whole.J.column(e)
        pivot = UN[e] + rotor
    else:
        UF, UN = whole.M.column(e), whole.B.rows[e]
        pivot = UF[e] + rotor
    check_pivot(chain.tree, segment.number, pivot)
    inverse = chain.builder.number(1.0) / pivot
    KF, KN, rotor_share = UF.scale(inverse), UN.scale(inverse), rotor * inverse

    def left(
        own: Matrix[Scalar], K: Vector[Scalar], U: Vector[Scalar], along: set[int], *, mirror: bool
    ) -> Matrix[Scalar]:
        rest = {
            (r, c): rotor_share * own[r, c] if (r in along and mirror) or c in along else own[r, c] - K[r] * U[c]
            for r in range(3)
            for c in range(3)
            if r <= c or not mirror
        }
        return symmetric(rest) if mirror else Matrix.of([rest[r, c] for c in range(3)] for r in range(3))

    turned = {e} if segment.is_revolute else set()
    slid = set() if segment.is_revolute else {e}
    M = left(whole.M, KF, UF, slid, mirror=True)
    J = left(whole.J, KN, UN, turned, mirror=True)
    B = left(whole.B, KF, UN, turned, mirror=False)
    if slid:
        B = Matrix.of([rotor_share * whole.B[r, c] if r == e else B[r, c] for c in range(3)] for r in range(3))
    return Body(parts, pivot, rotor_share, KF, KN, Inertia(M, B, J), whole, Load(UF, UN, UN), inverse)


def _across(segment: Segment, F: Vector[Scalar], N: Vector[Scalar]) -> list[Scalar]:
    """List the components of a load that are not along a joint."""
    along = segment.axis + 3 * segment.is_revolute
    return [x for r, x in enumerate((*F, *N)) if r != along]


def _hook(segment: Segment, bias: Load, body: Body, force_residual: Scalar, force: Scalar) -> Load:
    """Add a joint's share K u to the bias load; along the axis, this is the joint's force, less the rotor's part."""
    F, N = list(bias.F + body.KF.scale(force_residual)), list(bias.N + body.KN.scale(force_residual))
    (N if segment.is_revolute else F)[segment.axis] = force - body.rotor_share * force_residual
    return Load(Vector.of(F), Vector.of(N), Vector.of(N), bias.momentum)


def _tighten(segment: Segment, bias: Load, tension: Load, force: Scalar) -> Load:
    """Add a point's tension to the bias load; along the axis, this is the joint's force."""
    N = Vector.of(force if r == segment.axis else x for r, x in enumerate(bias.N + tension.N))
    return Load(bias.F + tension.F, N, N, bias.momentum)


def _accelerate(
    kinematics: Kinematics,
    bodies: Mapping[int, Body],
    force_residual: Mapping[int, Scalar],
    known: Mapping[int, Scalar],
    taken: Mapping[int, Scalar],
    followed: Mapping[int, Scalar],
    *,
    absolute: bool,
) -> list[Scalar]:
    """Compute the increments and qdd, from the base to the leaves.

    `known` holds accelerations near the base, `taken` what joints at rest take back, `followed` the accelerations of
    point masses in the bias motion.
    """
    zero = kinematics.builder.zero
    still = Vector(zero, zero, zero)
    increments = {0: Increment(still, still)}
    carried: dict[
        int, Scalar
    ] = {}  # along the axis of a joint with a known acceleration, before the joint or its group
    qdd = []
    for segment in kinematics.segments:
        i, axis, parent = segment.number, segment.axis, increments[segment.parent]
        if i not in known and _meets(kinematics, segment, known):
            felt, apart, taken_up = _move_together(kinematics, segment, known, bodies[i], absolute=absolute)
            motion, follows = felt + apart, absolute and not segment.counts_angle
        else:
            lever = parent.OMp.cross(link(kinematics, segment)) if segment.parent else still
            motion, follows = Motion(parent.a + lever, parent.OMp).arrive(kinematics, segment), False
            felt, taken_up = motion, zero
        a, OMp = motion.a, motion.OMp
        before = (OMp if segment.is_revolute else a)[axis]
        if follows:
            before = before + known[segment.parent]
        if i in known:
            continues = absolute and not segment.counts_angle
            carried[i] = carried[segment.parent] if continues else before
            total = carried[i] + (known[i] if absolute else segment.signed(known[i]))
            qdd.append(relative_acceleration(segment, known) if absolute else known[i])
        else:
            if series := bodies[i].series:
                total = series.accelerate(followed[i], force_residual[i], a, OMp)
            else:
                total = _free_acceleration(segment, bodies[i], force_residual[i], felt.a, felt.OMp) - taken_up
            qdd.append(segment.signed(total - (before + taken[i] if i in taken else before)))
        own = Vector.of(total if r == axis else x for r, x in enumerate(OMp if segment.is_revolute else a))
        increments[i] = Increment(a, own) if segment.is_revolute else Increment(own, OMp)
    return qdd


def _move_together(
    kinematics: Kinematics, segment: Segment, known: Mapping[int, Scalar], body: Body, *, absolute: bool
) -> tuple[Motion, Motion, Scalar]:
    """Compute the increment of a body, without its own joint, from the accelerations of the joints before it.

    In absolute rates, a body that continues a group only follows: the rotation of its parent in the group is left out.
    The increment has two parts: for the first, the joint gives way by K; what it gives way for the other is returned.
    """
    zero, freed = kinematics.builder.zero, body.free(segment, kinematics)
    still = Motion(Vector(zero, zero, zero), Vector(zero, zero, zero))
    sums, apart, taken_up = {True: still, False: still}, still, zero
    for j, brought in bring_all(kinematics, segment, absolute=absolute).items():
        x = known[j] if absolute else kinematics.segments[j - 1].signed(known[j])
        side = brought.is_before
        if freed.parts(brought):
            apart = apart + brought.beyond.scale(x)
            taken_up = taken_up + freed.feel(brought.beyond) * freed.inverse * x
        else:
            sums[side] = sums[side] + brought.at(before=side).scale(x)
    return sums[True].arrive(kinematics, segment) + sums[False], apart, taken_up


def _free_acceleration(
    segment: Segment, body: Body, force_residual: Scalar, a: Vector[Scalar], OMp: Vector[Scalar]
) -> Scalar:
    """Compute the increment along a joint that is eliminated alone: u / D - K.a', and the rotor's share."""
    rotor = body.rotor_share * (OMp if segment.is_revolute else a)[segment.axis]
    K = _across(segment, body.KF, body.KN)
    is_alone = all(x.is_zero for x in K)  # then the inverse has no other use
    total = force_residual / body.pivot if is_alone else force_residual * body.inverse
    for k, x in zip(K, _across(segment, a, OMp), strict=True):
        total = total - k * x
    return total + rotor


def symmetric(upper: dict[tuple[int, int], Scalar]) -> Matrix[Scalar]:
    """Make a symmetric matrix of its upper triangle."""
    return Matrix.of([upper[min(r, c), max(r, c)] for c in range(3)] for r in range(3))
