"""Problems as data: values on their limits are taken, values beyond are refused at their place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mbsrun.closure import Closure
from mbsrun.ocp.problem.problem import Bounds, Problem
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import _Reading, state_problem
from mbsrun.quaternions import list_quaternions
from tests.mbsrun.ocp.exact_motions import rails
from tests.mbsrun.peer import Peer, double_integrator

INF = math.inf
TASK: Mapping[str, Any] = {
    "horizon": 1,
    "intervals": 4,
    "scheme": "radau",
    "degree": 2,
    "cost": {"inputs": 1},
    "start": {"pose": {"slide": 0}},
    "bounds": {"coordinates": {"slide": [-1, 2]}, "velocities": [-3, 4]},
    "end": {"pose": {"slide": 1}},
}


def state(plant: Peer | None = None, **changes: Any) -> Problem:
    return state_problem({**TASK, **changes}, "task", plant or double_integrator(), Path())


GOOD: list[dict[str, Any]] = [
    {"start": {"pose": {"slide": 2}}},
    {"start": {"pose": {"slide": -1}}},
    {"start": {"pose": [2], "velocity": [4]}},
    {"start": {"pose": {}, "velocity": {"slide": -3}}},
    {"end": {"pose": {"slide": 2}, "velocity": {"slide": 4}, "acceleration": {"slide": 99}}},
    {"end": {"pose": [-1], "velocity": {"slide": -3}}},
    {"start": {"pose": {"slide": None}}, "guess": {"start": {"slide": 2}, "end": {"slide": -1}}},
    {"start": {"pose": {"slide": None}}, "guess": {"start": {"slide": -1}, "end": {"slide": 2}}},
    {"guess": {"solution": "walk.csv", "times": [1, 2]}},
    {"guess": {"solution": "walk.csv", "times": [None, 2]}},
    {"cost": {"inputs": 0, "input_rates": 1}},
    {"solver": {"method": "mbs", "threads": 2}},
    {"solver": {"method": "ipopt", "threads": 1}},
    {"end": {"sensors": {"place": {"x": 1}}}},
    {"end": {"sensors": {"place": {"radius": 1, "azimuth": 0, "height": 0}}}},
]


@pytest.mark.parametrize("changes", GOOD)
def test_values_on_their_limits_are_taken(changes: dict[str, Any]) -> None:
    assert state(**changes).name == "task"


BAD: list[tuple[dict[str, Any], str, str]] = [
    ({"start": {"pose": {"slide": 2.001}}}, "start.pose.slide", "slide = 2.001 is out of [-1, 2]"),
    ({"start": {"pose": {"slide": -1.001}}}, "start.pose.slide", "is out of [-1, 2]"),
    ({"start": {"pose": [2.001]}}, "start.pose[0]", "is out of [-1, 2]"),
    ({"start": {"pose": {}, "velocity": [0, 0]}}, "start.velocity", "found 2 numbers"),
    ({"start": {"pose": {}, "velocity": {"slide": 4.001}}}, "start.velocity.slide", "is out of [-3, 4]"),
    ({"end": {"pose": {"slide": 2.001}}}, "end.pose.slide", "2.001 is out of [-1, 2]"),
    ({"end": {"pose": {"slide": -1.001}}}, "end.pose.slide", "is out of [-1, 2]"),
    ({"end": {"pose": [1, 2]}}, "end.pose", "found 2 numbers"),
    ({"end": {"velocity": {"slide": -3.001}}}, "end.velocity.slide", "is out of [-3, 4]"),
    ({"guess": {"start": {"slide": 0}}}, "guess.start.slide", "this coordinate has a value at the start"),
    ({"guess": {"end": {"slide": 2.001}}}, "guess.end.slide", "is out of [-1, 2]"),
    ({"guess": {"end": {"slide": -1.001}}}, "guess.end.slide", "is out of [-1, 2]"),
    ({"guess": {"solution": "walk.csv", "times": [2, 2]}}, "guess.times", "2 is not before 2"),
    ({"guess": {"times": [None, 2]}}, "guess.times", "there is no recording"),
    ({"guess": {"times": [1, None]}}, "guess.times", "there is no recording"),
    ({"cost": {"inputs": 0}}, "cost", "every weight is 0"),
    ({"cost": {"inputs": -1}}, "cost.inputs", "-1"),
    ({"cost": {"inputs": 1, "input_rates": -1}}, "cost.input_rates", "-1"),
    ({"solver": {"method": "ipopt", "threads": 2}}, "solver.threads", "found 2, but ipopt has one thread"),
    ({"end": {"sensors": {"place": {"x": 1, "radius": 1}}}}, "end.sensors.place", "found"),
    ({"end": {"sensors": {"place": {}}}}, "end.sensors.place", "found nothing"),
    ({"end": {"sensors": {"place": {"radius": 1, "height": 0}}}}, "end.sensors.place", "found radius, height"),
    ({"end": {"sensors": {"nowhere": {"x": 1}}}}, "end.sensors.nowhere", "nowhere"),
    ({"end": {"orientations": {"place": {}}}}, "end.orientations.place", "found nothing"),
    (
        {"end": {"orientations": {"place": {"rpy": [0, 0, 0], "x": [1, 0, 0]}}}},
        "end.orientations.place",
        "found rpy, x",
    ),
]


@pytest.mark.parametrize(("changes", "place", "finding"), BAD)
def test_values_beyond_are_refused_at_their_place(changes: dict[str, Any], place: str, finding: str) -> None:
    with pytest.raises(ProblemError) as caught:
        state(**changes)
    (found,) = caught.value.findings
    assert found[0] == place
    assert finding in found[1]


def test_free_starts_are_guessed_within_their_bounds() -> None:
    """The neutral pose, or the nearest limit; free entries are listed."""
    problem = state(start={"pose": {"slide": None}}, bounds={"coordinates": {"slide": [0.5, 2]}})
    assert (problem.start_q, problem.free_start) == ((0.5,), (0,))
    problem = state(
        start={"pose": {"slide": None}, "velocity": [None]}, bounds={"coordinates": {"slide": [-2, -0.25]}}, end={}
    )
    assert (problem.start_q, problem.start_qd, problem.free_start) == ((-0.25,), (0.0,), (0, 1))


def test_a_cost_of_nothing_is_of_inputs() -> None:
    """Unless there is another term."""
    for cost, inputs in (
        ({}, 1.0),
        ({"running": [{"expression": "q_slide"}]}, 0.0),
        ({"terminal": [{"expression": "q_slide"}]}, 0.0),
        ({"input_rates": 2}, 0.0),
        ({"inputs": 3, "input_rates": 2}, 3.0),
    ):
        assert state(cost=cost).cost.inputs == inputs


def test_bounds_of_rates_are_none_where_no_input_has_one() -> None:
    assert state().bounds.rates == ()
    assert state(bounds={"input_rates": [None, 3]}).bounds.rates == ((-INF, 3.0),)
    assert state(bounds={"input_rates": {"slide": [-1, None]}}).bounds.rates == ((-1.0, INF),)
    assert state(bounds={"input_rates": {}}).bounds.rates == ()


def test_bounds_of_forces_of_driven_joints_are_none_where_no_force_has_one() -> None:
    for given, found in ((None, ()), ({"z": [-2, None]}, ((-2.0, INF),)), ([None, 5], ((-INF, 5.0),))):
        bounds = {} if given is None else {"tau": given}
        reading = SimpleNamespace(
            velocities=SimpleNamespace(known=["x", "y", "z"]),
            manifest=SimpleNamespace(driven=(2,)),
            look_up=lambda *_: 0,
            range=lambda _, pair: tuple(x if y is None else y for x, y in zip((-INF, INF), pair, strict=True)),
        )
        reading.ranges = lambda *given, own=reading: _Reading.ranges(cast(Any, own), *given)
        limits = bounds.get("tau", {})
        section = SimpleNamespace(tau=tuple(limits) if isinstance(limits, list) else limits)
        assert _Reading.driving(cast(Any, reading), cast(Any, section)) == found


# --- closed loops: y = 2 x ---


def looped(**changes: Any) -> Problem:
    """From x = 0.3, within wide bounds."""
    return state(rails(), **{"start": {"pose": {"x": 0.3}}, "bounds": {}, "end": {}, **changes})


def test_loops_complete_a_start_within_its_bounds() -> None:
    """To 1e-9: of y = 0.6 and its velocity."""
    problem = looped(
        start={"pose": {"x": 0.3}, "velocity": {"x": 0.5}}, bounds={"coordinates": {"y": [0.6, 0.6 + 1e-3]}}
    )
    assert problem.start_q == pytest.approx((0.3, 0.6))
    assert problem.start_qd == pytest.approx((0.5, 1.0))
    assert problem.free_start == ()
    for limits, fits in (
        ([0.6 + 0.9e-9, 2], True),
        ([0.6 + 1.1e-9, 2], False),
        ([0, 0.6 - 0.9e-9], True),
        ([0, 0.6 - 1.1e-9], False),
    ):
        if fits:
            looped(bounds={"coordinates": {"y": limits}})
            continue
        with pytest.raises(ProblemError, match=r"y = 0\.6 is out of"):
            looped(bounds={"coordinates": {"y": limits}})
    with pytest.raises(ProblemError, match="y = 1 is out of"):
        looped(start={"pose": {"x": 0.3}, "velocity": {"x": 0.5}}, bounds={"velocities": {"y": [-1, 0.999]}})


def test_free_coordinates_free_what_follows_from_them() -> None:
    """A free x frees y, whose velocity follows from the one of x; free velocities leave the pose."""
    assert looped(start={"pose": {"x": None}}).free_start == (0, 1, 3)
    assert looped(start={"pose": {}, "velocity": {"x": None}}).free_start == (2, 3)
    assert looped(start={"pose": {}}).free_start == ()


def test_loops_refuse_what_contradicts_them() -> None:
    with pytest.raises(ProblemError, match=r"the loops put it at 0\.6, 0\.1 away"):
        looped(start={"pose": {"x": 0.3, "y": 0.7}})
    with pytest.raises(ProblemError, match="found 3 numbers"):
        looped(start={"pose": [0.3, 0.6, 0.9]})
    assert looped(start={"pose": [0.3, 0.6]}).start_q == pytest.approx((0.3, 0.6))


def test_ends_keep_what_determines_the_others() -> None:
    """y follows from x; another value of it is refused; its velocity follows, too."""
    assert looped(end={"pose": {"x": 0.4, "y": 0.8}}).end.coordinates == ((0, 0.4),)
    assert looped(end={"pose": {"y": 0.8}}).end.coordinates == ((1, 0.8),)
    with pytest.raises(ProblemError, match=r"the loops put it at 0\.8"):
        looped(end={"pose": {"x": 0.4, "y": 0.9}})
    with pytest.raises(ProblemError, match="y follows from the others by the loops"):
        looped(end={"velocity": {"x": 0.4, "y": 0.8}})
    with pytest.raises(ProblemError, match="y follows from the others by the loops"):
        looped(end={"acceleration": {"x": 0.4, "y": 0.8}})


def test_guesses_of_closed_mechanisms_are_closed() -> None:
    """Given values stay; a coordinate that loops give at the start is no guess."""
    free = {"start": {"pose": {"x": None}}, "end": {}}
    assert dict(looped(**free, guess={"start": {"x": 0.5}}).guess.start) == pytest.approx({0: 0.5, 1: 1.0})
    assert dict(looped(**free, guess={"end": {"x": 0.5}}).guess.end) == pytest.approx({0: 0.5, 1: 1.0})
    assert looped(**free).guess.end == ()
    (found,) = looped(end={"pose": {"x": 0.4}}, guess={"end": {"y": 0.8}}).guess.end
    assert found == pytest.approx((1, 0.8))
    for start, finding in (
        ({"pose": {"x": 0.3}}, "the loops give this coordinate at the start"),
        ({"pose": {"x": 0.3, "y": 0.6}}, "this coordinate has a value at the start"),
        ({"pose": [0.3, 0.6]}, "this coordinate has a value at the start"),
    ):
        with pytest.raises(ProblemError, match=finding):
            looped(start=start, guess={"start": {"y": 0.6}})


def test_parameters_of_loops_free_what_follows_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Entries of (q, qd) that no value determines: y, and its velocity behind both coordinates."""
    monkeypatch.setattr(Closure, "parameters", ("length",))
    assert looped().following == (1, 3)
    assert looped(start={"pose": {"y": 0.6}, "velocity": {"y": 1}}).following == (0, 2)


