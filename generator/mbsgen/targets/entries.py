"""Names for the entries of a model's vectors: Tree -> enumerators and name tables of its C header.

A group is one vector of the kernels, or one list of columns: q, qd, u, ... Entry k has the enumerator
`<model>_IDX_<group>_<name>`, of value k, and its name in the model in the table `<model>_NAMES_<group>`. Blanks, dots
and dashes of names become `_`. If two entries of a group would get the same name, all its names are mangled.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from mbsgen.formulations.closure import kept_equations
from mbsgen.manifest import FIRST_LENGTH, TIME
from mbsgen.model.tree import Kind, Tree
from mbsgen.targets.names import escape, mangle

AXES = "xyz"


@dataclass(frozen=True)
class Entry:
    """One entry of a group."""

    name: str  # in the model
    identifier: str  # in C


@dataclass(frozen=True)
class Group:
    """One vector, or one list of columns, with named entries."""

    name: str  # "q"
    meaning: str  # for readers of the header
    entries: tuple[Entry, ...]


def list_groups(tree: Tree) -> tuple[Group, ...]:
    """List the groups of a tree that have entries, in the order of the header."""
    joints = tree.joints
    groups = (
        _group("q", "Entries of q", tree.coordinates),
        _group("qd", "Entries of qd and qdd, rows of Phi, rows and columns of M", (j.name for j in joints)),
        _group("u", "Entries of u: the actuated joints", (j.name for j in joints if j.actuated)),
        _group("a", "Entries of a and tau: the driven joints", (tree.bodies[i - 1].joint.name for i in tree.driven)),
        _group("lam", "Entries of h, hd, hdd and lam, rows of their Jacobian", name_equations(tree)),
        _group("yd", "Entries of yd and ydd: the independent joints", _list_independent(tree)),
        _group(
            "loop", "Loops: a function that fails at entry k returns the number of joints + 1 + k", name_loops(tree)
        ),
        _group(
            "length",
            f"Forces between points: a function that finds no direction of entry k returns {FIRST_LENGTH} + k",
            (x.length.label for x in tree.definitions if x.length is not None),
        ),
        _group("w", _describe_open(tree), _list_components(tree)),
        _group("p", "Entries of p: run-time parameters", _list_parameters(tree, Kind.RUNTIME)),
        _group("theta", "Entries of theta: differentiated parameters", _list_parameters(tree, Kind.DIFFERENTIATED)),
        _group("contact", "Entries of distance: points of contact", (x.name for x in tree.distances)),
        _group("sensor", "Columns of position, v and omega; six rows each of J", (s.name for s in tree.sensors)),
        _group(
            "body",
            "Columns of p of frames, three columns each of its R; the sensors follow",
            (b.name for b in tree.bodies),
        ),
    )
    return tuple(group for group in groups if group.entries)


def write_string(text: str) -> str:
    """Write a C string of any text: printable ASCII unchanged, other bytes escaped."""
    kept = (chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode("utf-8"))
    return f'"{"".join(kept)}"'


def _group(name: str, meaning: str, names: Iterable[str]) -> Group:
    own = list(names)
    return Group(name, meaning, tuple(Entry(x, identifier) for x, identifier in zip(own, identify(own), strict=True)))


def identify(names: Sequence[str]) -> list[str]:
    """Return distinct parts of C identifiers for distinct names."""
    plain = [re.sub("_+", "_", "".join(map(_soften, name))).strip("_") for name in names]
    return plain if all(plain) and len(set(plain)) == len(plain) else [mangle(name) for name in names]


def _soften(character: str) -> str:
    if character in " .-":
        return "_"
    return character if character == "_" or (character.isascii() and character.isalnum()) else escape(character)


def name_loops(tree: Tree) -> tuple[str, ...]:
    """Name loops, then constraints."""
    return (*(loop.name for loop in tree.loops), *(constraint.name for constraint in tree.constraints))


def name_equations(tree: Tree) -> tuple[str, ...]:
    """Name the entries of h, as in `knee.x`."""
    names = name_loops(tree)
    return tuple(f"{names[k]}.{equation}" for k, equation in kept_equations(tree))


def _list_independent(tree: Tree) -> Iterator[str]:
    if tree.closure is not None:
        yield from (tree.joints[i].name for i in tree.closure.independent)


def _describe_open(tree: Tree) -> str:
    wrenches = "Entries of w: components of the wrenches that are inputs"
    if not tree.signals:
        return wrenches
    return f"{wrenches}, then signals{f'; {TIME} is the time' if tree.signals[-1] == TIME else ''}"


def _list_components(tree: Tree) -> Iterator[str]:
    for wrench in tree.wrenches:
        for kind, vector in (("force", wrench.force), ("moment", wrench.moment)):
            if vector is None:
                yield from (f"{wrench.name}.{kind}.{axis}" for axis in AXES)
    yield from tree.signals


def _list_parameters(tree: Tree, kind: Kind) -> list[str]:
    return [parameter.name for parameter in tree.parameters if parameter.kind is kind]
