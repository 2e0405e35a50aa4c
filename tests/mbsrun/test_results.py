"""Numbers of a motion by name, of solutions and simulations: against differences, balances, SciPy and virtual power."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import mbsrun
from mbsrun.cli import cli
from mbsrun.external import Mechanism
from mbsrun.models import Extent
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.result import Solved, Unsolved
from mbsrun.recordings import Recording
from mbsrun.results import UnknownNameError
from mbsrun.simulation import Motion, Settings, control, simulate
from mbsrun.simulation.drive import hold

MODELS = Path(__file__).parents[2] / "models"
GRAVITY, TORQUE = 9.81, 0.1  # m/s2, N m


@pytest.fixture(scope="module")
def lift() -> Solved:
    """An arm that two muscles lift; nothing else but gravity acts on it."""
    problem = mbsrun.read_problem(MODELS / "muscles" / "lift.ocp.yaml")
    solved = problem.with_changes(intervals=12, refine=None).solve(check=False)
    assert isinstance(solved, Solved)
    return solved


@pytest.fixture(scope="module")
def turning() -> Motion:
    """A four-bar linkage under a torque of its motor."""
    linkage = mbsrun.load(MODELS / "four_bar.yaml", extent=Extent(derivatives=1))
    start = np.array(linkage.manifest.pose)
    return simulate(
        linkage, hold([TORQUE]), start, np.zeros(3), Settings(0.2, rtol=1e-11, atol=1e-11, output_step=2e-4)
    )


def test_muscles_do_the_work_of_their_tensions(lift: Solved) -> None:
    """Power = -sum of tension times rate, and the moment of each joint is the sum of tension times arm."""
    names = ("deltoid", "brachialis")
    spent = sum(lift.evaluate(f"-tension_{name}*rate_{name}") for name in names)
    assert lift["power"] == pytest.approx(spent, abs=1e-10)
    model, w = lift.plant, lift._numbers.whole("w")
    free = model("impl", q=lift["q"], qd=lift["qd"], qdd=lift["qdd"], u=np.zeros((len(w), 0)), w=0 * w + 1e-9)["Phi"]
    held = model("impl", q=lift["q"], qd=lift["qd"], qdd=lift["qdd"], u=np.zeros((len(w), 0)), w=w)["Phi"]
    idle = model("tensions", q=lift["q"], qd=lift["qd"], w=0 * w + 1e-9)["tension"]
    for i, joint in enumerate(("shoulder", "elbow")):
        moments = sum((lift[f"tension_{x}"] - idle[:, k]) * lift[f"arm_{x}_{joint}"] for k, x in enumerate(names))
        assert free[:, i] - held[:, i] == pytest.approx(moments, abs=1e-9)
    assert [lift.unit(x) for x in ("tension_deltoid", "rate_deltoid", "energy", "power")] == ["N", "m/s", "J", "W"]


def test_pins_carry_what_moves_all_bodies(turning: Motion) -> None:
    """The forces in the joints on the base are the growth of the momentum, plus the weight; the motor does all work."""
    grown = np.gradient(turning["momentum_z"], turning.t, edge_order=2)
    mass = sum(x.mass for x in turning.kernels.manifest.appearance.masses if x.frame >= 0)  # type: ignore[union-attr]
    carried = turning["reaction_z_motor"] + turning["reaction_z_swing"]
    assert carried[2:-2] == pytest.approx((grown + mass * GRAVITY)[2:-2], abs=2e-3)
    sideways = turning["reaction_x_motor"] + turning["reaction_x_swing"]
    assert sideways[2:-2] == pytest.approx(np.gradient(turning["momentum_x"], turning.t, edge_order=2)[2:-2], abs=2e-3)
    assert turning["power"] == pytest.approx(turning["power_motor"], abs=1e-12)
    assert np.abs(turning["reaction_my_motor"]) == pytest.approx(TORQUE, abs=1e-10)
    assert turning["energy"] - turning["energy"][0] == pytest.approx(turning.energy.work, abs=1e-8)  # type: ignore[union-attr]
    slopes = [np.gradient(turning[f"v{axis}_tracer"], turning.t, edge_order=2) for axis in "xz"]
    assert turning["ax_tracer"][2:-2] == pytest.approx(slopes[0][2:-2], abs=2e-3)
    assert turning["az_tracer"][2:-2] == pytest.approx(slopes[1][2:-2], abs=2e-3)


def test_attitudes_are_turns_about_the_axes_of_the_base() -> None:
    satellite = mbsrun.load(MODELS / "satellite.yaml", extent=Extent(derivatives=1))
    manifest = satellite.manifest
    q, qd = np.zeros(len(manifest.positions)), np.zeros(len(manifest.coordinates))
    turn = Rotation.from_euler("xyz", [0.3, -0.7, 1.1])
    k = manifest.quaternions[0]
    q[k : k + 4] = turn.as_quat()
    motion = simulate(satellite, control(lambda *_: np.zeros(len(manifest.inputs))), q, qd, Settings(0.01))
    sensor = next(frame.name for frame in manifest.frames if frame.sensor)
    angles = [motion[f"{name}_{sensor}"][0] for name in ("roll", "pitch", "yaw")]
    axes = np.array([[motion[f"{axis}{part}_{sensor}"][0] for axis in "xyz"] for part in "xyz"])
    assert Rotation.from_matrix(axes).as_euler("xyz") == pytest.approx(angles, abs=1e-12)


def test_tables_have_the_columns_that_are_named(tmp_path: Path) -> None:
    arguments = [
        "simulate",
        str(MODELS / "four_bar.yaml"),
        "--duration",
        "0.01",
        "--columns",
        "energy, reaction_*",
        "-o",
    ]
    found = CliRunner().invoke(cli, [*arguments, str(tmp_path / "out")])
    assert found.exit_code == 0, found.output
    with (tmp_path / "out" / "trajectory.csv").open() as file:
        header = next(csv.reader(file))
    assert header[-22] == "energy [J]"
    assert header[-21:-18] == ["reaction_motor [N]", "reaction_pin [N]", "reaction_swing [N]"]
    assert header[-1] == "reaction_mz_swing [N m]"
    arguments[5] = "reacton_pin"
    found = CliRunner().invoke(cli, [*arguments, str(tmp_path / "none")])
    assert isinstance(found.exception, UnknownNameError)  # which the program prints
    assert str(found.exception) == 'there is no quantity "reacton_pin"; did you mean reaction_pin?'
    assert not (tmp_path / "none").exists()


def test_pins_of_a_given_motion_carry_the_weight(tmp_path: Path) -> None:
    """A linkage that hardly moves: its joints on the base carry its weight; a power is the torque times the speed."""
    out = tmp_path / "pins.csv"
    motion = ["--motion", "motor=60 deg + 1e-3*t", "--duration", "1", "--output-step", "0.5"]
    arguments = ["inverse", str(MODELS / "four_bar.yaml"), *motion, "--columns", "reaction_z_*,power_motor", "-o"]
    found = CliRunner().invoke(cli, [*arguments, str(out)])
    assert found.exit_code == 0, found.output
    with out.open() as file:
        row = next(csv.DictReader(file))
    linkage = mbsrun.load(MODELS / "four_bar.yaml", extent=Extent(derivatives=1))
    masses = sum(x.mass for x in linkage.manifest.appearance.masses)  # type: ignore[union-attr]
    carried = float(row["reaction_z_motor [N]"]) + float(row["reaction_z_swing [N]"])
    assert carried == pytest.approx(masses * GRAVITY, rel=1e-6)
    assert float(row["power_motor [W]"]) == pytest.approx(1e-3 * float(row["u[motor] [N m]"]), rel=1e-12)


def test_solutions_write_further_columns(lift: Solved, tmp_path: Path) -> None:
    lift.to_csv(tmp_path / "lift.csv", "arm_*", "length_deltoid")
    with (tmp_path / "lift.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][-5:-1] == [f"arm_{x}_{y} [m]" for x in ("deltoid", "brachialis") for y in ("shoulder", "elbow")]
    assert [float(row[-1]) for row in rows[1:]] == lift["length_deltoid"].tolist()
    with pytest.raises(UnknownNameError, match="did you mean tension_deltoid"):
        lift.to_csv(tmp_path / "none.csv", "tension_deltoit")
    assert not (tmp_path / "none.csv").exists()


def test_a_folder_says_how_to_get_what_it_lacks() -> None:
    pendulum = mbsrun.load(MODELS / "pendulum.yaml", extent=Extent(("impl", "frames"), 0))
    assert pendulum.reactions(q=[0.0], qd=[0.0], qdd=[0.0])["force"].shape == (3, 1)  # generated at its first call
    with pytest.raises(mbsrun.binding.ArgumentError, match="`mbsgen MODEL --functions reactions` writes it"):
        Mechanism(pendulum.folder)("reactions", q=[0.0], qd=[0.0], qdd=[0.0])


def test_objects_show_themselves_in_a_line(lift: Solved, turning: Motion) -> None:
    problem: OptimalControl = mbsrun.read_problem(MODELS / "cart_pole_swing_up.ocp.yaml")
    stopped = problem.with_solver("mbs", max_iterations=1, fallback=False).solve()
    assert isinstance(stopped, Unsolved)
    failure = stopped.failure
    assert repr(failure) == f"Failure({problem.name}: {failure.run.status}: {failure.finding}; {failure.remedy})"
    shown = [problem.value, lift.solution, lift.trajectory, lift.plant, turning, turning.kernels]
    shown += [lift.plant.manifest, Recording("lift.csv", lift.t, (), np.zeros((lift.t.size, 0)))]
    for each in shown:
        assert len(repr(each)) < 400
        assert "\n" not in repr(each)
    assert f"cost {lift.cost:.10g}" in repr(lift.solution)
    assert "kinetic           (1,)      J" in (turning.kernels.energy.__doc__ or "")  # type: ignore[union-attr]