# --- quaternions, by the parts of the reading ---


def ball(**given: Any) -> Any:
    """A reading of a mechanism of one slider and one ball."""
    names = ("slide", "ball.qx", "ball.qy", "ball.qz", "ball.qw")
    manifest = SimpleNamespace(positions=names, quaternions=(1,))
    found = SimpleNamespace(manifest=manifest, coordinates=SimpleNamespace(known=list(names)), faults=[], **given)
    found.fault = lambda place, finding, remedy: found.faults.append((place, finding, remedy))
    found.attitudes = lambda place, values: _Reading.attitudes(cast(Any, found), place, values)
    return found


def limits(*own: tuple[float, float]) -> Bounds:
    return Bounds(((-9.0, 9.0), *own), (), ())


@pytest.mark.parametrize(
    ("own", "fits"),
    [
        (((-1.0, 1.0),) * 4, True),
        (((0.6, 0.6), (0.0, 0.0), (0.0, 0.0), (0.8, 0.8)), True),
        (((-0.6, -0.6), (0.0, 0.0), (0.0, 0.0), (-0.8, -0.8)), True),  # the other sign
        (((-0.6, -0.6), (0.0, 0.0), (0.0, 0.0), (0.8, 0.8)), False),
        (((0.61, 1.0), (0.0, 0.0), (0.0, 0.0), (-1.0, 1.0)), False),
        (((-1.0, 0.59), (0.0, 0.0), (0.0, 0.0), (0.0, 1.0)), False),
    ],
)
def test_attitudes_fit_with_either_sign(own: Any, fits: bool) -> None:
    reading = ball()
    (x,) = list_quaternions(reading.manifest)
    _Reading.check_attitude(reading, x, [1, 2, 3, 4], [5.0, 0.6, 0.0, 0.0, 0.8], limits(*own))
    assert [found[1] for found in reading.faults] == ([] if fits else ["the attitude of ball is out of bounds"])


