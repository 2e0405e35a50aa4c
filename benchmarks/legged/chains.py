"""Equations of motion as a user of CasADi writes them: one recursion in axes of the world, over SX.

Newton and Euler's equations of each body, summed from the tips to the base:

    f = m (a - g),    n = c x f + I alpha + omega x I omega,    Phi_i = axis_i . n_i (a turn) or axis_i . f_i (a slide)

with n about the joint's point. At q = 0 all frames are parallel to the base's. Nothing here comes from the generator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

Vector = tuple[float, float, float]
G = 9.81


@dataclass(frozen=True)
class Link:
    """A body, and the joint that carries it."""

    parent: int  # its place in the list of links; -1: the base
    axis: Vector
    place: Vector = (0.0, 0.0, 0.0)  # of the joint, in the parent's frame
    mass: float | ca.SX = 0.0
    com: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[float, ...] = (0.0,) * 6  # xx, yy, zz, xy, xz, yz, about the centre of mass
    turns: bool = True
    armature: float = 0.0  # inertia of the motor's rotor, times the square of the gear ratio


@dataclass(frozen=True)
class Point:
    """A point of a link."""

    link: int
    place: Vector


@dataclass(frozen=True)
class Mechanism:
    """Functions of a mechanism; forces on its points are the columns of a matrix, in axes of the world."""

    n: int
    points: tuple[str, ...]
    residual: ca.Function  # (q, qd, qdd, forces) -> the forces that the joints must give
    momentum: ca.Function  # (q, dv, impulses) -> M dv - J' impulses
    positions: ca.Function  # q -> 3 x points
    velocities: ca.Function  # (q, qd) -> 3 x points


@dataclass(frozen=True)
class _Pose:
    """A link's frame and its motion, in axes of the world."""

    turn: ca.SX
    point: ca.SX
    axis: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    om: ca.SX
    omp: ca.SX


def describe(links: Sequence[Link], points: Mapping[str, Point], gravity: float = G) -> Mechanism:
    """Write the functions of a mechanism."""
    n = len(links)
    q, qd, qdd = ca.SX.sym("q", n), ca.SX.sym("qd", n), ca.SX.sym("qdd", n)
    forces = ca.SX.sym("forces", 3, len(points))
    poses = _move(links, q, qd, qdd, gravity)
    rotors = ca.sparsify(ca.SX(ca.DM([link.armature for link in links])))
    still = _move(links, q, ca.SX(n, 1), qdd, 0.0)
    position, velocity = (ca.horzcat(*x) for x in zip(*(_see(poses[p.link], p) for p in points.values()), strict=True))
    return Mechanism(
        n,
        tuple(points),
        ca.Function("residual", [q, qd, qdd, forces], [_balance(links, poses, points, forces) + rotors * qdd]),
        ca.Function("momentum", [q, qdd, forces], [_balance(links, still, points, forces) + rotors * qdd]),
        ca.Function("positions", [q], [position]),
        ca.Function("velocities", [q, qd], [velocity]),
    )


def _move(links: Sequence[Link], q: ca.SX, qd: ca.SX, qdd: ca.SX, gravity: float) -> list[_Pose]:
    """Find all frames and their motion, from the base to the tips; the base accelerates by -g."""
    none = ca.SX(3, 1)
    ground = _Pose(ca.SX.eye(3), none, none, none, _vector((0.0, 0.0, gravity)), none, none)
    poses: list[_Pose] = []
    for i, link in enumerate(links):
        last = poses[link.parent] if link.parent >= 0 else ground
        axis = last.turn @ _vector(link.axis)
        arm = last.turn @ _vector(link.place)
        turn, om, omp, speed, push = last.turn, last.om, last.omp, none, none
        if link.turns:
            turn = last.turn @ _turn(link.axis, q[i])
            om = last.om + axis * qd[i]
            omp = last.omp + axis * qdd[i] + ca.cross(last.om, axis * qd[i])
        else:
            arm = arm + axis * q[i]
            speed, push = axis * qd[i], axis * qdd[i] + 2 * ca.cross(last.om, axis * qd[i])
        velocity = last.velocity + ca.cross(last.om, arm) + speed
        acceleration = last.acceleration + ca.cross(last.omp, arm) + ca.cross(last.om, ca.cross(last.om, arm)) + push
        poses.append(_Pose(turn, last.point + arm, axis, velocity, acceleration, om, omp))
    return poses


def _balance(links: Sequence[Link], poses: Sequence[_Pose], points: Mapping[str, Point], forces: ca.SX) -> ca.SX:
    """Sum forces and moments from the tips to the base, and return each joint's part."""
    loads: list[tuple[ca.SX, ca.SX]] = []
    for link, pose in zip(links, poses, strict=True):
        com = pose.turn @ _vector(link.com)
        force = link.mass * (pose.acceleration + ca.cross(pose.omp, com) + ca.cross(pose.om, ca.cross(pose.om, com)))
        inertia, om = _inertia(link.inertia), pose.turn.T @ pose.om
        moment = pose.turn @ (inertia @ (pose.turn.T @ pose.omp) + ca.cross(om, inertia @ om)) + ca.cross(com, force)
        loads.append((force, moment))
    for k, point in enumerate(points.values()):
        force, moment = loads[point.link]
        arm = poses[point.link].turn @ _vector(point.place)
        loads[point.link] = (force - forces[:, k], moment - ca.cross(arm, forces[:, k]))
    parts = []
    for i in reversed(range(len(links))):
        link, pose, (force, moment) = links[i], poses[i], loads[i]
        parts.append(ca.dot(pose.axis, moment if link.turns else force))
        if link.parent >= 0:
            arm = pose.point - poses[link.parent].point
            before = loads[link.parent]
            loads[link.parent] = (before[0] + force, before[1] + moment + ca.cross(arm, force))
    return ca.vertcat(*reversed(parts))


def _see(pose: _Pose, point: Point) -> tuple[ca.SX, ca.SX]:
    """Return the position and the velocity of a point."""
    arm = pose.turn @ _vector(point.place)
    return pose.point + arm, pose.velocity + ca.cross(pose.om, arm)


def _turn(axis: Vector, angle: ca.SX) -> ca.SX:
    """Return the matrix that turns about an axis (Rodrigues' formula)."""
    x, y, z = axis
    skew = ca.sparsify(ca.SX(ca.DM([[0, -z, y], [z, 0, -x], [-y, x, 0]])))
    return ca.SX.eye(3) + ca.sin(angle) * skew + (1 - ca.cos(angle)) * (skew @ skew)


def _inertia(entries: Sequence[float]) -> ca.SX:
    xx, yy, zz, xy, xz, yz = entries
    return ca.sparsify(ca.SX(ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])))


def _vector(entries: Sequence[float]) -> ca.SX:
    return ca.sparsify(ca.SX(ca.DM(entries)))
