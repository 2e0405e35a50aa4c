"""The JSON Schema that ships for editors takes what the reader takes, as far as shape goes."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from mbsgen.documents import read_document
from mbsgen.model.file.schema import write_schema
from tests.mbsgen.model.files import GOOD, ROOT, WALKER
from tests.shipped import MODELS

FILE = ROOT / "models" / "model.schema.json"


@cache
def find_validator() -> Draft202012Validator:
    return Draft202012Validator(json.loads(write_schema()))


def test_the_file_is_up_to_date() -> None:
    """If the change is meant: `make schema`."""
    assert FILE.read_text(encoding="utf-8") == write_schema()
    command = [sys.executable, "-m", "mbsgen.model.file.schema"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == write_schema()


def test_it_is_a_schema() -> None:
    Draft202012Validator.check_schema(json.loads(write_schema()))


@pytest.mark.parametrize("file", MODELS, ids=lambda file: file.stem)
def test_models_that_ship_are_valid(file: Path) -> None:
    assert [*find_validator().iter_errors(read_document(file).data)] == []


@pytest.mark.parametrize("text", [GOOD, WALKER], ids=["crane", "walker"])
def test_models_of_many_parts_are_valid(text: str) -> None:
    assert [*find_validator().iter_errors(yaml.safe_load(text))] == []


def list_mappings(data: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """List the places of the mappings in a document, except mappings whose keys are the user's names."""
    if not isinstance(data, dict | list):
        return []
    inner = data.items() if isinstance(data, dict) else enumerate(data)
    own = [place] if isinstance(data, dict) and place[-1:] != ("parameters",) else []
    return own + [found for key, value in inner for found in list_mappings(value, (*place, key))]


@pytest.mark.parametrize("place", list_mappings(yaml.safe_load(WALKER)), ids=str)
def test_unknown_keys_are_not(place: tuple[Any, ...]) -> None:
    data = yaml.safe_load(WALKER)
    inner = data
    for step in place:
        inner = inner[step]
    inner["colour"] = "red" if place[-1:] != ("axes",) else {}
    assert not find_validator().is_valid(data)


WRONG = {
    "a type": (("bodies", 0, "joint", "type"), "flaoting"),
    "an order": (("bodies", 0, "joint", "order"), "xyx"),
    "a short vector": (("gravity",), [0, 0]),
    "a long vector": (("gravity",), [0, 0, 0, 0]),
    "a truth for a number": (("bodies", 0, "mass"), True),
    "a number for a name": (("name",), 5),
    "a sequence of one": (("bodies", 2, "joint"), [{"type": "revolute", "axis": "x"}]),
    "an axis": (("bodies", 2, "joint", 0, "axis"), "w"),
    "an input": (("wrenches", 0, "force"), "inputs"),
}


@pytest.mark.parametrize(("place", "value"), WRONG.values(), ids=WRONG.keys())
def test_wrong_values_are_not(place: tuple[Any, ...], value: Any) -> None:
    data = yaml.safe_load(WALKER)
    inner = data
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    assert not find_validator().is_valid(data)


def test_what_must_be_given_is_missed() -> None:
    data = yaml.safe_load(WALKER)
    for key in ("name", "gravity", "bodies"):
        assert not find_validator().is_valid({k: v for k, v in data.items() if k != key})


def test_defaults_are_as_a_file_has_them() -> None:
    """Put into a file, every default is valid and says nothing new."""
    described = json.loads(write_schema())["$defs"]
    assert described["BodySection"]["properties"]["mass"]["default"] == 0
    assert described["BodySection"]["properties"]["com"]["default"] == [0, 0, 0]
    assert described["WrenchSection"]["properties"]["frame"]["default"] == "base"
    data = yaml.safe_load(WALKER)
    defaults = {k: x["default"] for k, x in described["BodySection"]["properties"].items() if "default" in x}
    data["bodies"][0] = defaults | data["bodies"][0]
    assert find_validator().is_valid(data)
