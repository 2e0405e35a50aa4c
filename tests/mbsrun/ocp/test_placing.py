"""Lines of a problem file for parts of a problem: each has a name there, and entries have the order of the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen.errors import Fault, InputError
from mbsrun.ocp.solving.placing import name_guesses, name_place, naming_guess, naming_lines
from mbsrun.ocp.statement.checks import ProblemError

TEXT = """model: arm.yaml
end: {pose: {a: 1, b: 2}, acceleration: {a: 0}}
bounds:
  coordinates: {a: [0, 1]}
  input_rates: [0, 1]
contacts:
  - {sensor: left, mode: touching}
  - {sensor: right}
  - {sensor: hand, mode: touching}
constraints:
  - {expression: q_a, range: [0, 1]}
guess: {solution: walk.csv}
"""
PHASES = """phases:
  - {name: first, end: {pose: {a: 3}}}
  - name: second
    end:
      velocity: {a: 3, b: 4}
    guess: {solution: run.csv}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Write a file of one phase."""
    file = tmp_path / "task.ocp.yaml"
    file.write_text(TEXT, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("part", "line", "place"),
    [
        ("end.coordinates[0]", 2, "end.pose.a"),
        ("end.coordinates[1]", 2, "end.pose.b"),
        ("end.coordinates[2]", 2, "end.pose"),
        ("end.accelerations", 2, "end.acceleration"),
        ("bounds.q[0]", 4, "bounds.coordinates.a"),
        ("bounds.rates", 5, "bounds.input_rates"),
        ("contacts[0].wrench", 8, "contacts[1]"),
        ("contacts[1].wrench", 7, "contacts[0]"),
        ("contacts[2].wrench", 9, "contacts[2]"),
        ("constraints[0].expression", 11, "constraints[0].expression"),
        ("model", 1, "model"),
    ],
)
def test_parts_have_the_names_and_the_order_of_the_file(file: Path, part: str, line: int, place: str) -> None:
    """Contacts that stand come first in a problem; a place that the file lacks has the line of the part around it."""
    assert name_place(file, part).startswith(f"{file}:{line}: {place}")


@pytest.mark.parametrize(
    ("part", "line", "place"),
    [
        ("phase first: end.coordinates[0]", 14, "phases[0].end.pose.a"),
        ("phase second: end.velocities[1]", 17, "phases[1].end.velocity.b"),
        ("phase second: bounds.q[0]", 4, "bounds.coordinates.a"),
        ("phase second: end.coordinates", 2, "end.pose"),
    ],
)
def test_parts_of_phases_are_theirs_or_shared(file: Path, part: str, line: int, place: str) -> None:
    file.write_text(TEXT + PHASES, encoding="utf-8")
    assert name_place(file, part).startswith(f"{file}:{line}: {place}")


def test_errors_get_lines(file: Path) -> None:
    """Of a problem all findings, of a guess the line that names it, unless the command line does."""
    with pytest.raises(InputError) as refusal, naming_lines(file):
        raise ProblemError("task", [("end.coordinates[1]", "too far", "move it"), ("constraints[0]", "x", "y")])
    found = [(fault.line, fault.path, fault.finding, fault.remedy) for fault in refusal.value.faults]
    assert found == [(2, "end.pose.b", "too far", "move it"), (11, "constraints[0]", "x", "y")]
    wrong = InputError([Fault("walk.csv", 0, "", "there is no such file", "write it")])
    with pytest.raises(InputError) as refusal, naming_guess(file, is_own=True):
        raise wrong
    (fault,) = refusal.value.faults
    assert (fault.line, fault.path, fault.finding) == (12, "guess.solution", "walk.csv: there is no such file")
    with pytest.raises(InputError) as refusal, naming_guess(file, is_own=False):
        raise wrong
    assert refusal.value is wrong
    file.write_text(TEXT + PHASES, encoding="utf-8")
    assert [name_guesses(file)(k, wrong.faults)[0].line for k in (None, 0, 1)] == [12, 12, 18]
