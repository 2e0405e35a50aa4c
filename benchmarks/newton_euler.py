"""Write the equations of motion as a user of CasADi does: short recursions with base inertial parameters.

A body is described by mass, first moment and inertia about its joint's point. Inertia that a joint cannot feel moves to
the parent (Gautier, Khalil, 1990): for a revolute joint the mass, the first moment along the axis, and an inertia that
is symmetric about the axis; for a prismatic joint the inertia. The residual is Newton-Euler's recursion; accelerations
are by LDL^T of M = d Phi / d qdd, or by articulated bodies (Featherstone); their Jacobian is -M^-1 d Phi.
Accelerations are of points, not spatial, so no recursion needs velocities of points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from sympy import Expr

from mbsgen.model.tree import Matrix, Motion, Tree, Vector

Array = NDArray[np.float64]
NAMES = ("impl", "semi", "exp1", "exp2", "jac_exp")


@dataclass(frozen=True)
class _Link:
    """A body: its place on its parent, and the inertia that its joint and those before it feel."""

    parent: int  # 0: the base
    axis: int
    turns: bool  # a revolute joint
    position: Array
    axes: Array  # the body's, as columns in the parent's frame, at q = 0
    mass: float
    moment: Array  # first moment
    inertia: Array  # about the joint's point

    @property
    def direction(self) -> ca.SX:
        """Return the joint's axis."""
        axis = ca.SX(3, 1)
        axis[self.axis] = 1
        return axis


@dataclass(frozen=True)
class _Frame:
    """A link at a state: its place, and the part of its acceleration that depends on velocities."""

    turn: ca.SX  # from the parent's frame to the link's
    place: ca.SX  # the joint's point, in the parent's frame
    om: ca.SX  # angular velocity
    omp: ca.SX  # bias of the angular acceleration
    coriolis: ca.SX  # acceleration of the point, in the parent's frame: 2 om x its velocity along a prismatic axis
    centripetal: ca.SX  # om x (om x place), in the parent's frame


def write_functions(tree: Tree, names: Sequence[str] = NAMES) -> dict[str, ca.Function]:
    """Write some of NAMES, with the kernels' arguments: exp1 is by LDL^T, exp2 by articulated bodies."""
    equations = _Equations(tree)
    return {name: getattr(equations, name)() for name in names}


class _Equations:
    """The equations of a tree in its symbols."""

    def __init__(self, tree: Tree) -> None:
        self._links = _regroup(tree)
        self._driven = [i for i, body in enumerate(tree.bodies) if body.joint.actuated]
        self._n, self._m = len(self._links), len(self._driven)
        self._lift = ca.SX(ca.sparsify(-_numbers(tree, tree.gravity)))  # acceleration of the base that gravity is
        n = self._n
        self._q, self._qd, self._qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
        self._u = ca.SX.sym("u", self._m)
        Q = ca.SX(n, 1)
        Q[self._driven] = self._u
        self._Q = ca.densify(Q)

    def impl(self) -> ca.Function:
        """Write Phi(q, qd, qdd) - Q."""
        inputs = [self._q, self._qd, self._qdd, self._u]
        return ca.Function("impl", inputs, [self._torque - self._Q], ["q", "qd", "qdd", "u"], ["Phi"])

    def semi(self) -> ca.Function:
        """Write M and c."""
        return ca.Function("semi", [self._q, self._qd], [self._M, self._bias], ["q", "qd"], ["M", "c"])

    def exp1(self) -> ca.Function:
        """Write the accelerations by factors of M."""
        return self._forward("exp1", [self._found], ["qdd"])

    def exp2(self) -> ca.Function:
        """Write the accelerations by articulated bodies."""
        found = _compute_accelerations(self._links, self._lift, self._q, self._qd, self._Q)
        return self._forward("exp2", [found], ["qdd"])

    def jac_exp(self) -> ca.Function:
        """Write the accelerations' Jacobian, -M^-1 d Phi and the driven columns of M^-1."""
        n, names = self._n, ["q", "qd", "u"]
        by_q, by_qd, _ = self._slopes(self._q, self._qd, self._found)
        right = ca.horzcat(-by_q, -by_qd, ca.SX.eye(n)[:, self._driven])
        blocks = ca.horzsplit(ca.ldl_solve(right, *self._factors), [0, n, 2 * n, 2 * n + self._m])
        return self._forward("jac_exp", blocks, [f"jac_qdd_{x}" for x in names])

    def _forward(self, name: str, results: list[ca.SX], names: list[str]) -> ca.Function:
        return ca.Function(name, [self._q, self._qd, self._u], results, ["q", "qd", "u"], names)

    @cached_property
    def _torque(self) -> ca.SX:
        return _compute_torques(self._links, self._lift, self._q, self._qd, self._qdd)

    @cached_property
    def _bias(self) -> ca.SX:
        return _compute_torques(self._links, self._lift, self._q, self._qd, ca.SX(self._n, 1))

    @cached_property
    def _slopes(self) -> ca.Function:
        inputs = [self._q, self._qd, self._qdd]
        return ca.Function("slopes", inputs, [ca.jacobian(self._torque, x) for x in inputs])

    @cached_property
    def _M(self) -> ca.SX:
        return ca.jacobian(self._torque, self._qdd)

    @cached_property
    def _factors(self) -> tuple[ca.SX, ca.SX, list[int]]:
        D, LT, p = ca.ldl(self._M)
        return D, LT, p

    @cached_property
    def _found(self) -> ca.SX:
        return ca.ldl_solve(self._Q - self._bias, *self._factors)


