"""Many problems of one kind at once: the numbers of single points and single solves, by the functions of one."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsrun.ocp.cases.cases import CaseSolver
from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.evaluation.backends.stacked import StackedProgram, Values
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving import judging, nearby
from mbsrun.ocp.solving.nearby import Late, NearAnswer, NearStart, solve_all_near
from mbsrun.ocp.solving.optimality import bound, judge, linearise
from mbsrun.ocp.solving.phases import Neighbour, PhasedSolver, prepare_near, prepare_phases
from mbsrun.ocp.solving.stacked import Limits, StackedJudge
from mbsrun.optimal.control import OptimalControl

MODELS = Path(__file__).parents[3] / "models"
SWING: dict[str, Any] = {
    "horizon": 2,
    "intervals": 10,
    "degree": 3,
    "bounds": {"inputs": [-20, 20]},
    "end": {"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"},
    "constraints": [{"expression": "q_cart", "range": [-1, 3]}, {"expression": "q_cart + q_pole", "range": [-9, 9]}],
}
KINDS: dict[str, dict[str, Any]] = {
    "given time": {},
    "free time": {
        "horizon": {"range": [1, 3], "guess": 2},
        "cost": {"terminal": [{"expression": "T", "weight": 1}], "inputs": 0.01},
    },
    "expressions": {
        "constants": {"k": 0.3},
        "cost": {"running": [{"expression": "k*q_pole**2*u_cart**2 + u_cart**2", "weight": 0.5}], "inputs": 0.1},
        "bounds": {"inputs": [-30, 30], "coordinates": {"cart": [-2, 2.5]}},
    },
    "integral form": {"form": "integral"},
}
PLACES = [0.8, 0.9, 0.95, 1.0, 1.05, 1.2]


def state(kind: str, places: list[float], **changes: Any) -> tuple[OptimalControl, list[PhasedProblem]]:
    problem = mbsrun.problem(MODELS / "cart_pole.yaml", **{**SWING, **KINDS[kind], **changes})
    assert isinstance(problem, OptimalControl)
    values = [{"end.pose.cart": x} for x in places]
    return problem, [case.problem for case in problem.family.list_cases(values, check=False)]


def number(kind: str) -> tuple[PhasedSolver, list[PhasedProblem], list[Instance]]:
    """Return a solver, and the numbers of some problems at their guesses."""
    problem, stated = state(kind, PLACES)
    solver, found = PhasedSolver(stated[0], problem.family.plants), []
    for own in stated:
        ready = prepare_phases(own, problem.family.plants, None, lambda *_: solver)
        assert not isinstance(ready, Failure)
        found.append(solver.number(ready.problem, solver.complete(ready.problem, ready.guess)))
    return solver, stated, found


@pytest.mark.parametrize("kind", KINDS)
def test_functions_at_many_points_are_the_ones_at_single_points(kind: str) -> None:
    """To rounding, in the order of the Jacobian's pattern."""
    solver, _, given = number(kind)
    rng, single = np.random.default_rng(0), solver.program.numpy
    if not isinstance(single, NumpyProgram):
        pytest.skip("its variables are condensed")
    x = np.array([own.x + 0.1 * rng.standard_normal(own.x.size) for own in given])
    p = np.array([own.parameters * (1 + 0.1 * k) for k, own in enumerate(given)])
    stacked = StackedProgram(solver.program, len(x))
    found = stacked.evaluate(x, p)
    for k in range(len(x)):
        J = single.jacobian(x[k], p[k])
        assert (J.indices.tolist(), J.indptr.tolist()) == (
            stacked.pattern.indices.tolist(),
            stacked.pattern.indptr.tolist(),
        )
        for one, other in (
            (found.slopes[k], J.data),
            (found.rows[k], single.constraint(x[k], p[k])),
            (found.gradient[k], single.gradient(x[k], p[k])),
            (found.terms[k], single.terms(x[k], p[k])),
        ):
            assert one == pytest.approx(other, rel=1e-12, abs=1e-12 * max(1.0, float(np.abs(other).max(initial=0.0))))


def list_points(solver: PhasedSolver, given: list[Instance]) -> Iterator[tuple[Instance, Any, Any]]:
    """Yield solved points with their multipliers, spoiled ones, and ones with scales."""
    rng = np.random.default_rng(1)
    for k, own in enumerate(given):
        found = solver.run(solver.problem, own)
        assert found.multipliers is not None
        yield own, found.x, found.multipliers
        yield own, found.x + 10.0 ** -(k + 2) * rng.standard_normal(own.x.size), found.multipliers
        yield own, found.x, found.multipliers * (1 + 10.0 ** -(k + 2))
        yield replace(own, scales=rng.uniform(0.1, 10, own.x.size)), found.x, found.multipliers


