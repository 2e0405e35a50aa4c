"""Linear equations about a pose: closed forms, differences of accelerations, and what a regulator does."""

from __future__ import annotations

import json
import re
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from click.testing import CliRunner

from mbsrun.cli import cli
from mbsrun.closure import Closure, OpenError
from mbsrun.external import Mechanism, load
from mbsrun.kernel import ArgumentError
from mbsrun.linearisation import BalanceError, balance, find_pose, linearise, settle
from mbsrun.models import INTEGRATED
from tests.model_kinds import write_model
from tests.picture_kinds import find_kind
from tests.shipped import FOLDER


def _load(name: str) -> Mechanism:
    return load(FOLDER / f"{name}.yaml", extent=INTEGRATED)


@pytest.mark.parametrize(("pole", "sign"), [(0.0, 1), (np.pi, -1)], ids=["hanging", "upright"])
def test_a_cart_pole_is_the_textbooks(pole: float, sign: int) -> None:
    """A point mass 1/2 m below a free cart: poles of (1 + m/M) g/l."""
    kernels = _load("cart_pole")
    found = linearise(kernels, balance(kernels, find_pose(kernels, {"pole": pole}), {}))
    cart, mass, length, g = 1.0, 0.3, 0.5, 9.81
    rate = np.sqrt((1 + mass / cart) * g / length)
    poles = sorted((mode.pole for mode in found.modes), key=abs)
    assert poles[:2] == [0, 0]
    expected = [1j * rate] if sign > 0 else [-rate, rate]
    assert sorted(poles[2:], key=lambda x: x.real) == pytest.approx(expected, rel=1e-9)
    assert not found.is_stable
    assert all(mode.controllable > 1e-3 for mode in found.modes)


def test_a_double_pendulum_swings_at_the_frequencies_of_its_matrices() -> None:
    """Small swings of two thin rods, with M and K written by hand."""
    kernels = _load("double_pendulum")
    found = linearise(kernels, settle(kernels, np.array([0.3, -0.2]), np.zeros(0)))
    l1, l2, m1, m2, g = 1.0, 0.7, 1.5, 0.8, 9.81
    b = m2 * l2**2 / 3 + m2 * l1 * l2 / 2
    M = np.array([[m1 * l1**2 / 3 + m2 * (l1**2 + l1 * l2 + l2**2 / 3), b], [b, m2 * l2**2 / 3]])
    K = g * np.array([[m1 * l1 / 2 + m2 * l1 + m2 * l2 / 2, m2 * l2 / 2], [m2 * l2 / 2, m2 * l2 / 2]])
    assert found.equilibrium.q == pytest.approx(np.zeros(2), abs=1e-9)
    expected = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)))) / (2 * np.pi)
    assert [mode.frequency for mode in found.modes] == pytest.approx(expected, rel=1e-9)
    assert [mode.damping for mode in found.modes] == [0, 0]
    assert all(np.copysign(1, x) == 1 for mode in found.modes for x in (mode.damping, mode.pole.real))  # no -0
    assert not found.is_stable  # they swing for ever


