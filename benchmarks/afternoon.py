"""What a good afternoon gives: Newton-Euler in CasADi's SX with base inertial parameters, and CasADi's derivatives.

Bodies are told by mass, first moment and inertia about the joint's point. What of them the joint cannot feel (mass, the
first moment along the axis, an inertia that is symmetric about it) is moved to the parent (Gautier, Khalil, 1990).
Accelerations are by elimination in M = d Phi / d qdd, their Jacobian -M^-1 d Phi.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from sympy import Expr

from mbsgen.model.tree import Matrix, Tree, Vector

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Link:
    """A body of a chain: its place on its parent, and what is left of its inertia."""

    axis: int
    position: Array
    axes: Array  # the body's, as columns in the parent's frame, at q = 0
    moment: Array  # first moment; no mass is left
    inertia: Array  # about the joint's point


def write_functions(tree: Tree) -> dict[str, ca.Function]:
    """Write impl, exp and jac_exp of a chain of revolute joints."""
    links = _regroup(tree)
    driven = [i for i, body in enumerate(tree.bodies) if body.joint.actuated]
    n, m = len(links), len(driven)
    q, qd, qdd, u = (ca.SX.sym(name, size) for name, size in (("q", n), ("qd", n), ("qdd", n), ("u", m)))
    Q = ca.SX(n, 1)
    Q[driven] = u
    torque = _recursion(links, -_numbers(tree, tree.gravity), q, qd, qdd)
    Phi = torque - ca.densify(Q)
    impl = ca.Function("impl", [q, qd, qdd, u], [Phi], ["q", "qd", "qdd", "u"], ["Phi"])
    slopes = ca.Function("slopes", [q, qd, qdd], [ca.jacobian(torque, x) for x in (q, qd, qdd)])
    M = slopes(q, qd, qdd)[2]
    D, LT, p = ca.ldl(M)
    found = ca.ldl_solve(-impl(q, qd, ca.SX(n, 1), u), D, LT, p)
    by_q, by_qd, _ = slopes(q, qd, found)
    right = ca.horzcat(-by_q, -by_qd, ca.SX.eye(n)[:, driven])
    blocks = ca.horzsplit(ca.ldl_solve(right, D, LT, p), [0, n, 2 * n, 2 * n + m])
    forward, names = [q, qd, u], ["q", "qd", "u"]
    return {
        "impl": impl,
        "exp": ca.Function("exp", forward, [found], names, ["qdd"]),
        "jac_exp": ca.Function("jac_exp", forward, blocks, names, [f"jac_qdd_{x}" for x in names]),
    }


def _recursion(links: list[_Link], lift: Array, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> ca.SX:
    """Compute the joints' torques; `lift` is the acceleration of the base that stands for gravity."""
    om, omp, a, U = ca.SX(3, 1), ca.SX(3, 1), ca.SX(lift), ca.SX(3, 3)
    turns, forces, moments = [], [], []
    for i, link in enumerate(links):
        axis = ca.SX(3, 1)
        axis[link.axis] = 1
        turn = (ca.SX(ca.sparsify(link.axes)) @ _turn(link.axis, q[i])).T  # from the parent's frame to the link's
        r = ca.SX(ca.sparsify(link.position))
        a = turn @ (a + U @ r)
        carried = turn @ om
        om = carried + axis * qd[i]
        omp = turn @ omp + axis * qdd[i] + ca.cross(carried, axis * qd[i])
        U = ca.skew(omp) + ca.skew(om) @ ca.skew(om)  # what U does to a point's place is its acceleration
        moment, inertia = ca.SX(ca.sparsify(link.moment)), ca.SX(ca.sparsify(link.inertia))
        turns.append(turn)
        forces.append(U @ moment)  # the mass has been moved away
        moments.append(inertia @ omp + ca.cross(om, inertia @ om) + ca.cross(moment, a))
    torques = []
    for i in reversed(range(len(links))):
        torques.append(moments[i][links[i].axis])
        if i:
            force = turns[i].T @ forces[i]
            forces[i - 1] += force
            moments[i - 1] += turns[i].T @ moments[i] + ca.cross(ca.SX(ca.sparsify(links[i].position)), force)
    return ca.densify(ca.vertcat(*reversed(torques)))


def _regroup(tree: Tree) -> list[_Link]:
    """Move from every body to the one before what its joint cannot feel; the first body's goes to the base."""
    links: list[_Link] = []
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))  # what the body after has left for this one
    for body in reversed(tree.bodies):
        com, k = _numbers(tree, body.com), body.joint.axis
        own = float(_numbers(tree, (body.mass,))[0])
        mass, moment = mass + own, moment + own * com
        inertia = inertia + _numbers(tree, body.inertia) - own * _squared(com)
        position, axes = _numbers(tree, body.position), _numbers(tree, body.orientation)
        given = np.eye(3) * inertia[k - 1, k - 1]
        given[k, k] = 0.0
        along = np.eye(3)[k] * moment[k]
        links.append(_Link(k, position, axes, moment - along, inertia - given))
        turned = axes @ along
        inertia = axes @ given @ axes.T - _squared(position, turned) - _squared(turned, position)
        inertia -= mass * _squared(position)
        moment = turned + mass * position
    return links[::-1]


def _squared(a: Array, b: Array | None = None) -> Array:
    """Give the matrix of v -> a x (b x v); b is a where it is not given."""
    b = a if b is None else b
    return np.outer(b, a) - np.eye(3) * float(a @ b)


def _turn(axis: int, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = ca.SX(3, 3)
    turn[axis, axis] = 1
    turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
    return turn


def _numbers(tree: Tree, expressions: Vector | Matrix | tuple[Expr, ...]) -> Array:
    values = {parameter.symbol: parameter.value for parameter in tree.parameters}
    entries = np.array(expressions, dtype=object)
    return np.array([float(x.subs(values)) for x in entries.ravel()]).reshape(entries.shape)
