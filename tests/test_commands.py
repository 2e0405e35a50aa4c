"""Every command on every kind of model: its exit code, no traceback, no fault of the program, nothing half-written."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

import mbsgen.cli
import mbsrun.cli
from mbsgen import families, report
from mbsgen.equations import FORMATS
from mbsgen.model.tree import Tree
from mbsgen.request import Request
from mbsgen.targets.languages import TARGETS
from mbsrun.ocp.showing import pictures as solutions
from mbsrun.simulation import record as simulation
from mbsrun.simulation.integration.methods import METHODS
from tests.model_kinds import KINDS, Kind, write_model, write_problem

pytestmark = pytest.mark.filterwarnings(  # a user would see the ones of libraries
    "error::UserWarning", "error::RuntimeWarning", "default::mbsgen.model.reader.ModelWarning"
)

Run = Callable[..., tuple[object, str]]
DRAWN = {  # functions that draw, by their modules; their last argument is a path
    simulation: ("plot_motion",),
    solutions: ("plot_trajectories", "draw_mechanism", "animate", "plot_starts", "plot_mesh"),
}
CHOSEN = [*KINDS] if "WHOLE_TABLE" in os.environ else [*KINDS][::6]  # `make table` takes all of them
MAIN = {"mbsgen": mbsgen.cli.main, "mbsrun": mbsrun.cli.main}
NOT_DONE, REFUSED = 1, 2
ROBOTS: dict[str, str | None] = {  # commands that read robots alone
    "compare": "files of URDF are compared",
    "import": "it is a model file already",
}
UNLOADED: dict[str, str | None] = {"identify": "torque"}  # the motions of kinds have none
TARGETED: dict[str, str | None] = dict.fromkeys(("sweep", "study"), "targets for no sensor")


@dataclass(frozen=True)
class Command:
    """A command, and the folders and files that it writes."""

    program: str
    arguments: tuple[str, ...]
    written: tuple[str, ...] = ()
    needs: str = ""  # a file of another command, without which it is left out
    codes: tuple[int, ...] = (0,)  # where it is not refused
    draws: bool = True  # a like command before draws the same

    @property
    def label(self) -> str:
        """Return the words that name it in `Kind.refused`."""
        return " ".join(self.arguments)


def generate(name: str) -> Iterator[Command]:
    """List the commands that read a model, print of it, and write code."""
    file = f"{name}.yaml"
    yield Command("mbsgen", ("check", file))
    yield Command("mbsgen", ("compare", file, "--with", "pinocchio"))
    yield Command("mbsgen", ("import", file))
    yield Command("mbsgen", ("show", file))
    yield Command("mbsgen", ("show", file, "-o", "tree.svg"), ("tree.svg",))
    for option in ("--json", "--markdown", "--compare"):
        yield Command("mbsgen", ("report", file, option))
    for form in ("whole", "named", "lines"):
        yield Command("mbsgen", ("equations", file, "--form", form, "--numbers"))
    for form in FORMATS:
        yield Command("mbsgen", ("equations", file, "--format", form))
    for k, options in enumerate(("--runtime", "--runtime --zeros", "--derivatives 0", "--without regroup")):
        yield Command("mbsgen", ("generate", file, *options.split(), "-o", f"code{k}"), (f"code{k}",))
    yield Command("mbsgen", ("generate", file, "--tolerance", "1e-3", "-o", "approximate"), ("approximate",))
    for target in TARGETS:
        yield Command("mbsgen", ("generate", file, f"--{target.name}", "-o", target.name), (target.name,))


def simulate(name: str, kind: Kind) -> Iterator[Command]:
    """List the commands that move a model."""
    file, brief = f"{name}.yaml", ("--duration", "0.01")
    yield Command("mbsrun", ("simulate", file, "--duration", "0.02", "-o", "moves"), ("moves",))
    for method in METHODS:
        yield Command("mbsrun", ("simulate", file, *brief, "--method", method, "-o", method), (method,), draws=False)
    for form in ("impl", "semi", "exp1"):
        given = (*brief, "--method", "rk4", "--formulation", form, "-o", form)
        yield Command("mbsrun", ("simulate", file, *given), (form,), draws=False)
    motion = [word for pair in kind.motion.items() for word in ("--motion", "=".join(pair))]
    table = f"{name}.inverse.csv"
    yield Command("mbsrun", ("inverse", file, *motion, "--output-step", "0.1"), (table,))
    for k, options in enumerate(("", "--settle", "--regulate 1", "--settle --regulate 1")):
        yield Command("mbsrun", ("linearise", file, *options.split(), "-o", f"linear{k}"), (f"linear{k}",))
    yield Command("mbsrun", ("inverse-dynamics", file, "motion.csv", "-o", "forces"), ("forces",))
    yield Command("mbsrun", ("identify", file, "motion.csv", "-o", "found"), ("found",))
    yield Command("mbsrun", ("fit-motion", file, "marks.csv", "-o", "fit"), ("fit",), codes=(0, NOT_DONE))
    pictures = ("page.html", "pictures.png")
    outputs = [word for picture in pictures for word in ("-o", picture)]
    yield Command("mbsrun", ("animate", file, "motion.csv", *outputs), pictures)
    yield Command("mbsrun", ("cuda", file, "--functions", "impl", "--derivatives", "0", "-o", "gpu"), ("gpu",))
    yield Command("mbsrun", ("fmu", file), (f"{name}.fmu",))
    yield Command("mbsrun", ("fmu", file, "--fmi", "2.0", "--source-only", "-o", "2.fmu"), ("2.fmu",))


def control(name: str) -> Iterator[Command]:
    """List the commands that solve a problem of a model, and use the solution."""
    file, problem, solution = f"{name}.yaml", f"{name}.ocp.yaml", "solution/solution.json"
    yield Command("mbsrun", ("solve", problem, "-o", "solution"), ("solution",))
    for name in ("semi", "exp1-o", "exp2-a"):
        options = ("--representation", name, "-o", name)
        yield Command("mbsrun", ("solve", problem, *options), (name,), draws=False)
    for form in ("integral", "shooting"):
        yield Command("mbsrun", ("solve", problem, "--form", form, "-o", form), (form,), draws=False)
    yield Command("mbsrun", ("solve", problem, "--solver", "ipopt", "-o", "ipopt"), ("ipopt",), draws=False)
    again = ("simulate", file, "--solution", solution, "-o", "again")
    yield Command("mbsrun", again, ("again",), needs=solution)
    yield Command("mbsrun", ("animate", file, "solution", "-o", "again.html"), ("again.html",), needs=solution)
    yield Command("mbsrun", ("controller", problem, "-o", "controller"), ("controller",))
    loop = ("track", problem, "--duration", "0.1", "--rate", "20")
    yield Command("mbsrun", (*loop, "-o", "loop"), ("loop",))
    manifest = "controller/manifest.json"
    yield Command("mbsrun", (*loop, "--controller", "controller", "-o", "c"), ("c",), needs=manifest)
    way = ("continue", problem, "--number", "horizon", "--to", "0.11", "-o", "way")
    yield Command("mbsrun", way, ("way",), codes=(0, 1), draws=False)
    yield Command("mbsrun", ("sweep", problem, "--minutes", "0"))
    yield Command("mbsrun", ("study", problem, "--minutes", "0", "--workers", "0"))


@pytest.fixture(autouse=True, scope="module")
def write_functions_once() -> Iterator[None]:
    """Write the functions of a tree, and the ones that a report counts, once for all commands that need the same."""
    write = families._write_chosen

    @cache
    def written(tree: Tree, request: Request, staged: bool) -> tuple[list[families.Family], object]:
        return write(tree, request, lambda _: None, staged=staged)

    def find(
        tree: Tree, request: Request, tell: Callable[[str], None], *, staged: bool
    ) -> tuple[list[families.Family], object]:
        tell("functions")
        found, ways = written(tree, replace(request, targets=(), count=True, prefix=None), staged)
        return [*found], ways

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(families, "_write_chosen", find)
        patch.setattr(report, "write_row", cache(report.write_row))
        yield


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in an empty folder, in this process; any exception but the end of the program gets out."""
    monkeypatch.chdir(tmp_path)

    def call(command: Command) -> tuple[object, str]:
        code: object = 0
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", [command.program, *command.arguments])
            for module, names in DRAWN.items():
                for name in () if command.draws else names:
                    patch.setattr(module, name, lambda *arguments, **_: arguments[-1].touch())
            if not command.draws:
                patch.setattr(simulation, "write_animation", lambda path, *_, **__: path.touch())
            try:
                MAIN[command.program]()
            except SystemExit as end:
                code = end.code or 0
        return code, capsys.readouterr().err

    return call


