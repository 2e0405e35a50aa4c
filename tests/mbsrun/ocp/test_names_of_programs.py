"""Every row and every bounded variable of a program has a name: the name of the quantity that moves it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.problem import Constraint, Problem
from mbsrun.ocp.solving.margins import list_watched
from mbsrun.ocp.transcription.clashes import Names, name_parts
from mbsrun.ocp.transcription.transcription import Transcription
from tests.mbsrun.ocp.horizons import CASES, pair, plant

RANGES = {  # of the problem: names of bounded variables, and the bounds that they have
    "the bounds of slide": (-1.0, 1.0),
    "the bounds of the velocity of slide": (-3.0, 3.0),
    "the bounds of the input slide": (-5.0, 5.0),
    "the bounds of w": (-4.0, 4.0),
    "the bounds of c": (-2.0, 2.0),
    "the range of the horizon": (0.5, 3.0),
}
ROWS = {
    "start: slide": (0.1, 0.1),
    "start: the velocity of slide": (0.2, 0.2),
    "start: w": (0.3, 0.3),
    "end: slide": (0.5, 0.5),
    "end: rest": (0.0, 0.0),
    "end: x of place": (0.4, 0.4),
    "end: y of place": (-0.1, -0.1),
    "end: z of place": (0.2, 0.2),
    "the bounds of slide": (-1.0, 1.0),
    "the bounds of the velocity of slide": (-3.0, 3.0),
    "the rate of the input slide": (-7.0, 9.0),
    "the rate of c": (-3.0, 3.0),
    "constraint q_slide + t/T": (-1.0, 2.0),
    "constraint u_slide*T": (-8.0, 8.0),
}


def name(transcription: Transcription) -> Names:
    manifest: Any = plant().manifest
    return name_parts(transcription, manifest)


def list_pairs(case: str) -> list[tuple[Transcription, Problem]]:
    one, other, given, free = pair(case)
    return [(one, given), (other, free)]


@pytest.mark.parametrize("case", CASES)
def test_every_row_has_a_name(case: str) -> None:
    for transcription, _ in list_pairs(case):
        assert sorted(name(transcription).rows) == [*range(transcription.program.constraints)]


@pytest.mark.parametrize("case", CASES)
def test_bounded_variables_have_the_name_of_what_the_problem_bounds(case: str) -> None:
    for transcription, problem in list_pairs(case):
        variables = name(transcription).variables
        lower, upper = transcription.variable_bounds(problem)
        for i, low, high in zip(transcription.program.kept.tolist(), lower, upper, strict=True):
            if np.isfinite([low, high]).any():
                assert RANGES[variables[i]] == (low, high)


@pytest.mark.parametrize("case", CASES)
def test_rows_have_the_name_of_what_the_problem_states(case: str) -> None:
    """Rows of an interval are of its stage, and equations; others have the limits that the problem gives them."""
    for transcription, problem in list_pairs(case):
        names, program = name(transcription), transcription.program
        lower, upper = transcription.constraint_bounds(problem)
        limits = dict(zip(program.kept_rows.tolist(), zip(lower.tolist(), upper.tolist(), strict=True), strict=True))
        stages = program.stages
        assert stages is not None
        for row, text in names.rows.items():
            interval = re.search(r" (?:in|within|after) interval (\d+)$", text)
            assert (interval is not None) == (row in names.inner), text
            if interval:
                assert limits.get(row, (0, 0)) == (0, 0)
                assert stages.rows[row] == int(interval[1]) - 1
            else:
                assert ROWS[text] == limits[row]


def test_what_the_problem_bounds_is_watched_along_the_path() -> None:
    """By the same names and ranges; relaxed constraints and constraints at the end are no matter of the path."""
    problem = pair("a state and a control")[2]
    others = Constraint("q_slide", (0.1, 0.9), "end"), Constraint("qd_slide", (0.0, 0.0), is_relaxed=True)
    problem = replace(problem, constraints=(*problem.constraints, *others))
    found = {part.name: part.range for part in list_watched(problem, plant())}
    known = {name: limits for name, limits in RANGES.items() if "horizon" not in name}
    assert found == known | {name: limits for name, limits in ROWS.items() if name.startswith("constraint")}
