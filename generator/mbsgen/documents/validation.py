"""Document -> a pydantic schema, or every fault of its shape.

The examples of a schema's fields show users what is right. They also replace wrong values while the rest is checked.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, Generic, Literal, Self, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, ErrorDetails
from pydantic_core.core_schema import no_info_plain_validator_function

from mbsgen.documents.places import MAX_FAULTS, Data, Place, abbreviate, lies_under, nearest, refuse, write_path
from mbsgen.documents.reading import Document
from mbsgen.errors import Fault

MAX_ROUNDS = 3  # of replacements: an example may lack keys that belong to its type

Shape = TypeVar("Shape", bound=BaseModel)


class Section(BaseModel):
    """Base of the schemas of files: nothing is converted, unknown keys are refused, and values do not change later."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Self:
        """Return the section itself: pydantic copies the default values of keys at each validation."""
        return self


@dataclass(frozen=True)
class Read:
    """In the annotation of a field: a function reads its value from the file.

    It does as pydantic's PlainValidator, but says nothing of how to write the value: for that, each field would take
    the schema of all kinds of expressions.
    """

    read: Callable[[Any], Any]  # raises WrongValueError
    written: Any  # the type in a file, of which the schema for editors is made

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_plain_validator_function(
            self.read, json_schema_input_schema=handler.generate_schema(self.written)
        )


class WrongValueError(ValueError):
    """Raised by a schema's validator, with the finding and the remedy."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding = finding
        self.remedy = remedy
        super().__init__(f"{finding}; {remedy}")


@dataclass(frozen=True)
class Examination(Generic[Shape]):
    """The result of validation: all faults, and a value in which further faults can be looked for.

    Where the file is at fault, `value` holds the schema's example. Findings at such a place (listed in `stand_ins`) do
    not concern the file. `value` is None where the schema has no example.
    """

    value: Shape | None
    faults: tuple[Fault, ...]
    stand_ins: frozenset[Place]


def validate(document: Document, schema: type[Shape]) -> Shape:
    """Check a document against a schema. Raises InputError with every fault."""
    examination = examine(document, schema)
    if examination.faults:
        raise refuse(examination.faults)
    assert examination.value is not None, "a document without faults has a value"
    return examination.value


def take(data: Data, schema: type[Shape]) -> Shape:
    """Check plain data against a schema. Raises WrongValueError with the first fault."""
    value, errors = _load(data, schema)
    if value is not None:
        return value
    place, error = next(iter(_troubles(errors, data).items()))
    finding, remedy = _explain(error, place, schema, data)
    raise WrongValueError(f"{write_path(place)}: {finding}", remedy)


def examine(document: Document, schema: type[Shape]) -> Examination[Shape]:
    """Check a document against a schema, and continue with examples in place of wrong values."""
    value, errors = _load(document.data, schema)
    troubles = _troubles(errors, document.data)
    if not troubles:
        return Examination(value, tuple(document.faults.values()), frozenset(document.faults))
    told = sorted(troubles, key=document.line)[: MAX_FAULTS + 1]
    faults = [
        document.fault(place, *_explain(troubles[place], place, schema, document.data))
        for place in told
        if not lies_under(place, document.faults)
    ]
    data = copy.deepcopy(document.data)
    stand_ins: set[Place] = set()
    for _ in range(MAX_ROUNDS):
        for place, error in troubles.items():
            if not lies_under(place, stand_ins):
                stand_ins.add(_stand_in(data, place, error, schema))
        value, errors = _load(data, schema)
        troubles = _troubles(errors, data)
        if value is not None:
            break
    return Examination(value, (*document.faults.values(), *faults), frozenset(stand_ins.union(document.faults)))


def _load(data: Data, schema: type[Shape]) -> tuple[Shape | None, list[ErrorDetails]]:
    """Validate as JSON: there a list may fill a tuple even where nothing is converted."""
    try:
        return schema.model_validate_json(json.dumps(data)), []
    except ValidationError as error:
        return None, error.errors(include_url=False)


def _troubles(errors: Sequence[ErrorDetails], data: Data) -> dict[Place, ErrorDetails]:
    """Sort errors by place, one each; of a union's members, the one that matches the data deepest is believed."""
    by_place: dict[Place, ErrorDetails] = {}
    for error in errors:
        by_place.setdefault(_place(error, data), error)
    around = {place[:i] for place in by_place for i in range(len(place))}
    return {place: error for place, error in by_place.items() if place not in around}