@pytest.mark.parametrize("name", ["four_bar", "satellite"])
def test_slopes_are_differences_of_accelerations(name: str) -> None:
    """exp2 shares neither formulation nor multipliers with the residual that is linearised."""
    kernels = _load(name)
    equilibrium = balance(kernels, find_pose(kernels, {}), {})
    found, closure, n = linearise(kernels, equilibrium), Closure(kernels), len(kernels.manifest.coordinates)
    freedoms = [[c.name for c in kernels.manifest.coordinates].index(x) for x in found.freedoms]

    def accelerate(x: np.ndarray, s: np.ndarray, u: np.ndarray) -> np.ndarray:
        qd = np.zeros(n)
        qd[freedoms] = x
        q = equilibrium.q + (kernels("rates", q=equilibrium.q, qd=qd)["rate"] if kernels.manifest.configuration else qd)
        if closure.count:
            q = closure.close(q, freedoms)
        velocities = np.zeros(n)
        velocities[freedoms] = s
        if closure.count:
            velocities = closure.complete_velocities(q, freedoms, s)
        return kernels("exp2", q=q, qd=velocities, u=u)["qdd"][freedoms]

    d, step = len(freedoms), 1e-5
    zero, u = np.zeros(d), equilibrium.u
    assert accelerate(zero, zero, u) == pytest.approx(zero, abs=1e-8)
    for k in range(d):
        e = step * np.eye(d)[k]
        by_x = (accelerate(e, zero, u) - accelerate(-e, zero, u)) / (2 * step)
        by_s = (accelerate(zero, e, u) - accelerate(zero, -e, u)) / (2 * step)
        scale = max(1.0, np.abs(found.A).max())
        assert by_x == pytest.approx(found.A[d:, k], abs=1e-6 * scale)
        assert by_s == pytest.approx(found.A[d:, d + k], abs=1e-6 * scale)
    for k in range(u.size):
        e = step * np.eye(u.size)[k]
        by_u = (accelerate(zero, zero, u + e) - accelerate(zero, zero, u - e)) / (2 * step)
        assert by_u == pytest.approx(found.B[d:, k], abs=1e-6 * max(1.0, np.abs(found.B).max()))


def test_transfer_functions_are_the_dynamic_stiffness() -> None:
    kernels = _load("satellite")
    found = linearise(kernels, balance(kernels, find_pose(kernels, {"hinge": 1.0}), {}))
    d = len(found.freedoms)
    for f in (0.1, 2.0):
        w = 2 * np.pi * f
        expected = np.linalg.solve(-(w**2) * found.M + 1j * w * found.C + found.K, found.F)
        assert found.respond(np.array([f]))[0, :d] == pytest.approx(expected, rel=1e-9)


def test_zeros_make_the_transfer_function_vanish() -> None:
    kernels = _load("cart_pole")
    found = linearise(kernels, balance(kernels, find_pose(kernels, {}), {}))
    (zero,) = (z for z in found.find_zeros(0, 0) if z.imag > 0)
    assert abs(found.respond(np.array([zero.imag / (2 * np.pi)]))[0, 0, 0]) < 1e-9


ACROSS = """\
name: across
gravity: [0, 0, -9.81]
bodies:
  - {name: cart, joint: {name: cart, type: prismatic, axis: x}, mass: 1}
  - name: pole
    parent: cart
    joint: {name: pole, type: revolute, axis: x, actuated: false}
    mass: 0.3
    com: [0, 0, 0.5]
"""


def test_a_pole_that_falls_across_the_way_of_its_cart_is_out_of_reach(tmp_path: Path) -> None:
    (tmp_path / "across.yaml").write_text(ACROSS, encoding="utf-8")
    kernels = load(tmp_path / "across.yaml", extent=INTEGRATED)
    found = linearise(kernels, balance(kernels, find_pose(kernels, {}), {}))
    assert [mode.controllable > 1e-6 for mode in found.modes] == [True, True, False, False]
    with pytest.raises(BalanceError, match="no input reaches"):
        found.regulate(1.0)


def test_the_regulator_minimises_its_integral() -> None:
    """At the optimum, the cost from a state is x' P x, by Lyapunov's equation of the closed loop."""
    kernels = _load("cart_pole")
    found = linearise(kernels, balance(kernels, find_pose(kernels, {"pole": np.pi}), {}))
    best = found.regulate(0.1)
    closed = found.A - found.B @ best
    assert np.linalg.eigvals(closed).real.max() < -0.5

    def cost(gains: np.ndarray) -> float:
        size = len(found.A)
        loop, price = found.A - found.B @ gains, np.eye(size) + 0.1 * gains.T @ gains
        whole = np.kron(loop.T, np.eye(size)) + np.kron(np.eye(size), loop.T)
        return float(np.trace(np.linalg.solve(whole, -price.ravel()).reshape(size, size)))

    rng = np.random.default_rng(2)
    assert all(cost(best + 0.05 * rng.normal(size=best.shape)) > cost(best) for _ in range(5))


