"""When a solve goes on, with which tolerance, and what it keeps: each rule at its boundary, without a method."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.problem.problem import SolverOptions
from mbsrun.ocp.solving import phases
from mbsrun.ocp.solving.phases import PhasedSolver, _sharpened


@dataclass(frozen=True)
class Task:
    """A problem of which the solver alone counts."""

    solver: SolverOptions
    weight: float = 1.0


@dataclass(frozen=True)
class Ran:
    """A run."""

    status: str = SOLVED
    decrease: float | None = 2e-4


@dataclass(frozen=True)
class Answer:
    """A solution of which cost and run count."""

    run: Any
    cost: float = 1.0

    def with_solver(self, _: object) -> Answer:
        return self


@dataclass(frozen=True)
class End:
    """An outcome."""

    run: Ran
    x: Any
    start: Any


@dataclass(frozen=True)
class Begin:
    """The start of a run."""

    x: Any = None
    cost_scale: float = 1.0


class Failed:
    """No answer."""


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phases, "join", lambda _, second: second)
    monkeypatch.setattr(phases, "Failure", Failed)


def sharpen(found: Answer, better: Any, again: Ran | None = None, x: float = 0.0, **given: Any) -> Any:
    """Return the answer that is kept, and the tolerance of the second run, if there is one."""
    task = Task(SolverOptions(**given.pop("options", {})), given.pop("weight", 1.0))
    seen: list[float] = []

    def call(problem: Task, _: object) -> End:
        seen.append(problem.solver.tolerance)
        return End(again or Ran(), np.array([x]), None)

    solver = SimpleNamespace(_is_judged=given.pop("judged", True), _call=call, _answer=lambda *_: better)
    solver.needs_sharpening = partial(PhasedSolver.needs_sharpening, cast(Any, solver))
    outcome = End(Ran(), np.zeros(1), Begin(cost_scale=given.pop("cost_scale", 1.0)))
    kept: Any = PhasedSolver._sharpen(cast(Any, solver), cast(Any, task), cast(Any, outcome), cast(Any, found))
    return kept is not found, seen


BETTER = Answer(Ran(decrease=1e-4), 0.9999)


def test_a_solve_goes_on_where_a_sizable_part_of_the_cost_may_fall() -> None:
    """More than 1e-6 of it, or 1e-4 if the tolerance is larger than the default; with 1e-4 of the tolerance."""
    tolerance = SolverOptions().tolerance
    assert sharpen(Answer(Ran()), BETTER) == (True, [pytest.approx(1e-4 * tolerance, rel=1e-12, abs=0)])
    for factor, share in ((1.0, 1e-6), (10.0, 1e-4)):
        own = {"options": {"tolerance": factor * tolerance}}
        assert sharpen(Answer(Ran(decrease=share)), BETTER, **own) == (False, [])
        assert sharpen(Answer(Ran(decrease=1.01 * share)), Answer(Ran(decrease=0.9 * share), 1.0), **own)[0]
    assert sharpen(Answer(Ran(), cost=-1.0), Answer(BETTER.run, -1.0001))[0]
    assert sharpen(Answer(Ran(decrease=2e-6), cost=-3.0), BETTER) == (False, [])
    for none in (None, 0.0):
        assert sharpen(Answer(Ran(decrease=none)), BETTER) == (False, [])
    assert sharpen(Answer(Ran()), BETTER, judged=False) == (False, [])


def test_acceptable_answers_go_on_with_loose_tolerances_alone() -> None:
    usual = SolverOptions().tolerance
    for factor, status, goes_on in ((1.0, ACCEPTABLE, False), (10.0, ACCEPTABLE, True), (1.0, "other", False)):
        found = sharpen(Answer(Ran(status)), BETTER, options={"tolerance": factor * usual})
        assert found[0] is goes_on
    assert sharpen(Answer(Ran()), BETTER, options={"tolerance": 10 * usual})[1] == [
        pytest.approx(1e-3 * usual, rel=1e-12, abs=0)
    ]


def test_a_cost_below_the_tolerance_is_none() -> None:
    """The tolerance is of the cost over its weight, or over the scaling that is given."""
    options = {"tolerance": 1e-2}
    tiny, lower = Answer(Ran(decrease=1e-4), cost=0.05), Answer(Ran(decrease=1e-5), 0.04999)
    assert sharpen(tiny, lower, options=options, weight=5.0) == (False, [])
    assert sharpen(tiny, lower, options=options, weight=4.9)[0]
    assert sharpen(tiny, lower, options=options, weight=4.9, cost_scale=0.5) == (False, [])
    assert sharpen(tiny, lower, options=options, weight=9.0, cost_scale=2.0)[0]
    assert sharpen(tiny, lower, options={**options, "objective_scaling": 0.1}) == (False, [])
    assert sharpen(tiny, lower, options={**options, "objective_scaling": 0.25}, weight=99.0)[0]


def test_another_minimum_is_not_taken() -> None:
    """A cost that rises, falls by more than twice what it could, or may fall as much as before."""
    found = Answer(Ran(decrease=2.0**-12))
    for cost, is_taken in ((1.0, True), (1.0 - 2.0**-11, True), (1.0 - 2.0**-10, False), (1.0 + 2.0**-12, False)):
        assert sharpen(found, Answer(Ran(decrease=2.0**-13), cost))[0] is is_taken
    assert not sharpen(found, Answer(Ran(decrease=2.0**-12), 1.0))[0]
    assert not sharpen(found, Answer(Ran(decrease=None), 1.0))[0]
    assert not sharpen(found, Failed())[0]
    assert not sharpen(found, BETTER, again=Ran(ACCEPTABLE))[0]
    assert not sharpen(found, BETTER, x=np.nan)[0]


def test_a_tolerance_is_sharpened_by_ten_thousand() -> None:
    assert _sharpened(cast(Any, Task(SolverOptions(tolerance=1e-2)))).solver.tolerance == pytest.approx(
        1e-6, rel=1e-12, abs=0
    )


@pytest.mark.parametrize(
    ("residual", "change", "polishes"),
    [(0.9e-13, 0.5, False), (1.1e-13, 0.5, True), (3.9e-13, -4.0, False), (4.1e-13, -4.0, True)],
)
def test_impacts_are_balanced_to_rounding(
    monkeypatch: pytest.MonkeyPatch, residual: float, change: float, polishes: bool
) -> None:
    """1e-13 of the largest change of a velocity, 1 at least, in the equations of links; ranges do not count."""
    monkeypatch.setattr(phases, "polish", lambda x, *_: x + 1)
    monkeypatch.setattr(phases, "Equations", lambda *_: SimpleNamespace(measure=lambda *_: 0.0))
    lower, upper = np.zeros(3), np.array([0.0, 0.0, 9.0])
    links = [SimpleNamespace(impact=None), SimpleNamespace(impact=SimpleNamespace(changes=np.array([1])))]
    own = SimpleNamespace(
        links=links,
        constraint_bounds=lambda _: (lower, upper),
        variable_bounds=lambda _: (lower, lower - 1),
        see_rows=lambda rows: rows,
        see=lambda changes: changes,
        offsets=[SimpleNamespace(rows=1)],
    )
    solver = SimpleNamespace(transcription=own, _evaluate=lambda *_: np.array([7.0, residual, 5.0]))

    @dataclass(frozen=True)
    class Timed:
        seconds: float = 3.0
        cpu_seconds: float = 2.0

    outcome = SimpleNamespace(run=Timed(), x=np.array([99.0, change]), start=SimpleNamespace(parameters=None))
    task = SimpleNamespace(solver=SolverOptions())
    run, x = PhasedSolver._balance_impacts(cast(Any, solver), cast(Any, task), cast(Any, outcome))
    assert bool(x[0] == 100.0) is polishes
    assert (run is outcome.run) is not polishes
    assert 3.0 <= run.seconds < 4.0
    assert 2.0 <= run.cpu_seconds < 3.0
    own.links = links[:1]
    assert PhasedSolver._balance_impacts(cast(Any, solver), cast(Any, task), cast(Any, outcome))[1] is outcome.x
