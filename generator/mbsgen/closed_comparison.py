"""Closed loops compared with Pinocchio's kinematics: forces of loops and accelerations at closed states.

Pinocchio's reader has no loops. So the loops are closed beside its model, by the velocities and accelerations of their
two ends. With r = R1' (p2 - p1), the way between the ends along the axes of the first one, and w the angular velocity
of the second one against the first, a loop keeps some components of r' and of w at 0:

    r' = R1' (v2 - v1 - w1 x d),    r'' = R1' (a2 - a1 - al1 x d - w1 x (w1 x d) - 2 w1 x (v2 - v1 - w1 x d)).

These rows J and their bias give M qdd + c = J' lam, J qdd + bias = 0. Redundant rows change neither qdd nor J' lam.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.assembly.mechanism import Mechanism
from mbsgen.assembly.poses import find_solved, walk
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.model.symbols import to_double
from mbsgen.model.tree import Cut, LoopFrame, Tree, coordinate_symbol
from mbsgen.procedure.procedure import straight

Array = NDArray[np.float64]
Evaluate = Callable[[Any, Mapping[str, Array]], dict[str, Array]]

STATES = 5
RESULTS = ("rates", "forces", "qdd", "ydd")  # of loops; of loops on joints; of all joints; of the reduced form
KEPT: Mapping[Cut, tuple[tuple[int, ...], tuple[int, ...]]] = MappingProxyType(
    {  # the components of r' and of w that are 0
        Cut.BALL: ((0, 1, 2), ()),
        Cut.HINGE: ((0, 1, 2), (0, 1)),
        Cut.CYLINDRICAL: ((0, 1), (0, 1)),
        Cut.PRISMATIC: ((0, 1), (0, 1, 2)),
        Cut.PLANAR: ((2,), (0, 1)),
        Cut.SOLID: ((0, 1, 2), (0, 1, 2)),
    }
)


@dataclass(frozen=True)
class Joints:
    """Pinocchio's model in a state, with our velocities: v = G qd in our order of its joints."""

    pin: Any
    model: Any
    data: Any
    order: Array
    G: Array
    free: int  # of the bodies, the first ones that a free base moves

    def move(self, at: Array, qd: Array) -> None:
        """Set coordinates of Pinocchio, and our velocities, without accelerations."""
        v = np.zeros(self.model.nv)
        v[self.order] = self.G @ qd
        self.pin.forwardKinematics(self.model, self.data, at, v, 0 * v)
        self.pin.computeJointJacobians(self.model, self.data, at)

    def read(self, tree: Tree, end: LoopFrame) -> End:
        """Return one end of a loop; rows of Jacobians are by our velocities."""
        n = self.G.shape[1]
        own, place = (np.array([[to_double(x) for x in row] for row in rows]) for rows in (end.axes, [end.position]))
        if not end.body:
            return End(place[0], own, np.zeros((3, n)), np.zeros((3, n)), *np.zeros((3, 3)))
        body = tree.bodies[end.body - 1]
        turn = np.array([[to_double(x) for x in row] for row in body.axes]).T
        joint = 1 if end.body <= self.free else self.model.getJointId(body.joint.name)
        frame = self.pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pose, rows = self.data.oMi[joint], self.pin.getJointJacobian(self.model, self.data, joint, frame)
        speed = self.pin.getVelocity(self.model, self.data, joint, frame)
        change = self.pin.getClassicalAcceleration(self.model, self.data, joint, frame)
        arm = pose.rotation @ turn @ place[0]
        linear, angular = (np.array(part)[:, self.order] @ self.G for part in (rows[:3], rows[3:]))
        w, alpha = np.array(speed.angular), np.array(change.angular)
        bias = np.array(change.linear) + np.cross(alpha, arm) + np.cross(w, np.cross(w, arm))
        linear = linear - np.cross(arm, angular, axisb=0, axisc=0)
        return End(pose.translation + arm, pose.rotation @ turn @ own, linear, angular, w, bias, alpha)


