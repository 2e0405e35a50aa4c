"""Closed linkages, each cut at several places: the bodies move alike, wherever the loops are cut.

A linkage is a set of links and pivots, at a pose where all bodies have the base's axes. A choice of cuts makes of it a
model file: the pivots that are left carry the bodies of a tree, and the cut ones are its loops. Motions are compared as
motions of the links; within each variant, all functions are compared with `free_bodies` as in `loops`. Pivots that no
variant cuts may have springs, be driven, and be tied by equations, some with a coefficient at run time.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.free_bodies import FreeBodies
from tests.fuzz.kinematics import DECIMALS, FLOATS, Array, Motion, fifty_digits
from tests.fuzz.loops import REGULAR, ROUNDING, Comparison, tally_up, turn_about, write_tapes, write_turns
from tests.fuzz.mechanisms import CHOICES, Mechanism, Tally

FREEDOMS = {"hinge": 1, "prismatic": 1, "helical": 1, "cylindrical": 2, "universal": 2, "ball": 3, "planar": 3}
FREEDOMS |= {"solid": 0, "rod": 5}
PLANES = {"x": "yz", "y": "xz", "z": "xy"}
FAMILIES = {"planar": 3, "spherical": 3, "spatial": 3, "pair": 2, "solid": 1}  # how often each is drawn
ATTEMPTS = 40  # at a linkage that moves regularly
NEAR = 0.15  # how far it moves from the pose at which it is drawn
STEPS = 40  # of Newton's method
PLAIN = ("hinge", "prismatic", "helical")  # kinds of pivots with one coordinate
RULES = 8  # attempts at an equation, or at a driven pivot
EQUATIONS = ("sin({a}) + 0.5*{b}**2 - {b}", "{a} - 0.8*{b}", "k*{a} + {b}", "{a}*{b} + {a} - k*{b}")
RATIO = 0.6  # k in the equations


@dataclass(frozen=True)
class Pivot:
    """A joint between two links, in a frame that both have at the drawn pose."""

    name: str
    kind: str
    one: str
    other: str
    p: Array
    R: Array
    axis: str = "z"
    axis2: str = "x"  # of universal joints
    end: Array | None = None  # of a rod: its place on the other link
    pitch: float = 0.0  # of a helical pivot


@dataclass
class Linkage:
    """Links by name, with mass, centre of mass and inertia in the base's axes; pivots; the freedom that is expected."""

    links: dict[str, tuple[float, Array, Array]]
    pivots: list[Pivot]
    freedom: int
    gravity: Sequence[float] = (0.3, -9.0, -2.0)
    wrenches: dict[str, tuple[Array, Array, Array]] = field(default_factory=dict)  # place, force and moment on links
    springs: dict[str, dict[str, float]] = field(default_factory=dict)  # of pivots that are never cut
    equations: list[tuple[str, str, str]] = field(default_factory=list)  # with the pivots a and b
    driven: dict[str, float] = field(default_factory=dict)  # pivots with their accelerations

    @property
    def parameters(self) -> dict[str, float]:
        """Return the values of parameters at run time."""
        return {"k": RATIO} if any("k*" in text for text, *_ in self.equations) else {}


def draw(seed: int) -> tuple[Linkage, list[dict[str, Any]]]:
    """Draw a linkage, and the model files of two ways to cut it."""
    source = random.Random(f"{seed} linkage")
    for _ in range(ATTEMPTS):
        family = source.choices([*FAMILIES], [*FAMILIES.values()])[0]
        linkage = _DRAWS[family](source)
        choices = _choose_cuts(linkage, source)
        kept = set.intersection(*({x.name for x in linkage.pivots} - cuts for cuts in choices))
        for pivot in linkage.pivots:
            if pivot.name in kept and pivot.kind in PLAIN and source.random() < 0.4:
                linkage.springs[pivot.name] = {"stiffness": source.choice([2.0, 15.0]), "damping": 0.3}
        models = [write_model(linkage, cuts, f"linkage{seed}") for cuts in choices]
        if all(_moves(linkage, model) for model in models):
            return _add_rules(linkage, choices, f"linkage{seed}")
    raise AssertionError(f"no linkage for seed {seed}")


