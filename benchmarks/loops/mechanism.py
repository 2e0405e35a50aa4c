"""A tree with loops -> the text that the programs in `cpp/` read, and MuJoCo's XML.

A hinge of which the tree keeps no more than the equations of a ball, as in a plane, is a point that two bodies share.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from sympy import Expr, Symbol

from benchmarks.mechanism import write_mechanism
from mbsgen.model.tree import NO_FORCE, ZERO, Body, Cut, Loop, LoopFrame, Motion, Tree

Kind = Literal["point", "axis", "frame", "rod"]

KINDS: Mapping[Cut, Kind] = {Cut.BALL: "point", Cut.HINGE: "axis", Cut.SOLID: "frame", Cut.ROD: "rod"}
EQUATIONS: Mapping[Cut, int] = {Cut.BALL: 3, Cut.HINGE: 5, Cut.SOLID: 6, Cut.ROD: 1}
TINY = 1e-12  # kg m2: moments of inertia of thin rods about themselves, which MuJoCo wants to be positive


@dataclass(frozen=True)
class Law:
    """The force of a joint: f - k (1 - slack/r) (b cos q - a sin q), r = sqrt(rest + 2 (a cos q + b sin q))."""

    joint: int  # from 0
    f: float = 0.0
    k: float = 0.0
    slack: float = 0.0
    a: float = 0.0
    b: float = 0.0
    rest: float = 1.0


@dataclass(frozen=True)
class Spring:
    """A spring with a damper between points of two bodies, 0 for the base."""

    bodies: tuple[int, int]
    points: tuple[tuple[float, float, float], tuple[float, float, float]]
    stiffness: float
    damping: float
    slack: float


def release(tree: Tree) -> Tree:
    """Return the tree without laws of its joints: they are compared with forces that are given."""
    bodies = (replace(body, joint=replace(body.joint, law=NO_FORCE)) for body in tree.bodies)
    return replace(tree, bodies=tuple(bodies))


def find_obstacle(tree: Tree) -> str | None:
    """Return why the peers do not take a tree; None if they do."""
    foreign = [loop.name for loop in tree.loops if loop.cut not in KINDS]
    if foreign or tree.constraints or tree.driven:
        return f"{', '.join(foreign) or 'equations of coordinates, driven joints'}: no peer has them all"
    if tree.wrenches or tree.quaternions or tree.couplings:
        return "wrenches, quaternions or followers"
    return None


def list_kinds(tree: Tree) -> tuple[Kind, ...]:
    """Return what each loop keeps together, as little as is sufficient."""
    kept = () if tree.closure is None else tree.closure.kept
    kinds, first = [], 0
    for loop in tree.loops:
        size = EQUATIONS[loop.cut]
        own = [k - first for k in kept if first <= k < first + size]
        is_flat = loop.cut is Cut.HINGE and max(own, default=0) < 3 and len(own) <= 2
        kinds.append("point" if is_flat else KINDS[loop.cut])
        first += size
    return tuple(kinds)


def write_loops(tree: Tree, laws: Iterable[Law] = (), springs: Iterable[Spring] = ()) -> str:
    """Write a mechanism with loops as `cpp/loops.hpp` reads it. Raises ValueError for parts that peers lack."""
    obstacle = find_obstacle(tree)
    if obstacle is not None:
        raise ValueError(f"{tree.name}: {obstacle}")
    alone = replace(release(tree), loops=(), constraints=(), driven=(), closure=None)
    listed = [_write_loop(loop, kind, _values(tree)) for loop, kind in zip(tree.loops, list_kinds(tree), strict=True)]
    forces = [f"{x.joint} {_join((x.f, x.k, x.slack, x.a, x.b, x.rest))}" for x in laws]
    ties = [_write_spring(x) for x in springs]
    lines = [str(len(listed)), *listed, str(len(forces)), *forces, str(len(ties)), *ties]
    return write_mechanism(alone) + "\n".join(lines) + "\n"


def _write_loop(loop: Loop, kind: Kind, values: Mapping[Symbol, float]) -> str:
    length = _join(_numbers([loop.value], values)) if kind == "rod" else ""
    return " ".join([kind, *(_write_end(end, values) for end in (loop.first, loop.second)), length]).rstrip()


def _write_end(end: LoopFrame, values: Mapping[Symbol, float]) -> str:
    axes = (entry for row in end.axes for entry in row)
    return f"{end.body} {_join(_numbers((*end.position, *axes), values))}"


def _write_spring(spring: Spring) -> str:
    ends = (f"{body} {_join(point)}" for body, point in zip(spring.bodies, spring.points, strict=True))
    return " ".join([*ends, _join((spring.stiffness, spring.damping, spring.slack))])


def _values(tree: Tree) -> Mapping[Symbol, float]:
    return {parameter.symbol: parameter.value for parameter in tree.parameters}


def _numbers(expressions: Iterable[Expr], values: Mapping[Symbol, float]) -> list[float]:
    return [float(expression.subs(values)) for expression in expressions]


def _join(numbers: Iterable[float]) -> str:
    return " ".join(map(repr, numbers))


# --- MuJoCo -------------------------------------------------------------------------------------------------------


SOFT = 'solref="0.0002 1" solimp="0.9999 0.9999 0.001 0.5 1"'  # as stiff as MuJoCo's loops remain stable with


def find_massless(tree: Tree) -> list[str]:
    """List the bodies without mass; a body that only carries a joint of the next one, at one point, is none."""
    return [body.name for number, body in enumerate(tree.bodies, 1) if body.mass == 0 and not _carries(tree, number)]


def _carries(tree: Tree, number: int) -> bool:
    """Return whether a body without mass is the place of one more joint of its only child."""
    if tree.bodies[number - 1].mass != 0 or len(children := tree.children(number)) != 1:
        return False
    child = tree.bodies[children[0] - 1]
    return child.position == (ZERO,) * 3 and all(
        child.orientation[r][c] == int(r == c) for r in range(3) for c in range(3)
    )


def write_xml(tree: Tree, springs: Sequence[Spring] = ()) -> str:
    """Write a mechanism as MJCF; its loops are soft. Raises ValueError."""
    massless = find_massless(tree)
    if massless:
        raise ValueError(f"{tree.name}: {', '.join(massless)}: MuJoCo takes no bodies without mass")
    rods = [loop.name for loop in tree.loops if loop.cut is Cut.ROD]
    if rods:
        raise ValueError(f"{tree.name}: {', '.join(rods)}: MuJoCo's loops keep points together, not distances")
    values = _values(tree)
    head = f'<option gravity="{_join(_numbers(tree.gravity, values))}" iterations="100" tolerance="1e-14"/>'
    lines = ['<mujoco><compiler angle="radian" autolimits="false"/>', head, "<worldbody>"]
    lines += [*_write_sites(tree, 0, values, springs), *_write_bodies(tree, 0, values, springs), "</worldbody>"]
    lines.append("<equality>")
    for loop, kind in zip(tree.loops, list_kinds(tree), strict=True):
        pairs = ("", ".z") if kind == "axis" else ("",)
        word = "weld" if kind == "frame" else "connect"
        lines += [f'<{word} site1="{loop.name}.1{x}" site2="{loop.name}.2{x}" {SOFT}/>' for x in pairs]
    lines += ["</equality>", "<tendon>"]
    for k, spring in enumerate(springs):
        own = f'springlength="{spring.slack}" stiffness="{spring.stiffness}" damping="{spring.damping}"'
        lines.append(f'<spatial {own}><site site="tie{k}.0"/><site site="tie{k}.1"/></spatial>')
    return "\n".join([*lines, "</tendon></mujoco>"]) + "\n"


def _write_bodies(tree: Tree, parent: int, values: Mapping[Symbol, float], springs: Sequence[Spring]) -> Iterator[str]:
    for number in tree.children(parent):
        body = tree.bodies[number - 1]
        yield f'<body name="{body.name}" pos="{_join(_numbers(body.position, values))}" {_write_axes(body, values)}>'
        yield _write_joint(body)
        while _carries(tree, number):
            number = tree.children(number)[0]
            body = tree.bodies[number - 1]
            yield _write_joint(body)
        I = [_numbers(row, values) for row in body.inertia]
        entries = [max(I[k][k], TINY) for k in range(3)] + [I[0][1], I[0][2], I[1][2]]
        (mass,), com = _numbers((body.mass,), values), _join(_numbers(body.com, values))
        yield f'<inertial pos="{com}" mass="{mass!r}" fullinertia="{_join(entries)}"/>'
        yield from _write_sites(tree, number, values, springs)
        yield from _write_bodies(tree, number, values, springs)
        yield "</body>"


def _write_joint(body: Body) -> str:
    kind = "hinge" if body.joint.motion is Motion.REVOLUTE else "slide"
    axis = _join(float(k == body.joint.axis) for k in range(3))
    return f'<joint name="{body.joint.name}" type="{kind}" axis="{axis}"/>'


def _write_axes(body: Body, values: Mapping[Symbol, float]) -> str:
    columns = [[body.orientation[r][c] for r in range(3)] for c in range(2)]
    return f'xyaxes="{_join(_numbers((*columns[0], *columns[1]), values))}"'


def _write_sites(tree: Tree, number: int, values: Mapping[Symbol, float], springs: Sequence[Spring]) -> Iterator[str]:
    for k, spring in enumerate(springs):
        for side, (body, point) in enumerate(zip(spring.bodies, spring.points, strict=True)):
            if body == number:
                yield f'<site name="tie{k}.{side}" pos="{_join(point)}"/>'
    for loop, kind in zip(tree.loops, list_kinds(tree), strict=True):
        for which, end in ((1, loop.first), (2, loop.second)):
            if end.body != number:
                continue
            axes = [_numbers([end.axes[r][c] for r in range(3)], values) for c in range(3)]
            place = _numbers(end.position, values)
            name, turn = f"{loop.name}.{which}", f'xyaxes="{_join((*axes[0], *axes[1]))}"'
            yield f'<site name="{name}" pos="{_join(place)}" {turn}/>'
            if kind == "axis":
                further = [p + z for p, z in zip(place, axes[2], strict=True)]
                yield f'<site name="{name}.z" pos="{_join(further)}" {turn}/>'
