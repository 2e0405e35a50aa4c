"""`mbsrun animate`: a model and motions -> a page, a GIF, a picture or an MP4."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click

from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.animation import Wanted, make_film
from mbsrun.animation.files import Size, write_film
from mbsrun.animation.film import Film
from mbsrun.animation.visuals import Visual, give_mesh, read_visuals, show_drawings
from mbsrun.commands.animated import equip, read_motion
from mbsrun.commands.console import NumberType, say, show_progress
from mbsrun.commands.recorded import set_parameters, split_pairs
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.models import Extent, list_undrawn

DRAWN = Extent(("frames",), derivatives=0, optional=("rates",))
LARGEST = 4096  # pixels
LEEWAY = 1e-3  # s

ANIMATE_HELP = """Animate motions of MODEL: as a page for any browser, a GIF, a picture, or an MP4.

A MOTION is a folder that solve, simulate, track, fit-motion or inverse-dynamics wrote, its solution.json, or a table
of the model's coordinates over time (CSV, MOT, STO). Several motions are shown at the same time, one over the other,
or with --apart side by side; NAME=MOTION gives one a name:

\b
  mbsrun animate models/cart_pole.yaml cart_pole_swing_up.solution -o swing.gif
  mbsrun animate models/acrobot.yaml optimum=a.solution guess=b.simulation --apart -o both.mp4

Bodies are solids sized from their mass and inertia, or the shapes and meshes of the model, of a URDF file or of --mesh.
Inputs and open wrenches are arrows, paths of sensors are lines, and the phases of a problem follow each other.

\b
Files, by their suffix
  .html   a page without other files, in which the view turns, and time goes at any speed
  .gif    a film that repeats
  .png    six pictures over the time, or one for each --at
  .mp4    a film, where ffmpeg is on the path

\b
Exit codes
  0   written
  2   the model, a motion or an argument cannot be accepted, or ffmpeg is missing
"""


class SizeType(click.ParamType[Size]):
    """A size such as 640x480."""

    name = "size"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Size:
        """Read the size."""
        found = value if isinstance(value, Size) else re.fullmatch(r"(\d{2,4})x(\d{2,4})", str(value))
        if found is None:
            self.fail(f"{value!r} is no size; give WIDTHxHEIGHT in pixels, such as 640x480", param, ctx)
        size = found if isinstance(found, Size) else Size(int(found[1]), int(found[2]))
        if not (min(size.width, size.height) >= 16 and max(size.width, size.height) <= LARGEST):
            self.fail(f"{value!r} is not between 16 and {LARGEST} pixels", param, ctx)
        return size


@click.command("animate", cls=ModelCommand, help=ANIMATE_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("motions", metavar="MOTION...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The file to write; may be given several times. By default NAME.html, for a model NAME.",
)
@click.option(
    "--visuals", type=click.Path(path_type=Path), help="A URDF file whose visuals to show; MODEL, if it is one."
)
@click.option(
    "--package",
    "packages",
    multiple=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder of a package that meshes are in (package://NAME/...), or a folder of packages.",
)
@click.option("--mesh", "meshes", multiple=True, metavar="BODY=FILE", help="A mesh of a body: STL, OBJ, PLY or glTF.")
@click.option("--apart", "is_apart", is_flag=True, help="Show several motions side by side.")
@click.option("--title", help="The title; by default the model's name.")
@click.option(
    "--size", type=SizeType(), default="640x480", metavar="WxH", help="The size of the pictures; by default 640x480."
)
@click.option("--rate", type=NumberType(), default=25.0, metavar="N", help="Pictures in a second; 25.")
@click.option("--at", multiple=True, type=NumberType(), metavar="T", help="The time of a picture in a PNG [s].")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A run-time parameter.")
@accept_robots
@click.pass_context
def animate_command(
    context: click.Context,
    /,
    model: Path,
    motions: Sequence[str],
    outputs: Sequence[Path],
    visuals: Path | None,
    packages: Sequence[Path],
    meshes: Sequence[str],
    is_apart: bool,
    title: str | None,
    size: Size,
    rate: float,
    at: tuple[float, ...],
    parameters: Sequence[str],
) -> None:
    """Read, place, draw, write."""
    if not 0 < rate <= 100:
        raise click.BadParameter("give a number above 0, of at most 100", param_hint="--rate")
    mechanism = load(model, extent=DRAWN)
    given = set_parameters(mechanism, parameters)
    mechanism = mechanism.with_parameters(**given)
    read = [read_motion(path, equip(mechanism, model, DRAWN, path, given), name) for name, path in map(_split, motions)]
    robot = context.params["model"]  # as given: `model` may be imported from it, and has no shapes
    shown = _read_shapes(robot, visuals, tuple(packages), meshes, read[0][0].manifest)
    markers = tuple(dict.fromkeys(marker for _, own in read for marker in own))
    film = make_film([motion for motion, _ in read], Wanted(title, markers, is_apart, shown, rate))
    outputs = outputs or (Path(f"{model.stem}.html"),)
    size = replace(size, at=_check_times(at, outputs, film))
    for out in outputs:
        out.parent.mkdir(parents=True, exist_ok=True)
        with show_progress() as report:
            write_film(film, out, size, report)
        say(f"wrote {out}")


def _read_shapes(
    model: Path, visuals: Path | None, packages: tuple[Path, ...], meshes: Sequence[str], manifest: Manifest
) -> tuple[Visual, ...]:
    """Read the shapes and meshes of bodies; a given mesh, or a given file's shapes of a body, replace the model's."""

    def warn(text: str) -> None:
        say(f"warning: {text}")

    source = visuals or (model if model.suffix.lower() == ".urdf" else None)
    bodies = [x.name for x in manifest.appearance.bodies] if manifest.appearance else []
    found = [] if source is None else read_visuals(source, packages, warn)
    found += [give_mesh(body, Path(path)) for body, path in split_pairs("mesh", meshes, bodies).items()]
    shown = {x.body for x in found}
    for notice in list_undrawn(model):
        warn(notice)
    own = show_drawings(manifest, model.parent if model.is_file() else model, warn)
    return (*found, *(x for x in own if x.body not in shown))


def _check_times(at: tuple[float, ...], outputs: Sequence[Path], film: Film) -> tuple[float, ...]:
    """Return times of pictures, if a picture is written, and they lie in the film's time."""
    first, last = float(film.times[0]), float(film.times[-1])
    if at and all(out.suffix.lower() != ".png" for out in outputs):
        raise click.BadParameter("it chooses the times of a .png; give -o FILE.png", param_hint="--at")
    for t in at:
        if not first - LEEWAY <= t <= last + LEEWAY:
            raise click.BadParameter(f"{t:g} s is not between {first:g} and {last:g} s", param_hint="--at")
    return at


def _split(text: str) -> tuple[str, Path]:
    """Return the name and the path of a motion: as given, or by the name of the folder or file."""
    name, sign, path = text.partition("=")
    if sign and name and path and not Path(text).exists():
        return name, Path(path)
    return Path(text).resolve().stem, Path(text)
