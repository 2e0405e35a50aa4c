"""Inputs of motions by hand: pieces of held and recorded inputs, sampled feedback, expressions, slopes of laws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.expressions import ExpressionError, parse
from mbsrun.quantities import Quantity
from mbsrun.simulation.drive import (
    Drive,
    DriveError,
    Piece,
    control,
    cut,
    differentiate,
    express,
    follow_polynomials,
    hold,
    hold_steps,
    measure,
)

Array = NDArray[np.float64]
Q, QD = np.array([2.0, 3.0]), np.array([-1.0, 0.5])


class Bare:
    """Kernels of a model with inputs, which may have the time as the last one; sensors see q and qd."""

    def __init__(self, inputs: tuple[str, ...] = ("u",), reads_time: bool = False) -> None:
        self.manifest = self
        self.inputs, self.reads_time = inputs, reads_time

    def __call__(self, name: str, **state: Array) -> Mapping[str, Array]:
        q = state["q"]
        if name == "sensors":
            return {"position": np.stack((q, 10 * q, 100 * q), axis=1)}
        return {"v": np.stack((q, state["qd"], q), axis=1), "omega": np.stack((q, q, state["qd"]), axis=1)}


def play(drive: Drive, end: float, kernels: Any = None) -> list[Piece]:
    return list(drive.play(kernels or Bare(), end, lambda: (Q, QD)))


def test_steps_hold_their_values_from_one_time_to_the_next() -> None:
    drive = hold_steps([0, 0.5, 2], [[1.0, 2], [3, 4]])
    assert [(x.start, x.end, x.is_constant) for x in drive.pieces] == [(0, 0.5, True), (0.5, 2, True)]
    assert [x.at(9.0).tolist() for x in drive.pieces] == [[1, 2], [3, 4]]
    assert drive.pieces[1].values(np.zeros(3)).tolist() == [[3, 4]] * 3
    assert (drive.end, hold([1.0]).end, Drive(control=lambda *_: np.zeros((1, 1))).end) == (2, np.inf, np.inf)
    assert [(x.start, x.end) for x in drive.until(1.0)] == [(0, 0.5), (0.5, 1.0)]
    assert [(x.start, x.end) for x in drive.until(0.5)] == [(0, 0.5)]
    assert [(x.start, x.end) for x in play(drive, 5.0)] == [(0, 0.5), (0.5, 2)]


@pytest.mark.parametrize(
    ("times", "values"),
    [
        ([0, 1, 2], [1.0, 2]),
        ([0, 1], [[1.0], [2]]),
        ([0, 1, 2, 3], [[1.0], [2]]),
        ([1e-9, 1, 2], [[1.0], [2]]),
        ([0, 1, 1], [[1.0], [2]]),
        ([0, 2, 1], [[1.0], [2]]),
    ],
)
def test_steps_need_times_that_increase_from_0_on(times: list[float], values: list[Any]) -> None:
    with pytest.raises(ValueError, match="one more than values"):
        hold_steps(times, values)


def test_polynomials_go_through_their_nodes() -> None:
    """Parabolas are found again between the nodes, each in its own piece."""
    nodes = np.array([[0.0, 0.5, 1.0], [1.0, 1.2, 2.0]])
    drive = follow_polynomials([0, 1, 2], nodes, np.stack((nodes**2, 1 - nodes), axis=2))
    assert [(x.start, x.end, x.is_constant) for x in drive.pieces] == [(0, 1, False), (1, 2, False)]
    for piece, time in zip(drive.pieces, (0.3, 1.7), strict=True):
        assert piece.at(time) == pytest.approx([time**2, 1 - time], rel=1e-12)


def test_pieces_are_cut_at_the_times_within_them() -> None:
    law = control(lambda t, q, qd: [t + q[0] + qd[1]])
    (whole,) = play(law, 2.0)
    found = list(cut(iter([whole]), [1.5, 0.5, 0.5, 0.0, 2.0, 3.0, -1.0]))
    assert [(x.start, x.end) for x in found] == [(0.0, 0.5), (0.5, 1.5), (1.5, 2.0)]
    assert all(x.law is whole.law for x in found)


def test_feedback_acts_at_once_or_is_held_for_its_period() -> None:
    """Held inputs are computed once, of the state that is reached; the last period ends with the motion."""
    (piece,) = play(control(lambda t, q, qd: [t, q[0], qd[1]]), 0.25)
    assert (piece.start, piece.end, piece.is_constant) == (0.0, 0.25, False)
    assert piece.at(0.125, Q, QD).tolist() == [0.125, 2.0, 0.5]
    both = piece.follow(np.array([0.0, 1.0]), np.array([Q, 2 * Q]), np.array([QD, QD]))
    assert both.tolist() == [[0.0, 2.0, 0.5], [1.0, 4.0, 0.5]]
    with pytest.raises(AssertionError, match="no value over time alone"):
        piece.values(np.zeros(1))
    states, calls = iter([(k * Q, QD) for k in range(9)]), list[float]()

    def law(t: float, q: Array, _: Array) -> list[float]:
        calls.append(t)
        return [q[0]]

    found = [
        (x.start, x.end, x.is_constant, x.at(99.0).tolist())
        for x in control(law, 0.1).play(Bare(), 0.25, lambda: next(states))  # type: ignore[arg-type]
    ]
    assert found == [(0.0, 0.1, True, [0.0]), (0.1, 0.2, True, [2.0]), (0.2, 0.25, True, [4.0])]
    assert calls == [0.0, 0.1, 0.2]


def test_a_motion_of_whole_periods_has_no_short_one_by_rounding() -> None:
    drive = control(lambda *_: [1.0], 0.1)
    assert [len(play(drive, end)) for end in (0.3, 3 * 0.1, 0.3 + 1e-9, 0.1, 0.05)] == [3, 3, 4, 1, 1]


def test_the_time_is_the_last_input_where_forces_read_it() -> None:
    """In place of a recorded one, for inputs over time and for feedback; no such input is constant."""
    kernels = Bare(("u", "w", "t"), reads_time=True)
    for drive in (hold([1.0, 2.0]), hold([1.0, 2.0, 77.0])):
        (piece,) = play(drive, 3.0, kernels)
        assert (piece.start, piece.end, piece.is_constant, piece.law) == (0.0, 3.0, False, None)
        assert piece.at(0.5).tolist() == [1.0, 2.0, 0.5]
    (piece,) = play(control(lambda _, q, qd: [q[0], qd[0]]), 3.0, kernels)
    assert piece.at(0.5, Q, QD).tolist() == [2.0, -1.0, 0.5]
    (piece,) = play(hold([1.0, 2.0]), 3.0)
    assert piece.is_constant


def test_periods_are_positive_numbers() -> None:
    for period in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="must be a positive number"):
            control(lambda *_: [1.0], period)
    assert control(lambda *_: [1.0], 1e-9).period == 1e-9
    assert control(lambda *_: [1.0]).period is None


@pytest.mark.parametrize("value", [[[1.0]], [np.nan], [1.0, np.inf]])
def test_a_control_returns_a_row_of_finite_numbers(value: Any) -> None:
    (piece,) = play(control(lambda t, *_: [1.0] if t < 1 else value), 9.0)
    times = np.array([0.5, 2.5])
    with pytest.raises((DriveError, ValueError)) as error:
        piece.follow(times, np.array([Q, Q]), np.array([QD, QD]))
    assert "at t = 2.5 s" in str(error.value)


def test_slopes_of_a_law_are_its_derivatives() -> None:
    """u = (sin q1 qd2, t q2^2, qd1 + qd2): by q and by qd, at three times and states."""

    def law(t: Array, q: Array, qd: Array) -> Array:
        return np.stack((np.sin(q[:, 0]) * qd[:, 1], t * q[:, 1] ** 2, qd[:, 0] + qd[:, 1]), axis=1)

    rng = np.random.default_rng(1)
    t, q, qd = rng.normal(size=3), 10 * rng.normal(size=(3, 2)), rng.normal(size=(3, 2))
    by_q, by_qd = differentiate(law, t, q, qd)
    zero, one = np.zeros(3), np.ones(3)
    expected_q = np.array([[np.cos(q[:, 0]) * qd[:, 1], zero], [zero, 2 * t * q[:, 1]], [zero, zero]])
    expected_qd = np.array([[zero, np.sin(q[:, 0])], [zero, zero], [one, one]])
    np.testing.assert_allclose(by_q, expected_q.transpose(2, 0, 1), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(by_qd, expected_qd.transpose(2, 0, 1), rtol=1e-8, atol=1e-8)


def say(*texts: str, period: float | None = None) -> Drive:
    quantities = {"q": Quantity("q", 1), "qd": Quantity("qd", 0)}
    return express([parse(x) for x in texts], [f"u{k}" for k in range(len(texts))], {"k": 5.0}, quantities, period)


def test_expressions_of_time_are_inputs_and_expressions_of_the_state_are_feedback() -> None:
    (piece,) = say("k", "2").pieces
    assert (piece.start, piece.end, piece.is_constant) == (0.0, np.inf, True)
    (piece,) = say("k", "3*t").pieces
    assert not piece.is_constant
    assert piece.at(2.0).tolist() == [5.0, 6.0]
    assert piece.values(np.array([1.0, 2.0])).tolist() == [[5.0, 3.0], [5.0, 6.0]]
    drive = say("k*q + t", "qd")
    assert (drive.pieces, drive.period) == ((), None)
    (piece,) = play(drive, 4.0)
    assert piece.at(0.5, Q, QD).tolist() == [15.5, -1.0]
    assert piece.follow(np.zeros(2), np.array([Q, 2 * Q]), np.array([QD, QD])).tolist() == [[15, -1], [30, -1]]
    assert [x.at(0.0).tolist() for x in play(say("t", period=0.5), 1.0)] == [[0.0], [0.5]]
    assert say().pieces[0].values(np.zeros(2)).shape == (2, 0)
    with pytest.raises(ExpressionError, match="nobody"):
        say("nobody + 1")


@pytest.mark.parametrize("times", [[0.0], [1.0, 0.0, 0.0]])
def test_an_input_without_a_value_is_named_with_its_first_time(times: list[float]) -> None:
    (piece,) = say("1", "1/t").pieces
    with pytest.raises(DriveError, match="the input of u1 has no finite value at t = 0 s; mend its expression"):
        piece.values(np.array(times))


def test_quantities_are_measured_by_their_kinds() -> None:
    q, qd = np.array([Q, 2 * Q]), np.array([QD, 2 * QD])
    used = {
        "a": Quantity("q", 1),
        "b": Quantity("qd", 0),
        "x": Quantity("position", 1),
        "y": Quantity("v", 3),
        "z": Quantity("omega", 4),
    }
    found = measure(used, Bare(), q, qd)  # type: ignore[arg-type]
    assert {name: x.tolist() for name, x in found.items()} == {
        "a": [3.0, 6.0],
        "b": [-1.0, -2.0],
        "x": [20.0, 40.0],
        "y": [3.0, 6.0],
        "z": [3.0, 6.0],
    }
    assert measure({"a": used["a"]}, None, q, qd)["a"].tolist() == [3.0, 6.0]  # type: ignore[arg-type]
