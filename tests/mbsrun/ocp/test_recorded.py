"""Guesses from recorded motions: what `mbsrun solve` writes is read back, on another grid too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.guessing.guess import adapt, find_inputs
from mbsrun.ocp.guessing.recorded import find_guess
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import FREE_RANGE, cart_pole
from tests.mbsrun.peer import Peer


@pytest.fixture(scope="module")
def plant() -> Peer:
    return cart_pole()


@pytest.fixture(scope="module")
def swing() -> Problem:
    return Problem(
        name="swing",
        horizon=2.0,
        intervals=25,
        family=Family.RADAU,
        degree=3,
        cost=Cost(1.0, 0.1),
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds((FREE_RANGE,) * 2, (FREE_RANGE,) * 2, ((-20.0, 20.0),)),
        end=End(coordinates=((0, 1.0), (1, np.pi)), velocity_zero=True),
    )


@pytest.fixture(scope="module")
def solved(swing: Problem, plant: Peer) -> Solution:
    found = solve(swing, plant)
    assert isinstance(found, Solution)
    return found


def test_a_table_is_a_guess_as_the_solution_is(swing: Problem, plant: Peer, solved: Solution, tmp_path: Path) -> None:
    """On the problem's grid, and with another horizon and grid: splines round off the jumps of accelerations."""
    write_table(solved, plant, tmp_path / "solution.csv")
    for problem in (swing, replace(swing, horizon=1.5, intervals=30, degree=4)):
        guess = find_guess(tmp_path / "solution.csv", problem, plant)
        expected = adapt(solved.trajectory, problem, schemes.build(problem.family, problem.degree))
        np.testing.assert_allclose(guess.u, expected.u, atol=1e-9)
        for name, most in (("q", 2e-3), ("point_q", 2e-3), ("qd", 0.03), ("point_qd", 0.03)):
            np.testing.assert_allclose(getattr(guess, name), getattr(expected, name), atol=most, err_msg=name)
    again = solve(swing, plant, guess=find_guess(tmp_path / "solution.csv", swing, plant))
    assert isinstance(again, Solution)
    assert again.run.iterations < solved.run.iterations
    assert again.cost.total == pytest.approx(solved.cost.total, rel=1e-6)


def test_coordinates_alone_are_enough(swing: Problem, plant: Peer, tmp_path: Path) -> None:
    """The rest are derivatives of splines, and the inverse dynamics."""
    t = np.linspace(3, 5, 201)
    rows = np.stack((t, np.sin(t), np.degrees(np.cos(2 * t))), axis=1)
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "a.csv").write_text(f"time,cart,q[pole] [deg]\n{text}\n", "utf-8")
    guess = find_guess(tmp_path / "a.csv", swing, plant)
    s = guess.point_t + 3
    np.testing.assert_allclose(guess.point_q, np.stack((np.sin(s), np.cos(2 * s)), axis=-1), atol=1e-6)
    np.testing.assert_allclose(guess.point_qd, np.stack((np.cos(s), -2 * np.sin(2 * s)), axis=-1), atol=1e-3)
    q, qd, qdd = (x.reshape(-1, 2) for x in (guess.point_q, guess.point_qd, guess.point_qdd))
    expected = find_inputs(plant, q, qd, qdd).reshape(25, 3).mean(axis=1)
    np.testing.assert_allclose(guess.u[:, 0], np.clip(expected, -20, 20), atol=1e-9)


def test_every_missing_coordinate_is_named(swing: Problem, plant: Peer, tmp_path: Path) -> None:
    for text, words in (
        ("t,u[cart]\n0,1\n1,2\n", ['"q[cart]"', '"q[pole]"', "every coordinate"]),
        ("t,cart,pole\n0,1,\n1,1,2\n2,1,3\n", ['column "pole": it is empty at an end']),
        ("t,cart [N],pole\n0,1,1\n1,1,2\n", ['it is in "N"']),
    ):
        (tmp_path / "a.csv").write_text(text, "utf-8")
        with pytest.raises(InputError) as caught:
            find_guess(tmp_path / "a.csv", swing, plant)
        assert [word for word in words if word not in str(caught.value)] == []
