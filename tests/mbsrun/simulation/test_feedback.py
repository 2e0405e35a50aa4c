"""Inputs that follow the state: as expressions and as functions, at once and sampled, by every method."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import parse
from mbsrun import Mechanism, cli
from mbsrun.quantities import list_quantities
from mbsrun.simulation import METHODS, Formulation, Settings, control, simulate
from mbsrun.simulation.drive import Drive, differentiate, express, hold
from mbsrun.simulation.statement import read_statement

SPRING, DAMPER = 40.0, 3.0
START = [1.0, 0.1, 0.0], [0.5, -0.2, 0.3]
STEPS = {
    "euler": 1e-3,
    "symplectic-euler": 1e-3,
    "rk4": 1e-2,
    "generalized-alpha": 5e-3,
    "radau-iia": 1e-2,
    "gauss": 1e-2,
}


def say(bench: Mechanism, *texts: str, period: float | None = None) -> Drive:
    """Write the bench's inputs as expressions: the slider's force, and the force on the bob along x, y, z."""
    expressions = [parse(text) for text in (*texts, *["0"] * (4 - len(texts)))]
    return express(
        expressions, ["slider", "x", "y", "z"], {"k": SPRING, "c": DAMPER}, list_quantities(bench.manifest), period
    )


@pytest.mark.parametrize("method", METHODS)
def test_a_feedback_moves_as_a_spring_and_a_damper_in_the_model_do(bench: Mechanism, method: str) -> None:
    """The same equations by two ways: motions differ by rounding, and by the tolerance of adaptive methods.

    Except symplectic Euler and `moreau`, which take inputs at a step's start and dampers with the step's velocity:
    their errors are some step times the acceleration's change.
    """
    settings = Settings(0.5, method, step=STEPS.get(method, 1e-3))
    inside = simulate(bench.with_parameters(k=SPRING, c=DAMPER), hold(np.zeros(4)), *START, settings)
    bare = bench.with_parameters(k=0.0, c=0.0)
    outside = simulate(bare, say(bench, "-k*q_slider - c*qd_slider"), *START, settings)
    assert outside.is_complete, outside.halt
    bounds = {
        "symplectic-euler": 2e-3,
        "moreau": 2e-3,
        "dop853": 1e-7,
        "rk45": 1e-7,
        "lsoda": 1e-6,
        "radau": 1e-7,
        "bdf": 1e-6,
    }
    bound = bounds.get(method, 1e-11)
    assert np.abs(inside.q[-1] - outside.q[-1]).max() < bound
    assert np.abs(inside.qd[-1] - outside.qd[-1]).max() < 20 * bound
    assert np.allclose(
        outside.inputs[:, 0], -SPRING * outside.q[:, 1] - DAMPER * outside.qd[:, 1], rtol=1e-12, atol=1e-12
    )
    assert outside.energy is not None
    assert inside.energy is not None
    assert np.allclose(inside.energy.work, outside.energy.work, atol=2000 * bound if "euler" in method else 100 * bound)


@pytest.mark.parametrize("formulation", Formulation)
@pytest.mark.parametrize("method", ["rk4", "gauss", "generalized-alpha"])
def test_a_feedback_is_the_same_in_every_formulation(bench: Mechanism, method: str, formulation: Formulation) -> None:
    """To the rest of Newton's method."""
    drive = say(bench, "-30*q_slider*(1 + q_slider**2) + sin(t)", "-2*qd_bob", "0", "1")
    ends = [
        simulate(bench, drive, *START, Settings(0.2, method, f, step=1e-2)).q[-1]
        for f in (Formulation.EXP2, formulation)
    ]
    assert np.abs(ends[0] - ends[1]).max() < 1e-11


ORDERS = {"euler": 1, "rk4": 4, "generalized-alpha": 2, "radau-iia": 3, "gauss": 4, "symplectic-euler": 1}


@pytest.mark.parametrize(("method", "order"), ORDERS.items())
def test_a_smooth_feedback_costs_no_order(bench: Mechanism, method: str, order: int) -> None:
    """Halving the step divides the error by 2^order, to a fifth of an order; the law is nonlinear in time and state."""
    drive = say(bench, "-60*tanh(3*q_slider) - 2*qd_slider + sin(5*t)*qd_bob")
    bare = bench.with_parameters(k=0.0, c=0.0)

    def end(method: str, **options: Any) -> Any:
        motion = simulate(bare, drive, *START, Settings(0.4, method, **options))
        return np.concatenate((motion.q[-1], motion.qd[-1]))

    exact = end("dop853", rtol=1e-12, atol=1e-12)
    h = 2e-3 if order == 1 else 0.02
    errors = [np.abs(end(method, step=x) - exact).max() for x in (h, h / 2)]
    assert errors[1] > 1e-11, "the error must not be rounding"
    assert np.log2(errors[0] / errors[1]) >= order - 0.2


