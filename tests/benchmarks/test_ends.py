"""The comparisons at the limits: the same problems for each number, wrong answers, the pages."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.ocp import ends, quadratics
from benchmarks.ocp.ends import Solve
from mbsrun.external import load_on_demand
from mbsrun.ocp.problem.problem import Problem, find_conflicts
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.statement.statement import read_problem
from studies.laboratory.ends import KINDS, draw
from tests.csrc.stages import Library, compile_solver


def made(number: int, method: str, cost: float, nearby: float | None = None, strict: float | None = None) -> Solve:
    status = "Restoration_Failed" if math.isnan(cost) else "Solve_Succeeded"
    return Solve(number, "stop", method, status, 10, 0.1, cost, nearby, nearby if strict is None else strict)


def read(number: int, folder: Path) -> Problem:
    problem, _ = read_problem(draw(number).write(folder), load_on_demand)
    return problem


def test_a_number_is_one_problem(tmp_path: Path) -> None:
    """The same number is the same file, kinds take turns, and each problem is admitted."""
    kinds = [draw(number).kind for number in range(2 * len(KINDS))]
    assert kinds == [*KINDS, *KINDS]
    for number in range(60):
        assert draw(number) == draw(number)
        assert not find_conflicts(read(number, tmp_path))


def test_forms_and_limits_are_drawn(tmp_path: Path) -> None:
    """All forms and representations occur, and an arm ends at its stop."""
    problems = [read(number, tmp_path) for number in range(100)]
    assert len({problem.form for problem in problems}) == 3
    assert len({problem.representation for problem in problems}) == 6
    stops = [problem for number, problem in enumerate(problems) if draw(number).kind == "stop"]
    assert stops
    for problem in stops:
        assert any(value in problem.bounds.q[i] for i, value in problem.end.coordinates)


def test_an_answer_is_wrong_where_a_lower_cost_is_near() -> None:
    """Costs are one within 1e-6 of them; another minimum is not wrong, and neither is a lower cost of `mbs`."""
    pairs = [
        (made(0, "mbs", 1.0), made(0, "ipopt", 1.0 + 1e-7)),
        (made(1, "mbs", 1.001, 1.0), made(1, "ipopt", 1.0)),
        (made(2, "mbs", 1.001, 1.001), made(2, "ipopt", 1.0)),
        (made(3, "mbs", math.nan), made(3, "ipopt", 1.0)),
        (made(4, "mbs", 1.001, 1.0, strict=1.0005), made(4, "ipopt", 1.0)),
    ]
    summary = ends.summarise(pairs)
    assert (summary.solved, summary.others, summary.iterations) == ((4, 5), 3, (10, 10))
    assert (summary.wrong, summary.loose) == (1, 1)
    page = ends.write_page([solve for both in pairs for solve in both])
    assert "| 1 | stop | wrong, Solve_Succeeded, 10 | 1.001 |" in page
    assert "| 3 | stop | Restoration_Failed, 10 | nan |" in page
    assert "| 4 | stop | undetermined, Solve_Succeeded, 10 | 1.001 |" in page


def test_an_interrupted_run_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Problems that both methods solved are not solved again; a half of one is."""
    kept = [made(0, "mbs", 1.0), made(0, "ipopt", 1.0), made(1, "mbs", 1.0)]
    lines = [json.dumps(asdict(solve)) for solve in kept]
    (tmp_path / "ends.jsonl").write_text("\n".join(lines), "utf-8")
    asked: list[int] = []

    def solve_both(number: int, _: Path) -> tuple[Solve, Solve]:
        asked.append(number)
        return made(number, "mbs", 2.0), made(number, "ipopt", 2.0)

    monkeypatch.setattr(ends, "solve_both", solve_both)
    ends.main(["--problems", "3", "--out", str(tmp_path)])
    assert asked == [1, 2]
    assert [solve.number for solve in ends.read(tmp_path / "ends.jsonl")] == [0, 0, 1, 1, 2, 2]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(compile_solver(tmp_path_factory.mktemp("stages")))


@pytest.mark.parametrize("number", [0, 1, 2, 3, 4, 5, 6, 8])
def test_a_quadratic_program_is_convex_and_both_find_its_cost(number: int, library: Library) -> None:
    """Kinds without dependent rows: no eigenvalue is negative, costs agree to 1e-6, and the gap of duality is small."""
    _, program = quadratics.draw(number)
    assert np.linalg.eigvalsh(program.matrices[0].toarray()).min() >= -1e-12
    result = quadratics.solve(number, library)
    assert result.is_solved
    assert result.is_peer_solved
    assert not result.is_wrong
    assert result.gap <= 1e-6


def test_rows_that_repeat_change_no_cost(library: Library) -> None:
    """Without an interior, rows that give by 1e-8 decide 1.2e-6 of this cost; IPOPT needs none that do."""
    result = quadratics.solve(169, library)
    assert result.is_solved
    assert result.is_peer_solved
    assert result.cost == pytest.approx(result.peer_cost, rel=1e-8)


@pytest.mark.parametrize(("number", "cost"), [(116, 1.75271222), (344, 32.852134), (434, 19.6061574)])
def test_motions_to_a_wall_are_solved(number: int, cost: float, tmp_path: Path) -> None:
    """Costs are IPOPT's, with bounds that give by 1e-8 as here; steps lost their digits near bounds."""
    problem, plant = read_problem(draw(number).write(tmp_path), load_on_demand)
    found = ends.solve(ends.choose(problem, "mbs"), plant)
    assert isinstance(found, Solution)
    assert found.cost.total == pytest.approx(cost, rel=1e-6)


def test_a_quadratic_answer_is_wrong_by_cost_or_by_gap() -> None:
    """Where IPOPT has no answer, the gap of duality and the violation judge."""
    right = quadratics.Result(0, "rails", "solved", 9, 1.0, 0.0, 1e-9, "Solve_Succeeded", 9, 1.0)
    assert not right.is_wrong
    for change in ({"cost": 1.0001}, {"peer_status": "Restoration_Failed", "gap": 1e-3}):
        assert replace(right, **change).is_wrong
    assert not replace(right, status="out of digits", cost=2.0).is_wrong
    assert "| rails | 1 | 1, 1 | 0 | 9, 9 | 1.00 | 1e-09 |" in quadratics.write_page([right])