def write_kind(name: str) -> Kind:
    """Write the files of a kind: a model, a problem, a motion, markers at rest."""
    kind, times = KINDS[name], [k / 10 for k in range(8)]
    Path(f"{name}.yaml").write_text(write_model(name), "utf-8")
    Path(f"{name}.ocp.yaml").write_text(write_problem(name), "utf-8")
    columns = {"t": "", **{column: f",{value!r}" for column, value in kind.columns.items()}}
    rows = [",".join(columns), *(f"{t}{''.join(columns.values())}" for t in times)]
    Path("motion.csv").write_text("\n".join(rows) + "\n", "utf-8")
    marks = ["t,x[tip],y[tip],z[tip]", *(f"{t},0.1,0.2,-0.3" for t in times)]
    Path("marks.csv").write_text("\n".join(marks) + "\n", "utf-8")
    return kind


def judge(run: Run, command: Command, refused: str | None) -> Iterator[str]:
    """Run a command; yield what is wrong with its end."""
    before = set(Path().iterdir())
    code, err = run(command)
    new = {path.name for path in set(Path().iterdir()) - before}
    for word in ("Traceback", "fault of mbsgen"):
        if word in err:
            yield f"{word}: {err}"
    if refused is None and code not in command.codes:
        yield f"exit code {code}: {err}"
    elif refused is None and new != set(command.written):
        yield f"wrote {sorted(new)}"
    elif refused is not None and (code != REFUSED or refused not in err or new):
        yield f"exit code {code}, not refused by {refused!r}, wrote {sorted(new)}: {err}"