def _add_rules(linkage: Linkage, choices: list[set[str]], name: str) -> tuple[Linkage, list[dict[str, Any]]]:
    """Tie two pivots, and drive one, where these have coordinates in all variants and some freedom is left."""
    source = random.Random(f"{name} rules")  # does not change the rest of the linkage
    plain = [x.name for x in linkage.pivots if x.kind in PLAIN and not any(x.name in cuts for cuts in choices)]
    models = [write_model(linkage, cuts, name) for cuts in choices]
    for add in (_tie, _drive):
        for _ in range(RULES if source.random() < 0.7 else 0):
            tried = add(linkage, plain, source)
            if tried is None:
                continue
            changed = [write_model(tried, cuts, name) for cuts in choices]
            if all(_moves(tried, model) for model in changed):
                linkage, models = tried, changed
                break
    return linkage, models


def _tie(linkage: Linkage, plain: Sequence[str], source: random.Random) -> Linkage | None:
    if len(plain) < 2 or linkage.freedom < 2:
        return None
    text, (a, b) = source.choice(EQUATIONS), source.sample(plain, 2)
    return replace(linkage, equations=[*linkage.equations, (text, a, b)], freedom=linkage.freedom - 1)


def _drive(linkage: Linkage, plain: Sequence[str], source: random.Random) -> Linkage | None:
    if not plain or linkage.freedom < 2:
        return None
    return replace(linkage, driven={source.choice(plain): round(source.uniform(-2, 2), 3)})


# -- draws ------------------------------------------------------------------------------------------------------------


def _link(source: random.Random) -> tuple[float, Array, Array]:
    points = np.array([[source.gauss(0, 0.3) for _ in range(3)] for _ in range(6)])
    inertia = sum((p @ p * np.eye(3) - np.outer(p, p) for p in points), np.zeros((3, 3)))
    com = np.array([round(source.uniform(-0.5, 0.5), 3) for _ in range(3)])
    return round(source.uniform(0.5, 3), 3), com, np.round(inertia, 4)


def _finish(source: random.Random, pivots: list[Pivot], freedom: int) -> Linkage:
    names = sorted({x for pivot in pivots for x in (pivot.one, pivot.other)} - {"base"})
    linkage = Linkage({name: _link(source) for name in names}, pivots, freedom)
    for name in source.sample(names, source.randint(0, 1)):
        place, force, moment = (np.array([round(source.uniform(-1, 1), 3) for _ in range(3)]) for _ in range(3))
        linkage.wrenches[name] = (place, 5 * force, moment)
    return linkage


def _stand(source: random.Random) -> Array:
    """Return a random rotation, or none."""
    axis = np.array([source.gauss(0, 1) for _ in range(3)])
    return np.eye(3) if source.random() < 0.5 else turn_about(axis, source.uniform(-2, 2))


def _polygon(source: random.Random, size: int) -> list[Array]:
    """Return corners of a polygon in the plane."""
    angles = [2 * np.pi * (k + source.uniform(-0.2, 0.2)) / size for k in range(size)]
    radii = [source.uniform(0.4, 0.9) for _ in angles]
    return [np.array([r * np.cos(a), r * np.sin(a), 0.0]).round(3) for r, a in zip(radii, angles, strict=True)]


