"""Rates of the coordinates: Tree -> Tape of `rates`, for trees whose velocities are not the rates of q.

A quaternion q = (v, s), scalar last, turns with the angular velocity w, in the body's axes, by

    v' = (s w + v x w) / 2,    s' = -v.w / 2,

which keeps its length (Wittenburg, 2008, 2.2). The position of a free body changes by R v.
"""

from __future__ import annotations

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


def build(tree: Tree) -> Tape:
    """Write `rates`: inputs q, qd; output rate, shape of q: the time derivative of q, rad/s, m/s or 1/s."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False, wrenches=False)
    beginnings = {x.first: x for x in tree.quaternions}
    inside = {i for x in tree.quaternions for i in x.bodies}
    half = builder.number(0.5)
    rates: list[Scalar] = []
    for i in range(1, len(tree.bodies) + 1):
        if i not in inside:
            rates.append(state.qd[i - 1])
        elif i in beginnings:
            frame, own = state.frames[i], [state.qd[k - 1] for k in beginnings[i].bodies]
            w = Vector.of(own[-3:])
            if beginnings[i].is_free:
                rates += frame.R.apply(Vector.of(own[:3]))
            rates += (w.scale(frame.s) + frame.v.cross(w)).scale(half)
            rates.append(-(frame.v.dot(w) * half))
    builder.output_dense(ports.RATES, [[x] for x in rates])
    return builder.build("rates")