def check(run: Run, commands: Iterable[Command], kind: Kind) -> None:
    """Run commands of a kind, in order; demand the ends that they should have, all at once."""
    faults = []
    for command in commands:
        if command.needs and not Path(command.needs).exists():
            continue
        known = (*ROBOTS.items(), *kind.refused.items(), *TARGETED.items(), *UNLOADED.items())
        refused = next((words for label, words in known if _is_part(label, command.label)), None)
        faults += [f"{command.label}: {fault}" for fault in judge(run, command, refused)]
    assert not faults, "\n".join(faults)


def _is_part(label: str, words: str) -> bool:
    """Return whether the words of a label are among others, in their order."""
    rest = iter(words.split())
    return all(word in rest for word in label.split())


@pytest.mark.parametrize("name", CHOSEN)
def test_code_is_generated_or_refused(name: str, run: Run) -> None:
    kind = write_kind(name)
    check(run, generate(name), kind)


@pytest.mark.parametrize("name", CHOSEN)
def test_a_model_is_moved_or_refused(name: str, run: Run) -> None:
    kind = write_kind(name)
    check(run, simulate(name, kind), kind)


@pytest.mark.parametrize("name", CHOSEN)
def test_a_problem_is_solved_or_refused(name: str, run: Run) -> None:
    kind = write_kind(name)
    check(run, control(name), kind)