def _draw_planar(source: random.Random) -> Linkage:
    """Draw one or two loops in a plane: hinges and slides, which move in it however they are cut."""
    size, stand, axis = source.randint(4, 5), _stand(source), source.choice("xyz")
    cyclic = np.roll(np.eye(3), "zxy".index(axis), axis=0)  # brings z to the axis
    corners = _polygon(source, size)
    names = ["base", *(f"b{k}" for k in range(1, size))]
    kinds = ["hinge"] * size
    if source.random() < 0.4:
        kinds[source.randrange(size)] = "prismatic"
    across = {"x": "y", "y": "z", "z": "x"}[axis]
    pivots = []
    for k, (kind, corner) in enumerate(zip(kinds, corners, strict=True)):
        along = axis if kind == "hinge" else across
        pivots.append(Pivot(f"j{k}", kind, names[k], names[(k + 1) % size], stand @ cyclic @ corner, stand, along))
    freedom = size - 3
    if size == 4 and source.random() < 0.4:  # two links more, which close a second loop
        for k, (one, other) in enumerate([("b2", "c0"), ("c0", "c1"), ("c1", "base")]):
            corner = np.array([source.uniform(-1, 1), source.uniform(-1, 1), 0.0]).round(3)
            pivots.append(Pivot(f"k{k}", "hinge", one, other, stand @ cyclic @ corner, stand, axis))
    return _finish(source, pivots, freedom)


def _draw_spherical(source: random.Random) -> Linkage:
    """Draw a loop of hinges whose axes meet in a point."""
    size, point = source.randint(4, 5), np.array([source.uniform(-0.5, 0.5) for _ in range(3)]).round(3)
    names, stand = ["base", *(f"b{k}" for k in range(1, size))], _stand(source)
    pivots = []
    for k in range(size):
        turn = turn_about(
            np.array([np.cos(2 * np.pi * k / size), np.sin(2 * np.pi * k / size), 0.0]), source.uniform(0.4, 0.9)
        )
        place = point + stand @ turn[:, 2] * round(source.uniform(0, 0.5), 3)
        pivots.append(Pivot(f"j{k}", "hinge", names[k], names[(k + 1) % size], place, stand @ turn))
    return _finish(source, pivots, size - 3)


def _draw_spatial(source: random.Random) -> Linkage:
    """Draw one loop of any pivots in space, with one freedom or two."""
    kinds: list[str] = []
    while sum(FREEDOMS[kind] for kind in kinds) < 7:
        kinds.append(source.choice(["hinge", "hinge", "prismatic", "cylindrical", "universal", "ball", "planar"]))
    thread = random.Random(repr(kinds))  # so that screws do not change the rest of the linkage
    kinds = ["helical" if kind == "prismatic" and thread.random() < 0.5 else kind for kind in kinds]
    return _finish(source, [*_chain(source, kinds, "b", "base", "base")], sum(FREEDOMS[kind] for kind in kinds) - 6)


def _draw_pair(source: random.Random) -> Linkage:
    """Draw two loops in space that share links, the second one closed by a rod or a chain."""
    first = ["hinge", "ball", "hinge", source.choice(["ball", "universal"]), "hinge"]
    pivots = [*_chain(source, first, "b", "base", "base")]
    freedom = sum(FREEDOMS[kind] for kind in first) - 6
    second = source.choice([["rod"], ["rod"], ["universal", "prismatic", "ball"], ["ball", "hinge", "universal"]])
    pivots += _chain(source, second, "c", "b2", source.choice(["base", "b4"]))
    return _finish(source, pivots, freedom + sum(FREEDOMS[kind] for kind in second) - 6)


def _draw_solid(source: random.Random) -> Linkage:
    """Draw a loop in space, with two links that are fixed to each other."""
    kinds = ["ball", "hinge", "solid", "universal", "cylindrical"]
    source.shuffle(kinds)
    return _finish(source, [*_chain(source, kinds, "b", "base", "base")], 2)


_DRAWS = {
    "planar": _draw_planar,
    "spherical": _draw_spherical,
    "spatial": _draw_spatial,
    "pair": _draw_pair,
    "solid": _draw_solid,
}


def _chain(source: random.Random, kinds: Sequence[str], letter: str, start: str, end: str) -> Iterator[Pivot]:
    names = [start, *(f"{letter}{k}" for k in range(1, len(kinds))), end]
    for k, kind in enumerate(kinds):
        p, other = (np.array([source.uniform(-0.8, 0.8) for _ in range(3)]).round(3) for _ in range(2))
        axis, axis2 = source.sample("xyz", 2)
        if kind in ("ball", "solid", "rod"):
            axis, axis2 = "z", "x"
        name, place, pitch = f"{letter}j{k}", other if kind == "rod" else None, 0.3 * (kind == "helical")
        yield Pivot(name, kind, names[k], names[k + 1], p, _stand(source), axis, axis2, place, pitch)


