"""First guesses by hand: polynomials of motions, bumps, and the guesses of states that a problem adds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mbsrun import load
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing import state_guess
from mbsrun.ocp.guessing.guess import Pose, balance, bump, find_inputs, interpolate, rest
from mbsrun.ocp.guessing.state_guess import _choose_ends, _find_start, _guess, _interpolate, _spread, complete
from mbsrun.ocp.problem.problem import Bounds, GuessOptions, Problem, State
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

Array = NDArray[np.float64]
SCHEME = schemes.build(Family.RADAU, 2)
INF = np.inf


def moving(**changes: Any) -> Problem:
    """Push for 2 s from q = 0.5 at a speed of 3."""
    return replace(push(4), horizon=2.0, start_q=(0.5,), start_qd=(3.0,), **changes)


def test_a_guessed_motion_is_the_quintic_between_its_ends() -> None:
    """With the velocity of the start, at rest at the end, and without acceleration at both."""
    found = interpolate(moving(), SCHEME, np.array([-1.0]))
    conditions = np.zeros((6, 6))
    for k in range(6):
        unit = Polynomial(np.eye(6)[k])
        conditions[:, k] = [unit.deriv(m)(t) if m else unit(t) for t in (0.0, 2.0) for m in range(3)]
    p = Polynomial(np.linalg.solve(conditions, [0.5, 3.0, 0, -1.0, 0, 0]))
    assert found.t == pytest.approx([0, 0.5, 1, 1.5, 2])
    for times, values, order in (
        (found.t, found.q, 0),
        (found.t, found.qd, 1),
        (found.point_t, found.point_q, 0),
        (found.point_t, found.point_qd, 1),
        (found.point_t, found.point_qdd, 2),
    ):
        assert values[..., 0] == pytest.approx((p.deriv(order) if order else p)(times), abs=1e-12)
    assert found.u.tolist() == [[0.0]] * 4
    straight = interpolate(moving(guess=GuessOptions(motion="line")), SCHEME, np.array([-1.0]))
    assert straight.q[:, 0] == pytest.approx(0.5 - 0.75 * straight.t)
    assert straight.point_qd == pytest.approx(np.full((4, 2, 1), -0.75))
    assert straight.point_qdd == pytest.approx(np.zeros((4, 2, 1)), abs=1e-14)
    still = rest(moving(guess=GuessOptions(motion="line")), SCHEME)
    assert (still.q == 0.5).all()
    assert (still.qd == 0).all()


def test_bumps_leave_both_ends_as_they_are() -> None:
    """One of a height up to 1 at the middle, and one that goes there and back; rates are their derivatives."""
    motion = interpolate(moving(), SCHEME, np.array([-1.0]))
    motion = replace(motion, q=np.hstack((motion.q, motion.q)), qd=np.hstack((motion.qd, motion.qd)),
                     **{name: np.concatenate([getattr(motion, name)] * 2, axis=2)
                        for name in ("point_q", "point_qd", "point_qdd")})  # fmt: skip
    a, b = np.random.default_rng(3).uniform(-1, 1, (1, 2))[0]
    found = bump(motion, [1], np.random.default_rng(3))
    s = Polynomial([0, 0.5])
    shape = a * 64 * s**3 * (1 - s) ** 3 + b * 64 * s**3 * (1 - s) ** 3 * (4 * s - 2)
    assert found.q[:, 0].tolist() == motion.q[:, 0].tolist()
    assert found.q[:, 1] - motion.q[:, 1] == pytest.approx(shape(motion.t), abs=1e-13)
    assert found.qd[:, 1] - motion.qd[:, 1] == pytest.approx(shape.deriv()(motion.t), abs=1e-13)
    assert found.point_q[..., 1] - motion.point_q[..., 1] == pytest.approx(shape(motion.point_t), abs=1e-13)
    assert found.point_qd[..., 1] - motion.point_qd[..., 1] == pytest.approx(shape.deriv()(motion.point_t), abs=1e-13)
    assert found.point_qdd[..., 1] - motion.point_qdd[..., 1] == pytest.approx(
        shape.deriv(2)(motion.point_t), abs=1e-12
    )
    narrow = {name: getattr(motion, name)[..., :1] for name in ("qd", "point_qd", "point_qdd")}
    with pytest.raises(ValueError, match="a bump on a quaternion"):
        bump(replace(motion, **narrow), [0], np.random.default_rng(3))


def test_inputs_are_means_of_forces_within_their_bounds() -> None:
    """Of a mass of 1 kg: its accelerations; at rest 0; what a bound cuts is cut."""
    plant, problem = double_integrator(), moving(bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((-2.0, 1.0),)))
    motion = interpolate(problem, SCHEME, np.array([-1.0]))
    means = motion.point_qdd[..., 0].mean(axis=1)
    assert means.min() < -2 < means.max()
    assert balance(motion, problem, plant, "dynamic").u[:, 0] == pytest.approx(np.clip(means, -2, 1))
    assert balance(motion, problem, plant, "static").u == pytest.approx(np.zeros((4, 1)), abs=1e-14)
    assert balance(motion, problem, plant, "zero").u.tolist() == [[0.0]] * 4
    one = np.array([[7.0]])
    assert find_inputs(plant, one, one, one) == pytest.approx(np.array([[7.0]]))


def test_a_pose_as_near_as_a_hundredth_of_a_millimetre_is_reached() -> None:
    for distance, is_reached in ((1e-5, True), (1.01e-5, False)):
        assert Pose(np.zeros(1), distance, True).is_reached is is_reached


def state(rate: str, start: tuple[float, float] = (0.0, 0.0), **given: Any) -> State:
    return State("s", rate, start=start, **given)


@pytest.mark.parametrize(
    ("given", "ends"),
    [
        (state("1"), None),
        (state("1", guess=3.0), (3.0, 3.0)),
        (state("1", guess=(3.0, 4.0)), (3.0, 4.0)),
        (state("1", (1.0, 1.0), end=(2.0, 2.0)), (1.0, 2.0)),
        (state("1", (1.0, 1.5), end=(2.0, 2.0)), None),
        (state("1", (1.0, 1.0), end=(2.0, 2.5)), None),
    ],
)
def test_a_state_goes_straight_where_both_ends_are_known(given: State, ends: tuple[float, float] | None) -> None:
    assert _choose_ends(given) == ends


@pytest.mark.parametrize(
    ("start", "bounds", "first"),
    [
        ((-INF, INF), (-INF, INF), 0.0),
        ((2.0, 3.0), (-INF, INF), 2.0),
        ((-3.0, -2.0), (-INF, INF), -2.0),
        ((-INF, INF), (0.5, 9.0), 0.5),
        ((-INF, INF), (-9.0, -0.5), -0.5),
        ((1.0, 2.0), (-9.0, 9.0), 1.0),
    ],
)
def test_a_start_is_the_nearest_to_0(start: tuple[float, float], bounds: tuple[float, float], first: float) -> None:
    assert _find_start(state("1", start, bounds=bounds)) == first


def guess(*states: State, t: Array | None = None, **changes: Any) -> Array:
    """Guess states along the motion of a mass, at some times."""
    plant = double_integrator()
    problem = moving(states=states, **changes)
    motion = complete(interpolate(moving(), SCHEME, np.array([-1.0]), plant), moving(), plant)
    times = np.unique(np.concatenate((motion.t, motion.point_t.ravel()))) if t is None else t
    return _guess(problem.every_state, times, motion, problem, plant)


TIMES = np.array([0.0, 1 / 6, 0.5, 2 / 3, 1.0, 7 / 6, 1.5, 5 / 3, 2.0])


def test_states_are_integrated_from_their_start_along_the_motion() -> None:
    """By LSODA at 1e-4: s' = qd, t and s; in bounds; a pole on the way leaves the start."""
    found = guess(state("qd_slide", (1.0, 1.0)), replace(state("t"), name="r"))
    motion = interpolate(moving(), SCHEME, np.array([-1.0]))
    speeds = [float(x) for pair in zip(motion.qd[:, 0], [*motion.point_qd[:, 0, 0], 0.0], strict=True) for x in pair][
        :-1
    ]
    ways = np.concatenate(([0.0], np.cumsum(np.diff(TIMES) * (np.array(speeds[1:]) + speeds[:-1]) / 2)))
    assert found[:, 0] == pytest.approx(1.0 + ways, abs=1e-3)  # velocities are straight from point to point
    assert found[:, 1] == pytest.approx(TIMES**2 / 2, abs=1e-3)
    assert guess(state("-s", (2.0, 2.0)))[:, 0] == pytest.approx(2 * np.exp(-TIMES), abs=1e-3)
    assert guess(state("t", bounds=(0.0, 0.5)))[:, 0] == pytest.approx(np.minimum(TIMES**2 / 2, 0.5), abs=1e-3)
    assert guess(state("s**2", (1.0, 1.0)))[:, 0].tolist() == [1.0] * 9
    assert guess(state("1/t", (3.0, 3.0)))[:, 0].tolist() == [3.0] * 9
    assert guess(state("1", guess=(3.0, 5.0)))[:, 0] == pytest.approx(3 + TIMES)
    assert guess(state("T"))[:, 0] == pytest.approx(2 * TIMES, abs=1e-3)


