"""States: a Tree -> the inputs of a formulation, declared in a builder, and the frames of quaternions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from types import MappingProxyType

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations import ports
from mbsgen.model.tree import Kind, Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Port


@dataclass(frozen=True)
class Frame:
    """The placement that the coordinates of a quaternion add to the constant placement of its bodies."""

    p: Vector[Scalar]
    v: Vector[Scalar]  # the quaternion's vector part, as given
    s: Scalar  # its scalar part
    R: Matrix[Scalar]  # columns: axes


@dataclass(frozen=True)
class State:
    """The inputs of a formulation, declared in a builder; inputs that it does not take are empty lists."""

    q: list[Scalar]  # of each joint; 0 for joints that stand for a quaternion
    qd: list[Scalar]
    qdd: list[Scalar]
    u: list[Scalar]
    w: list[Scalar]
    theta: list[Scalar]
    p: list[Scalar]
    a: list[Scalar] = field(default_factory=list)  # accelerations of driven joints
    frames: Mapping[int, Frame] = field(default_factory=dict)  # by the first body that stands for a quaternion
    more: Mapping[str, list[Scalar]] = field(default_factory=dict)  # further columns, by name


def declare_state(
    tree: Tree,
    builder: Builder,
    *,
    rates: bool = True,
    accelerations: bool = True,
    forces: bool = True,
    wrenches: bool = True,
    drive: bool = False,
    more: Mapping[Port, int] = MappingProxyType({}),
) -> State:
    """Declare q; qd, qdd, u, a where requested; w, theta and p where there are open wrenches, signals, parameters.

    `more` are the sizes of further columns, which follow the accelerations.
    """
    assert not tree.couplings, "recursions see the uncoupled tree; see coupling.write"
    n = len(tree.bodies)
    given = builder.vector(ports.COORDINATES, len(tree.coordinates))
    qd = builder.vector(ports.VELOCITIES, n) if rates else []
    qdd = builder.vector(ports.ACCELERATIONS, n) if accelerations else []
    further = {port.name: builder.vector(port, size) for port, size in more.items()}
    u = builder.vector(ports.FORCES, sum(body.joint.actuated for body in tree.bodies)) if forces else []
    a = builder.vector(ports.DRIVE, len(tree.driven)) if drive and tree.driven else []
    w = builder.vector(ports.WRENCHES, tree.open_entries) if wrenches and tree.open_entries else []

    def declare(port: Port, kind: Kind) -> list[Scalar]:
        size = sum(x.kind is kind for x in tree.parameters)
        return builder.vector(port, size) if size else []

    theta, p = declare(ports.DESIGN, Kind.DIFFERENTIATED), declare(ports.PARAMETERS, Kind.RUNTIME)
    if not tree.quaternions:
        return State(given, qd, qdd, u, w, theta, p, a, more=further)
    q, frames = share_out(tree, builder, given)
    return State(q, qd, qdd, u, w, theta, p, a, frames, further)


def share_out(tree: Tree, builder: Builder, given: Sequence[Scalar]) -> tuple[list[Scalar], dict[int, Frame]]:
    """Assign each joint its coordinate, and each quaternion its frame."""
    entries, zero = iter(given), builder.zero
    inside = {i: x for x in tree.quaternions for i in x.bodies}
    q: list[Scalar] = []
    frames: dict[int, Frame] = {}
    for i in range(1, len(tree.bodies) + 1):
        own = inside.get(i)
        q.append(zero if own else next(entries))
        if own and own.first == i:
            p = Vector.of(islice(entries, 3)) if own.is_free else Vector(zero, zero, zero)
            v, s = Vector.of(islice(entries, 3)), next(entries)
            frames[i] = Frame(p, v, s, turn(v, s))
    return q, frames


def turn(v: Vector[Scalar], s: Scalar) -> Matrix[Scalar]:
    """Return the rotation matrix of a quaternion of any nonzero length: 1 + 2 (s v~ + v~ v~) / (v.v + s2).

    It does not depend on the length. So its derivatives by the components are the derivatives at the unit quaternion,
    without a part along the quaternion.
    """
    one, (x, y, z) = s.builder.number(1.0), v
    a, b, c = v.scale(s.builder.number(2.0) / (v.dot(v) + s * s))
    return Matrix.of(
        [
            [one - (y * b + z * c), x * b - s * c, x * c + s * b],
            [x * b + s * c, one - (x * a + z * c), y * c - s * a],
            [x * c - s * b, y * c + s * a, one - (x * a + y * b)],
        ]
    )
