"""Motions of many states: each is the motion that the kernels' accelerations give; failures and parameters by state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbsgen.pipeline import Options, generate
from mbsrun import load, many, rollout
from mbsrun.external import Mechanism
from mbsrun.kernel import ArgumentError, Array

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Any:
    def made(name: str, functions: tuple[str, ...] = ("exp2", "energy"), **options: Any) -> Mechanism:
        folder = tmp_path_factory.mktemp("model") / name
        generate(MODELS / f"{name}.yaml", folder, Options(functions=functions, derivatives=0, **options))
        return load(folder)

    return made


@pytest.fixture(scope="module")
def cart(make: Any) -> Mechanism:
    made: Mechanism = make("cart_pole", runtime=True)
    return made


def differentiate(cart: Mechanism, force: float) -> Any:
    """Return the right-hand side of one state."""

    def rates(_: float, x: Array) -> Array:
        return np.hstack([x[2:], cart.exp2(q=x[:2], qd=x[2:], u=[force])["qdd"]])

    return rates


@pytest.mark.parametrize("states", [1, 5, 70])
def test_motions_are_those_of_an_integrator_with_a_tolerance(cart: Mechanism, states: int) -> None:
    rng = np.random.default_rng(1)
    q, qd, u = (rng.normal(size=(states, k)) for k in (2, 2, 1))
    found = rollout(cart, q, qd, step=1e-3, steps=500, every=100, inputs={"u": u})
    assert (found.q.shape, found.t.tolist()) == ((states, 6, 2), pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5]))
    for k in range(min(states, 5)):
        start = np.hstack([q[k], qd[k]])
        exact = solve_ivp(differentiate(cart, u[k, 0]), (0, 0.5), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(np.hstack([found.q[k, -1], found.qd[k, -1]]), exact, rtol=0, atol=1e-9)


def test_the_order_of_the_methods(make: Any) -> None:
    """Half the step, a sixteenth of the error; by Euler's method half of it."""
    pendulum = make("double_pendulum")
    ends = {
        (method, steps): rollout(pendulum, [0.5, 1.0], [0.0, 0.0], step=0.2 / steps, steps=steps, method=method).q[
            0, -1
        ]
        for method, counts in (("rk4", (20, 40, 640)), ("euler", (2000, 4000)))
        for steps in counts
    }
    exact = ends["rk4", 640]
    errors = {key: np.abs(end - exact).max() for key, end in ends.items()}
    assert errors["rk4", 20] / errors["rk4", 40] == pytest.approx(16, rel=0.1)
    assert errors["euler", 2000] / errors["euler", 4000] == pytest.approx(2, rel=0.05)


def test_inputs_of_each_step(cart: Mechanism) -> None:
    """They are constant in a step, and may be the same for all states."""
    u = np.random.default_rng(2).normal(size=(1, 12, 1))
    found = rollout(cart, np.zeros((9, 2)), [0.0, 0.0], step=0.01, steps=12, inputs={"u": u})
    q, qd = np.zeros(2), np.zeros(2)
    for k in range(12):
        one = rollout(cart, q, qd, step=0.01, steps=1, inputs={"u": u[0, k]})
        q, qd = one.q[0, -1], one.qd[0, -1]
    np.testing.assert_allclose(found.q[:, -1], np.tile(q, (9, 1)), rtol=0, atol=1e-14)


def test_parameters_of_each_state(cart: Mechanism) -> None:
    name = next(iter(cart.parameters))
    values = cart.parameters[name] * np.linspace(0.8, 1.2, 20)
    setting: Any = {"step": 0.01, "steps": 50, "inputs": {"u": [1.0]}}
    found = rollout(cart, [0.0, 0.3], [0.0, 0.0], parameters={name: values}, **setting)
    for k in (0, 7, 19):
        alone = rollout(cart.with_parameters(**{name: values[k]}), [0.0, 0.3], [0.0, 0.0], **setting)
        np.testing.assert_allclose(found.q[k], alone.q[0], rtol=0, atol=1e-13)
    assert np.ptp(found.q[:, -1], axis=0).max() > 1e-3


def test_threads_change_no_bit(cart: Mechanism) -> None:
    q = np.random.default_rng(3).normal(size=(203, 2))
    one, two = (rollout(cart, q, [0.0, 0.0], step=0.01, steps=20, threads=k) for k in (1, 2))
    np.testing.assert_array_equal(one.q, two.q)


