"""Untrusted YAML files: text -> `Document` (plain data with line numbers) -> a validated pydantic schema.

The language is YAML 1.2's core schema without anchors, aliases, tags, directives and merge keys: `1e3` is a number,
`on` and `12:30` are strings, `010` is ten. Size, nesting and the number of values are bounded before anything is
composed. Every fault becomes a `Fault` with file, line, path, finding and remedy; those of one file come together.
"""

from __future__ import annotations

import copy
import difflib
import json
import math
import re
import unicodedata
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Generic, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from mbsgen.errors import Fault, InputError

MAX_BYTES = 1 << 20
MAX_DEPTH = 32
MAX_VALUES = 50_000
MAX_DIGITS = 64  # characters of one number
MAX_FAULTS = 100  # faults told of one file
MAX_CANDIDATES = 200  # words that a mistyped one is compared with

Data = dict[str, "Data"] | list["Data"] | str | int | float | bool | None
Place = tuple[str | int, ...]  # keys and indices from the top of a document
Shape = TypeVar("Shape", bound=BaseModel)


class Section(BaseModel):
    """Base of the schemas of files: nothing is converted, nothing unknown is let through, nothing changes later."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class WrongValueError(ValueError):
    """Raised by a schema's validator: what was found, and what to do about it."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding = finding
        self.remedy = remedy
        super().__init__(f"{finding}; {remedy}")