def test_quaternions_are_given_whole_or_free_whole() -> None:
    reading = ball()
    (x,) = list_quaternions(reading.manifest)
    _Reading.check_attitude(reading, x, [], [0.0] * 5, limits(*((5.0, 6.0),) * 4))
    assert not reading.faults
    _Reading.check_attitude(reading, x, [1, 3], [0.0] * 5, limits(*((-1.0, 1.0),) * 4))
    place, finding, remedy = reading.faults.pop()
    assert (place[2], finding) == ("ball.qx", "only a part of the quaternion of ball")
    assert remedy.startswith("give ball.qy, ball.qw too")
    for free, count in (((), 0), ((0,), 0), ((1,), 1), ((0, 2, 3, 4), 1), ((1, 2, 3, 4), 0)):
        reading = ball()
        _Reading.check_free(reading, ("start", "pose"), free)
        assert len(reading.faults) == count


def test_attitudes_have_length_1() -> None:
    reading = ball()
    assert reading.attitudes(("start",), [7.0, 0, 3, 0, 4]) == pytest.approx([7, 0, 0.6, 0, 0.8])
    assert not reading.faults
    _Reading.attitudes(reading, ("start",), [7.0, 0, 0, 0, 0])
    assert reading.faults[0][1:] == ("the quaternion of ball is 0", "give ball.qw too; 0, 0, 0, 1 turns nothing")
    whole = _Reading.whole(ball(), ("start",), {0: 2.0, 2: 3.0, 4: 4.0})
    assert whole == pytest.approx({0: 2.0, 1: 0.0, 2: 0.6, 3: 0.0, 4: 0.8})
    assert _Reading.whole(ball(), ("start",), {0: 2.0}) == {0: 2.0}
    assert _Reading.whole(ball(), ("start",), {1: None, 2: 3.0}) == {1: None, 2: 3.0}


