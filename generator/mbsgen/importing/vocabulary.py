"""The vocabulary of a format: what may stand where motion is described, and the treatment of each part.

A vocabulary has places, such as a joint or its dynamics. A place lists the attributes (`@name`) and elements that a
format knows there. Each is read, of no meaning for the motion, warned of, or refused; whatever a place does not list is
warned of, too. A reader still reads what is read by itself: `survey` finds all the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element

TEXT = "#text"  # of an element, in the list of a place
_SPACES = ("xmlns", "xsi:", "xml:")  # attributes of XML itself
_NOTHING = ("false", "no")  # values that switch an element off


class Treatment(Enum):
    """The treatment of an element or an attribute by its reader."""

    READ = "read"
    IDLE = "of no meaning for the motion"
    WARNED = "warned of"
    REFUSED = "refused"


@dataclass(frozen=True)
class Part:
    """An element or an attribute at its place."""

    treatment: Treatment
    place: str | None = None  # inside of the element; None: nothing in it is looked at
    repeats: bool = False  # whether several beside each other are read
    text: str = ""  # of the warning or the fault
    remedy: str = ""
    harmless: tuple[str, ...] | None = None  # values that change nothing: no warning; None: 0 and false


Place = Mapping[str, Part]


@dataclass(frozen=True)
class Vocabulary:
    """The places of a format."""

    places: Mapping[str, Place]

    def __post_init__(self) -> None:
        assert all(
            part.place is None or part.place in self.places for place in self.places.values() for part in place.values()
        ), "every place is listed"


@dataclass
class Survey:
    """The result of a survey of a file, besides warnings and faults."""

    idle: dict[str, int] = field(default_factory=dict)  # elements of no meaning for the motion, and their number


def place(
    *,
    read: str = "",
    idle: str = "",
    warned: Mapping[str, str | Part] = MappingProxyType({}),
    refused: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> Place:
    """List a place: names that are read or idle, texts of warnings, findings and remedies of faults.

    `joint*=hinge` is an element that may be there several times, and opens the place `hinge`; without a sign, an
    element opens the place of its name, and `joint=` opens none.
    """
    found: dict[str, Part] = {}
    for word in read.split():
        name, sign, inside = word.partition("=")
        tag = name.removesuffix("*")
        opened = None if tag.startswith(("@", "#")) or (sign and not inside) else inside or tag
        found[tag] = Part(Treatment.READ, opened, repeats=name.endswith("*"))
    found |= {name: Part(Treatment.IDLE) for name in idle.split()}
    for name, text in warned.items():
        found[name] = text if isinstance(text, Part) else Part(Treatment.WARNED, text=text)
    for name, (text, remedy) in refused.items():
        found[name] = Part(Treatment.REFUSED, text=text, remedy=remedy)
    return MappingProxyType(found)


def warning(text: str, *harmless: str) -> Part:
    """Make the part that is warned of unless it has one of some values; without these, it always is."""
    return Part(Treatment.WARNED, text=text, harmless=harmless)


def survey(root: Element, vocabulary: Vocabulary, start: str, findings: Findings) -> Survey:
    """Add the warnings and faults of all elements and attributes that a reader does not read."""
    result = Survey()
    waiting = [(root, start)]
    while waiting:
        element, name = waiting.pop()
        known = vocabulary.places[name]
        _check_attributes(element, known, findings)
        waiting += [*_check_children(element, known, findings, result)][::-1]
    return result


def _check_attributes(element: Element, known: Place, findings: Findings) -> None:
    for name, value in element.attributes.items():
        if not name.startswith(_SPACES):
            _check(element, f"@{name}", f"{name[:40]} {abbreviate(value)}", [value], known, findings)
    if element.text and known.get(TEXT) is None:
        findings.warn(element, f"its text {abbreviate(element.text)} has no meaning here, and is left out")


def _check_children(
    element: Element, known: Place, findings: Findings, result: Survey
) -> Iterator[tuple[Element, str]]:
    """Yield the elements to look into, with their places."""
    seen: dict[str, Element] = {}
    for child in element.children:
        part = known.get(child.tag)
        if part is None or part.treatment in (Treatment.WARNED, Treatment.REFUSED):
            _check(child, child.tag, f"<{child.tag[:40]}>", _list_values(child), known, findings)
            continue
        if part.treatment is Treatment.IDLE:
            result.idle[child.tag] = result.idle.get(child.tag, 0) + 1
            continue
        if child.tag in seen and not part.repeats:
            text = f"a second <{child.tag}>, which is left out: line {seen[child.tag].line} has the first"
            findings.warn(child, text)
            continue
        seen[child.tag] = child
        if part.place is not None:
            yield child, part.place


def _check(element: Element, key: str, shown: str, values: list[str], known: Place, findings: Findings) -> None:
    part = known.get(key)
    if part is None:
        kind = "@" if key.startswith("@") else ""
        names = [name.removeprefix("@") for name in known if name.startswith("@") == bool(kind) and name != TEXT]
        meant = nearest(key.removeprefix("@"), names)
        hint = f" (did you mean {meant}?)" if meant else ""
        findings.warn(element, f"{shown} is not known here, and is left out{hint}")
    elif part.treatment is Treatment.REFUSED:
        findings.fault(element, part.text, part.remedy)
    elif part.treatment is Treatment.WARNED and not (values and all(_is_harmless(x, part) for x in values)):
        findings.warn(element, part.text)


def _list_values(element: Element) -> list[str]:
    """List the texts and attributes of an element, and of all in it."""
    return [value for each in element.walk() for value in (each.text, *each.attributes.values()) if value]


def _is_harmless(value: str, part: Part) -> bool:
    text = value.strip().lower()
    if part.harmless is not None:
        return text in part.harmless
    if text in _NOTHING:
        return True
    try:
        return not any(float(word) for word in text.split())
    except ValueError:
        return False