@pytest.mark.parametrize("kind", KINDS)
def test_verdicts_are_the_ones_of_the_judge_of_single_points(kind: str) -> None:
    """Where the multipliers prove enough; all others are left to that judge, whose verdict may be any."""
    solver, _, given = number(kind)
    if not isinstance(solver.program.numpy, NumpyProgram):
        pytest.skip("its variables are condensed")
    points = list(list_points(solver, given))
    x, lam = (np.array([point[i] for point in points]) for i in (1, 2))
    owns = [point[0] for point in points]
    values = StackedProgram(solver.program, len(x)).evaluate(x, np.array([own.parameters for own in owns]))
    pattern = solver.program.numpy.jacobian(x[0], owns[0].parameters)
    scales = np.array([np.ones(own.x.size) if own.scales is None else own.scales for own in owns])
    names = "lower", "upper", "g_lower", "g_upper"
    sides = [np.array([getattr(own, name) for own in owns]) for name in names]
    limits = Limits(sides[0], sides[1], sides[2], sides[3], scales)
    weights = np.linspace(0.5, 2, len(x))
    found = StackedJudge(pattern).judge(x, values, limits, lam, 1e-8, weights)
    decided = 0
    for k, own in enumerate(owns):
        J = Matrix((values.slopes[k], pattern.indices, pattern.indptr), shape=pattern.shape)
        bounds, ranges = (own.lower, own.upper), (own.g_lower, own.g_upper)
        point = linearise(x[k], values.rows[k], values.gradient[k], J, bounds, ranges, scales[k])
        expected, one = judge(point, 1e-8, float(weights[k]), lam[k]), found[k]
        if one is None:
            assert bound_by(point, lam[k]) > expected.allowed
            continue
        decided += 1
        assert (one.is_optimal, one.is_feasible, one.is_sure) == (True, expected.is_feasible, True)
        for name in ("decrease", "allowed", "reach", "violation"):
            assert getattr(one, name) == pytest.approx(getattr(expected, name), rel=1e-9, abs=1e-14), name
    assert len(given) <= decided < len(x)


def bound_by(point: Any, lam: Any) -> float:
    return bound(point, np.inf, lam)[0]


def test_numbers_that_are_none_are_left_to_the_judge_of_single_points() -> None:
    pattern = Matrix(np.ones((1, 2)))
    values = Values(np.zeros((2, 1)), np.zeros((2, 2)), np.array([[0.0], [np.nan]]), np.ones((2, 2)))
    ones = np.ones((2, 2))
    limits = Limits(-ones, ones, np.zeros((2, 1)), np.zeros((2, 1)), ones)
    found = StackedJudge(pattern).judge(np.zeros((2, 2)), values, limits, np.zeros((2, 1)), 1e-8, np.ones(2))
    assert [one is None for one in found] == [False, True]


@pytest.fixture(scope="module")
def near() -> tuple[PhasedSolver, list[NearStart]]:
    """Return problems that start from the solution of one of them, by their own and by others' scaling."""
    problem, stated = state("expressions", PLACES)
    solver, kept = CaseSolver(problem.family.plants), list[Neighbour]()
    case, *_ = problem.family.list_cases([{}], check=False)
    assert isinstance(solver.solve(case, kept.append), PhasedSolution)
    ready = [prepare_near(own, problem.family.plants, kept[0], solver.programs.find) for own in stated]
    starts = [NearStart(one.problem, kept[0], 40) for one in ready if not isinstance(one, Failure)]
    starts[1] = replace(starts[1], own=replace(kept[0], cost_scale=0.1 * kept[0].cost_scale))
    starts[2] = replace(starts[2], most_iterations=1)
    return solver.programs.find(stated[0], problem.family.plants), starts


def read(answer: NearAnswer | None) -> PhasedSolution | None:
    if answer is None:
        return None
    return answer.found.solution if isinstance(answer.found, Late) else answer.found


@pytest.mark.parametrize("threads", [1, 3])
def test_solves_at_once_have_the_bits_of_single_ones(near: tuple[PhasedSolver, list[NearStart]], threads: int) -> None:
    """Motions, multipliers and statuses; and each solution is a start as good as the one of a single solve."""
    solver, starts = near
    found = solve_all_near(solver, starts, threads)
    for start, answer in zip(starts, found, strict=True):
        kept: list[Neighbour] = []
        expected, own = solver.solve_near(start.problem, start.own, start.most_iterations, kept.append), read(answer)
        assert (own is None) == (expected is None) == (start.most_iterations == 1)
        if own is None or expected is None or answer is None:
            continue
        assert isinstance(answer.found, Late)
        assert np.array_equal(own.phases[0].trajectory.q, expected.phases[0].trajectory.q)
        assert np.array_equal(own.phases[0].trajectory.u, expected.phases[0].trajectory.u)
        assert (own.run.status, own.run.iterations, own.run.method) == (
            "Solve_Succeeded",
            expected.run.iterations,
            "mbs",
        )
        assert answer.found.cost == pytest.approx(expected.cost, rel=1e-12)
        assert own.cost == pytest.approx(expected.cost, rel=1e-14)
        assert own.run.decrease == pytest.approx(expected.run.decrease, rel=1e-6)
        assert own.run.reach == pytest.approx(expected.run.reach, rel=1e-9)
        assert answer.neighbour is not None
        for one, other in zip(answer.neighbour.near.point.parts, kept[0].near.point.parts, strict=True):
            assert np.array_equal(one, other)


