"""States, delays and bounds of rates in the closed loop of a puck, by the solver and by controllers in C.

x'' = u / 2 under inputs that are held, so motions, integrals and rates have closed forms.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mbsrun
from mbsgen.expressions import parse
from mbsgen.output import write_folder
from mbsrun import Controller, Mechanism, cli
from mbsrun.controllers.making import make
from mbsrun.external import load_on_demand
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Kick, Noise, Plant, SolvingController, Track, Trial, record, track
from mbsrun.tracking.analysis import find_margins
from mbsrun.tracking.compiled import CompiledController, MisfitError, Stepping
from tests.mbsrun.tracking.tasks import FOLLOW

PERIOD, RATE, HEAT = 0.05, 20.0, 30.0
NOISE = Noise(np.full(1, 1e-3), np.full(1, 1e-2), np.zeros(1))
TRIAL = Trial(
    "task", 1.0, PERIOD, np.zeros(1), np.full(1, 0.5), NOISE, Settings(1.0),
    updates={"t0": parse("t")}, kicks=(Kick(0.4, ((0, 0.2),)),),
)  # fmt: skip
TASKS = {
    "late": f"{FOLLOW}inputs: {{delay: 0.15, history: 2}}\n",
    "rated": f"{FOLLOW}bounds: {{input_rates: [-{RATE}, {RATE}]}}\n",
    "both": f"{FOLLOW}inputs: {{delay: 0.1}}\nbounds: {{input_rates: [-{RATE}, {RATE}], inputs: [-8, 8]}}\n",
    "states": (
        f"{FOLLOW}states:\n  heat: {{rate: u_x**2, start: 0, range: [null, {HEAT}]}}\n"
        "  sum: {rate: q_x - sin(t0 + t), start: 0.1}\n"
    ),
    "integral": f"{FOLLOW}integrals: [{{expression: u_x**2, range: [0, 25]}}]\n",
    "numbers": FOLLOW.replace("100}]", "1}], largest: [{expression: u_x, absolute: true, weight: 0.01, name: peak}]")
    + "constraints: [{expression: q_x, range: [null, 0.6], soft: 2}]\n",
}
DELAYS = {"late": 3, "both": 2}


@dataclass(frozen=True)
class Case:
    """A task, and its controller in C."""

    name: str
    problem: Problem
    model: Path
    written: Controller

    def run(self, puck: Mechanism, steps: int | None = None, *, is_solver: bool = False, delay: int = 0) -> Track:
        """Run the loop, by the controller in C or by the solver."""
        states = self.problem.states
        trial = replace(
            TRIAL,
            delay=delay,
            states=tuple(state.name for state in states),
            controls=tuple(control.name for control in self.problem.controls),
            start_states=np.array([state.start[0] for state in states]),
        )
        self.written.reset()
        stepping = None if steps is None else Stepping(steps)
        controller = (
            SolvingController(self.problem, load_on_demand(self.model), PERIOD)
            if is_solver
            else CompiledController(self.written, self.problem, PERIOD, stepping)
        )
        return track(trial, self.problem.bounds, Plant(puck, trial, self.problem), controller, puck)


Make = Callable[[str], Case]


@pytest.fixture(scope="module")
def find(folder: Path) -> Make:
    """Return a case by its name; its controller is written once, and compiled without optimisation."""
    return cache(lambda name: write_case(name, folder))


def write_case(name: str, folder: Path) -> Case:
    file = folder / f"{name}.ocp.yaml"
    file.write_text(f"{TASKS[name]}solver: {{tolerance: 1e-10}}\n", encoding="utf-8")
    problem = read_problem(file, load_on_demand)[0]
    model = folder / "puck.yaml"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0 -Wall -Wextra -Wpedantic -Werror")
        made = make(problem, load_on_demand(model), model)
        write_folder(made.files, folder / f"controller_{name}")
        return Case(name, problem, model, mbsrun.controller(folder / f"controller_{name}"))


def read_inputs(found: Track) -> np.ndarray:
    return np.array([sample.u[0] for sample in found.samples])


@pytest.mark.parametrize("name", TASKS)
def test_the_controller_solves_what_the_command_solves(find: Make, name: str) -> None:
    case = find(name)
    expected = solve(case.problem, load_on_demand(case.model))
    assert isinstance(expected, Solution)
    case.written.reset()
    result = case.written.solve()
    assert (result.status, result.cost) == ("solved", pytest.approx(expected.cost.total, rel=1e-6))
    assert case.written.plan().inputs[:, :1] == pytest.approx(expected.trajectory.u, abs=1e-3)


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("delay", [0, 1])
def test_the_loop_of_the_controller_is_the_loop_of_the_solver(
    find: Make, name: str, puck: Mechanism, delay: int
) -> None:
    """Both solve to 1e-8 of conditions in which inputs weigh 1e-4: places agree better than inputs."""
    case = find(name)
    found, expected = (case.run(puck, is_solver=is_solver, delay=delay) for is_solver in (False, True))
    assert (found.failures, expected.failures) == (0, 0)
    assert found.q == pytest.approx(expected.q, abs=2e-4)
    assert found.states == pytest.approx(expected.states, abs=2e-2)


@pytest.mark.parametrize("name", ["rated", "both"])
@pytest.mark.parametrize("steps", [None, 1])
def test_rates_hold_across_samples(find: Make, name: str, puck: Mechanism, steps: int | None) -> None:
    """|u_k - u_(k-1)| <= rate * period in what acts, with noise and a blow; from the history on, where it is late."""
    case = find(name)
    for delay in (0, 1):
        found = case.run(puck, steps, delay=delay)
        assert found.failures == 0
        steps_of_inputs = np.diff(read_inputs(found), prepend=[0.0] if case.name == "both" else [])
        assert np.abs(steps_of_inputs).max() <= RATE * PERIOD * (1 + 1e-6)
        assert np.abs(steps_of_inputs).max() > 0.9 * RATE * PERIOD


@pytest.mark.parametrize("name", DELAYS)
@pytest.mark.parametrize("steps", [None, 1])
def test_commands_act_late(find: Make, name: str, puck: Mechanism, steps: int | None) -> None:
    case = find(name)
    found, late = case.run(puck, steps), DELAYS[case.name]
    given = [float(sample.decision.inputs[0]) for sample in found.samples]
    assert read_inputs(found).tolist() == [*[2.0 if case.name == "late" else 0.0] * late, *given[:-late]]
    if case.name == "late":
        assert np.abs(found.q[:, 0] - np.sin(found.t))[-5:].max() < 0.02


@pytest.mark.parametrize("name", ["states"])
@pytest.mark.parametrize("steps", [None, 1])
def test_added_states_follow_the_true_motion(find: Make, name: str, puck: Mechanism, steps: int | None) -> None:
    """Heat is the sum of u^2; the sum of errors follows from parabolas, and from the cosine; heat has a limit."""
    case = find(name)
    found = case.run(puck, steps)
    u = read_inputs(found)
    areas = [x.q[0] * PERIOD + x.qd[0] * PERIOD**2 / 2 + x.u[0] / 2 * PERIOD**3 / 6 for x in found.samples]
    kick = 0.2 * PERIOD  # at the start of the ninth period, before its motion
    assert found.states[-1, 0] == pytest.approx(float((u**2).sum() * PERIOD), rel=1e-9)
    assert found.states[-1, 1] == pytest.approx(0.1 + sum(areas) + kick * PERIOD / 2 + np.cos(1) - 1, abs=1e-9)
    margin = next(x for x in find_margins(found, case.problem, puck)[0] if x.name == "state heat")
    assert margin.is_kept
    assert found.states[-1, 0] <= HEAT * (1 + 1e-3)


@pytest.mark.parametrize("name", ["rated", *DELAYS])
def test_a_period_that_is_no_interval_is_refused(find: Make, name: str, folder: Path) -> None:
    """Commands are remembered by intervals; bounds of rates alone bind the solver's samples at any rate."""
    case = find(name)
    halved = PERIOD / 2
    if case.name in ("late", "both", "rated"):
        with pytest.raises(
            MisfitError, match=r"remembers inputs by intervals of 0\.05 s, and a period has 0\.025 s; give"
        ):
            CompiledController(case.written, case.problem, halved)
    if case.name in ("late", "both"):
        with pytest.raises(ProblemError, match=r"periods of 0\.025 s are none; give a rate of 20 Hz"):
            SolvingController(case.problem, load_on_demand(folder / "puck.yaml"), halved)