def test_rates_are_computed_so_often_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state_guess, "MAX_CALLS", 3)
    assert guess(state("-s", (2.0, 2.0)))[:, 0].tolist() == [2.0] * 9


def test_values_at_points_are_read_between_them() -> None:
    motion = interpolate(moving(), SCHEME, np.array([-1.0]))
    points = (5 * motion.point_t)[..., None]
    t = np.array([1 / 6, 0.4, 1.9, 2.0])
    assert _spread(points, motion, t)[:, 0] == pytest.approx(5 * t)
    assert _spread(points, motion, np.array([0.0]))[0, 0] == pytest.approx(5 / 6)
    assert _spread(points[..., :0], motion, t).shape == (4, 0)
    values, times = np.array([[0.0, 1.0], [2.0, 1.0], [2.0, 5.0]]), np.array([0.0, 1.0, 3.0])
    for time, expected in ((0.0, [0, 1]), (0.25, [0.5, 1]), (1.0, [2, 1]), (2.0, [2, 3]), (3.0, [2, 5]), (4.0, [2, 7])):
        assert _interpolate(time, times, values)[0] == pytest.approx(expected)


def test_inputs_of_a_guess_hold_against_given_wrenches(tmp_path: Path) -> None:
    """A wind of 3 N/s blows a mass that is to rest: the input is against its mean over each interval's points."""
    model, file = tmp_path / "kite.yaml", tmp_path / "kite.ocp.yaml"
    model.write_text(
        "name: kite\ngravity: [0, 0, 0]\n"
        "bodies:\n  - name: kite\n    joint: {name: x, type: prismatic, axis: x}\n"
        "    mass: 2\n    com: [0, 0, 0]\n    inertia: [1, 1, 1]\n"
        "wrenches: [{name: wind, body: kite, position: [0, 0, 0], frame: base, force: input}]\n"
    )
    file.write_text(
        "model: kite.yaml\nhorizon: 1\nintervals: 4\ncost: {inputs: 1}\nstart: {pose: {x: 0}}\nend: {pose: {x: 0}}\n"
        "wrenches: {wind: {force: [3*t, 0, 0]}}\n"
    )
    problem, plant = read_problem(file, load)
    t, point_t = problem.grid.times(1.0, schemes.build(problem.family, problem.degree).points)
    points, rest = np.zeros((*point_t.shape, 1)), np.zeros((5, 1))
    motion = Trajectory(t, rest, rest, np.zeros((4, 1)), point_t, points, points, points)
    assert balance(motion, problem, plant, "dynamic").u[:, 0] == pytest.approx(-3 * point_t.mean(axis=1))