@dataclass(frozen=True)
class End:
    """One end of a loop in the base frame: place, axes, Jacobians, and accelerations at qdd = 0."""

    place: Array
    axes: Array
    linear: Array
    angular: Array
    w: Array
    bias: Array
    alpha: Array


def find_uncompared(tree: Tree) -> list[str]:
    """List the loops of a kind that is not compared."""
    return [loop.name for loop in tree.loops if loop.cut not in KEPT]


def draw_states(tree: Tree) -> list[tuple[Array, Array]]:
    """Draw closed states of an assembled tree: q and qd."""
    assert tree.closure is not None, "the tree is assembled"
    mechanism, rng = Mechanism(tree), np.random.default_rng(7)
    states = []
    kept, slack = find_solved(tree.closure)
    own = slice(None) if kept is None else list(kept)
    for q in islice(walk(mechanism, np.array(tree.closure.pose), kept, slack), STATES):
        J, qd = mechanism.J(q)[own], rng.uniform(-1, 1, mechanism.n)
        for _ in range(2):  # the second time for rounding
            qd = qd - np.linalg.pinv(J, rcond=1e-9) @ (J @ qd)
        states.append((q, qd))
    return states


def compute_ours(tree: Tree, states: Sequence[tuple[Array, Array]], evaluate: Evaluate) -> list[dict[str, Array]]:
    """Compute the results by the kernels of the tree, without inputs; loops open at no rate."""
    assert tree.closure is not None, "the tree is assembled"
    whole, forces, reduced = (
        straight(FUNCTIONS[name].build(tree, ALL)) for name in ("exp1", "loop_forces", "exp1_red")
    )
    u, independent = np.zeros(sum(joint.actuated for joint in tree.joints)), list(tree.closure.independent)
    found = []
    for q, qd in states:
        given = {"q": q, "qd": qd, "yd": qd[independent], "u": u}
        ours = evaluate(whole, given)
        Q = evaluate(forces, given | {"lam": ours["lam"]})["Q"]
        ydd = evaluate(reduced, given)["ydd"]
        found.append({"rates": np.zeros(1), "forces": Q, "qdd": ours["qdd"], "ydd": ydd})
    return found


def compute_theirs(tree: Tree, joints: Joints, state: tuple[Array, Array], M: Array, c: Array) -> dict[str, Array]:
    """Compute the results by M and c of the open tree, and the ends of loops, at the state that the joints have."""
    assert tree.closure is not None, "the tree is assembled"
    rows, bias = _close(tree, joints, state[1])
    m, n = rows.shape
    system = np.block([[M, -rows.T], [rows, np.zeros((m, m))]])
    qdd = np.linalg.lstsq(system, -np.concatenate((c, bias)), rcond=1e-13)[0][:n]
    rates = np.array([np.abs(rows @ state[1]).max(initial=0.0)])
    return {"rates": rates, "forces": M @ qdd + c, "qdd": qdd, "ydd": qdd[list(tree.closure.independent)]}


def _close(tree: Tree, joints: Joints, qd: Array) -> tuple[Array, Array]:
    """Return J and its bias, redundant rows included."""
    rows, bias = [], []
    for loop in tree.loops:
        one, other = joints.read(tree, loop.first), joints.read(tree, loop.second)
        shifts, turns = (one.axes[:, list(kept)].T for kept in KEPT[loop.cut])
        d = other.place - one.place
        moved = other.linear - one.linear + np.cross(d, one.angular, axisb=0, axisc=0)
        across = np.cross(one.alpha, d) + np.cross(one.w, np.cross(one.w, d)) + 2 * np.cross(one.w, moved @ qd)
        rows += [shifts @ moved, turns @ (other.angular - one.angular)]
        bias += [shifts @ (other.bias - one.bias - across)]
        bias += [turns @ (other.alpha - one.alpha - np.cross(one.w, other.w))]
    for constraint in tree.constraints:  # of a file of URDF: linear, with numbers
        slopes = [constraint.equation.diff(coordinate_symbol(body.joint.name)) for body in tree.bodies]
        rows.append(np.array([[to_double(x) for x in slopes]]) @ joints.G)
        bias.append(np.zeros(1))
    return np.concatenate(rows), np.concatenate(bias)
