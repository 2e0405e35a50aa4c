"""The command line `mbsgen`: a model file in; a folder of C, a report, a picture or a result of a check out."""

from __future__ import annotations

import difflib
import functools
import io
import math
import platform
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import click
from click.shell_completion import CompletionItem
from rich.console import Console
from rich.markup import escape
from rich.text import Text
from rich.tree import Tree as Branches

from mbsgen import __version__
from mbsgen.assembly import reach
from mbsgen.equations import (
    FORMATS,
    Page,
    SizeError,
    build_numeric,
    build_symbolic,
    derive,
    derive_stepwise,
    show_lines,
    show_motion,
    write_lines,
)
from mbsgen.errors import MbsError
from mbsgen.families import Tell, say_nothing
from mbsgen.formulations.catalogue import FUNCTIONS, list_rows
from mbsgen.formulations.reductions import ALL
from mbsgen.help import CommandsBySubject
from mbsgen.importing import Choices, Mimic, Notice, import_model, is_foreign, list_formats, write_imported
from mbsgen.model.model import Model
from mbsgen.model.scene import EVERYTHING
from mbsgen.model.tree import Tree
from mbsgen.output import find_differences, write_file, write_folder
from mbsgen.pipeline import Options, make, read, read_tree
from mbsgen.report import (
    COLUMNS,
    COMPARISON,
    DIFFERENTIATION,
    NOTE,
    WAYS,
    Report,
    Section,
    comparisons,
    note_of_scene,
    sections,
    tables_of_scene,
    ways_taken,
    write_json,
    write_markdown,
)
from mbsgen.robots import OPTIONS as ROBOT
from mbsgen.robots import option as robot_option
from mbsgen.robots import read_finite, read_locks
from mbsgen.scaling import PERIOD, find_crossing, grow
from mbsgen.targets.languages import TARGETS
from mbsgen.targets.symbols import describe_mangling

_UNCUT = 10_000  # characters in a line, so that neither a pipe nor a narrow terminal cuts text off
SWITCHES = {name.replace("_", "-"): name for name in ("regroup", "share_frames", "lump", "absolute", "factor")}
DIFFERENT = 1  # exit code: a folder differs from the generated one
PACKAGES = ("sympy", "mpmath", "jinja2", "pydantic", "pyyaml", "click", "rich")  # that `--version` shows
BAD_INPUT = 2  # exit code: an unacceptable file or argument; 0 is success

MODEL = click.argument("model", type=click.Path(path_type=Path))


_IMPORTING = (
    robot_option("--name", help="The model's name; by default, the name in the file."),
    *ROBOT,
    robot_option("--gravity", metavar="X,Y,Z", help="In m/s2; by default, the file's own, or 0,0,-9.81."),
    robot_option("--quaternions", is_flag=True, help="Give balls and free bodies quaternions, not turns in a row."),
    robot_option(
        "--friction-speed",
        type=click.FloatRange(0, 1e6, min_open=True),
        default=Choices.friction_speed,
        show_default=True,
        help="The speed at which dry friction reaches 3/4 of its force, rad/s or m/s.",
    ),
    robot_option(
        "--quarter-turns",
        type=click.FloatRange(0, 0.01),
        default=Choices.quarter_turns,
        show_default=True,
        help="Round angles within this distance of a quarter turn to it, rad.",
    ),
    robot_option("--allow-unphysical", is_flag=True, help="Accept inertias that no body can have."),
    robot_option(
        "--root",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
        help="The folder that holds all files which the file names; by default, the file's own folder.",
    ),
)


