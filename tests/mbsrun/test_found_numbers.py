"""Numbers that a solution found, or that a motion was made with, in everything that is done with it later."""

from __future__ import annotations

import csv
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

import mbsrun
from mbsrun import cli
from mbsrun.appearance import complete_manifest
from mbsrun.commands.animated import read_motion
from mbsrun.external import load_on_demand
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.solution.solution import Solution, read_solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.recordings import read_recording
from mbsrun.skeleton import place
from tests.mbsrun.carousel import CAROUSEL
from tests.mbsrun.running import Run, make_run

BAR = """\
name: bar
gravity: [0, 0, -9.81]
parameters:
  rocker: {value: 0.24, kind: differentiated}
  mass: 0.36
bodies:
  - {name: crank, joint: {name: motor, type: revolute, axis: -y}, mass: 0.15, com: [0.05, 0, 0],
     inertia: [0, 1e-4, 1e-4]}
  - name: coupler
    parent: crank
    joint: {name: pin, type: revolute, axis: -y, position: [0.1, 0, 0], actuated: false}
    mass: 0.42
    com: [0.14, 0, 0]
    inertia: [0, 3e-3, 3e-3]
  - name: rocker
    joint: {name: swing, type: revolute, axis: -y, position: [0.3, 0, 0], actuated: false}
    mass: mass
    com: [rocker/2, 0, 0]
    inertia: [0, mass*rocker**2/12, mass*rocker**2/12]
    visual: [{shape: box, size: [rocker, 0.02, 0.02], position: [rocker/2, 0, 0]}]
loops:
  - {name: closure, type: hinge, axis: y, from: {body: coupler, position: [0.28, 0, 0]},
     to: {body: rocker, position: [rocker, 0, 0]}}
independent: [motor]
assembly: {motor: 60 deg, pin: -29 deg, swing: 91 deg}
"""
TURN = """\
model: bar.yaml
horizon: 0.5
intervals: 16
scheme: radau
degree: 3
unknowns:
  rocker: {guess: 0.24, range: [0.22, 0.3]}
cost:
  inputs: 1
  terminal:
    - {expression: (rocker - 0.28)**2, weight: 100}
start: {pose: {motor: 60 deg}}
end: {pose: {motor: 150 deg}, velocity: zero}
accuracy: 1e-5
"""


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Solve for the length of a rocker, and return the folder of model, problem and `turn`."""
    folder = tmp_path_factory.mktemp("turned")
    (folder / "bar.yaml").write_text(BAR, "utf-8")
    (folder / "turn.ocp.yaml").write_text(TURN, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("sys.argv", ["mbsrun", "solve", "turn.ocp.yaml", "-o", "turn"])
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert end.value.code == 0
    return folder


@pytest.fixture
def run(turned: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in that folder."""
    return make_run(turned, monkeypatch, capsys)


def test_a_mechanism_is_drawn_with_the_lengths_found(turned: Path) -> None:
    """The ends of the loop are one point at all times: a rocker of 0.24 m would be centimetres away."""
    motion, _ = read_motion(turned / "turn", mbsrun.load(turned / "bar.yaml"), "turn")
    (part,) = motion.parts
    (length,) = read_solution(turned / "turn" / "solution.json").trajectory.unknowns
    assert abs(length - 0.24) > 0.01
    skeleton = place(part.kernels, part.q)
    (link,) = skeleton.links
    gap = skeleton.p[:, :, link.first] - skeleton.p[:, :, link.second]
    assert np.abs(gap).max() < 1e-9
    end = [0.3 + length * np.cos(part.q[:, 2]), np.zeros(len(part.q)), length * np.sin(part.q[:, 2])]
    np.testing.assert_allclose(skeleton.p[:, :, link.second].T, end, atol=1e-12)
    appearance = motion.manifest.appearance
    assert appearance is not None
    rocker = appearance.masses[2]
    assert rocker.com == pytest.approx((length / 2, 0, 0), abs=1e-15)
    assert rocker.inertia[:3] == pytest.approx((0, 0.03 * length**2, 0.03 * length**2), abs=1e-15)
    (box,) = appearance.drawings
    assert (box.size[0], box.at[0]) == pytest.approx((length, length / 2), abs=1e-15)


