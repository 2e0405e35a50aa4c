"""Solids that may touch: Tree -> Tape of `meetings`, with their poses and the velocities of one relative to the other.

The velocity of the first solid relative to the other one, both at p, is v + OM x p, with the two rows of three of the
twist: v is that velocity at the origin of the base, OM the relative angular velocity. All vectors are in the base
frame. A joint of axis e and place o adds e and o x e to OM and v, or e to v if it is prismatic; with minus signs for
the joints of the other solid. No force of rigid contacts is in any function.
"""

from __future__ import annotations

from dataclasses import replace

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.results.poses import Pose, place_bodies
from mbsgen.formulations.results.touching import list_carriers
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


def build(tree: Tree) -> Tape:
    """Write `meetings`: inputs q [, p]; outputs place (3, 2 pairs) [m], axes (3, 6 pairs), twist (6 pairs, n).

    Of `twist` only the nonzeros are written.
    """
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, replace(state, qd=[builder.zero] * len(tree.bodies)))
    poses, entries = place_bodies(chain), dict[tuple[int, int], Scalar]()
    places, axes = list[Vector[Scalar]](), list[Vector[Scalar]]()
    for k, pair in enumerate(tree.meetings):
        for solid in (pair.first, pair.other):
            places.append(chain.components(solid.place))
            axes += [chain.components(axis) for axis in solid.axes]
        for c, column in _move(chain, poses, (pair.first.body, pair.other.body)).items():
            entries |= {(6 * k + r, c): x for r, x in enumerate(column)}
    builder.output_dense(ports.SOLID_PLACES, [[x[r] for x in places] for r in range(3)])
    builder.output_dense(ports.SOLID_AXES, [[x[r] for x in axes] for r in range(3)])
    builder.output_nonzeros(ports.SOLID_TWISTS, 6 * len(tree.meetings), len(tree.bodies), entries)
    return builder.build("meetings")


def _move(chain: Chain, poses: dict[int, Pose], bodies: tuple[int, int]) -> dict[int, list[Scalar]]:
    """Return the twist of the first body relative to the other one, by the joints that move either."""
    first, other = (list_carriers(chain, body) for body in bodies)
    columns = {}
    for number in first ^ other:  # joints that carry both move neither
        link, pose = chain.links[number - 1], poses[number]
        axis = pose.R.column(link.joint.axis)
        parts = (pose.p.cross(axis), axis) if link.is_revolute else (axis, chain.still)
        signed = parts if number in first else tuple(-part for part in parts)
        columns[number - 1] = [x for part in signed for x in part]
    return dict(sorted(columns.items()))
