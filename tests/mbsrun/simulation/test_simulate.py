"""Refusals and stops of simulations, and the output of the command."""

from __future__ import annotations

import csv
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, FUNCTIONS, evaluate, parse
from mbsgen.resources import folder
from mbsrun import Mechanism, cli, load
from mbsrun.kernel import ArgumentError
from mbsrun.models import INTEGRATED, WHOLE
from mbsrun.recordings import read_recording
from mbsrun.simulation import METHODS, Formulation, Settings, simulate
from mbsrun.simulation.drive import ARRAYS, DriveError, express, hold, hold_steps
from mbsrun.simulation.integration import explicit
from mbsrun.simulation.integration.methods import Family, complete_settings
from mbsrun.simulation.record import draw_motion
from mbsrun.simulation.statement import Statement, read_statement
from tests.picture_kinds import find_kind

REST = hold(np.zeros(4))
ADAPTIVE = [name for name, method in METHODS.items() if method.family is Family.ADAPTIVE]
FIXED = [name for name in METHODS if name not in ADAPTIVE]


@pytest.mark.parametrize("formulation", Formulation)
@pytest.mark.parametrize("method", ["rk4", "symplectic-euler", "dop853", "gauss", "generalized-alpha"])
def test_a_singular_configuration_stops_with_time_and_joint(
    lock: Mechanism, method: str, formulation: Formulation
) -> None:
    """At the lock no method goes on, nor gives a number; with another start each does."""
    settings = Settings(0.01, method, formulation)
    motion = simulate(lock, hold(np.zeros(3)), [0, np.pi / 2, 0], [0.1, 0, 0], settings)
    assert motion.halt is not None
    assert motion.halt.time == 0
    assert motion.halt.joint in ("first", "third")
    assert "singular" in motion.halt.finding
    assert len(motion.t) == 1
    assert simulate(lock, hold(np.zeros(3)), [0, 1, 0], [0.1, 0, 0], settings).is_complete


@pytest.mark.parametrize("method", [m for m in METHODS if m not in ("radau-iia", "radau")])
def test_a_motion_that_runs_away_keeps_what_it_reached(bench: Mechanism, method: str) -> None:
    """x'' = x^3 from x = 2, x' = 2 sqrt 2 is x = sqrt 2 / (t* - t): infinite at t* = 1/sqrt 2.

    Adaptive methods stop there; methods with a fixed step soon after, when the numbers overflow.
    """
    settings = Settings(2.0, method, output_step=0.01)
    motion = simulate(bench.with_parameters(b=1.0), REST, [0, 0, 2], [0, 0, 2 * np.sqrt(2)], settings)
    assert motion.halt is not None
    assert motion.halt.joint == (None if method == "moreau" else "runner")  # its steps have no solution before
    assert motion.halt.time == pytest.approx(np.sqrt(0.5), abs=0.03 if "euler" in method else 0.01)
    assert motion.t[-1] <= motion.halt.time + 1e-12
    assert np.isfinite(motion.q).all()
    early = np.searchsorted(motion.t, 0.3)
    first_order = "euler" in method
    assert motion.q[early, 2] == pytest.approx(np.sqrt(2) / (np.sqrt(0.5) - 0.3), rel=0.02 if first_order else 1e-4)


def test_settings_that_cannot_be_are_refused(bench: Mechanism) -> None:
    q = [0, 0, 0]
    with pytest.raises(ValueError, match="3 finite numbers"):
        simulate(bench, REST, [0], q, Settings(1.0))
    with pytest.raises(ValueError, match="3 finite numbers"):
        simulate(bench, REST, q, [0, 0, np.nan], Settings(1.0))
    with pytest.raises(ValueError, match=r"\(4,\) expected"):
        simulate(bench, hold([0.0]), q, q, Settings(1.0))
    with pytest.raises(ValueError, match="no method 'rk5'"):
        simulate(bench, REST, q, q, Settings(1.0, "rk5"))
    with pytest.raises(ValueError, match="step = 0"):
        simulate(bench, REST, q, q, Settings(1.0, "rk4", step=0.0))
    with pytest.raises(ValueError, match="more than"):
        simulate(bench, REST, q, q, Settings(1.0, "rk4", step=1e-12))
    with pytest.raises(ValueError, match="inputs end at"):
        simulate(bench, hold_steps([0, 0.5], np.zeros((1, 4))), q, q, Settings(1.0))
    for times in ([0, 1, 1], [0.5, 1, 2], [0, 1]):
        with pytest.raises(ValueError, match="from 0 on"):
            hold_steps(times, np.zeros((2, 4)))


