"""Untrusted YAML: YAML 1.2's core schema is read; anything else is reported with line and path, and nothing runs."""

from __future__ import annotations

import contextlib
import math
import random
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Discriminator, Field, Tag

from mbsgen.documents import (
    Document,
    Section,
    abbreviate,
    examine,
    read_document,
    reading,
    validate,
    write_path,
)
from mbsgen.documents.places import MAX_FAULTS
from mbsgen.documents.reading import MAX_BYTES
from mbsgen.errors import Fault, InputError


def read(text: str | bytes, folder: Path) -> Document:
    file = folder / "file.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_document(file)


def faults(text: str | bytes, folder: Path, schema: type[Section] | None = None) -> tuple[Fault, ...]:
    with pytest.raises(InputError) as caught:
        validate(read(text, folder), schema or Anything)
    return caught.value.faults


class Anything(Section):
    a: object = None
    b: object = None


SCALARS = {
    "1e3": 1000.0,
    "1.5": 1.5,
    ".5": 0.5,
    "5.": 5.0,
    "-0.25e-2": -0.0025,
    "+7": 7,
    "010": 10,
    "0o10": 8,
    "0x1F": 31,
    "null": None,
    "~": None,
    "": None,
    "true": True,
    "False": False,
    ".inf": math.inf,
    "-.INF": -math.inf,
    "on": "on",
    "Yes": "Yes",
    "n": "n",
    "12:30:45": "12:30:45",
    "1_000": "1_000",
    "2001-01-01": "2001-01-01",
    "<<": "<<",
    "=": "=",
    "1e": "1e",
    "0b1": "0b1",
    "-pi/2": "-pi/2",
    "'1'": "1",
    '"true"': "true",
    "'~'": "~",
}


@pytest.mark.parametrize(("text", "value"), SCALARS.items(), ids=map(repr, SCALARS))
def test_scalars_are_those_of_the_core_schema(text: str, value: object, tmp_path: Path) -> None:
    found = read(f"a: {text}\n", tmp_path).data
    assert found == {"a": value}
    assert type(found["a"]) is type(value)


def test_nan_is_a_number_here(tmp_path: Path) -> None:
    data = read("a: .nan", tmp_path).data
    assert isinstance(data, dict)
    assert isinstance(data["a"], float)
    assert math.isnan(data["a"])


class Doubles(Section):
    values: tuple[float, ...]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False)))
