"""The run-time data of a controller: a number that is written there counts as the same number in the problem.

For each field the test says which part of a problem it is. The vectors of the solver that a changed number gives are
the vectors of the changed problem, entry by entry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.controllers.fields import MARK, Sources, list_delays, list_histories, list_inputs
from mbsrun.ocp.problem.problem import Bounds, Control, Delay, Force, Problem
from tests.mbsrun.controllers.built import FREE_TIME, LATE, PROBLEMS, make
from tests.mbsrun.ocp.plants import FREE_RANGE, push

Array = NDArray[np.float64]
FREE = (FREE_RANGE,)


def read(sources: Sources, values: Array) -> list[Array]:
    """Return all vectors of the solver."""
    parts = (sources.lower, sources.upper, sources.least, sources.most, sources.parameters)
    return [values[part] for part in parts]


def put(values: Any, k: int, x: Any) -> Any:
    return tuple(x if i == k else value for i, value in enumerate(values))


def bound(key: str, side: int) -> Callable[[Problem, int, float], Problem]:
    def change(problem: Problem, k: int, x: float) -> Problem:
        ranges = getattr(problem.bounds, key)
        return replace(problem, bounds=replace(problem.bounds, **{key: put(ranges, k, put(ranges[k], side, x))}))

    return change


def part(key: str, name: str, side: int) -> Callable[[Problem, int, float], Problem]:
    def change(problem: Problem, k: int, x: float) -> Problem:
        old = getattr(problem, key)
        return replace(problem, **{key: put(old, k, replace(old[k], **{name: put(getattr(old[k], name), side, x)}))})

    return change


def end(key: str) -> Callable[[Problem, int, float], Problem]:
    def change(problem: Problem, k: int, x: float) -> Problem:
        old = getattr(problem.end, key)
        return replace(problem, end=replace(problem.end, **{key: put(old, k, (old[k][0], x))}))

    return change


def weigh(problem: Problem, k: int, x: float) -> Problem:
    """Change one weight that is not 0: inputs, their rates, running and terminal terms, rates of controls."""
    cost = problem.cost
    if k < 2:
        return replace(problem, cost=replace(cost, **{("inputs", "input_rates")[k]: x}))
    if k < 4:
        at = (0, 2)[k - 2]
        return replace(problem, cost=replace(cost, running=put(cost.running, at, replace(cost.running[at], weight=x))))
    if k == 4:
        return replace(problem, cost=replace(cost, terminal=(replace(cost.terminal[0], weight=x),)))
    return replace(problem, cost=replace(cost, control_rates=(("c", x),)))


MEANING: Mapping[str, Callable[[Problem, int, float], Problem]] = {
    "start_q": lambda p, k, x: replace(p, start_q=put(p.start_q, k, x)),
    "start_qd": lambda p, k, x: replace(p, start_qd=put(p.start_qd, k, x)),
    "start_states": lambda p, k, x: p if k else replace(p, states=put(p.states, k, replace(p.states[k], start=(x, x)))),
    "end_states": lambda p, _, x: replace(p, states=put(p.states, 1, replace(p.states[1], end=(x, x)))),
    "end_q": end("coordinates"),
    "end_qd": end("velocities"),
    "end_qdd": end("accelerations"),
    "end_sensors": lambda p, k, x: replace(
        p, end=replace(p.end, sensors=(("place", put(p.end.sensors[0][1], (0, 2)[k], x)),))
    ),
    "end_sensor_velocities": lambda p, _, x: replace(
        p, end=replace(p.end, sensor_velocities=(("place", (x, None, None)),))
    ),
    **{f"{key}_{name}": bound(key, side) for key in ("q", "qd", "u") for side, name in enumerate(("lower", "upper"))},
    **{f"input_rates_{name}": bound("rates", side) for side, name in enumerate(("lower", "upper"))},
    **{
        f"{key}_{name}": part(key, {"constraints": "range"}.get(key, "bounds"), side)
        for key in ("states", "controls", "constraints")
        for side, name in enumerate(("lower", "upper"))
    },
    "horizon_lower": lambda p, _, x: replace(p, horizon_range=put(p.horizon_range, 0, x)),
    "horizon_upper": lambda p, _, x: replace(p, horizon_range=put(p.horizon_range, 1, x)),
    "weights": weigh,
    "constants": lambda p, k, x: replace(p, constants=put(p.constants, k, (p.constants[k][0], x))),
}  # fmt: skip
OWN = ("inputs_before", "inputs_given")  # of the loop, see below


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_number_of_the_data_is_the_same_number_of_the_problem(name: str) -> None:
    built = make(name)
    sources = built.find(built.problem)
    assert sources.count == sum(len(field.entries) for field in sources.fields)
    assert {field.name for field in sources.fields} <= {*MEANING, *OWN}
    values, changed = sources.values, built.problem
    for field in (field for field in sources.fields if field.name not in OWN):
        for k, entry in enumerate(field.entries):
            at = sources.place(field.name) + k
            values[at] = entry.value + 0.03125 + at / 1024  # each by another amount
            changed = MEANING[field.name](changed, k, float(values[at]))
    expected = built.find(changed)
    for found, wanted in zip(read(sources, values), read(expected, expected.values), strict=True):
        assert found.tolist() == wanted.tolist()


def test_the_data_of_a_problem_are_its_numbers_with_names_and_units() -> None:
    """A term of weight 0, and numbers that nothing reads, are no data."""
    late = {field.name: [(e.name, e.unit, e.value) for e in field.entries] for field in make("late").find(LATE).fields}
    assert late == {
        "start_q": [("slide", "m", 0.1)], "start_qd": [("slide", "m/s", 0.2)],
        "start_states": [("heat", "", 0.25), ("sum", "", 0.0)], "end_states": [("sum", "", 0.75)],
        "states_lower": [("heat", "", -1.0), ("sum", "", -60.0)],
        "states_upper": [("heat", "", 50.0), ("sum", "", 61.0)],
        "end_q": [("slide", "m", 1.0)], "end_qd": [("slide", "m/s", 0.3)], "end_qdd": [("slide", "m/s^2", 0.6)],
        "q_lower": [("slide", "m", -5.0)], "q_upper": [("slide", "m", 6.0)],
        "qd_lower": [("slide", "m/s", -7.0)], "qd_upper": [("slide", "m/s", 8.0)],
        "u_lower": [("slide", "N", -9.0)], "u_upper": [("slide", "N", 10.0)],
        "input_rates_lower": [("slide", "N/s", -11.0)], "input_rates_upper": [("slide", "N/s", 12.0)],
        "controls_lower": [("c", "", -2.0), ("e", "", -17.0)], "controls_upper": [("c", "", 3.0), ("e", "", 18.0)],
        "inputs_before": [("slide_2", "N", 0.7), ("slide_1", "N", 0.7)],
        "inputs_given": [("slide", "N", 0.0), ("c", "", 0.0), ("e", "", 0.0)],
        "constraints_lower": [("path0", "", -13.0), ("end1", "", -15.0)],
        "constraints_upper": [("path0", "", 14.0), ("end1", "", 16.0)],
        "weights": [
            ("inputs", "", 1.5), ("input_rates", "", 0.5), ("running0", "", 2.0), ("running2", "", 6.0),
            ("terminal0", "", 3.5), ("rate_c", "", 0.125),
        ],
        "constants": [("k", "", 4.0), ("l", "", 5.0)],
    }  # fmt: skip
    fields = {field.name: field for field in make("free time").find(FREE_TIME).fields}
    assert [(e.name, e.unit, e.value) for e in fields["end_sensors"].entries] == [
        ("place.x", "m", 1.0), ("place.z", "m", 0.0)
    ]  # fmt: skip
    assert [(e.name, e.unit) for e in fields["end_sensor_velocities"].entries] == [("place.x", "m/s")]
    assert [(e.name, e.unit, e.value) for e in fields["horizon_upper"].entries] == [("horizon", "s", 2.0)]
    notes = {e.name: e.note for field in make("late").find(LATE).fields for e in field.entries if e.note}
    assert (notes.pop("path0"), notes.pop("end1")) == ("q_slide + c", "qd_slide")
    assert [notes[name] for name in ("running0", "running2", "terminal0")] == [
        "(q_slide - k)**2 + c**2 + l", "e**2", "heat"
    ]  # fmt: skip


def test_a_command_of_before_fixes_the_input_of_its_interval() -> None:
    """The oldest acts first; one that was given since acts in no interval of this plan."""
    sources = make("late").find(LATE)
    values, place = sources.values, sources.place("inputs_before")
    values[place], values[place + 1], values[sources.place("inputs_given")] = 100.0, 101.0, 102.0
    for part in (sources.lower, sources.upper):
        found = values[part]
        assert [x for x in found if x in (100.0, 101.0, 102.0)] == [100.0, 101.0]
        assert np.count_nonzero(sources.values[part] == 0.7) == 2


def test_a_history_of_0_is_0() -> None:
    still = replace(LATE, delays=(replace(LATE.delays[0], history=0.0),))
    assert [x.value for x in make("late").find(still).field("inputs_before").entries] == [0.0, 0.0]


def test_numbers_without_a_bound_are_infinite_and_none_is_a_mark() -> None:
    sources = make("free time").find(FREE_TIME)
    for found in read(sources, sources.values):
        assert not (np.isfinite(found) & (np.abs(found) > 1e6)).any()
    assert all(abs(x) < MARK or np.isinf(x) for x in sources.constants)
    for found in (sources, make("late").find(LATE)):
        lower, upper = found.values[found.lower], found.values[found.upper]
        assert ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all()


def test_histories_are_of_inputs_that_are_late_or_have_rates() -> None:
    """By index; a place counts what no expression gives; where only a rate is bounded, one command is remembered."""
    four: dict[str, Any] = {
        "bounds": Bounds(FREE, FREE, FREE * 4, (FREE_RANGE, (-1.0, 1.0), FREE_RANGE, (-2.0, np.inf))),
        "forces": (Force(0, "c"),), "controls": (Control("c"),),
    }  # fmt: skip
    problem = replace(push(4), delays=(Delay("input", 3, 0.5), Delay("input", 2, 0.25)), **four)
    found = [(x.input, x.place, x.delay, x.is_rated, x.count) for x in list_histories(problem)]
    assert found == [(1, 0, 0, True, 1), (2, 1, 1, False, 1), (3, 2, 2, True, 2)]
    assert list_delays(problem) == (0, 1, 2, 0)
    assert list_delays(replace(problem, delays=())) == ()
    coordinates = tuple(SimpleNamespace(name=f"j{i}", force_unit="N") for i in range(5))
    manifest: Any = SimpleNamespace(coordinates=coordinates, actuated=(4, 3, 1, 0))
    assert list_inputs(problem, manifest) == [("j3", "N"), ("j1", "N"), ("j0", "N"), ("c", "")]
