"""The command line: what it writes where, its exit codes, and that no input brings a traceback."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import click
import pytest

from mbsgen import __version__
from mbsgen.cli import BAD_INPUT, ENTRIES, cli, main
from mbsgen.commands.console import DIFFERENT
from mbsgen.commands.generate import SWITCHES
from mbsgen.help import ModelCommand, describe
from mbsgen.report import DIFFERENTIATION
from tests.shipped import FOLDER

ARM = Path(__file__).parents[2] / "models" / "arm_pendulum.yaml"
PENDULUM = """\
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: hinge, type: revolute, axis: y, limits: [-pi, pi]}
    mass: 2
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.01]
  - name: slider
    parent: rod
    joint: {name: slide, type: prismatic, axis: z, actuated: false}
    mass: 0.25
    inertia: [0.01, 0.01, 0.01]
frames:
  - {name: tip, body: slider, position: [0, 0, -1]}
"""
FAULTS = """\
name: bad
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: hinge, type: revolte, axis: y}
    mass: -1
  - name: rod
    parent: nobody
    joint: {name: hinge, type: revolute, axis: [0, 0, 0]}
colour: red
"""


@dataclass(frozen=True)
class Outcome:
    """The result of a command."""

    code: int
    out: str
    err: str


Command = Callable[..., Outcome]


@pytest.fixture
def mbsgen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run the command in an empty folder that holds a model, and one with faults."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pendulum.yaml").write_text(PENDULUM)
    (tmp_path / "bad.yaml").write_text(FAULTS)

    def run(*arguments: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["mbsgen", *arguments])
        code: object = 0
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        assert isinstance(code, int)
        return Outcome(code, *capsys.readouterr())

    return run


def run_process(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-c", "from mbsgen.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, check=False)


@pytest.mark.parametrize("arguments", [["pendulum.yaml", "-o", "out"], ["-o", "out", "pendulum.yaml"]])
def test_a_model_is_generated_without_a_command(arguments: list[str], mbsgen: Command) -> None:
    done = mbsgen(*arguments)
    assert (done.code, re.sub(r"\d+", "N", done.err)) == (0, "wrote N files to out\n")
    assert json.loads(Path("out/manifest.json").read_text())["model"] == "pendulum"
    assert "jac_adj1_impl" in done.out
    assert done.out.endswith("report.md explains\ntables and columns.\n")
    assert "assignments of the C that compute something" in Path("out/report.md").read_text()


def test_the_targets_beside_c_are_written_on_request(mbsgen: Command) -> None:
    assert mbsgen("pendulum.yaml", "-o", "plain").code == 0
    assert mbsgen("pendulum.yaml", "-o", "all", "--python", "--matlab").code == 0
    assert not [file for file in Path("plain").rglob("*") if file.suffix in (".py", ".m")]
    assert Path("all/pendulum.py").is_file()
    assert Path("all/matlab/pendulum_jac_impl.m").is_file()


def test_parameters_come_at_run_time_on_request(mbsgen: Command) -> None:
    assert mbsgen("pendulum.yaml", "-o", "out", "--runtime").code == 0
    manifest = json.loads(Path("out/manifest.json").read_text())
    assert {"rod.mass", "slider.inertia.xx"} <= {p["name"] for p in manifest["parameters"]}
    assert manifest["kernels"][0]["name"] == "setup"


@pytest.mark.parametrize("name", sorted(set(cli.commands) - {"scaling"}))  # which takes no model
def test_a_subcommand_wins_over_a_file_of_its_name(name: str, mbsgen: Command) -> None:
    Path(name).write_text(PENDULUM)
    assert mbsgen(name).code == BAD_INPUT  # its own argument is missing
    assert mbsgen(name, "-o", "out").code == BAD_INPUT
    assert not Path("out").exists()
    assert mbsgen(f"./{name}", "-o", "out").code == 0
    assert Path("out/manifest.json").is_file()


def test_an_output_may_have_the_name_of_a_subcommand(mbsgen: Command) -> None:
    assert mbsgen("-o", "report", "pendulum.yaml").code == 0
    assert Path("report/manifest.json").is_file()


@pytest.mark.parametrize("command", [["check"], ["report"], ["show"], ["-o", "out"], ["generate", "-o", "out"]])
def test_every_fault_is_told_and_nothing_is_written(command: list[str], mbsgen: Command, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    done = mbsgen(*command, "bad.yaml")
    assert (done.code, done.out) == (BAD_INPUT, "")
    lines = done.err.splitlines()
    for line, word in ((5, "revolte"), (6, "mass"), (10, "colour")):
        assert any(told.startswith(f"bad.yaml:{line}:") and word in told for told in lines)
    assert len(lines) >= 3
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("command", [["check"], ["report"], ["show"], ["-o", "out"]])
@pytest.mark.parametrize("model", ["missing.yaml", "folder", "bytes", "empty", "/dev/null", "nul", ""])
def test_what_is_no_model_file_is_refused_in_words(model: str, command: list[str], mbsgen: Command) -> None:
    Path("folder").mkdir()
    Path("bytes").write_bytes(bytes(range(256)) * 8)
    Path("nul").write_bytes(b"name: a\0b\n")
    Path("empty").touch()
    done = mbsgen(*command, model)
    assert (done.code, done.out) == (BAD_INPUT, "")
    assert done.err.startswith("mbsgen: ")
    assert "Traceback" not in done.err
    assert not Path("out").exists()


def test_a_model_without_fault_is_said_to_be_so(mbsgen: Command, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    assert mbsgen("check", "pendulum.yaml") == Outcome(0, "", "pendulum.yaml: no fault found\n")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("out", ["file", "file/below", "full", "foreign", "/proc/none/such", "", "."])
def test_what_cannot_be_written_is_refused_and_left_alone(out: str, mbsgen: Command, tmp_path: Path) -> None:
    """A file, a folder with files in it, one with a manifest of another program, the folder one stands in."""
    Path("file").write_text("mine")
    Path("full").mkdir()
    Path("full/mine").touch()
    Path("foreign").mkdir()
    Path("foreign/manifest.json").write_text('{"name": "an app", "icons": []}')
    before = sorted(tmp_path.rglob("*"))
    done = mbsgen("pendulum.yaml", "-o", out)
    assert (done.code, done.out) == (BAD_INPUT, "")
    assert done.err
    assert "Traceback" not in done.err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("arguments", [["pendulum.yaml"], ["report"], ["--bogus"], ["report", "--bogus"]])
def test_a_command_that_is_wrong_is_told_how_it_should_be(arguments: list[str], mbsgen: Command) -> None:
    done = mbsgen(*arguments)
    assert (done.code, done.out) == (BAD_INPUT, "")
    assert "Usage: mbsgen" in done.err


def test_help_and_version_go_to_stdout(mbsgen: Command) -> None:
    shown = mbsgen("--version").out.splitlines()
    assert shown[0] == f"mbsgen, version {__version__}"
    assert f"sympy       {version('sympy')}" in shown
    for arguments in (["--help"], ["-h"], *([name, "--help"] for name in cli.commands), ["pendulum.yaml", "--help"]):
        done = mbsgen(*arguments)
        assert (done.code, done.err) == (0, "")
        assert done.out.startswith("Usage: mbsgen")
        assert "..." not in done.out.partition("Generate:")[2], "no summary is cut short"
        assert max(map(len, done.out.splitlines())) <= 80
    context = click.Context(cli)
    assert list(ENTRIES) == [describe(command, context) for command in cli.commands.values()]
    for name in cli.commands:
        shown_robots = mbsgen(name, "--help").out.partition("Options for robots")[2]
        assert (name == "scaling") == (shown_robots == "")
        assert (name == "import") == ("Hold a joint at a coordinate." in shown_robots), "the others name this page"


def test_sections_of_help_name_options() -> None:
    """A section with a name of no option would leave that option among all others."""
    sections = {"Functions", "Numbers and operations", "Further languages and forms"}
    command = cli.commands["generate"]
    assert isinstance(command, ModelCommand)
    assert set(command.titles.values()) == sections
    assert command.titles.keys() <= {parameter.name for parameter in command.params}


@pytest.mark.parametrize("columns", ["40", "80", "200"])
def test_tables_are_whole_whatever_takes_them_up(columns: str, tmp_path: Path) -> None:
    """Piped, at any width in the environment: within 80 columns, nothing cut, numbers under their headers."""
    (tmp_path / "pendulum.yaml").write_text(PENDULUM)
    done = run_process("report", "pendulum.yaml", cwd=tmp_path, COLUMNS=columns)
    lines = done.stdout.decode("ascii").splitlines()
    assert max(map(len, lines)) <= 80
    assert [line for line in lines if line != line.rstrip()] == []
    counts = lines[: next(k for k, line in enumerate(lines) if line.startswith(DIFFERENTIATION))]
    header = next(line for line in lines if "flops" in line)
    ends = [match.end() for match in re.finditer(r"\+ -|\S+", header)]
    rows = [line for line in counts if re.fullmatch(r"[A-Za-z]\w+( +\d+)+", line)]
    assert {"IMPL", "EXP2", "impl", "jac_adj1_impl", "frames"} <= {row.split()[0] for row in rows}
    for row in rows:
        assert [match.end() for match in re.finditer(r" \d+", row)] == ends


@pytest.mark.parametrize("form", ["json", "markdown"])
def test_reports_are_printed_as_they_are_written(form: str, mbsgen: Command) -> None:
    assert mbsgen("pendulum.yaml", "-o", "out").code == 0
    done = mbsgen("report", "pendulum.yaml", f"--{form}")
    assert done == Outcome(0, Path("out", {"json": "report.json", "markdown": "report.md"}[form]).read_text(), "")


def test_the_tree_is_shown_as_text(mbsgen: Command) -> None:
    done = mbsgen("show", "pendulum.yaml")
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines() == [
        "pendulum: base",
        "└── rod hinge: revolute about y, -3.142..3.142, 2 kg  [q 0, u 0]",
        "    └── slider slide: prismatic along z, passive, 0.25 kg  [q 1]",
        "        └── frame tip  sensor 0",
    ]


@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("new/b.svg", b"<?xml"), ("C.PNG", b"\x89PNG")])
def test_the_mechanism_is_drawn(name: str, start: bytes, mbsgen: Command) -> None:
    done = mbsgen("show", "pendulum.yaml", "-o", name, "--at", "hinge=0.5, slide=-1e-1")
    assert (done.code, done.err) == (0, f"wrote {name}\n")
    assert Path(name).read_bytes().startswith(start)


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ("hing=1", ["hing", "hinge"]),
        ("hinge=x,slid=2", ["'x' is no number", "slide"]),
        ("hinge=inf", ["'inf' is no number"]),
        ("3", ["hinge=0.3"]),
        ("hinge=__import__('os')", ["is no number"]),
    ],
)
def test_coordinates_that_cannot_be_read_are_all_told(at: str, words: list[str], mbsgen: Command) -> None:
    done = mbsgen("show", "pendulum.yaml", "--at", at)
    assert (done.code, done.out) == (BAD_INPUT, "")
    assert [word for word in words if word not in done.err] == []


def test_a_closed_mechanism_is_drawn_where_its_loops_are_closed(mbsgen: Command) -> None:
    """The tree lists the loops. A given coordinate takes the others along; where it cannot, the command fails."""
    four_bar = str(FOLDER / "four_bar.yaml")
    done = mbsgen("show", four_bar, "-o", "a.svg", "--at", "motor=4")
    assert (done.code, done.err) == (0, "wrote a.svg\n")
    assert done.out.splitlines()[-1] == "└── loop closure: hinge between coupler and rocker"
    done = mbsgen("show", four_bar, "--at", "swing=4")
    assert (done.code, done.out) == (BAD_INPUT, "")
    assert "the loops do not close there" in done.err


@pytest.mark.parametrize("out", ["a.pdf", "a", "folder.png", "pendulum.yaml/a.png"])
def test_a_picture_that_cannot_be_written_is_refused(out: str, mbsgen: Command) -> None:
    Path("folder.png").mkdir()
    done = mbsgen("show", "pendulum.yaml", "-o", out)
    assert (done.code, done.out) == (BAD_INPUT, "")
    assert out in done.err


def test_names_beyond_the_encoding_of_the_terminal_are_escaped(tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(PENDULUM.replace("pendulum", "机械臂").replace("rod", "é"), encoding="utf-8")
    for command in ("show", "report"):
        done = run_process(command, "model.yaml", cwd=tmp_path, PYTHONIOENCODING="latin-1", PYTHONUTF8="0")
        assert (done.returncode, done.stderr) == (0, b"")
        assert b"\\u673a" in done.stdout


def test_names_are_no_markup(mbsgen: Command) -> None:
    Path("model.yaml").write_text(
        PENDULUM.replace("name: rod", "name: '[red]'").replace("parent: rod", "parent: '[red]'")
    )
    assert "[red] hinge" in mbsgen("show", "model.yaml").out


def test_lumping_needs_parameters_at_run_time(mbsgen: Command) -> None:
    done = mbsgen("pendulum.yaml", "--lump", "-o", "out")
    assert done.code == BAD_INPUT
    assert "the model has no parameter at run time; give --runtime too, or leave it out" in done.err
    assert not Path("out").exists()
    assert mbsgen("pendulum.yaml", "--lump", "--runtime", "--functions=impl", "-o", "out").code == 0


def test_masses_are_not_both_lumped_and_left_alone(mbsgen: Command) -> None:
    done = mbsgen("pendulum.yaml", "--lump", "--without=lump", "-o", "out")
    assert done.code == BAD_INPUT
    assert "--lump" in done.err
    assert not Path("out").exists()


def test_reductions_can_be_left_out(tmp_path: Path) -> None:
    """Each name is accepted; without them a kernel takes more operations."""
    flops = {}
    for name, without in {"all": (), "none": SWITCHES}.items():
        options = ["--functions", "impl", "--derivatives", "0", *(f"--without={x}" for x in without)]
        with pytest.raises(SystemExit) as stopped:
            cli(["generate", str(ARM), "-o", str(tmp_path / name), *options])
        assert stopped.value.code == 0
        report = json.loads((tmp_path / name / "report.json").read_text())
        flops[name] = report["kernels"]["impl"]["flops"]["paper"]
    assert flops["none"] > flops["all"]


def test_scaling_counts_chains(mbsgen: Command) -> None:
    """Degrees 1, 2, 3, 1 of Table 1."""
    answer = mbsgen("scaling")
    assert answer.code == 0
    found = dict(re.findall(r"(\w+): flops of degree (\d)", answer.out))
    assert found == {"IMPL": "1", "SEMI": "2", "EXP1": "3", "EXP2": "1"}


def test_a_folder_can_be_checked_against_what_would_be_written(mbsgen: Command) -> None:
    assert mbsgen("pendulum.yaml", "-o", "out").code == 0
    assert mbsgen("pendulum.yaml", "-o", "out", "--check").code == 0
    before = Path("out/manifest.json").read_bytes()
    Path("out/pendulum.h").write_text("/* edited */\n")
    answer = mbsgen("pendulum.yaml", "-o", "out", "--check")
    assert (answer.code, answer.out) == (DIFFERENT, "")
    assert "pendulum.h: differs from the code that is generated now" in answer.err
    assert Path("out/manifest.json").read_bytes() == before
    assert mbsgen("pendulum.yaml", "-o", "nowhere", "--check").code == DIFFERENT
    assert not Path("nowhere").exists()


def test_functions_and_derivatives_can_be_chosen(mbsgen: Command, tmp_path: Path) -> None:
    """Spaces and repetitions do no harm; unknown names are reported with similar ones."""
    assert mbsgen("pendulum.yaml", "-o", "out", "--functions", "impl, sensors,impl", "--derivatives", "1").code == 0
    kernels = json.loads((tmp_path / "out" / "manifest.json").read_text())["kernels"]
    assert [k["name"] for k in kernels] == [
        f"{p}{f}" for f in ("impl", "sensors") for p in ("", "jac_", "adj1_", "lin_")
    ]
    refused = mbsgen("pendulum.yaml", "-o", "other", "--functions", "imlp")
    assert (refused.code, refused.err) == (
        BAD_INPUT,
        "mbsgen: functions: there is no function 'imlp'; is impl meant?\n",
    )
    assert not (tmp_path / "other").exists()
    assert mbsgen("pendulum.yaml", "-o", "other", "--derivatives", "3").code == BAD_INPUT


def test_functions_for_acados_are_written_beside_the_kernels(mbsgen: Command, tmp_path: Path) -> None:
    options = ("--acados", "--functions", "impl", "--derivatives", "0")
    assert mbsgen("pendulum.yaml", "-o", "out", *options).code == 0
    assert {"pendulum_impl.c", "pendulum_impl_dae_fun.c"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert mbsgen("pendulum.yaml", "-o", "out", "--check", *options).code == 0
