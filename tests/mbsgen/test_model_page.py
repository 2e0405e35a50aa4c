"""The examples of docs/model.md are what the reader takes, and mean what the page says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from mbsgen.expressions import FUNCTIONS
from mbsgen.formulations.closure import EQUATIONS
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.file.loops import WORDS
from mbsgen.model.joints import list_joint_types
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Cut
from mbsgen.model.writer import write_model

PAGE = (Path(__file__).parents[2] / "docs" / "model.md").read_text(encoding="utf-8")
WHOLE, *PARTS = re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def read(text: str, folder: Path) -> Model:
    file = folder / "model.yaml"
    file.write_text(text, encoding="utf-8")
    return read_model(file)


def complete(part: str) -> str:
    """Put the keys of an example into the whole file; bodies come without the frame on the rod."""
    whole: dict[str, Any] = yaml.safe_load(WHOLE)
    given: dict[str, Any] = yaml.safe_load(part)
    if "bodies" in given:
        whole.pop("frames")
    if "parameters" in given:
        given["parameters"] = whole["parameters"] | given["parameters"]
    return yaml.safe_dump(whole | given, sort_keys=False)


def test_the_whole_file_is_written_as_it_stands(tmp_path: Path) -> None:
    assert write_model(read(WHOLE, tmp_path)) == WHOLE


def test_python_makes_the_whole_file(tmp_path: Path) -> None:
    (script,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
    assert (tmp_path / "pendulum.yaml").read_text(encoding="utf-8") == WHOLE


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.splitlines()[0])
def test_parts_fit_into_it(part: str, tmp_path: Path) -> None:
    build_tree(read(complete(part), tmp_path))


def test_joints_are_called_as_the_page_says(tmp_path: Path) -> None:
    (part,) = (part for part in PARTS if "floating" in part)
    names = [body.joint.name for body in build_tree(read(complete(part), tmp_path)).bodies]
    listed = re.search(r"the joints\s+of\s+this\s+example\s+are (.*?)\.\s", PAGE, re.DOTALL)
    assert listed
    assert names == re.findall(r"`([^`]+)`", listed[1])


def test_functions_and_types_are_listed() -> None:
    (listed,) = re.findall(r"functions `([^`]+)`", PAGE)
    assert set(listed.split()) == set(FUNCTIONS)
    types = list_cells(PAGE[PAGE.index("| type |") : PAGE.index("| loop |")])
    assert types == {*list_joint_types()} - {"revolute", "prismatic", "fixed"}  # which the text introduces
    assert list_cells(PAGE[PAGE.index("| loop |") : PAGE.index("## Frames")]) == {*WORDS}


def list_cells(text: str) -> set[str]:
    """List the words of code in the first column of tables."""
    return {name for cell in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`(\w+)`", cell)}


def test_equations_of_loops_are_as_many_as_the_page_says() -> None:
    counts = dict(re.findall(r"^\| `(\w+)`.*? \| (\d) \|", PAGE, re.MULTILINE))
    assert {Cut(word): int(count) for word, count in counts.items()} == {cut: len(EQUATIONS[cut]) for cut in Cut}
