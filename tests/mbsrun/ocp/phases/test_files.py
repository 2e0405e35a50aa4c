"""The files of a solution in phases: written by the command, read back, and a guess for another solve."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from mbsgen.errors import InputError
from mbsrun.cli import cli
from mbsrun.commands import solve as solving
from mbsrun.external import load_on_demand
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import End, Form, Representation
from mbsrun.ocp.showing.files import write_files
from mbsrun.ocp.solution.phases import PhasedSolution, read_phased_guess, read_phased_solution, write_phased_solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.statement.phases import read_phased_problem
from tests.mbsrun.ocp.phases.motions import split, swing_up
from tests.mbsrun.ocp.plants import cart_pole
from tests.mbsrun.peer import Peer, double_integrator

MODELS = Path(__file__).parents[4] / "models"


@pytest.fixture(scope="module")
def cart() -> Peer:
    return cart_pole()


@pytest.fixture(scope="module")
def solution(cart: Peer) -> PhasedSolution:
    outcome = solve_phases(split(swing_up()), Plants((cart, cart)))
    assert isinstance(outcome, PhasedSolution)
    return outcome


def test_a_solution_is_read_back_with_every_digit(solution: PhasedSolution, tmp_path: Path) -> None:
    write_phased_solution(solution, tmp_path / "solution.json")
    found = read_phased_solution(tmp_path / "solution.json")
    assert found.problem == solution.problem
    assert found.values == solution.values
    for ours, theirs in zip(found.phases, solution.phases, strict=True):
        assert (ours.trajectory.point_q == theirs.trajectory.point_q).all()
    write_phased_solution(found, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "solution.json").read_bytes()


def test_a_solve_from_a_solution_ends_at_once(solution: PhasedSolution, cart: Peer, tmp_path: Path) -> None:
    write_phased_solution(solution, tmp_path / "solution.json")
    guess = read_phased_guess(tmp_path / "solution.json", solution.names, (cart.manifest, cart.manifest))
    again = solve_phases(solution.problem, Plants((cart, cart)), guess=guess)
    assert isinstance(again, PhasedSolution)
    assert again.run.iterations < solution.run.iterations
    assert again.cost == pytest.approx(solution.cost, rel=1e-8)


def test_a_guess_for_other_phases_is_refused(solution: PhasedSolution, cart: Peer, tmp_path: Path) -> None:
    write_phased_solution(solution, tmp_path / "solution.json")
    with pytest.raises(InputError) as refusal:
        read_phased_guess(tmp_path / "solution.json", ("first", "third"), (double_integrator().manifest, cart.manifest))
    text = str(refusal.value)
    assert "phase first: its coordinates are cart, pole; double integrator has slide" in text
    assert "it has the phases first, second, and none of the name third" in text


def test_tables_go_on_in_time(solution: PhasedSolution, cart: Peer, tmp_path: Path) -> None:
    """The second phase's table begins where the first one's ends; the pictures are drawn."""
    plants = Plants((cart, cart))
    written = write_files(solution, plants, tmp_path / "out")
    assert written == (
        "solution.json",
        "first.csv",
        "second.csv",
        "trajectories.png",
        "mechanism.png",
        "animation.html",
    )
    first, second = (np.array(list(csv.reader((tmp_path / "out" / name).open()))[1:], float) for name in written[1:3])
    assert first[-1, :5] == pytest.approx(second[0, :5], abs=1e-9)
    assert second[-1, 0] == 2.0
    assert all((tmp_path / "out" / name).stat().st_size for name in written)


TEXT = """\
model: cart_pole.yaml
horizon: 1
intervals: 10
scheme: radau
degree: 4
cost: {inputs: 1}
phases:
  - {name: first, start: {pose: {}}}
  - {name: second, end: {pose: {cart: 1, pole: pi}, velocity: zero}}
links:
  - {from: first, to: second}
