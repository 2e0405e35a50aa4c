"""Poses of bodies and sensors: Tree -> Tape of `sensors` (positions), `attitudes` (rotations) and `frames` (both).

With parent h: R_i = R_h R and p_i = p_h + R_h dpt. All results are in the base frame. The axes of a body are the axes
in the model file, whichever frame the recursions use.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Sensor, Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


@dataclass(frozen=True)
class Pose:
    """The pose of a frame: its origin, and its axes as columns."""

    p: Vector[Scalar]
    R: Matrix[Scalar]


def build_sensors(tree: Tree) -> Tape:
    """Write `sensors`: inputs q [, p]; output position, shape (3, number of sensors) [m]."""
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    columns = [_position(chain, sensor) for sensor in tree.sensors]
    entries = {(r, c): column[r] for c, column in enumerate(columns) for r in range(3)}
    builder.output_dense(ports.POSITION, [[entries[r, c] for c in range(len(columns))] for r in range(3)])
    return builder.build("sensors")


def _position(chain: Chain, sensor: Sensor) -> Vector[Scalar]:
    """Carry a point from its body to the base: one rotation of one vector for each joint on the way."""
    point, number = chain.vector(sensor.position), sensor.body
    while number:
        link = chain.links[number - 1]
        point, number = link.dpt + link.R.apply(point), link.parent
    return point


def build_attitudes(tree: Tree) -> Tape:
    """Write `attitudes`: inputs q [, p]; output attitude, shape (3, 3 * number of sensors)."""
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    columns = [_direction(chain, s, k) for s in tree.sensors for k in range(3)]
    builder.output_dense(ports.ATTITUDE, [[column[r] for column in columns] for r in range(3)])
    return builder.build("attitudes")


def _direction(chain: Chain, sensor: Sensor, k: int) -> Vector[Scalar]:
    """Carry an axis of a sensor from its body to the base."""
    axis, number = chain.matrix(sensor.orientation).column(k), sensor.body
    while number:
        link = chain.links[number - 1]
        axis, number = link.R.apply(axis), link.parent
    return axis


def build_distances(tree: Tree) -> Tape:
    """Write `distances`: inputs q [, p]; output distance, shape (number of points of contact,) [m]."""
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    still = replace(state, qd=[builder.zero] * len(tree.bodies))
    chain = write_chain(tree, builder, still)
    chain.guard_lengths({name for distance in tree.distances for name in distance.owners})
    builder.output_dense(ports.DISTANCE, [[chain.force(distance.symbol)] for distance in tree.distances])
    return builder.build("distances")


def build_frames(tree: Tree) -> Tape:
    """Write `frames`: inputs q [, p]; outputs p (3, F) [m] and R (3, 3 F) of all bodies, then all sensors."""
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    poses = place_bodies(chain)
    drawn = [Pose(poses[i].p, poses[i].R.times(chain.matrix(b.axes))) for i, b in enumerate(tree.bodies, 1)]
    drawn += [_place(poses[s.body], chain.vector(s.position), chain.matrix(s.orientation)) for s in tree.sensors]
    builder.output_dense(ports.ORIGINS, [[pose.p[r] for pose in drawn] for r in range(3)])
    builder.output_dense(ports.ROTATIONS, [[pose.R[r, c] for pose in drawn for c in range(3)] for r in range(3)])
    return builder.build("frames")


def place_bodies(chain: Chain) -> dict[int, Pose]:
    """Compute the pose of every body, from the base to the leaves; entry 0 is the base."""
    one, zero = chain.builder.number(1.0), chain.builder.zero
    unit = Matrix.of([[one if r == c else zero for c in range(3)] for r in range(3)])
    poses = {0: Pose(chain.still, unit)}
    for link in chain.links:
        poses[link.number] = _place(poses[link.parent], link.dpt, link.R)
    return poses


def _place(parent: Pose, position: Vector[Scalar], R: Matrix[Scalar]) -> Pose:
    return Pose(parent.p + parent.R.apply(position), parent.R.times(R))
