"""Cases that are stated late: where their numbers are placed, the bits of stated ones, and their faults."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsrun.ocp.cases.cases import Case, CaseSolver, LateCase
from mbsrun.ocp.cases.placing import choose_stated, find_placing, find_special
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.nearby import Late
from mbsrun.ocp.solving.phases import Neighbour
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.many import Deferred, Family

MODELS = Path(__file__).parents[3] / "models"
KEYS: dict[str, Any] = {
    "horizon": 2,
    "intervals": 12,
    "degree": 3,
    "constants": {"most": 25.0},
    "bounds": {"inputs": [-25, 25]},
    "end": {"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"},
    "constraints": [{"expression": "q_cart - most", "range": [-30, 0]}],
}
PLACES = np.linspace(0.8, 1.2, 40).tolist()


@pytest.fixture(scope="module")
def swing() -> OptimalControl:
    return mbsrun.problem(MODELS / "cart_pole.yaml", **KEYS)


def list_late(own: OptimalControl, cases: list[dict[str, Any]]) -> list[int]:
    found = own.family.list_near_cases(cases, check=False)
    return [k for k, case in enumerate(found) if isinstance(case, LateCase)]


def test_late_cases_end_in_the_bits_of_stated_ones(swing: OptimalControl, monkeypatch: pytest.MonkeyPatch) -> None:
    """Costs, iterations and motions are the same, and so is the problem that somebody looks at."""
    over = {"end.pose.cart": PLACES}
    late = list_late(swing, [{"end.pose.cart": x} for x in PLACES])
    assert len(late) > 30
    found = swing.solve_many(over, check=False, neighbours=True)
    monkeypatch.setattr(Family, "list_near_cases", lambda own, cases, check: own.list_cases(cases, check=check))
    stated = swing.solve_many(over, check=False, neighbours=True)
    assert found.is_solved.all()
    assert np.array_equal(found.cost, stated.cost)
    assert np.array_equal(found.iterations, stated.iterations)
    held = [k for k in late if isinstance(found.kept[k], Deferred)]
    assert len(held) > 20
    for k in held[:3]:
        assert isinstance(found.kept[k].late, Late)
        assert found[k].solution.problem == swing.with_changes(end={"pose": {"cart": PLACES[k]}}).value
        assert np.array_equal(found[k]["q"], stated[k]["q"])


def test_stated_are_the_ends_of_each_range_and_some_between() -> None:
    numbers = np.stack((np.arange(40.0), -np.abs(np.arange(40.0) - 11)), axis=1)
    assert choose_stated(numbers) == [0, 8, 11, 24, 39]
    assert find_special(np.array([[1.0, 2.0], [0.0, 1.0], [3.0, -7.0]]), frozenset([-7.0])) == [1, 2]


def test_a_fault_at_an_end_of_a_range_is_the_one_of_all_statements(swing: OptimalControl) -> None:
    """The text is the one of cases that are all stated."""
    wrong = [*PLACES[:30], "far", 1e400]
    for values in ([*PLACES[:30], float("nan")], wrong):
        cases = [{"end.pose.cart": x} for x in values]
        with pytest.raises(ProblemError) as late:
            swing.family.list_near_cases(cases, check=False)
        with pytest.raises(ProblemError) as all_stated:
            swing.family.list_cases(cases, check=False)
        assert str(late.value) == str(all_stated.value)


@pytest.mark.parametrize("key", ["bounds.inputs[1]", "horizon", "cost.inputs"])
def test_cases_of_other_keys_are_stated(swing: OptimalControl, key: str) -> None:
    assert not list_late(swing, [{key: 25 + x} for x in PLACES])


def test_few_cases_and_special_numbers_are_stated(swing: OptimalControl) -> None:
    assert not list_late(swing, [{"end.pose.cart": x} for x in PLACES[:3]])
    shifted = [{"end.pose.cart": x - PLACES[17]} for x in PLACES]
    assert 17 not in list_late(swing, shifted)
    assert len(list_late(swing, shifted)) > 30


def find_places(own: OptimalControl, key: str, values: list[float]) -> Any:
    family, solver, kept = own.family, CaseSolver(Plants((own.plant,))), list[Neighbour]()
    cases = family.list_cases([{key: x} for x in values], check=False)
    solver.solve(cases[0], kept.append)
    numbers = np.array(values)[:, None]
    return find_placing([x.problem for x in cases], numbers, kept[-1], solver.plants, solver.programs.find)


def test_numbers_are_placed_where_programs_have_them_as_they_are(swing: OptimalControl) -> None:
    """A constant is a parameter; a bound that is its square is none of its places."""
    values = [20.0, 23.0, 25.0]
    placing = find_places(swing, "constants.most", values)
    assert [entries.size for entries, _ in placing.places] == [1, 0, 0, 0, 0]
    curved = swing.with_changes(bounds={"inputs": [-625, "most**2"]})
    assert find_places(curved, "constants.most", values) is None


def test_cases_whose_numbers_have_no_places_are_stated_late(swing: OptimalControl) -> None:
    """Their optima are the ones of single solves."""
    curved = swing.with_changes(bounds={"inputs": [-625, "most**2"]})
    values = np.linspace(4.0, 5.0, 20).tolist()
    assert list_late(curved, [{"constants.most": x} for x in values])
    found = curved.solve_many({"constants.most": values}, check=False, neighbours=True)
    assert found.is_solved.all()
    for k in (3, 12):
        alone = curved.with_constants(most=values[k]).solve(check=False)
        assert found.cost[k] == pytest.approx(alone.cost, rel=1e-7)


def test_a_late_case_that_turns_out_to_be_wrong_fails_alone(swing: OptimalControl) -> None:
    """Its failure has the finding of its statement."""
    cases = swing.family.list_near_cases([{"end.pose.cart": x} for x in PLACES], check=False)
    late = next(case for case in cases if isinstance(case, LateCase))

    def refuse() -> Case:
        raise ProblemError("swing", [("end", "too far", "come nearer")])

    solver, wrong = CaseSolver(Plants((swing.plant,))), LateCase(late.form, late.numbers, refuse, is_checked=False)
    found = solver.solve(wrong)
    assert isinstance(found, Failure)
    assert (found.finding, found.remedy, found.place) == ("too far", "come nearer", "end")
    assert isinstance(solver.solve(late), PhasedSolution)