def test_a_simulation_takes_the_lengths_found(run: Run) -> None:
    """The inputs of the solution lead to its end, and each time is in the table once."""
    code, _, err = run("simulate", "bar.yaml", "--solution", "turn/solution.json", "-o", "again")
    assert (code, "warning" in err) == (0, False)
    found, solution = read_recording(Path("again/trajectory.csv")), read_solution(Path("turn/solution.json"))
    assert found.column("q[motor]")[-1] == pytest.approx(np.radians(150), abs=1e-4)
    assert np.diff(found.times).min() > 1e-6
    settings = json.loads(Path("again/simulation.json").read_text("utf-8"))
    assert settings["parameters"] == {"rocker": solution.trajectory.unknowns[0]}
    code, _, _ = run(
        *("simulate", "bar.yaml", "--solution", "turn/solution.json", "-o", "other"),
        *("--parameter", "rocker=0.25"),
    )
    assert code == 0
    assert json.loads(Path("other/simulation.json").read_text("utf-8"))["parameters"] == {"rocker": 0.25}


CART = """\
name: cart
gravity: [0, 0, 0]
bodies:
  - {name: cart, joint: {name: x, type: prismatic, axis: x}, mass: 2}
signals: [gain]
forces: [{name: spring, from: {body: base}, to: {body: cart, position: [1, 0, 0]}, force: -gain*t}]
wrenches: [{name: wind, body: cart, force: input}]
"""
BLOW = """\
model: cart.yaml
horizon: 1
intervals: 4
degree: 3
scheme: radau
cost: {inputs: 1}
start: {pose: {}}
wrenches: {wind: {force: [4*t, 0, 0]}}
signals: {gain: 2 + t}
"""


def test_a_simulation_takes_the_wrenches_and_signals_of_a_solution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without inputs, 2 x'' = 4 t + (2 + t) t from rest: x(1) = (6/6 + 1/12)/2, and x'(1) = (6/2 + 1/3)/2."""
    run = make_run(tmp_path, monkeypatch, capsys)
    for name, text in (("cart.yaml", CART), ("blow.ocp.yaml", BLOW)):
        Path(name).write_text(text, "utf-8")
    assert run("solve", "blow.ocp.yaml", "-o", "blow")[0] == 0
    code, _, err = run("simulate", "cart.yaml", "--solution", "blow/solution.json", "-o", "again")
    assert code == 0, err
    end = json.loads(Path("again/simulation.json").read_text("utf-8"))["end"]
    assert end["q"] == pytest.approx([13 / 24], rel=1e-7)
    assert end["qd"] == pytest.approx([5 / 3], rel=1e-7)
    Path("cart.yaml").write_text(CART.replace("force: input", "force: [1, 0, 0]"), "utf-8")
    code, _, err = run("simulate", "cart.yaml", "--solution", "blow/solution.json", "-o", "third")
    assert (code, "it has 5 components of open wrenches and signals, and the model 2" in err) == (2, True)


ROUND = """\
model: carousel.yaml
constants: {rate: 3}
unknowns: {more: {guess: 0.5, range: [0.5, 0.5]}}
horizon: 0.4
intervals: 10
degree: 4
scheme: radau
driven: {q1: rate*t**2*(1 + more)/T}
cost: {inputs: 1}
start: {pose: {}}
"""