# -- model files ------------------------------------------------------------------------------------------------------


def _choose_cuts(linkage: Linkage, source: random.Random) -> list[set[str]]:
    """Choose cuts that leave a tree, twice, and differently where there is a choice."""
    found: list[set[str]] = []
    for _ in range(12):
        order = source.sample(linkage.pivots, len(linkage.pivots))
        group = {name: name for name in ("base", *linkage.links)}
        cuts = set()
        for pivot in sorted(order, key=lambda x: x.kind == "rod"):
            one, other = (next(k for k in group.values() if k == group[x]) for x in (pivot.one, pivot.other))
            if one == other or pivot.kind == "rod":
                cuts.add(pivot.name)
                continue
            group = {name: one if x == other else x for name, x in group.items()}
        if cuts not in found:
            found.append(cuts)
        if len(found) == 2:
            break
    return found if len(found) == 2 else found * 2


def seat_links(linkage: Linkage, cuts: set[str]) -> dict[str, tuple[Pivot, bool]]:
    """Return the pivot that carries each link, and whether it is taken in reverse; parents come first."""
    seats: dict[str, tuple[Pivot, bool]] = {}
    waiting = [x for x in linkage.pivots if x.name not in cuts]
    while waiting:
        for pivot in waiting:
            for parent, child in ((pivot.one, pivot.other), (pivot.other, pivot.one)):
                if (parent == "base" or parent in seats) and child not in seats and child != "base":
                    seats[child] = (pivot, parent != pivot.one)
        waiting = [x for x in waiting if not {x.one, x.other} <= {*seats, "base"}]
    return seats


def write_model(linkage: Linkage, cuts: set[str], name: str) -> dict[str, Any]:
    """Write a linkage as the data of a model file; a link has the frame of the pivot that carries it."""
    seats = seat_links(linkage, cuts)

    def place(link: str, p: Array, R: Array) -> dict[str, Any]:
        own_p, own_R = (seats[link][0].p, seats[link][0].R) if link in seats else (np.zeros(3), np.eye(3))
        turn = np.eye(3) if R is own_R else own_R.T @ R
        return {"position": [float(x) for x in own_R.T @ (p - own_p)], "orientation": write_turns(turn)}

    bodies, loops, wrenches = [], [], []
    for link, (pivot, reverse) in seats.items():
        mass, com, inertia = linkage.links[link]
        tensor = pivot.R.T @ inertia @ pivot.R
        parent = pivot.other if reverse else pivot.one
        bodies.append(
            {
                "name": link,
                "parent": parent,
                "joint": {**_write_joint(pivot, reverse), **place(parent, pivot.p, pivot.R)}
                | linkage.springs.get(pivot.name, {})
                | ({"actuated": False} if pivot.name in linkage.driven else {}),
                "mass": mass,
                "com": [float(x) for x in pivot.R.T @ (com - pivot.p)],
                "inertia": {f"{'xyz'[r]}{'xyz'[c]}": float(tensor[r, c]) for r in range(3) for c in range(r, 3)},
            }
        )
    for pivot in (x for x in linkage.pivots if x.name in cuts):
        loop: dict[str, Any] = {"name": pivot.name, "type": pivot.kind}
        loop |= {"axis": pivot.axis} if pivot.kind not in ("rod", "ball", "solid") else {}
        loop |= {"axis2": pivot.axis2} if pivot.kind == "universal" else {}
        loop |= {"pitch": pivot.pitch} if pivot.kind == "helical" else {}
        end = pivot.p if pivot.end is None else pivot.end
        loop |= {"length": float(np.linalg.norm(end - pivot.p))} if pivot.kind == "rod" else {}
        loop["from"] = {"body": pivot.one, **place(pivot.one, pivot.p, pivot.R)}
        loop["to"] = {"body": pivot.other, **place(pivot.other, end, pivot.R)}
        loops.append(loop)
    for link, (p, force, moment) in linkage.wrenches.items():
        entry = {"name": f"w_{link}", "body": link, "position": place(link, p, np.eye(3))["position"]}
        wrenches.append(entry | {"force": [float(x) for x in force], "moment": [float(x) for x in moment]})
    parameters = {key: {"value": x, "kind": "runtime"} for key, x in linkage.parameters.items()}
    model: dict[str, Any] = {"name": name, "gravity": [*linkage.gravity], "parameters": parameters, "bodies": bodies}
    signs = find_signs(linkage, cuts)
    spelled = {x: x if sign > 0 else f"(-{x})" for x, sign in signs.items()}
    equations = [text.format(a=spelled[a], b=spelled[b]) for text, a, b in linkage.equations]
    rules: dict[str, Any] = {"constraints": [{"name": f"e{k}", "equation": x} for k, x in enumerate(equations)]}
    rules["driven"] = [*linkage.driven]
    return model | {"loops": loops, "wrenches": wrenches, "frames": []} | {key: x for key, x in rules.items() if x}


