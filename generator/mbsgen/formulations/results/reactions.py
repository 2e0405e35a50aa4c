"""Reactions of joints: Tree -> Tape of `reactions`, the whole force and moment that each joint transmits.

Force and moment on body i, about its origin, are what the textbook's recursion carries inward,

    F_i = m A + K S - Fext + sum R_j F_j,    N_i = J OMp + OM x J OM + S x A - Next + sum (R_j N_j + dpt_j x R_j F_j)

less the forces of loops beyond the joint. To these, by virtual power, belong the derivatives of lamT h by six
displacements of all that body i carries: joints without a motion, three slides and three turns, stand between the
body and everything on it.

Along its own axis a joint transmits its drive, its force law, and what the loops leave. Of equations of loops that
follow from others, the forces are not determined; they are 0 here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import closure, ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.results.poses import place_bodies
from mbsgen.formulations.states import declare_state
from mbsgen.formulations.textbook import Wrench, backward_dynamics, forward_kinematics
from mbsgen.model.tree import IDENTITY, NO_FORCE, ZERO, Body, Joint, Motion, Tree
from mbsgen.tape import reverse
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.passes import drop_unused_inputs
from mbsgen.tape.ports import adjoint_port, seed_port
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Tape

WAYS = tuple((motion, axis) for motion in (Motion.PRISMATIC, Motion.REVOLUTE) for axis in range(3))


def build(tree: Tree) -> Tape:
    """Write `reactions`: inputs q, qd, qdd [, lam] [, w] [, p]; outputs force [N] and moment [N m], (3, bodies).

    Columns belong to the joints of all bodies, followers included; components are in the base frame.
    """
    builder = Builder()
    sizes = {port: size for port, size in closure.count_forces(tree).items() if port == ports.MULTIPLIERS}
    state = declare_state(tree, builder, forces=False, more=sizes)
    chain = write_chain(tree, builder, state)
    motion = forward_kinematics(chain, state.qd, chain.accelerate(state.qdd))
    load: dict[int, Wrench] = {}
    for link in reversed(chain.links):
        load[link.number] = backward_dynamics(chain, link, motion[link.number], load)
    if sizes:
        held = _write_loops(chain)
        load = {i: Wrench(x.F - held[i].F, x.N - held[i].N) for i, x in load.items()}
    poses = place_bodies(chain)
    F, N = ([poses[i].R.apply(v) for i, v in enumerate(found, 1)] for found in zip(*_list(load), strict=True))
    builder.output_dense(ports.REACTION_FORCE, [[v[r] for v in F] for r in range(3)])
    builder.output_dense(ports.REACTION_MOMENT, [[v[r] for v in N] for r in range(3)])
    return builder.build("reactions")


def _list(load: Mapping[int, Wrench]) -> list[tuple[Vector[Scalar], Vector[Scalar]]]:
    return [(load[i].F, load[i].N) for i in sorted(load)]


def _write_loops(chain: Chain) -> dict[int, Wrench]:
    """Write the forces of loops on all that each body carries, about its origin and in its frame."""
    opened = open_joints(chain.tree)
    tape = drop_unused_inputs(reverse.adjoint(closure.build(opened.tree), [ports.COORDINATES.name]))
    own = dict(zip(chain.tree.coordinates, _list_coordinates(chain), strict=True))
    state, seed = chain.state, seed_port(ports.CLOSURE)
    given: dict[str, Sequence[Scalar]] = {ports.DESIGN.name: state.theta, ports.PARAMETERS.name: state.p}
    given[ports.COORDINATES.name] = [own.get(name, chain.builder.zero) for name in opened.tree.coordinates]
    given[seed.name] = state.more[ports.MULTIPLIERS.name]
    values = replay(tape, chain.builder, {i.name: given[i.name] for i in tape.inputs})
    found = [values[v] for v in tape.output(adjoint_port(ports.COORDINATES).name).values]
    felt = dict(zip(opened.tree.coordinates, found, strict=True))
    return {
        i: Wrench(Vector.of(felt[name] for name in names[:3]), Vector.of(felt[name] for name in names[3:]))
        for i, names in opened.ways.items()
    }


def _list_coordinates(chain: Chain) -> list[Scalar]:
    """List the entries of the input q, which quaternions share."""
    inside = {i: x for x in chain.tree.quaternions for i in x.bodies}
    found: list[Scalar] = []
    for i, q in enumerate(chain.state.q, 1):
        if i not in inside:
            found.append(q)
        elif inside[i].first == i:
            frame = chain.state.frames[i]
            found += [*(frame.p if inside[i].is_free else ()), *frame.v, frame.s]
    return found


@dataclass(frozen=True)
class Opened:
    """A tree in which six joints that stand still follow each joint, by the numbers of the bodies of the first tree."""

    tree: Tree
    ways: Mapping[int, tuple[str, ...]]  # the names of these joints: slides along, and turns about x, y, z


def open_joints(tree: Tree) -> Opened:
    """Put six joints between each body and everything on it, for loops alone: the tree has no forces nor sensors."""
    last = {i: x.bodies[-1] for x in tree.quaternions for i in x.bodies}
    places, bodies, ways = {0: 0}, list[Body](), dict[int, tuple[str, ...]]()
    for i, body in enumerate(tree.bodies, 1):
        bodies.append(replace(body, parent=places[body.parent]))
        if last.get(i, i) == i:
            added = [_make_body(tree, i, k, len(bodies) + k) for k in range(len(WAYS))]
            bodies += added
            ways[i] = tuple(x.joint.name for x in added)
        places[i] = len(bodies)
    ways |= {i: ways[k] for i, k in last.items()}
    firsts = {i: places[i] - (len(WAYS) if last.get(i, i) == i else 0) for i in range(1, len(tree.bodies) + 1)}
    opened = replace(
        tree,
        bodies=tuple(bodies),
        sensors=(),
        wrenches=(),
        probes=(),
        definitions=(),
        distances=(),
        quaternions=tuple(replace(x, first=firsts[x.first]) for x in tree.quaternions),
        loops=tuple(
            replace(
                x,
                first=replace(x.first, body=places[x.first.body]),
                second=replace(x.second, body=places[x.second.body]),
            )
            for x in tree.loops
        ),
        driven=(),
        chosen=(),
        rough=(),
    )
    return Opened(opened, ways)


def _make_body(tree: Tree, number: int, k: int, parent: int) -> Body:
    """Make the body of a joint that stands still, on the body before it."""
    motion, axis = WAYS[k]
    name = f"@{number}.{k}"  # which no joint of a file has
    joint = Joint(name, motion, axis, actuated=False, lower=None, upper=None, law=NO_FORCE)
    nowhere = (ZERO, ZERO, ZERO)
    axes = tree.bodies[number - 1].axes if k == len(WAYS) - 1 else IDENTITY
    return Body(name, parent, joint, nowhere, IDENTITY, ZERO, nowhere, (nowhere, nowhere, nowhere), axes)
