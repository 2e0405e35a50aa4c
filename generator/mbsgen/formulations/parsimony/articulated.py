"""Order-N accelerations (EXP2): qdd = nu(q, qd, Q) by articulated bodies, in three recursions.

Schwertassek, Rulka (1989); Featherstone (1983; 2008, 7.3). Loads and accelerations of a body are about its origin,
where the body is written: F = M a + B OMp, N = BT a + J OMp. With IA = [M B; BT J], the joint's unit motion e, its
rotor, and the bias load p of the Newton-Euler recursion at qdd = 0, from the leaves to the base:

    U = IA e,    D = e.U + rotor,    K = U / D,    u = Q - e.p
    IA_parent += X (IA - K UT) XT,    p_parent += X (p + K u)

and from the base to the leaves, with the acceleration a' on top of the bias (`Increment`): qdd = u / D - K.a'. Since a'
counts from the bias motion, the product of articulated inertia and bias acceleration never arises. Along the joint's
axis, p + K u is the joint's force, so that it is not computed.

A rotor feels only its joint's own acceleration. So the pivot D contains its inertia, and the rotor takes the fraction
`rotor_share` = rotor / D of the joint's force. The bodies take the rest. Along the axis, the parent then feels
`rotor_share` times the bodies' inertia; without a rotor, nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial, reduce

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.chain import Chain, check_pivot
from mbsgen.formulations.parsimony.mass_matrix import link, own_inertia
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Load, join_loads
from mbsgen.formulations.parsimony.segments import Segment, children
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar


@dataclass(frozen=True)
class Inertia:
    """The articulated inertia of a body at its origin: with all bodies beyond it, whose joints are free."""

    M: Matrix[Scalar]  # symmetric
    B: Matrix[Scalar]
    J: Matrix[Scalar]  # symmetric


@dataclass(frozen=True)
class Body:
    """The terms of a body in the elimination."""

    parts: tuple[Inertia, ...]  # its own inertia, and the articulated inertia beyond each of its joints
    pivot: Scalar  # D: the inertia that its own joint feels
    rotor_share: Scalar  # the part of the pivot that is the rotor's inertia
    KF: Vector[Scalar]  # K: load for a unit force of its joint
    KN: Vector[Scalar]
    left: Inertia  # the articulated inertia that its parent feels, with its joint free


@dataclass(frozen=True)
class Increment:
    """Acceleration on top of the bias: of the origin, and angular."""

    a: Vector[Scalar]
    OMp: Vector[Scalar]


def accelerations(writing: Writing, qd: Sequence[Scalar], Q: Sequence[Scalar]) -> tuple[list[Scalar], dict[int, Body]]:
    """Compute qdd; also return the terms of the elimination."""
    kinematics, inertias = writing.kinematics, writing.inertias
    segments = kinematics.segments
    movements = kinematics.move(writing.chain.gravity, qd, writing.chain.drift)
    bodies = articulate(writing)
    force_residual: dict[int, Scalar] = {}  # u = Q - e.p: the joint force residual of the bias motion
    loads: dict[int, Load] = {}
    for segment in reversed(segments):
        i = segment.number
        force = segment.signed(Q[i - 1])
        bias = join_loads(kinematics, segment, inertias[i], movements[i], loads)
        force_residual[i] = force - (bias.N if segment.is_revolute else bias.F)[segment.axis]
        loads[i] = kinematics.builder.remember(
            ("hook", force_residual[i].ref, force.ref),
            (segment, bias, bodies[i]),
            partial(_hook, segment, bias, bodies[i], force_residual[i], force),
        )
    return _accelerate(kinematics, bodies, force_residual), bodies


def articulate(writing: Writing) -> dict[int, Body]:
    """Compute the articulated inertia of each body and eliminate its joint, from the leaves to the base."""
    kinematics = writing.kinematics
    bodies: dict[int, Body] = {}
    for segment in reversed(kinematics.segments):
        inertia, beyond = writing.inertias[segment.number], children(kinematics.segments, segment.number)
        parts = (*(bodies[c.number] for c in beyond), *(kinematics.frames[c.number] for c in beyond))
        bodies[segment.number] = kinematics.builder.remember(
            ("articulate",),
            (segment, inertia, kinematics.frames[segment.number], *parts),
            lambda: _free(writing.chain, segment, _gather(kinematics, segment, inertia, bodies)),  # noqa: B023  # now
        )
    return bodies


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
        beyond, d = bodies[child.number].left, link(kinematics, child)
        M, B, J = (kinematics.depart_tensor(child, x, faithful=True) for x in (beyond.M, beyond.B, beyond.J))
        parts.append(_shift(b, Inertia(M, B, J), d))
    return tuple(parts)


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
    return Body(parts, pivot, rotor_share, KF, KN, Inertia(M, B, J))


def _hook(segment: Segment, bias: Load, body: Body, force_residual: Scalar, force: Scalar) -> Load:
    """Add a joint's share K u to the bias load; along the axis, this is the joint's force, less the rotor's part."""
    F, N = list(bias.F + body.KF.scale(force_residual)), list(bias.N + body.KN.scale(force_residual))
    (N if segment.is_revolute else F)[segment.axis] = force - body.rotor_share * force_residual
    return Load(Vector.of(F), Vector.of(N), Vector.of(N))


def _accelerate(kinematics: Kinematics, bodies: dict[int, Body], force_residual: dict[int, Scalar]) -> list[Scalar]:
    """Compute the increments and qdd, from the base to the leaves."""
    zero = kinematics.builder.zero
    still = Vector(zero, zero, zero)
    increments = {0: Increment(still, still)}
    qdd = []
    for segment in kinematics.segments:
        parent, body = increments[segment.parent], bodies[segment.number]
        lever = parent.OMp.cross(link(kinematics, segment)) if segment.parent else still
        a, OMp = kinematics.arrive(segment, parent.a + lever), kinematics.arrive(segment, parent.OMp)
        axis = segment.axis
        before = (OMp if segment.is_revolute else a)[axis]
        rest = [(body.KN, OMp), (body.KF, a)]
        total = force_residual[segment.number] / body.pivot
        for K, motion in rest:
            for r in range(3):
                if r != axis or (K is body.KF) == segment.is_revolute:
                    total = total - K[r] * motion[r]
        total = total + body.rotor_share * before
        own = Vector.of(total if r == axis else x for r, x in enumerate(OMp if segment.is_revolute else a))
        increments[segment.number] = Increment(a, own) if segment.is_revolute else Increment(own, OMp)
        qdd.append(segment.signed(total - before))
    return qdd


def cross_matrix(builder: Builder, v: Vector[Scalar]) -> Matrix[Scalar]:
    """Make v~, with v~ w = v x w."""
    zero = builder.zero
    return Matrix.of([[zero, -v.z, v.y], [v.z, zero, -v.x], [-v.y, v.x, zero]])


def symmetric(upper: dict[tuple[int, int], Scalar]) -> Matrix[Scalar]:
    """Make a symmetric matrix of its upper triangle."""
    return Matrix.of([upper[min(r, c), max(r, c)] for c in range(3)] for r in range(3))