def test_a_simulation_takes_the_motion_of_driven_joints_of_a_solution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ends where the solution ends; a motion that is given has priority."""
    run = make_run(tmp_path, monkeypatch, capsys)
    for name, text in (("carousel.yaml", CAROUSEL), ("round.ocp.yaml", ROUND)):
        Path(name).write_text(text, "utf-8")
    assert run("solve", "round.ocp.yaml", "-o", "round")[0] == 0
    solution = read_solution(Path("round/solution.json")).trajectory
    for options, q1 in (((), 3 * 0.4 * 1.5), (("--driven", "q1=2*t**2"), 2 * 0.4**2)):
        code, _, err = run("simulate", "carousel.yaml", "--solution", "round/solution.json", "-o", "again", *options)
        assert code == 0, err
        q = json.loads(Path("again/simulation.json").read_text("utf-8"))["end"]["q"]
        assert q[0] == pytest.approx(q1, rel=1e-9)
        assert (abs(q[1] - solution.q[-1, 1]) < 1e-6) == (not options)


def test_another_mechanism_is_named(run: Run) -> None:
    """A comment changes nothing; another mass is another version of the model."""
    for text, changes in ((BAR + "# the rocker is light\n", False), (BAR.replace("0.36", "0.37"), True)):
        Path("changed.yaml").write_text(text, "utf-8")
        code, _, err = run("simulate", "changed.yaml", "--solution", "turn/solution.json", "-o", "changed")
        assert (code, "another version of the model" in err) == (0, changes)


def test_inverse_dynamics_takes_the_lengths_found(run: Run) -> None:
    """The forces of the table are the inputs in it."""
    code, _, _ = run("inverse-dynamics", "bar.yaml", "turn/solution.csv", "-o", "forces")
    assert code == 0
    given = read_recording(Path("turn/solution.csv")).column("u[motor]")
    found = read_recording(Path("forces/forces.csv")).column("u[motor]")
    inner = slice(3, -3)  # without the ends of the splines, which smooth inputs that are constant by steps
    assert float(np.sqrt(np.mean((found - given)[inner] ** 2))) < 0.05 * np.abs(given).max()
    (length,) = read_solution(Path("turn/solution.json")).trajectory.unknowns
    assert json.loads(Path("forces/forces.json").read_text("utf-8"))["parameters"] == {"rocker": length}


def test_a_mechanism_is_linearised_where_a_solution_ends(run: Run) -> None:
    """Loops are closed there with the length found; without it, this pose is open."""
    code, _, _ = run("linearise", "bar.yaml", "--solution", "turn/solution.json", "-o", "linear")
    assert code == 0
    found = json.loads(Path("linear/linearisation.json").read_text("utf-8"))
    last = read_solution(Path("turn/solution.json")).trajectory.q[-1]
    assert list(found["pose"].values()) == pytest.approx(last.tolist(), abs=1e-8)


def test_inverse_dynamics_takes_the_parameters_of_a_fit(run: Run) -> None:
    """A table has them in the summary beside it."""
    Path("fit").mkdir(exist_ok=True)
    Path("fit/motion.csv").write_bytes(Path("turn/solution.csv").read_bytes())
    Path("fit/motion.json").write_text('{"parameters": {"rocker": 0.26}}', "utf-8")
    code, _, _ = run("inverse-dynamics", "bar.yaml", "fit/motion.csv", "-o", "fitted")
    assert code == 0
    assert json.loads(Path("fitted/forces.json").read_text("utf-8"))["parameters"] == {"rocker": 0.26}


PENDULUM = """\
name: pendulum
gravity: [0, 0, -9.81]
parameters: {l: {value: 0.3, kind: runtime}, m: {value: 2, kind: runtime}}
bodies:
  - {name: arm, joint: {type: revolute, axis: -y}, mass: m, com: [0, 0, -l], inertia: [m*l**2/3, m*l**2/3, 0]}
"""


def test_centres_and_masses_follow_run_time_parameters(tmp_path: Path) -> None:
    """Without parameters the numbers are the model's; a body whose mass becomes 0 is drawn as none."""
    path = tmp_path / "model.yaml"
    path.write_text(PENDULUM, "utf-8")
    plant = mbsrun.load(find_folder(path, Extent(("frames",), derivatives=0)))
    longer = plant.with_parameters(l=0.5, m=4.0)
    assert place(longer, np.zeros((1, 1))).p[0, :, 1] == pytest.approx([0, 0, -0.5], abs=1e-15)
    assert place(plant, np.zeros((1, 1))).p[0, :, 1] == pytest.approx([0, 0, -0.3], abs=1e-15)
    appearance = complete_manifest(longer).appearance
    assert appearance is not None
    assert (appearance.masses[0].mass, appearance.masses[0].com) == (4.0, (0.0, 0.0, -0.5))
    none = complete_manifest(plant.with_parameters(m=0.0)).appearance
    assert none is not None
    assert none.masses == ()


# --- closed loops and controllers ----------------------------------------------------------------------------------

SPRING = """\
name: spring
gravity: [0, 0, 0]
parameters:
  m: {value: 2, kind: runtime}
  k: {value: 1, kind: differentiated}
bodies:
  - {name: puck, joint: {name: x, type: prismatic, axis: x, stiffness: k}, mass: m}
"""
SWING = """\
model: spring.yaml
parameters: {m: 4}
unknowns: {k: {guess: 1, range: [0.5, 9]}}
horizon: 1
intervals: 20
scheme: radau
degree: 2
start: {pose: {x: 0.5}}
cost:
  inputs: 1
  running: [{expression: (q_x - 0.5*cos(t))**2, weight: 100}]
  terminal: [{expression: (k - 3)**2, weight: 1e-3}]
"""
RATE = "duration: 0.25\nrate: 20\n"