@dataclass(frozen=True)
class Document:
    """A file's data, with the line of every value."""

    file: str
    data: Data
    lines: Mapping[Place, int]
    faults: Mapping[Place, Fault] = field(default_factory=lambda: MappingProxyType({}))  # that did not stop the reading

    def line(self, place: Place) -> int:
        """Return the line, from 1, of a value, or of the nearest thing around it that is in the file."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 0)

    def fault(self, place: Place, finding: str, remedy: str) -> Fault:
        """Make the fault of one place."""
        return Fault(self.file, self.line(place), write_path(place), finding, remedy)


@dataclass(frozen=True)
class Examination(Generic[Shape]):
    """What validation tells: all faults, and a value to look for further faults in.

    Where the file is at fault, `value` holds the example that the schema gives there; what follows from such a place
    (listed in `stand_ins`) tells nothing about the file. `value` is None where the schema has no example.
    """

    value: Shape | None
    faults: tuple[Fault, ...]
    stand_ins: frozenset[Place]


def read_document(path: Path) -> Document:
    """Read a YAML file. Raises InputError for what cannot be read on; lesser faults wait in `Document.faults`."""
    file = str(path)
    text = _read_text(path, file)
    composer = _Composer(file)
    try:
        data = composer.compose(yaml.parse(text, Loader=yaml.SafeLoader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        finding = " ".join(x for x in (error.context, error.problem) if x).replace("\n", " ")
        fatal = Fault(file, mark.line + 1 if mark else 0, "", finding, "mend the YAML syntax here or just before")
        raise InputError([*composer.faults.values(), fatal]) from None
    return Document(file, data, MappingProxyType(composer.lines), MappingProxyType(composer.faults))


def validate(document: Document, schema: type[Shape]) -> Shape:
    """Check a document against a schema. Raises InputError with every fault."""
    examination = examine(document, schema)
    if examination.faults:
        raise refuse(examination.faults)
    assert examination.value is not None, "a document without faults has a value"
    return examination.value


def examine(document: Document, schema: type[Shape]) -> Examination[Shape]:
    """Check a document against a schema, and go on with examples in place of what is at fault."""
    value, errors = _load(document.data, schema)
    troubles = _troubles(errors, document.data)
    if not troubles:
        return Examination(value, tuple(document.faults.values()), frozenset(document.faults))
    told = sorted(troubles, key=document.line)[: MAX_FAULTS + 1]
    faults = [
        document.fault(place, *_explain(troubles[place], place, schema))
        for place in told
        if not lies_under(place, document.faults)
    ]
    data = copy.deepcopy(document.data)
    stand_ins: set[Place] = set()
    for place, error in troubles.items():
        if not lies_under(place, stand_ins):
            stand_ins.add(_stand_in(data, place, error, schema))
    value, _ = _load(data, schema)
    return Examination(value, (*document.faults.values(), *faults), frozenset(stand_ins.union(document.faults)))


def refuse(faults: Sequence[Fault]) -> InputError:
    """Make the error of a file that is not accepted; of very many faults the first ones are told."""
    ordered = sorted(set(faults))
    if len(ordered) > MAX_FAULTS:
        last = ordered[MAX_FAULTS - 1]
        rest = Fault(last.file, last.line, last.path, "there are more faults after this", "mend these first")
        ordered = [*ordered[:MAX_FAULTS], rest]
    return InputError(ordered)


def lies_under(place: Place, places: Container[Place]) -> bool:
    """Tell whether a place is one of `places` or inside one."""
    return any(place[:i] in places for i in range(len(place) + 1))


def write_path(place: Place) -> str:
    """Write a place as a user reads it: `bodies[2].joint.axis`."""
    path = ""
    for step in place:
        if isinstance(step, int):
            path += f"[{step}]"
        elif re.fullmatch(r"\w[\w-]{0,63}", step):
            path += f".{step}" if path else step
        else:
            path += f"[{abbreviate(step)}]"
    return path


def abbreviate(data: Data) -> str:
    """Show a value in at most some sixty characters."""
    match data:
        case None:
            return "nothing"
        case dict() if len(data) > 0:
            return f"a mapping of {', '.join(abbreviate(k) for k in list(data)[:3])}{', ...' if len(data) > 3 else ''}"
        case list() if len(data) > 6:
            return f"a list of {len(data)}"
        case list():
            inner = ", ".join(abbreviate(x) for x in data)
            return f"[{inner}]" if len(inner) < 60 else f"a list of {len(data)}"
        case str():
            return json.dumps(data if len(data) <= 40 else data[:37] + "...", ensure_ascii=False)
        case float() if not math.isfinite(data):
            return str(data)
    return json.dumps(data)


def nearest(word: str, words: Sequence[str]) -> str | None:
    """Find the word that was probably meant."""
    known = {known.casefold(): known for known in words[:MAX_CANDIDATES]}
    return next((known[found] for found in difflib.get_close_matches(word[:100].casefold(), known, 1)), None)


# --- text ----------------------------------------------------------------------------------------------------------


def _read_text(path: Path, file: str) -> str:
    raw = _read_bytes(path, file)
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


def _read_bytes(path: Path, file: str) -> bytes:
    try:
        if not path.exists():
            raise InputError([Fault(file, 0, "", "there is no such file", "check the path")])
        if not path.is_file():
            raise InputError([Fault(file, 0, "", "this is not a file", "give the path of a YAML file")])
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        finding = getattr(error, "strerror", None) or str(error)
        raise InputError([Fault(file, 0, "", f"cannot be read: {finding}", "check the path")]) from None
    if len(raw) > MAX_BYTES:
        raise InputError([Fault(file, 0, "", f"larger than {MAX_BYTES} bytes", "split the file or shorten it")])
    return raw


def _is_control(character: str) -> bool:
    """Tell characters that no text needs: control, surrogates, line and paragraph separators, direction overrides."""
    return (
        unicodedata.category(character) in {"Cc", "Cs", "Zl", "Zp"}
        or character in "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
    )


# --- YAML ----------------------------------------------------------------------------------------------------------


class _Composer:
    """Turns parser events into plain data; depth is bounded, so recursion is."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[Place, int] = {}
        self.faults: dict[Place, Fault] = {}
        self.values = 0

    def compose(self, events: Iterator[yaml.Event]) -> Data:
        """Compose the one document of a stream. Raises InputError for what makes no sense to read on."""
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
        """Compose the value that begins with `event`."""
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
        plain = event.style is None or event.style == ""
        return self.scalar(event.value, place, line) if plain else self.string(event.value, place, line)

    def sequence(self, events: Iterator[yaml.Event], place: Place) -> list[Data]:
        """Compose a list whose start has been taken."""
        items: list[Data] = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            items.append(self.value(event, events, (*place, len(items))))
        return items

    def mapping(self, events: Iterator[yaml.Event], place: Place) -> dict[str, Data]:
        """Compose a mapping whose start has been taken; of a repeated key the first value stays."""
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
            if event.style is None and not isinstance(self.scalar(key, inner, line), str):
                self.fault(inner, line, f"key {key[:40]} is not a string", "give a name, or put it into quotes")
            self.string(key, inner, line)
            mapping[key] = self.value(next(events), events, inner)
        return mapping

    def scalar(self, text: str, place: Place, line: int) -> Data:
        """Resolve a plain scalar by YAML 1.2's core schema."""
        if text in _WORDS:
            return _WORDS[text]
        if not _NUMBER.fullmatch(text[:MAX_BYTES]):
            return self.string(text, place, line)
        if len(text) > MAX_DIGITS:
            self.fault(place, line, f"a number of {len(text)} characters", f"give at most {MAX_DIGITS}")
            return None
        if re.fullmatch(r"0[xo].*", text):
            return int(text, 0)
        if re.fullmatch(r"[-+]?[0-9]+", text):
            return int(text, 10)
        number = float(text)
        if math.isinf(number):
            self.fault(place, line, f"{text} is beyond the largest double", "give a smaller number")
        if number == 0 and re.search("[1-9]", re.split("[eE]", text)[0]):
            self.fault(place, line, f"{text} is below the smallest double", "give 0 or a larger number")
        return number

    def string(self, text: str, place: Place, line: int) -> str:
        """Take a string; an escape in quotes may have brought a control character in."""
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


