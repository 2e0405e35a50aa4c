"""Recorded motions as guesses of problems in phases: a table for each phase, or parts of one recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mbsgen.errors import InputError
from mbsrun.cli import cli
from mbsrun.ocp.guessing.recorded_phases import find_phased_guess
from mbsrun.ocp.problem.phases import PhasedProblem, Plants
from mbsrun.ocp.solution.phases import Guess, PartialGuess, PhasedSolution, read_phased_solution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.phases import Ready, prepare_phases, solve_phases
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.phases.motions import cut, split, swing_up
from tests.mbsrun.ocp.plants import cart_pole
from tests.mbsrun.peer import Peer

MODELS = Path(__file__).parents[4] / "models"
TEXT = """\
model: cart_pole.yaml
horizon: {guess: 0.4, range: [0.2, 2]}
intervals: 10
scheme: radau
degree: 4
cost: {inputs: 1}
constants: {half: 0.7}
phases:
  - name: first
    start: {pose: {}}
  - name: second
    end: {pose: {pole: pi/3}}
links:
  - from: first
    to: second
    conditions: [{expression: end_T + start_T, range: [1.5, 1.5]}]
"""


@pytest.fixture(scope="module")
def cart() -> Peer:
    return cart_pole()


@pytest.fixture(scope="module")
def whole(cart: Peer) -> Solution:
    found = solve(swing_up(), cart)
    assert isinstance(found, Solution)
    return found


def guess_from(
    problem: PhasedProblem, files: tuple[str | None, ...], times: tuple[tuple[float, float], ...]
) -> PhasedProblem:
    """Name the file and the times of each phase's guess."""
    phases = []
    for phase, file, part in zip(problem.phases, files, times, strict=True):
        guess = replace(phase.problem.guess, solution=file, times=part)
        phases.append(replace(phase, problem=replace(phase.problem, guess=guess)))
    return replace(problem, phases=tuple(phases))


def test_parts_of_a_recording_are_the_parts_of_the_motion(whole: Solution, cart: Peer, tmp_path: Path) -> None:
    """A motion, solved as one phase, recorded and cut in the middle, is the motion cut there, to the error of splines.

    The solve in phases then ends at the cost of the solve of one phase.
    """
    write_table(whole, cart, tmp_path / "whole.csv")
    problem = guess_from(split(swing_up()), ("whole.csv",) * 2, ((0.0, 1.0), (1.0, 2.0)))
    plants = Plants((cart, cart))
    guess = find_phased_guess(problem, plants, tmp_path)
    assert isinstance(guess, Guess)
    for found, expected in zip(guess.trajectories, cut(whole.trajectory), strict=True):
        np.testing.assert_allclose(found.u, expected.u, atol=1e-9)
        np.testing.assert_allclose(found.t, expected.t, atol=1e-12)
        for name, most in (("q", 2e-3), ("point_q", 2e-3), ("qd", 0.03), ("point_qd", 0.03)):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=most, err_msg=name)
    outcome, unguessed = (solve_phases(problem, plants, guess=x) for x in (guess, PartialGuess()))
    assert isinstance(outcome, PhasedSolution)
    assert isinstance(unguessed, PhasedSolution)
    assert outcome.cost == pytest.approx(whole.cost.total, rel=1e-8)
    assert outcome.run.iterations < unguessed.run.iterations


def test_a_phase_without_a_recording_is_guessed_from_the_end_of_the_one_before(
    whole: Solution, cart: Peer, tmp_path: Path
) -> None:
    write_table(whole, cart, tmp_path / "whole.csv")
    problem = guess_from(split(swing_up()), ("whole.csv", None), ((0.0, 1.2), (0.0, 1.0)))
    guess = find_phased_guess(problem, Plants((cart, cart)), tmp_path)
    assert isinstance(guess, PartialGuess)
    ready = prepare_phases(problem, Plants((cart, cart)), guess)
    assert isinstance(ready, Ready)
    first, second = ready.guess.trajectories
    np.testing.assert_allclose(second.q[0], first.q[-1])
    np.testing.assert_allclose(second.q[-1], (1.0, np.pi))


def test_the_command_takes_tables_and_recordings(requires: Callable[[str], str], tmp_path: Path) -> None:
    """Tables that it wrote; a simulated motion, cut; a free horizon is guessed as the duration of its part."""
    requires("cc")
    (tmp_path / "cart_pole.yaml").write_text((MODELS / "cart_pole.yaml").read_text())
    file = tmp_path / "split.ocp.yaml"
    file.write_text(TEXT)
    command = ["solve", str(file), "-o", str(tmp_path / "out")]
    assert "not solved" not in CliRunner().invoke(cli, command).output
    before = read_phased_solution(tmp_path / "out" / "solution.json")
    again = CliRunner().invoke(cli, [*command, "--guess", str(tmp_path / "out")])
    assert "not solved" not in again.output
    after = read_phased_solution(tmp_path / "out" / "solution.json")
    assert after.cost == pytest.approx(before.cost, rel=1e-7)
    assert after.run.iterations < before.run.iterations
    out = str(tmp_path / "fall")
    fall = CliRunner().invoke(
        cli, ["simulate", str(tmp_path / "cart_pole.yaml"), "--pose", "pole=0.1", "--duration", "1.5", "-o", out]
    )
    assert fall.exit_code == 0, fall.output
    (recorded,) = (tmp_path / "fall").glob("*.csv")
    undivided = CliRunner().invoke(cli, [*command, "--guess", str(recorded)])
    assert isinstance(undivided.exception, InputError)
    assert "no guess.times divide it for first, second; give each phase its guess.times" in str(undivided.exception)
    text = TEXT.replace("constants:", f"guess: {{solution: {recorded.relative_to(tmp_path)}}}\nconstants:")
    text = text.replace("{pose: {}}", "{pose: {}}\n    guess: {times: [null, half]}")
    file.write_text(text.replace("pi/3}}", "pi/3}}\n    guess: {times: [half, null]}"))
    assert "not solved" not in CliRunner().invoke(cli, command).output
    missing = CliRunner().invoke(cli, [*command, "--guess", str(tmp_path / "fall")])
    assert isinstance(missing.exception, InputError)
    assert [x.file.rsplit("/", 1)[1] for x in missing.exception.faults] == ["first.csv", "second.csv"]
