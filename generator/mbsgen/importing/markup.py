"""Untrusted XML -> a tree of elements with their lines and paths; bounded in size, depth and number before it is built.

Declarations of document types and entities are refused, so nothing is expanded and nothing outside the file is read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from xml.parsers import expat

from mbsgen.documents import abbreviate, read_bytes
from mbsgen.errors import Fault, InputError

MAX_BYTES = 1 << 23
MAX_DEPTH = 200
MAX_ELEMENTS = 100_000
MAX_ATTRIBUTES = 60  # of one element


@dataclass(frozen=True)
class Element:
    """One element of a file."""

    tag: str
    attributes: Mapping[str, str]
    children: tuple[Element, ...]
    text: str  # between its tags, without blanks at the ends
    file: str
    line: int
    path: str  # such as robot/joint[elbow]/limit

    def all(self, *tags: str) -> Iterator[Element]:
        """Yield the children with these tags."""
        return (child for child in self.children if child.tag in tags)

    def first(self, tag: str) -> Element | None:
        """Return the first child with a tag, if there is any."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """Yield the element and all below it, in the order of the file."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting += element.children[::-1]

    def fault(self, finding: str, remedy: str) -> Fault:
        """Make the fault of this element."""
        return Fault(self.file, self.line, self.path, finding, remedy)


@dataclass
class _Open:
    """An element whose end has not been read yet."""

    tag: str
    attributes: dict[str, str]
    line: int
    path: str
    children: list[Element] = field(default_factory=list)
    text: list[str] = field(default_factory=list)


def read_markup(path: Path) -> Element:
    """Read an XML file. Raises InputError if it cannot be read."""
    file = str(path)
    raw = read_bytes(path, MAX_BYTES)
    reading = _Reading(file)
    try:
        return reading.read(raw)
    except expat.ExpatError as error:
        finding = f"this is no XML: {expat.ErrorString(error.code)}"
        raise InputError([Fault(file, error.lineno, "", finding, "mend it here or just before")]) from None
    except (LookupError, ValueError) as error:  # an unknown encoding
        raise InputError([Fault(file, 1, "", f"cannot be read: {error}", "save the file as UTF-8")]) from None


def write_markup(root: Element) -> str:
    """Write a document with an element's tree; comments of its file are lost."""
    return '<?xml version="1.0" encoding="UTF-8" ?>\n' + "".join(f"{line}\n" for line in _write(root, ""))


def _write(element: Element, indent: str) -> Iterator[str]:
    from xml.sax.saxutils import escape, quoteattr  # here: it loads the library of web requests, and few write markup

    tag = element.tag + "".join(f" {key}={quoteattr(value)}" for key, value in element.attributes.items())
    if not element.children:
        yield f"{indent}<{tag}>{escape(element.text)}</{element.tag}>" if element.text else f"{indent}<{tag} />"
        return
    yield f"{indent}<{tag}>" + (escape(element.text) if element.text else "")
    for child in element.children:
        yield from _write(child, indent + "\t")
    yield f"{indent}</{element.tag}>"


class _Reading:
    """Turns the events of a parser into elements."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._open: list[_Open] = []
        self._count = 0
        self._root: Element | None = None
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._take_text
        self._parser.StartDoctypeDeclHandler = self._refuse_declaration
        self._parser.EntityDeclHandler = self._refuse_declaration

    def read(self, raw: bytes) -> Element:
        """Read a file's bytes."""
        self._parser.Parse(raw, True)
        assert self._root is not None, "a document without a root is no XML"
        return self._root

    def _fail(self, finding: str, remedy: str) -> InputError:
        return InputError([Fault(self._file, self._parser.CurrentLineNumber, "", finding, remedy)])

    def _refuse_declaration(self, *_: object) -> None:
        raise self._fail("a document type or an entity is declared", "remove the declaration, and write its text out")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise self._fail(f"more than {MAX_ELEMENTS} elements", "shorten the file")
        if len(self._open) >= MAX_DEPTH:
            raise self._fail(f"nested deeper than {MAX_DEPTH} elements", "flatten it")
        if len(attributes) > MAX_ATTRIBUTES:
            raise self._fail(f"an element of {len(attributes)} attributes", f"give at most {MAX_ATTRIBUTES}")
        name = attributes.get("name", "")
        step = _show(tag) + (f"[{_show(name)}]" if name else "")
        path = f"{self._open[-1].path}/{step}" if self._open else _show(tag)
        self._open.append(_Open(tag, attributes, self._parser.CurrentLineNumber, path))

    def _end(self, _: str) -> None:
        o = self._open.pop()
        attributes, text = MappingProxyType(o.attributes), "".join(o.text).strip()
        element = Element(o.tag, attributes, tuple(o.children), text, self._file, o.line, _shorten(o.path))
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element

    def _take_text(self, text: str) -> None:
        if self._open:
            self._open[-1].text.append(text)


def _show(name: str) -> str:
    return name if re.fullmatch(r"[\w:.-]{1,64}", name) else abbreviate(name)


def _shorten(path: str) -> str:
    """Keep the beginning and the end of a long path, since bodies of bodies nest deep."""
    steps = path.split("/")
    return path if len(steps) <= 6 else "/".join([*steps[:2], "...", *steps[-3:]])
