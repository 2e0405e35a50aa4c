"""The regressor of the inertias: Tree -> Tape of Y(q, qd, qdd), by which the residual is linear in moments of bodies.

    Phi(q, qd, qdd) = Y pi + (all that does not depend on masses),    pi = (m, S, J) of every body

with mass m, first moment S and tensor J about the origin of the body's frame, along the axes that the author gave the
body (C. Atkeson, C. An, J. Hollerbach, Int. J. Robotics Research 5(3), 1986). The force and the moment about the origin
that unit moments take are columns of

    F = A m + K S,    N = J OMp + OM x J OM + S x A,    K = OMp~ + OM~ OM~

and joint i below the body feels e.F, or e.(N + d x F) with d from its origin to the body's: axes of joints are carried
out to the bodies, since the columns of a body share them. A body without inertia has no column with nonzeros.
"""

from __future__ import annotations

from collections.abc import Iterator

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.links import Link
from mbsgen.formulations.states import declare_state
from mbsgen.formulations.textbook import Kinematics, forward_kinematics
from mbsgen.model.tree import ZERO, Body, Tree
from mbsgen.roles import MOMENTS
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape

Column = tuple[Vector[Scalar], Vector[Scalar]]  # a force, and a moment about the body's origin


def build(tree: Tree) -> Tape:
    """Write `regressor`: inputs q, qd, qdd [, theta] [, p]; output Y, shape (n, 10 * bodies), nonzeros only.

    Ten columns for each body, followers included, in the order of `roles.MOMENTS`.
    """
    builder = Builder()
    state = declare_state(tree, builder, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    motion = forward_kinematics(chain, state.qd, chain.accelerate(state.qdd))
    entries: dict[tuple[int, int], Scalar] = {}
    for link, body in zip(chain.links, tree.bodies, strict=True):
        if not has_inertia(body):
            continue
        columns = list_columns(motion[link.number], chain, chain.matrix(body.axes))
        for joint, (along, about) in _carry_axes(chain, link):
            for k, (F, N) in enumerate(columns):
                entry = along.dot(F) + about.dot(N)
                if not entry.is_zero:
                    entries[joint - 1, len(MOMENTS) * (link.number - 1) + k] = entry
    builder.output_nonzeros(ports.REGRESSOR, len(tree.bodies), len(MOMENTS) * len(tree.bodies), entries)
    return builder.build("regressor")


def has_inertia(body: Body) -> bool:
    """Return whether a body, or a part of it, has a mass or an inertia: bodies between joints have none."""
    numbers = [body.mass, *(x for row in body.inertia for x in row)]
    return bool(body.parts) or any(x != ZERO for x in numbers)


def list_columns(motion: Kinematics, chain: Chain, axes: Matrix[Scalar]) -> tuple[Column, ...]:
    """List force and moment, in the body's frame, that a unit of each moment along the given axes (columns) takes."""
    still, OM, OMp = chain.still, motion.OM, motion.OMp
    units = [axes.column(k) for k in range(3)]
    firsts = [(motion.K.apply(e), e.cross(motion.A)) for e in units]

    def turn(a: Vector[Scalar], b: Vector[Scalar]) -> Vector[Scalar]:
        """Return J OMp + OM x J OM of the tensor J = a bT."""
        return a.scale(b.dot(OMp)) + OM.cross(a).scale(b.dot(OM))

    tensors = []
    for i in range(3):
        tensors.append((still, turn(units[i], units[i])))
        tensors += [(still, turn(units[i], units[j]) + turn(units[j], units[i])) for j in range(i + 1, 3)]
    return ((motion.A, still), *firsts, *tensors)


def _carry_axes(chain: Chain, link: Link) -> Iterator[tuple[int, Column]]:
    """Yield each joint below a body, with the weights by which it feels a force and a moment at the body's origin.

    A turn about the axis e feels e.(N + d x F) = (e x d).F + e.N, a slide e.F, all in the body's frame.
    """
    zero, one = chain.builder.zero, chain.builder.number(1.0)
    units = [Vector.of(one if i == k else zero for i in range(3)) for k in range(3)]
    out, d = Matrix.of(units), chain.still  # from the frame of `number` to the body's; its origin to the body's, there
    number = link.number
    while number:
        below = chain.links[number - 1]
        e = out.column(below.joint.axis)
        yield number, (e.cross(d), e) if below.is_revolute else (e, chain.still)
        out = out.times(below.R.transposed)
        d, number = d + out.apply(below.dpt), below.parent
