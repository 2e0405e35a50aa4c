"""Where expressions have no value, no derivative or a kink along a motion: of which points, and when; by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solving.singularities import find_in_links, find_kink, find_singularity, list_stated
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem

Array = NDArray[np.float64]
HEAD = "horizon: 2\nintervals: 2\nscheme: radau\ndegree: 2\nconstants: {k: 4}\n"
STATES = "states: {x: {rate: v, start: 1}, y: {rate: v, start: 1}}\ncontrols: {v: {}, w: {}}\n"
MESH, POINTS = np.array([0.0, 1.0, 2.0]), np.array([[0.25, 0.75], [1.25, 1.75]])


def write(folder: Path, text: str) -> Path:
    file = folder / "task.ocp.yaml"
    file.write_text(text, "utf-8")
    return file


def read(folder: Path, text: str) -> Problem:
    return read_problem(write(folder, HEAD + STATES + text), load_on_demand, NO_MECHANISM)[0]


def move(
    x: list[float], y: list[float] | None = None, v: tuple[float, float] = (3.0, 5.0), begin: float = 0.0
) -> Trajectory:
    """Make a motion of the numbers at 0, 0.25, 0.75, 1, 1.25, 1.75 and 2 s; v is constant in each interval."""
    states = np.stack((np.array(x), np.array(y or [7.0] * 7)), axis=1)
    points = states[[1, 2, 4, 5]].reshape(2, 2, 2)
    return Trajectory(
        begin + MESH,
        *np.zeros((2, 3, 0)),
        np.zeros((2, 0)),
        begin + POINTS,
        *np.zeros((3, 2, 2, 0)),
        states=states[[0, 3, 6]],
        point_states=points,
        controls=np.stack((np.array(v), np.ones(2)), axis=1),
    )


ONES = [1.0] * 7


def vanish(place: int) -> list[float]:
    return [0.0 if i == place else 1.0 for i in range(7)]


@pytest.mark.parametrize(("place", "time"), list(enumerate([0.0, 0.25, 0.75, 1.0, 1.25, 1.75])))
def test_a_path_is_read_at_mesh_points_and_between_them(tmp_path: Path, place: int, time: float) -> None:
    problem = read(tmp_path, "cost: {running: [{expression: k + sqrt(x)}]}\n")
    found = find_singularity(problem, NO_MECHANISM, move(vanish(place)))
    assert found is not None
    assert (found.part, found.finding, found.time) == ("sqrt(x)", "has no finite derivative", time)
    assert find_singularity(problem, NO_MECHANISM, move(ONES)) is None


def test_the_end_and_the_start_have_expressions_of_their_places(tmp_path: Path) -> None:
    """The path's end belongs to terminal costs and ends, its start to the constraints there."""
    problem = read(tmp_path, "cost: {running: [{expression: 1/x}], terminal: [{expression: log(y)}]}\n")
    assert find_singularity(problem, NO_MECHANISM, move(vanish(6))) is None
    assert find_singularity(problem, NO_MECHANISM, move(ONES, vanish(5))) is None
    found = find_singularity(problem, NO_MECHANISM, move(ONES, vanish(6)))
    assert found is not None
    assert (found.part, found.time, found.stated.place) == ("log(y)", 2.0, "cost.terminal[0]")
    for at, place, time in (("start", 0, 0.0), ("end", 6, 2.0)):
        held = read(tmp_path, f"constraints: [{{expression: 1/y, at: {at}, range: [0, 1]}}]\ncost: {{inputs: 1}}\n")
        assert find_singularity(held, NO_MECHANISM, move(ONES, vanish(6 - place))) is None
        found = find_singularity(held, NO_MECHANISM, move(ONES, vanish(place)))
        assert found is not None
        assert (found.finding, found.time) == ("has no finite value", time)


def test_inputs_at_a_mesh_point_are_those_after_it(tmp_path: Path) -> None:
    problem = read(tmp_path, "cost: {running: [{expression: w/v}]}\n")
    for v, time in (((1.0, 0.0), 1.0), ((0.0, 1.0), 0.0)):
        found = find_singularity(problem, NO_MECHANISM, move(ONES, None, v))
        assert found is not None
        assert found.time == time
    assert find_singularity(problem, NO_MECHANISM, move(ONES)) is None