def test_a_motion_that_fails_ends_alone(cart: Mechanism) -> None:
    """It is no number from then on, and has a status; the others are as without it."""
    q = np.random.default_rng(4).normal(size=(40, 2))
    qd = np.zeros((40, 2))
    good = rollout(cart, q, qd, step=0.01, steps=30)
    assert not good.status.any()
    qd[[3, 20]] = np.nan
    found = rollout(cart, q, qd, step=0.01, steps=30)
    left = np.setdiff1d(np.arange(40), [3, 20])
    np.testing.assert_allclose(found.q[left], good.q[left], rtol=0, atol=1e-12)
    assert np.isnan(found.q[[3, 20], 1:]).all()


def test_lanes_are_used(cart: Mechanism, monkeypatch: pytest.MonkeyPatch) -> None:
    """With them and without, motions agree to rounding."""
    q = np.random.default_rng(5).normal(size=(64, 2))
    lanes = rollout(cart, q, [0.0, 0.0], step=0.01, steps=50)
    assert cart.choose_loop("exp2", 64 * 50)[1] is not None
    monkeypatch.setattr(many, "FEWEST", 10**9)
    np.testing.assert_allclose(rollout(cart, q, [0.0, 0.0], step=0.01, steps=50).q, lanes.q, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"step": 0.0}, "step: 0.0 s; give a positive number"),
        (
            {"steps": 0, "threads": 0},
            "steps: 0; give a whole number, 1 or more\n.*threads: 0; give a whole number, 1 or more",
        ),
        ({"steps": 5.5}, "steps: 5.5; give a whole number, 1 or more"),
        ({"inputs": np.zeros(2)}, "inputs: a value of type ndarray; give arrays by name"),
        ({"method": "rk5"}, "method: 'rk5'; there are euler, rk4"),
        ({"inputs": {"v": [1.0]}}, "exp2 has no input 'v'; there are u"),
        ({"inputs": {"u": [1.0, 2.0]}}, r"u: shape \(2,\) given, \(1,\), \(states, 1\) or \(states, 5, 1\) expected"),
        ({"inputs": {"u": np.zeros((3, 1))}}, r"arrays are of \[2, 3\] states"),
        ({"parameters": {"mass": 1.0}}, "no parameter mass; there are "),
    ],
)
def test_misuse_is_told(cart: Mechanism, changes: dict[str, Any], finding: str) -> None:
    setting = {"step": 0.01, "steps": 5} | changes
    with pytest.raises(ArgumentError, match=f"(?s){finding}"):
        rollout(cart, np.zeros((2, 2)), np.zeros((2, 2)), **setting)


def test_masked_states_are_refused(cart: Mechanism) -> None:
    states, hidden = np.zeros((2, 2)), np.ma.masked_greater(np.eye(2), 0.5)
    for q, qd in ((hidden, states), (states, hidden)):
        with pytest.raises(ArgumentError, match=r"^qd?: some entries are masked"):
            rollout(cart, q, qd, step=0.01, steps=5)


def test_closed_loops_are_left_to_the_simulator(make: Any) -> None:
    with pytest.raises(ArgumentError, match="closed loops and driven joints move by `mbsrun simulate` alone"):
        rollout(make("four_bar"), np.zeros(3), np.zeros(3), step=0.01, steps=5)


def test_bodies_turn_by_quaternions(make: Any) -> None:
    """Against an integrator with a tolerance; quaternions keep their length; wheels' torques differ by state."""
    satellite = make("satellite", functions=("exp2", "rates"))
    rng = np.random.default_rng(7)
    q = rng.normal(size=(20, 5))
    q[:, :4] /= np.linalg.norm(q[:, :4], axis=1, keepdims=True)
    qd, u = rng.normal(size=(20, 4)), rng.normal(size=(20, 4))
    found = rollout(satellite, q, qd, step=1e-3, steps=400, every=400, inputs={"u": u})
    assert not found.status.any()
    np.testing.assert_allclose(np.linalg.norm(found.q[:, -1, :4], axis=1), 1.0, rtol=0, atol=1e-15)

    def rates(_: float, x: Array, u: Array) -> Array:
        state = {"q": x[:5], "qd": x[5:]}
        return np.hstack([satellite.rates(**state)["rate"], satellite.exp2(u=u, **state)["qdd"]])

    for k in (0, 13):
        start = np.hstack([q[k], qd[k]])
        exact = solve_ivp(rates, (0, 0.4), start, "DOP853", rtol=1e-12, atol=1e-12, args=(u[k],)).y[:, -1]
        np.testing.assert_allclose(np.hstack([found.q[k, -1], found.qd[k, -1]]), exact, rtol=0, atol=1e-9)