def find_signs(linkage: Linkage, cuts: set[str]) -> dict[str, float]:
    """Return the signs of the coordinates of pivots: -1 where a pivot is taken in reverse."""
    return {pivot.name: -1.0 if reverse else 1.0 for pivot, reverse in seat_links(linkage, cuts).values()}


def _write_joint(pivot: Pivot, reverse: bool) -> dict[str, Any]:
    match pivot.kind:
        case "hinge":
            return {"name": pivot.name, "type": "revolute", "axis": pivot.axis}
        case "prismatic":
            return {"name": pivot.name, "type": "prismatic", "axis": pivot.axis}
        case "helical":
            return {"name": pivot.name, "type": "helical", "axis": pivot.axis, "pitch": pivot.pitch}
        case "cylindrical":
            return {"type": "cylindrical", "axis": pivot.axis}
        case "planar":
            return {"type": "planar", "plane": PLANES[pivot.axis]}
        case "universal":
            axes = (pivot.axis2, pivot.axis) if reverse else (pivot.axis, pivot.axis2)
            return {"type": "universal", "axis": axes[0], "axis2": axes[1]}
        case "ball":
            return {"type": "ball"}
    assert pivot.kind == "solid"
    return {"type": "fixed"}


def _moves(linkage: Linkage, model: Mapping[str, Any]) -> bool:
    """Return whether a linkage has the expected freedom, and no singular pose near."""
    program = FreeBodies(model, linkage.parameters, FLOATS)
    J = program.jacobian(start(program))[1]
    driven = [program.names_of_velocities.index(name) for name in linkage.driven]
    J = np.concatenate((J, np.eye(J.shape[1])[driven]))
    singular, rank = np.linalg.svd(J, compute_uv=False), J.shape[1] - linkage.freedom + len(driven)
    if not 0 < rank <= len(singular):
        return False
    return bool(singular[rank - 1] > REGULAR * singular[0] and (singular[rank:] < 1e-12).all())


# -- motions ----------------------------------------------------------------------------------------------------------


def start(program: FreeBodies) -> dict[str, Any]:
    """Return the coordinates of the drawn pose: 0, and quaternions that turn nothing."""
    return {name: program.numbers.make(float(name.endswith(".qw"))) for name in program.names_of_coordinates}


def link_motions(linkage: Linkage, cuts: set[str], bodies: Mapping[str, Motion]) -> dict[str, Motion]:
    """Return the motions of the links in the frames that stand in the base's at the drawn pose."""
    found = {}
    for link, (pivot, _) in seat_links(linkage, cuts).items():
        turned = bodies[link].turned(DECIMALS.array(pivot.R.T))
        found[link] = turned.carry(-DECIMALS.array(pivot.p))
    return found


def draw_state(program: FreeBodies, source: np.random.Generator) -> tuple[dict[str, Any], Array]:
    """Draw a closed state near the drawn pose."""
    q = program.close(start(program))
    J = program.jacobian(q)[1]
    way = program.make_consistent(J, DECIMALS.array(source.uniform(-1, 1, J.shape[1])))
    q = program.close(program.advance(q, way * Decimal(NEAR)))
    J = program.jacobian(q)[1]
    return q, program.make_consistent(J, DECIMALS.array(source.uniform(-2, 2, J.shape[1])))


