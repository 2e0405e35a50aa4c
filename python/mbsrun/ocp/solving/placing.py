"""Lines of a problem file for the parts of a problem that a solve refuses: ProblemError -> InputError.

A file is checked when it is read; what needs the kernels' values, a guess or a method is found later. Such findings
name parts of a problem, such as `end.coordinates` or `phase swing: contacts[0]`, which have other keys in a file.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from mbsgen.documents import Data, Document, Place, read_document, refuse
from mbsgen.errors import Fault, InputError
from mbsrun.ocp.guessing.recorded_phases import Name
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phases import STANDS, find_in_file
from mbsrun.ocp.statement.statement import PHASED
from mbsrun.reading import overlay, relate

_KEYS: Mapping[Place, Place] = {  # parts of a problem that have other keys in a file
    ("start_q",): ("start", "pose"),
    ("start_qd",): ("start", "velocity"),
    ("free_start",): ("start", "pose"),
    ("horizon_range",): ("horizon", "range"),
    ("mesh",): ("intervals",),
    ("delays",): ("inputs", "delay"),
    ("bounds", "q"): ("bounds", "coordinates"),
    ("bounds", "qd"): ("bounds", "velocities"),
    ("bounds", "u"): ("bounds", "inputs"),
    ("bounds", "rates"): ("bounds", "input_rates"),
    ("end", "coordinates"): ("end", "pose"),
    ("end", "velocities"): ("end", "velocity"),
    ("end", "accelerations"): ("end", "acceleration"),
}
_PHASE = re.compile(r"phase (?P<name>\w+): (?P<part>.*)", re.DOTALL)

Command = TypeVar("Command", bound=Callable[..., None])


def name_lines(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command on a problem's `file` name the lines of the parts that it refuses."""

    @functools.wraps(command)
    def call(*args: object, file: Path, **own: object) -> None:
        with naming_lines(file):
            command(*args, file=file, **own)

    return call


@contextmanager
def naming_lines(file: Path) -> Iterator[None]:
    """Turn the error of a problem that was read from a file into one with the file's lines."""
    try:
        yield
    except ProblemError as error:
        raise place_findings(error, read_document(file)) from None


@contextmanager
def naming_guess(file: Path, *, is_own: bool) -> Iterator[None]:
    """Name the line of a problem file that gives a guess, where the guess as a whole is at fault."""
    try:
        yield
    except InputError as error:
        if not is_own:
            raise
        raise refuse(relate(error.faults, read_document(file), ("guess", "solution"))) from None


def name_guesses(file: Path) -> Name:
    """Return the function that names the lines of a problem file which give the guesses of its phases."""

    def name(phase: int | None, faults: Sequence[Fault]) -> list[Fault]:
        document, place = read_document(file), ("guess", "solution")
        return relate(faults, document, place if phase is None else find_in_file(document, phase, place))

    return name


def name_place(file: Path, part: str) -> str:
    """Return file, line and place of a part of a problem that was read from a file, as `task.ocp.yaml:4: cost`."""
    fault = _place(read_document(file), part, "", "")
    return f"{fault.file}:{fault.line}: {fault.path}" if fault.line else f"{fault.file}: {fault.path}"


def place_findings(error: ProblemError, document: Document) -> InputError:
    """Return the error with the places of a file."""
    return refuse([_place(document, part, finding, remedy) for part, finding, remedy in error.findings])


def _place(document: Document, part: str, finding: str, remedy: str) -> Fault:
    data = document.data if isinstance(document.data, dict) else {}
    found = _PHASE.fullmatch(part)
    if found is None:
        return document.fault(_translate(_split(part), data), finding, remedy)
    phases = data.get("phases")
    every = [own for own in phases if isinstance(own, dict)] if isinstance(phases, list) else [{}]
    k = next((k for k, own in enumerate(every) if own.get("name") == found["name"]), 0)
    usual: dict[str, Data] = {key: value for key, value in data.items() if key not in PHASED}
    place = _translate(_split(found["part"]), overlay(usual, every[k]))
    return document.fault(find_in_file(document, k, place), finding, remedy)


def _split(part: str) -> Place:
    """Return a part as steps: "contacts[0].wrench" -> ("contacts", 0, "wrench"); the whole problem is ()."""
    steps = tuple(int(step) if step.isdigit() else step for step in re.findall(r"\w+", part))
    return () if steps == ("problem",) else steps


def _translate(part: Place, data: Data) -> Place:
    """Return the place in a file's data: keys by the file's names, entries of mappings by their keys."""
    for size in (1, 2):
        if part[:size] in _KEYS:
            part = (*_KEYS[part[:size]], *part[size:])
            break
    place: list[str | int] = []
    for step in part:
        if isinstance(data, dict) and isinstance(step, int):
            keys = list(data)
            if step >= len(keys):
                break
            step = keys[step]
        elif isinstance(data, list) and isinstance(step, int) and place == ["contacts"]:
            step = _order_contacts(data)[step]
        place.append(step)
        data = _enter(data, step)
    return tuple(place)


def _order_contacts(contacts: list[Data]) -> list[int]:
    """Return the contacts of a file in a problem's order: the ones that stand come first."""
    stands = [not isinstance(x, dict) or x.get("mode", STANDS) == STANDS for x in contacts]
    return sorted(range(len(contacts)), key=lambda i: not stands[i])


def _enter(data: Data, step: str | int) -> Data:
    if isinstance(data, dict) and isinstance(step, str):
        return data.get(step)
    if isinstance(data, list) and isinstance(step, int) and step < len(data):
        return data[step]
    return None