def importing(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of files that are imported; the command gets them as `choices`."""

    @functools.wraps(command)
    def call(
        *,
        model: Path,
        name: str | None,
        base: Literal["fixed", "floating"],
        gravity: str | None,
        sensors: tuple[str, ...],
        locks: tuple[str, ...],
        lock_massless: bool,
        mimic: Mimic,
        loop_tolerance: float | None,
        quaternions: bool,
        friction_speed: float,
        quarter_turns: float,
        allow_unphysical: bool,
        root: Path | None,
        **own: object,
    ) -> None:
        choices = Choices(
            name=name,
            base=base,
            gravity=None if gravity is None else _read_gravity(gravity),
            sensors=tuple(dict.fromkeys(sensors)),
            locked=read_locks(locks),
            lock_massless=lock_massless,
            mimic=mimic,
            loop_tolerance=loop_tolerance,
            quaternions=quaternions,
            friction_speed=friction_speed,
            quarter_turns=quarter_turns,
            allow_unphysical=allow_unphysical,
            root=root,
        )
        if choices != Choices() and not is_foreign(model):
            raise click.UsageError(
                f"{model} is a model file: --name, --base, --lock and the like are for files of {list_formats()}"
            )
        command(model=model, choices=choices, **own)

    for option in reversed(_IMPORTING):
        call = option(call)
    return call


HELP = f"""Turn the description of a multibody system into C kernels for its dynamics.

\b
  mbsgen models/pendulum.yaml -o pendulum    write C to the folder pendulum
  mbsgen show models/pendulum.yaml           print the tree of its bodies

MODEL is a YAML file (models/ holds examples), or a file of {list_formats()}. Without COMMAND, `generate` is meant.
Write ./NAME for a file with the name of a command. `mbsgen COMMAND --help` describes a command.

\b
Exit codes
  0   done
  1   with --check, the folder differs; or compared equations differ
  2   the model or an argument cannot be accepted; nothing written
"""


class ModelFirst(CommandsBySubject):
    """A group whose default command is `generate`: `mbsgen MODEL -o DIR`. A subcommand wins over a file of its name."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command before arguments that start with neither a command nor an option of the group."""
        own = {*self.commands, *ctx.help_option_names, "--version"}
        first = args[0] if args else ""
        is_word = first.isalpha() and first not in own and not Path(first).exists()
        if is_word and (near := difflib.get_close_matches(first, self.commands, 1)):
            raise click.UsageError(f"there is no command and no file {first!r}; did you mean {near[0]!r}?", ctx)
        return super().parse_args(ctx, ["generate", *args] if args and args[0] not in own else args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the first word to a command or a file."""
        return [*super().shell_complete(ctx, incomplete), CompletionItem(incomplete, type="file")]


def _show_versions(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the versions of mbsgen, Python and the packages that mbsgen uses."""
    if asked and not ctx.resilient_parsing:
        found = {"Python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
        click.echo(f"mbsgen, version {__version__}")
        for name, text in found.items():
            click.echo(f"{name:<12}{text}")
        click.echo("compiler, cache and solvers: mbsrun --version")
        ctx.exit()


@click.group(
    cls=ModelFirst,
    help=HELP,
    subcommand_metavar="[COMMAND] MODEL ...",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_versions, help="Show versions."
)
def cli() -> None:
    """Turn the description of a multibody system into C kernels: `mbsgen`."""


def _targets(command: Callable[..., None]) -> Callable[..., None]:
    """Add an option for each target beside C; the command gets the names of the requested ones as `targets`."""

    @functools.wraps(command)
    def call(**given: object) -> None:
        wanted = tuple(target.name for target in TARGETS if given.pop(target.name.replace("-", "_")))
        command(targets=wanted, **given)

    for target in reversed(TARGETS):
        call = click.option(f"--{target.name}", is_flag=True, help=target.help)(call)
    return call


@cli.command("generate")
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), required=True, help="The folder to write.")
@click.option(
    "--runtime",
    is_flag=True,
    help="Make the numbers of the model parameters at run time, except zeros, quarter turns, axes and limits.",
)
@click.option("--zeros", is_flag=True, help="With --runtime: zeros and quarter turns too; this costs operations.")
@click.option(
    "--lump",
    is_flag=True,
    help="Place free masses by dividing by run-time parameters too. That saves flops; setup fails where one is 0.",
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(list(SWITCHES)),
    help="Switch a reduction off; repeatable. Without share-frames, each angle also has its own sine.",
)
@_targets
@click.option(
    "--functions",
    metavar="NAME,...",
    help=f"Only these functions, with their derivatives: {', '.join(FUNCTIONS)}; by default all.",
)
@click.option(
    "--derivatives",
    type=click.IntRange(0, 2),
    default=2,
    show_default=True,
    help="The highest order of generated derivatives. CasADi needs both for exact Hessians.",
)
@click.option("--scene", type=click.Path(path_type=Path), help="A scene file: the part of the model to generate.")
@click.option(
    "--tolerance",
    type=float,
    help="Relative error allowed for functions: smaller effects are left out. By default, the scene's, or none.",
)
@click.option(
    "--prefix",
    metavar="NAME",
    help="Let names in C begin with NAME; by default, the model's name. Models of one name need it in one program.",
)
@click.option("--check", is_flag=True, help="Write nothing; fail if the folder differs from the generated one.")
@importing
def generate_command(
    model: Path,
    out: Path,
    runtime: bool,
    zeros: bool,
    lump: bool,
    without: tuple[str, ...],
    targets: tuple[str, ...],
    functions: str | None,
    derivatives: int,
    scene: Path | None,
    tolerance: float | None,
    prefix: str | None,
    check: bool,
    choices: Choices,
) -> None:
    """Write a folder of C from MODEL; the default command.

    It holds the kernels, their header, manifest.json, report.md and report.json. The cost of the kernels is printed.
    The folder appears as a whole, and replaces one that mbsgen wrote before.
    """
    if lump and "lump" in without:
        raise click.BadParameter("it contradicts --without lump; give one of the two", param_hint="--lump")
    reductions = replace(ALL, lump_runtime=lump, **{SWITCHES[name]: False for name in without})
    options = Options(
        runtime=runtime,
        zeros=zeros,
        targets=targets,
        reductions=reductions,
        functions=None if functions is None else tuple(filter(None, map(str.strip, functions.split(",")))),
        derivatives=derivatives,
        scene=EVERYTHING if scene is None else scene,
        tolerance=tolerance,
        prefix=prefix,
    )
    source = _read(model, choices)
    with _progress() as tell:
        product = make(source, options, tell)
    if lump and not product.manifest.parameters:
        raise click.BadParameter(
            "the model has no parameter at run time; give --runtime too, or leave it out", param_hint="--lump"
        )
    if check:
        _check_folder({**product.files, **product.packages}, out)
        return
    write_folder({**product.files, **product.packages}, out)
    print_report(product.report)
    if notice := describe_mangling(product.manifest.model, product.manifest.prefix):
        click.echo(f"note: {notice}", err=True)
    click.echo(f"wrote {len(product.files) + len(product.packages)} files to {out}", err=True)


@contextmanager
def _progress() -> Iterator[Tell]:
    """Show on a terminal which stage is at work; write nothing into pipes and files."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield say_nothing
        return
    with console.status("") as status:
        yield lambda stage: status.update(escape(stage))


def _check_folder(files: Mapping[str, str | bytes], out: Path) -> None:
    """Print the files of a folder that differ from the generated ones; exit if there are any."""
    different = find_differences(files, out)
    for name in different:
        click.echo(f"{out / name}: not as generated now", err=True)
    if different:
        sys.exit(DIFFERENT)
    click.echo(f"{out}: as generated now", err=True)


_AT = "Coordinates of the drawing, rad or m; 0 by default, or where the loops are closed."


@cli.command("show")
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The picture to write: .png or .svg.")
@click.option("--at", "coordinates", metavar="q1=0.3,...", help=_AT)
@importing
def show_command(model: Path, out: Path | None, coordinates: str | None, choices: Choices) -> None:
    """Print the tree of MODEL; with -o, draw it.

    The tree lists bodies, joints and masses, and the indices, from 0, of joints in q and u and of frames among sensors.
    The picture shows the tree beside the mechanism in space.
    """
    from mbsgen.drawing import FORMATS, describe_joint, describe_loop, list_masses, render  # takes long to load

    form = "" if out is None else out.suffix.removeprefix(".").lower()
    if out is not None and form not in FORMATS:
        raise click.BadParameter(f"{out} is neither a .png nor a .svg", param_hint="-o")
    tree = read_tree(_read(model, choices))
    q = _read_coordinates(tree, coordinates or "")
    branches = {0: Branches(Text(f"{tree.name}: base"))}
    places = _find_places(tree)
    for i, (body, mass) in enumerate(zip(tree.bodies, list_masses(tree), strict=True), 1):
        limits = _describe_limits(body.joint.lower, body.joint.upper)
        words = f" {body.joint.name}: {describe_joint(tree, i)}{limits}, {mass:.6g} kg"
        place = Text(f"  {places[i]}" if places[i] else "", style="dim")
        branches[i] = branches[body.parent].add(Text.assemble((body.name, "bold"), words, place))
    for k, sensor in enumerate(tree.sensors):
        named = Text.assemble((f"frame {sensor.name}", "italic"), (f"  sensor {k}", "dim"))
        branches[sensor.body].add(named)
    for loop in tree.loops:
        branches[0].add(Text.assemble((f"loop {loop.name}", "italic"), f": {describe_loop(tree, loop)}"))
    for constraint in tree.constraints:
        branches[0].add(Text.assemble((f"constraint {constraint.name}", "italic")))
    if out is not None:
        write_file(render(tree, q, form), out)
        click.echo(f"wrote {out}", err=True)
    Console(width=_UNCUT, highlight=False).print(branches[0])


def _find_places(tree: Tree) -> dict[int, str]:
    """Return the indices, from 0, of each body's joint in q, in qd where these differ, and in u, as in the header."""
    followers, places = tree.followers, {}
    seen = {"qd": 0, "u": 0}
    for i, body in enumerate(tree.bodies, 1):
        own = []
        if i not in followers:
            if body.joint.name in tree.coordinates:
                own.append(f"q {tree.coordinates.index(body.joint.name)}")
            if tree.quaternions:
                own.append(f"qd {seen['qd']}")
            seen["qd"] += 1
        for x in tree.quaternions:
            if x.first == i:
                first = tree.coordinates.index(x.coordinates[0])
                own.insert(0, f"q {first}..{first + len(x.coordinates) - 1}")
        if body.joint.actuated:
            own.append(f"u {seen['u']}")
            seen["u"] += 1
        places[i] = f"[{', '.join(own)}]" if own else ""
    return places


def _describe_limits(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return ""
    return f", {'' if lower is None else f'{lower:.4g}'}..{'' if upper is None else f'{upper:.4g}'}"


def _read_coordinates(tree: Tree, text: str) -> list[float]:
    """Read `name=number,...` as the coordinates of all joints, the others of which close the loops.

    Raises click.BadParameter with all faults.
    """
    values = dict(zip(tree.coordinates, tree.closure.pose if tree.closure else tree.neutral, strict=True))
    given: dict[int, float] = {}
    faults = []
    for part in filter(str.strip, text.split(",")):
        name, sign, written = (word.strip() for word in part.rpartition("="))
        if not sign:
            faults.append(f"{written}: it gives no joint a number; write, for example, {next(iter(values))}=0.3")
            continue
        if name not in values:
            near = difflib.get_close_matches(name, values, 1) or list(values)[:3]
            faults.append(f"{part.strip()}: no joint is called {name!r}; there is {', '.join(near)}")
            continue
        values[name] = read_finite(written)
        if not math.isfinite(values[name]):
            faults.append(f"{part.strip()}: {written!r} is no number; write, for example, {name}=0.3")
        given[tree.coordinates.index(name)] = values[name]
    if faults:
        raise click.BadParameter("\n  ".join(faults), param_hint="--at")
    if tree.closure is None or not given:
        return list(values.values())
    if (found := reach(tree, given)) is None:
        raise click.BadParameter("the loops do not close there; give other coordinates, or fewer", param_hint="--at")
    return [float(x) for x in found]


@cli.command("report")
@MODEL
@click.option("--json", "form", flag_value="json", help="Print report.json.")
@click.option("--markdown", "form", flag_value="markdown", help="Print report.md.")
@click.option("--compare", is_flag=True, help="Also count without each reduction, to show its savings.")
@importing
def report_command(model: Path, form: str | None, compare: bool, choices: Choices) -> None:
    """Count the cost of MODEL: flops and equations."""
    source = _read(model, choices)
    with _progress() as tell:
        report = make(source, Options(compare=compare), tell).report
    if form is None:
        print_report(report)
    else:
        click.echo(write_json(report) if form == "json" else write_markdown(report), nl=False)


@cli.command("equations")
@MODEL
@click.option(
    "--form",
    type=click.Choice(["auto", "whole", "named", "lines"]),
    default="auto",
    show_default=True,
    help="Whole equations, equations in named intermediate values, or the residual line by line as it is generated; "
    "auto chooses whole ones where they are short, else lines.",
)
@click.option(
    "--format",
    "language",
    type=click.Choice([*FORMATS]),
    help="The language; by default, text, or what the suffix of --output says.",
)
@click.option("--numbers", is_flag=True, help="Put in the numbers of named parameters, instead of their names.")
@click.option(
    "-o",
    "--output",
    "outputs",
    type=click.Path(path_type=Path),
    multiple=True,
    help="A file to write; else stdout. Several are written with one call.",
)
@importing
def equations_command(
    model: Path, form: str, language: str | None, numbers: bool, outputs: tuple[Path, ...], choices: Choices
) -> None:
    """Print the equations of motion of MODEL.

    They are M(q) qdd + c(q, qd) + G(q) = Q. Products of sines and cosines are written as sums, so the form is unique,
    and zeros are not there. Loops add h(q) = 0 and its Jacobian J, frames their places. Mechanisms of many joints are
    written line by line, as the recursion that is generated.
    """
    if language is not None and len(outputs) > 1:
        finding = "the suffixes of several files choose their languages; leave it out"
        raise click.BadParameter(finding, param_hint="--format")
    languages = [language or _choose_language(out) for out in outputs]
    source = read(_read(model, choices))
    with _progress() as tell:
        tell("the equations")
        tree = build_numeric(source) if numbers else build_symbolic(source)
        page = _choose_page(tree, form)
    for out, own in zip(outputs, languages, strict=True):
        write_file(FORMATS[own](page).encode(), out)
    if not outputs:
        click.echo(FORMATS[language or "text"](page), nl=False)


def _choose_language(out: Path) -> str:
    """Return the language of a file's suffix."""
    if out.suffix not in _SUFFIXES:
        raise click.BadParameter(f"{out} ends in none of {', '.join(_SUFFIXES)}; give --format", param_hint="-o")
    return _SUFFIXES[out.suffix]


_SUFFIXES = {".txt": "text", ".py": "python", ".tex": "latex", ".md": "markdown", ".html": "html"}
_READABLE = 600  # terms of whole equations, beyond which lines are shorter


def _choose_page(tree: Tree, form: str) -> Page:
    """Lay out whole equations, or lines where these are too long."""
    if form == "lines":
        return show_lines(write_lines(tree))
    if form == "named":
        return show_motion(derive_stepwise(tree), "intermediate values")
    try:
        motion = derive(tree) if form == "whole" else derive(tree, _READABLE)
    except SizeError as error:
        if form == "whole":
            raise SizeError(f"{error}; take --form named or --form lines") from None
        return show_lines(write_lines(tree))
    return show_motion(motion) if form == "whole" or motion.terms <= _READABLE else show_lines(write_lines(tree))


@cli.command("scaling")
@click.option(
    "--to", "largest", type=click.IntRange(12, 1000), default=24, show_default=True, help="The longest chain."
)
def scaling_command(largest: int) -> None:
    """Count the formulations for chains of growing length.

    Uniform serial chains, axes z, y, x in turn, full inertias, numbers folded. SEMI and EXP1 are counted to 50 bodies.
    """
    sizes = range(PERIOD, largest + 1, PERIOD)
    found = {}
    for name, row in list_rows().items():
        within = [n for n in sizes if n <= row.longest]
        with click.progressbar(within, label=name, file=sys.stderr) as steps:
            found[name] = grow(name, steps)
    click.echo("bodies" + "".join(f"{name:>9} eqs  " for name in found))
    for n in sizes:
        cells = (g.counts.get(n) for g in found.values())
        click.echo(f"{n:6}" + "".join(f"{c.paper:8}{c.equations:6}" if c else " " * 14 for c in cells))
    for name, growth in found.items():
        if growth.degree("flops") is None:  # the chains are too short to show it
            continue
        click.echo(f"{name}: flops of degree {growth.degree('flops')}, equations of {growth.degree('equations')}")
    crossing = find_crossing(found["EXP1"].counts, found["EXP2"].counts)
    click.echo(f"EXP2 takes fewer flops than EXP1 from {crossing} bodies on" if crossing else "EXP1 takes fewer flops")


@cli.command("check")
@MODEL
@importing
def check_command(model: Path, choices: Choices) -> None:
    """Print every fault of MODEL, and write nothing."""
    read_tree(_read(model, choices))
    click.echo(f"{model}: no fault found", err=True)


@cli.command("compare")
@MODEL
@click.option("--with", "peer", type=click.Choice(["pinocchio"]), required=True, help="The program to compare with.")
@importing
def compare_command(model: Path, peer: str, choices: Choices) -> None:
    """Compare MODEL, a URDF file, with another program.

    Prints the largest differences of the residual Phi, the mass matrix M, the bias c and the accelerations qdd at
    random states, relative to the largest entry, and their known causes. Of closed loops, it compares forces and
    accelerations at closed states. Exit code 1: an unexplained difference.
    """
    from mbsgen.comparison import RESULTS, TOLERANCE, compare_with_pinocchio

    if model.suffix.lower() != ".urdf":
        raise click.UsageError(f"{model}: files of URDF are compared, since {peer} reads these")
    found = compare_with_pinocchio(model, choices)
    for title, misses in (("as imported", found.imported), ("without damping, friction and rotors", found.bare)):
        click.echo(f"{title:38}" + "".join(f"{name} {misses[name]:.1e}   " for name in RESULTS).rstrip())
    if found.closed:
        shown = "".join(f"{name} {miss:.1e}   " for name, miss in found.closed.items()).rstrip()
        click.echo(f"{'with loops, at closed states':38}{shown}")
    for line in found.named:
        click.echo(line)
    if not found.agrees:
        click.echo(f"the equations differ by more than {TOLERANCE:g}", err=True)
        sys.exit(DIFFERENT)


@cli.command(
    "import",
    help=f"""Make a model file of MODEL, a file of {list_formats()}.

    Changes and omissions are printed on stderr, and written as comments into the model file.
    """,
)
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The model file to write; else stdout.")
@importing
def import_command(
    model: Path,
    out: Path | None,
    choices: Choices,
) -> None:
    """Make a model file of a file in another format."""
    imported = import_model(model, choices)
    _tell(imported.notices)
    text = write_imported(imported)
    if out is None:
        click.echo(text, nl=False)
        return
    write_file(text.encode(), out)
    click.echo(f"wrote {out}", err=True)


def _read(model: Path, choices: Choices) -> Path | Model:
    """Import a foreign model and print its notices; return the path of any other model."""
    if not is_foreign(model):
        return model
    imported = import_model(model, choices)
    _tell(imported.notices)
    return imported.model


def _tell(notices: Sequence[Notice]) -> None:
    for notice in notices:
        click.echo(str(notice), err=True)


def _read_gravity(text: str) -> tuple[float, float, float]:
    values = [read_finite(word) for word in text.split(",")]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise click.BadParameter(
            f"{text!r} is not three numbers; write, for example, 0,0,-9.81", param_hint="--gravity"
        )
    x, y, z = values
    return x, y, z


def print_report(report: Report) -> None:
    """Print the cost of a model on stdout: tables with the same columns, whatever their contents."""
    cells = [
        (name, *map(str, cost.row)) for s in sections(report) for costs in s.groups for name, cost in costs.items()
    ]
    widths = [max(map(len, column)) for column in zip(("", *COLUMNS), *cells, strict=True)]
    for section in sections(report):
        click.echo(f"{section.title}: {report.model}\n")
        click.echo("\n".join(_lay_out(section, widths)) + "\n")
    if rows := comparisons(report):
        click.echo(f"{COMPARISON}: {report.model}\n")
        first = max(map(len, rows))
        click.echo("  ".join(("".ljust(first), *(name.rjust(6) for name in report.formulations))))
        click.echo("-" * (first + 8 * len(report.formulations)))
        for title, row in rows.items():
            click.echo("  ".join((title.ljust(first), *(str(row[name]).rjust(6) for name in report.formulations))))
        click.echo("")
    _print_ways(report)
    click.echo(textwrap.fill(NOTE, 79))


def _print_ways(report: Report) -> None:
    for title, header, table in tables_of_scene(report):
        widths = [max(len(row[k]) for row in (header, *table)) for k in range(len(header))]
        click.echo(f"{title}: {report.model}\n")
        for row in (header, *table):
            click.echo("  ".join((row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:]))).rstrip())
        click.echo("")
    if note := note_of_scene(report):
        click.echo(textwrap.fill(note, 79) + "\n")
    if not report.ways:
        return
    rows = ways_taken(report)
    first = max(map(len, rows))
    click.echo(f"{DIFFERENTIATION}: {report.model}\n")
    for title, cells in {"": WAYS, **rows}.items():
        click.echo("  ".join((title.ljust(first), *(cell.rjust(9) for cell in cells))).rstrip())
    click.echo("")


def _lay_out(section: Section, widths: Sequence[int]) -> Iterator[str]:
    """Arrange a table in columns; a blank line separates groups of several rows."""

    def line(*cells: str) -> str:
        return "  ".join((cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])))

    yield line("", *COLUMNS)
    yield "-" * len(line("", *COLUMNS))
    before = 1
    for costs in section.groups:
        if max(before, len(costs)) > 1 and costs is not section.groups[0]:
            yield ""
        before = len(costs)
        yield from (line(name, *map(str, cost.row)) for name, cost in costs.items())


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    click.echo(f"warning: {message}", err=True)


def main() -> None:
    """Run the command line; a user's errors are printed without a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # the terminal's encoding may lack the characters of a name
    warnings.showwarning = _show_warning
    try:
        cli(prog_name="mbsgen")
    except MbsError as error:
        click.echo(f"mbsgen: {error}" if "\n" not in str(error) else str(error), err=True)
        sys.exit(BAD_INPUT)
