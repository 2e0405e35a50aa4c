"""The command line: what it prints where, what it writes, and its exit codes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich import filesize

from mbsgen.help import ModelCommand
from mbsrun import cli, load
from mbsrun.cache import cache_folder
from mbsrun.commands import simulate, sweep
from mbsrun.commands import solve as solving
from mbsrun.commands.cache import DAY
from mbsrun.limits import Limits
from mbsrun.ocp.ground.status import ACCEPTABLE
from mbsrun.ocp.problem.problem import Form, Refinement
from mbsrun.ocp.searching.trials import COUNTS
from mbsrun.ocp.showing import pictures
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import read_solution
from mbsrun.ocp.solving import phases as phases_solve
from tests.mbsrun.peer_arm import peer_arm
from tests.picture_kinds import find_kind
from tests.sample import write_sample

PAPER = (Path(__file__).parents[2] / "models" / "arm_reach.ocp.yaml").read_text("utf-8")
TARGET = "{radius: 0.65, azimuth: 0.01, height: 0}"  # a small step aside: solved in a tenth of a second
COARSE = PAPER.replace("{radius: 0.63, azimuth: pi/2, height: -0.1}", TARGET) + "accuracy: 1e-2\n"
COARSE = COARSE.replace("intervals: 100", "intervals: 10").replace("degree: 4", "degree: 3")


@dataclass(frozen=True)
class Result:
    exit_code: object
    stdout: str
    stderr: str


Run = Callable[..., Result]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in an empty folder with the arm made by hand; a problem's text is put into task.ocp.yaml."""
    monkeypatch.chdir(tmp_path)
    arm = peer_arm()
    monkeypatch.setattr(simulate, "load", lambda _, **_extent: arm)
    monkeypatch.setattr(solving, "load_on_demand", lambda _: arm)
    monkeypatch.setattr(sweep, "load_on_demand", lambda _: arm)

    def call(*arguments: str, text: str = COARSE) -> Result:
        Path("task.ocp.yaml").write_text(text, "utf-8")
        monkeypatch.setattr(sys, "argv", ["mbsrun", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return Result(end.value.code, *capsys.readouterr())

    return call


@pytest.fixture
def quick(run: Run, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The same, with empty files for pictures."""
    for name in ("plot_trajectories", "draw_mechanism", "animate", "plot_starts", "plot_mesh"):
        monkeypatch.setattr(pictures, name, lambda *arguments: arguments[-1].touch())
    return run


def test_a_problem_is_solved(run: Run) -> None:
    """Exit code 0; the summary on stdout, what was written on stderr; a solution, two pictures and an animation."""
    result = run("solve", "task.ocp.yaml", "-o", "out", "--format", "pdf")
    assert result.exit_code == 0, result.stderr
    for word in ("task, model peer arm", "Solve_Succeeded", "variables", "cost", "defect", "open loop"):
        assert word in result.stdout
    assert "wrote out/solution.json, out/solution.csv, out/trajectories.pdf, out/mechanism.pdf" in result.stderr
    names = ["animation.html", "mechanism.pdf", "solution.csv", "solution.json", "trajectories.pdf"]
    assert sorted(os.listdir("out")) == names
    assert [find_kind(Path("out", name)) for name in names if name.endswith(".pdf")] == ["pdf", "pdf"]
    solution = read_solution(Path("out/solution.json"))
    assert f"{solution.cost.total:.10g}" in result.stdout
    assert solution.resimulation is not None


def test_the_grid_is_refined(quick: Run) -> None:
    """By an option, which has priority over the file; the summary lists the rounds, and a picture shows them."""
    result = quick("solve", "task.ocp.yaml", "-o", "out", "--refine", "1e-7", text=COARSE + "refine: {rounds: 3}\n")
    assert result.exit_code == 0, result.stderr
    assert "the re-simulation confirms the accuracy" in result.stdout
    assert "  round 0     10 intervals" in result.stdout
    assert Path("out/mesh.png").exists()
    solution = read_solution(Path("out/solution.json"))
    assert solution.problem.refine == Refinement(1e-7, 3)
    assert solution.resimulation is not None
    assert max(solution.resimulation.defects) <= 1e-7
    result = quick("solve", "task.ocp.yaml", "-o", "none", "--refine", "1e-20")
    assert result.exit_code == 2
    assert "--refine 1e-20: give at least 1e-12" in result.stderr


def test_the_folder_is_named_after_the_problem(quick: Run) -> None:
    assert quick("solve", "task.ocp.yaml").exit_code == 0
    assert Path("task.solution/solution.json").exists()


def test_another_target(quick: Run) -> None:
    """Radius, azimuth and height, as expressions, negative ones too."""
    result = quick("solve", "task.ocp.yaml", "-o", "out", "--target", "0.65", "-pi/100", "-0.001")
    assert result.exit_code == 0, result.stderr
    ((_, target),) = read_solution(Path("out/solution.json")).problem.end.sensors
    assert target == pytest.approx((0.65 * cos(pi / 100), -0.65 * sin(pi / 100), -0.001))


def test_another_solution_is_a_guess(quick: Run) -> None:
    """Of another grid; given on the command line, or named in the problem, beside its file."""
    assert quick("solve", "task.ocp.yaml", "-o", "out").exit_code == 0
    first = read_solution(Path("out/solution.json"))
    finer = COARSE.replace("intervals: 10", "intervals: 12")
    for arguments, text in (
        (("--guess", "out/solution.json"), finer),
        ((), finer.replace("upright:", "solution: out/solution.json\n  upright:")),
    ):
        result = quick("solve", "task.ocp.yaml", "-o", "again", *arguments, text=text)
        assert result.exit_code == 0, result.stderr
        second = read_solution(Path("again/solution.json"))
        assert second.problem.intervals == 12
        assert second.run.iterations < first.run.iterations


def test_representation_solver_and_guess_are_chosen(quick: Run) -> None:
    """The command line has priority over the file, and the file's options for another solver are dropped."""
    text = COARSE + "solver: {options: {mu_strategy: adaptive}}\n"
    chosen = ("--guess-inputs", "static", "--solver", "sqpmethod", "--representation", "impl")
    result = quick("solve", "task.ocp.yaml", "-o", "out", *chosen, text=text)
    assert result.exit_code == 0, result.stderr
    problem = read_solution(Path("out/solution.json")).problem
    assert (problem.guess.inputs, problem.solver.method, problem.solver.options) == ("static", "sqpmethod", ())


def test_many_starts_go_on_and_tell_what_they_found(quick: Run) -> None:
    """The best of four, by the words of the summary; with six, two more are made. The earlier results stay."""
    counts = []
    for starts in (4, 6):
        result = quick("solve", "task.ocp.yaml", "-o", "out", "--starts", str(starts), "--seed", "3")
        assert result.exit_code == 0, result.stderr
        solution = read_solution(Path("out/solution.json"))
        assert solution.starts is not None
        assert (solution.starts.seed, len(solution.starts.results)) == (3, starts)
        assert solution.starts.best is not None
        assert solution.cost.total == pytest.approx(solution.starts.best.cost, rel=1e-6)
        times = solution.starts.times
        told = "once" if times == 1 else f"{times} times"
        assert f"the lowest cost was found {told} in {starts} starts; lower ones may exist" in result.stdout
        assert {"starts.png", "starts.sqlite"} <= set(os.listdir("out"))
        counts.append([start.cpu_seconds for start in solution.starts.results])
    assert counts[1][:4] == counts[0]  # to the last digit: they were not solved again


def test_hops_go_on_from_the_best(quick: Run) -> None:
    result = quick("solve", "task.ocp.yaml", "-o", "out", "--starts", "1", "--hops", "2")
    assert result.exit_code == 0, result.stderr
    starts = read_solution(Path("out/solution.json")).starts
    assert starts is not None
    assert len(starts.hops) in range(2, 20, 2)
    assert f"{len(starts.hops)} hops" in result.stdout


def test_a_search_without_time_makes_no_start(quick: Run) -> None:
    result = quick("solve", "task.ocp.yaml", "-o", "out", "--starts", "3", "--minutes", "0")
    assert result.exit_code == 1
    assert "0 of 3 starts were made; repeat the command to continue" in result.stdout
    assert "the time was over before the first start ended" in result.stderr
    assert not Path("out/solution.json").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--seed", "1"), "give --starts too"),
        (("--hops", "1"), "give --starts too"),
        (("--starts", "2", "--guess", "other.json"), "it takes no solution to start from"),
        (("--starts", "0"), "0 is not in the range"),
    ],
)
def test_what_a_search_does_not_take_is_told(quick: Run, arguments: tuple[str, ...], told: str) -> None:
    result = quick("solve", "task.ocp.yaml", "-o", "out", *arguments)
    assert result.exit_code == 2
    assert told in result.stderr


def test_a_check_that_does_not_finish_is_told(quick: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The solution is written, and does not count as accurate."""
    monkeypatch.setattr(phases_solve, "resimulate", partial(phases_solve.resimulate, limits=Limits(steps=3)))
    result = quick("solve", "task.ocp.yaml", "-o", "out")
    assert result.exit_code == 1
    assert (
        "the re-simulation did not finish, the limit of 3 steps is reached, so the accuracy is unknown" in result.stderr
    )
    assert "unknown (the re-simulation did not finish)" in result.stdout
    check = read_solution(Path("out/solution.json")).resimulation
    assert check is not None
    assert not check.is_accurate


def test_shooting_is_chosen(quick: Run) -> None:
    """By options, which have priority over the file; contradictions are reported before anything is solved."""
    chosen = ("--form", "shooting", "--integrator", "rk4", "--steps", "2", "--representation", "exp1-o")
    result = quick("solve", "task.ocp.yaml", "-o", "out", *chosen)
    assert result.exit_code == 0, result.stderr
    problem = read_solution(Path("out/solution.json")).problem
    assert (problem.form, problem.integrator, problem.steps) == (Form.SHOOTING, "rk4", 2)
    for wrong, finding in (
        (("--integrator", "rk4"), "the form is standard"),
        (chosen[:4], "IMPL returns a residual"),
    ):
        result = quick("solve", "task.ocp.yaml", "-o", "none", *wrong)
        assert result.exit_code == 2
        assert finding in result.stderr
        assert not Path("none").exists()


def test_a_sweep_refuses_representations_that_its_form_does_not_take(run: Run) -> None:
    """Of all six, which are the usual ones, shooting takes four."""
    result = run(*SWEEP, text=COARSE.replace("degree: 3", "degree: 3\nform: shooting"))
    assert result.exit_code == 2
    assert "EXP1-A has accelerations as variables" in result.stderr


def test_a_target_out_of_reach_is_not_solved(quick: Run) -> None:
    """Exit code 1, the reason on stderr, nothing on stdout and nothing written."""
    result = quick("solve", "task.ocp.yaml", "-o", "out", "--target", "1.5", "0", "0")
    assert result.exit_code == 1
    assert "not solved (Target_Out_Of_Reach): no pose" in result.stderr
    assert result.stdout == ""
    assert not Path("out").exists()


def test_what_ipopt_does_not_solve_is_not_solved(quick: Run) -> None:
    result = quick("solve", "task.ocp.yaml", "-o", "out", text=COARSE + "solver: {max_iterations: 2}\n")
    assert result.exit_code == 1
    assert "Maximum_Iterations_Exceeded" in result.stderr
    assert not Path("out").exists()


def test_an_earlier_solution_is_not_taken_for_this_one(quick: Run) -> None:
    """It stays, and the message says whose it is."""
    assert quick("solve", "task.ocp.yaml", "-o", "out").exit_code == 0
    before = Path("out/solution.json").read_bytes()
    result = quick("solve", "task.ocp.yaml", "-o", "out", "--target", "1.5", "0", "0")
    assert result.exit_code == 1
    assert "out/solution.json is from an earlier solve" in result.stderr
    assert Path("out/solution.json").read_bytes() == before


def test_an_inaccurate_solution_is_written_with_a_warning(quick: Run) -> None:
    """Ten intervals of degree 3 are not good for 1e-9: exit code 1, and the file says so."""
    result = quick("solve", "task.ocp.yaml", "-o", "out", text=COARSE.replace("1e-2", "1e-9"))
    assert result.exit_code == 1
    assert "warning: the largest defect of an interval" in result.stderr
    check = read_solution(Path("out/solution.json")).resimulation
    assert check is not None
    assert not check.is_accurate


def test_an_acceptable_solution_is_written_with_a_warning(quick: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop_short(*arguments: Any) -> PhasedSolution:
        outcome = phases_solve.solve_phases(*arguments)
        assert isinstance(outcome, PhasedSolution)
        return replace(outcome, run=replace(outcome.run, status=ACCEPTABLE))

    monkeypatch.setattr(solving, "solve_phases", stop_short)
    result = quick("solve", "task.ocp.yaml", "-o", "out")
    assert result.exit_code == 1
    assert "warning: the solver stopped at an acceptable level" in result.stderr
    assert read_solution(Path("out/solution.json")).is_only_acceptable


SWEEP = ("sweep", "task.ocp.yaml", "--radius", "0.64", "--azimuths", "0", "0.02", "2", "--heights", "0", "0", "1")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search from few random starts."""
    monkeypatch.setattr("mbsrun.ocp.searching.trials.COUNTS", {kind: (int(kind == "bumps"),) * 2 for kind in COUNTS})
    monkeypatch.setattr("mbsrun.ocp.searching.trials.HOPS", (1, 1))


@pytest.mark.usefixtures("few")
def test_a_sweep_solves_all_targets_and_goes_on(run: Run) -> None:
    """The command prints a line for each part and one for all parts; the same command again prints the same.

    The paper's protocol goes into the same file. So does another problem, which sees nothing of the first.
    """
    text = COARSE.replace("intervals: 10", "intervals: 5").replace("degree: 3", "degree: 2")
    result = run(*SWEEP, "--representation", "IMPL", text=text)
    assert result.exit_code == 0, result.stderr
    for part in ("interpolation", "neighbours", "result"):
        assert part in result.stdout
    again = run(*SWEEP, "--representation", "IMPL", text=text)
    assert (again.exit_code, again.stdout) == (0, result.stdout)
    paper = run(*SWEEP, "--representation", "IMPL", "--protocol", "paper", text=text)
    assert paper.exit_code == 0, paper.stderr
    assert "paper" in paper.stdout
    assert "result" in paper.stdout
    other = run(*SWEEP, "--representation", "IMPL", "--minutes", "0", text=text.replace("horizon: 2", "horizon: 3"))
    assert other.exit_code == 1
    assert not any(part in other.stdout for part in ("interpolation", "paper", "result"))


def test_a_sweep_without_time_is_not_through(run: Run) -> None:
    result = run(*SWEEP, "--representation", "IMPL", "--minutes", "0")
    assert result.exit_code == 1
    assert "the time is over" in result.stderr


BAD = {
    "a sweep that bumps what there is not": (["sweep", "task.ocp.yaml", "--bump", "q9"], COARSE, "no coordinate 'q9'"),
    "a missing file": (["solve", "nowhere.ocp.yaml"], COARSE, "there is no such file"),
    "a bad file": (["solve", "task.ocp.yaml"], "intervals: 2\n", "task.ocp.yaml:1: horizon: missing"),
    "a target that is no number": (["solve", "task.ocp.yaml", "--target", "1", "2", "up"], COARSE, "unknown name"),
    "a guess that is missing": (
        ["solve", "task.ocp.yaml", "--guess", "none.json"],
        COARSE,
        "none.json: cannot be read",
    ),
    "a guess that is no solution": (
        ["solve", "task.ocp.yaml", "--guess", "task.ocp.yaml"],
        COARSE,
        "give a solution (.json) or a recording",
    ),
    "an unknown solver": (["solve", "task.ocp.yaml", "--solver", "magic"], COARSE, "'magic' is not one of"),
    "a target of two numbers": (["solve", "task.ocp.yaml", "--target", "1", "2"], COARSE, "3 arguments"),
    "a target for no sensor": (
        ["solve", "task.ocp.yaml", "--target", "1", "2", "3"],
        COARSE.replace(f"  sensors:\n    hand: {TARGET}\n", "  pose: {q1: 1}\n"),
        "targets for no sensor",
    ),
    "an output that is a file": (["solve", "task.ocp.yaml", "-o", "task.ocp.yaml"], COARSE, "is a file"),
    "an output below a file": (["solve", "task.ocp.yaml", "-o", "task.ocp.yaml/out"], COARSE, "Not a directory"),
    "an unknown command": (["slove", "task.ocp.yaml"], COARSE, "No such command"),
    "an unknown option": (["solve", "task.ocp.yaml", "--tagret"], COARSE, "No such option"),
}


@pytest.mark.parametrize(("arguments", "text", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_has_exit_code_2(quick: Run, arguments: list[str], text: str, message: str) -> None:
    """A message on stderr, no traceback, nothing on stdout."""
    result = quick(*arguments, text=text)
    assert result.exit_code == 2, result.stderr
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


def test_subcommands_win_over_files_of_the_same_name(quick: Run) -> None:
    """A problem file called `solve` does not hide the command."""
    Path("solve").write_text(COARSE, "utf-8")
    assert quick("solve", "solve", "-o", "out").exit_code == 0
    assert Path("out/solution.json").exists()


@pytest.mark.parametrize("arguments", [["--help"], ["solve", "--help"], ["sweep", "--help"], ["--version"]])
def test_help_and_version(arguments: list[str]) -> None:
    """From a separate process, as a user calls it."""
    done = subprocess.run([sys.executable, "-m", "mbsrun", *arguments], capture_output=True, text=True, check=True)
    assert done.stdout.strip()
    assert done.stderr == ""


def test_help_lists_commands_by_subject_and_options_of_robots_apart(run: Run) -> None:
    """Each summary stands whole on one line of 80 columns; `animate` lists the options of URDF and the like last."""
    lines = run("--help").stdout.splitlines()
    for entry in (entry for entries in cli.COMMANDS.values() for entry in entries):
        line = next(line for line in lines if line.startswith(f"  {entry.name} "))
        assert line.endswith(entry.summary)
        assert len(line) <= 80
    assert lines.index("Motions:") < lines.index("Optimal control:") < lines.index("Files:")
    own, _, robots = run("animate", "--help").stdout.partition("Options for robots in URDF, MJCF, SDF and OpenSim:")
    assert "--apart" in own
    assert "--mimic" not in own
    assert "--mimic" in robots


@pytest.mark.parametrize("name", ["simulate", "solve", "sweep", "track"])
def test_sections_of_help_name_options(name: str, run: Run) -> None:
    """A section with a name of no option would leave that option among all others."""
    command = cli.cli.commands[name]
    assert isinstance(command, ModelCommand)
    assert command.titles
    assert command.titles.keys() <= {parameter.name for parameter in command.params}
    lines = run(name, "--help").stdout.splitlines()
    assert all(f"{title}:" in lines for title in command.titles.values())


def test_the_version_lists_what_was_found(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiler, flags, cache and optional packages; a compiler that is missing is no error."""
    shown = dict(line.split(maxsplit=1) for line in run("--version").stdout.splitlines()[1:])
    assert shown["casadi"] == version("casadi")
    assert "-ffp-contract=fast" in shown["flags"]
    assert Path(shown["cache"]) == cache_folder(os.environ)
    assert {"ziglang", "pin", "fmpy", "distributed"} <= set(shown)
    monkeypatch.setenv("CC", "no-such-compiler")
    result = run("--version")
    assert result.exit_code == 0
    assert "compiler    none: cannot run no-such-compiler" in result.stdout


@pytest.mark.parametrize(
    ("program", "words", "found"),
    [
        ("mbsrun", "sim", "plain,simulate"),
        ("mbsrun", "simulate --dur", "plain,--duration"),
        ("mbsrun", "simulate --method rk", "plain,rk4"),
        ("mbsgen", "che", "plain,check"),
        ("mbsgen", "models/cart", "file,models/cart"),
    ],
)
def test_a_shell_completes_commands_options_and_names(program: str, words: str, found: str) -> None:
    """As bash calls it, after `eval "$(_MBSRUN_COMPLETE=bash_source mbsrun)"`."""
    told = {"COMP_WORDS": f"{program} {words}", "COMP_CWORD": str(len(words.split()))}
    environment = {**os.environ, f"_{program.upper()}_COMPLETE": "bash_complete", **told}
    call = f"import sys; sys.argv = ['{program}']; from {program}.cli import cli; cli(prog_name='{program}')"
    done = subprocess.run([sys.executable, "-c", call], env=environment, capture_output=True, text=True, check=True)
    assert found in done.stdout.splitlines()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [(["-h"], cli.HELP), (["solve", "-h"], solving.SOLVE_HELP), (["sweep", "-h"], sweep.SWEEP_HELP)],
)
def test_lists_in_the_help_keep_their_lines(run: Run, arguments: list[str], text: str) -> None:
    """A terminal of 80 columns shows what is indented in the text as it is written."""
    shown = run(*arguments).stdout.splitlines()
    written = [line for line in text.splitlines() if line.startswith("  ")]
    assert written
    assert [line for line in written if f"  {line}" not in shown] == []


# -- the cache ------------------------------------------------------------------------------------------------------


@pytest.fixture
def filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache with a compiled kernel, last used two days ago, another of today, and what a process is making."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    k = load(write_sample(tmp_path / "sample"))
    library = k.compile("setup")
    place = tmp_path / "cache" / "mbsgen"
    for path in place.rglob("*setup*.o"):
        os.utime(path, (0, time.time() - 2 * DAY))
    os.utime(library, (0, time.time() - 2 * DAY))
    k.compile("impl")
    (place / "building-now").mkdir()
    return place


def test_the_cache_is_told_by_model(run: Run, filled: Path) -> None:
    found = run("cache")
    assert (found.exit_code, found.stderr) == (0, "")
    (line,) = (line.split() for line in found.stdout.splitlines() if "sample" in line.split())
    assert line[:5] == ["sample", "0", "2", "2", "0"]
    size = sum(path.stat().st_size for path in filled.rglob("*") if path.is_file())
    assert f"5 entries, {filesize.decimal(size)}, in {filled}" in found.stdout


def test_an_empty_cache_is_told(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "none"))
    assert run("cache").stdout == f"0 entries, 0 bytes, in {tmp_path / 'none' / 'mbsgen'}\n"
    assert run("cache", "--clear").stdout == "removed 0 of 0 entries, 0 bytes\n"


def test_what_was_not_used_lately_is_removed(run: Run, filled: Path) -> None:
    assert run("cache", "--older-than", "3").stdout.startswith("removed 0 of 5 entries")
    assert run("cache", "--older-than", "1").stdout.startswith("removed 2 of 5 entries")
    assert sorted(path.suffix for path in filled.rglob("sample*") if path.is_file()) == [
        ".o",
        ".sha256",
        ".sha256",
        ".so",
    ]


def test_the_cache_is_cleared_but_for_what_is_being_made(run: Run, filled: Path) -> None:
    """And what was removed is compiled again when it is called."""
    assert run("cache", "--clear").stdout.startswith("removed 4 of 5 entries")
    assert [path.name for path in filled.rglob("*") if path.name not in ("compiled", "sample")] == ["building-now"]
    os.utime(filled / "building-now", (0, time.time() - 2 * DAY))
    assert run("cache", "--clear").stdout.startswith("removed 1 of 1 entry")
    k = load(filled.parents[1] / "sample")
    np.testing.assert_array_equal(k.setup(p=[2, 3])["h"], [6, 2])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--older-than", "-1"), "-1.0 is not in the range x>=0"),
        (("--older-than", "soon"), "'soon' is not a valid float"),
        (("--clear", "--older-than", "1"), "--clear removes everything; give it, or --older-than, but not both"),
    ],
)
def test_what_the_cache_command_does_not_take_is_told(
    run: Run, filled: Path, arguments: tuple[str, ...], told: str
) -> None:
    found = run("cache", *arguments)
    assert found.exit_code == 2
    assert told in found.stderr
    assert len(list(filled.rglob("sample*.o"))) == 2