@pytest.fixture(scope="module")
def swinging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a problem that chooses the stiffness of a spring and gives a mass, and its controller."""
    folder = tmp_path_factory.mktemp("swinging")
    for name, text in (("spring.yaml", SPRING), ("swing.ocp.yaml", SWING), ("swing.track.yaml", RATE)):
        (folder / name).write_text(text, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("CFLAGS", "-O0")
        patch.setattr("sys.argv", ["mbsrun", "controller", "swing.ocp.yaml", "-o", "controller"])
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert end.value.code == 0
    return folder


def read_rows(file: Path) -> list[dict[str, float]]:
    with file.open(encoding="utf-8") as stream:
        return [{key: float(x) for key, x in row.items() if key != "status"} for row in csv.DictReader(stream)]


@pytest.mark.parametrize("options", [[], ["--controller", "controller"]])
def test_the_plant_of_a_loop_has_the_numbers_of_the_problem(
    swinging: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    """x'' = (u - k x) / m with the mass that the problem gives, and the stiffness that it found."""
    run = make_run(swinging, monkeypatch, capsys)
    monkeypatch.setattr("mbsrun.tracking.record.save", lambda *_: None)  # pictures take seconds
    problem, plant = read_problem(swinging / "swing.ocp.yaml", load_on_demand)
    solution = solve(problem, plant)
    assert isinstance(solution, Solution)
    (k,), m = solution.trajectory.unknowns, 4.0
    code, told, errors = run("track", "swing.ocp.yaml", "--settings", "swing.track.yaml", *options, "-o", "track")
    assert (code, f"k = {k:.5g}" in told) == (0, True), told + errors
    assert "another version" not in errors
    found = json.loads((swinging / "track" / "summary.json").read_text("utf-8"))["parameters"]
    assert found == {"m": 4.0, "k": pytest.approx(k, rel=1e-6)}
    rows, w, h = read_rows(swinging / "track" / "track.csv"), np.sqrt(k / m), 0.05
    for before, after in itertools.pairwise(rows):
        middle = before["u[x]"] / k
        x = middle + (before["q[x]"] - middle) * np.cos(w * h) + before["qd[x]"] / w * np.sin(w * h)
        assert after["q[x]"] == pytest.approx(x, abs=1e-8)


def test_a_controller_has_the_numbers_of_the_problem(swinging: Path) -> None:
    """Its optimum is the one of `mbsrun solve`, with the parameters and the numbers among its data."""
    problem, plant = read_problem(swinging / "swing.ocp.yaml", load_on_demand)
    solution = solve(problem, plant)
    assert isinstance(solution, Solution)
    controller = mbsrun.controller(swinging / "controller")
    assert controller.solve().cost == pytest.approx(solution.cost.total, rel=1e-6)
    assert (controller.data["parameters"][0], controller.data["theta"][0]) == (
        4.0,
        pytest.approx(solution.trajectory.unknowns[0], rel=1e-6),
    )
    assert controller.manifest.numbers == {"k": pytest.approx(controller.data["theta"][0])}


def test_loops_stay_closed_with_the_lengths_found(turned: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the reduced form a controller measures the velocities alone that the loops leave free."""
    monkeypatch.setenv("CFLAGS", "-O0")
    monkeypatch.setattr("mbsrun.tracking.record.save", lambda *_: None)  # pictures take seconds
    (length,) = read_solution(turned / "turn" / "solution.json").trajectory.unknowns
    (turned / "turn.track.yaml").write_text("duration: 0.25\nrate: 32\n", "utf-8")
    code, told, errors = run("controller", "turn.ocp.yaml", "-o", "controller")
    assert (code, "of 4 states and 1 inputs" in told) == (0, True), told + errors
    motions = []
    for options in ([], ["--controller", "controller"]):
        code, told, errors = run("track", "turn.ocp.yaml", "--settings", "turn.track.yaml", *options, "-o", "loop")
        assert (code, "another version" in errors) == (0, False), told + errors
        rows = read_rows(turned / "loop" / "track.csv")
        motor, pin, swing = (np.array([row[f"q[{name}]"] for row in rows]) for name in ("motor", "pin", "swing"))
        coupler = 0.1 * np.exp(1j * motor) + 0.28 * np.exp(1j * (motor + pin))
        assert coupler == pytest.approx(0.3 + length * np.exp(1j * swing), abs=1e-6)  # found twice, to 1e-8 of terms
        motions.append(motor)
    assert motions[0] == pytest.approx(motions[1], abs=1e-6)
