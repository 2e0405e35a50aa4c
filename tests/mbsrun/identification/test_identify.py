"""`mbsrun identify`: what it writes and prints, and what it refuses, each with one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import MbsError
from mbsgen.model.reader import read_model
from mbsrun import cli
from mbsrun.identification import IdentificationError, Settings, identify
from mbsrun.identification.writing import write_model
from mbsrun.recordings import Recording
from mbsrun.recordings.recording import Column
from tests.mbsrun.identification.motions import ROOT, TWO_LINK, open_model, record, swing
from tests.picture_kinds import find_kind

Run = Callable[..., tuple[object, str, str]]
RECORDING = str(TWO_LINK.with_suffix(".csv"))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[object, str, str]:
        monkeypatch.setattr("sys.argv", ["mbsrun", "identify", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    return call


def test_a_model_is_written_that_explains_the_recording(run: Run) -> None:
    words = ("--unknown", "inertia,damping", "--unknown", "friction", "--cutoff", "5")
    code, out, err = run(str(TWO_LINK), RECORDING, *words, "-o", "found", "--format", "svg")
    assert code == 0, err
    assert "Sz[upper] - 0.4 m[lower]" in out
    assert "no motion determines" in out
    names = ["identification.html", "identification.json", "identified.yaml", "numbers.svg", "residuals.svg"]
    assert sorted(x.name for x in Path("found").iterdir()) == names
    assert find_kind(Path("found/residuals.svg")) == "svg"
    summary = json.loads(Path("found/identification.json").read_text("utf-8"))
    assert len(summary["base"]) == 10
    assert summary["torques"][0]["residual"] < 0.2 * summary["torques"][0]["residual_before"]
    text = Path("found/identified.yaml").read_text("utf-8")
    assert "#   Jyy[lower] = 0.081" in text
    model = read_model(Path("found/identified.yaml"))
    assert model.name == "two link"
    code, out, err = run("found/identified.yaml", RECORDING, *words, "-o", "again")
    again = json.loads(Path("again/identification.json").read_text("utf-8"))
    assert again["torques"][0]["residual_before"] == pytest.approx(summary["torques"][0]["residual"], rel=1e-3)


def test_numbers_that_a_recording_does_not_tell_are_named(run: Run) -> None:
    """The shoulder stands still, and the links hang: of gravity alone, some sums are felt."""
    kernels, t = open_model(TWO_LINK), np.arange(200) / 20
    q, qd, qdd = swing(2, t, 3)
    for x in (q, qd, qdd):
        x[:, 0] = 0
    made = record(kernels, t, (q, qd, qdd), 0.01)
    found = identify(TWO_LINK, [made])
    assert "Jyy[upper] + 0.16 m[lower]" in found.undetermined
    table = ",".join(["t", *made.names]) + "\n"
    table += "".join(",".join(f"{x:.8g}" for x in (a, *row)) + "\n" for a, row in zip(t, made.values, strict=True))
    Path("still.csv").write_text(table, "utf-8")
    code, out, _ = run(str(TWO_LINK), "still.csv")
    assert code == 1
    assert "these recordings do not determine Jyy[upper] + 0.16 m[lower]" in out


@pytest.mark.parametrize(
    ("arguments", "determined"),
    [
        (("--unknown", "inertie"), "no kind of unknown numbers is named"),
        (("--body", "arm"), "no body is named"),
        (("--joint", "hip"), "no joint is named"),
        (("--torque", "elbow=force"), "no column is named"),
        (("--column", "elbow=angle"), "no column is named"),
        (("--unknown", "damping", "--body", "lower"), "inertia is not unknown"),
        (("--prior", "-1"), "prior must be positive"),
        (("--torque-noise", "elbow=0"), "noise of elbow must be positive"),
        (("--until", "0.03"), "a motion needs 4 at least"),
        (("--parameter", "length=1"), "the model has none"),
        (("--torques", RECORDING, "--torques", RECORDING), "give one for each"),
        (("--wrench", "push=F"), 'leaves no wrench "push" open'),
        (("--fit", "length"), "no parameter is named"),
        (("--cutoff", "40"), "a cut-off below"),
        (("--unknown", "motor", "--unmeasured", "elbow", "--unmeasured", "shoulder"), "no number is unknown"),
    ],
)
def test_what_cannot_be_is_refused(run: Run, arguments: tuple[str, ...], determined: str) -> None:
    code, _, err = run(str(TWO_LINK), RECORDING, *arguments)
    assert code == 2
    assert determined in err
    assert "Traceback" not in err
    assert not list(Path().iterdir())


def change(made: Recording, **columns: float) -> Recording:
    values = made.values.copy()
    for name, value in columns.items():
        values[:, [k for k, x in enumerate(made.names) if x.startswith(name)]] = value
    return Recording(made.file, made.times, made.columns, values)


def test_recordings_that_tell_nothing_are_refused() -> None:
    kernels, t = open_model(TWO_LINK), np.arange(100) / 10
    made = record(kernels, t, swing(2, t, 3), 0.01)
    without = Recording("made.csv", t, made.columns[:6], made.values[:, :6])
    with pytest.raises(MbsError, match=r'no torque of "shoulder": no column is named "u\[shoulder\]"') as error:
        identify(TWO_LINK, [without])
    assert 'no torque of "elbow"' in str(error.value)
    one = Recording("made.csv", t[:1], made.columns, made.values[:1])
    with pytest.raises(MbsError, match="it has 1 sample, and a motion needs 4 at least"):
        identify(TWO_LINK, [one])
    with pytest.raises(MbsError, match="at no time are all coordinates and torques known"):
        identify(TWO_LINK, [change(made, u=np.nan)])
    with pytest.raises(MbsError, match="at no time are all coordinates and forces known"):
        identify(TWO_LINK, [change(made, q=np.nan)])
    with pytest.raises(IdentificationError, match="excites nothing"):
        identify(TWO_LINK, [change(made, q=0.0, qd=0.0, qdd=0.0)], Settings(unknown=("damping",)))
    with pytest.raises(IdentificationError, match=r"no torque is known .* ratios alone"):
        identify(TWO_LINK, [change(made, u=0.0)])
    currents = {name: f"u[{name}]" for name in ("shoulder", "elbow")}
    with pytest.raises(IdentificationError, match="give a motor's constant"):
        identify(TWO_LINK, [made], Settings(unknown=("inertia", "motor"), currents=currents))
    with pytest.raises(IdentificationError, match="no recording is given"):
        identify(TWO_LINK, [])
    with pytest.raises(IdentificationError, match="it holds code"):
        identify(kernels.folder, [made])


def test_closed_loops_are_identified() -> None:
    """A five-bar: torques of both motors, of a motion that keeps the loop closed, determine all sums that it feels."""
    from mbsrun.closure import Closure
    from mbsrun.simulation.inverse import balance

    path = ROOT / "models" / "five_bar.yaml"
    kernels, t = open_model(path), np.arange(200) / 20
    manifest, closure = kernels.manifest, Closure(kernels)
    own, pose, poses = list(manifest.actuated), np.array(manifest.pose), []
    y, yd, ydd = swing(2, t, 5, 0.2)
    for row in y + pose[own]:
        pose = closure.move(pose, own, row)
        poses.append(pose)
    q = np.array(poses)
    qd = closure.complete_velocities(q, own, yd)
    qdd = closure.complete_accelerations(q, qd, own, ydd)
    u = balance(kernels, t, q, qd, qdd, np.zeros((t.size, 0))).u
    u = u + 0.01 * np.sqrt(np.mean(u**2, axis=0)) * np.random.default_rng(1).standard_normal(u.shape)
    names = [c.name for c in manifest.coordinates]
    columns = [f"{kind}[{name}]" for kind in ("q", "qd", "qdd") for name in names] + [f"u[{names[i]}]" for i in own]
    found = identify(path, [Recording("made.csv", t, tuple(map(Column, columns)), np.hstack((q, qd, qdd, u)))])
    assert len(found.base) == 11
    for x in found.base:
        assert abs(x.value - x.before) < 4 * x.deviation


PUSHED = """name: pushed
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: hinge, type: revolute, axis: y, actuated: false}
    mass: MASS
    com: [0, 0, -0.5]
    inertia: [0.2, 0.2, 0.01]
