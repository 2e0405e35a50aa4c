"""`mbsgen generate`, the default command: a model -> a folder of C, with the cost of its kernels."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import click

from mbsgen.commands.console import DIFFERENT, show_progress
from mbsgen.commands.importing import MODEL, importing, read_model
from mbsgen.commands.report import print_report
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices
from mbsgen.model.changes.scene import EVERYTHING
from mbsgen.output import find_differences, write_folder
from mbsgen.pipeline import Options, make
from mbsgen.report import BRIEF
from mbsgen.roles import ACCELERATING, QUICKEST
from mbsgen.targets.c.symbols import describe_mangling
from mbsgen.targets.languages import TARGETS

SWITCHES = {
    name.replace("_", "-"): name
    for name in (
        *("regroup", "share_frames", "lump", "absolute", "meet", "together"),
        *("spin", "momentum", "rest", "series", "factor", "share", "order"),
    )
}


def _targets(command: Callable[..., None]) -> Callable[..., None]:
    """Add an option for each target beside C; the command gets the names of the requested ones as `targets`."""

    @functools.wraps(command)
    def call(**given: object) -> None:
        wanted = tuple(target.name for target in TARGETS if given.pop(target.name.replace("-", "_")))
        command(targets=wanted, **given)

    for target in reversed(TARGETS):
        call = click.option(f"--{target.name}", is_flag=True, help=target.help)(call)
    return call


HELP = """Write a folder of C from MODEL; the default command.

\b
  mbsgen models/pendulum.yaml -o pendulum
  mbsgen robot.urdf --functions impl,exp2 --derivatives 1 -o robot

The folder contains the kernels, their header, manifest.json, report.md and report.json. It appears as a whole, and
replaces a folder that mbsgen wrote before. The numbers of operations are printed.
"""
SECTIONS = {
    "Functions": ("functions", "derivatives", "scene", "tolerance"),
    "Numbers and operations": ("runtime", "zeros", "lump", "without"),
    "Further languages and forms": tuple(target.name.replace("-", "_") for target in TARGETS),
}


@click.command("generate", cls=ModelCommand, help=HELP, sections=SECTIONS)
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), required=True, help="The folder to write.")
@click.option(
    "--runtime",
    is_flag=True,
    help="Turn the model's numbers into run-time parameters, except zeros, quarter turns, axes and limits.",
)
@click.option("--zeros", is_flag=True, help="With --runtime: zeros and quarter turns too; this costs operations.")
@click.option(
    "--lump",
    is_flag=True,
    help="Also divide by run-time parameters to lump masses: fewer flops, but setup fails where such a number is 0.",
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(list(SWITCHES)),
    metavar="NAME",
    help=f"Switch off a reduction of operations; repeatable: {', '.join(SWITCHES)}. Without share-frames, each angle "
    "also has its own sine.",
)
@_targets
@click.option(
    "--functions",
    metavar="NAME,...",
    help=f"Only these functions, with their derivatives: {', '.join(FUNCTIONS)}; by default all. {QUICKEST} means "
    f"{' or '.join(sorted(ACCELERATING))}, whichever is quicker.",
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
    help="The beginning of all names in C; by default, the model's name. Models in one program need different ones.",
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
    """Generate, verify, and write the folder."""
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
    source = read_model(model, choices)
    with show_progress() as tell:
        product = make(source, options, tell)
    if lump and not product.manifest.parameters:
        raise click.BadParameter(
            "the model has no parameter at run time; give --runtime too, or leave it out", param_hint="--lump"
        )
    if check:
        _check_folder({**product.files, **product.packages}, out)
        return
    write_folder({**product.files, **product.packages}, out)
    print_report(product.report, BRIEF)
    if notice := describe_mangling(product.manifest.model, product.manifest.prefix):
        click.echo(f"note: {notice}", err=True)
    if hidden := product.manifest.switching:
        notice = "have rigid stops or dry friction, which are in no kernel; mbsrun simulate applies them"
        click.echo(f"note: joints {', '.join(hidden)} {notice}", err=True)
    click.echo(f"wrote {len(product.files) + len(product.packages)} files to {out}", err=True)


def _check_folder(files: Mapping[str, str | bytes], out: Path) -> None:
    """Print the files of a folder that differ from the generated ones; exit if there are any."""
    different = find_differences(files, out)
    for name in different:
        click.echo(f"{out / name}: differs from the code that is generated now", err=True)
    if different:
        sys.exit(DIFFERENT)
    click.echo(f"{out}: as generated now", err=True)