def test_expressions_over_time_are_those_of_the_language() -> None:
    """Functions and operators have the same values on arrays as on floats; an undefined value is reported with its
    time.
    """
    for name, count in FUNCTIONS.items():
        arguments = ["t", *(f"{k}/10 + t/100" for k in range(1, count))]  # in ascending order, as a curve's points
        expression = parse(f"{name}({', '.join(arguments)}) + 2*t**-2 - pi/t")
        t = np.array([0.3, 0.7])
        expected = [evaluate(expression, {"t": x}, FLOATS) for x in t]
        assert np.allclose(evaluate(expression, {"t": t}, ARRAYS), expected, rtol=1e-14)
    drive = express([parse("1/(t - 2)")], ["joint q1"], {})
    with pytest.raises(DriveError, match=r"joint q1 has no finite value at t = 2 s"):
        drive.pieces[0].at(2.0)


def test_a_formulation_stays_where_its_method_can_take_it() -> None:
    """Explicit methods take any; implicit steps of closed loops solve the residual in place of accelerations."""
    for formulation in Formulation:
        asked = Settings(1.0, "dop853", formulation)
        assert complete_settings(asked, is_closed=True).formulation is formulation
        taken = complete_settings(Settings(1.0, "radau-iia", formulation), is_closed=True).formulation
        assert taken is (Formulation.IMPL if formulation.evaluated.is_direct else formulation)