@pytest.mark.parametrize("text", ["sqrt(k - 4) + x", "sqrt(t)*x", "sqrt(T - 2) + x", "x/(1 + sqrt(t))"])
def test_time_and_constants_need_no_derivatives(tmp_path: Path, text: str) -> None:
    """Nor the horizon, where it is given; a horizon that is free does."""
    term = f"cost: {{running: [{{expression: {text}}}]"
    assert find_singularity(read(tmp_path, term + "}\n"), NO_MECHANISM, move(ONES)) is None
    free = (HEAD + STATES + term + "}\n").replace("horizon: 2", "horizon: {range: [1, 3], guess: 2}")
    timed = read_problem(write(tmp_path, free), load_on_demand, NO_MECHANISM)[0]
    assert (find_singularity(timed, NO_MECHANISM, move(ONES)) is None) == ("T" not in text)


def test_values_of_time_count(tmp_path: Path) -> None:
    found = find_singularity(read(tmp_path, "cost: {running: [{expression: x/t}]}\n"), NO_MECHANISM, move(ONES))
    assert found is not None
    assert (found.part, found.finding, found.time) == ("x/t", "has no finite value", 0.0)


@pytest.mark.parametrize(
    ("text", "part", "where"),
    [
        ("v + abs(x - 2)", "abs(x - 2)", "abs has no derivative at 0"),
        ("v + max(x, 2)", "max(x, 2)", "max has no derivative at equal arguments"),
        ("v + min(2, x)", "min(2, x)", "min has no derivative at equal arguments"),
    ],
)
def test_a_kink_is_met_where_a_motion_passes_it(tmp_path: Path, text: str, part: str, where: str) -> None:
    problem = read(tmp_path, f"cost: {{running: [{{expression: v**2}}, {{expression: '{text}'}}]}}\n")
    assert find_kink(problem, NO_MECHANISM, move(ONES)) is None
    found = find_kink(problem, NO_MECHANISM, move([1, 1, 1, 1, 3, 3, 3]))
    assert found is not None
    assert (found.part, found.time, found.stated.place) == (part, 1.0, "cost.running[1]")
    assert found.remedy == f"{where}: split it or smooth it"


def test_all_expressions_of_a_problem_are_listed_with_their_places(tmp_path: Path) -> None:
    problem = read(
        tmp_path,
        "constraints: [{expression: x, range: [0, 9]}, {expression: y, at: end, range: [0, 9]},"
        " {expression: x + y, at: start, range: [0, 9]}]\n"
        "integrals: [{expression: x*y, range: [0, 9]}]\n"
        "cost: {running: [{expression: v**2}], terminal: [{expression: x**2}]}\n",
    )
    assert [(each.place, each.text, each.is_initial, each.is_terminal) for each in list_stated(problem)] == [
        ("constraints[0]", "x", False, False),
        ("constraints[1]", "y", False, True),
        ("constraints[2]", "x + y", True, False),
        ("cost.running[0]", "v**2", False, False),
        ("cost.terminal[0]", "x**2", False, True),
        ("states.x.rate", "v", False, False),
        ("states.y.rate", "v", False, False),
        ("integrals[0]", "x*y", False, False),
    ]


LINK = (
    HEAD
    + STATES
    + "cost: {running: [{expression: v**2}]}\nphases: [{name: one}, {name: two}, {name: three}]\n"
    + "links: [{from: one, to: two}, {from: two, to: three, LINK}]\n"
)


@pytest.mark.parametrize(
    ("link", "finding"),
    [
        (
            "map: {x: 1/y, y: y}",
            "1/y has no finite value at t = 4 s of the guess, phase two (the x by link",
        ),
        (
            "conditions: [{expression: log(start_x) + end_x, range: [0, 1]}]",
            "log(start_x) has no finite value at t = 4",
        ),
        ("conditions: [{expression: sqrt(end_y - start_x), range: [0, 1]}]", "has no finite derivative at t = 4 s"),
        ("cost: [{expression: 1/end_y}]", "1/end_y has no finite value at t = 4 s"),
        ("cost: [{expression: k/end_x + 1/(start_y - k)}]", ""),
        ("map: {x: 1/x, y: 1/(x - 4)}", ""),
    ],
)
def test_links_read_the_end_of_one_phase_and_the_start_of_the_next(tmp_path: Path, link: str, finding: str) -> None:
    """At the link, y ends with 0, and x starts with 0; other numbers vanish elsewhere."""
    problem, _ = read_phased_problem(write(tmp_path, LINK.replace("LINK", link)), load_on_demand)
    before, after = move([0, *[2.0] * 6], vanish(6), begin=2.0), move(vanish(0), [3, *[0.0] * 6], begin=4.0)
    plants = Plants((NO_MECHANISM,) * 3)
    found = find_in_links(problem, plants, [move(vanish(3)), before, after], "the guess")
    assert (found is None) == (finding == "")
    if found is not None:
        assert finding in found.finding
        assert found.place.startswith("links[1]")
