"""The textbook's Newton-Euler recursion: Phi(q, qd, qdd) in body frames, without any reduction.

Docquier, Bruls, Fisette, eqs. (12)-(15); Luh, Walker, Paul (1980). O(n) equations. Vectors of body i are in body frame
i; gravity enters as acceleration -g of the base. From the base to the leaves, with parent h and joint axis e:

    OM_i = RT OM_h + e qd,    OMp_i = RT OMp_h + (RT OM_h) x e qd + e qdd,    K = OMp~ + OM~ OM~
    A_i = RT (A_h + K_h dpt)                 and, for a prismatic joint instead,  A_i += 2 (RT OM_h) x e qd + e qdd

From the leaves to the base, summed over the children j:

    F_i = m A + K S - Fext + sum R_j F_j,    N_i = J OMp + OM x J OM + S x A - Next + sum (R_j N_j + dpt_j x R_j F_j)

and Phi_i = e.N_i for a revolute joint, e.F_i for a prismatic one, plus the rotor's inertia times qdd.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.chain import Chain
from mbsgen.formulations.links import Link
from mbsgen.tape.builder import Scalar


@dataclass(frozen=True)
class Kinematics:
    """The motion of one body, in its own frame."""

    OM: Vector[Scalar]  # angular velocity
    OMp: Vector[Scalar]  # angular acceleration
    K: Matrix[Scalar]  # OMp~ + OM~ OM~: maps a point's position to its acceleration relative to the origin
    A: Vector[Scalar]  # acceleration of the origin, less gravity


@dataclass(frozen=True)
class Wrench:
    """Force, and moment about the body's origin, in the body's frame."""

    F: Vector[Scalar]
    N: Vector[Scalar]


def residual(chain: Chain, qd: Sequence[Scalar], qdd: Sequence[Scalar]) -> list[Scalar]:
    """Compute Phi(q, qd, qdd): the joint forces of the given motion of the bodies and the rotors."""
    motion = forward_kinematics(chain, qd, qdd)
    load: dict[int, Wrench] = {}
    for link in reversed(chain.links):
        load[link.number] = backward_dynamics(chain, link, motion[link.number], load)
    felt = ((load[x.number].N if x.is_revolute else load[x.number].F)[x.joint.axis] for x in chain.links)
    return [force + rotor * a for force, rotor, a in zip(felt, chain.armatures, qdd, strict=True)]


def forward_kinematics(chain: Chain, qd: Sequence[Scalar], qdd: Sequence[Scalar]) -> dict[int, Kinematics]:
    """Compute velocities and accelerations of every body, from the base to the leaves; entry 0 is the base."""
    zero = chain.still
    motion = {0: Kinematics(zero, zero, Matrix((zero, zero, zero)), -chain.gravity)}
    for link, rate, acceleration in zip(chain.links, qd, qdd, strict=True):
        motion[link.number] = _move(chain, link, motion[link.parent], rate, acceleration)
    return motion


def _move(chain: Chain, link: Link, parent: Kinematics, qd: Scalar, qdd: Scalar) -> Kinematics:
    to_body, axis = link.R.transposed, link.joint.axis
    carried = to_body.apply(parent.OM)
    OMp = to_body.apply(parent.OMp)
    A = to_body.apply(parent.A + parent.K.apply(link.dpt))
    relative = chain.still.along(axis, qd)
    if link.is_revolute:
        OM = carried.along(axis, qd)
        OMp = (OMp + carried.cross(relative)).along(axis, qdd)
    else:
        OM = carried
        A = (A + carried.cross(relative) + carried.cross(relative)).along(axis, qdd)
    i = link.number
    chain.builder.label((*OM, *OMp, *A), [f"{x}{k}_{i}" for x in ("OM", "OMp", "A") for k in "123"])
    return Kinematics(OM, OMp, _acceleration_field(OM, OMp), A)


def _acceleration_field(OM: Vector[Scalar], OMp: Vector[Scalar]) -> Matrix[Scalar]:
    """Form K = OMp~ + OM~ OM~."""
    xx, yy, zz = OM.x * OM.x, OM.y * OM.y, OM.z * OM.z
    xy, xz, yz = OM.x * OM.y, OM.x * OM.z, OM.y * OM.z
    return Matrix.of(
        [
            [-(yy + zz), xy - OMp.z, xz + OMp.y],
            [xy + OMp.z, -(xx + zz), yz - OMp.x],
            [xz - OMp.y, yz + OMp.x, -(xx + yy)],
        ]
    )


def backward_dynamics(chain: Chain, link: Link, motion: Kinematics, load: dict[int, Wrench]) -> Wrench:
    """From the leaves to the base: what the joint of `link` carries (Newton and Euler about the body's origin)."""
    external = _external_load(chain, link)
    F = motion.A.scale(link.m) + motion.K.apply(link.S) - external.F
    N = _gyration(link.J, motion) + link.S.cross(motion.A) - external.N
    for child in (x for x in chain.links if x.parent == link.number):
        force = child.R.apply(load[child.number].F)
        F = F + force
        N = N + child.R.apply(load[child.number].N) + child.dpt.cross(force)
    i = link.number
    chain.builder.label((*F, *N), [f"{x}{k}_{i}" for x in ("F", "N") for k in "123"])
    return Wrench(F, N)


def _external_load(chain: Chain, link: Link) -> Wrench:
    """Add up the external wrenches on a body."""
    F, N = chain.still, chain.still
    for wrench in (x for x in chain.wrenches if x.body == link.number):
        force, moment = wrench.force, wrench.moment
        if wrench.in_base:
            force, moment = (_carry_out(chain, link, v) for v in (force, moment))
        F, N = F + force, N + moment + wrench.position.cross(force)
    return Wrench(F, N)


def _carry_out(chain: Chain, link: Link, v: Vector[Scalar]) -> Vector[Scalar]:
    """Take components from the base frame to the body's."""
    before = _carry_out(chain, chain.links[link.parent - 1], v) if link.parent else v
    return link.R.transposed.apply(before)


def _gyration(J: Matrix[Scalar], motion: Kinematics) -> Vector[Scalar]:
    """Form J OMp + OM x J OM from differences of inertia and the entries of K, which other terms share."""
    K, OM, OMp = motion.K, motion.OM, motion.OMp

    def component(x: int) -> Scalar:
        y, z = (x + 1) % 3, (x + 2) % 3
        return (
            J[x, x] * OMp[x]
            + (J[z, z] - J[y, y]) * (OM[y] * OM[z])
            - J[x, y] * K[z, x]
            + J[x, z] * K[y, x]
            + J[y, z] * (K[y, y] - K[z, z])
        )

    return Vector(component(0), component(1), component(2))