@settings(derandomize=True, deadline=None)
def test_doubles_arrive_as_they_were_written(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    document = read(f"values: {values!r}", tmp_path_factory.mktemp("doubles"))
    found = validate(document, Doubles).values
    assert [x.hex() for x in found] == [x.hex() for x in values]


@given(
    st.one_of(
        st.binary(max_size=200), st.text(max_size=50), st.text(alphabet="ab:-[]{}&*!|>'\"%@,? \n\t#~1.", max_size=200)
    )
)
@settings(derandomize=True, deadline=None, max_examples=500)
def test_no_bytes_bring_anything_but_a_document_or_faults(
    tmp_path_factory: pytest.TempPathFactory, content: bytes | str
) -> None:
    with contextlib.suppress(InputError):
        validate(read(content, tmp_path_factory.getbasetemp()), Anything)


REFUSED: dict[str, tuple[str | bytes, int, str, str]] = {  # content; line, path, piece of the finding
    "empty": ("", 0, "", "empty"),
    "only a comment": ("# nothing\n", 0, "", "empty"),
    "only a marker": ("---\n", 0, "", "empty"),
    "two documents": ("a: 1\n---\nb: 2\n", 2, "", "second document"),
    "a directive": ("%YAML 1.1\n---\na: on\n", 1, "", "directive"),
    "an alias": ("a: &x 1\nb: *x\n", 2, "b", "alias *x"),
    "an anchor": ("a: 1\nb: &x 2\n", 2, "b", "anchor &x"),
    "a tag": ("a: !!python/object/apply:os.system ['true']\n", 1, "a", "tag"),
    "a tag of one's own": ("a: !x 1\n", 1, "a", "tag !x"),
    "a repeated key": ("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n", 5, "b.c", "key repeated, first in line 3"),
    "a key that is a number": ("a:\n  1: 2\n", 2, "a.1", "key 1 is not a string"),
    "a key that is a truth": ("a: {true: 2}\n", 1, "a.true", "key true is not a string"),
    "a key that is a list": ("a:\n  ? [1]\n  : 2\n", 2, "a", "key that is not a string"),
    "an unclosed bracket": ("a: [1, 2\nb: 3\n", 2, "", "flow sequence"),
    "a tab": ("a:\n\tb: 1\n", 2, "", "cannot start any token"),
    "bad indentation": ("a: 1\n  b: 2\n", 2, "", "mapping values are not allowed"),
    "no UTF-8": (b"a: 1\nb: \xff\n", 2, "", "byte 0xff is not UTF-8"),
    "UTF-16": ("a: 1".encode("utf-16"), 1, "", "not UTF-8"),
    "a control character": ("a: 1\nb: \x07\n", 2, "", "control character U+0007"),
    "an escaped control character": ('a: "\\0"\n', 1, "a", "control character U+0000"),
    "an escaped surrogate": ('a: "\\ud800"\n', 1, "a", "control character U+D800"),
    "text that turns direction": ("a: \u202ex\n", 1, "", "control character U+202E"),
    "no character": ("a: \uffff\n", 1, "", "control character U+FFFF"),
    "a huge number": ("a: 1e999\n", 1, "a", "beyond the largest double"),
    "a tiny number": ("a: [1, 1e-999]\n", 1, "a[1]", "below the smallest double"),
    "a long number": (f"a: {'1' * 5000}\n", 1, "a", "a number of 5000 characters"),
    "deep lists": ("[" * 100_000, 1, "", "nested deeper"),
    "deep mappings": ("".join(f"{' ' * i}a:\n" for i in range(1000)), 34, "", "nested deeper"),
    "many values": (f"a: [{'1,' * 60_000}]", 1, "", "more than 50000 values"),
    "a bomb": (
        "a: &a [x, x]\n" + "".join(f"b{i}: &b{i} [{', '.join(['*a'] * 9)}]\n" for i in range(9)),
        1,
        "a",
        "anchor &a",
    ),
}


@pytest.mark.parametrize(("content", "line", "path", "finding"), REFUSED.values(), ids=REFUSED.keys())
def test_refusals_tell_line_path_and_finding(
    content: str | bytes, line: int, path: str, finding: str, tmp_path: Path
) -> None:
    found = [f for f in faults(content, tmp_path) if finding in f.finding]
    assert [(f.file, f.line, f.path) for f in found[:1]] == [(str(tmp_path / "file.yaml"), line, path)]
    assert found[0].remedy


def test_a_file_too_large_is_refused_unread(tmp_path: Path) -> None:
    """A hole of 64 GiB, which no one could read."""
    file = tmp_path / "file.yaml"
    with file.open("wb") as stream:
        stream.truncate(1 << 36)
    with pytest.raises(InputError, match=f"larger than {MAX_BYTES} bytes"):
        read_document(file)


@pytest.mark.parametrize(
    ("name", "finding"), [("missing", "no such file"), (".", "a folder"), ("a\0b", "no such file")]
)
def test_what_is_no_file_is_told(name: str, finding: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=finding):
        read_document(tmp_path / name)


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    assert read(b"\xef\xbb\xbfa: 1", tmp_path).data == {"a": 1}


class Wheel(Section):
    radius: float = Field(examples=[0.3])
    side: Literal["left", "right"] = Field(default="left", examples=["left"])
    place: tuple[float, float] = Field(default=(0.0, 0.0), examples=[[0.0, 0.0]])


class Car(Section):
    name: str = Field(examples=["beetle"])
    wheels: tuple[Wheel, ...] = Field((), examples=[[]])
    doors: int | str = 2
    spare: Wheel | None = None
    extras: dict[str, float | Wheel] = Field(default={})


CAR = """\
nam: beetle
wheels:
  - {radius: 1, side: lef}
  - radius: "2"
    place: [1]
  - radius: .nan
    place: [1, x]
    sidé: 3
  - 7
doors: 2.5
extras:
  a: {radius: 1, "x y": 2}
  b: [1]
"""


def test_all_faults_come_together_sorted_by_line(tmp_path: Path) -> None:
    found = faults(CAR, tmp_path, Car)
    told = [(f.line, f.path, f.finding, f.remedy) for f in found]
    assert told == [
        (1, "nam", "unknown key", "did you mean `name`?"),
        (1, "name", "missing", 'give it, e.g. "beetle"'),
        (3, "wheels[0].side", 'found "lef"', "give 'left' or 'right'"),
        (4, "wheels[1].radius", 'found "2"', "give a finite number"),
        (5, "wheels[1].place", "found a list of 1", "give a list of another length, e.g. [0.0, 0.0]"),
        (6, "wheels[2].radius", "found nan", "give a finite number"),
        (7, "wheels[2].place[1]", 'found "x"', "give a finite number"),
        (8, "wheels[2].sidé", "unknown key", "did you mean `side`?"),
        (9, "wheels[3]", "found 7", "give a mapping of radius, side, place"),
        (10, "doors", "found 2.5", "give a whole number"),
        (12, 'extras.a["x y"]', "unknown key", "the keys here are radius, side, place"),
        (13, "extras.b", "found [1]", "give a finite number"),
    ]


class Trip(Section):
    places: Annotated[
        Annotated[tuple[str, ...], Tag("list")] | Annotated[dict[str, str], Tag("mapping")],
        Discriminator(lambda found: "mapping" if isinstance(found, dict) else "list"),
    ] = Field(examples=[{"first": "Lyon"}])
    people: int = Field(ge=1, examples=[2])
    speed: float = Field(lt=3e8, examples=[10.0])


def test_remedies_name_every_form_that_is_taken(tmp_path: Path) -> None:
    found = faults("places: Lyon\npeople: 0\nspeed: 3.0e+8\n", tmp_path, Trip)
    assert [f.remedy for f in found] == [
        'give a mapping or a list, e.g. {"first": "Lyon"}',
        "give a number greater than or equal to 1",
        "give a number less than 300000000",
    ]


class Petrol(Section):
    fuel: Literal["petrol", "diesel"] = Field(examples=["petrol"])
    litres: float = Field(examples=[1.3])


class Electric(Section):
    fuel: Literal["none"] = Field(examples=["none"])
    battery: float = Field(examples=[60.0])


class Fleet(Section):
    engines: tuple[Annotated[Petrol | Electric, Field(discriminator="fuel")], ...] = Field(examples=[[]])
    plates: tuple[str, ...] = Field(min_length=2, examples=[["a", "b"]])
    owner: str = Field(examples=["me"])


FLEET = """\
engines:
  - {fuel: none, battery: 60}
  - {fuel: petrol, batery: 60}
  - {fuel: none, batery: 60}
  - {fuel: water, battery: 60}
  - {litres: 1.3}
  - petrol
plates: [a]
owner: 7
"""


class Paint(Enum):
    MATT = "matt"
    GLOSSY = "glossy"


class Door(Section):
    side: Literal["left", "right"] | None = Field(examples=["left"])
    paint: Paint = Field(examples=["matt"])


def test_a_word_in_the_place_of_a_key_is_given_its_key(tmp_path: Path) -> None:
    found = faults("side: left\npaint: matt\nglossy: true\nright: true\n", tmp_path, Door)
    assert [(f.path, f.remedy) for f in found] == [
        ("glossy", "did you mean `paint: glossy`?"),
        ("right", "did you mean `side: right`?"),
    ]


def test_a_word_tells_which_keys_belong_to_a_mapping(tmp_path: Path) -> None:
    told = [(f.line, f.path, f.finding, f.remedy) for f in faults(FLEET, tmp_path, Fleet)]
    assert told == [
        (3, "engines[1].batery", "unknown key", "the keys here are fuel, litres"),
        (3, "engines[1].litres", "missing", "give it, e.g. 1.3"),
        (4, "engines[2].batery", "unknown key", "did you mean `battery`?"),
        (4, "engines[2].battery", "missing", "give it, e.g. 60.0"),
        (5, "engines[3].fuel", 'found "water"', "give 'petrol', 'diesel', 'none'"),
        (6, "engines[4].fuel", "missing", 'give it, e.g. "petrol"'),
        (7, "engines[5]", 'found "petrol"', "give a mapping of fuel, litres, battery"),
        (8, "plates", "found a list of 1", "give at least 2"),
        (9, "owner", "found 7", "give a string"),
    ]


def test_what_follows_from_a_stand_in_is_stood_in_for_too(tmp_path: Path) -> None:
    """Water is taken for petrol; that litres are missing then, and a battery is too much, says nothing."""
    examination = examine(read("engines: [{fuel: water, battery: 60}]\nplates: [a, b]\nowner: x\n", tmp_path), Fleet)
    assert [f.path for f in examination.faults] == ["engines[0].fuel"]
    assert examination.value == Fleet(engines=(Petrol(fuel="petrol", litres=1.3),), plates=("a", "b"), owner="x")


def test_faults_of_yaml_and_of_shape_come_together(tmp_path: Path) -> None:
    found = faults("name: x\nname: y\nwheels: &w []\ndoors: {}\n", tmp_path, Car)
    assert [(f.line, f.path) for f in found] == [(2, "name"), (3, "wheels"), (4, "doors")]


def test_a_value_that_is_faulty_as_yaml_is_told_once(tmp_path: Path) -> None:
    """An alias stands for nothing here; that nothing is no name follows from it."""
    assert [f.finding for f in faults("name: *x\n", tmp_path, Car)] == ["alias *x"]


def test_examples_stand_in_for_what_is_wrong(tmp_path: Path) -> None:
    """So that the rest can be examined on."""
    document = read("nam: x\nwheels: [{radius: a}, {radius: 1, side: up}]\n", tmp_path)
    examination = examine(document, Car)
    assert examination.value == Car(name="beetle", wheels=(Wheel(radius=0.3), Wheel(radius=1.0, side="left")))
    places = {("nam",), ("name",), ("wheels", 0, "radius"), ("wheels", 1, "side")}
    assert examination.stand_ins == places
    assert len(examination.faults) == 4


def test_without_an_example_there_is_no_value(tmp_path: Path) -> None:
    examination = examine(read("name: x\ndoors: {}\n", tmp_path), Car)
    assert examination.value is None
    assert [f.path for f in examination.faults] == ["doors"]


def test_very_many_faults_are_cut(tmp_path: Path) -> None:
    found = faults(f"name: x\nwheels: [{'{}, ' * 5000}]\n", tmp_path, Car)
    assert len(found) == MAX_FAULTS + 1
    assert found[-1].finding == "there are more faults after this"


def test_lines_of_nested_values_are_kept(tmp_path: Path) -> None:
    document = read("a:\n  - b: 1\n    c:\n      - 2\n      - [3,\n         4]\n", tmp_path)
    assert document.line(("a", 0, "c")) == 3
    assert document.line(("a", 0, "c", 1, 1)) == 6
    assert document.line(("a", 0, "no", "such")) == 2


def test_paths_are_written_as_users_read_them() -> None:
    assert write_path(("bodies", 2, "joint", "axis")) == "bodies[2].joint.axis"
    assert write_path(("a", "b c", "x" * 99)) == 'a["b c"]["' + "x" * 37 + '..."]'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "nothing"),
        (True, "true"),
        (math.inf, "inf"),
        ("x" * 100, '"' + "x" * 37 + '..."'),
        ([1, [2, "a"]], '[1, [2, "a"]]'),
        (list(range(7)), "a list of 7"),
        (["x" * 30] * 3, "a list of 3"),
        ({}, "{}"),
        ({"a": 1, "b": 2, "c": 3, "d": 4}, 'a mapping of "a", "b", "c", ...'),
    ],
)
def test_values_are_shown_short(value: object, text: str) -> None:
    assert abbreviate(value) == text  # type: ignore[arg-type]


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML has been built without libyaml")
def test_both_parsers_read_the_same() -> None:
    """Files that libyaml reads without a fault, PyYAML's own parser reads as the same data in the same lines."""
    models = [
        file.read_text(encoding="utf-8") for file in sorted((Path(__file__).parents[2] / "models").glob("*.yaml"))
    ]
    tokens = (
        *":-{}[],#\"'|>?~%@`\t ",
        "&a ",
        "*a ",
        "!x ",
        "\n",
        "  ",
        "1e400",
        "0x1",
        ": ",
        "- ",
        "---\n",
        "\u00e9",
        "<<: ",
    )
    rng = random.Random(1)
    read = 0
    for _ in range(150):
        text = rng.choice(models)[: rng.randrange(100, 900)]
        for _ in range(rng.randrange(3)):
            place = rng.randrange(len(text))
            text = text[:place] + rng.choice(tokens) + text[place + rng.randrange(3) :]
        fast = reading._read_fast("f", text)
        if fast is not None:
            read += 1
            slow = reading._read("f", text, yaml.SafeLoader)
            assert (repr(fast.data), fast.lines, slow.faults) == (repr(slow.data), slow.lines, {})
    assert 30 < read < 150


@pytest.mark.parametrize("text", ["a: [1]\t\nb:\t2", "a: {b?c: 1}", "a: {b: 1", "a: &x 1", "a: 1\na: 2"])
def test_what_may_be_wrong_is_told_by_one_parser(text: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """So errors and their places are the same where there is no libyaml."""

    def tell() -> object:
        try:
            return reading.read_document(file).faults
        except InputError as error:
            return error.faults

    file = tmp_path / "f.yaml"
    file.write_text(text, encoding="utf-8")
    told = tell()
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    assert tell() == told
