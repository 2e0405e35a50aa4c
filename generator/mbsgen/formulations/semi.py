"""Semi-explicit form (SEMI): Tree -> Tapes of M(q), c(q, qd), and of the residual M qdd + c - Q.

Docquier, Bruls, Fisette, eqs. (16)-(17); Fisette, Samin (1996). c is the Newton-Euler recursion at qdd = 0; a column of
M is the wrench that its joint's unit acceleration asks of everything beyond it, taken as one rigid body (Walker, Orin,
1982), carried down to the base. O(n2) equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.impl import Wrench, residual
from mbsgen.formulations.links import Chain, Link, State, declare_state, joint_forces, write_chain
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape

Entries = dict[tuple[int, int], Scalar]  # of M, by body numbers (ancestor, descendant); others are zero


@dataclass(frozen=True)
class Composite:
    """The bodies beyond a joint as one: moments of mass about the joint, in the joint's body frame."""

    m: Scalar
    S: Vector[Scalar]
    J: Matrix[Scalar]


def build(tree: Tree) -> Tape:
    """Write `semi`: inputs q, qd [, p]; outputs M, shape (n, n), and c, shape (n,)."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False)
    chain, M, c = _terms(tree, builder, state)
    n = len(chain.links)
    full = {(i - 1, j - 1): v for (i, j), v in M.items()} | {(j - 1, i - 1): v for (i, j), v in M.items()}
    builder.output_dense("M", [[full.get((i, j), builder.zero) for j in range(n)] for i in range(n)])
    builder.output_dense("c", [[x] for x in c])
    return builder.build("semi")


def build_residual(tree: Tree) -> Tape:
    """Write `semi_res`: inputs q, qd, qdd, u [, p]; output Phi, shape (n,): M qdd + c - Q."""
    builder = Builder()
    state = declare_state(tree, builder)
    chain, M, c = _terms(tree, builder, state)
    Q = joint_forces(tree, builder, state.u)

    def row(i: int) -> Scalar:
        terms = [v * state.qdd[b + a - i - 1] for (a, b), v in M.items() if i in (a, b)]
        return reduce(add, terms, c[i - 1]) - Q[i - 1]

    builder.output_dense("Phi", [[row(link.number)] for link in chain.links])
    return builder.build("semi_res")


def _terms(tree: Tree, builder: Builder, state: State) -> tuple[Chain, Entries, list[Scalar]]:
    chain = write_chain(tree, builder, state.q, state.p)
    at_rest = [builder.zero] * len(chain.links)
    return chain, mass_matrix(chain), residual(chain, state.qd, at_rest)


def mass_matrix(chain: Chain) -> Entries:
    """Compute one triangle of M; bodies on different branches have no entry."""
    M: Entries = {}
    composites = _compose(chain)
    for link in reversed(chain.links):
        load, at = _unit_load(chain, link, composites[link.number]), link
        M[link.number, link.number] = _along(load, link)
        while at.parent:
            force = at.R.apply(load.F)
            load = Wrench(force, at.R.apply(load.N) + at.dpt.cross(force))
            at = chain.links[at.parent - 1]
            M[at.number, link.number] = _along(load, at)
    return M


def _compose(chain: Chain) -> dict[int, Composite]:
    """From the leaves to the base: gather what each joint carries."""
    composites: dict[int, Composite] = {}
    for link in reversed(chain.links):
        m, S, J = link.m, link.S, link.J
        for child in (x for x in chain.links if x.parent == link.number):
            beyond = composites[child.number]
            turned = child.R.apply(beyond.S)
            J = J + child.R.times(beyond.J).times(child.R.transposed) + _shift(chain, beyond.m, turned, child.dpt)
            S = S + turned + child.dpt.scale(beyond.m)
            m = m + beyond.m
        composites[link.number] = Composite(m, S, J)
    return composites


def _shift(chain: Chain, m: Scalar, S: Vector[Scalar], d: Vector[Scalar]) -> Matrix[Scalar]:
    """Form what J gains when its point of reference moves by -d (Steiner, for a reference off the centre of mass)."""
    second = outer(d, S) + outer(S + d.scale(m), d)
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    zero = chain.builder.zero
    return Matrix.of([trace if r == c else zero for c in range(3)] for r in range(3)) - second


def _unit_load(chain: Chain, link: Link, body: Composite) -> Wrench:
    """Compute the wrench for a unit acceleration of the joint, about the joint."""
    axis, one = link.joint.axis, chain.builder.number(1.0)
    unit = chain.still.along(axis, one)
    if link.is_revolute:
        return Wrench(unit.cross(body.S), body.J.column(axis))
    return Wrench(unit.scale(body.m), body.S.cross(unit))


def _along(load: Wrench, link: Link) -> Scalar:
    return (load.N if link.is_revolute else load.F)[link.joint.axis]