@pytest.mark.parametrize("name", ["mbs_explicit.c", "mbs_radau.c"])
def test_the_loops_are_clean_c(requires: Callable[[str], str], tmp_path: Path, name: str) -> None:
    source = folder("csrc") / name
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
    command = [requires("cc"), *strict, "-c", str(source), "-o", str(tmp_path / "simulate.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ADAPTIVE)
def test_an_adaptive_method_takes_no_more_steps_than_it_may(bench: Mechanism, method: str) -> None:
    """The number that the whole motion takes is enough; with one less, all but the end is reached and kept."""
    whole = simulate(bench, REST, [1, 0, 0], [0, 0, 0], Settings(1.0, method))
    steps = whole.effort.steps
    assert simulate(bench, REST, [1, 0, 0], [0, 0, 0], Settings(1.0, method, max_steps=steps)).is_complete
    short = simulate(bench, REST, [1, 0, 0], [0, 0, 0], Settings(1.0, method, max_steps=steps - 1))
    assert short.halt is not None
    assert f"limit of {steps - 1} steps is reached; raise max_steps" in str(short.halt)
    assert short.effort.steps == steps - 1
    assert 0.5 < short.t[-1] == short.halt.time < 1.0


def test_inputs_at_a_jump_are_the_next_ones(bench: Mechanism) -> None:
    """One row of inputs at each time; no state comes twice."""
    values = np.array([1.0, 2.0, 3.0])[:, None] * [0.25, 0.5, 0.75, 1.0]
    motion = simulate(
        bench, hold_steps([0, 0.25, 0.5, 1.0], values), [1, 0, 0], [0, 0, 0], Settings(1.0, output_step=0.125)
    )
    assert motion.t == pytest.approx(np.arange(9) / 8)
    assert motion.inputs == pytest.approx(values[[0, 0, 1, 1, 2, 2, 2, 2, 2]])


@pytest.mark.parametrize("method", ADAPTIVE)
def test_a_late_pulse_of_the_inputs_is_seen(bench: Mechanism, method: str) -> None:
    """All rest for 7.1 s, and errors of steps are 0; then the slider of 0.3 kg gets the impulse of 0.2 N s."""
    pulse = [parse(text) for text in ("max(0, 1 - abs(t - 7.3)/0.2)", "0", "0", "0")]
    drive = express(pulse, ["slider", "x", "y", "z"], {})
    motion = simulate(bench.with_parameters(k=0.0), drive, [0, 0, 0], [0, 0, 0], Settings(20.0, method))
    assert motion.qd[-1] == pytest.approx([0, 0.2 / 0.3, 0], rel=1e-5, abs=1e-12)


@pytest.mark.parametrize("method", FIXED)
def test_steps_are_counted_over_all_pieces_of_the_inputs(bench: Mechanism, method: str) -> None:
    """Each of three pieces takes a step at least; two steps end with the second."""
    drive = hold_steps([0, 0.1, 0.2, 0.3], np.zeros((3, 4)))
    motion = simulate(bench, drive, [1, 0, 0], [0, 0, 0], Settings(0.3, method, step=0.15, max_steps=2))
    assert motion.halt is not None
    assert "limit of 2 steps" in motion.halt.finding
    assert motion.t[-1] == motion.halt.time == 0.2


@pytest.mark.parametrize("method", ["rk4", "dop853", "gauss"])
def test_a_simulation_ends_when_its_seconds_are_used_up(
    bench: Mechanism, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here each look at the clock takes a second."""
    monkeypatch.setattr("mbsrun.limits.time.thread_time", itertools.count(0.0).__next__)
    motion = simulate(bench, REST, [1, 0, 0], [0, 0, 0], Settings(500.0, method, max_seconds=3))
    assert motion.halt is not None
    assert "limit of 3 s of processor time" in motion.halt.finding
    assert motion.effort.steps == 2 * {"rk4": explicit.STEPS, "dop853": explicit.FREE_STEPS}.get(method, 1)
    assert 0 < motion.t[-1] == motion.halt.time < 500


# --- settings --------------------------------------------------------------------------------------------------------

SETTINGS = """\
constants: {a: 2*pi}
duration: a
method: rk4
start: {pose: {bob: a/4, slider: 0.1}, velocity: {runner: 1}}
inputs: {slider: a*t}
wrenches: {push: {force: [0, t**2, 1]}}
parameters: {c: 3}
"""


def read(folder: Path, text: str, bench: Mechanism, **options: Any) -> Statement:
    file = folder / "settings.yaml"
    file.write_text(text, encoding="utf-8")
    return read_statement(file, options, bench.manifest)


def test_a_settings_file_says_all(tmp_path: Path, bench: Mechanism) -> None:
    statement = read(tmp_path, SETTINGS, bench)
    assert statement.settings == Settings(2 * np.pi, "rk4")
    assert statement.start.q.tolist() == [np.pi / 2, 0.1, 0]
    assert statement.start.qd.tolist() == [0, 0, 1]
    assert statement.drive.pieces[0].at(0.5).tolist() == [np.pi, 0, 0.25, 1]
    assert statement.parameters == {"c": 3}


def test_options_win_over_the_file(tmp_path: Path, bench: Mechanism) -> None:
    statement = read(tmp_path, SETTINGS, bench, method="gauss", stages=3, start={"pose": {"slider": "a/2"}})
    assert (statement.settings.method, statement.settings.stages) == ("gauss", 3)
    assert statement.start.q.tolist() == [np.pi / 2, np.pi, 0], "what an option does not name stays"


FAULTS = {
    "coordinate": ("start: {pose: {bop: 1}}", 'start.pose.bop: the model has no coordinate "bop"; did you mean "bob"?'),
    "passive": ("inputs: {runner: 1}", 'no actuated coordinate "runner"'),
    "wrench": ("wrenches: {pull: {force: [0, 0, 1]}}", 'no wrench with inputs "pull"'),
    "moment": ("wrenches: {push: {moment: [0, 0, 1]}}", "the moment of this wrench is not an input"),
    "name": ("inputs: {slider: x*t}", 'unknown name "x"'),
    "time": ("start: {pose: {bob: t}}", 'unknown name "t"'),
    "code": ("inputs: {slider: __import__('os')}", "has no meaning in an expression"),
    "method": ("method: rk5", 'found "rk5"; give one of euler'),
    "step": ("step: 0", "step: found 0; give a positive number"),
    "steps": ("step: 1e-12\nmethod: rk4", "1e+12 steps would be taken"),
    "outputs": ("output_step: 1e-9", "states would be kept"),
    "limit": (
        "step: 1e-3\nmethod: rk4\nmax_steps: 10",
        "1e+03 steps would be taken; take a longer step, or raise max_steps = 10",
    ),
    "no steps": ("max_steps: 0", "max_steps: found 0"),
    "seconds": ("max_seconds: 0", "max_seconds: found 0; give a positive number"),
    "rho": ("rho: 2", "give a number from 0 to 1"),
    "stages": ("stages: 10", "stages: found 10"),
    "constant": ("constants: {t: 1}", "no name for a constant"),
    "parameter": ("parameters: {z: 1}", 'no parameter that may be changed "z"'),
    "key": ("durration: 1", "did you mean `duration`?"),
}


@pytest.mark.parametrize(("text", "told"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_told_with_their_lines(tmp_path: Path, bench: Mechanism, text: str, told: str) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, f"duration: 1\n{text}\n", bench)
    assert "settings.yaml:2:" in str(error.value)
    assert told in str(error.value)


def test_all_faults_are_told_at_once_and_those_of_options_as_such(tmp_path: Path, bench: Mechanism) -> None:
    text = "method: generalized-alpha\nrho: 2\nstep: -1\n"
    with pytest.raises(InputError) as error:
        read(tmp_path, text, bench, start={"velocity": {"bop": "1"}}, max_seconds="x")
    lines = str(error.value).splitlines()
    assert len(lines) == 5
    assert sum(line.startswith("command line: ") for line in lines) == 2
    assert any("duration: missing" in line for line in lines)


@pytest.mark.parametrize(
    ("text", "options", "finding"),
    [
        (
            "method: rk4\nrtol: 1e-3\n",
            {},
            ":3: rtol: rk4 does not use it; leave it out, or give a method",
        ),
        ("step: 1e-3\n", {}, ":2: step: dop853 does not use it"),
        (
            "",
            {"stages": 3, "method": "rk4"},
            "command line: stages: rk4 does not use it; leave it out",
        ),
        ("alpha: 3\n", {}, ":2: alpha: a gain of loops: baumgarte; leave it out, or give that"),
    ],
)
def test_settings_without_effect_are_refused(
    text: str, options: dict[str, Any], finding: str, tmp_path: Path, bench: Mechanism
) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, f"duration: 1\n{text}", bench, **options)
    assert finding in str(error.value)


def test_another_method_on_the_command_line_needs_no_other_file(tmp_path: Path, bench: Mechanism) -> None:
    """The file's step is of no use to that method, but is not meant for it."""
    settings = read(tmp_path, "duration: 1\nmethod: rk4\nstep: 1e-3\n", bench, method="dop853").settings
    assert settings.method == "dop853"


# --- command ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Result:
    exit_code: object
    stdout: str
    stderr: str


Run = Callable[..., Result]


@pytest.fixture
def run(tmp_path: Path, bench_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Simulate the bench, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Result:
        monkeypatch.setattr(sys, "argv", ["mbsrun", "simulate", str(bench_file), *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return Result(end.value.code, *capsys.readouterr())

    return call


def test_the_command_writes_and_tells(run: Run) -> None:
    result = run(
        "--duration",
        "1",
        "--method",
        "rk4",
        "--pose",
        "bob=pi/2",
        "--input",
        "slider=sin(t)",
        "-o",
        "out",
        "--format",
        "pdf",
    )
    assert result.exit_code == 0, result.stderr
    for word in ("bench, 3 coordinates", "rk4", "step 0.001", "1000, 0 rejected", "energy drift"):
        assert word in result.stdout
    assert sorted(os.listdir("out")) == ["animation.html", "plots.pdf", "simulation.json", "trajectory.csv"]
    assert find_kind(Path("out/plots.pdf")) == "pdf"
    with Path("out/trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1001
    assert float(rows[0]["q[bob] [rad]"]) == np.pi / 2
    assert float(rows[-1]["input[slider] [N]"]) == pytest.approx(np.sin(1))
    assert list(rows[0])[-3:] == ["kinetic [J]", "potential [J]", "work [J]"]
    summary = json.loads(Path("out/simulation.json").read_text("utf-8"))
    assert summary["complete"] is True
    assert summary["end"]["q"] == [float(rows[-1][name]) for name in ("q[bob] [rad]", "q[slider] [m]", "q[runner] [m]")]
    assert summary["energy"]["largest_drift"] < 1e-8


@pytest.mark.parametrize(
    ("start", "duration"), [([1.0, 0.0, 0.0], 1.0), ([0.0, 0.0, 0.0], 1.0), ([0.0, 0.0, 2.0], 5.0)]
)
def test_the_drift_is_plotted_on_a_logarithmic_scale(bench: Mechanism, start: list[float], duration: float) -> None:
    """Between rounding and the drift that is warned of; where nothing moves, too; where it is unknown, that is said."""
    motion = simulate(bench.with_parameters(b=1.0), REST, start, [0, 0, start[2]], Settings(duration, "rk4"))
    figure = draw_motion(motion, bench.manifest)
    axes = figure.axes[-1]
    assert axes.get_ylabel() == "|energy drift| [J]"
    if motion.energy is None:
        assert "unknown" in axes.texts[0].get_text()
        return
    assert axes.get_yscale() == "log"
    drift, warning, rounding = (np.array(line.get_ydata()) for line in axes.lines)
    assert (drift > 0).all()
    assert rounding[0] <= drift.min()
    larger = drift > rounding[0]
    assert larger.any() == (start[0] != 0)
    np.testing.assert_array_equal(drift[larger], np.abs(motion.energy.drift)[larger])
    assert motion.energy.is_kept == (drift.max() <= warning[0])


def test_the_same_command_writes_the_same_bytes_but_for_the_time_taken(run: Run) -> None:
    for out in ("one", "two"):
        run("--duration", "0.1", "--pose", "bob=1", "-o", out)
    for name in ("animation.html", "plots.png", "trajectory.csv"):
        assert Path("one", name).read_bytes() == Path("two", name).read_bytes()
    one, two = (json.loads(Path(out, "simulation.json").read_text("utf-8")) for out in ("one", "two"))
    one["effort"].pop("seconds")
    two["effort"].pop("seconds")
    assert one == two


def test_a_motion_that_ends_early_is_written_as_incomplete(run: Run) -> None:
    """Exit code 1; time and joint on stderr; what was reached in files that say so."""
    result = run("--duration", "2", "--pose", "runner=2", "--velocity", "runner=3", "--parameter", "b=1", "-o", "out")
    assert result.exit_code == 1
    assert "stopped at t = 0.6" in result.stderr
    assert "joint runner" in result.stderr
    assert "incomplete" in result.stderr
    assert "Traceback" not in result.stderr
    summary = json.loads(Path("out/simulation.json").read_text("utf-8"))
    assert summary["complete"] is False
    assert summary["halt"]["joint"] == "runner"
    assert "incomplete" in Path("out/animation.html").read_text("utf-8")


def test_a_limit_ends_the_command_with_what_was_reached(run: Run) -> None:
    result = run("--duration", "1e4", "--max-steps", "20", "--pose", "bob=1", "-o", "out")
    assert result.exit_code == 1
    assert "the limit of 20 steps is reached; raise max_steps; what was written is incomplete" in result.stderr
    summary = json.loads(Path("out/simulation.json").read_text("utf-8"))
    assert (summary["complete"], summary["effort"]["steps"]) == (False, 20)
    assert run("--duration", "1e4", "--max-seconds", "-1").exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--duration", "1", "--pose", "bop=1"), 'did you mean "bob"?'),
        (("--duration", "1", "--pose", "bob"), "give NAME=VALUE"),
        (("--duration", "1", "--pose", "bob=1", "--pose", "bob=2"), "given twice"),
        (("--duration", "1", "--method", "rk5"), "rk5"),
        (("--duration", "1", "--input", "slider=1/(t - 0.5)", "--method", "rk4", "--step", "0.1"), "at t = 0.5 s"),
        (("--settings", "none.yaml"), "there is no such file"),
        (("--solution", "none.json"), "none.json"),
        ((), "duration: missing"),
    ],
)
def test_what_cannot_be_accepted_writes_nothing(run: Run, arguments: tuple[str, ...], told: str) -> None:
    result = run(*arguments, "-o", "out")
    assert result.exit_code == 2
    assert told in result.stderr
    assert "Traceback" not in result.stderr
    assert not Path("out").exists()


# --- kinds of parameters, and what was left out ----------------------------------------------------------------------

FALLING = """
name: falling
gravity: [0, 0, -9.81]
parameters:
  drag: {value: 0.5, kind: runtime}
  m: {value: 2, kind: differentiated}
bodies:
  - name: stone
    joint: {type: prismatic, axis: z, damping: drag}
    mass: m
"""


@pytest.fixture(scope="module")
def falling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("falling") / "falling.yaml"
    file.write_text(FALLING, encoding="utf-8")
    return file


@pytest.mark.parametrize("formulation", Formulation)
def test_parameters_of_both_kinds_reach_the_steps_in_c(falling: Path, formulation: Formulation) -> None:
    """A stone with drag falls with the speed (m g/d) (1 - exp(-d t/m)); RK4 with h = 1e-2 errs by less than 1e-10."""
    for m, d in ((2.0, 0.5), (3.0, 1.5)):
        stone = load(falling).with_parameters(m=m, drag=d)
        motion = simulate(stone, hold([0.0]), [0], [0], Settings(1.0, "rk4", formulation, step=1e-2))
        assert motion.qd[-1, 0] == pytest.approx(-m * 9.81 / d * (1 - np.exp(-d / m)), abs=1e-10)


@pytest.mark.parametrize("method", ["radau-iia", "gauss", "generalized-alpha", "bdf"])
def test_derivatives_that_are_generated_late_change_no_bit(falling: Path, method: str) -> None:
    """Implicit methods differentiate accelerations by default, with parameters that are not the model's."""
    settings, parameters = Settings(0.1, method, step=1e-2), {"m": 3.0, "drag": 1.5}
    plants = [load(falling, parameters, extent) for extent in (INTEGRATED, WHOLE)]
    late, whole = (simulate(plant, hold([0.5]), [0], [0], settings) for plant in plants)
    assert late.qd[-1, 0] < -0.5
    assert np.array_equal(late.q, whole.q)
    assert np.array_equal(late.qd, whole.qd)


def test_kernels_that_were_left_out_are_named(falling: Path, tmp_path: Path) -> None:
    run_mbsgen = [sys.executable, "-c", "from mbsgen.cli import main; main()"]
    generate = [*run_mbsgen, str(falling), "-o", str(tmp_path / "out"), "--functions", "exp2,energy"]
    subprocess.run(generate, check=True, capture_output=True)
    with pytest.raises(ArgumentError, match="was generated without frames, impl, jac_impl, power"):
        simulate(load(tmp_path / "out"), hold([0.0]), [0], [0], Settings(1.0))


def test_a_table_gives_the_inputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mass of 2 kg under a force that grows from 0 to 3 N in 1.5 s, and falls to 0 in 0.5: by integration."""
    monkeypatch.chdir(tmp_path)
    text = "name: mass\ngravity: [0, 0, -9.81]\nbodies:\n"
    text += "  - {name: mass, joint: {name: x, type: prismatic, axis: x}, mass: 2}\n"
    Path("mass.yaml").write_text(text, "utf-8")
    Path("push.csv").write_text("t,x [N],remark\n0,0,1\n1.5,3,2\n2,0,3\n", "utf-8")

    def run(*options: str) -> tuple[object, str]:
        command = ["mbsrun", "simulate", "mass.yaml", "--inputs", "push.csv", "-o", "out"]
        monkeypatch.setattr("sys.argv", [*command, *options])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, capsys.readouterr().err

    assert run()[0] == 0
    end = json.loads(Path("out/simulation.json").read_text("utf-8"))["end"]
    assert end["t"] == 2.0
    assert end["qd"] == pytest.approx([(0.5 * 1.5 * 3 + 0.5 * 0.5 * 3) / 2], rel=1e-9)
    ramp = (3 / 1.5) * 1.5**3 / 6 / 2
    assert end["q"] == pytest.approx([ramp + 0.5 * 2.25 / 2 + (3 * 0.5**2 / 2 - 6 * 0.5**3 / 6) / 2], rel=1e-9)
    table = read_recording(Path("out/trajectory.csv"))
    assert table.column("input[x]")[-1] == pytest.approx(0, abs=1e-12)
    assert (np.diff(table.times) > 0).all()
    for content, finding in (
        ("t,y\n0,1\n1,2\n", "no column is an input's"),
        ("t,x\n1,1\n2,2\n", "the first time is 1 s"),
        ("t,x\n0,1\n1,\n", "an input is missing at 1 s"),
        ("t,x [rad]\n0,1\n1,2\n", "it is in"),
    ):
        Path("push.csv").write_text(content, "utf-8")
        code, err = run()
        assert (code, finding in err) == (2, True), err
    Path("push.csv").write_text("t,u[x],u[y],q[y]\n0,1,0,0\n1,2,0,0\n", "utf-8")
    assert "warning: push.csv: u[y]: of no input of the model, which has x" in run()[1]
    Path("push.csv").write_text("t,x\n0,1\n1,2\n", "utf-8")
    assert "gives the inputs" in run("--input", "x=1")[1]
