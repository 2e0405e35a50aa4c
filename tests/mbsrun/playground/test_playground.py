"""The page's module computes the numbers of the native kernels; the page fits a telephone and a screen, and moves.

Names are hostile: nothing of them may end the block of the page that holds them.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import mbsrun
from mbsgen.resources import folder as resources
from mbsgen.roles import Role
from mbsrun.cli import cli, main
from mbsrun.closure import Closure
from mbsrun.external import Mechanism, load
from mbsrun.library import CompileError
from mbsrun.linearisation import balance, linearise
from mbsrun.models import INTEGRATED, Extent
from mbsrun.playground import PlaygroundError, machine, render_playground
from mbsrun.playground.machine import (
    FUNCTIONS,
    LOOPED,
    OPTIONAL,
    describe_controller,
    list_functions,
    name_array,
)
from mbsrun.simulation import Formulation, Settings, simulate
from mbsrun.simulation.drive import hold

ROOT = Path(__file__).parents[3]
CALLS = Path(__file__).with_name("calls.js")
EXTENT = Extent(FUNCTIONS, 0, optional=(*OPTIONAL, *LOOPED, "loop_jacobian"))
MODEL = """\
name: 'cart <!--<script> "'
gravity: [0, 0, -9.81]
parameters:
  mp: {value: 0.3, kind: runtime}
  mc: {value: 1.0, kind: differentiated}
bodies:
  - name: cart
    joint: {name: 'c<!--<script>', type: prismatic, axis: x, limits: [-2, 2]}
    mass: mc
  - name: pole
    parent: cart
    joint: {name: pole, type: revolute, axis: -y, actuated: false, damping: 0.1}
    mass: mp
    com: [0, 0, -0.5]
"""
PROBLEM = """\
model: cart.yaml
horizon: 1
intervals: 5
scheme: radau
degree: 2
representation: EXP1-O
cost: {inputs: 0.5}
start:
  pose: {pole: 0.4}
end:
  pose: {pole: 0}
