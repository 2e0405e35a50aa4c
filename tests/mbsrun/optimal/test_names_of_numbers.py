"""Numbers of a problem by name, plain data, and scenarios that share first inputs; each by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.problem import Bounds, Control, Cost, Delay, End, Force, Problem
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.naming import Source, WrongPlaceError, _is_range, _look, _read_place, _write, list_left_out, put_at
from mbsrun.optimal.plain import make_plain, merge
from mbsrun.optimal.scenarios import FIRST, _list_first, state_scenarios
from tests.mbsrun.ocp.plants import FREE_RANGE, cart_pole, push

INF = math.inf
DATA: dict[str, Any] = {
    "horizon": {"range": [0.5, "2*k"], "guess": 1},
    "constants": {"k": 1.5, "far.away": 4, "text": "k + 1"},
    "cost": {"inputs": 2, "running": [{"expression": "q", "weight": 3}, {"expression": "1", "weight": True}]},
    "bounds": {"q": {"knee": [-1, 1]}, "inputs": [-5, 5]},
    "start": {"pose": {"hip": 0.25}},
    "constraints": [{"expression": "q", "range": [0, None]}],
    "solver": {"tolerance": 1e-6},
    "intervals": 10,
}
LEFT_OUT = {"start.pose.hip": 0.25, "start.pose.knee": 0.0, "parameters.mass": 7.0}


def make(data: Any = None, **left_out: float) -> Source:
    state: Any = lambda changed: ("stated", changed)  # noqa: E731
    return Source("task", data or DATA, left_out or LEFT_OUT, state)


# --- places ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("constants.k", ("constants", "k")),
        ("constants.far.away", ("constants", "far.away")),
        ("cost.running[1].weight", ("cost", "running", 1, "weight")),
        ("horizon.range.lower", ("horizon", "range", 0)),
        ("horizon.range.upper", ("horizon", "range", 1)),
        ("bounds.q.knee.upper", ("bounds", "q", "knee", 1)),
        ("bounds.inputs[0]", ("bounds", "inputs", 0)),
        ("nothing.at.all", ("nothing", "at", "all")),
    ],
)
def test_names_are_read_as_places_by_the_longest_key_that_fits(name: str, place: Any) -> None:
    assert _read_place(name, DATA) == place


def test_ends_of_ranges_are_named_lower_and_upper() -> None:
    for place, name in (
        (("horizon", "range", 0), "horizon.range.lower"),
        (("bounds", "q", "knee", 1), "bounds.q.knee.upper"),
        (("bounds", "inputs", 0), "bounds.inputs.lower"),
        (("constraints", 0, "range", 0), "constraints[0].range.lower"),
        (("cost", "running", 0, "weight"), "cost.running[0].weight"),
        (("cost", "running", 0), "cost.running[0]"),
        (("constants", "k"), "constants.k"),
    ):
        assert _write(place, DATA) == name
        assert _is_range(DATA, place) == name.endswith(("lower", "upper"))
    assert not _is_range(DATA, ())
    three = {"bounds": {"a": [1, 2, 3]}, "plain": [1, 2]}
    assert not _is_range(three, ("bounds", "a", 0))
    assert not _is_range(three, ("plain", 0))


def test_data_are_looked_up_and_changed_without_touching_the_old_ones() -> None:
    assert _look(DATA, ("bounds", "q", "knee", 1)) == 1
    for place in (
        ("bounds", "x"),
        ("horizon", "range", 2),
        ("horizon", 0),
        ("constants", "k", "x"),
        ("cost", "running", "a"),
    ):
        assert _look(DATA, place) is None
    old = {"a": [1, {"b": 2}], "c": 3}
    assert put_at(old, ("a", 1, "b"), 9) == {"a": [1, {"b": 9}], "c": 3}
    assert put_at(old, ("d", "e"), 9) == {"a": [1, {"b": 2}], "c": 3, "d": {"e": 9}}
    assert put_at(old, (), 9) == 9
    assert old == {"a": [1, {"b": 2}], "c": 3}
    for place in (("a", 2), ("c", 0), ("c", "x")):
        with pytest.raises(WrongPlaceError):
            put_at(old, place, 9)


# --- numbers --------------------------------------------------------------------------------------------------------


def test_numbers_have_their_values_and_state_the_problem_anew() -> None:
    """Texts of constants are numbers too; numbers that the data leave out can be set."""
    own = make()
    for name, value in (
        ("constants.k", 1.5), ("constants.text", 2.5), ("horizon.range.upper", 3.0), ("horizon.range.lower", 0.5),
        ("cost.inputs", 2.0), ("bounds.q.knee.lower", -1.0), ("start.pose.hip", 0.25), ("start.pose.knee", 0.0),
        ("parameters.mass", 7.0), ("constants.far.away", 4.0),
    ):  # fmt: skip
        assert own.find(name).value == pytest.approx(value), name
    _, changed = own.find("start.pose.knee").state(2.0)  # type: ignore[misc]
    assert changed["start"] == {"pose": {"hip": 0.25, "knee": 2.0}}
    _, changed = own.find("parameters.mass").state(8.0)  # type: ignore[misc]
    assert changed["parameters"] == {"mass": 8.0}
    both = own.put({"constants.k": 5, "bounds.q.knee.upper": 6})
    assert both["constants"] == {**DATA["constants"], "k": 5.0}
    assert both["bounds"]["q"] == {"knee": [-1, 6.0]}  # type: ignore[index,call-overload]
    assert DATA["constants"]["k"] == 1.5


def test_all_numbers_that_matter_to_an_optimum_are_listed_once() -> None:
    names = make().list_names()
    assert len(names) == len(set(names))
    assert {"constants.k", "horizon.range.lower", "cost.running[0].weight", "constraints[0].range.lower"} <= set(names)
    assert {"start.pose.hip", "start.pose.knee", "parameters.mass"} <= set(names)
    assert not [name for name in names if name.startswith(("solver", "intervals"))]
    assert not {"horizon.guess", "cost.running[1].weight", "constraints[0].range.upper"} & set(names)


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("constants.q", "it is no number of the problem"),
        ("constants", "which is no number"),
        ("cost.running[0].expression", "found 'q', which is no number"),
        ("solver.tolerance", "found 1e-06, which is no number"),
        ("cost.running[1].weight", "found True, which is no number"),
        ("constraints[0].range.upper", "it is no number of the problem"),
    ],
)
def test_what_is_no_number_is_refused(name: str, finding: str) -> None:
    with pytest.raises(ProblemError) as error:
        make().find(name)
    ((place, found, remedy),) = error.value.findings
    assert (place, finding in found) == (name, True), found
    assert remedy.startswith(("did you mean ", "give one of "))


def test_starts_of_trees_and_parameters_are_left_out_of_data() -> None:
    """Except where a start is free, loops determine it, or the data give it otherwise."""
    plant: Any = SimpleNamespace(
        manifest=SimpleNamespace(
            positions=("a", "b"), coordinates=[SimpleNamespace(name=n) for n in "ab"], dependent=(),
            design=[SimpleNamespace(name="mass")],
        ),
        parameters={"mass": 7.0},
    )  # fmt: skip
    problem: Any = SimpleNamespace(start_q=(1.0, 2.0), start_qd=(3.0, 4.0), free_start=(), has_quaternions=False)
    every = {"start.pose.a": 1.0, "start.pose.b": 2.0, "start.velocity.a": 3.0, "start.velocity.b": 4.0}
    mass = {"parameters.mass": 7.0}
    assert list_left_out(problem, plant, {}) == every | mass
    problem.free_start = (1, 2)
    assert list_left_out(problem, plant, {}) == {"start.pose.a": 1.0, "start.velocity.b": 4.0} | mass
    problem.free_start = ()
    assert (
        list_left_out(problem, plant, {"start": {"pose": "rest"}})
        == {name: x for name, x in every.items() if "velocity" in name} | mass
    )
    problem.has_quaternions = True
    assert list_left_out(problem, plant, {}) == mass
    problem.has_quaternions, plant.manifest.dependent = False, (1,)
    assert list_left_out(problem, plant, {}) == mass


# --- plain data -----------------------------------------------------------------------------------------------------


class Kind(Enum):
    """A choice."""

    FAST = "fast"


def test_values_of_python_become_data_of_a_file() -> None:
    given = {
        "a": np.array([[1.0, 2.0, 3.0]]), "b": np.float64(2.5), "c": Kind.FAST, "d": Path("x/y"), "e": (1, "t", None),
        "f": {"g": [True, -INF]}, "h": [-INF, INF], "i": [INF, -INF], "j": [0.0, 1.0, INF],
    }  # fmt: skip
    assert make_plain("task", given) == {
        "a": [[1.0, 2.0, 3.0]], "b": 2.5, "c": "fast", "d": "x/y", "e": [1, "t", None], "f": {"g": [True, -INF]},
        "h": [None, None], "i": [INF, -INF], "j": [0.0, 1.0, INF],
    }  # fmt: skip


def test_values_that_a_file_cannot_hold_are_found_with_their_places() -> None:
    masked = np.ma.MaskedArray([1.0, 2.0], [False, True])
    with pytest.raises(ProblemError) as error:
        make_plain("task", {"a": {1: 2}, "b": [0, {"c": object()}], "d": masked})
    assert [(place, finding.split(";")[0]) for place, finding, _ in error.value.findings][:2] == [
        ("a", "a key is 1"), ("b[1].c", "found a value of type object")
    ]  # fmt: skip
    assert error.value.findings[2][0] == "d"
    assert make_plain("task", {"d": np.ma.MaskedArray([1.0, 2.0], [False, False])}) == {"d": [1.0, 2.0]}


def test_changes_are_merged_into_mappings_and_null_drops_a_key() -> None:
    data = {"a": {"b": 1, "c": 2}, "d": [1, 2], "e": 3}
    assert merge(data, {"a": {"c": 5, "f": 6}, "d": [9], "e": None, "x": None}) == {
        "a": {"b": 1, "c": 5, "f": 6},
        "d": [9],
    }
    assert data == {"a": {"b": 1, "c": 2}, "d": [1, 2], "e": 3}


# --- scenarios ------------------------------------------------------------------------------------------------------

CART = cart_pole().manifest


def state_cart(**given: Any) -> Problem:
    free = (FREE_RANGE, FREE_RANGE)
    known: dict[str, Any] = {
        "start_q": (0.0, 0.0), "start_qd": (0.0, 0.0), "end": End(), "bounds": Bounds(free, free, ((-5.0, INF),)),
    }  # fmt: skip
    return replace(push(4), **(known | given))


def test_scenarios_are_phases_that_share_their_first_inputs() -> None:
    """As unknowns with the bounds and guesses of the inputs; the default cost is written down for each."""
    controls = (Control("c", (0.0, 1.0), 0.5), Control("rate_of_x"))
    data = {"model": "m.yaml", "solver": {"tolerance": 1}, "unknowns": {"n": {}}, "constraints": [{"expression": "x"}]}
    found = state_scenarios("task", data, state_cart(controls=controls[:1]), CART, {"constants.k": [1, 2]})
    first = {f"{FIRST}u_cart": {"range": [-5.0, None], "guess": 0.0}, f"{FIRST}c": {"range": [0.0, 1.0], "guess": 0.5}}
    assert found["unknowns"] == {"n": {}} | first
    assert {key: found[key] for key in ("model", "solver")} == {"model": "m.yaml", "solver": {"tolerance": 1}}
    ties = [{"expression": f"{x} - {FIRST}{x}", "range": [0, 0], "at": "start"} for x in ("u_cart", "c")]
    for k, phase in enumerate(found["phases"]):  # type: ignore[union-attr,arg-type]
        assert phase == {
            "model": "m.yaml", "name": f"scenario{k}", "constants": {"k": k + 1}, "cost": {"inputs": 1.0},
            "constraints": [{"expression": "x"}, *ties],
        }  # fmt: skip
    free = state_scenarios("task", {"cost": {"time": 1}}, state_cart(cost=Cost(0.0, 1.0)), CART, [{}])
    assert free["phases"][0]["cost"] == {"time": 1}  # type: ignore[index,call-overload]
    none = state_scenarios("task", {}, state_cart(cost=Cost(0.0, 1.0)), CART, [{}])
    assert "cost" not in none["phases"][0]  # type: ignore[operator,index]


def test_first_inputs_are_the_ones_that_are_chosen() -> None:
    """Guesses of inputs are 0, or the bound that is nearest to it."""
    free = (FREE_RANGE, FREE_RANGE)
    for limits, guess in (((2.0, 5.0), 2.0), ((-5.0, -2.0), -2.0), ((-1.0, 1.0), 0.0)):
        problem = state_cart(bounds=Bounds(free, free, (limits,)))
        assert _list_first(problem, CART) == [("u_cart", limits, guess)]
    given = state_cart(forces=(Force(0, "1"),), controls=(Control("c"),))
    assert [name for name, *_ in _list_first(given, CART)] == ["c"]
    with pytest.raises(ProblemError, match="there are none that scenarios could share"):
        _list_first(state_cart(forces=(Force(0, "1"),)), CART)


@pytest.mark.parametrize(
    ("changes", "keys", "place"),
    [
        ({"inputs": "linear"}, {}, "inputs"),
        ({"controls": (Control("rate_of_u"),)}, {}, "inputs"),
        ({"controls": (Control("c"),)}, {}, None),
        ({"delays": (Delay("input", 0, 0.1),)}, {}, "inputs.delay"),
        ({}, {"solver.tolerance": [1]}, "solver.tolerance"),
        ({}, {"unknowns.n.guess": [1]}, "unknowns.n.guess"),
    ],
)
def test_scenarios_refuse_what_they_cannot_share(
    changes: dict[str, Any], keys: dict[str, Any], place: str | None
) -> None:
    over = keys or {"constants.k": [1]}
    if place is None:
        state_scenarios("task", {}, state_cart(**changes), CART, over)
        return
    with pytest.raises(ProblemError) as error:
        state_scenarios("task", {}, state_cart(**changes), CART, over)
    assert [found[0] for found in error.value.findings] == [place]