def _compute_torques(links: Sequence[_Link], lift: ca.SX, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> ca.SX:
    """Compute the joints' forces from accelerations."""
    frames = _place(links, q, qd)
    omps, accelerations, spins = [ca.SX(3, 1)], [lift], [ca.SX(3, 3)]
    forces, moments = [], []
    for link, frame, acceleration in zip(links, frames, ca.vertsplit(qdd), strict=True):
        along = link.direction * acceleration
        omp = frame.turn @ omps[link.parent] + frame.omp
        a = frame.turn @ (accelerations[link.parent] + spins[link.parent] @ frame.place + frame.coriolis)
        omp, a = (omp + along, a) if link.turns else (omp, a + along)
        omps.append(omp)
        accelerations.append(a)
        # U r is the acceleration of the point r, less the origin's
        U = ca.skew(omp) + ca.skew(frame.om) @ ca.skew(frame.om)
        spins.append(U)
        moment, inertia = ca.SX(ca.sparsify(link.moment)), ca.SX(ca.sparsify(link.inertia))
        forces.append(link.mass * a + U @ moment if link.mass else U @ moment)
        moments.append(inertia @ omp + ca.cross(frame.om, inertia @ frame.om) + ca.cross(moment, a))
    torques = []
    for i in reversed(range(len(links))):
        link, frame = links[i], frames[i]
        torques.append((moments if link.turns else forces)[i][link.axis])
        if link.parent:
            force = frame.turn.T @ forces[i]
            forces[link.parent - 1] += force
            moments[link.parent - 1] += frame.turn.T @ moments[i] + ca.cross(frame.place, force)
    return ca.densify(ca.vertcat(*reversed(torques)))


def _compute_accelerations(links: Sequence[_Link], lift: ca.SX, q: ca.SX, qd: ca.SX, Q: ca.SX) -> ca.SX:
    """Compute accelerations by articulated bodies: vectors of six are angular first, inertias about joint points."""
    frames = _place(links, q, qd)
    inertias, forces = zip(*(_describe(link, frame) for link, frame in zip(links, frames, strict=True)), strict=True)
    bodies, biases = list(inertias), list(forces)
    columns, rests = [], []
    for i in reversed(range(len(links))):
        link, frame = links[i], frames[i]
        k = link.axis if link.turns else 3 + link.axis
        column, rest = bodies[i][:, k], Q[i] - biases[i][k]
        columns.append(column)
        rests.append(rest)
        if link.parent:
            left = bodies[i] - column @ column.T / column[k]
            left[k, :] = left[:, k] = 0  # exactly
            left = ca.sparsify(left)
            bias = ca.vertcat(frame.omp, frame.turn @ (frame.centripetal + frame.coriolis))
            felt = biases[i] + left @ bias + column * (rest / column[k])
            turn, shift = ca.diagcat(frame.turn, frame.turn), _shift(frame.place)
            moved = shift.T @ ca.triu2symm(ca.triu(turn.T @ left @ turn)) @ shift
            bodies[link.parent - 1] += ca.triu2symm(ca.triu(moved))
            biases[link.parent - 1] += shift.T @ (turn.T @ felt)
    found: list[ca.SX] = []
    accelerations = [ca.vertcat(ca.SX(3, 1), lift)]
    for link, frame, column, rest in zip(links, frames, reversed(columns), reversed(rests), strict=True):
        carried = _shift(frame.place) @ accelerations[link.parent]
        linear = frame.turn @ (carried[3:] + frame.centripetal + frame.coriolis)
        a = ca.vertcat(frame.turn @ carried[:3] + frame.omp, linear)
        k = link.axis if link.turns else 3 + link.axis
        found.append((rest - column.T @ a) / column[k])
        a[k] += found[-1]
        accelerations.append(a)
    return ca.densify(ca.vertcat(*found))


def _describe(link: _Link, frame: _Frame) -> tuple[ca.SX, ca.SX]:
    """Return a link's inertia, 6 x 6, and the moment and force that its velocity takes."""
    moment, inertia = ca.SX(ca.sparsify(link.moment)), ca.SX(ca.sparsify(link.inertia))
    offset = ca.sparsify(ca.skew(moment))
    mass = ca.SX(ca.sparsify(link.mass * np.eye(3)))
    whole = ca.vertcat(ca.horzcat(inertia, offset), ca.horzcat(offset.T, mass))
    return whole, ca.vertcat(ca.cross(frame.om, inertia @ frame.om), ca.cross(frame.om, ca.cross(frame.om, moment)))


def _place(links: Sequence[_Link], q: ca.SX, qd: ca.SX) -> list[_Frame]:
    """Place all links at coordinates and velocities."""
    frames: list[_Frame] = []
    for link, angle, rate in zip(links, ca.vertsplit(q), ca.vertsplit(qd), strict=True):
        axes, position = ca.SX(ca.sparsify(link.axes)), ca.SX(ca.sparsify(link.position))
        om = frames[link.parent - 1].om if link.parent else ca.SX(3, 1)
        along = link.direction * rate
        if link.turns:
            turn = (axes @ _turn(link.axis, angle)).T
            carried = turn @ om
            spin = ca.cross(carried, along)
            frame = _Frame(turn, position, carried + along, spin, ca.SX(3, 1), ca.cross(om, ca.cross(om, position)))
        else:
            place, slide = position + axes @ link.direction * angle, axes @ along
            coriolis = 2 * ca.cross(om, slide)
            frame = _Frame(axes.T, place, axes.T @ om, ca.SX(3, 1), coriolis, ca.cross(om, ca.cross(om, place)))
        frames.append(frame)
    return frames


def _shift(place: ca.SX) -> ca.SX:
    """Return the matrix from the acceleration of the origin to the acceleration of a point, both angular first."""
    one = ca.SX.eye(3)
    return ca.vertcat(ca.horzcat(one, ca.SX(3, 3)), ca.horzcat(-ca.sparsify(ca.skew(place)), one))


def _regroup(tree: Tree) -> list[_Link]:
    """Move from every body to its parent the inertia that its joint cannot feel; the base drops it."""
    links: list[_Link] = []
    count = len(tree.bodies) + 1
    masses, moments, inertias = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))  # the share of children
    for number, body in reversed(list(enumerate(tree.bodies, 1))):
        com, k, turns = _numbers(tree, body.com), body.joint.axis, body.joint.motion is Motion.REVOLUTE
        own = float(_numbers(tree, (body.mass,))[0])
        mass, moment = masses[number] + own, moments[number] + own * com
        inertia = inertias[number] + _numbers(tree, body.inertia) - own * _squared(com)
        position, axes = _numbers(tree, body.position), _numbers(tree, body.orientation)
        if turns:
            given = np.eye(3) * inertia[k - 1, k - 1]
            given[k, k] = 0.0
            given_mass, along = mass, np.eye(3)[k] * moment[k]
        else:
            given, given_mass, along = inertia, 0.0, np.zeros(3)
        kept = mass - given_mass, moment - along, inertia - given
        links.append(_Link(body.parent, k, turns, position, axes, *kept))
        turned = axes @ along
        inertias[body.parent] += axes @ given @ axes.T - _squared(position, turned) - _squared(turned, position)
        inertias[body.parent] -= given_mass * _squared(position)
        moments[body.parent] += turned + given_mass * position
        masses[body.parent] += given_mass
    return links[::-1]


def _squared(a: Array, b: Array | None = None) -> Array:
    """Return the matrix of v -> a x (b x v); b is a by default."""
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