@pytest.mark.parametrize("as_matrices", [False, True])
def test_chosen_weights_are_the_ones_of_the_integral(as_matrices: bool) -> None:
    """A mass m under a force has the gains sqrt(q/r) and sqrt(s/r + 2 m sqrt(q/r)), by Riccati's equation."""
    q, s, r, m = 4.0, 0.5, 0.3, 2.0
    found = linearise(kernels := _mass(m), balance(kernels, find_pose(kernels, {}), {}))
    weights = (np.array([[r]]), np.diag([q, s])) if as_matrices else (r, [q, s])
    stiffness = np.sqrt(q / r)
    expected = [stiffness, np.sqrt(s / r + 2 * m * stiffness)]
    assert found.regulate(*weights)[0] == pytest.approx(expected, rel=1e-9)
    for wrong in ((0.0, 1.0), (r, [1.0, -1.0]), (r, [1.0, 2.0, 3.0]), (r, [[1.0, 1.0], [0.0, 1.0]])):
        with pytest.raises(ArgumentError):
            found.regulate(*wrong)


MASS = """\
name: mass
gravity: [0, 0, -9.81]
parameters: {{m: {{value: {m}, kind: runtime}}}}
bodies:
  - {{name: mass, joint: {{name: x, type: prismatic, axis: x}}, mass: m}}
"""


def _mass(m: float) -> Mechanism:
    with TemporaryDirectory() as folder:
        path = Path(folder, "mass.yaml")
        path.write_text(MASS.format(m=m), encoding="utf-8")
        return load(path, extent=INTEGRATED)


SHAKEN = """\
name: shaken
gravity: [0, 0, -9.81]
driven: [table]
bodies:
  - {name: table, joint: {name: table, type: prismatic, axis: x, actuated: false}, mass: 3}
  - name: seat
    parent: table
    joint: {name: seat, type: prismatic, axis: x, stiffness: 50, damping: 1.5, actuated: false}
    mass: 2
frames:
  - {name: head, body: seat}
"""


def test_a_shaken_base_transmits_as_the_textbook_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative to the base m w^2/(k - m w^2 + i c w); absolute, (k + i c w) by the same: the transmissibility."""
    monkeypatch.chdir(tmp_path)
    Path("shaken.yaml").write_text(SHAKEN, encoding="utf-8")
    kernels = load(Path("shaken.yaml"), extent=INTEGRATED)
    found = linearise(kernels, balance(kernels, find_pose(kernels, {}), {}))
    f = np.array([0.1, 0.8, 5.0])
    w, (k, c, m) = 2 * np.pi * f, (50, 1.5, 2)
    below, transmitted = k - m * w**2 + 1j * c * w, found.transmit(f)
    assert found.outputs == ("seat", "head.x", "head.y", "head.z")
    assert transmitted[:, 0, 0] == pytest.approx(m * w**2 / below, rel=1e-9)
    assert transmitted[:, 1, 0] == pytest.approx((k + 1j * c * w) / below, rel=1e-9)
    assert CliRunner().invoke(cli, ["linearise", "shaken.yaml", "-o", "out"]).exit_code == 0
    written = json.loads(Path("out/linearisation.json").read_text(encoding="utf-8"))
    assert written["excitation"] == {"M": [[2.0]], "C": [[0.0]], "K": [[0.0]], "G": [[0.0], [1.0], [0.0], [0.0]]}
    assert Path("out/responses.png").exists()


def test_a_shaken_loop_moves_as_its_driven_joint_does(tmp_path: Path) -> None:
    """Slowly, the mechanism of a shaken four-bar on springs follows the driven joint: differences of equilibria."""
    (tmp_path / "shaken.yaml").write_text(SHAKEN_LOOP, encoding="utf-8")
    kernels = load(tmp_path / "shaken.yaml", extent=INTEGRATED)
    at = settle(kernels, find_pose(kernels, {}), np.zeros(0))
    found, step = linearise(kernels, at), 1e-4
    places = [kernels.manifest.positions.index(name) for name in found.freedoms]
    driven = kernels.manifest.positions.index(found.driven[0])
    ends = []
    for sign in (1, -1):
        moved = at.q.copy()
        moved[driven] += sign * step
        ends.append(settle(kernels, Closure(kernels).move(at.q, [driven], moved[[driven]]), np.zeros(0)).q[places])
    expected = (ends[0] - ends[1]) / (2 * step)
    d = len(found.freedoms)
    assert found.transmit(np.array([0.0]))[0, :d, 0] == pytest.approx(expected, rel=1e-5)
    assert np.abs(expected).max() > 0.01


def test_a_ball_alone_settles_where_its_mass_hangs(tmp_path: Path) -> None:
    """A pendulum that swings as sqrt(m g l / (I + m l^2)) about two axes, and turns freely about the third."""
    (tmp_path / "bob.yaml").write_text(
        "name: bob\ngravity: [0, 0, -9.81]\nbodies:\n"
        "  - {name: bob, joint: {type: ball}, mass: 1, com: [0, 0, -1], inertia: [0.1, 0.1, 0.1]}\n",
        encoding="utf-8",
    )
    kernels = load(tmp_path / "bob.yaml", extent=INTEGRATED)
    tilted = np.array([np.sin(0.1), 0.0, 0.0, np.cos(0.1)])
    found = linearise(kernels, settle(kernels, tilted, np.zeros(3)))
    swings = sorted(mode.pole.imag for mode in found.modes)
    assert swings[-2:] == pytest.approx([np.sqrt(9.81 / 1.1)] * 2, rel=1e-9)
    assert Closure(kernels).measure_strength(tilted) == 1.0


def test_a_horizontal_arm_settles_where_it_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without stiffness where it starts: its weight's moment is the largest there. The driven table stays."""
    monkeypatch.chdir(tmp_path)
    Path("table.yaml").write_text(write_model("driven"), encoding="utf-8")
    kernels = load(Path("table.yaml"), extent=INTEGRATED)
    for angle in (0.0, np.pi, 1e-9):
        q = settle(kernels, np.array([0.4, angle]), np.zeros(1)).q
        assert [q[0], np.cos(q[1])] == pytest.approx([0.4, 0.0], abs=1e-8)
        assert np.sin(q[1]) > 0  # its mass is at (0.2, 0, 0) of its frame, which turns about y