# --- schema --------------------------------------------------------------------------------------------------------


def _load(data: Data, schema: type[Shape]) -> tuple[Shape | None, list[ErrorDetails]]:
    """Validate as JSON: there a list may fill a tuple even where nothing is converted."""
    try:
        return schema.model_validate_json(json.dumps(data)), []
    except ValidationError as error:
        return None, error.errors(include_url=False)


def _troubles(errors: Sequence[ErrorDetails], data: Data) -> dict[Place, ErrorDetails]:
    """Sort errors by place, one each; of a union's members the one that got deepest into the data is believed."""
    by_place: dict[Place, ErrorDetails] = {}
    for error in errors:
        by_place.setdefault(_place(error, data), error)
    around = {place[:i] for place in by_place for i in range(len(place))}
    return {place: error for place, error in by_place.items() if place not in around}


def _place(error: ErrorDetails, data: Data) -> Place:
    """Take pydantic's own tags (of unions, of keys) out of an error's location."""
    place: Place = ()
    for i, step in enumerate(error["loc"]):
        if isinstance(data, dict) and step in data:
            data = data[str(step)]
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
        elif not (error["type"] == "missing" and i == len(error["loc"]) - 1 and isinstance(step, str)):
            continue
        place = (*place, step)
    return place


def _explain(error: ErrorDetails, place: Place, schema: type[BaseModel]) -> tuple[str, str]:
    """Put a pydantic error into finding and remedy."""
    context = error.get("ctx", {})
    if isinstance(wrong := context.get("error"), WrongValueError):
        return wrong.finding, wrong.remedy
    found = f"found {abbreviate(error['input'])}"
    match error["type"]:
        case "missing" | "too_short" | "too_long" if isinstance(error["input"], list):
            return f"found a list of {len(error['input'])}", _give_example("a list of another length", schema, place)
        case "missing":
            return "missing", _give_example("it", schema, place)
        case "extra_forbidden":
            return "unknown key", _suggest(str(place[-1]), _keys(schema, place[:-1]))
        case "model_type" | "model_attributes_type" | "dict_type":
            keys = _keys(schema, place)
            return found, f"give a mapping{' of ' + ', '.join(keys) if keys else ''}"
        case "literal_error" | "enum":
            return found, f"give {context['expected']}"
        case "list_type" | "tuple_type":
            return found, _give_example("a list", schema, place)
        case "string_type":
            return found, "give a string"
        case "float_type" | "int_type" | "finite_number" | "int_from_float":
            return found, f"give a{' whole' if error['type'].startswith('int') else ' finite'} number"
        case "bool_type":
            return found, "give true or false"
    message = error["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return found, f"{'give ' if error['msg'].startswith('Input should be ') else ''}{message[0].lower()}{message[1:]}"


def _give_example(what: str, schema: type[BaseModel], place: Place) -> str:
    example = _example(schema, place)
    return f"give {what}{'' if example is None else f', e.g. {json.dumps(example)}'}"


def _suggest(key: str, keys: Sequence[str]) -> str:
    meant = nearest(key, keys)
    return f"did you mean `{meant}`?" if meant else f"the keys here are {', '.join(keys)}"


def _stand_in(data: Data, place: Place, error: ErrorDetails, schema: type[BaseModel]) -> Place:
    """Put an example of what is right where an error is, or around it; return the place that was changed."""
    if error["type"] == "extra_forbidden":
        _change(data, place, None)
        return place
    for length in range(len(place), 0, -1):
        example = _example(schema, place[:length])
        if example is not None:
            _change(data, place[:length], copy.deepcopy(example))
            return place[:length]
    return ()


def _change(data: Data, place: Place, new: Data) -> None:
    """Set a value in place; with None, take the key away."""
    inner: Any = data
    for step in place[:-1]:
        inner = inner[step]
    if new is None:
        inner.pop(place[-1], None)
    else:
        inner[place[-1]] = new


@dataclass(frozen=True)
class _Slot:
    """A type that a schema admits at some place, with the example it gives there."""

    annotation: Any
    example: Data


def _slots(schema: type[BaseModel], place: Place) -> list[_Slot]:
    """Find the types that a schema admits at a place: several, where unions are on the way."""
    slots = [_Slot(schema, None)]
    for step in place:
        slots = [inner for slot in slots for inner in _step(slot.annotation, step)]
    return slots


def _step(annotation: Any, step: str | int) -> Iterator[_Slot]:
    for choice in _choices(annotation):
        origin, arguments = get_origin(choice), get_args(choice)
        if isinstance(step, str) and isinstance(choice, type) and issubclass(choice, BaseModel):
            for name, info in choice.model_fields.items():
                if step == (info.alias or name):
                    yield _Slot(info.annotation, _first_example([info]))
        elif isinstance(step, str) and origin is dict:
            yield _inner_slot(arguments[1])
        elif isinstance(step, int) and origin is tuple:
            element = arguments[0] if arguments[-1] is ... else arguments[step] if step < len(arguments) else None
            if element is not None:
                yield _inner_slot(element)
        elif isinstance(step, int) and origin is list:
            yield _inner_slot(arguments[0])


def _inner_slot(annotation: Any) -> _Slot:
    metadata = getattr(annotation, "__metadata__", ())
    return _Slot(annotation, _first_example([x for x in metadata if isinstance(x, FieldInfo)]))


def _first_example(fields: Sequence[FieldInfo]) -> Data:
    return next((info.examples[0] for info in fields if info.examples), None)


def _choices(annotation: Any) -> Iterator[Any]:
    """Unwrap Annotated and unions."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _choices(get_args(annotation)[0])
    elif origin is Union or origin is UnionType:
        for choice in get_args(annotation):
            yield from _choices(choice)
    elif annotation is not NoneType:
        yield annotation


def _example(schema: type[BaseModel], place: Place) -> Data:
    return next((slot.example for slot in _slots(schema, place) if slot.example is not None), None)


def _keys(schema: type[BaseModel], place: Place) -> list[str]:
    """List the keys that a schema knows at a place."""
    choices = [c for slot in _slots(schema, place) for c in _choices(slot.annotation)]
    models = [c for c in choices if isinstance(c, type) and issubclass(c, BaseModel)]
    return list(dict.fromkeys(info.alias or name for model in models for name, info in model.model_fields.items()))
