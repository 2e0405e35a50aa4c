"""`mbsrun range`: a model -> how far its joints can move."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
from rich import box
from rich.table import Table

from mbsgen.help import ModelCommand
from mbsrun.closure import Closure
from mbsrun.commands.console import print_table, say
from mbsrun.commands.recorded import read_numbers, set_parameters, write_table
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.models import Extent
from mbsrun.quaternions import neutral
from mbsrun.simulation.strokes import Stroke, find_stroke, find_strokes, list_extremes, tabulate

MOVED = Extent(("frames",), 1, optional=("loops", "loop_rates", "loop_jacobian", "rates"))

RANGE_HELP = """Find how far the joints of MODEL can move, as its loops and the limits of joints allow.

Each joint moves in turn, from the model's pose; other independent joints stand still. A motion ends at a limit of some
joint, or at a dead centre, where the loops cannot be closed any farther. With --joint, one joint moves, and a table of
all coordinates and sensors along the motion is written.

\b
  mbsrun range models/four_bar.yaml
  mbsrun range models/four_bar.yaml --joint swing -o swing.csv

\b
Exit codes
  0   found
  2   the model or an argument cannot be accepted, or no loop can be closed; nothing written
"""


@click.command("range", cls=ModelCommand, help=RANGE_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--joint", metavar="NAME", help="The joint that moves; by default each in turn.")
@click.option(
    "--pose", multiple=True, metavar="NAME=NUMBER", help="The first value of a coordinate [rad, m]; others follow."
)
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A run-time parameter.")
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The table; by default NAME.range.csv.")
@accept_robots
def range_command(
    model: Path, joint: str | None, pose: Sequence[str], parameters: Sequence[str], out: Path | None
) -> None:
    """Read, move, write, print."""
    if out is not None and joint is None:
        raise click.UsageError("-o writes a table of one joint; give --joint, too")
    mechanism = load(model, extent=MOVED)
    mechanism = mechanism.with_parameters(**set_parameters(mechanism, parameters))
    manifest = mechanism.manifest
    names = [c.name for c in manifest.coordinates if c.name in manifest.positions]
    if joint is not None and joint not in names:
        raise click.BadParameter(f"found {joint!r}; give some of {', '.join(names)}", param_hint="--joint")
    start = np.array(manifest.pose) if manifest.pose else neutral(manifest)
    given = read_numbers("pose", pose, names)
    start = Closure(mechanism).move(start, [manifest.positions.index(x) for x in given], np.array([*given.values()]))
    if joint is None:
        _print_all(find_strokes(mechanism, start), {c.name: c.unit for c in manifest.coordinates})
        return
    stroke = find_stroke(mechanism, start, joint)
    if stroke is None:
        raise click.BadParameter(f"the loops do not let {joint} move", param_hint="--joint")
    out = out or Path(f"{model.stem}.range.csv")
    write_table(out, *tabulate(stroke, mechanism))
    for label, end in (("from", stroke.lower), ("to", stroke.upper)):
        click.echo(f"{label:<8}{end.value:.9g}: {end.cause}")
    if stroke.held:
        click.echo(f"held    {', '.join(stroke.held)}")
    for name, least, most in list_extremes(stroke, mechanism):
        click.echo(f"{name:<24}{least:.6g} to {most:.6g}")
    say(f"wrote {out}")


def _print_all(strokes: Sequence[Stroke], units: dict[str, str]) -> None:
    """Print a row for each joint that can lead."""
    table = Table(box=box.SIMPLE)
    for title in ("joint", "from", "to", "unit", "ends"):
        table.add_column(title, justify="right" if title in ("from", "to") else "left")
    for x in strokes:
        causes = " / ".join(dict.fromkeys((x.lower.cause, x.upper.cause)))
        table.add_row(x.joint, f"{x.lower.value:.6g}", f"{x.upper.value:.6g}", units[x.joint], causes)
    print_table(table)
    held = dict.fromkeys(name for x in strokes for name in x.held)
    if held:
        click.echo(f"while one joint moves, other independent joints stand still: {', '.join(held)}")