def test_a_crate_with_a_bob_settles_on_its_corners(tmp_path: Path) -> None:
    """The corners carry the weight: N = k d^(3/2) in sum, and in moments about the centres of mass; the bob hangs."""
    (tmp_path / "crate.yaml").write_text(
        "name: crate\ngravity: [0, 0, -9.81]\nbodies:\n"
        "  - {name: hull, joint: {type: free}, mass: 2, inertia: [0.1, 0.2, 0.3], com: [0.01, 0, 0]}\n"
        "  - {name: bob, parent: hull, joint: {type: ball, position: [0.1, 0, 0]}, mass: 0.5, com: [0.2, 0, 0], "
        "inertia: [0.01, 0.02, 0.02]}\n"
        "contacts: [{name: box, body: hull, size: [0.4, 0.3, 0.2], stiffness: 1e5}]\n",
        encoding="utf-8",
    )
    kernels = load(tmp_path / "crate.yaml", extent=INTEGRATED)
    start = np.array([0, 0, 0.099, 0, 0, 0, 1, 0, np.sqrt(0.5), 0, np.sqrt(0.5)])
    q = settle(kernels, start, np.zeros(len(kernels.manifest.actuated))).q
    tilt = 2 * np.arctan2(q[4], q[6])  # about y; x leans to -z
    x = np.array([0.2, -0.2]) * np.cos(tilt) - 0.1 * np.sin(tilt)
    depth = -(q[2] - np.array([0.2, -0.2]) * np.sin(tilt) - 0.1 * np.cos(tilt))
    N = 2 * 1e5 * depth**1.5
    assert N.sum() == pytest.approx(2.5 * 9.81, rel=1e-5)
    hung = 0.1 * np.cos(tilt)
    assert N @ x == pytest.approx(9.81 * (2 * 0.01 * np.cos(tilt) + 0.5 * hung), rel=1e-3)
    assert tilt + 2 * np.arctan2(q[8], q[10]) == pytest.approx(np.pi / 2, abs=1e-8)


