"""Energy and momentum: Tree -> Tapes of `energy` and `power`, in which every body counts unreduced.

Mass m, first moment S, momentum P and moment of momentum H of all bodies beyond a joint are summed from the leaves to
the base:

    P = m v + OM x S,    H = J OM + S x v,    (M qd)_i = e.H (revolute) or e.P (prismatic)
    T = 1/2 sum qd_i (M qd)_i + 1/2 sum rotor_i qd_i2,    V = -g.S_whole

So the kinetic energy takes one more product for each joint. A rotor has the energy of its spin relative to the body
that holds it, and no momentum: its drive acts between two bodies.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, joint_forces, write_chain
from mbsgen.formulations.links import AppliedWrench, Link
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


@dataclass(frozen=True)
class Velocity:
    """The velocity of a body, in its own frame."""

    v: Vector[Scalar]  # of its origin
    OM: Vector[Scalar]  # angular velocity


@dataclass(frozen=True)
class Momentum:
    """Mass, its first moment, momentum and moment of momentum, about one origin and in its frame."""

    m: Scalar
    S: Vector[Scalar]
    P: Vector[Scalar]
    H: Vector[Scalar]

    def __add__(self, other: Momentum) -> Momentum:
        return Momentum(self.m + other.m, self.S + other.S, self.P + other.P, self.H + other.H)


def build(tree: Tree) -> Tape:
    """Write `energy`: inputs q, qd [, p]; outputs in the base frame, about its origin.

    kinetic and potential, shape (1,) [J], the potential being 0 with all mass at the origin; momentum (3,) [kg m/s],
    angular_momentum (3,) [kg m2/s], com (3,): the centre of mass [m], unless
    no body has a mass, at the numbers of the model file.
    """
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    carried = _add_up(chain)
    twice = reduce(add, (_along(x, carried[x.number]) * qd for x, qd in zip(chain.links, state.qd, strict=True)))
    twice = reduce(add, (rotor * qd * qd for rotor, qd in zip(chain.armatures, state.qd, strict=True)), twice)
    whole = reduce(add, (_refer(x, carried[x.number]) for x in chain.links if not x.parent), _nothing(chain))
    builder.output_dense(ports.KINETIC, [[builder.number(0.5) * twice]])
    builder.output_dense(ports.POTENTIAL, [[-chain.gravity.dot(whole.S)]])
    builder.output_dense(ports.MOMENTUM, [[x] for x in whole.P])
    builder.output_dense(ports.ANGULAR_MOMENTUM, [[x] for x in whole.H])
    if not whole.m.is_zero and _has_mass(tree):
        builder.output_dense(ports.CENTRE_OF_MASS, [[x / whole.m] for x in whole.S])
    return builder.build("energy")


def _has_mass(tree: Tree) -> bool:
    """Return whether a body has a mass, at the numbers of the model file."""
    values = {parameter.symbol: parameter.value for parameter in tree.parameters}
    masses = (mass for body in tree.bodies for mass in (body.mass, *(part.mass for part in body.parts)))
    return any(mass.xreplace(values) != 0 for mass in masses)


def build_power(tree: Tree) -> Tape:
    """Write `power`: inputs q, qd, u [, w] [, p]; output power, shape (1,) [W], of all forces except gravity."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False)
    chain = write_chain(tree, builder, state)
    bodies = _move_bodies(chain) if chain.wrenches else {}
    total = reduce(add, (force * qd for force, qd in zip(joint_forces(chain), state.qd, strict=True)))
    total = reduce(add, (_power(chain, wrench, bodies[wrench.body]) for wrench in chain.wrenches), total)
    builder.output_dense(ports.POWER, [[total]])
    return builder.build("power")


def _power(chain: Chain, wrench: AppliedWrench, body: Velocity) -> Scalar:
    """Compute the power of an external wrench."""
    v, OM = body.v + body.OM.cross(wrench.position), body.OM
    number = wrench.body if wrench.in_base else 0
    while number:
        link = chain.links[number - 1]
        v, OM, number = link.R.apply(v), link.R.apply(OM), link.parent
    return wrench.force.dot(v) + wrench.moment.dot(OM)


def _nothing(chain: Chain) -> Momentum:
    return Momentum(chain.builder.zero, chain.still, chain.still, chain.still)


def _add_up(chain: Chain) -> dict[int, Momentum]:
    """Compute the momentum beyond each joint, about the joint and in its body's frame, from the leaves to the base."""
    bodies = _move_bodies(chain)
    carried: dict[int, Momentum] = {}
    for link in reversed(chain.links):
        beyond = (_refer(x, carried[x.number]) for x in chain.links if x.parent == link.number)
        carried[link.number] = reduce(add, beyond, _own(link, bodies[link.number]))
    return carried


def _move_bodies(chain: Chain) -> dict[int, Velocity]:
    """Compute velocities of every body, from the base to the leaves; entry 0 is the base."""
    bodies = {0: Velocity(chain.still, chain.still)}
    for link, qd in zip(chain.links, chain.state.qd, strict=True):
        parent, to_body, axis = bodies[link.parent], link.R.transposed, link.joint.axis
        v, OM = to_body.apply(parent.v + parent.OM.cross(link.dpt)), to_body.apply(parent.OM)
        own = Velocity(v, OM.along(axis, qd)) if link.is_revolute else Velocity(v.along(axis, qd), OM)
        bodies[link.number] = own
    return bodies


def _own(link: Link, body: Velocity) -> Momentum:
    P = body.v.scale(link.m) + body.OM.cross(link.S)
    return Momentum(link.m, link.S, P, link.J.apply(body.OM) + link.S.cross(body.v))


def _refer(link: Link, own: Momentum) -> Momentum:
    """Refer the momentum beyond a joint to its parent's origin, in the parent's frame."""
    S, P = link.R.apply(own.S) + link.dpt.scale(own.m), link.R.apply(own.P)
    return Momentum(own.m, S, P, link.R.apply(own.H) + link.dpt.cross(P))


def _along(link: Link, carried: Momentum) -> Scalar:
    """Return the component along a joint: its row of M qd."""
    return (carried.H if link.is_revolute else carried.P)[link.joint.axis]
