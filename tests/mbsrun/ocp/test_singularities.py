"""A search that fails at an expression names it: its place in the file, its part, the time, value or derivative."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from mbsrun.cli import cli
from mbsrun.ocp.ground.status import INVALID, explain
from mbsrun.ocp.solution.solution import Failure
from mbsrun.optimal.control import read_problem

GRID = "horizon: 2\nintervals: 10\nscheme: radau\ndegree: 3\n"
MASS = "name: mass\ngravity: [0, 0, 0]\nbodies: [{name: a, joint: {type: prismatic, axis: x}, mass: 1}]\n"
THROUGH = (
    GRID
    + """
states: {x: {rate: v, start: 0, end: 2}, y: {rate: w, start: 0, end: 0}}
controls: {v: {range: [-2, 2]}, w: {range: [-2, 2]}}
cost: {running: [{expression: v**2 + w**2}]}
constraints: [{expression: sqrt((x - 1)**2 + y**2), range: [0.3, null]}]
"""
)
DIVIDED = (
    GRID
    + """
states: {r: {rate: w, start: 1, end: 2}, w: {rate: u + 1/h, start: 0}, h: {rate: s, start: 1, end: 1, guess: 0}}
controls: {u: {range: [-10, 10]}, s: {range: [-1, 1]}}
cost: {running: [{expression: u**2 + s**2}]}
"""
)
LOGGED = GRID + "states: {x: {rate: u, start: 0}}\ncontrols: {u: {}}\ncost: {terminal: [{expression: log(x)}]}\n"
ROOT = LOGGED.replace("log(x)", "sqrt(x)").replace("start: 0", "start: 1, end: 0").replace("radau", "legendre")
WORK = (
    GRID.replace("2", "1", 1)
    + """
model: mass.yaml
cost: {inputs: 0, running: [{expression: abs(u_a*qd_a)}]}
start: {pose: {}}
end: {pose: {a: 1}, velocity: zero}
bounds: {inputs: [-5, 5]}
solver: {max_iterations: 30}
"""
)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        (THROUGH, ":9: constraints[0]", "sqrt((x - 1)**2 + y**2) has no finite derivative at t = 1 s of the guess"),
        (DIVIDED, ":6: states.w.rate", "1/h has no finite value at t = 0 s of the guess"),
        (LOGGED, ":7: cost.terminal[0]", "log(x) has no finite value at t = 2 s of the guess"),
        (ROOT, ":7: cost.terminal[0]", "sqrt(x) has no finite derivative at t = 2 s of the guess"),
        (WORK, ":7: cost.running[0]", "abs has no derivative at 0: split it or smooth it"),
    ],
)
@pytest.mark.parametrize("phases", [False, True])
def test_the_expression_is_named(tmp_path: Path, text: str, place: str, words: str, *, phases: bool) -> None:
    """In a problem of one phase, and of phases; no word of kernels or poses where there is no model."""
    (tmp_path / "mass.yaml").write_text(MASS, "utf-8")
    file = tmp_path / "task.ocp.yaml"
    file.write_text(text + ("phases: [{name: only}]\n" if phases else ""), "utf-8")
    result = CliRunner().invoke(cli, ["solve", str(file), "-o", str(tmp_path / "out")])
    assert result.exit_code == 1
    assert words in result.stderr
    assert f"task.ocp.yaml{place}" in result.stderr
    assert "model" in text or not ("kernel" in result.stderr or "poses" in result.stderr)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("link", "place", "words"),
    [
        ("map: {v: sqrt(v), x: x}", "links[0].map.v", "sqrt(v) has no finite derivative at t = 2 s of the guess"),
        ("map: {v: 1 + 1/v}", "links[0].map.v", "1/v has no finite value at t = 2 s"),
        (
            "conditions: [{expression: log(end_x - start_v - 9), range: [0, 1]}]",
            "links[0].conditions[0]",
            "log(end_x - start_v - 9) has no finite value at t = 2 s",
        ),
        ("cost: [{expression: sqrt(end_v)}]", "links[0].cost[0]", "sqrt(end_v) has no finite derivative at t = 2 s"),
    ],
)
def test_expressions_of_links_are_named(tmp_path: Path, link: str, place: str, words: str) -> None:
    """By the numbers of both sides where the guess joins them; also where no point lies at the end of a phase."""
    text = (
        GRID.replace("radau", "legendre")
        + "states: {x: {rate: v}, v: {rate: u}}\ncontrols: {u: {}}\ncost: {running: [{expression: u**2}]}\n"
        "phases: [{name: one, states: {x: {start: 0}, v: {start: 0, guess: 0}}}, {name: two, states: {x: {end: 1}}}]\n"
        f"links: [{{from: one, to: two, {link}}}]\nsolver: {{fallback: false}}\n"
    )
    (tmp_path / "task.ocp.yaml").write_text(text, "utf-8")
    result = CliRunner().invoke(cli, ["solve", str(tmp_path / "task.ocp.yaml"), "-o", str(tmp_path / "out")])
    assert result.exit_code == 1
    assert f"task.ocp.yaml:9: {place}: not solved" in result.stderr
    assert words in result.stderr


def test_python_names_it_too(tmp_path: Path) -> None:
    """The failure has the finding, and the part of the problem."""
    (tmp_path / "task.ocp.yaml").write_text(THROUGH, "utf-8")
    failure = read_problem(tmp_path / "task.ocp.yaml").solve().failure
    assert isinstance(failure, Failure)
    assert failure.place == "constraints[0]"
    assert "sqrt((x - 1)**2 + y**2) has no finite derivative" in failure.finding


def test_no_model_has_no_kernels() -> None:
    """A number that is not finite, without a cause that is known."""
    assert not {"kernel", "poses"} & set(" ".join(explain(INVALID, 3, has_model=False)).split())