def test_poles_beside_a_change_point_are_doubted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A parallelogram in line may go on as a parallelogram or crossed: its equations depend on each other there."""
    monkeypatch.chdir(tmp_path)
    link = "type: revolute, axis: y, actuated: false"
    Path("bars.yaml").write_text(
        "name: bars\ngravity: [0, 0, 0]\nbodies:\n"
        "  - {name: a, joint: {name: q1, type: revolute, axis: y}, mass: 1, inertia: [1, 1, 1]}\n"
        f"  - {{name: b, parent: a, joint: {{name: q2, {link}, position: [0.2, 0, 0]}}, mass: 1, inertia: [1, 1, 1]}}\n"
        f"  - {{name: c, joint: {{name: q3, {link}, position: [0.5, 0, 0]}}, mass: 1, inertia: [1, 1, 1]}}\n"
        "loops:\n  - {name: pin, type: hinge, axis: y, from: {body: b, position: [0.5, 0, 0]}, to: {body: c, position:"
        " [0.2, 0, 0]}}\nindependent: [q1]\nassembly: {q1: -1, q2: 1, q3: -1}\n",
        encoding="utf-8",
    )
    for angle, is_doubted in ((1.0, False), (1e-5, True)):
        pose = [f"--pose=q1={-angle}", f"--pose=q2={angle}", f"--pose=q3={-angle}"]
        run = CliRunner().invoke(cli, ["linearise", "bars.yaml", *pose, "-o", "out"])
        assert run.exit_code == 0
        assert ("almost depend on each other" in run.output) is is_doubted


@pytest.mark.parametrize("angle", [1e-6, -1e-4, 1e-2])
def test_a_small_force_is_missing_too(angle: float) -> None:
    """Rounding alone is no force: the weight's moment at a small angle is shown in its size, and hanging is at rest."""
    kernels = _load("double_pendulum")
    weight = abs(float(kernels("impl", q=[angle, 0], qd=[0, 0], qdd=[0, 0])["Phi"][0]))
    with pytest.raises(BalanceError, match=re.escape(f"a force of {weight:.3g} along")):
        balance(kernels, np.array([angle, 0.0]), {})
    assert balance(kernels, np.zeros(2), {}).u.size == 0


def test_a_pose_that_nothing_keeps_is_refused() -> None:
    kernels = _load("double_pendulum")
    with pytest.raises(BalanceError, match=r"force of 5\.\d+ along q1 is not balanced; settle it"):
        balance(kernels, np.array([0.3, 0.0]), {})
    with pytest.raises(OpenError):
        balance(_load("four_bar"), np.zeros(3), {})


SHAKEN_LOOP = """\
name: shaken_loop
gravity: [0, 0, -9.81]
driven: [table]
bodies:
  - {name: table, joint: {name: table, type: prismatic, axis: x, actuated: false}, mass: 1}
  - name: crank
    parent: table
    joint: {name: crank, type: revolute, axis: -y, actuated: false, stiffness: 20, rest: 1}
    mass: 1
    com: [0.1, 0, 0]
  - name: coupler
    parent: crank
    joint: {name: pin, type: revolute, axis: -y, position: [0.2, 0, 0], actuated: false}
    mass: 0.5
    com: [0.3, 0, 0]
  - name: rocker
    joint: {name: rocker, type: revolute, axis: -y, position: [0.7, 0, 0], actuated: false}
    mass: 1
    com: [0.2, 0, 0]
loops:
  - {name: pin2, type: hinge, axis: y, from: {body: coupler, position: [0.6, 0, 0]},
     to: {body: rocker, position: [0.4, 0, 0]}}
independent: [table, crank]
assembly: {table: 0, crank: 60 deg, pin: -45 deg, rocker: 80 deg}
"""


