"""Names in a model: their form, and that no two of a kind look alike.

Names never reach a path or a shell, and are mangled on their way into C, so that keywords and `gamma` are fine.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import replace

from mbsgen.documents import Finding, Place, abbreviate, lies_under
from mbsgen.expressions import is_free_name, names
from mbsgen.manifest import TIME
from mbsgen.model.expansion import list_steps
from mbsgen.model.model import BASE, COORDINATE, FREE, LENGTH, LENGTH_RATE, RATE, Model
from mbsgen.model.quantities import find_read_signals, list_quantities

MAX_LENGTH = 64

Named = tuple[Place, str]


def check_names(model: Model, doubtful: Container[Place]) -> Iterator[Finding]:
    """Find names that are malformed, reserved, or alike, one a place. Those under a doubtful place are passed over."""
    told: set[Place] = set()
    for finding in _check_names(model, doubtful):
        if finding.place not in told:
            told.add(finding.place)
            yield finding


def _check_names(model: Model, doubtful: Container[Place]) -> Iterator[Finding]:
    def trusted(names: list[Named]) -> list[Named]:
        return [(place, name) for place, name in names if not lies_under(place, doubtful)]

    bodies = trusted([(("bodies", i, "name"), body.name) for i, body in enumerate(model.bodies)])
    between, joints = (trusted(names) for names in _name_steps(model))
    frames = trusted([(("frames", i, "name"), frame.name) for i, frame in enumerate(model.frames)])
    wrenches = trusted([(("wrenches", i, "name"), wrench.name) for i, wrench in enumerate(model.wrenches)])
    parameters = trusted([(("parameters", p.name), p.name) for p in model.parameters])
    loops = trusted([(("loops", i, "name"), loop.name) for i, loop in enumerate(model.loops)])
    loops += trusted([(("constraints", i, "name"), constraint.name) for i, constraint in enumerate(model.constraints)])
    forces = trusted([(("forces", i, "name"), element.name) for i, element in enumerate(model.forces)])
    forces += trusted([(("contacts", i, "name"), contact.name) for i, contact in enumerate(model.contacts)])
    forces += trusted([(("stops", i, "name"), stop.name) for i, stop in enumerate(model.stops)])
    whole = trusted([(("name",), model.name)])
    for place, name in [*whole, *bodies, *between, *joints, *frames, *wrenches, *forces, *loops]:
        yield from _check_form(place, name)
    for place, name in parameters:
        yield from _check_parameter(place, name)
        if name in (COORDINATE, RATE) and any(j.law != FREE for body in model.bodies for j in body.joints):
            yield Finding(place, f"in the force laws of joints {name} is the joint's own", "give another name")
    for place, name in bodies:
        if _normalise(name) == BASE:
            yield Finding(place, f"name {abbreviate(name)} is the name of the fixed base", "give the body another name")
    for alike in (between + bodies, joints, frames, wrenches, forces, loops):
        yield from _check_alike(alike, _normalise)
    signals = trusted([(("signals", i), name) for i, name in enumerate(model.signals)])
    yield from _check_signals(signals, model)
    yield from _check_alike(parameters + signals, str)  # m and M are different letters of a formula


def _name_steps(model: Model) -> tuple[list[Named], list[Named]]:
    """Name the bodies between the joints of sequences, and the joints, each where its name comes from."""
    between: list[Named] = []
    joints: list[Named] = []
    for i, body in enumerate(model.bodies):
        of_body: Place = ("bodies", i, "name")
        for step in list_steps(i, body):
            joints.append(((*step.place, "name") if step.joint.name is not None else of_body, step.name))
            if step.mover != body.name:
                between.append((of_body, step.mover))
    return between, joints


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
    elif not is_free_name(name):
        yield Finding(place, f"expressions have their own meaning of {abbreviate(name)}", "give another name")


def _check_signals(signals: Sequence[Named], model: Model) -> Iterator[Finding]:
    meant = list_quantities(replace(model, signals=()))
    driven = [names(x.muscle.activation) for x in model.forces if x.muscle is not None]
    read, taken = frozenset(find_read_signals(model)).union(*driven), {p.name for p in model.parameters}
    for place, name in signals:
        yield from _check_parameter(place, name)
        if name in (COORDINATE, RATE, LENGTH, LENGTH_RATE, TIME):
            yield Finding(place, f"forces have their own meaning of {name}", "give another name")
        elif name in meant:
            yield Finding(place, f"{name} is a number of the state too", "give another name")
        elif name not in read and name not in taken:
            yield Finding(place, f"no force reads {abbreviate(name)}", "take it away, or use it in a force")


def _check_alike(names: Sequence[Named], normalise: Callable[[str], str]) -> Iterator[Finding]:
    first: dict[str, Named] = {}
    for place, name in names:
        origin, other = first.setdefault(normalise(name), (place, name))
        if origin != place:
            finding = "is taken" if other == name else f"is hard to tell from {abbreviate(other)}"
            yield Finding(place, f"name {abbreviate(name)} {finding}", "give another name")


def _normalise(name: str) -> str:
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())
