"""Condition: Tree -> Tape of `condition`, which estimates the rounding errors of accelerations by EXP1 and EXP2.

(M^-1)_ii is the acceleration of joint i for a unit of its force, with all joints free. 1 / M_ii is the same with all
other joints held. M_ii (M^-1)_ii is 1 where the other joints do not matter, and grows without bound towards a lock:
there, elimination subtracts nearly all of M_ii. These products are the diagonal of C^-1 with C = D^-1/2 M D^-1/2, D =
diag(M). So cond(C) lies between the largest product and n times their sum, whatever the units.

The articulated recursion subtracts elsewhere. Omega of a body is the 6 x 6 matrix of its operational-space compliance:
the acceleration of its origin for a unit of force and moment there (Kreutz-Delgado, Jain, Rodriguez, 1992). It is also
the derivative of log det M, the sum of the logarithms of the pivots, by the body's articulated inertia IA. A relative
rounding u of the entries of IA therefore changes the pivots by up to the sum of u |Omega| |IA| over the entries. EXP2
rounds the terms that it adds to IA, and the part of IA that moves to the parent; both are counted, in the frames of
EXP2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from operator import add

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.parsimony.articulated import Body, articulate, find_together
from mbsgen.formulations.parsimony.mass_matrix import Composite, Inertia, compose, link
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.segments import Segment, align
from mbsgen.formulations.parsimony.writing import Writing, begin
from mbsgen.formulations.planning import find_plans
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Op, Tape

Square = list[list[Scalar]]  # 6 x 6: acceleration of the origin, angular acceleration


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `condition`: inputs q [, p]; outputs elimination and articulated, shape (n,). It has no guard.

    Relative to the largest acceleration, EXP1 errs by about epsilon times the largest entry of `elimination`, EXP2 by
    about epsilon times the largest entry of `articulated`. A value that is not finite means that no digit is left.
    """
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    # M does not depend on wrenches, so their inputs are not declared
    chain = write_chain(replace(tree, wrenches=()), builder, state)
    segments = align(chain, group=reductions.share_frames)
    # the diagonal of M is read off composite bodies, which hold all that they carry
    writing = begin(chain, segments, find_plans(tree, reductions).articulated.carried_down, reductions)
    bodies = articulate(writing)
    held = _hold(writing)
    free, lost = give_way(writing.kinematics, bodies)
    numbers = range(1, len(segments) + 1)
    eliminated = {i: _size(held[i] * free[i]) for i in numbers}
    together = find_together(writing.kinematics)
    articulated = (lost[i] + eliminated[i] if i in together else lost[i] for i in numbers)
    builder.output_dense(ports.ELIMINATION, [[x] for x in eliminated.values()])
    builder.output_dense(ports.ARTICULATED, [[x] for x in articulated])
    return builder.build("condition")


def _hold(writing: Writing) -> dict[int, Scalar]:
    """Compute the diagonal of M: the inertia of each joint with all others held."""
    composites: dict[int, Composite] = {}
    diagonal = {}
    for s in reversed(writing.kinematics.segments):
        body = compose(writing.kinematics, s, writing.inertias[s.number], composites)
        composites[s.number] = body
        felt = body.J[s.axis, s.axis] if s.is_revolute else body.m
        diagonal[s.number] = felt + writing.chain.armatures[s.number - 1]
    return diagonal


def give_way(kinematics: Kinematics, bodies: Mapping[int, Body]) -> tuple[dict[int, Scalar], dict[int, Scalar]]:
    """Compute the diagonal of M^-1 and the effect of rounding on the pivots, by joint, from the base to the leaves."""
    b = kinematics.builder
    compliances: dict[int, Square] = {0: [[b.zero] * 6 for _ in range(6)]}
    free, lost = {}, {}
    for s in kinematics.segments:
        body, along = bodies[s.number], s.axis + (3 if s.is_revolute else 0)
        before = _arrive(kinematics, s, compliances[s.parent])
        K = [-body.rotor_share if r == along else x for r, x in enumerate((*body.KF, *body.KN))]
        taken = [_dot(row, K) for row in before]
        own = b.number(1.0) / body.pivot + _dot(taken, K)
        free[s.number] = own + taken[along] + taken[along] + before[along][along]
        after = [[-taken[r] if c == along else x for c, x in enumerate(row)] for r, row in enumerate(before)]
        after[along] = [own if c == along else -x for c, x in enumerate(taken)]
        compliances[s.number] = after
        lost[s.number] = b.number(1.0) + _weigh(before, (body.left,))
        if body.pivot.is_literal:  # computed in 60 digits, as all literals: only the final differences are rounded
            lost[s.number] = lost[s.number] + _weigh(before, body.parts, body.left)
        else:
            lost[s.number] = lost[s.number] + _weigh(after, body.parts)
    return free, lost


def _arrive(kinematics: Kinematics, segment: Segment, square: Square) -> Square:
    """Refer a compliance from the parent's origin to the origin of `segment`, beyond its joint."""
    half = [_arrive_column(kinematics, segment, column) for column in zip(*square, strict=True)]
    return [_arrive_column(kinematics, segment, column) for column in zip(*half, strict=True)]


def _arrive_column(kinematics: Kinematics, segment: Segment, column: Sequence[Scalar]) -> list[Scalar]:
    a, OMp = Vector.of(column[:3]), Vector.of(column[3:])
    if segment.parent:
        a = a + OMp.cross(link(kinematics, segment))
    return [*kinematics.arrive(segment, a), *kinematics.arrive(segment, OMp)]


def _dot(row: Sequence[Scalar], other: Sequence[Scalar]) -> Scalar:
    return reduce(add, (x * y for x, y in zip(row, other, strict=True)))


def _weigh(compliance: Square, inertias: Sequence[Inertia], left: Inertia | None = None) -> Scalar:
    """Return the sum of |Omega| |I| over the entries; with `left`, only over entries that were subtracted from."""
    total = compliance[0][0].builder.zero
    for r, row in enumerate(compliance):
        for c, x in enumerate(row):
            entries = [_entry(inertia, r, c) for inertia in inertias]
            felt = [_size(y) for y in entries if not y.is_zero]
            if felt and (left is None or _is_difference(_entry(left, r, c), entries)):
                total = total + _size(x) * reduce(add, felt)
    return total


def _is_difference(left: Scalar, entries: Sequence[Scalar]) -> bool:
    """Return whether something known only at run time was subtracted."""
    return not left.is_literal and left.ref not in [entry.ref for entry in entries]


def _entry(inertia: Inertia, row: int, column: int) -> Scalar:
    """Return an entry of [M, B; BT, J]."""
    block = ((inertia.M, inertia.B), (inertia.B.transposed, inertia.J))[row // 3][column // 3]
    return block[row % 3, column % 3]


def _size(x: Scalar) -> Scalar:
    return x if x.is_zero else x.builder.apply(Op.ABS, x)
