"""Ranges watched between the points of a grid, and starts that violate a path: by hand, without a mechanism."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.problem.problem import Constraint, Problem
from mbsrun.ocp.solving.margins import find_wrong_start, list_watched
from mbsrun.ocp.statement.statement import read_problem

INF = math.inf
TEXT = """
horizon: 2
intervals: 2
scheme: radau
degree: 2
states: {x: {rate: v, start: START, range: [-1, null]}, y: {rate: v, start: 3}}
controls: {v: {range: [null, 5]}, w: {}}
cost: {running: [{expression: v**2 + w**2}]}
"""


def read(folder: Path, text: str = "", start: str = "1") -> Problem:
    file = folder / "task.ocp.yaml"
    file.write_text(TEXT.replace("START", start) + text, "utf-8")
    return read_problem(file, load_on_demand, NO_MECHANISM)[0]


def test_bounds_and_constraints_of_the_whole_path_are_watched(tmp_path: Path) -> None:
    """Those with a limit; not the ones of an end, nor the ones that a penalty replaces."""
    problem = read(
        tmp_path,
        "constraints: [{expression: x + y, range: [0, 9]}, {expression: x - y, at: end, range: [0, 9]},"
        " {expression: 2*x, at: start, range: [0, 9]}, {expression: v*w, range: [null, 4]}]\n",
    )
    found = [
        (part.name, part.range, part.kind, part.index, part.expression) for part in list_watched(problem, NO_MECHANISM)
    ]
    assert found == [
        ("the bounds of x", (-1, INF), "states", 0, ""),
        ("the bounds of v", (-INF, 5), "controls", 0, ""),
        ("constraint x + y", (0, 9), "", 0, "x + y"),
        ("constraint v*w", (-INF, 4), "", 0, "v*w"),
    ]


def test_products_that_a_solver_relaxes_are_not_watched(tmp_path: Path) -> None:
    """They are above their limit by design: at a start as along a path."""
    problem = read(tmp_path, "constraints: [{expression: x, range: [0, 9]}]\n")
    relaxed = replace(problem, constraints=(*problem.constraints, Constraint("x*y", (-INF, 0.0), is_relaxed=True)))
    assert list_watched(relaxed, NO_MECHANISM) == list_watched(problem, NO_MECHANISM)
    assert find_wrong_start(relaxed, NO_MECHANISM) is None


def test_a_soft_constraint_is_watched_with_its_slack(tmp_path: Path) -> None:
    soft = read(tmp_path, "constraints: [{expression: x + y, range: [0, 9], soft: 3}]\n")
    found = [(part.name, part.range) for part in list_watched(soft, NO_MECHANISM)[2:]]
    assert ("constraint x + y plus its slack", (0.0, INF)) in found
    assert len(found) == 3


@pytest.mark.parametrize(
    ("expression", "start", "finding"),
    [
        ("x + y", "-0.5", ""),
        ("x - y + 0.5", "1", "x - y + 0.5 is -1.5 at 0 s, 1.5 below its limit 0"),
        ("x - y + 2", "1", ""),
        ("x*y + t - 1", "0", "x*y + t - 1 is -1 at 0 s, 1 below its limit 0"),
        ("9 + x", "1", "9 + x is 10 at 0 s, 1 above its limit 9"),
        ("v - 20", "1", ""),  # what a control chooses
        ("x - y", "null", ""),  # free to move
        ("x - y", "[-1, 1]", ""),
    ],
)
def test_a_start_that_is_given_whole_keeps_the_path(tmp_path: Path, expression: str, start: str, finding: str) -> None:
    first = "{expression: x + y, at: end, range: [90, 91]}, {expression: x, range: [-1, 2]}"
    problem = read(tmp_path, f"constraints: [{first}, {{expression: {expression}, range: [0, 9]}}]\n", start)
    found = find_wrong_start(problem, NO_MECHANISM)
    assert found == (
        (f"the given start violates a constraint of the path: {finding}", "constraints[2]") if finding else None
    )
