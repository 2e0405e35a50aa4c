"""Names in a model: their form, and that no two of a kind look alike.

Names never reach a path or a shell, and are mangled on their way into C, so that keywords and `gamma` are fine.
"""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Container, Iterator, Sequence

from mbsgen.documents import Place, abbreviate, lies_under
from mbsgen.expressions import CONSTANTS, FUNCTIONS
from mbsgen.model.findings import Finding
from mbsgen.model.model import BASE, Body, Model

MAX_LENGTH = 64

Named = tuple[Place, str]


def check_names(model: Model, doubtful: Container[Place]) -> Iterator[Finding]:
    """Find names that are malformed, reserved, or alike. Names under a doubtful place are passed over."""

    def trusted(names: list[Named]) -> list[Named]:
        return [(place, name) for place, name in names if not lies_under(place, doubtful)]

    bodies = trusted([(("bodies", i, "name"), body.name) for i, body in enumerate(model.bodies)])
    joints = trusted([_name_joint(i, body) for i, body in enumerate(model.bodies)])
    frames = trusted([(("frames", i, "name"), frame.name) for i, frame in enumerate(model.frames)])
    parameters = trusted([(("parameters", p.name), p.name) for p in model.parameters])
    for place, name in [*trusted([(("name",), model.name)]), *bodies, *joints, *frames]:
        yield from _check_form(place, name)
    for place, name in parameters:
        yield from _check_parameter(place, name)
    for place, name in bodies:
        if _normalise(name) == BASE:
            yield Finding(place, f"name {abbreviate(name)} is that of what does not move", "give the body another name")
    for names in (bodies, joints, frames, parameters):
        yield from _check_alike(names)


def _name_joint(i: int, body: Body) -> Named:
    """Tell where a joint has its name from: if it has none of its own, from its body."""
    own = body.joint.name != body.name
    return ("bodies", i, "joint", "name") if own else ("bodies", i, "name"), body.joint.name


def _check_form(place: Place, name: str) -> Iterator[Finding]:
    if not name.strip():
        yield Finding(place, "an empty name", "give a name")
    elif len(name) > MAX_LENGTH:
        yield Finding(place, f"a name of {len(name)} characters", f"give at most {MAX_LENGTH}")
    elif name != name.strip():
        yield Finding(place, f"name {abbreviate(name)} has blanks at its ends", "remove them")
    elif hidden := [c for c in name if unicodedata.category(c)[0] == "C" or unicodedata.category(c) in ("Zl", "Zp")]:
        yield Finding(place, f"a name with the hidden character U+{ord(hidden[0]):04X}", "remove it")
    elif re.search(r"[/\\]", name) or name[0] in ".~":
        yield Finding(place, f"name {abbreviate(name)} looks like a path", "leave out / \\ and a leading . or ~")


def _check_parameter(place: Place, name: str) -> Iterator[Finding]:
    if len(name) > MAX_LENGTH:
        yield Finding(place, f"a name of {len(name)} characters", f"give at most {MAX_LENGTH}")
    elif not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        yield Finding(place, f"expressions cannot use the name {abbreviate(name)}", "use letters, digits and _")
    elif name in FUNCTIONS or name in CONSTANTS or keyword.iskeyword(name):
        yield Finding(place, f"expressions have their own meaning of {abbreviate(name)}", "give another name")


def _check_alike(names: Sequence[Named]) -> Iterator[Finding]:
    first: dict[str, Named] = {}
    for place, name in names:
        origin, other = first.setdefault(_normalise(name), (place, name))
        if origin != place:
            finding = "is taken" if other == name else f"is hard to tell from {abbreviate(other)}"
            yield Finding(place, f"name {abbreviate(name)} {finding}", "give another name")


def _normalise(name: str) -> str:
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())
