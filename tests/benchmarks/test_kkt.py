"""The benchmark of the linear solver: its transcriptions have the published optima, by either solver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.kkt.__main__ import Figures, main, write_figures
from benchmarks.kkt.problems import PROBLEMS
from benchmarks.kkt.solving import Case, Row, measure
from benchmarks.kkt.transcription import SCHEMES, Problem, admits, make_mesh
from mbsrun.ocp.ground.linear import OWN

BY_NAME = {problem.name: problem for problem in PROBLEMS}


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize("name", ["van der Pol", "gas oil"])
def test_both_solvers_find_the_published_optimum(name: str, scheme: object) -> None:
    """On a coarse mesh, with bounds on states, or with measurements and parameters of the whole trajectory."""
    problem = BY_NAME[name]
    case = measure(problem, next(s for s in SCHEMES if s is scheme), rounds=1, intervals=30)
    assert case.is_comparable
    assert not case.is_lost
    assert case.own.iterations == case.peer.iterations
    assert case.own.cost == pytest.approx(problem.optimum, rel=0.2 if case.own.scheme == "trapezoid" else 0.02)


def test_there_are_twenty_problems_and_more() -> None:
    assert len(BY_NAME) == len(PROBLEMS) >= 20
    assert sum(problem.optimum is not None for problem in PROBLEMS) >= 20


def test_measurements_are_at_mesh_points() -> None:
    problem = BY_NAME["methanol"]
    assert problem.measured is not None
    mesh = make_mesh(problem, 50) * problem.measured.times[-1]
    assert all(abs(mesh - t).min() < 1e-12 for t in problem.measured.times)
    assert (mesh[1:] > mesh[:-1]).all()


def test_algebraic_equations_need_inputs() -> None:
    """Two equations at each of four points leave no freedom for three constant inputs."""
    rod = BY_NAME["heated rod"]
    assert [scheme.name for scheme in SCHEMES if not admits(rod, scheme)] == ["Legendre 4, constant u"]


def make_case(costs: tuple[float, float, float], statuses: tuple[str, str, str]) -> Case:
    rows = [
        Row("a", "Radau 3", 10, 5, OWN, status, 7, cost, 1, 0.2, 0.2, 0.1 * (k + 1), 0.1)
        for k, (cost, status) in enumerate(zip(costs, statuses, strict=True))
    ]
    return Case(tuple(rows), 1.0, 1e-3)


FINE, BAD = "Solve_Succeeded", "Restoration_Failed"


@pytest.mark.parametrize(
    ("costs", "statuses", "is_lost"),
    [
        ((1.0, 1.0, 1.0), (FINE, FINE, FINE), False),
        ((1.0, 1.0, 1.0), (BAD, FINE, FINE), True),
        ((1.0, 1.0, 1.0), (BAD, BAD, BAD), False),
        ((1.1, 1.0, 1.0), (FINE, FINE, FINE), True),
        ((1.1, 1.0, 2.0), (FINE, FINE, FINE), False),
        ((0.9, 1.0, 1.0), (FINE, FINE, FINE), False),
        ((1.1, 1.0, 1.2), (FINE, FINE, BAD), True),
    ],
)
def test_what_is_lost(costs: tuple[float, float, float], statuses: tuple[str, str, str], *, is_lost: bool) -> None:
    """Lost is what both settings of MUMPS do better."""
    assert make_case(costs, statuses).is_lost is is_lost


def test_the_page_names_what_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem: Problem = replace(BY_NAME["van der Pol"], name="a")
    monkeypatch.setattr("benchmarks.kkt.__main__.PROBLEMS", (problem,))
    case = make_case((1.0, 1.0, 1.0), (BAD, FINE, FINE))
    write_figures(Figures("a machine", 0.5, (case,)), tmp_path)
    page = (tmp_path / "kkt.md").read_text("utf-8")
    assert "Lost: a, Radau 3." in page
    assert "**lost**" in page


def test_an_unknown_problem_is_refused() -> None:
    with pytest.raises(SystemExit):
        main(["--problem", "nothing"])
