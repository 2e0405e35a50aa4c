"""Many values of a problem's keys: the numbers of single solves, in any order and in threads; faults by case."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsrun.ocp.cases import cases
from mbsrun.ocp.evaluation.stages import binding
from mbsrun.ocp.solving.phases import PhasedSolver
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.many import NAMED, SolvedMany, change, list_cases
from mbsrun.optimal.phases import PhasedControl, SolvedPhases
from mbsrun.optimal.result import Solved, Unsolved

MODELS = Path(__file__).parents[3] / "models"
KEYS: dict[str, Any] = {
    "horizon": 2,
    "intervals": 12,
    "degree": 3,
    "bounds": {"inputs": [-20, 20]},
    "end": {"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"},
    "constraints": [{"expression": "q_cart", "range": [-1, 3]}],
}
PLACES = [0.8, 1.0, 1.2]


@pytest.fixture(scope="module")
def swing() -> OptimalControl:
    return mbsrun.problem(MODELS / "cart_pole.yaml", **KEYS)


@pytest.fixture(scope="module")
def alone(swing: OptimalControl) -> list[Solved]:
    found = [swing.with_changes(end={"pose": {"cart": x}}).solve() for x in PLACES]
    assert all(isinstance(x, Solved) for x in found)
    return [x for x in found if isinstance(x, Solved)]


@pytest.mark.parametrize("threads", [1, 3])
def test_cases_have_the_numbers_of_single_solves(swing: OptimalControl, alone: list[Solved], threads: int) -> None:
    seen: dict[int, Any] = {}
    found = swing.solve_many({"end.pose.cart": PLACES}, threads=threads, watch=seen.__setitem__)
    assert isinstance(found, SolvedMany)
    assert len(found) == len(PLACES)
    assert found.is_solved.all()
    for k, expected in enumerate(alone):
        one = found[k]
        assert one is seen[k]
        assert isinstance(one, Solved)
        assert np.array_equal(one["q"], expected["q"])
        assert (one.cost, one.defect, one.status) == (expected.cost, expected.defect, expected.status)
    assert found.cost.tolist() == [one.cost for one in alone]
    assert found.iterations.tolist() == [one.solution.run.iterations for one in alone]


def test_neither_order_nor_company_matters(swing: OptimalControl, alone: list[Solved]) -> None:
    found = swing.solve_many([{"end.pose.cart": x} for x in (1.2, 1.1, 0.8)], check=False)
    assert found.cost[[2, 0]].tolist() == [alone[0].cost, alone[2].cost]
    assert [one.defect for one in found] == [None] * 3


def test_one_program_serves_all_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """It serves later calls, too; who solves meanwhile gets another one."""
    made: list[object] = []
    swing = mbsrun.problem(MODELS / "cart_pole.yaml", **KEYS)
    begin = PhasedSolver.__init__

    def count(self: PhasedSolver, *given: Any, **named: Any) -> None:
        made.append(self)
        begin(self, *given, **named)

    monkeypatch.setattr(PhasedSolver, "__init__", count)
    swing.solve_many({"end.pose.cart": [0.9, 1.1], "bounds.inputs": [[-15, 15], [-25, 25]]}, check=False)
    assert len(made) == 1
    swing.solve_many({"end.pose.cart": [0.9]}, check=False)
    assert len(made) == 1
    with swing.programs.lend() as own, swing.programs.lend() as other:
        assert own is swing.programs
        assert other is not own
    with swing.programs.lend() as own:
        assert own is swing.programs


def test_c_calls_no_python_unless_somebody_watches(swing: OptimalControl, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread in C would wait for the others otherwise; a limit of time needs a clock, which is Python's."""

    def refuse(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(binding, "_Observer", refuse)
    assert swing.solve_many({"end.pose.cart": [0.9]}, check=False).is_solved.all()
    timed = swing.with_solver("mbs", options={"max_wall_time": 60.0})
    with pytest.raises(AssertionError):
        timed.solve(check=False)


def test_a_case_without_a_solution_harms_no_other(swing: OptimalControl, alone: list[Solved]) -> None:
    own = {"method": "mbs", "max_iterations": 40}
    found = swing.with_changes(solver=own).solve_many({"horizon": [0.05, 2], "end.pose.cart": [0.8, 1.0]})
    failed = found[0]
    assert isinstance(failed, Unsolved)
    assert failed.status == found.statuses[0] != "Solve_Succeeded"
    assert found.is_solved.tolist() == [False, True]
    assert np.isnan(found.cost[0])
    assert found.cost[1] == alone[1].cost
    assert "1 of 2" in repr(found)
    assert f"{failed.status}: {failed.reason}" in repr(found)
    assert list(found.shortcomings) == [1]  # the grid is coarse


def test_faults_that_only_kernels_find_are_a_failure_of_their_case(
    swing: OptimalControl, alone: list[Solved], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as a start whose loops cannot be closed."""
    whole = cases.solve_phases

    def refuse(problem: Any, *given: Any) -> Any:
        if problem.phases[0].problem.end.coordinates[0][1] == PLACES[0]:
            raise ProblemError("cart_pole", [("start.pose", "it cannot be closed", "start elsewhere")])
        return whole(problem, *given)

    monkeypatch.setattr(cases, "solve_phases", refuse)
    found = swing.solve_many({"end.pose.cart": PLACES[:2]}, check=False)
    failed = found[0]
    assert isinstance(failed, Unsolved)
    assert failed.status == "Bad_Problem"
    assert failed.reason == "it cannot be closed; start elsewhere"
    assert failed.failure.place == "start.pose"
    assert found.cost[1] == alone[1].cost


def test_guesses_belong_to_cases(swing: OptimalControl, alone: list[Solved]) -> None:
    found = swing.solve_many({"end.pose.cart": PLACES[:2]}, guesses=[alone[0], None], check=False)
    assert found.iterations[0] < alone[0].solution.run.iterations
    assert found.iterations[1] == alone[1].solution.run.iterations
    with pytest.raises(ProblemError, match="guesses: there are 1 for 2 cases; give one for each"):
        swing.solve_many({"end.pose.cart": PLACES[:2]}, guesses=[None])


def test_neighbours_lead_to_the_optima_of_single_solves(swing: OptimalControl) -> None:
    """In fewer iterations, except for the one in the middle, which starts from its own guess."""
    places = [0.98, 1.0, 1.02]
    expected = swing.solve_many({"end.pose.cart": places})
    found = swing.solve_many({"end.pose.cart": places}, neighbours=True)
    assert found.is_solved.all()
    assert found.cost == pytest.approx(expected.cost, rel=1e-8)
    assert found[1].cost == expected[1].cost
    assert (found.iterations < expected.iterations).tolist() == [True, False, True]
    for one, other in zip(found, expected, strict=True):
        assert one["q"] == pytest.approx(other["q"], abs=1e-6)
        assert one.defect == pytest.approx(other.defect, rel=1e-3)


@pytest.mark.parametrize("threads", [1, 2])
def test_neighbours_depend_on_the_set_of_cases_alone(swing: OptimalControl, threads: int) -> None:
    """Neither their order nor threads change a bit; a case that is there twice has one cost."""
    places = [0.8, 1.0, 1.2, 0.9, 1.0]
    first = swing.solve_many({"end.pose.cart": places}, check=False, neighbours=True)
    order = [3, 1, 0, 4, 2]
    again = swing.solve_many(
        {"end.pose.cart": [places[k] for k in order]}, check=False, neighbours=True, threads=threads
    )
    assert again.cost == pytest.approx(first.cost[order], rel=1e-9)
    for k in (0, 2, 3):
        assert np.array_equal(again[order.index(k)]["q"], first[k]["q"])
    assert first.cost[1] == pytest.approx(first.cost[4], rel=1e-9)


def test_a_neighbour_without_a_solution_leaves_cases_to_their_guesses(
    swing: OptimalControl, alone: list[Solved]
) -> None:
    """The case in the middle, from which the others would start, permits no motion; a single case has no neighbour."""
    own = swing.with_changes(solver={"method": "mbs", "max_iterations": 40})
    ranges = [[-1, 3], [-1, 0.5], [-1, 3]]
    found = own.solve_many({"end.pose.cart": PLACES, "constraints[0].range": ranges}, check=False, neighbours=True)
    assert found.is_solved.tolist() == [True, False, True]
    assert found.cost[[0, 2]] == pytest.approx([alone[0].cost, alone[2].cost], rel=1e-7)
    single = swing.solve_many({"end.pose.cart": PLACES[:1]}, check=False, neighbours=True)
    assert (single.cost[0], single.iterations[0]) == (alone[0].cost, alone[0].solution.run.iterations)


def test_cases_with_other_programs_are_no_neighbours(swing: OptimalControl, alone: list[Solved]) -> None:
    """Another grid, or another method, has other variables."""
    found = swing.solve_many({"intervals": [12, 13], "end.pose.cart": PLACES[:2]}, check=False, neighbours=True)
    assert found.is_solved.all()
    assert found.cost[0] == alone[0].cost
    other = swing.with_solver("ipopt")
    costs = [other.solve_many({"end.pose.cart": PLACES[:2]}, check=False, neighbours=x).cost for x in (False, True)]
    assert costs[0].tolist() == costs[1].tolist()
    with pytest.raises(ProblemError, match="guesses: cases start from their neighbours"):
        swing.solve_many({"end.pose.cart": PLACES[:1]}, guesses=[None], neighbours=True)


def test_phases_take_values_too() -> None:
    keys = {key: value for key, value in KEYS.items() if key not in ("horizon", "end", "constraints")}
    keys |= {"cost": {"inputs": 1}, "start": {"pose": {}}}
    phases = [{"name": "pump", "horizon": 1}, {"name": "catch", "horizon": 1, "end": KEYS["end"]}]
    links = [{"from": "pump", "to": "catch"}]
    swing: PhasedControl = mbsrun.problem(MODELS / "cart_pole.yaml", phases=phases, links=links, **keys)
    found = swing.solve_many({"phases[1].end.pose.cart": [0.9, 1.1]})
    expected = swing.with_phase("catch", end={"pose": {"cart": 1.1}}).solve()
    assert isinstance(expected, SolvedPhases)
    assert found.cost[1] == expected.cost
    one = found[1]
    assert isinstance(one, SolvedPhases)
    assert one["catch"]["q_cart"][-1] == pytest.approx(1.1)


def test_parameters_of_the_model_may_differ(tmp_path: Path) -> None:
    model = tmp_path / "pendulum.yaml"
    model.write_text(
        "name: pendulum\ngravity: [0, 0, -9.81]\nparameters: {l: {value: 0.5, kind: runtime}}\nbodies:\n"
        "  - {name: rod, joint: {type: revolute, axis: y}, mass: 1, com: [0, 0, -l]}\n"
    )
    swing = mbsrun.problem(model, horizon=1, intervals=6, end={"pose": {"rod": 1}, "velocity": "zero"})
    found = swing.solve_many({"parameters.l": [0.4, 0.5, 0.6]})
    alone = [swing.with_changes(parameters={"l": x}).solve().cost for x in (0.4, 0.5, 0.6)]
    assert found.cost.tolist() == alone
    assert len(set(alone)) == 3


@pytest.mark.parametrize(
    ("over", "told"),
    {
        "no case": ({}, "over: there is no case"),
        "no value": ({"horizon": []}, "over: there is no case"),
        "no mapping": ([], "over: there is no case"),
        "two lengths": ({"horizon": [1], "intervals": [1, 2]}, "horizon 1, intervals 2; give all the same number"),
        "an unknown key": ({"end.pose.cat": [1]}, 'case 0: end.pose.cat: the model has no coordinate "cat"; did you'),
        "no path": ({"end..cart": [1]}, "end..cart: this is no path of keys"),
        "an open bracket": ({"constraints[0.range": [1]}, "this is no path of keys"),
        "an entry that is not there": ({"constraints[1].range": [[0, 1]]}, "found a list of 1 where the path has [1]"),
        "no list": ({"end[0]": [1]}, "found no list where the path has [0]"),
        "keys of a number": ({"horizon.x": [1]}, "found 2 where the path has x"),
        "a bad value": ({"horizon": [2, -1]}, "case 1: horizon: "),
        "no plain value": ({"horizon": [object()]}, "found a value of type object"),
    }.values(),
)
def test_bad_values_get_one_sentence(swing: OptimalControl, over: Any, told: str) -> None:
    with pytest.raises(ProblemError) as error:
        swing.solve_many(over)
    assert told in str(error.value)


def test_many_cases_with_faults_are_counted(swing: OptimalControl) -> None:
    with pytest.raises(ProblemError) as error:
        swing.solve_many({"horizon": [-1.0] * 9})
    assert len(error.value.findings) == NAMED + 1
    assert f"{9 - NAMED} more of 9 have faults" in str(error.value)
    with pytest.raises(ProblemError, match="threads: found 0; give a whole number, 1 or more"):
        swing.solve_many({"horizon": [2]}, threads=0)


def test_paths_reach_into_lists_and_leave_data_alone(swing: OptimalControl) -> None:
    changed = change("x", swing.data, {"constraints[0].range": [0, 1], "start.velocity.cart": 2, "bounds": None})
    assert changed["constraints"] == [{"expression": "q_cart", "range": [0, 1]}]
    assert changed["start"] == {"pose": {}, "velocity": {"cart": 2}}
    assert "bounds" not in changed
    assert swing.data["constraints"] == KEYS["constraints"]
    assert list_cases("x", {"a": [1, 2], "b": [3, 4]}) == ({"a": 1, "b": 3}, {"a": 2, "b": 4})


def test_a_frame_has_a_row_for_each_case(swing: OptimalControl, monkeypatch: pytest.MonkeyPatch) -> None:
    found = swing.solve_many({"end.pose.cart": PLACES}, check=False)

    class Frame(dict[str, Any]):
        def assign(self, **columns: Any) -> Frame:
            return Frame(self | columns)

    def frame(rows: list[dict[str, Any]]) -> Frame:
        return Frame({key: [row[key] for row in rows] for key in rows[0]})

    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=frame))
    table = found.to_frame()
    assert table["end.pose.cart"] == PLACES
    assert table["cost"].tolist() == found.cost.tolist()
    assert list(table["status"]) == ["Solve_Succeeded"] * 3
    assert "<table" in found._repr_html_()