wrenches:
  - {name: push, body: rod, position: [0, 0, -1], frame: base, force: input}
"""


def test_a_known_force_gives_the_scale_where_no_torque_is_measured(tmp_path: Path) -> None:
    """A rod without a motor, pushed at its tip: (J + m/4) qdd + g m/2 sin q = -F cos q, by hand."""
    path, t = tmp_path / "pushed.yaml", np.arange(500) / 50
    path.write_text(PUSHED.replace("MASS", "2"), "utf-8")
    (q,), (qd,), (qdd,) = (x.T for x in swing(1, t, 3))
    m, J = 1.5, 0.25
    force = -((J + m / 4) * qdd + 9.81 * m / 2 * np.sin(q)) / np.cos(q)
    columns = ["q[hinge]", "qd[hinge]", "qdd[hinge]", *(f"input[push.force.{axis}]" for axis in "xyz")]
    values = np.stack((q, qd, qdd, force, 0 * t, 0 * t), axis=1)
    found = identify(path, [Recording("pushed.csv", t, tuple(map(Column, columns)), values)])
    assert found.find("Jyy[rod]").value == pytest.approx(J + m / 4, rel=1e-9)
    assert found.find("Sz[rod]").value == pytest.approx(-m / 2, rel=1e-9)
    free = Recording("free.csv", t, tuple(map(Column, columns[:3])), values[:, :3])
    with pytest.raises(IdentificationError, match="ratios alone"):
        identify(path, [free])


def test_frictions_and_rotors_are_written_into_the_model(tmp_path: Path) -> None:
    """The written model explains the recording as well as the estimate: its force, friction, damping and armature."""
    kernels, t = open_model(TWO_LINK), np.arange(1000) / 100
    q, qd, qdd = swing(2, t, 3)
    slope = np.tanh(qd / 0.02)
    more = 0.3 * qd + 0.5 * slope + 0.4 * np.exp(-((qd / 0.15) ** 2)) * slope + 0.07 * qdd
    made = record(kernels, t, (q, qd, qdd), 0.01, more=more)
    found = identify(TWO_LINK, [made], Settings(unknown=("inertia", "damping", "friction", "stribeck", "armature")))
    path = tmp_path / "found.yaml"
    path.write_text(write_model(found, TWO_LINK), "utf-8")
    assert "exp(-(qd/0.1" in path.read_text("utf-8")
    again = identify(path, [made], Settings(unknown=("inertia",)))
    for own, other in zip(again.torques, found.torques, strict=True):
        assert own.before == pytest.approx(other.deviation, rel=1e-3)
