"""Solutions survive their files, to the last digit; other files are refused."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.ocp.ground.status import ACCEPTABLE
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Run, Solution, read_solution, write_solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.peer import Peer


def test_a_solution_survives_its_file(arm: Peer, reached: Solution, tmp_path: Path) -> None:
    """Everything comes back equal, infinite bounds and every bit of the arrays included."""
    solution = resimulate(reached, arm)
    write_solution(solution, tmp_path / "solution.json")
    again = read_solution(tmp_path / "solution.json")
    for field in fields(Solution):
        if field.name != "trajectory":
            assert getattr(again, field.name) == getattr(solution, field.name), field.name
    for field in fields(solution.trajectory):
        assert np.array_equal(getattr(again.trajectory, field.name), getattr(solution.trajectory, field.name))


def test_the_same_solve_writes_the_same_bytes_but_for_times(
    arm: Peer, reach: Problem, reached: Solution, tmp_path: Path
) -> None:
    timeless = Run("Solve_Succeeded", 0, 0.0, 0.0)
    again = solve(reach, arm)
    assert isinstance(again, Solution)
    for name, solution in (("one", reached), ("two", again)):
        write_solution(replace(solution, run=timeless), tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_an_acceptable_solution_is_flagged(reached: Solution) -> None:
    assert not reached.is_only_acceptable
    assert replace(reached, run=replace(reached.run, status=ACCEPTABLE)).is_only_acceptable


DAMAGED = {
    "empty": lambda _: "",
    "not JSON": lambda text: text[: len(text) // 2],
    "another format": lambda text: text.replace("mbsrun solution 1", "mbsrun solution 99"),
    "a key missing": lambda text: text.replace('"model":', '"modle":'),
    "a number missing": lambda text: text.replace('"t": [0.0, ', '"t": ['),
    "a number that is none": lambda text: text.replace('"t": [0.0, ', '"t": [NaN, '),
    "text for numbers": lambda text: text.replace('"t": [0.0, ', '"t": ["zero", '),
    "a mapping for numbers": lambda text: text.replace('"t": [0.0, ', '"t": [{}, '),
    "a number for numbers": lambda text: re.sub(r'"u": .*', '"u": 3,', text),
    "ragged": lambda text: text.replace('"q": [[', '"q": [[0.0, '),
}


@pytest.mark.parametrize("damage", DAMAGED.values(), ids=DAMAGED.keys())
def test_a_damaged_file_is_refused(reached: Solution, tmp_path: Path, damage: object) -> None:
    path = tmp_path / "solution.json"
    write_solution(reached, path)
    text = path.read_text("utf-8")
    assert callable(damage)
    path.write_text(damage(text), "utf-8")
    with pytest.raises(InputError, match=r"solution\.json"):
        read_solution(path)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_solution(tmp_path / "none.json")
