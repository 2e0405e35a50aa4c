"""`mbsrun inverse`: a model and the motion of some joints -> the forces that the motion takes."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from mbsgen.expressions import Expression, ExpressionError, Number, parse
from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.commands.columns import more_columns
from mbsrun.commands.console import NumberType, say
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.models import INTEGRATED
from mbsrun.simulation.course import follow, place_driven
from mbsrun.simulation.inverse import invert, measure, tabulate
from mbsrun.smoothness import demand_smooth

INVERSE_HELP = """Compute the forces that a given motion of MODEL takes, and write them as a table.

--motion gives the motions of joints over the time t, as many as there are degrees of freedom; loops determine the
others. Driven joints without a motion stand where the model's closed pose has them:

\b
  mbsrun inverse models/four_bar.yaml --motion 'motor=60 deg + 0.5*sin(2*t)' --duration 3

If more actuators act than necessary, their forces have the least norm. If too few act, the column
`unbalanced` holds the largest generalised force that is missing.

\b
Exit codes
  0   written
  2   the model or an argument cannot be accepted, or loops cannot be closed; nothing written
"""


@click.command("inverse", cls=ModelCommand, help=INVERSE_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--motion",
    "motions",
    multiple=True,
    metavar="NAME=EXPRESSION",
    help="A joint over the time t [rad, m]: --motion 'q1=0.3*sin(2*t)'.",
)
@click.option("--duration", type=NumberType(), default=1.0, metavar="T", help="The length of the motion [s]; 1.")
@click.option("--output-step", type=NumberType(), metavar="H", help="The time between rows [s]; by default T/1000.")
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The table; by default NAME.inverse.csv.")
@more_columns
@accept_robots
def inverse_command(
    model: Path,
    motions: Sequence[str],
    duration: float,
    output_step: float | None,
    out: Path | None,
    columns: tuple[str, ...],
) -> None:
    """Read, compute, write, print."""
    step = output_step if output_step is not None else duration / 1000
    if not (duration > 0 and step > 0 and duration / step <= 1_000_000):
        raise click.UsageError("--duration and --output-step must be positive, with at most a million rows")
    mechanism = load(model, extent=INTEGRATED)
    manifest = mechanism.manifest
    demand_smooth(manifest, "inverse dynamics", stops=False)
    expressions = _read_motions(motions, manifest)
    names = [c.name for c in manifest.coordinates]
    try:
        course = follow(list(expressions.values()), [names[i] for i in expressions], {})
    except ExpressionError as error:
        raise click.BadParameter(str(error), param_hint="--motion") from None
    times = np.linspace(0.0, duration, round(duration / step) + 1)
    forces = invert(mechanism, list(expressions), course, times)
    header, rows = tabulate(forces, mechanism)
    numbers = measure(forces, mechanism)
    chosen = numbers.select(columns)
    header += map(numbers.label, chosen)
    rows = np.column_stack((rows, *(numbers[name] for name in chosen)))
    out = out or Path(f"{model.stem}.inverse.csv")
    with out.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows.tolist())
    for name, column in zip(header, rows.T, strict=True):
        if name.startswith(("u[", "tau[")):
            click.echo(f"{name:<24}{column.min():.6g} to {column.max():.6g}")
    click.echo(f"{'unbalanced':<24}{forces.unbalanced.max():.2g} at most")
    if forces.spare:
        click.echo(f"{forces.spare} more forces than degrees of freedom: the ones of least norm are shown")
    say(f"wrote {out}")
    if jump := forces.find_jump(manifest):
        say(
            f"warning: {jump[1]} jumps at t = {jump[0]:.6g} s, away from its velocity: rows are too far apart, or the "
            "motion changes between two ways to assemble the loops; take a shorter --output-step"
        )


def _read_motions(motions: Sequence[str], manifest: Manifest) -> dict[int, Expression]:
    """Return the expressions of joints by their entries of qd; driven ones without a motion stand."""
    names = [c.name for c in manifest.coordinates]
    places = zip(manifest.driven, place_driven(manifest), strict=True)
    found: dict[int, Expression] = {i: Number(manifest.pose[k] if manifest.pose else 0.0) for i, k in places}
    given = set[str]()
    for pair in motions:
        name, sign, text = pair.partition("=")
        name = name.strip()
        if not sign or name not in names or name not in manifest.positions or name in given:
            known = ", ".join(x for x in names if x in manifest.positions)
            told = f"found {pair!r}; give NAME=EXPRESSION once for some of {known}"
            raise click.BadParameter(told, param_hint="--motion")
        given.add(name)
        try:
            found[names.index(name)] = parse(text)
        except ExpressionError as error:
            raise click.BadParameter(f"{name}: {error}", param_hint="--motion") from None
    return found