"""
OPEN = """\
<html><body><script>
const found = [];
async function visit(width) {
  const frame = document.createElement("iframe");
  frame.style.width = width + "px"; frame.style.height = "800px"; frame.src = "page.html";
  const loaded = new Promise((resolve) => { frame.onload = resolve; });
  document.body.appendChild(frame);
  await loaded;
  const inside = frame.contentWindow, root = frame.contentDocument.documentElement;
  const errors = [];
  inside.addEventListener("error", (event) => errors.push(event.message));
  inside.addEventListener("unhandledrejection", (event) => errors.push(String(event.reason)));
  for (let k = 0; k < 200 && root.dataset.ready !== "yes"; k++) await new Promise((resolve) => setTimeout(resolve, 20));
  const at = (id) => frame.contentDocument.getElementById(id);
  const cell = () => at("inverse").rows[2].cells[1].textContent;
  const slider = at("coordinates").querySelectorAll("input[type=range]")[1];
  const before = cell();
  slider.value = "1"; slider.dispatchEvent(new Event("input"));
  const moved = cell();
  at("drive").value = String(at("drive").options.length - 1); at("drive").dispatchEvent(new Event("change"));
  await new Promise((resolve) => setTimeout(resolve, 100));
  inside.playground.advance(0.5); inside.playground.refresh();
  found.push({ width, ready: root.dataset.ready, scroll: root.scrollWidth, before, moved, errors,
    state: [...inside.playground.model.get("coordinate")], clock: at("clock").textContent,
    title: at("title").textContent,
    drives: [...at("drive").options].map((option) => option.text), note: at("note").textContent });
  frame.remove();
}
(async () => {
  for (const width of [390, 1280]) await visit(width);
  document.title = "measured " + JSON.stringify(found);
})();
</script></body></html>
"""


@dataclass(frozen=True)
class Case:
    """A page with a generated controller and a regulator, and its model."""

    place: Path
    kernels: Mechanism
    page: Path


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    pytest.importorskip("ziglang")
    place = tmp_path_factory.mktemp("playground")
    (place / "cart.yaml").write_text(MODEL, encoding="utf-8")
    (place / "home.ocp.yaml").write_text(PROBLEM, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")  # which takes longer to run, and less to compile
        run("controller", place / "home.ocp.yaml", "-o", place / "home")
    options = ("--controller", place / "home", "--pose", "pole=0", "--regulate", "0.5")
    run("playground", place / "cart.yaml", *options, "-o", place / "page.html")
    return Case(place, load(place / "cart.yaml", extent=EXTENT), place / "page.html")


def run(*arguments: object) -> None:
    done = CliRunner().invoke(cli, [str(x) for x in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output


def ask(requires: Callable[[str], str], page: Path, place: Path, requests: dict[str, Any]) -> dict[str, Any]:
    """Return the results of the page's own calls, in node."""
    (place / "requests.json").write_text(json.dumps(requests), encoding="utf-8")
    kernels = resources("templates") / "html" / "kernels.js"
    command = [requires("node"), CALLS, kernels, page, place / "requests.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def draw_states(kernels: Mechanism, rng: np.random.Generator, count: int) -> list[dict[str, list[float]]]:
    """Return numbers for each role that a function reads, except parameters."""
    kept = (Role.PARAMETER, Role.SETUP, Role.DESIGN)
    used = [kernel for kernel in kernels.manifest.kernels if kernel.name in (*FUNCTIONS, *OPTIONAL)]
    sizes = {x.role: x.nnz for kernel in used for x in kernel.inputs if x.role not in kept}
    return [{role.value: rng.uniform(-2, 2, size).tolist() for role, size in sizes.items()} for _ in range(count)]


def compute(kernels: Mechanism, state: dict[str, list[float]]) -> dict[str, dict[str, list[float]]]:
    """Return all results of the native kernels, matrices column by column."""
    found = {}
    for name in list_functions(kernels.manifest):
        inputs = {x.name: state[name_array(x)] for x in kernels.describe(name).inputs if name_array(x) in state}
        found[name] = {key: np.ravel(x, order="F").tolist() for key, x in kernels(name, **inputs).items()}
    return found


def list_differences(one: dict[str, Any], other: dict[str, Any]) -> list[float]:
    """Return the largest difference of each result, relative to its largest entry."""
    differences = []
    for name, results in one.items():
        for key, values in results.items():
            size = np.abs(values).max(initial=0.0) or 1.0
            differences.append(float(np.abs(np.subtract(values, other[name][key])).max(initial=0.0) / size))
    return differences


@pytest.mark.parametrize("model", ["cart", "satellite"])
def test_the_module_computes_the_numbers_of_the_native_kernels(
    model: str,
    case: Case,
    requires: Callable[[str], str],
    rng: np.random.Generator,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To 1e-14 of the largest entry, with other parameters than the model's; WebAssembly has no fused multiply-add."""
    monkeypatch.setenv("CFLAGS", "-ffp-contract=off -O1")
    kernels, page = load(case.place / "cart.yaml", extent=EXTENT), case.page
    if model == "satellite":
        kernels, page = load(ROOT / "models" / "satellite.yaml", extent=EXTENT), tmp_path / "page.html"
        page.write_text(render_playground(kernels), encoding="utf-8")
    names = [p.name for p in kernels.manifest.parameters]
    changed = kernels.with_parameters(**{name: 1.25 * kernels.parameters[name] for name in names})
    states = draw_states(kernels, rng, 5)
    requests = {"states": states, "start": {}, "steps": 0, "h": 0.0}
    found = ask(requires, page, tmp_path, {**requests, "parameters": [changed.parameters[name] for name in names]})
    differences = [
        x for k, state in enumerate(states) for x in list_differences(found["values"][k], compute(changed, state))
    ]
    assert len(differences) >= 5 * 11
    assert max(differences) <= 1e-14


def test_the_page_steps_as_the_simulation_does(case: Case, requires: Callable[[str], str], tmp_path: Path) -> None:
    """400 steps of rk4 under a constant force; 1e-11 is some 100 roundings of each step."""
    start = {"coordinate": [0.1, 2.0], "velocity": [0.5, -1.0], "force": [0.7]}
    requests = {"states": [], "start": start, "steps": 400, "h": 0.005, "parameters": [0.3]}
    motion = ask(requires, case.page, tmp_path, requests)["motion"]
    kernels = load(case.place / "cart.yaml", extent=INTEGRATED)
    expected = simulate(
        kernels, hold([0.7]), [0.1, 2.0], [0.5, -1.0], Settings(2.0, "rk4", Formulation.EXP2, step=0.005)
    )
    np.testing.assert_allclose(motion[-1], [*expected.q[-1], *expected.qd[-1]], rtol=0, atol=1e-11)


def place_slider_crank(angle: np.ndarray[Any, Any], speed: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the states of the compressor: r sin a + l sin(a + b) = 0, z = r cos a + l cos(a + b)."""
    r, length = 0.045, 0.140
    tilt = -np.arcsin(r / length * np.sin(angle))
    turning = -r * np.cos(angle) * speed / (length * np.cos(tilt))
    height = r * np.cos(angle) + length * np.cos(tilt)
    rising = -r * np.sin(angle) * speed - length * np.sin(tilt) * turning
    return np.stack((angle, tilt - angle, height, speed, turning - speed, rising), axis=-1)


def test_the_page_keeps_loops_closed_and_moves_driven_joints(
    requires: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crank with a given acceleration drives a piston: RK4 is exact for the crank, and geometry places the others.

    A joint that the loop determines takes no value: the page keeps the state.
    """
    monkeypatch.setenv("CFLAGS", "-ffp-contract=off -O1")
    kernels, page = load(ROOT / "models" / "compressor.yaml", extent=EXTENT), tmp_path / "page.html"
    page.write_text(render_playground(kernels), encoding="utf-8")
    angle, speed, acceleration, t = 0.7, 3.0, 5.0, 1e-3 * np.arange(1, 201)
    first = place_slider_crank(np.array(angle), np.array(speed)).tolist()
    arrays = {"force": [], "drive": [acceleration], "multiplier": [0.3, -0.2], "driving_force": [0.4]}
    state = {"coordinate": first[:3], "velocity": first[3:], "acceleration": [1.0, 2.0, 3.0], **arrays}
    state |= {"independent_velocity": [speed], "independent_acceleration": [-2.0]}
    requests = {
        "states": [state],
        "start": {},
        "steps": 200,
        "h": 1e-3,
        "parameters": [],
        "moves": [[0, 4.0], [2, 9.0]],
    }
    found = ask(requires, page, tmp_path, requests)
    assert set(found["values"][0]) == {*FUNCTIONS, *LOOPED}
    assert max(list_differences(compute(kernels, state), found["values"][0])) <= 1e-12
    expected = place_slider_crank(angle + speed * t + acceleration * t**2 / 2, speed + acceleration * t)
    np.testing.assert_allclose(found["motion"], expected, rtol=0, atol=1e-12)
    arrived, stayed = found["moved"]
    assert (arrived["arrives"], stayed["arrives"]) == (True, False)
    closed = place_slider_crank(np.array(4.0), np.array(0.0))[:3]
    for each in (arrived, stayed):
        np.testing.assert_allclose(each["at"], closed, rtol=0, atol=1e-12)
        assert np.abs(each["gap"]).max() <= 1e-12


SWING = """\
name: swing
gravity: [0, 0, -9.81]
bodies:
  - name: arm
    joint: {type: ball, actuated: false}
    mass: 2
    com: [0.3, 0, 0]
    inertia: [0.02, 0.03, 0.04]
  - name: rod
    parent: arm
    joint: {type: revolute, axis: z, position: [0.6, 0, 0], actuated: false}
    mass: 1
    com: [0.25, 0, 0]
    inertia: [0.01, 0.02, 0.02]
loops:
  - {name: anchor, type: ball, from: {body: rod, position: [0.5, 0, 0]}, to: {body: base, position: [0.7, 0.3, 0]}}
assembly: {rod: 60 deg}
"""


def test_the_page_keeps_loops_with_quaternions_closed(
    requires: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An arm on a ball joint, held by a rod: the page steps as the simulation does, and the rod stays anchored."""
    monkeypatch.setenv("CFLAGS", "-ffp-contract=off -O0")
    (tmp_path / "swing.yaml").write_text(SWING, encoding="utf-8")
    kernels, page = load(tmp_path / "swing.yaml", extent=EXTENT), tmp_path / "page.html"
    assert kernels.manifest.quaternions
    page.write_text(render_playground(kernels), encoding="utf-8")
    start = {"coordinate": list(kernels.manifest.pose), "velocity": [0.0] * 4}
    motion = ask(requires, page, tmp_path, {"states": [], "start": start, "steps": 40, "h": 0.005, "parameters": []})
    run("simulate", tmp_path / "swing.yaml", "--duration", 0.2, "--method", "rk4", "--step", 0.005, "-o", tmp_path)
    rows = (tmp_path / "trajectory.csv").read_text(encoding="utf-8").splitlines()
    found = np.array(motion["motion"][-1])
    expected = np.array([float(x) for x in rows[-1].split(",")][1 : 1 + len(found)])
    for state in (found, expected):
        state[:4] /= np.linalg.norm(state[:4])  # the length of a quaternion is free
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)
    assert np.abs(kernels("loops", q=found[:5])["gap"]).max() <= 1e-14


def test_a_controller_finds_the_plan_and_the_inputs_of_the_native_one(
    case: Case, requires: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both make the same steps of Newton's method; roundings differ."""
    monkeypatch.setenv("CFLAGS", "-O0")
    compare_controllers(
        requires, tmp_path, case.page, case.place / "home", ([0.2, 0.3], [0.1, -0.2]), [0.1, -0.2], [0.3]
    )


def test_a_controller_of_a_loop_gets_the_velocities_that_are_its_states(
    requires: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page knows velocities of all joints; the controller's states are of independent joints alone."""
    pytest.importorskip("ziglang")
    monkeypatch.setenv("CFLAGS", "-O0")
    text = (ROOT / "models" / "five_bar_reach.ocp.yaml").read_text("utf-8")
    text = re.sub(r"intervals: \d+", "intervals: 4", text).replace(
        "five_bar.yaml", str(ROOT / "models" / "five_bar.yaml")
    )
    (tmp_path / "reach.ocp.yaml").write_text(text, encoding="utf-8")
    run("controller", tmp_path / "reach.ocp.yaml", "-o", tmp_path / "reach")
    page = tmp_path / "page.html"
    run("playground", ROOT / "models" / "five_bar.yaml", "--controller", tmp_path / "reach", "-o", page)
    native = mbsrun.controller(tmp_path / "reach")
    q = native.data["start_q"].tolist()
    closure = Closure(load(ROOT / "models" / "five_bar.yaml", extent=EXTENT))
    velocities = closure.complete_velocities(np.array(q), closure.independent, np.array([0.1, -0.2]))
    compare_controllers(requires, tmp_path, page, tmp_path / "reach", (q, velocities.tolist()), [0.1, -0.2], [])


def compare_controllers(
    requires: Callable[[str], str],
    place: Path,
    page: Path,
    folder: Path,
    state: tuple[list[float], list[float]],
    chosen: list[float],
    parameters: list[float],
) -> None:
    """Compare plans and inputs of the page with the native ones; `chosen` are the velocities among the states."""
    q, qd = state
    start = {"coordinate": q, "velocity": qd}
    requests = {"states": [], "start": start, "steps": 0, "h": 0.0, "parameters": parameters}
    (found,) = ask(requires, page, place, requests)["control"]
    native = mbsrun.controller(folder)
    native.data["start_q"][:], native.data["start_qd"][:] = q, chosen
    result = native.solve()
    assert result.is_solved
    assert (found["status"], found["message"]) == (0, result.message)
    for k, each in enumerate(found["stepped"]):
        native.prepare(shift=k > 0)
        inputs, _ = native.feedback([*q, *chosen])
        assert each["status"] == 10
        np.testing.assert_allclose(each["inputs"], inputs, rtol=1e-7, atol=1e-7)
    plan = native.plan()
    assert found["period"] == native.period
    np.testing.assert_allclose(found["times"], plan.times, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["states"], plan.states.ravel(), rtol=0, atol=1e-7)


def test_the_page_moves_in_a_browser_and_fits_it(case: Case, requires: Callable[[str], str]) -> None:
    """A slider changes the torques, a regulator drives the simulation, and nothing is reported on the console."""
    (case.place / "open.html").write_text(OPEN, encoding="utf-8")
    options = ("--headless", "--no-sandbox", "--allow-file-access-from-files", "--enable-unsafe-swiftshader")
    rendering = ("--use-gl=angle", "--use-angle=swiftshader", "--window-size=1400,900", "--virtual-time-budget=20000")
    done = subprocess.run(
        [
            *(requires("chromium"), *options, *rendering, "--enable-logging=stderr", "--dump-dom"),
            (case.place / "open.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    measured = re.search(r"<title>measured (.*?)</title>", done.stdout)
    assert measured is not None, done.stderr[-2000:]
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []
    for found in json.loads(measured[1].replace("&quot;", '"').replace("&lt;", "<").replace("&gt;", ">")):
        assert found["ready"] == "yes"
        assert found["errors"] == []
        assert found["scroll"] <= found["width"]
        assert found["before"] == "0.0000"
        assert float(found["moved"]) == pytest.approx(0.3 * 9.81 * 0.5 * np.sin(1.0), abs=1e-3)
        assert found["title"] == 'cart <!--<script> "'
        assert found["drives"][2] == "predictive controller home"
        assert found["drives"][3].startswith("linear-quadratic regulator")
        assert found["clock"] == "0.50 s"
        assert found["note"] == ""
        assert np.isfinite(found["state"]).all()
        assert found["state"][1] != 1.0


def test_the_same_mechanism_gives_the_same_bytes(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the cache, and compiled again in another folder."""
    first = render_playground(case.kernels)
    assert not re.search(r"""\b(?:src|href)\s*=|https?:""", first)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert render_playground(load(case.kernels.folder)) == first


def test_mechanisms_and_controllers_that_do_not_fit_are_refused(
    case: Case, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(PlaygroundError, match=r"home: controls .* with other coordinates or inputs than satellite has"):
        describe_controller(case.place / "home", load(ROOT / "models" / "satellite.yaml", extent=EXTENT).manifest)
    with pytest.raises(PlaygroundError, match="satellite has quaternions"):
        run("playground", ROOT / "models" / "satellite.yaml", "--regulate", "1", "-o", case.place / "satellite.html")
    assert not (case.place / "satellite.html").exists()
    done = CliRunner().invoke(cli, ["playground", "cart.yaml", "--pose", "pole=1"])
    assert (done.exit_code, "give both" in done.output) == (2, True)
    monkeypatch.setattr("mbsrun.library.find_spec", lambda _: None)
    with pytest.raises(CompileError, match=r"ziglang is not installed; run .*: pip install '\.\[compiler\]'"):
        render_playground(case.kernels)
    monkeypatch.setattr("sys.argv", ["mbsrun", "playground", str(case.place / "cart.yaml")])
    with pytest.raises(SystemExit):
        main()
    assert "ziglang is not installed" in capsys.readouterr().err


def test_places_of_nonzeros_are_in_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nonzeros at their places in column-major order are the dense result: of matrices that are not symmetric, too."""
    monkeypatch.setattr(machine, "compile_module", lambda *_: b"")
    monkeypatch.setattr("mbsgen.machine.LOOPED", ("loop_jacobian",))
    kernels = load(ROOT / "models" / "slider_crank.yaml", extent=EXTENT)
    described = machine.describe_machine(kernels)["functions"]["loop_jacobian"]["results"]
    state = {"q": kernels.manifest.pose, "qd": np.ones(3)}
    for each in (found for found in described if "places" in found):
        dense = kernels("loop_jacobian", **state)[each["name"]]
        found = np.zeros(dense.size)
        found[each["places"]] = kernels("loop_jacobian", sparse=True, **state)[each["name"]]
        np.testing.assert_array_equal(found.reshape(dense.shape, order="F"), dense)
    assert any(each["rows"] != each["cols"] for each in described if "places" in each)


def test_a_regulator_holds_the_pose_it_was_found_for(case: Case) -> None:
    """Of a pole that stands, on a cart beside the origin."""
    kernels = load(case.place / "cart.yaml", extent=Extent(FUNCTIONS, 1, optional=(*OPTIONAL, *LOOPED, "sensors")))
    found = linearise(kernels, balance(kernels, np.array([0.4, np.pi]), {}))
    assert machine.describe_regulator(kernels.manifest, found, 0.5)["pose"] == pytest.approx([0.4, np.pi])