def _place(error: ErrorDetails, data: Data) -> Place:
    """Remove pydantic's own tags (of unions, of keys) from an error's location."""
    place: Place = ()
    for i, step in enumerate(error["loc"]):
        if isinstance(data, dict) and step in data:
            data = data[str(step)]
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
        elif not (error["type"] == "missing" and i == len(error["loc"]) - 1 and isinstance(step, str)):
            continue
        place = (*place, step)
    if error["type"] in ("union_tag_not_found", "union_tag_invalid"):
        place = (*place, _discriminator(error))
    return place


def _discriminator(error: ErrorDetails) -> str:
    """Return the key whose value selects the member of a union."""
    return str(error["ctx"]["discriminator"]).strip("'")


def _explain(error: ErrorDetails, place: Place, schema: type[BaseModel], data: Data) -> tuple[str, str]:
    """Translate a pydantic error into finding and remedy."""
    context = error.get("ctx", {})
    if isinstance(wrong := context.get("error"), WrongValueError):
        return wrong.finding, wrong.remedy
    found = f"found {abbreviate(error['input'])}"
    match error["type"]:
        case "too_short" if isinstance(error["input"], list):
            return f"found a list of {len(error['input'])}", f"give at least {context['min_length']}"
        case "missing" | "too_long" if isinstance(error["input"], list):
            return f"found a list of {len(error['input'])}", _give_example("a list of another length", schema, place)
        case "union_tag_invalid":
            found = f"found {abbreviate(error['input'][place[-1]])}"
            return found, f"give {context['expected_tags']}"
        case "missing" | "union_tag_not_found":
            return "missing", _give_example("it", schema, place)
        case "extra_forbidden":
            return "unknown key", _suggest(str(place[-1]), _models(schema, place[:-1], data))
        case "model_type" | "model_attributes_type" | "dict_type":
            keys = _keys(schema, place, data)
            return found, f"give a mapping{' of ' + ', '.join(keys) if keys else ''}"
        case "literal_error" | "enum":
            return found, f"give {context['expected']}"
        case "list_type" | "tuple_type":
            is_mapping = isinstance(_example(schema, place), dict)
            return found, _give_example("a mapping or a list" if is_mapping else "a list", schema, place)
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            return found, error["msg"].replace("Input should be", "give a number", 1)
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


def _suggest(key: str, models: Sequence[type[BaseModel]]) -> str:
    """Suggest a key of these models; the key and the word, where the wrong key is a word that a key takes."""
    fields = {info.alias or name: info.annotation for model in models for name, info in model.model_fields.items()}
    owner = next((name for name, annotation in fields.items() if key in _list_words(annotation)), None)
    meant = f"{owner}: {key}" if owner else nearest(key, list(fields))
    return f"did you mean `{meant}`?" if meant else f"the keys here are {', '.join(fields)}"


def _stand_in(data: Data, place: Place, error: ErrorDetails, schema: type[BaseModel]) -> Place:
    """Put an example in place of an error, or around it; return the place that was changed."""
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
    """Set a value in place; None removes the key."""
    inner: Any = data
    for step in place[:-1]:
        inner = inner[step]
    if new is None:
        inner.pop(place[-1], None)
    else:
        inner[place[-1]] = new


# --- the schema at a place -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Slot:
    """A type that a schema admits at some place, with its example."""

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


def _models(schema: type[BaseModel], place: Place, data: Data) -> list[type[BaseModel]]:
    """List the models that a schema admits at a place; of a union, the members that match the data there."""
    choices = [c for slot in _slots(schema, place) for c in _choices(slot.annotation)]
    models = [c for c in choices if isinstance(c, type) and issubclass(c, BaseModel)]
    inner: Any = data
    for step in place:
        inner = inner[step]
    return [model for model in models if _may_be(inner, model)] or models


def _keys(schema: type[BaseModel], place: Place, data: Data) -> list[str]:
    """List the keys of a schema at a place."""
    models = _models(schema, place, data)
    return list(dict.fromkeys(info.alias or name for model in models for name, info in model.model_fields.items()))


def _list_words(annotation: Any) -> list[Any]:
    """List the words that a field takes, where these are given."""
    words: list[Any] = []
    for choice in _choices(annotation):
        if get_origin(choice) is Literal:
            words += get_args(choice)
        elif isinstance(choice, type) and issubclass(choice, Enum):
            words += [member.value for member in choice]
    return words


def _may_be(data: Data, model: type[BaseModel]) -> bool:
    """Return whether a mapping has allowed words in the keys that the schema restricts to certain words."""
    if not isinstance(data, dict):
        return True
    words = {
        name: get_args(x.annotation) for name, x in model.model_fields.items() if get_origin(x.annotation) is Literal
    }
    return all(data[name] in known for name, known in words.items() if name in data)
