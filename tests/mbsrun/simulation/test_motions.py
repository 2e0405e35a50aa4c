"""Simulations of many starts: each motion is the one that `simulate` gives, whatever computes it beside others."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from mbsgen.expressions import parse
from mbsrun import Mechanism, load, simulate_many
from mbsrun.binding import ArgumentError
from mbsrun.closure import Closure
from mbsrun.commands.simulate import simulate_command
from mbsrun.models import INTEGRATED
from mbsrun.quantities import list_quantities
from mbsrun.simulation import Settings, control, simulate
from mbsrun.simulation.closing import complete_velocities
from mbsrun.simulation.drive import Drive, express, hold, hold_steps

MODELS = Path(__file__).parents[3] / "models"
COUNT = 11  # of starts: no multiple of a group of lanes


@pytest.fixture(scope="module")
def satellite() -> Mechanism:
    return load(MODELS / "satellite.yaml", extent=INTEGRATED)


@pytest.fixture(scope="module")
def four_bar() -> Mechanism:
    return load(MODELS / "four_bar.yaml", extent=INTEGRATED)


def compare(mechanism: Mechanism, drive: Drive, q: Any, qd: Any, settings: Settings, **own: Any) -> None:
    """Compare with single motions, and two threads with one: these agree to the last bit."""
    found = simulate_many(mechanism, drive, q, qd, settings, parameters=own)
    assert found.is_complete.all()
    for k in (0, 4, len(q) - 1):
        one = simulate(
            mechanism.with_parameters(**{name: x[k] for name, x in own.items()}), drive, q[k], qd[k], settings
        )
        np.testing.assert_allclose(found.t, one.t, rtol=1e-12)
        np.testing.assert_allclose(found.q[k], one.q, rtol=0, atol=1e-11)
        np.testing.assert_allclose(found.qd[k], one.qd, rtol=0, atol=1e-11)
        assert one.energy is not None
        np.testing.assert_allclose(found.measure_energy()[k], one.energy.total[[0, -1]], rtol=1e-10)
    if settings.method in ("rk4", "dop853"):
        shared = simulate_many(mechanism, drive, q, qd, settings, parameters=own, threads=3)
        np.testing.assert_array_equal(shared.q, found.q)


@pytest.mark.parametrize(
    ("method", "formulation"),
    [("rk4", "exp2"), ("rk4", "semi"), ("euler", "exp1"), ("dop853", "exp2"), ("gauss", "impl")],
)
def test_motions_of_a_tree(double_pendulum: Mechanism, method: str, formulation: str) -> None:
    """Outputs lie between steps, and inputs jump between them."""
    q, qd = np.random.default_rng(1).normal(size=(2, COUNT, 2))
    u = np.zeros((2, len(double_pendulum.manifest.inputs)))
    u[1] = 0.5
    kept = Settings(0.3, method, type(Settings.formulation)(formulation), step=7e-3, output_step=0.02)
    compare(double_pendulum, hold_steps([0.0, 0.15, 0.3], u), q, qd, kept)


@pytest.mark.parametrize("method", ["rk4", "dop853"])
@pytest.mark.parametrize("law", ["0.3*sin(5*t)", "-q_q1 - 0.2*qd_q1"])
def test_inputs_over_time_and_feedback(pendulum: Mechanism, method: str, law: str) -> None:
    drive = express([parse(law)], ["q1"], {}, list_quantities(pendulum.manifest))
    q, qd = np.random.default_rng(2).normal(size=(2, COUNT, 1))
    compare(pendulum, drive, q, qd, Settings(0.3, method, step=0.01, output_step=0.05))


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_parameters_differ_and_quaternions_turn(satellite: Mechanism, method: str) -> None:
    rng = np.random.default_rng(3)
    q = rng.normal(size=(COUNT, 5))
    q[:, :4] /= np.linalg.norm(q[:, :4], axis=1, keepdims=True)
    qd, masses = rng.normal(size=(COUNT, 4)), np.linspace(1, 5, COUNT)
    compare(satellite, hold(np.zeros(4)), q, qd, Settings(0.4, method, step=0.01, output_step=0.1), m_boom=masses)


def test_closed_loops(four_bar: Mechanism) -> None:
    """A start whose loop is open ends at once, and changes nothing beside it."""
    closure, q = Closure(four_bar), np.array(four_bar.manifest.pose)
    motor = [c.name for c in four_bar.manifest.coordinates].index("motor")
    speeds = np.eye(q.size)[motor] * np.linspace(1, 3, COUNT)[:, None]
    qd = np.array([complete_velocities(closure, q, speed, [motor]) for speed in speeds])
    drive, settings = hold(np.zeros(len(four_bar.manifest.inputs))), Settings(0.2, output_step=0.05)
    compare(four_bar, drive, np.tile(q, (COUNT, 1)), qd, settings)
    good = simulate_many(four_bar, drive, q, qd, settings)
    starts = np.tile(q, (COUNT, 1))
    starts[2] += 0.1
    found = simulate_many(four_bar, drive, starts, qd, settings, threads=2)
    assert [k for k, halt in enumerate(found.halts) if halt] == [2]
    assert "is open by" in str(found.halts[2])
    np.testing.assert_array_equal(np.delete(found.q, 2, axis=0), np.delete(good.q, 2, axis=0))


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_a_motion_that_fails_ends_alone(lock: Mechanism, method: str) -> None:
    """It keeps what it reached, and why it ended, as `simulate` has it; others keep their bits."""
    q, qd = np.random.default_rng(4).normal(size=(2, COUNT, 3)) * 0.1
    settings = Settings(1.0, method, step=0.01, output_step=0.1)
    good = simulate_many(lock, hold(np.zeros(3)), q, qd, settings)
    q[5], qd[5], qd[9] = [0, np.pi / 2, 0], [1, 0, 0], np.nan
    found = simulate_many(lock, hold(np.zeros(3)), q, qd, settings)
    assert np.flatnonzero(~found.is_complete).tolist() == [5, 9]
    assert str(found.halts[5]) == str(simulate(lock, hold(np.zeros(3)), q[5], qd[5], settings).halt)
    assert "finite" in str(found.halts[9])
    assert np.isnan(found.q[5, 1:]).all()
    np.testing.assert_allclose(
        np.delete(found.q, [5, 9], axis=0), np.delete(good.q, [5, 9], axis=0), rtol=0, atol=1e-13
    )


def test_misuse_is_told(pendulum: Mechanism) -> None:
    settings, drive = Settings(0.1, "gauss"), hold([0.0])
    with pytest.raises(ArgumentError, match=r"arrays are of \[2, 3\] starts"):
        simulate_many(pendulum, drive, np.zeros((2, 1)), np.zeros((3, 1)), settings)
    with pytest.raises(ValueError, match=r"the inputs have shape \(2,\), \(1,\) expected"):
        simulate_many(pendulum, hold([0.0, 0.0]), [0.0], [0.0], Settings(0.1, "rk4"))
    with pytest.raises(ArgumentError, match="threads: gauss takes one"):
        simulate_many(pendulum, drive, [0.0], [0.0], settings, threads=2)
    with pytest.raises(ArgumentError, match="no run-time parameter m; there are none"):
        simulate_many(pendulum, drive, [0.0], [0.0], settings, parameters={"m": 1.0})
    with pytest.raises(ArgumentError, match=r"q: shape \(2,\) given, \(states, 1\) expected"):
        simulate_many(pendulum, drive, [0.0, 0.0], [0.0], settings)
    with pytest.raises(ArgumentError, match=r"^q: some entries are masked"):
        simulate_many(pendulum, drive, np.ma.array([[0.0]], mask=True), [0.0], settings)
    with pytest.raises(ArgumentError, match=r"^qd: float32 given, float64 expected"):
        simulate_many(pendulum, drive, [0.0], np.zeros((1, 1), np.float32), settings)
    with pytest.raises(ArgumentError, match="arrays are of no starts; give one start at least"):
        simulate_many(pendulum, drive, np.zeros((0, 1)), [0.0], settings)
    bare: Any = np.zeros(1)
    with pytest.raises(ValueError, match=r"inputs: found a value of type ndarray; give a Drive, such as hold"):
        simulate_many(pendulum, bare, [0.0], [0.0], settings)


def test_sampled_feedback_of_each(pendulum: Mechanism) -> None:
    q = np.linspace(-1, 1, COUNT)[:, None]
    law = control(lambda _, q, qd: -5 * q - qd, period=0.05)
    compare(pendulum, law, q, np.zeros((COUNT, 1)), Settings(0.2, output_step=0.05))


@pytest.fixture
def order(tmp_path: Path) -> Any:
    """Run `mbsrun simulate` with an output folder; return the exit code, its words, and the folder."""

    def call(model: str, *arguments: str) -> tuple[int, str, Path]:
        out = tmp_path / "many"
        ended = CliRunner().invoke(simulate_command, [str(MODELS / model), "-o", str(out), *arguments])
        return ended.exit_code, ended.output + (str(ended.exception) if ended.exception else ""), out

    return call


def test_the_command_reads_a_table(order: Any, tmp_path: Path) -> None:
    table = tmp_path / "starts.csv"
    table.write_text("\ufeffq_hinge,qd_hinge,m_boom\n0,0.1,1\n0.5,0,3\npi/4,0.2,5\n", encoding="utf-8")
    code, said, out = order("satellite.yaml", "--duration", "0.2", "--starts", str(table))
    assert code == 0, said
    arrays = np.load(out / "motions.npz")
    assert (arrays["q"].shape, arrays["given"][2].tolist()) == ((3, 101, 5), [np.pi / 4, 0.2, 5])
    rows = list(csv.DictReader((out / "starts.csv").open(encoding="utf-8")))
    assert [row["status"] for row in rows] == ["complete"] * 3
    assert float(rows[2]["q[hinge] [rad]"]) == arrays["q"][2, -1, 4]
    assert json.loads((out / "simulation.json").read_text("utf-8"))["complete"] == 3


def test_the_command_draws_starts_and_closes_them(order: Any) -> None:
    given = ("--duration", "0.1", "--starts", "5", "--vary", "qd_motor=1:3")
    code, said, out = order("four_bar.yaml", *given, "--threads", "2")
    assert code == 0, said
    first = np.load(out / "motions.npz")
    assert (np.ptp(first["given"]) > 0, first["given"].min() >= 1, first["given"].max() <= 3) == (True, True, True)
    np.testing.assert_allclose(first["qd"][:, 0, 0], first["given"][:, 0])
    order("four_bar.yaml", *given)
    np.testing.assert_array_equal(np.load(out / "motions.npz")["q"], first["q"])


@pytest.mark.parametrize(
    ("arguments", "finding"),
    [
        (("--starts", "3"), "give --vary NAME=LOW:HIGH, or a table"),
        (("--starts", "3", "--vary", "q_nix=0:1"), "q_nix': there are q_q1, qd_q1"),
        (("--starts", "3", "--vary", "q_q1=1:0"), "give NAME=LOW:HIGH, LOW first"),
        (("--starts", "0", "--vary", "q_q1=0:1"), "0 starts; give 1 to"),
        (("--starts", "no.csv"), "no.csv: there is no such file"),
        (("--threads", "2"), "--threads belongs to many motions"),
        (("--starts", "3", "--columns", "energy"), "--columns belongs to the table of one motion"),
    ],
)
def test_misuse_of_the_command_is_told(order: Any, arguments: tuple[str, ...], finding: str) -> None:
    code, said, out = order("pendulum.yaml", "--duration", "0.1", *arguments)
    assert finding in said
    assert (code == 0, out.exists()) == (False, False)


def test_every_fault_of_a_table_is_told(order: Any, tmp_path: Path) -> None:
    table = tmp_path / "starts.csv"
    table.write_text("q_q1,x\n1,2\n\n1\n", encoding="utf-8")
    _, said, _ = order("pendulum.yaml", "--duration", "0.1", "--starts", str(table))
    assert "starts.csv:1: x names nothing; there are q_q1, qd_q1" in said
    assert "starts.csv:4: found 1; give 2 numbers" in said
