"""Forces along recordings: against the textbook's two-link arm, statics, and the inputs of simulations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun import cli, load
from mbsrun.external import Mechanism
from mbsrun.models import INTEGRATED
from mbsrun.quaternions import normalise
from mbsrun.recordings import Treatment, read_recording
from mbsrun.recordings.fitting import FITTED
from mbsrun.simulation.inverse import balance
from mbsrun.simulation.recorded import Load, analyse, scale
from tests.recordings_made import FOLDER, FORE, UPPER, swing

Array = NDArray[np.float64]
MODELS = FOLDER.parent
T = np.arange(121) / 100


def two_links(q: Array, qd: Array, qdd: Array) -> Array:
    """Return the torques of the arm: Lagrange's equations of two rods, the angles from the vertical."""
    (m1, m2), (J1, J2), c1, c2, g = (2.1, 1.5), (0.016, 0.011), 0.45 * UPPER, 0.5 * FORE, 9.81
    a, b = q[:, 0], q[:, 1]
    k = m2 * UPPER * c2
    M11 = J1 + J2 + m1 * c1**2 + m2 * (UPPER**2 + c2**2) + 2 * k * np.cos(b)
    M12, M22 = J2 + m2 * c2**2 + k * np.cos(b), J2 + m2 * c2**2
    h = k * np.sin(b)
    fore = m2 * g * c2 * np.sin(a + b)
    tau1 = M11 * qdd[:, 0] + M12 * qdd[:, 1] - h * (2 * qd[:, 0] + qd[:, 1]) * qd[:, 1]
    tau2 = M12 * qdd[:, 0] + M22 * qdd[:, 1] + h * qd[:, 0] ** 2
    return np.stack((tau1 + (m1 * c1 + m2 * UPPER) * g * np.sin(a) + fore, tau2 + fore), axis=1)


def differentiate(order: int) -> Array:
    """Differentiate the arm's motion by Chebyshev polynomials."""
    fine = np.linspace(0, 1.2, 400)
    parts = [np.polynomial.Chebyshev.fit(fine, values, 30, domain=[0, 1.2]) for values in swing(fine)]
    return np.stack([(p.deriv(order) if order else p)(T) for p in parts], axis=1)


@pytest.fixture(scope="module")
def arm() -> Mechanism:
    return load(FOLDER / "arm.yaml", extent=INTEGRATED)


def test_the_torques_of_an_arm(arm: Mechanism, tmp_path: Path) -> None:
    """Samples of 100 Hz, in degrees, with a short gap and a long one."""
    q = np.degrees(np.stack(swing(T), axis=1))
    q[30, 0] = np.nan
    q[60:80, 1] = np.nan
    rows = "\n".join(f"{t}\t{a}\t{b}" for t, (a, b) in zip(T, q, strict=True))
    text = f"walk\nnRows=121\nnColumns=3\ninDegrees=yes\nendheader\ntime\tshoulder\telbow_flexion\n{rows}\n"
    (tmp_path / "walk.mot").write_text(text, "utf-8")
    found = analyse(read_recording(tmp_path / "walk.mot"), arm, Treatment(), columns={"elbow": "elbow_flexion"})
    assert (found.samples, found.bridged, found.left_open) == (121, 1, 1)
    kept = np.r_[0:60, 80:121]
    np.testing.assert_allclose(found.forces.t, T[kept])
    expected = two_links(*(differentiate(order) for order in range(3)))[kept]
    inner = (np.abs(T[kept] - 0.6) > 0.25) & (T[kept] > 0.05) & (T[kept] < 1.15)
    np.testing.assert_allclose(found.forces.u[inner], expected[inner], atol=2e-3)
    np.testing.assert_allclose(found.forces.rest, 0, atol=1e-12)