@pytest.mark.parametrize("method", ["euler", "rk4", "dop853", "radau", "gauss", "symplectic-euler"])
def test_a_sampled_control_is_held_between_its_samples(bench: Mechanism, method: str) -> None:
    """A mass under forces held for a period moves on parabolas: x' = x + v T + a T^2/2, v' = v + a T.

    Both Euler methods take a hundred steps in a period: the sums that they form instead are known, too.
    """
    period, times = 0.07, []

    def law(t: float, q: Any, qd: Any) -> list[float]:
        times.append(t)
        return [-40 * q[1] - 6 * qd[1] + t, 0, 0, 0]

    bare = bench.with_parameters(k=0.0, c=0.0)
    settings = Settings(0.5, method, step=period / 100)
    motion = simulate(bare, control(law, period), [0, 0.1, 0], [0, 0, 0], settings)
    x, v, mass = 0.1, 0.0, 0.3
    for k in range(8):
        t, h = k * period, min(period, 0.5 - k * period)
        a = (-40 * x - 6 * v + t) / mass
        steps = np.ceil(h / settings.step * (1 - 1e-12))
        half = {"euler": 1 - 1 / steps, "symplectic-euler": 1 + 1 / steps}.get(method, 1.0) / 2
        x, v = x + v * h + half * a * h * h, v + a * h
    assert motion.q[-1, 1] == pytest.approx(x, abs=1e-8 if method == "radau" else 1e-11)
    assert motion.qd[-1, 1] == pytest.approx(v, abs=1e-7 if method == "radau" else 1e-10)
    assert times == pytest.approx([k * period for k in range(8)]), "a law with a memory is called once a period"
    jumps = np.searchsorted(motion.t, [k * period for k in range(8)])
    assert len(set(motion.inputs[jumps, 0])) == 8, "the inputs that are kept follow a jump"


def test_a_period_holds_expressions_too(bench: Mechanism) -> None:
    """Over time alone, and of the state."""
    for text, law in (
        ("sin(9*t)", lambda t, *_: [np.sin(9 * t), 0, 0, 0]),
        ("-9*q_slider", lambda _, q, __: [-9 * q[1], 0, 0, 0]),
    ):
        ends = [
            simulate(bench, drive, *START, Settings(0.3, "rk4")).q[-1]
            for drive in (say(bench, text, period=0.05), control(law, 0.05))
        ]
        np.testing.assert_array_equal(*ends)


def test_expressions_know_what_sensors_measure(bench: Mechanism) -> None:
    """The bob is 1 m from its axis y: x = -sin q or sin q, z = -cos q; velocities are their rates."""
    names = [name for name in list_quantities(bench.manifest) if name[0] in "xyzv" and name != "T"]
    assert names
    rng = np.random.default_rng(4)
    q, qd, e = rng.uniform(-1, 1, (5, 3)), rng.uniform(-1, 1, (5, 3)), 1e-6
    for frame in sorted({name[2:] for name in names if name[1] == "_"}):
        for axis in "xyz":
            place, rate = (say(bench, f"{kind}{axis}_{frame}").control for kind in ("", "v"))
            assert place is not None
            assert rate is not None
            ahead, behind = (place(bench, np.zeros(5), q + s * e * qd, qd)[:, 0] for s in (1, -1))
            np.testing.assert_allclose(rate(bench, np.zeros(5), q, qd)[:, 0], (ahead - behind) / (2 * e), atol=1e-8)
    tip = bench("sensors", q=q)["position"][:, :, 0]
    first = next(frame.name for frame in bench.manifest.frames if frame.sensor)
    found = [say(bench, f"{axis}_{first}").control for axis in "xyz"]
    np.testing.assert_array_equal(np.stack([f(bench, np.zeros(5), q, qd)[:, 0] for f in found if f], axis=1), tip)


