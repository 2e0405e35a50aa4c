"""The JSON Schemas that ship for editors take what the readers take, as far as shape goes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from mbsgen.documents import read_document
from mbsrun.ocp.statement import sections
from mbsrun.ocp.statement.phase_sections import PhaseSection, WholeSection
from mbsrun.schemas import KINDS, write_schema

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "models"
PROBLEMS = sorted(MODELS.glob("**/*.ocp.yaml"))
TRIALS = sorted(MODELS.glob("**/*.track.yaml"))
BASE = {"horizon": 1, "intervals": 10, "scheme": "radau", "degree": 3, "cost": {}}


@cache
def find_validator(kind: str) -> Draft202012Validator:
    return Draft202012Validator(json.loads(write_schema(kind)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_files_are_up_to_date(kind: str) -> None:
    """If the change is meant: `make schema`."""
    assert (MODELS / f"{kind}.schema.json").read_text(encoding="utf-8") == write_schema(kind)
    Draft202012Validator.check_schema(json.loads(write_schema(kind)))


def test_a_command_writes_them() -> None:
    command = [sys.executable, "-m", "mbsrun.schemas"]
    found = subprocess.run([*command, "trial"], capture_output=True, text=True, check=True)
    assert found.stdout == write_schema("trial")
    wrong = subprocess.run([*command, "model"], capture_output=True, text=True, check=False)
    assert wrong.stderr == "usage: python -m mbsrun.schemas problem|simulation|trial\n"


def test_files_that_ship_are_valid() -> None:
    assert len(PROBLEMS) > 30
    for kind, files in (("problem", PROBLEMS), ("trial", TRIALS)):
        for file in files:
            assert [*find_validator(kind).iter_errors(read_document(file).data)] == [], file


def list_examples(page: str) -> list[Any]:
    """List the documents of a page's fenced YAML; a list, and a mapping with a list of costs, are of links."""
    found = []
    for block in re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / page).read_text("utf-8"), re.DOTALL):
        for data in yaml.safe_load_all(block):
            whole = {"links": data} if isinstance(data, list) else data
            found.append({"links": [whole]} if isinstance(whole.get("cost"), list) else whole)
    return found


def test_what_the_pages_show_is_valid_and_names_every_section() -> None:
    """Each example is a part of a problem. Together, and with the pages' tables, they show every key of the top."""
    pages = ("problem.md", "phases.md")
    examples = [data for page in pages for data in list_examples(page) if "frames" not in data]
    for data in examples:
        known = {} if "phases" in data else BASE
        assert [*find_validator("problem").iter_errors(known | data)] == [], data
    text = "\n".join((ROOT / "docs" / page).read_text("utf-8") for page in pages)
    keys = {*PhaseSection.model_fields, *WholeSection.model_fields}
    shown = {key for data in examples for key in data} | {key for key in keys if f"`{key}" in text}
    assert keys - shown - {"references"} == set()  # recordings.md shows these


GOOD = BASE | {"model": "arm.yaml", "start": {"pose": {}}}
PHASED = GOOD | {"phases": [{"name": "one"}, {"name": "two", "end": {"velocity": "zero"}}], "links": [{"from": "one"}]}


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("problem", GOOD),
        ("problem", {key: GOOD[key] for key in ("model", "horizon", "cost", "start")}),
        ("problem", PHASED),
        ("problem", {"phases": [{"name": "one", "horizon": {"guess": 1}}], "horizon": {"range": [0, 2]}}),
        ("problem", {k: v for k, v in GOOD.items() if k != "cost"} | {"links": [{}]}),
        ("simulation", {"duration": "2*pi", "start": {"pose": {"q1": 1}}}),
    ],
)
def test_good_files_are_valid(kind: str, data: Any) -> None:
    assert [*find_validator(kind).iter_errors(data)] == []


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("problem", GOOD | {"colour": "red"}),
        ("problem", {k: v for k, v in GOOD.items() if k != "horizon"}),
        ("problem", {k: v for k, v in GOOD.items() if k != "cost"}),
        ("problem", GOOD | {"inputs": "quadratic"}),
        ("problem", GOOD | {"inputs": {"delay": [1]}}),
        ("problem", GOOD | {"constraints": [{"expression": "q_a", "range": [0, 1], "soft": {"cubic": 1}}]}),
        ("problem", GOOD | {"constraints": [{"expression": "q_a", "range": [0, 1, 2]}]}),
        ("problem", GOOD | {"cost": {"largest": [{"weight": 1}]}}),
        ("problem", GOOD | {"controls": {"a": {"rate": 3}}}),
        ("problem", PHASED | {"phases": [{"end": {}}]}),
        ("problem", PHASED | {"phases": []}),
        ("problem", PHASED | {"phases": [{"name": "one", "solver": {}}]}),
        ("problem", PHASED | {"links": [{"from": "one", "cost": {"inputs": 1}}]}),
        ("problem", PHASED | {"phases": [{"name": "one", "constraints": [{"expression": "q_a"}]}]}),
        ("simulation", {"duration": [1]}),
        ("trial", {"duration": 1}),
    ],
)
def test_wrong_shapes_are_not(kind: str, data: Any) -> None:
    assert [*find_validator(kind).iter_errors(data)] != []


def test_no_validator_is_built_before_a_file_is_read() -> None:
    """Sections that a file leaves out are the same as empty ones."""
    code = "from mbsrun.ocp.statement import sections as s; print(s.BoundsSection.__pydantic_complete__)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "False"
    for name in ("bounds", "end", "guess", "solver"):
        default = sections.ProblemSection.model_fields[name].default
        assert default == type(default)()