PUSHED = """\
name: pushed
gravity: [0, 0, -9.81]
bodies:
  - {name: rod, joint: {name: q, type: revolute, axis: y}, mass: 2, com: [0, 0, -0.5], inertia: [0.2, 0.2, 0.01]}
wrenches:
  - {name: tip, body: rod, position: [0.1, 0, -1], frame: FRAME, force: input, moment: input}
frames:
  - {name: tip, body: rod, position: [0.1, 0, -1]}
"""


@pytest.mark.parametrize("frame", ["base", "body"])
def test_a_recorded_force_acts_where_it_was_measured(tmp_path: Path, frame: str) -> None:
    """At rest the torque balances weight, force and free moment about the axis, wherever the wrench is."""
    (tmp_path / "pushed.yaml").write_text(PUSHED.replace("FRAME", frame), "utf-8")
    F, P, M = np.array([30.0, 5, -70]), np.array([0.4, 0.1, -0.9]), np.array([1.0, 2, 3])
    head = [f"{part}{axis}" for part in ("F_", "P_", "M_") for axis in "xyz"]
    row = ",".join(map(str, (*F, *P, *M)))
    (tmp_path / "grf.csv").write_text("t,q," + ",".join(head) + "".join(f"\n{t},0.3,{row}" for t in range(8)), "utf-8")
    kernels = load(tmp_path / "pushed.yaml", extent=INTEGRATED)
    recording = read_recording(tmp_path / "grf.csv")
    found = analyse(recording, kernels, Treatment(), loads={"tip": Load("F_", "P_", "M_")})
    weight = np.cross([-0.5 * np.sin(0.3), 0, -0.5 * np.cos(0.3)], [0, 0, -2 * 9.81])
    expected = -(weight + np.cross(P, F) + M)[1]
    np.testing.assert_allclose(found.forces.u, expected, rtol=1e-9)
    for load_, word in ((Load("G_"), '"G_x"'), (Load("F_", "Q_"), '"Q_z"')):
        with pytest.raises(InputError, match=word):
            analyse(recording, kernels, Treatment(), loads={"tip": load_})


def test_the_derivatives_of_a_scaled_quaternion() -> None:
    """Against central differences."""
    manifest = load(MODELS / "satellite.yaml", extent=FITTED).manifest
    rng = np.random.default_rng(0)
    p = rng.standard_normal((3, len(manifest.positions)))

    def read(t: float) -> list[Array]:
        return [(p[0] + p[1] * t + p[2] * t**2)[None], (p[1] + 2 * p[2] * t)[None], (2 * p[2])[None]]

    before, here, after = (scale(read(t), manifest) for t in (0.7 - 1e-4, 0.7, 0.7 + 1e-4))
    np.testing.assert_allclose(here[1], (after[0] - before[0]) / 2e-4, atol=1e-6)
    np.testing.assert_allclose(here[2], (after[0] - 2 * here[0] + before[0]) / 1e-8, atol=1e-5)


HELD = """\
name: held
gravity: [0, 0, -9.81]
bodies:
  - {name: bob, joint: {type: ball, actuated: false}, mass: 1, com: [0, 0, -0.5], inertia: [0.1, 0.1, 0.1]}
  - {name: cart, joint: {name: x, type: prismatic, axis: x, position: [0, 0, -1]}, mass: 1}
loops: [{name: pin, type: rod, length: 0.5, from: {body: bob, position: [0, 0, -1]}, to: {body: cart}}]
assembly: {x: 0.5}
"""