def test_a_law_is_differentiated_for_newtons_method() -> None:
    """Central differences of a polynomial of degree 2 err by rounding alone: 1e-16 / 1e-6."""

    def law(t: Any, q: Any, qd: Any) -> Any:
        return np.stack((q[:, 0] * qd[:, 1] + t, 3 * q[:, 2]), axis=1)

    rng = np.random.default_rng(5)
    t, q, qd = rng.uniform(-1, 1, 4), rng.uniform(-1, 1, (4, 3)), rng.uniform(-1, 1, (4, 3))
    by_q, by_qd = differentiate(law, t, q, qd)
    expected = np.zeros((2, 4, 2, 3))
    expected[0, :, 0, 0], expected[0, :, 1, 2], expected[1, :, 0, 1] = qd[:, 1], 3, q[:, 0]
    np.testing.assert_allclose([by_q, by_qd], expected, atol=1e-9)


def test_a_stiff_feedback_is_no_matter_for_implicit_steps(bench: Mechanism) -> None:
    """Gains that decay at 1e5 1/s, with steps of 1e-2 s: Newton's method knows the feedback."""
    bare = bench.with_parameters(k=0.0, c=0.0)
    for method in ("radau-iia", "generalized-alpha", "radau"):
        drive = say(bench, "-8e5*q_slider - 4e4*qd_slider")
        motion = simulate(bare, drive, [1, 0.01, 0], [0, 0, 0], Settings(0.5, method, step=1e-2, rho=0.0))
        assert motion.is_complete, motion.halt
        assert abs(motion.q[-1, 1] - 0.01 * np.exp(-20 * 0.5)) < 1e-4
        assert motion.effort.iterations <= 5 * motion.effort.steps


# --- what goes wrong -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [None, 0.05])
def test_a_feedback_without_a_value_ends_the_motion_with_what_was_reached(
    bench: Mechanism, period: float | None
) -> None:
    """The slider moves through 0 after some time, where the law is infinite or worse."""
    drive = say(bench, "-sqrt(q_slider)", period=period)
    motion = simulate(bench.with_parameters(k=0.0), drive, [0, 0.1, 0], [0, -0.5, 0], Settings(1.0, "rk4", step=1e-2))
    assert motion.halt is not None
    assert "the input of slider has no finite value at t = 0." in str(motion.halt)
    assert 0 < motion.halt.time < 1 or period is None
    assert np.isfinite(motion.inputs).all()


@pytest.mark.parametrize(("value", "told"), [([np.nan, 0, 0, 0], "returned"), ([[0, 0, 0, 0]], "returned")])
def test_a_control_that_returns_no_numbers_is_told(bench: Mechanism, value: Any, told: str) -> None:
    with pytest.raises(Exception, match=rf"the control {told} .* at t = 0 s; let it return finite numbers"):
        simulate(bench, control(lambda *_: value), *START, Settings(1.0))


def test_a_control_of_another_size_is_refused(bench: Mechanism) -> None:
    with pytest.raises(ValueError, match=r"the inputs have shape \(2,\), \(4,\) expected"):
        simulate(bench, control(lambda *_: [0, 0]), *START, Settings(1.0))
    with pytest.raises(ValueError, match="period = 0"):
        control(lambda *_: [0], 0.0)


FAULTS = {
    "no such coordinate": (
        "inputs: {slider: -q_slyder}",
        'inputs.slider: unknown name "q_slyder"; did you mean "q_slider"?',
    ),
    "acceleration": ("inputs: {slider: -qdd_slider}", 'unknown name "qdd_slider"'),
    "constant": ("constants: {q_bob: 1}", "no name for a constant"),
    "period": ("input_period: -1", "input_period: found -1; give a positive number"),
    "start": ("start: {pose: {bob: q_bob}}", 'unknown name "q_bob"'),
    "code": ("inputs: {slider: q_slider.real}", "has no meaning in an expression"),
}


@pytest.mark.parametrize(("text", "told"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_of_feedback_are_told_with_their_lines(tmp_path: Path, bench: Mechanism, text: str, told: str) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(f"duration: 1\n{text}\n", encoding="utf-8")
    with pytest.raises(InputError) as error:
        read_statement(file, {}, bench.manifest)
    assert "settings.yaml:2:" in str(error.value)
    assert told in str(error.value)


def test_the_command_takes_feedback(
    bench_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--duration", "0.5", "--pose", "slider=0.1", "--input", "slider=-5*qd_slider", "--input-period", "1e-2"]
    monkeypatch.setattr(sys, "argv", ["mbsrun", "simulate", str(bench_file), *options, "-o", "out"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0, capsys.readouterr().err
    assert json.loads(Path("out/simulation.json").read_text("utf-8"))["complete"] is True
