"""Problems that a controller cannot have: each is refused with its line, all parts at once, before any work."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mbsrun import cli
from mbsrun.controllers import making
from mbsrun.controllers.writing import tag_names

MODEL = """\
name: cart
gravity: [0, 0, -9.81]
bodies:
  - name: cart
    joint: {name: cart, type: prismatic, axis: x}
    mass: 1
"""
OPEN = (
    MODEL
    + """\
frames:
  - {name: hand, body: cart}
wrenches:
  - {name: hand, body: cart, frame: base, force: input}
"""
)
WINDY = MODEL.replace("axis: x", "axis: x, force: gust") + "signals: [gust]\n"
PROBLEM = """\
model: cart.yaml
horizon: 1
intervals: 8
scheme: radau
degree: 2
cost:
  inputs: 1
start:
  pose: {}
end:
  pose: {cart: 1}
bounds:
  inputs: [-8, 8]
"""
Refuse = Callable[[str, str], str]
LINES = len(PROBLEM.splitlines())
END = f"task.ocp.yaml:{LINES + 1}:"


@pytest.fixture
def refuse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refuse:
    """Call the command on a problem and a model; return stderr of a refusal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(making, "_finish", lambda *_: pytest.fail("a controller was made"))

    def call(problem: str, model: str) -> str:
        Path("task.ocp.yaml").write_text(problem, encoding="utf-8")
        Path("cart.yaml").write_text(model, encoding="utf-8")
        monkeypatch.setattr(sys, "argv", ["mbsrun", "controller", "task.ocp.yaml", "-o", "out"])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code == 2
        return capsys.readouterr().err

    return call


SECTIONS = {
    "controls: {brake: {range: [0, 1], rate: {range: [-1, 1]}}}": f"{END} controls.brake.rate: a controller remembers",
    "controls: {brake: {range: [0, 1], delay: 0.125}}": f"{END} controls.brake.delay: a controller remembers",
    "inputs: linear": f"{END} inputs: a controller holds its inputs from sample to sample",
    "inputs: polynomial": f"{END} inputs: a controller holds its inputs from sample to sample",
    "inputs: {delay: 0.125, history: free}": f"{END} inputs.history: a controller remembers the inputs that it gave",
}
CHANGES = {
    "intervals: 8": ("intervals: [0.1, 0.4, 0.5]", "task.ocp.yaml:3: intervals: a controller moves its plan ahead"),
}


@pytest.mark.parametrize("section", SECTIONS)
def test_a_section_that_a_controller_cannot_have_is_refused(refuse: Refuse, section: str) -> None:
    assert SECTIONS[section] in refuse(f"{PROBLEM}{section}\n", MODEL)


@pytest.mark.parametrize("line", CHANGES)
def test_a_line_that_a_controller_cannot_have_is_refused(refuse: Refuse, line: str) -> None:
    changed, expected = CHANGES[line]
    assert expected in refuse(PROBLEM.replace(line, changed), MODEL)


OPENED = {
    "contacts: [{sensor: hand, axes: x, normal: null}]": f"{END} contacts: a controller chooses the inputs",
    "wrenches: {hand: {force: [3*sin(t), 0, 0]}}": f"{END} wrenches: a controller chooses the inputs",
}


@pytest.mark.parametrize("section", OPENED)
def test_forces_beside_the_inputs_are_refused(refuse: Refuse, section: str) -> None:
    assert OPENED[section] in refuse(f"{PROBLEM}{section}\n", OPEN)


def test_signals_are_refused(refuse: Refuse) -> None:
    told = refuse(f"{PROBLEM}signals: {{gust: sin(t)}}\n", WINDY)
    assert told.startswith(
        f"{END} signals: a controller chooses the inputs of the model alone, and forces of the model"
    )


def test_rates_of_periods_that_are_free_are_refused(refuse: Refuse) -> None:
    """A bound of a rate from the input before needs the time since."""
    changed = PROBLEM.replace("horizon: 1", "horizon: {guess: 1, range: [0.5, 2]}")
    told = refuse(changed.replace("  inputs: [-8, 8]", "  input_rates: [-9, 9]"), MODEL)
    assert told.startswith(
        "task.ocp.yaml:13: bounds.input_rates: a controller remembers the inputs that it gave a period"
    )


def test_all_parts_are_refused_at_once(refuse: Refuse) -> None:
    changed = PROBLEM.replace("intervals: 8", "intervals: [0.1, 0.9]")
    changed += "controls: {brake: {rate: {range: [-1, 1]}}}\n"
    told = refuse(f"{changed}contacts: [{{sensor: hand, axes: x, normal: null}}]\n", OPEN).splitlines()
    places = ("task.ocp.yaml:3: intervals:", f"{END} controls.brake.rate:", f"task.ocp.yaml:{LINES + 2}: contacts:")
    assert [line.startswith(place) for line, place in zip(told, places, strict=True)] == [True] * 3


def test_a_folder_of_somebody_else_is_refused_before_the_work(refuse: Refuse) -> None:
    Path("out").mkdir()
    Path("out/notes.txt").write_text("mine", encoding="utf-8")
    assert "out: it exists, and is no folder that mbsgen wrote" in refuse("no problem", MODEL)


def test_only_the_beginning_of_a_name_gets_the_tag() -> None:
    """A controller of the name s has functions such as s_solve_batch, whose other letters stay."""
    assert tag_names(["s_solve_batch", "s_steps"], "s", "s_0a1b") == [
        ("s_solve_batch", "MBS_STAGES_NAME(s_0a1b, _solve_batch)"),
        ("s_steps", "MBS_STAGES_NAME(s_0a1b, _steps)"),
    ]