@pytest.mark.parametrize(
    ("model", "start", "inputs"),
    [
        ("satellite", ["--velocity", "hull.rx=0.3"], {"hull.ry": "2*sin(3*t)", "hinge": "cos(2*t)"}),
        ("four_bar", ["--pose", "motor=1"], {"motor": "0.5*sin(3*t)"}),
    ],
)
def test_the_inputs_of_a_simulation_come_back(
    model: str, start: list[str], inputs: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table of `mbsrun simulate` is read back: quaternions, closed loops, and the inputs that moved them."""
    check_inputs(MODELS / f"{model}.yaml", start, inputs, tmp_path, monkeypatch)


GRIPPER = """
name: gripper
gravity: [0, 0, -9.81]
bodies:
  - {name: palm, parent: base, joint: {type: revolute, axis: y, name: turn, actuated: false}, mass: 1,
     com: [0, 0, 0.2], inertia: [0.1, 0.1, 0.1]}
  - {name: left, parent: palm, joint: {type: prismatic, axis: y, name: grip}, mass: 0.3, com: [0.1, 0, 0.1],
     inertia: [0.01, 0.01, 0.01]}
  - {name: right, parent: palm, joint: {type: prismatic, axis: -y, follows: {joint: grip, ratio: 2}}, mass: 0.2,
     com: [0.1, 0, 0.1], inertia: [0.01, 0.01, 0.01]}
"""


@pytest.mark.parametrize("name", ["gripper", "satellite", "cart_pole", "branched"])
def test_many_times_are_balanced_as_each_one_alone(name: str, tmp_path: Path) -> None:
    """With joints without a force, quaternions, and a joint that follows another, in any states."""
    model = MODELS / f"{name}.yaml" if name != "gripper" else tmp_path / "gripper.yaml"
    if name == "gripper":
        model.write_text(GRIPPER, "utf-8")
    kernels = load(model, extent=INTEGRATED)
    rng, n = np.random.default_rng(5), len(kernels.manifest.coordinates)
    q = normalise(rng.normal(size=(7, len(kernels.manifest.positions))), kernels.manifest)
    qd, qdd = rng.normal(size=(2, 7, n))
    t, w = np.arange(7.0), np.zeros((7, kernels.manifest.open_entries))
    together = balance(kernels, t, q, qd, qdd, w)
    for k in range(7):
        one = slice(k, k + 1)
        alone = balance(kernels, t[one], q[one], qd[one], qdd[one], w[one])
        for part in ("u", "tau", "rest"):
            np.testing.assert_allclose(getattr(together, part)[one], getattr(alone, part), atol=1e-11)
        assert together.spare == alone.spare


def test_a_loop_that_a_quaternion_determines_is_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cart holds a ball joint's pendulum by a rod; with a coordinate left out, its name is asked for."""
    (tmp_path / "held.yaml").write_text(HELD, "utf-8")
    check_inputs(tmp_path / "held.yaml", ["--velocity", "x=0.2"], {"x": "0.3*sin(3*t)"}, tmp_path, monkeypatch)
    table = tmp_path / "out" / "trajectory.csv"
    table.write_text(table.read_text("utf-8").replace("q[bob.qy]", "q[other]"), "utf-8")
    kernels = load(tmp_path / "held.yaml", extent=INTEGRATED)
    with pytest.raises(InputError, match=r'no column is named "q\[bob.qy\]"'):
        analyse(read_recording(table), kernels, Treatment())


def check_inputs(
    model: Path, start: list[str], inputs: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels = load(model, extent=INTEGRATED)
    names = [kernels.manifest.coordinates[i].name for i in kernels.manifest.actuated]
    given = [word for pair in inputs.items() for word in ("--input", "=".join(pair))]
    folder = tmp_path / "out"
    command = ["simulate", str(model), *start, *given, "--duration", "0.5", "--output-step", "0.005"]
    monkeypatch.setattr("sys.argv", ["mbsrun", *command, "-o", str(folder)])
    for name in ("plot_motion", "write_animation"):
        monkeypatch.setattr(f"mbsrun.simulation.record.{name}", lambda *_, **__: None)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0
    recording = read_recording(folder / "trajectory.csv")
    found = analyse(recording, kernels, Treatment())
    inner = slice(10, -10)
    for k, name in enumerate(names):
        np.testing.assert_allclose(
            found.forces.u[inner, k], recording.column(f"input[{name}]")[inner], atol=2e-4, err_msg=name
        )
