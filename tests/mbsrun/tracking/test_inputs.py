"""Which inputs a loop gives, which act late, and which controllers fit; each by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.problem import Delay
from mbsrun.tracking.added import Line, hold_inputs, is_interval, is_whole, list_chosen, list_lines
from mbsrun.tracking.compiled import _list_velocities, count_held, find_wrong_rate, list_misfits, remembers
from mbsrun.tracking.record import _finite


def make(**changes: Any) -> Any:
    """Make a problem of three inputs and two controls."""
    usual = {
        "bounds": SimpleNamespace(u=((-1, 1),) * 3),
        "controls": (SimpleNamespace(name="a"), SimpleNamespace(name="b")),
        "forces": (),
        "delays": (),
        "horizon": 2.0,
        "intervals": 8,
        "mesh": None,
        "start_q": (0.0,) * 3,
        "start_qd": (0.0,) * 3,
        "states": (),
        "unknowns": (),
    }
    return SimpleNamespace(**(usual | changes))


def test_inputs_that_act_late_are_counted_in_periods() -> None:
    """Controls come behind all inputs; a free history is 0."""
    delays = (Delay("input", 1, 0.5, 2.0), Delay("control", 1, 0.25, None), Delay("input", 2, 0.7500001))
    assert list_lines(make(delays=delays), 0.25) == (Line(1, 2, 2.0), Line(4, 1, 0.0), Line(2, 3, 0.0))
    assert list_lines(make(), 0.25) == ()


def test_controllers_choose_what_no_expression_gives() -> None:
    assert list_chosen(make(forces=(SimpleNamespace(input=1),))) == [0, 2, 3, 4]
    assert list_chosen(make(controls=())) == [0, 1, 2]


def test_a_mechanism_moves_with_its_states_where_inputs_depend_on_more() -> None:
    assert is_whole(make())
    assert is_whole(make(controls=(), forces=(SimpleNamespace(input=1),)))
    assert not is_whole(make(controls=()))


def test_a_period_is_an_interval_up_to_rounding() -> None:
    assert is_interval(make(), 0.25)
    assert is_interval(make(), 0.25 * (1 + 0.9e-6))
    assert is_interval(make(), 0.25 * (1 - 0.9e-6))
    assert not is_interval(make(), 0.25 * (1 + 1.1e-6))
    assert not is_interval(make(), 0.5)
    assert not is_interval(make(mesh=(0.5, 0.5)), 0.25)


def test_held_inputs_have_no_wrenches() -> None:
    """Controls behind the inputs are left out."""
    kernels: Any = SimpleNamespace(manifest=SimpleNamespace(actuated=(0, 1), inputs=("u0", "u1", "fx", "fy", "fz")))
    force = hold_inputs(np.array([3.0, 4.0, 5.0]), kernels)
    assert force(0.0).tolist() == [3, 4, 0, 0, 0]
    assert force(7.0).tolist() == [3, 4, 0, 0, 0]


@pytest.mark.parametrize(
    ("interval", "period", "is_right"),
    [
        (0.1, 0.1, True),
        (0.1, 0.05, True),
        (0.3, 0.1, True),
        (0.1, 0.1 * (1 + 0.9e-6), True),
        (0.1, 0.1 * (1 + 1.2e-6), False),
        (0.1, 0.2, False),
        (0.1, 0.04, False),
        (0.1, 0.3, False),
    ],
)
def test_periods_are_parts_of_intervals(interval: float, period: float, is_right: bool) -> None:
    found = find_wrong_rate(interval, period)
    assert (found is None) is is_right
    if found is not None:
        assert found[1] == "give a rate of 10 Hz, or a multiple"


def test_a_controller_that_remembers_inputs_needs_whole_intervals() -> None:
    assert find_wrong_rate(0.1, 0.1, remembers=True) is None
    assert find_wrong_rate(0.1, 0.1 * (1 + 0.9e-6), remembers=True) is None
    for period in (0.05, 0.1 * (1 + 1.2e-6), 0.2):
        found = find_wrong_rate(0.1, period, remembers=True)
        assert found is not None
        assert found[0].startswith("the controller remembers inputs by intervals of 0.1 s, and a period has ")
        assert found[1] == "give a rate of 10 Hz"


def name_all(names: str) -> tuple[Any, ...]:
    """Make things that have names."""
    return tuple(SimpleNamespace(name=name) for name in names)


def describe(**changes: Any) -> Any:
    """Describe a controller of the problem above: seven states with an added one, five inputs, eight intervals."""
    names = {"start_q": "xyz", "start_qd": "xyz", "constants": ("m", "k")}
    data = [
        SimpleNamespace(name=name, entries=[SimpleNamespace(name=x) for x in entries])
        for name, entries in (names | changes.pop("data", {})).items()
    ]
    usual = {"states": name_all("abcdefg"), "inputs": ("u",) * 5, "intervals": 8, "horizon": 2.0, "prefix": "puck"}
    return SimpleNamespace(**(usual | changes), data=tuple(data))


PROBLEM = make(states=(SimpleNamespace(name="heat"),))


def test_a_controller_of_another_problem_does_not_fit() -> None:
    assert list_misfits(describe(), PROBLEM) == []
    assert list_misfits(describe(), PROBLEM, ["k", "m"]) == []
    for change, sizes in (
        ({"states": name_all("abcdef")}, "6, 5, 8"),
        ({"inputs": ("u",) * 4}, "7, 4, 8"),
        ({"intervals": 9}, "7, 5, 9"),
    ):
        (finding,) = list_misfits(describe(**change), PROBLEM)
        assert finding == f"puck is of another problem: {sizes} states, inputs and intervals, and not 7, 5, 8"
    (finding,) = list_misfits(describe(horizon=None), PROBLEM)
    assert finding == "puck chooses its horizon, and a loop needs intervals of a fixed length"
    (finding,) = list_misfits(describe(), PROBLEM, ["m", "c"])
    assert finding == "puck has no constant c, which the loop updates"


def test_unknown_numbers_that_are_held_are_not_measured() -> None:
    """They are states of the controller behind the others."""
    held = make(states=PROBLEM.states, unknowns=name_all("gx"))
    assert [count_held(describe(), problem) for problem in (PROBLEM, held)] == [0, 1]
    (finding,) = list_misfits(describe(), held)
    assert finding.endswith("and not 8, 5, 8")
    assert list_misfits(describe(states=name_all("abcdefhg")), held) == []


def test_independent_velocities_are_read_alone() -> None:
    """Where a controller names some of the velocities, in its order; else it reads all."""
    assert _list_velocities(describe(), PROBLEM) == [0, 1, 2]
    assert _list_velocities(describe(data={"start_qd": "zx"}), PROBLEM) == [2, 0]
    assert _list_velocities(describe(data={"start_qd": "zw"}), PROBLEM) == [0, 1, 2]
    assert _list_velocities(describe(data={"start_qd": "zx", "start_q": "wxyz"}), PROBLEM) == [0, 1, 2]
    (finding,) = list_misfits(describe(data={"start_qd": "zx"}), PROBLEM)
    assert finding.endswith("and not 6, 5, 8")


def test_controllers_remember_inputs_that_they_have_numbers_of() -> None:
    assert not remembers(describe())
    assert remembers(describe(data={"inputs_before": "u"}))


def test_summaries_have_null_for_what_is_no_number() -> None:
    data = {"a": [1.5, np.nan, {"b": -np.inf}], "c": "nan", "d": None, "e": 3}
    assert _finite(data) == {"a": [1.5, None, {"b": None}], "c": "nan", "d": None, "e": 3}