def follow(
    linkage: Linkage, cuts: set[str], program: FreeBodies, wanted: Mapping[str, Motion]
) -> tuple[dict[str, Any], Array]:
    """Find the coordinates and velocities with which the links stand and move as they do in another variant."""
    q = start(program)
    still = dict.fromkeys(program.velocities(), Decimal(0))
    for _ in range(STEPS):
        moved = program.move(program.fill(q), still, still)
        found = link_motions(linkage, cuts, moved.bodies)
        S = np.concatenate([_columns(program, found[name]) for name in wanted])
        off = np.concatenate([_difference(wanted[name], found[name]) for name in wanted])
        inverse = DECIMALS.array(np.linalg.pinv(S.astype(float), rcond=1e-9))
        if abs(off).max() < 1e-40:
            break
        q = program.advance(q, inverse @ off)
    velocities = np.concatenate([np.concatenate([x.v, x.om]) for x in wanted.values()])
    qd = inverse @ velocities
    for _ in range(4):
        qd = qd + inverse @ (velocities - S @ qd)
    return q, qd


def _columns(program: FreeBodies, motion: Motion) -> Array:
    shares = {column.name: np.concatenate(column.at(motion.p)) for column in motion.columns}
    return program.fold(shares, (6,))


def _difference(wanted: Motion, found: Motion) -> Array:
    """Return the step that leads from a pose to another, to first order."""
    R = wanted.R @ found.R.T
    turn = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    return np.concatenate([wanted.p - found.p, turn])


# -- comparison -------------------------------------------------------------------------------------------------------


def examine(seed: int) -> str:
    """Compare both variants of a linkage with the independent program, and their motions with each other."""
    source = random.Random(f"{seed} reductions")
    linkage, models = draw(seed)
    faults: list[str] = []
    motions: list[Mapping[str, Motion]] = []
    wanted: dict[str, Motion] = {}
    for k, model in enumerate(models):
        mechanism = Mechanism(model, {}, linkage.parameters, source.choice([*CHOICES]))
        cuts = {x["name"] for x in model["loops"]}
        tree, tapes = write_tapes(mechanism)
        with fifty_digits():
            comparison = Comparison(mechanism, tree, tapes, seed)
            found = comparison.run()
            faults += [f"variant {k}: {found}"] if found else []
            if tree.closure is None or len(tree.closure.independent) != linkage.freedom:
                faults.append(f"variant {k}: its freedom is not {linkage.freedom}")
            program = comparison.program
            if wanted:
                q, qd = follow(linkage, cuts, program, wanted)
            else:
                q, qd = draw_state(program, np.random.default_rng(seed))
            signs = find_signs(linkage, cuts)
            qdd = comparison.accelerate(q, qd, {name: signs[name] * a for name, a in linkage.driven.items()})
            given = [dict(zip(program.names_of_velocities, x, strict=True)) for x in (qd, qdd)]
            moved = program.move(program.fill(q), *map(program.fill_rates, given))
            motions.append(link_motions(linkage, cuts, moved.bodies))
            wanted = wanted or dict(motions[0])
    one, other = motions
    for name in linkage.links:
        for key in ("p", "R", "v", "om", "a", "alpha"):
            x, y = (np.asarray(getattr(given[name], key), float) for given in (one, other))
            off = np.abs(x - y).max() / max(1.0, np.abs(x).max())
            if not off <= ROUNDING * 10:
                faults.append(f"{key} of {name} depends on the cut by {off:.1e}")
    return ", ".join(faults)


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine linkages from a seed on."""

    def examine_one(number: int) -> tuple[str, Callable[[], Mechanism]]:
        return examine(number), lambda: Mechanism((drawn := draw(number))[1][0], {}, drawn[0].parameters, "all")

    return tally_up(range(seed, seed + count), examine_one, keep, show)