"""


def test_the_command_solves_phases(requires: Callable[[str], str], tmp_path: Path) -> None:
    """It prints the phases and links, and warns of errors; it refines grids, and refuses other guesses."""
    requires("cc")
    (tmp_path / "cart_pole.yaml").write_text((MODELS / "cart_pole.yaml").read_text())
    (tmp_path / "split.ocp.yaml").write_text(TEXT)
    command = ["solve", str(tmp_path / "split.ocp.yaml"), "-o", str(tmp_path / "out")]
    run = CliRunner().invoke(cli, command)
    assert "phase second" in run.output
    assert "link first to second" in run.output
    assert "warning: phase second: the largest defect" in run.output
    assert run.exit_code == 1
    assert read_phased_solution(tmp_path / "out" / "solution.json").names == ("first", "second")
    (tmp_path / "other.json").write_text("{}")
    other = CliRunner().invoke(cli, [*command, "--guess", str(tmp_path / "other.json")])
    assert isinstance(other.exception, InputError)
    assert "solve the problem of phases again" in str(other.exception)
    refined = CliRunner().invoke(cli, [*command, "--refine", "1e-4"])
    assert refined.exit_code == 0, refined.output
    assert "second: refinement" in refined.output
    assert "warning" not in refined.output
    assert CliRunner().invoke(cli, [*command, "--refine", "0"]).exit_code == 2
    text = TEXT.replace(
        "to: second}", "to: second, conditions: [{expression: start_u_cart - end_u_cart, range: [0, 0]}]}"
    )
    (tmp_path / "split.ocp.yaml").write_text(text)
    unstaged = CliRunner().invoke(cli, [*command, "--solver", "mbs"])
    place = f"{tmp_path / 'split.ocp.yaml'}:11: links[0].conditions[0].expression"
    assert f"{place}: mbs cannot read inputs at a start" in str(unstaged.exception)
    assert "here: start_u_cart - end_u_cart; take solver.method: ipopt" in str(unstaged.exception)
    (tmp_path / "split.ocp.yaml").write_text(TEXT)
    refused = CliRunner().invoke(cli, [*command, "--starts", "3", "--hops", "2", "--workers", "2"])
    assert refused.exit_code == 2
    assert "--hops, --workers: only for problems of one phase; leave it out" in refused.output
    aimless = CliRunner().invoke(cli, [*command, "--target", "1", "0", "0"])
    assert aimless.exit_code == 2
    assert "the problem has targets for no sensor" in aimless.output
    searched = CliRunner().invoke(cli, [*command, "--starts", "2"])
    assert "in 2 starts; lower ones may exist" in searched.output
    assert (tmp_path / "out" / "starts.png").is_file()


def test_a_target_is_the_one_of_the_phase_that_has_one() -> None:
    """Of two phases that have one, neither is taken."""
    own = split(swing_up())
    first, second = own.phases
    aimed = replace(second, problem=replace(second.problem, end=End(sensors=(("tip", (1.0, None, None)),))))
    found = solving._retarget(replace(own, phases=(first, aimed)), (2.0, math.pi / 2, 0.5))
    assert found.phases[0] == first
    assert found.phases[1].problem.end.sensors[0][1] == pytest.approx((0.0, 2.0, 0.5))
    with pytest.raises(click.BadParameter, match="the phases second, second have targets"):
        solving._retarget(replace(own, phases=(aimed, aimed)), (2.0, 0.0, 0.5))


def test_options_hold_for_every_phase(requires: Callable[[str], str], tmp_path: Path) -> None:
    """The optimum stays; what the phases do not take together is refused, phase by phase."""
    requires("cc")
    (tmp_path / "cart_pole.yaml").write_text((MODELS / "cart_pole.yaml").read_text())
    (tmp_path / "split.ocp.yaml").write_text(TEXT)
    command = ["solve", str(tmp_path / "split.ocp.yaml"), "-o", str(tmp_path / "out")]
    CliRunner().invoke(cli, command)
    usual = read_phased_solution(tmp_path / "out" / "solution.json")
    CliRunner().invoke(cli, [*command, "--form", "shooting", "--representation", "exp2-o"])
    shot = read_phased_solution(tmp_path / "out" / "solution.json")
    assert [phase.problem.form for phase in shot.problem.phases] == [Form.SHOOTING] * 2
    assert [phase.problem.representation for phase in shot.problem.phases] == [Representation.EXP2_O] * 2
    assert shot.cost == pytest.approx(usual.cost, rel=1e-7)
    refused = CliRunner().invoke(cli, [*command, "--integrator", "rk4"])
    assert "phases[0].integrator: rk4 with 1 steps is for shooting" in str(refused.exception)
    assert "phases[1].integrator: rk4 with 1 steps is for shooting" in str(refused.exception)


STAGES = """
horizon: {guess: 60, range: [1, 300]}
intervals: 10
scheme: radau
degree: 4
constants: {g: 9.81, ve: 3000, F1: 60000, F2: 12000}
states:
  v: {rate: F/m - g}
  m: {rate: -F/ve}
controls: {F: {}}
phases:
  - name: first
    states: {v: {start: 0}, m: {start: 3000, end: [1300, null]}}
    controls: {F: {range: [0, F1], guess: F1}}
  - name: second
    states: {m: {end: [400, null]}}
    controls: {F: {range: [0, F2], guess: F2}}
    cost: {terminal: [{expression: -v}]}
links: [{from: first, to: second, map: {m: m - 500}}]
"""


def test_a_linked_state_needs_no_start(tmp_path: Path) -> None:
    """A rocket of two stages at full thrust: v = ve ln(3000/1300) + ve ln(800/400) - g (85 s + 100 s).

    The second stage's mass, of which no start and no guess is given, is guessed by the link: at 0, F/m has no value.
    """
    (tmp_path / "rocket.ocp.yaml").write_text(STAGES, "utf-8")
    problem, plants = read_phased_problem(tmp_path / "rocket.ocp.yaml", load_on_demand)
    solution = solve_phases(problem, plants)
    assert isinstance(solution, PhasedSolution), solution.finding
    assert solution.durations == pytest.approx((85.0, 100.0), rel=1e-6)
    assert -solution.cost == pytest.approx(3000 * math.log(3000 / 1300 * 800 / 400) - 9.81 * 185, rel=1e-6)


def test_a_state_that_no_link_leads_to_needs_a_start(tmp_path: Path) -> None:
    """The message names the place, and that null is free."""
    (tmp_path / "rocket.ocp.yaml").write_text(STAGES.replace("{v: {start: 0}, m:", "{m:"), "utf-8")
    with pytest.raises(
        InputError, match=r"rocket.ocp.yaml:\d+: states.v.start: missing; give it, e.g. 0.0; null is free$"
    ):
        read_phased_problem(tmp_path / "rocket.ocp.yaml", load_on_demand)
