"""A file that is given in the place of another, and names of commands: what it is, and what was meant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from mbsgen.cli import cli
from mbsgen.errors import InputError
from mbsgen.model.changes.scene import read_scene
from mbsgen.model.reader import read_model
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.statement import read_statement
from mbsrun.tracking.statement import TrialStatement

MODELS = Path(__file__).parents[2] / "models"
FILES = {
    "model": (MODELS / "pendulum.yaml").read_text(encoding="utf-8"),
    "problem": (MODELS / "arm_reach.ocp.yaml").read_text(encoding="utf-8"),
    "trial": "duration: 2\nrate: 10\n",
    "settings": "duration: 2\nstep: 0.1\n",
    "scene": "functions: [impl]\nlocked: {a: 0}\n",
}
READERS: dict[str, Callable[[Path], Any]] = {
    "model": read_model,
    "problem": lambda file: read_problem(file, lambda _: SimpleNamespace()),  # type: ignore[arg-type, type-var]
    "trial": lambda file: TrialStatement(file, {}),
    "settings": lambda file: read_statement(file, {}, SimpleNamespace()),  # type: ignore[arg-type]
    "scene": lambda file: read_scene(file, SimpleNamespace(), {}),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("found", FILES)
@pytest.mark.parametrize("wanted", READERS)
def test_a_file_of_another_kind_is_told_by_its_kind(found: str, wanted: str, tmp_path: Path) -> None:
    if found == wanted:
        return
    file = tmp_path / "file.yaml"
    file.write_text(FILES[found], encoding="utf-8")
    with pytest.raises(InputError, match=rf"this file describes .*{found}.*; expected: .*{wanted}") as told:
        READERS[wanted](file)
    assert len(told.value.faults) == 1


def test_a_folder_in_the_place_of_a_model_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this is a folder; give the path of a file"):
        read_model(tmp_path)
    (tmp_path / "arm.yaml").touch()
    with pytest.raises(InputError, match=r"this is a folder; give a file, such as arm\.yaml in it"):
        read_model(tmp_path)
    (tmp_path / "manifest.json").touch()
    with pytest.raises(InputError, match="a folder that mbsgen has generated; give the file that it was generated"):
        read_model(tmp_path)


@pytest.mark.parametrize(("given", "meant"), [("chek", "check"), ("reprot", "report"), ("sow", "show")])
def test_a_mistyped_command_is_told(given: str, meant: str) -> None:
    outcome = CliRunner().invoke(cli, [given, "model.yaml"])
    assert outcome.exit_code == 2
    assert f"did you mean '{meant}'?" in outcome.output


def test_a_file_is_taken_before_a_command_that_is_like_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "chek").write_text(FILES["model"], encoding="utf-8")
    outcome = CliRunner().invoke(cli, ["chek", "-o", "out"])
    assert outcome.exit_code == 0, outcome.output