@pytest.mark.parametrize(
    ("own", "fits"),
    [
        (((-1.0, 1.0),) * 4, True),
        (((0.6, 2.0), (0.8, 2.0), (-1.0, 1.0), (-1.0, 1.0)), True),
        (((0.6, 2.0), (0.81, 2.0), (-1.0, 1.0), (-1.0, 1.0)), False),
        (((-0.6, 0.1), (-0.1, 0.8), (0.0, 0.0), (0.0, 0.0)), True),
        (((-0.6, 0.1), (-0.1, 0.79), (0.0, 0.0), (0.0, 0.0)), False),
        (((-2.0, -0.7), (-2.0, -0.72), (-1.0, 1.0), (-1.0, 1.0)), False),
    ],
)
def test_bounds_leave_a_quaternion_of_length_1(own: Any, fits: bool) -> None:
    given = {"coordinates": ((-9.0, 9.0), *own), "velocities": (), "inputs": ()}
    reading = ball(
        ranges=lambda key, *_: given[key], limits=(), speeds=(), forces=(), velocities=None, inputs=None,
        rates=lambda _: (), driving=lambda _: (),
    )  # fmt: skip
    section = SimpleNamespace(coordinates=None, velocities=None, inputs=None)
    assert np.array(_Reading.bounds(reading, cast(Any, section)).q).shape == (5, 2)
    assert len(reading.faults) == (0 if fits else 1)
