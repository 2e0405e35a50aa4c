"""YAML -> Document: bounded in size, depth and number of values before it is composed; nothing in it is run."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import yaml

from mbsgen.documents.places import Data, Place, refuse, write_path
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import MAX_DIGITS, ExpressionError, read_double

MAX_BYTES = 1 << 20
GENERATED = "manifest.json"  # a folder that mbsgen has generated holds this file
MAX_DEPTH = 32
MAX_VALUES = 50_000
_DISPUTED = re.compile(r"[\t?]")  # libyaml takes tabs for blanks, and ? into plain words within brackets


@dataclass(frozen=True)
class Document:
    """A file's data, with the line of every value."""

    file: str
    data: Data
    lines: Mapping[Place, int]
    faults: Mapping[Place, Fault]  # faults that did not stop the reading

    def line(self, place: Place) -> int:
        """Return the line, from 1, of a value, or of the nearest enclosing value in the file."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 0)

    def fault(self, place: Place, finding: str, remedy: str) -> Fault:
        """Make the fault of one place."""
        return Fault(self.file, self.line(place), write_path(place), finding, remedy)


def read_document(path: Path) -> Document:
    """Read a YAML file. Raises InputError if reading cannot continue; lesser faults are in `Document.faults`."""
    file = str(path)
    text = _read_text(path, file)
    return _read_fast(file, text) or _read(file, text, yaml.SafeLoader)


def _read_fast(file: str, text: str) -> Document | None:
    """Read by libyaml, which is many times faster; None where PyYAML's own parser decides.

    It decides where libyaml is missing, finds a fault, or may accept a text that PyYAML refuses.
    """
    if not yaml.__with_libyaml__ or _DISPUTED.search(text):
        return None
    try:
        document = _read(file, text, yaml.CSafeLoader)
    except InputError:
        return None
    return None if document.faults else document


def _read(file: str, text: str, loader: type[yaml.SafeLoader] | type[yaml.CSafeLoader]) -> Document:
    composer = _Composer(file)
    try:
        data = composer.compose(yaml.parse(text, Loader=loader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        finding = " ".join(x for x in (error.context, error.problem) if x).replace("\n", " ")[:200]
        remedy = "mend the YAML syntax here or just before"
        raise composer.fatal((), mark.line + 1 if mark else 0, finding, remedy) from None
    return Document(file, data, MappingProxyType(composer.lines), MappingProxyType(composer.faults))


def _read_text(path: Path, file: str) -> str:
    raw = read_bytes(path, MAX_BYTES)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        finding = f"byte 0x{raw[error.start]:02x} is not UTF-8"
        raise InputError([Fault(file, line, "", finding, "save the file as UTF-8 text")]) from None
    for match in re.finditer(r"[^\t\n\r -~]", text):
        if _is_control(match[0]):
            line = text.count("\n", 0, match.start()) + 1
            finding = f"control character U+{ord(match[0]):04X}"
            raise InputError([Fault(file, line, "", finding, "remove it")])
    return text


def read_bytes(path: Path, limit: int) -> bytes:
    """Read a file of at most `limit` bytes. Raises InputError."""
    file = str(path)
    try:
        if not path.exists():
            raise InputError([Fault(file, 0, "", "there is no such file", "check the path")])
        if path.is_dir():
            raise InputError([Fault(file, 0, "", *_describe_folder(path))])
        if not path.is_file():
            raise InputError([Fault(file, 0, "", "this is not a file", "give the path of a file")])
        with path.open("rb") as stream:
            raw = stream.read(limit + 1)
    except (OSError, ValueError) as error:
        finding = getattr(error, "strerror", None) or str(error)
        raise InputError([Fault(file, 0, "", f"cannot be read: {finding}", "check the path")]) from None
    if len(raw) > limit:
        raise InputError([Fault(file, 0, "", f"larger than {limit} bytes", "split the file or shorten it")])
    return raw


def _describe_folder(path: Path) -> tuple[str, str]:
    """Return finding and remedy for a folder in place of a file."""
    if (path / GENERATED).is_file():
        return "this is a folder that mbsgen has generated", "give the file that it was generated from"
    files = sorted(entry for entry in path.iterdir() if entry.is_file() and entry.suffix)
    inside = [file.name for file in sorted(files, key=lambda file: file.suffix not in (".yaml", ".yml"))]
    shown = ", ".join(inside[:3]) + (", ..." if len(inside) > 3 else "")
    return "this is a folder", f"give a file, such as {shown} in it" if inside else "give the path of a file"


def _is_control(character: str) -> bool:
    """Return whether no text needs a character: controls, line separators, overrides of direction, noncharacters."""
    return (
        unicodedata.category(character) in {"Cc", "Cs", "Zl", "Zp"}
        or character in _OVERRIDES
        or ord(character) & 0xFFFE == 0xFFFE
    )


_OVERRIDES = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"


class _Composer:
    """Turns parser events into plain data; depth is bounded, so recursion is."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[Place, int] = {}
        self.faults: dict[Place, Fault] = {}
        self.values = 0

    def compose(self, events: Iterator[yaml.Event]) -> Data:
        """Compose the one document of a stream. Raises InputError if reading cannot continue."""
        next(events)  # stream start
        start = next(events)
        if not isinstance(start, yaml.DocumentStartEvent):
            raise self.fatal((), 0, "the file is empty", "describe something in it")
        if start.version or start.tags:
            raise self.fatal((), _line(start), "directives have no use here", "remove the lines with %")
        data = self.value(next(events), events, ())
        next(events)  # document end
        end = next(events)
        if not isinstance(end, yaml.StreamEndEvent):
            raise self.fatal((), _line(end), "a second document begins", "keep one document in a file")
        if data is None and not self.faults:
            raise self.fatal((), 0, "the file is empty", "describe something in it")
        return data

    def value(self, event: yaml.Event, events: Iterator[yaml.Event], place: Place) -> Data:
        """Compose the value that starts with `event`."""
        line = _line(event)
        self.lines.setdefault(place, line)
        self.values += 1
        if self.values > MAX_VALUES:
            raise self.fatal((), line, f"more than {MAX_VALUES} values", "split the file or shorten it")
        if len(place) > MAX_DEPTH:
            raise self.fatal((), line, f"nested deeper than {MAX_DEPTH} levels", "flatten it")
        if isinstance(event, yaml.AliasEvent):
            self.fault(place, line, f"alias *{str(event.anchor)[:40]}", "write the value out")
            return None
        assert isinstance(event, yaml.ScalarEvent | yaml.SequenceStartEvent | yaml.MappingStartEvent)
        if event.anchor is not None:
            self.fault(place, line, f"anchor &{event.anchor[:40]}", "remove it, and write repeated values out")
        if event.tag is not None:
            self.fault(place, line, f"tag {str(event.tag)[:40]}", "remove it")
        if isinstance(event, yaml.SequenceStartEvent):
            return self.sequence(events, place)
        if isinstance(event, yaml.MappingStartEvent):
            return self.mapping(events, place)
        return self.string(event.value, place, line) if event.style else self.scalar(event.value, place, line)

    def sequence(self, events: Iterator[yaml.Event], place: Place) -> list[Data]:
        """Compose a list whose start event has been read."""
        items: list[Data] = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            items.append(self.value(event, events, (*place, len(items))))
        return items

    def mapping(self, events: Iterator[yaml.Event], place: Place) -> dict[str, Data]:
        """Compose a mapping whose start event has been read; of a repeated key the first value stays."""
        mapping: dict[str, Data] = {}
        while not isinstance(event := next(events), yaml.MappingEndEvent):
            line = _line(event)
            if not isinstance(event, yaml.ScalarEvent):
                raise self.fatal(place, line, "a key that is not a string", "give a name followed by a colon")
            key, inner = event.value, (*place, event.value)
            if key in mapping:
                self.fault(inner, line, f"key repeated, first in line {self.lines[inner]}", "keep one of them")
                self.value(next(events), events, inner)
                continue
            self.lines[inner] = line
            if event.anchor is not None or event.tag is not None:
                self.fault(inner, line, "a key with an anchor or a tag", "write the plain key")
            if not event.style and not isinstance(self.scalar(key, inner, line), str):
                self.fault(inner, line, f"key {key[:40]} is not a string", "give a name, or put it into quotes")
            self.string(key, inner, line)
            mapping[key] = self.value(next(events), events, inner)
        return mapping

    def scalar(self, text: str, place: Place, line: int) -> Data:
        """Resolve a plain scalar by YAML 1.2's core schema."""
        if text in _WORDS:
            return _WORDS[text]
        if not _NUMBER.fullmatch(text):
            return self.string(text, place, line)
        if len(text) > MAX_DIGITS:
            self.fault(place, line, f"a number of {len(text)} characters", f"give at most {MAX_DIGITS}")
            return None
        if re.fullmatch(r"0[xo].*", text):
            return int(text, 0)
        if re.fullmatch(r"[-+]?[0-9]+", text):
            return int(text, 10)
        try:
            return read_double(text)
        except ExpressionError as error:
            self.fault(place, line, error.finding, error.remedy)
            return None

    def string(self, text: str, place: Place, line: int) -> str:
        """Return a string without control characters, which escapes in quotes may contain."""
        for character in text:
            if character not in "\n\t" and not " " <= character <= "~" and _is_control(character):
                self.fault(place, line, f"control character U+{ord(character):04X}", "remove it")
                break
        return text

    def fault(self, place: Place, line: int, finding: str, remedy: str) -> None:
        """Keep the first fault of a place."""
        self.faults.setdefault(place, Fault(self.file, line, write_path(place), finding, remedy))

    def fatal(self, place: Place, line: int, finding: str, remedy: str) -> InputError:
        """Make the error that ends the reading, with the faults so far."""
        return refuse([*self.faults.values(), Fault(self.file, line, write_path(place), finding, remedy)])


def _line(event: yaml.Event) -> int:
    assert event.start_mark is not None, "events of a parser have marks"
    return event.start_mark.line + 1


_WORDS: Mapping[str, bool | float | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **{sign + word: math.inf for sign in ("", "+") for word in (".inf", ".Inf", ".INF")},
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
_NUMBER = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+|[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