def test_the_command_writes_a_feedback_that_balances(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model, runner = str(FOLDER / "cart_pole.yaml"), CliRunner()
    run = runner.invoke(
        cli, ["linearise", model, "--pose", "pole=pi", "--regulate", "0.1", "--format", "svg"], catch_exceptions=False
    )
    assert run.exit_code == 0
    written = json.loads(Path("cart_pole.linear/linearisation.json").read_text(encoding="utf-8"))
    assert written["stable"] is False
    assert len(written["gains"][0]) == 4
    assert {x.name for x in Path("cart_pole.linear").iterdir()} == {"linearisation.json", "poles.svg", "responses.svg"}
    assert [find_kind(x) for x in Path("cart_pole.linear").glob("*.svg")] == ["svg", "svg"]
    (feedback,) = re.findall(r"--input '(.*)'", run.stdout)
    arguments = ["simulate", model, "--pose", "pole=pi+0.2", "--duration", "12", "--input", feedback, "-o", "out"]
    assert runner.invoke(cli, arguments, catch_exceptions=False).exit_code == 0
    last = Path("out/trajectory.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")
    assert [float(x) for x in last[1:5]] == pytest.approx([0, np.pi, 0, 0], abs=1e-3)
    assert feedback.startswith("cart=3.16227")
    assert "(q_pole - 3.14159265359)" in feedback
    assert "(q_cart" not in feedback
    options = ["--regulate", "0.1", "--weigh", "pole=10", "--weigh", "qd_cart=2", "--weigh-input", "cart=0.5"]
    run = runner.invoke(cli, ["linearise", model, "--pose", "pole=pi", *options, "-o", "weighed"])
    assert run.exit_code == 0
    weighed = json.loads(Path("weighed/linearisation.json").read_text(encoding="utf-8"))
    kernels = _load("cart_pole")
    found = linearise(kernels, balance(kernels, find_pose(kernels, {"pole": np.pi}), {}))
    assert weighed["gains"] == pytest.approx(found.regulate(0.5, [1, 10, 2, 1]), rel=1e-9)
    alone = runner.invoke(cli, ["linearise", model, "--pose", "pole=pi", "--weigh", "pole=10"])
    assert (alone.exit_code, "give it too" in alone.output) == (2, True)
    wrong = runner.invoke(cli, ["linearise", model, "--pose", "pol=1"])
    assert wrong.exit_code == 2
    assert "give NAME=NUMBER" in wrong.output


def test_a_feedback_names_the_turns_of_a_joint_as_expressions_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`arm.rx` is `arm_rx` in an expression; gains that are 0 are left out; the weight is held."""
    monkeypatch.chdir(tmp_path)
    Path("crane.yaml").write_text(CRANE, encoding="utf-8")
    runner = CliRunner()
    run = runner.invoke(cli, ["linearise", "crane.yaml", "--pose", "rope=0.3", "--regulate", "0.1"])
    feedback = re.findall(r"--input '(.*)'", run.stdout)
    assert [re.findall(r"q_\w+", line) for line in feedback] == [["q_arm_rx"], ["q_arm_ry"], ["q_rope"]]
    assert feedback[2].startswith("rope=1.962 - 3.162")  # 0.2 kg
    arguments = [part for line in feedback for part in ("--input", line)]
    run = runner.invoke(
        cli,
        [
            "simulate",
            "crane.yaml",
            "--pose",
            "arm.rx=0.1",
            "--pose",
            "rope=0.2",
            "--duration",
            "9",
            *arguments,
            "-o",
            "x",
        ],
    )
    assert run.exit_code == 0, run.output
    last = Path("x/trajectory.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")
    assert [float(x) for x in last[1:4]] == pytest.approx([0, 0, 0.3], abs=1e-3)


def test_gains_of_quaternions_are_said_to_be_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke(cli, ["linearise", str(FOLDER / "satellite.yaml"), "--regulate", "1", "-o", "out"])
    assert run.exit_code == 0, run.output
    assert "--input" not in run.stdout
    assert "the gains are only in linearisation.json" in run.stderr
    assert json.loads(Path("out/linearisation.json").read_text(encoding="utf-8"))["gains"]


CRANE = """\
name: crane
gravity: [0, 0, -9.81]
bodies:
  - name: arm
    joint: {type: universal, axis: x, axis2: y}
    mass: 0.5
    com: [0, 0, -0.6]
    inertia: [0.06, 0.06, 0.01]
  - {name: hook, parent: arm, joint: {name: rope, type: prismatic, axis: z}, mass: 0.2}
"""
