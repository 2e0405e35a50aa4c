"""Delays that differ across a link: which inputs act again, and why one cannot; each by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.problem.problem import SAME_TIME, Delay
from mbsrun.ocp.transcription.delays import Half, Placed, Shift, _read, find_misfits, find_shifts

COORDINATES = [SimpleNamespace(name=name) for name in ("x", "y", "z")]
MANIFEST: Any = SimpleNamespace(coordinates=COORDINATES, actuated=(2, 0))  # inputs: z, then x
SHIFT = Shift("input", "x", "", 0.2, 0.5, True)


def make(name: str = "first", horizon: float = 1.0, intervals: int = 10, **changes: Any) -> Half:
    """Make a phase of equal intervals, with a control and a state whose rate it is."""
    usual: dict[str, Any] = {
        "delays": (),
        "forces": (),
        "controls": (SimpleNamespace(name="slope"), SimpleNamespace(name="aim")),
        "states": (SimpleNamespace(name="steer"),),
        "is_timed": True,
        "horizon": horizon,
        "grid": Grid(intervals, changes.pop("mesh", None)),
        "inputs": "constant",
        "degree": 3,
        "family": schemes.Family.RADAU,
        "refine": None,
    }
    problem: Any = SimpleNamespace(**(usual | changes))
    return Half(name, problem, MANIFEST)


def explain(before: Half, after: Half, shift: Shift = SHIFT) -> str:
    """Return the finding, or nothing."""
    return "".join(finding for finding, _ in find_misfits(shift, before, after))


def test_inputs_whose_delays_differ_are_shifted() -> None:
    """Inputs without a delay act at once; a difference of rounding is none."""
    before = make(delays=(Delay("input", 1, 0.2), Delay("control", 1, 0.3), Delay("input", 0, 0.4)))
    after = make(delays=(Delay("input", 1, 0.5, is_linked=True), Delay("input", 0, 0.4 * (1 + 0.5 * SAME_TIME))))
    shifts = find_shifts(before, after)
    assert shifts == [Shift("input", "x", "", 0.2, 0.5, True), Shift("control", "aim", "", 0.3, 0.0, False)]
    assert [shift.seconds for shift in shifts] == pytest.approx([0.3, -0.3])
    assert [shift.repeats for shift in shifts] == [True, False]
    assert not Shift("input", "x", "", 0.2, 0.5, False).repeats
    assert not Shift("input", "x", "", 0.2, 0.2, True).repeats
    later = make(delays=(Delay("input", 0, 0.4 * (1 + 3 * SAME_TIME)), *before.problem.delays[:2]))
    assert [shift.name for shift in find_shifts(before, later)] == ["z"]


def test_a_continuous_input_is_a_state_with_its_rate() -> None:
    """Whichever phase has the delay."""
    delay = Delay("control", 0, 0.25, state=0)
    for before, after in ((make(delays=(delay,)), make()), (make(), make(delays=(delay,)))):
        (shift,) = find_shifts(before, after)
        assert (shift.kind, shift.name, shift.rate) == ("state", "steer", "slope")
        assert {shift.before, shift.after} == {0.0, 0.25}


def test_inputs_are_found_by_name() -> None:
    """An input that an expression gives is none; a continuous one is a control and a state."""
    half = make(forces=(SimpleNamespace(input=0),))
    assert half.find(SHIFT) == 1
    assert half.find(Shift("input", "z", "", 0, 1, True)) is None
    assert half.find(Shift("input", "y", "", 0, 1, True)) is None
    assert half.find(Shift("control", "aim", "", 0, 1, True)) == 1
    assert half.find(Shift("control", "other", "", 0, 1, True)) is None
    assert half.find(Shift("state", "steer", "slope", 0, 1, True)) == 0
    assert half.find(Shift("state", "other", "slope", 0, 1, True)) is None


def test_inputs_that_act_again_fit_both_phases() -> None:
    """0.3 s before the end of the first phase and 0.1 s steps: intervals of the second one end where inputs change."""
    assert explain(make(), make("second")) == ""
    assert explain(make(horizon=0.3, intervals=3), make("second")) == ""
    missing = make("second", intervals=5)
    assert explain(make(), missing).endswith("so mesh points are missing here, at 0.1, 0.3 s")
    coarse = make(intervals=4)
    assert explain(coarse, make("second")).endswith("which has no mesh point 0.3 s before its end")
    assert explain(coarse, make("second", mesh=(0.05, 0.95)), Shift("input", "x", "", 0.25, 0.5, True)) == (
        "x acts 0.5 s later, and 0.25 s later in phase first; so mesh points are missing here, at 0.25 s"
    )


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        ({"is_timed": False}, "whose horizon is free, so its mesh points move"),
        ({"horizon": 0.299}, "which lasts 0.299 s, less than the difference"),
        ({"inputs": "polynomial"}, "where inputs are polynomial, and here constant"),
        ({"refine": 1}, "whose grid is refined"),
        ({"forces": (SimpleNamespace(input=1),)}, "which has no such input, or one of another course"),
    ],
)
def test_a_phase_before_that_cannot_act_again_is_refused(change: dict[str, Any], finding: str) -> None:
    assert finding in explain(make(**change), make("second"))


def test_polynomials_are_read_by_as_many_points() -> None:
    """Points of the phase after read polynomials of the phase before, of at most their degree, exactly."""
    first, second = make(inputs="polynomial", degree=3), make("second", inputs="polynomial", degree=3)
    assert explain(first, second) == ""
    assert explain(make(inputs="polynomial", degree=2), second) == ""
    assert "where the degree is 3, and here 2" in explain(first, make("second", inputs="polynomial", degree=2))
    given, asked = (schemes.build(schemes.Family.RADAU, 3).points for _ in range(2))
    E = _read(first.problem, second.problem, (0.25, 0.5, 2.0))
    polynomial = np.polynomial.Polynomial([1.0, -2.0, 3.0])
    assert E @ polynomial(2.0 * given) == pytest.approx(polynomial(0.25 + 0.5 * asked), rel=1e-13)
    assert np.array_equal(_read(first.problem, second.problem, (0.0, 2.0, 2.0)), np.eye(3))
    assert np.array_equal(_read(first.problem, second.problem, (1e-12, 2.0, 2.0)), np.eye(3))  # rounding apart
    assert np.array_equal(_read(make().problem, second.problem, (0.0, 1.0, 2.0)), np.ones((1, 1)))


def test_variables_of_a_phase_begin_at_its_offset() -> None:
    """Values of an interval are one constant, or one for each point; inputs that expressions give have none."""
    half = make(forces=(SimpleNamespace(input=0),))
    extras = SimpleNamespace(
        free=(1,),  # of z and x, by x alone
        controls=np.array([[20, 30], [21, 31]]),
        point_controls=np.array([[[40, 50], [41, 51]], [[42, 52], [43, 53]]]),
        states=np.array([[60], [61], [62]]),
    )
    inputs, points = np.array([[10], [11]]), np.array([[[70], [71]], [[72], [73]]])
    layout: Any = SimpleNamespace(extras=extras, inputs=inputs, point_inputs=points)
    own: Any = SimpleNamespace(layout=layout)
    placed = Placed(half, own, 100)
    assert placed.find_values(SHIFT).tolist() == [[110], [111]]
    assert placed.find_values(Shift("control", "aim", "", 0, 1, True)).tolist() == [[130], [131]]
    assert placed.find_values(Shift("state", "steer", "slope", 0, 1, True)).tolist() == [[120], [121]]
    assert [placed.find_state(Shift("state", "steer", "slope", 0, 1, True), k) for k in range(3)] == [160, 161, 162]
    varying = Placed(make(forces=(SimpleNamespace(input=0),), inputs="polynomial"), own, 100)
    assert varying.find_values(SHIFT).tolist() == [[170, 171], [172, 173]]
    assert varying.find_values(Shift("control", "aim", "", 0, 1, True)).tolist() == [[150, 151], [152, 153]]
