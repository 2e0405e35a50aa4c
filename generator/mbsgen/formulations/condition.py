"""Condition: Tree -> Tape of `condition`, which tells how many roundings an acceleration by EXP1 or EXP2 is off by.

M^-1 has two faces. (M^-1)_ii is what joint i gives way for a unit of its force, with all joints free; M_ii is what it
resists with all others held. Their product is 1 where the others do not matter, and grows without bound towards a
lock: elimination subtracts all but that part from M_ii. It is the diagonal of C^-1, C = D^-1/2 M D^-1/2 with D the
diagonal of M, so that cond(C) lies between its largest entry and n times its sum; units do not matter.

The articulated recursion subtracts elsewhere. Omega of a body is the 6 x 6 matrix of what its origin gives way for a
unit of force and moment there (Kreutz-Delgado, Jain, Rodriguez, 1992); it is also the derivative of log det M, the sum
of the logarithms of the pivots, by the body's articulated inertia. So a rounding of its entries by a part u of them
changes the pivots by up to u |Omega| |IA|, added up over the entries: of all that EXP2 adds up to IA, and of what it
leaves of IA to the parent, in the frames that EXP2 writes them in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from operator import add

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations.links import declare_state, write_chain
from mbsgen.formulations.parsimony.articulated import Body, Inertia, articulate
from mbsgen.formulations.parsimony.mass_matrix import Composite, compose, link
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.segments import Segment, align
from mbsgen.formulations.parsimony.writing import Writing, begin
from mbsgen.formulations.planning import find_plans
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Op, Tape

Square = list[list[Scalar]]  # 6 x 6: acceleration of the origin, angular acceleration


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `condition`: inputs q [, p]; outputs elimination and articulated, shape (n,). It has no guard.

    A result of EXP1 errs by about epsilon times the largest of `elimination`, one of EXP2 by epsilon times the largest
    of `articulated`, relative to the largest acceleration. What is not finite tells that no digit is left.
    """
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(replace(tree, wrenches=()), builder, state)  # M knows none; their inputs are not declared
    segments = align(chain, group=reductions.share_frames)
    writing = begin(chain, segments, find_plans(tree, reductions).articulated, reductions)
    bodies = articulate(writing)
    held = _hold(writing)
    free, lost = _give_way(writing.kinematics, bodies)
    n = len(segments)
    builder.output_dense("elimination", [[_size(held[i] * free[i])] for i in range(1, n + 1)])
    builder.output_dense("articulated", [[lost[i]] for i in range(1, n + 1)])
    return builder.build("condition")


def _hold(writing: Writing) -> dict[int, Scalar]:
    """Compute the diagonal of M: what each joint feels with all others held."""
    composites: dict[int, Composite] = {}
    diagonal = {}
    for s in reversed(writing.kinematics.segments):
        body = compose(writing.kinematics, s, writing.inertias[s.number], composites)
        composites[s.number] = body
        felt = body.J[s.axis, s.axis] if s.is_revolute else body.m
        diagonal[s.number] = felt + writing.chain.armatures[s.number - 1]
    return diagonal


def _give_way(kinematics: Kinematics, bodies: Mapping[int, Body]) -> tuple[dict[int, Scalar], dict[int, Scalar]]:
    """From the base to the leaves: the diagonal of M^-1, and what rounding does to the pivots, by joint."""
    b = kinematics.builder
    compliances: dict[int, Square] = {0: [[b.zero] * 6 for _ in range(6)]}
    free, lost = {}, {}
    for s in kinematics.segments:
        body, along = bodies[s.number], s.axis + (3 if s.is_revolute else 0)
        before = _arrive(kinematics, s, compliances[s.parent])
        K = [-body.rotor_share if r == along else x for r, x in enumerate((*body.KF, *body.KN))]  # less the axis itself
        taken = [_dot(row, K) for row in before]
        own = b.number(1.0) / body.pivot + _dot(taken, K)
        free[s.number] = own + taken[along] + taken[along] + before[along][along]
        after = [[-taken[r] if c == along else x for c, x in enumerate(row)] for r, row in enumerate(before)]
        after[along] = [own if c == along else -x for c, x in enumerate(taken)]
        compliances[s.number] = after
        lost[s.number] = b.number(1.0) + _weigh(before, (body.left,))
        if (
            body.pivot.is_literal
        ):  # it was found by more digits than rounding leaves, and so was what is left of numbers
            lost[s.number] = lost[s.number] + _weigh(before, body.parts, body.left)
        else:
            lost[s.number] = lost[s.number] + _weigh(after, body.parts)
    return free, lost


def _arrive(kinematics: Kinematics, segment: Segment, square: Square) -> Square:
    """Take a compliance from the parent's origin to that of `segment`, which its joint carries."""
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
    """Add up |Omega| |I| over the entries; given what is left of them, over those that it is a difference of."""
    total = compliance[0][0].builder.zero
    for r, row in enumerate(compliance):
        for c, x in enumerate(row):
            entries = [_entry(inertia, r, c) for inertia in inertias]
            felt = [_size(y) for y in entries if not y.is_zero]
            if felt and (left is None or _is_difference(_entry(left, r, c), entries)):
                total = total + _size(x) * reduce(add, felt)
    return total


def _is_difference(left: Scalar, entries: Sequence[Scalar]) -> bool:
    """Tell whether something was subtracted that is known at run time only."""
    return not left.is_literal and left.ref not in [entry.ref for entry in entries]


def _entry(inertia: Inertia, row: int, column: int) -> Scalar:
    """Look an entry up: [M, B; BT, J]."""
    block = ((inertia.M, inertia.B), (inertia.B.transposed, inertia.J))[row // 3][column // 3]
    return block[row % 3, column % 3]


def _size(x: Scalar) -> Scalar:
    return x if x.is_zero else x.builder.apply(Op.ABS, x)
