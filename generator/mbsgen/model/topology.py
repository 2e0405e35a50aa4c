"""The tree that bodies and their parents form."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence

from mbsgen.documents import Finding, Place, abbreviate, lies_under, nearest
from mbsgen.model.model import BASE, Fixed, Model


def sort_bodies(model: Model) -> list[int]:
    """Number the bodies (from 0, in the file) so that parents come first: as in the file, or else depth first."""
    parents = index_parents(model)
    if all(parent is None or parent < i for i, parent in enumerate(parents)):
        return list(range(len(parents)))
    return walk_bodies(model)


def walk_bodies(model: Model) -> list[int]:
    """Number the bodies depth first: each is followed by all that it carries."""
    children: list[list[int]] = [[] for _ in model.bodies]
    roots: list[int] = []
    for i, parent in enumerate(index_parents(model)):
        (roots if parent is None else children[parent]).append(i)
    order: list[int] = []
    waiting = roots[::-1]
    while waiting:
        i = waiting.pop()
        order.append(i)
        waiting += children[i][::-1]
    return order


def index_parents(model: Model) -> list[int | None]:
    """Return the parents' indices in the list of bodies; None for the base, and for unknown parents."""
    named = [(i, body) for i, body in enumerate(model.bodies) if body.name != BASE]  # no body may have this name
    places = {body.name: i for i, body in reversed(named)}
    return [places.get(body.parent) for body in model.bodies]


def find_carriers(model: Model) -> dict[str, str]:
    """Name what moves every body: itself, or what it is fixed to in the end, which may be the base."""
    carriers = {BASE: BASE}
    for body in (model.bodies[i] for i in walk_bodies(model)):
        parent = carriers.get(body.parent, body.parent)  # which may be missing
        carriers[body.name] = parent if isinstance(body.joint, Fixed) else body.name
    return carriers


def check_tree(model: Model, doubtful: Container[Place]) -> Iterator[Finding]:
    """Find parents and bodies of frames, forces and loops that do not exist, and loops of parents."""
    names = [body.name for body in model.bodies]
    if any(lies_under(("bodies", i, "name"), doubtful) for i in range(len(names))):
        return  # any name may be the one that is missed
    parents: list[tuple[Place, str]] = [(("bodies", i, "parent"), b.parent) for i, b in enumerate(model.bodies)]
    carriers: list[tuple[Place, str]] = [(("frames", i, "body"), f.body) for i, f in enumerate(model.frames)]
    carriers += [(("wrenches", i, "body"), wrench.body) for i, wrench in enumerate(model.wrenches)]
    carriers += [
        (("wrenches", i, "against", "body"), x.against.body) for i, x in enumerate(model.wrenches) if x.against
    ]
    ends = [(i, key, end) for i, x in enumerate(model.loops) for key, end in (("from", x.first), ("to", x.second))]
    carriers += [(("loops", i, key, "body"), end.body) for i, key, end in ends]
    spans = [(i, key, end) for i, x in enumerate(model.forces) for key, end in (("from", x.first), ("to", x.second))]
    carriers += [(("forces", i, key, "body"), end.body) for i, key, end in spans]
    passed = [(i, k, end) for i, x in enumerate(model.forces) for k, end in enumerate(x.via)]
    carriers += [(("forces", i, "via", k, "body"), end.body) for i, k, end in passed]
    wraps = [(i, k, wrap) for i, x in enumerate(model.forces) for k, wrap in enumerate(x.wraps)]
    carriers += [(("forces", i, "wraps", k, "body"), wrap.body) for i, k, wrap in wraps]
    carriers += [(("contacts", i, "body"), contact.body) for i, contact in enumerate(model.contacts)]
    carriers += [(("contacts", i, x.key, "body"), x.other.body) for i, x in enumerate(model.contacts)]
    for place, name in [*parents, *carriers]:
        if name not in (BASE, *names) and not lies_under(place, doubtful):
            meant = nearest(name, [BASE, *names])
            remedy = f"did you mean {abbreviate(meant)}?" if meant else f"name a body, or {BASE}"
            yield Finding(place, f"there is no body {abbreviate(name)}", remedy)
    for loop in _find_loops(index_parents(model)):
        shown = [*map(abbreviate, (names[i] for i in loop[:8])), *(["..."] if len(loop) > 8 else [])]
        chain = " -> ".join([*shown, shown[0]])
        yield Finding(("bodies", loop[0], "parent"), f"a loop of parents: {chain}", f"let one of them stand on {BASE}")


def _find_loops(parents: Sequence[int | None]) -> Iterator[list[int]]:
    """Follow the parents from each body; a loop begins where it comes first in the list."""
    clear: set[int | None] = {None}
    for start in range(len(parents)):
        path: list[int] = []
        i: int | None = start
        while i not in clear and i not in path:
            assert i is not None, "the base is clear"
            path.append(i)
            i = parents[i]
        if i not in clear and i is not None:
            loop = path[path.index(i) :]
            first = loop.index(min(loop))
            yield loop[first:] + loop[:first]
        clear.update(path)