def test_numbers_of_plans_have_no_margins(find: Make, puck: Mechanism) -> None:
    """A plan's largest value bounds inputs of that plan; its slack is a control, and the place may be passed by it."""
    case = find("numbers")
    names = [margin.name for margin in find_margins(case.run(puck), case.problem, puck)[0]]
    assert "q_x less its slack" in names
    assert not [name for name in names if "peak" in name]


SETTINGS = """
duration: 0.2
rate: 20
updates: {t0: t}
start: {states: {heat: 1}}
measures: [{name: warm, expression: heat}]
"""


def test_the_command_writes_states(
    find: Make, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    find("states")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(record, "save", lambda *_: None)  # pictures take seconds
    Path("task.track.yaml").write_text(SETTINGS, encoding="utf-8")
    arguments = ["states.ocp.yaml", "--settings", "task.track.yaml", "--controller", "controller_states", "-o", "warm"]
    monkeypatch.setattr(sys, "argv", ["mbsrun", "track", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    told = "".join(capsys.readouterr())
    assert end.value.code == 0, told
    rows = list(csv.DictReader(Path("warm/track.csv").read_text(encoding="utf-8").splitlines()))
    assert rows[0]["state[sum]"] == "0.1"
    heats = [float(row["state[heat]"]) for row in rows]
    assert heats[0] == 1
    assert heats[1] == pytest.approx(1 + float(rows[0]["u[x]"]) ** 2 * PERIOD)
    assert "warm" in told
