"""Velocities of sensors: Tree -> Tape of `motion` (velocities) and `jacobian` (J, with velocities J qd).

With parent h and joint axis e: OM_i = OM_h + e qd and v_i = v_h + OM_h x dpt for a revolute joint; a prismatic joint
adds e qd to v_i instead. The columns of J are (e x r, e) or (e, 0), with r from the joint to the sensor. All vectors
are in the base frame: this takes fewer operations than body frames, in derivatives above all.

`accelerations` differentiates these once more: OMp_i = OMp_h + OM_h x e qd + e qdd, A_i = A_h + K_h dpt with K_h x =
OMp_h x x + OM_h x (OM_h x x), and for a prismatic joint A_i += 2 OM_h x e qd + e qdd instead. With qdd = 0 this is
Jd qd.
"""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.results.poses import Pose, place_bodies
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Sensor, Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


@dataclass(frozen=True)
class Velocity:
    """The velocity of a body."""

    v: Vector[Scalar]  # of its origin
    OM: Vector[Scalar]  # angular velocity


def build_motion(tree: Tree) -> Tape:
    """Write `motion`: inputs q, qd [, p]; outputs v [m/s] and omega [rad/s], shape (3, number of sensors)."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    poses = place_bodies(chain)
    bodies = _move_bodies(chain, poses)
    v = [
        bodies[s.body].v + bodies[s.body].OM.cross(poses[s.body].R.apply(chain.vector(s.position)))
        for s in tree.sensors
    ]
    omega = [bodies[s.body].OM for s in tree.sensors]
    builder.output_dense(ports.VELOCITY, [[column[r] for column in v] for r in range(3)])
    builder.output_dense(ports.ANGULAR_VELOCITY, [[column[r] for column in omega] for r in range(3)])
    return builder.build("motion")


def _move_bodies(chain: Chain, poses: dict[int, Pose]) -> dict[int, Velocity]:
    """Compute velocities of every body, from the base to the leaves; entry 0 is the base."""
    bodies = {0: Velocity(chain.still, chain.still)}
    for link, qd in zip(chain.links, chain.state.qd, strict=True):
        parent = bodies[link.parent]
        v = parent.v + parent.OM.cross(poses[link.parent].R.apply(link.dpt))
        own = poses[link.number].R.column(link.joint.axis).scale(qd)
        bodies[link.number] = Velocity(v, parent.OM + own) if link.is_revolute else Velocity(v + own, parent.OM)
    return bodies


@dataclass(frozen=True)
class Acceleration:
    """The motion of a body, up to its acceleration."""

    OM: Vector[Scalar]  # angular velocity
    OMp: Vector[Scalar]  # angular acceleration
    A: Vector[Scalar]  # acceleration of its origin

    def reach(self, r: Vector[Scalar]) -> Vector[Scalar]:
        """Return the acceleration of a fixed point at r from the origin."""
        return self.A + self.OMp.cross(r) + self.OM.cross(self.OM.cross(r))


def build_accelerations(tree: Tree) -> Tape:
    """Write `accelerations`: inputs q, qd, qdd [, p]; outputs acceleration [m/s2] and alpha [rad/s2], (3, sensors).

    They are J qdd + Jd qd, with the J of `jacobian`.
    """
    builder = Builder()
    state = declare_state(tree, builder, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    poses = place_bodies(chain)
    bodies = _accelerate_bodies(chain, poses)
    found = [bodies[s.body].reach(poses[s.body].R.apply(chain.vector(s.position))) for s in tree.sensors]
    turning = [bodies[s.body].OMp for s in tree.sensors]
    builder.output_dense(ports.ACCELERATION, [[column[r] for column in found] for r in range(3)])
    builder.output_dense(ports.ANGULAR_ACCELERATION, [[column[r] for column in turning] for r in range(3)])
    return builder.build("accelerations")


def _accelerate_bodies(chain: Chain, poses: dict[int, Pose]) -> dict[int, Acceleration]:
    """Compute the motion of every body, from the base to the leaves; entry 0 is the base."""
    bodies = {0: Acceleration(chain.still, chain.still, chain.still)}
    rates = zip(chain.links, chain.state.qd, chain.accelerate(chain.state.qdd), strict=True)
    for link, qd, qdd in rates:
        parent, axis = bodies[link.parent], poses[link.number].R.column(link.joint.axis)
        A, across = parent.reach(poses[link.parent].R.apply(link.dpt)), parent.OM.cross(axis.scale(qd))
        own, change = axis.scale(qd), axis.scale(qdd)
        if link.is_revolute:
            bodies[link.number] = Acceleration(parent.OM + own, parent.OMp + across + change, A)
        else:
            bodies[link.number] = Acceleration(parent.OM, parent.OMp, A + across + across + change)
    return bodies


def build_jacobian(tree: Tree) -> Tape:
    """Write `jacobian`: inputs q [, p]; output J, shape (6 * number of sensors, n), nonzeros only.

    Six rows for each sensor: J qd is its velocity [m/s], then its angular velocity [rad/s]. Only the joints between a
    sensor and the base have entries.
    """
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    poses = place_bodies(chain)
    entries = {
        (6 * k + row, column): value
        for k, sensor in enumerate(tree.sensors)
        for column, rows in _columns(chain, sensor, poses).items()
        for row, value in enumerate(rows)
    }
    builder.output_nonzeros(ports.SENSOR_JACOBIAN, 6 * len(tree.sensors), len(tree.bodies), entries)
    return builder.build("jacobian")


def _columns(chain: Chain, sensor: Sensor, poses: dict[int, Pose]) -> dict[int, list[Scalar]]:
    """Return the nonzero columns of a sensor's Jacobian, by the positions of their coordinates in q."""
    body = poses[sensor.body]
    place = body.p + body.R.apply(chain.vector(sensor.position))
    columns: dict[int, list[Scalar]] = {}
    number = sensor.body
    while number:
        link, pose = chain.links[number - 1], poses[number]
        axis = pose.R.column(link.joint.axis)
        linear, angular = (axis.cross(place - pose.p), axis) if link.is_revolute else (axis, chain.still)
        columns[number - 1] = [*linear, *angular]
        number = link.parent
    return columns
