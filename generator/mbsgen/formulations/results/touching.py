"""Rigid contacts: Tree -> Tape of `touching`, with all that a cone problem needs of the points of contact.

With p the point at which two sides touch, or would touch, and the joints between each side and the base, the velocity
of the first side relative to the other one, both at p, is a sum over joints of axis e and place o:

    slide qd = sum of +- (e x (p - o)) qd, of revolute joints, or +- e qd, of prismatic ones

with plus signs for the joints that carry the first side, minus signs for the joints of the other one. All vectors
are in the base frame. A rigid stop at a number of the pose has no point: it counts as one that moves along x, with the
rate of the number, whose derivatives by the velocities are generalised forces of wrenches (F, N), by virtual power:

    e . (N + (p - o) x F) of revolute joints, e . F of prismatic ones.

No force of a rigid contact or stop is in any function.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.results.poses import Pose, place_bodies
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import IDENTITY, Barrier, Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


def build(tree: Tree) -> Tape:
    """Write `touching`: inputs q [, p]; outputs clearance (points,) [m], direction (3, points), slide (3 points, n).

    Of `slide` only the nonzeros are written.
    """
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, replace(state, qd=[builder.zero] * len(tree.bodies)))
    points = [(x.symbol, x.rigid) for x in tree.distances if x.rigid is not None]
    chain.guard_lengths({name for x in tree.distances if x.rigid is not None for name in x.owners})
    poses = place_bodies(chain)
    normals, entries = [], dict[tuple[int, int], Scalar]()
    for k, (_, rigid) in enumerate(points):
        if isinstance(rigid, Barrier):
            normals.append(chain.components(IDENTITY[0]))
            entries |= {(3 * k, c): x for c, x in _differentiate(chain, poses, rigid).items()}
            continue
        normals.append(chain.components(rigid.normal))
        place = chain.components(rigid.point)
        columns = _move(chain, poses, rigid.bodies, place)
        entries |= {(3 * k + r, c): x for c, column in columns.items() for r, x in enumerate(column)}
    builder.output_dense(ports.CLEARANCE, [[chain.force(symbol)] for symbol, _ in points])
    builder.output_dense(ports.CONTACT_NORMAL, [[n[r] for n in normals] for r in range(3)])
    builder.output_nonzeros(ports.CONTACT_JACOBIAN, 3 * len(points), len(tree.bodies), entries)
    return builder.build("touching")


def _move(
    chain: Chain, poses: dict[int, Pose], bodies: tuple[int, int], place: Vector[Scalar]
) -> dict[int, Vector[Scalar]]:
    """Return the velocity of the first body relative to the other one at a place, by the joints that move either."""
    first, other = (list_carriers(chain, body) for body in bodies)
    columns = {}
    for number in first ^ other:  # joints that carry both move neither
        link, pose = chain.links[number - 1], poses[number]
        axis = pose.R.column(link.joint.axis)
        column = axis.cross(place - pose.p) if link.is_revolute else axis
        columns[number - 1] = column if number in first else -column
    return dict(sorted(columns.items()))


def _differentiate(chain: Chain, poses: dict[int, Pose], barrier: Barrier) -> dict[int, Scalar]:
    """Return the derivatives of a number of the pose by the velocities that change it."""
    numbers = {body.joint.name: i for i, body in enumerate(chain.tree.bodies)}
    terms = defaultdict[int, list[Scalar]](list)
    for name, push in barrier.joints:
        terms[numbers[name]].append(chain.force(push))
    for wrench in barrier.wrenches:
        assert wrench.force is not None
        assert wrench.moment is not None, "the wrenches of a stop are known"
        F, N, pose = chain.components(wrench.force), chain.components(wrench.moment), poses[wrench.body]
        place = pose.p + pose.R.apply(chain.vector(wrench.position))
        for number in list_carriers(chain, wrench.body):
            link, own = chain.links[number - 1], poses[number]
            axis = own.R.column(link.joint.axis)
            terms[number - 1].append(axis.dot(N + (place - own.p).cross(F)) if link.is_revolute else axis.dot(F))
    return {c: sum(parts[1:], start=parts[0]) for c, parts in sorted(terms.items())}


def list_carriers(chain: Chain, body: int) -> set[int]:
    """Return a body and all bodies between it and the base."""
    found = set()
    while body:
        found.add(body)
        body = chain.links[body - 1].parent
    return found