def test_what_multipliers_do_not_prove_is_judged_alone(
    near: tuple[PhasedSolver, list[NearStart]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer that no judge confirms is no solution, in company as alone."""
    solver, starts = near
    monkeypatch.setattr(StackedJudge, "judge", lambda _, x, *__: [None] * len(x))
    found = solve_all_near(solver, starts)
    assert [isinstance(one.found, PhasedSolution) if one else None for one in found] == [
        True,
        True,
        None,
        True,
        True,
        True,
    ]
    monkeypatch.setattr(judging, "judge", lambda point, *_: spoil(point))
    assert solve_all_near(solver, starts) == [None] * len(starts)


def spoil(point: Any) -> Any:
    return replace(judge(point, 1e-8, 1.0), decrease=1e3, is_sure=True)


def test_cases_that_bound_other_numbers_are_divided() -> None:
    """Open limits and equal ones are other kinds of cases, with other tables or solvers."""
    problem, _ = state("given time", PLACES)
    ranges: list[Any] = [[-1, 3], [-1, None], [-1, 3], [None, 3], [-1, 3]]
    over: dict[str, Any] = {"end.pose.cart": PLACES[:5], "constraints[0].range": ranges}
    found = problem.solve_many(over, check=False, neighbours=True)
    assert found.is_solved.all()
    expected = problem.solve_many(over, check=False)
    assert found.cost == pytest.approx(expected.cost, rel=1e-7)
    assert found.statuses == expected.statuses


def test_starts_of_another_layout_are_no_starts(near: tuple[PhasedSolver, list[NearStart]]) -> None:
    """The others of the stack are solved nevertheless."""
    solver, starts = near
    other = replace(starts[0].own.near, layout=b"other")
    mixed = [replace(starts[0], own=replace(starts[0].own, near=other)), starts[3]]
    assert [one is None for one in solve_all_near(solver, mixed)] == [True, False]


def test_motions_are_read_when_somebody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Costs, statuses and iterations need none; each is read once."""
    problem, _ = state("given time", PLACES)
    read_at: list[object] = []
    begin = PhasedSolver.read

    def count(self: PhasedSolver, *given: Any) -> PhasedSolution:
        read_at.append(given)
        return begin(self, *given)

    monkeypatch.setattr(PhasedSolver, "read", count)
    found = problem.solve_many({"end.pose.cart": PLACES}, check=False, neighbours=True)
    assert found.is_solved.all()
    assert np.isfinite(found.cost).all()
    assert (found.cpu_seconds > 0).all()
    assert (found.iterations.size, len(found.statuses), len(found), read_at) == (6, 6, 6, [])
    assert found[2] is found[2]
    assert found[2].cost == pytest.approx(found.cost[2], rel=1e-14)
    assert len(read_at) <= 1
    assert [one.cost for one in found] == pytest.approx(found.cost.tolist(), rel=1e-14)
    assert len(found[1:3]) == 2


def test_a_small_room_changes_nothing(
    near: tuple[PhasedSolver, list[NearStart]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points are evaluated in parts."""
    solver, starts = near
    whole = solve_all_near(solver, starts)
    monkeypatch.setattr(nearby, "ROOM", 1)
    parts = solve_all_near(solver, starts)
    for one, other in zip(whole, parts, strict=True):
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert isinstance(one.found, Late)
            assert isinstance(other.found, Late)
            assert np.array_equal(one.found.x, other.found.x)
            assert one.found.cost == pytest.approx(other.found.cost, rel=1e-13)


def test_the_c_of_stacks_has_no_warnings(tmp_path: Path) -> None:
    """Of strict C99, as all of the solver's."""
    folder = Path(__file__).parents[3] / "csrc"
    include = [f"-I{folder / name}" for name in ("stages", "program", "timing")]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-c"]
    given = ["cc", *flags, *include, str(folder / "cases" / "mbs_cases.c"), "-o", str(tmp_path / "cases.o")]
    found = subprocess.run(given, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
