"""Constraints and bounds between the points of a grid: their worst violation is found, said, stored and refined."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from mbsgen.errors import InputError
from mbsrun.cli import cli
from mbsrun.ocp.solution.phases import read_phased_solution
from mbsrun.ocp.solution.solution import Margins, read_solution
from mbsrun.ocp.solving.margins import TOLERATED, find_tolerated
from mbsrun.optimal.control import read_problem

PUCK = """
name: puck
gravity: [0, 0, 0]
bodies:
  - name: puck
    joint: [{name: x, type: prismatic, axis: x}, {name: y, type: prismatic, axis: y}]
    mass: 1
frames: [{name: p, body: puck}]
"""
RADIUS = 0.03
POST = f"""
model: puck.yaml
horizon: 2
intervals: 10
scheme: radau
degree: 3
cost: {{inputs: 1}}
start: {{pose: {{x: -1.03, y: 0.0}}}}
end: {{pose: {{x: 1, y: 0}}, velocity: zero}}
constraints: [{{expression: x_p**2 + (y_p - 0.002)**2, range: [{RADIUS**2}, null]}}]
"""
ARCH = """
horizon: 1
intervals: 1
scheme: radau
degree: 3
accuracy: 0.1
states: {x: {rate: pi*cos(pi*t), start: 0, range: [null, LIMIT]}}
controls: {c: {range: [-1, 1]}}
cost: {running: [{expression: c**2}]}
"""


def run(folder: Path, text: str, *options: str) -> Result:
    """Solve a problem with the model of the puck beside it."""
    (folder / "puck.yaml").write_text(PUCK, "utf-8")
    (folder / "task.ocp.yaml").write_text(text, "utf-8")
    arguments = ["solve", str(folder / "task.ocp.yaml"), "-o", str(folder / "out"), *options]
    return CliRunner().invoke(cli, arguments)


def margins(folder: Path) -> Margins:
    check = read_solution(folder / "out" / "solution.json").resimulation
    assert check is not None
    assert check.margins is not None
    return check.margins


def test_the_worst_place_between_points_is_exact(tmp_path: Path) -> None:
    """x = sin(pi t) is 1 at t = 1/2, where one interval of degree 3 has no point; at its points it is 0.898 at most."""
    result = run(tmp_path, ARCH.replace("LIMIT", "0.95"))
    assert result.exit_code == 1
    assert "between the points of the grid, x is 1 at 0.5 s, 0.05 above its limit 0.95" in result.stderr
    worst = margins(tmp_path).worst
    assert worst is not None
    assert worst.value == pytest.approx(1.0, abs=1e-9)
    assert worst.time == pytest.approx(0.5, abs=1e-4)  # the top is flat: 1 - (pi dt)^2 / 2
    assert worst.violation == pytest.approx(0.05, abs=1e-9)
    assert not worst.is_kept


@pytest.mark.parametrize(
    ("start", "expression", "words"),
    [
        (-1.03, "x_p + 0.5", "x_p + 0.5 is -0.53 at 0 s, 0.53 below its limit 0"),
        (0.0, "log(q_x**2)", "log(q_x**2) is -inf at 0 s, inf below its limit 0"),
        (-1.03, "vx_p*u_x", ""),  # the inputs may do something about it
    ],
)
def test_a_given_start_keeps_constraints_of_states(tmp_path: Path, start: float, expression: str, words: str) -> None:
    """A program leaves them out there, as nothing can change: the finest jump away from it would be the answer."""
    text = POST.replace("-1.03", f"{start}").replace("(y_p - 0.002)**2", "0").replace("x_p**2 + 0", expression)
    result = run(tmp_path, text.replace(f"{RADIUS**2}", "0").replace("horizon", "solver: {fallback: false}\nhorizon"))
    assert ("start violates" in result.stderr) == bool(words)
    assert words in result.stderr
    assert "Warning" not in result.stderr


def test_a_kept_range_is_reported_without_a_warning(tmp_path: Path) -> None:
    """The same arch under a limit above it."""
    result = run(tmp_path, ARCH.replace("LIMIT", "1.001"))
    assert result.exit_code == 0, result.stderr
    assert "between       the grid's points, bounds and constraints are violated by 0.0e+00 at most" in result.stdout
    assert not margins(tmp_path).violated


def test_a_thin_post_is_not_passed_in_silence(tmp_path: Path) -> None:
    """A straight way at 0.002 m beside the centre of a post of 0.03 m leads through it, between two points."""
    result = run(tmp_path, POST)
    assert result.exit_code == 1
    assert "x_p**2 + (y_p - 0.002)**2" in result.stderr
    worst = margins(tmp_path).worst
    assert worst is not None
    assert math.sqrt(worst.value) < 0.62 * RADIUS
    table = np.genfromtxt(tmp_path / "out" / "solution.csv", delimiter=",", names=True)
    apart = np.hypot(table[table.dtype.names[1]], table[table.dtype.names[2]] - 0.002)
    assert apart.min() > RADIUS * (1 - 1e-6)  # at all points of the grid


SLOPED = """
model: puck.yaml
horizon: 2
intervals: 20
scheme: radau
degree: 3
cost: {inputs: 1}
start: {pose: {}}
end: {pose: {x: 1, y: 0}, velocity: zero}
constraints: [{expression: qd_x, range: [null, 0.5], soft: 0.6}]
"""


def test_a_slack_that_falls_to_a_smaller_one_is_no_violation(tmp_path: Path) -> None:
    """The speed follows slacks that are constant over intervals; as it falls, it begins each above its slack."""
    result = run(tmp_path, SLOPED)
    assert result.exit_code == 0, result.output
    margin = next(part for part in margins(tmp_path).each if "qd_x" in part.name)
    assert margin.name == "constraint qd_x less its slack"
    assert margin.is_kept
    slacks = read_solution(tmp_path / "out" / "solution.json").trajectory.controls[:, 0]
    assert np.diff(slacks).min() < -0.01 < 0.01 < np.diff(slacks).max()  # larger steps than are tolerated


def test_refinement_leads_around_the_post(tmp_path: Path) -> None:
    """It splits the interval within which the post is violated, though every defect is below rounding."""
    result = run(tmp_path, POST, "--refine", "1e-6")
    assert result.exit_code == 0, result.stderr
    worst = margins(tmp_path).worst
    assert worst is not None
    assert worst.value > RADIUS**2 * (1 - TOLERATED)
    solution = read_solution(tmp_path / "out" / "solution.json")
    assert 10 < solution.problem.intervals < 40


def test_phases_are_watched(tmp_path: Path) -> None:
    """The post stands in the way of the second phase."""
    lines = POST.replace("start: {pose: {x: -1.03, y: 0.0}}\n", "").replace("horizon: 2\n", "").strip().splitlines()
    shared, (end, constraints) = lines[:-2], lines[-2:]
    text = "\n".join(
        [
            *shared,
            "phases:",
            "  - name: before",
            "    horizon: 0.5",
            "    start: {pose: {x: -1.53, y: 0.0}}",
            "    end: {pose: {x: -1.03, y: 0.0}}",
            "  - name: through",
            "    horizon: 2",
            f"    {end}",
            f"    {constraints}",
            "links: [{from: before, to: through}]",
        ]
    )
    result = run(tmp_path, text)
    assert result.exit_code == 1, result.output
    assert "phase through: between the points of the grid, x_p**2" in result.stderr
    assert "through: between" in result.stdout
    solution = read_phased_solution(tmp_path / "out" / "solution.json")
    found = [phase.resimulation for phase in solution.phases]
    assert [bool(check and check.margins and check.margins.violated) for check in found] == [False, True]


def test_a_cost_may_be_empty(tmp_path: Path) -> None:
    """Without a mechanism it asks for any motion that meets the constraints; left out, it is missed."""
    text = ARCH.replace("cost: {running: [{expression: c**2}]}", "cost: {}").replace("LIMIT", "2")
    assert run(tmp_path, text).exit_code == 0
    result = run(tmp_path, text.replace("cost: {}", ""))
    assert isinstance(result.exception, InputError)
    assert "cost: missing" in str(result.exception)


def test_python_returns_the_margins(tmp_path: Path) -> None:
    """As the file holds them."""
    (tmp_path / "task.ocp.yaml").write_text(ARCH.replace("LIMIT", "0.95"), "utf-8")
    solution = read_problem(tmp_path / "task.ocp.yaml").solve()
    assert solution
    found = {margin.name: margin for margin in solution.margins}
    assert found["the bounds of x"].violation == pytest.approx(0.05, abs=1e-9)
    assert any("between the points" in text for text in solution.shortcomings)


@pytest.mark.parametrize(
    ("limits", "values", "expected"),
    [
        ((-2.0, 2.0), [-10.0, 10.0], 0.04),  # the length of the range
        ((0.0009, math.inf), [0.0003, 1.0], 9e-6),  # the only limit
        ((0.0, math.inf), [-0.5, 1.5], 0.02),  # no limit to measure by: the spread
        ((-math.inf, 100.0), [100.0, 101.0], 0.01),  # the spread, where it is less than the limit
        ((3.0, 3.0), [3.0, 3.0], 0.03),  # an equation: its value
        ((0.0, math.inf), [0.0, 0.0], 1e-7),  # nothing: rounding alone
    ],
)
def test_what_is_tolerated_has_a_scale(limits: tuple[float, float], values: list[float], expected: float) -> None:
    """One in a hundred of the scale that the documentation states."""
    assert find_tolerated(limits, np.array(values)) == pytest.approx(expected)
