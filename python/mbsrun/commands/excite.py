"""`mbsrun excite`: a model file -> the motion within its limits that determines its inertias and frictions best."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
from rich.markup import escape
from rich.table import Table

from mbsgen.help import ModelCommand
from mbsrun.commands.console import NumberType, choose_format, list_written, print_table, say, show_progress
from mbsrun.commands.recorded import read_numbers, write_json, write_table
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.identification.excitation import CRITERIA, MODEST, Excitation, Wishes, excite
from mbsrun.identification.identify import EXTENT
from mbsrun.identification.settings import INERTIA, SPEED, Settings
from mbsrun.recordings.pictures import Panel, plot_panels

FORMAT = "mbsrun excitation 1"
MOTION, SUMMARY, PICTURE = "motion.csv", "excitation.json", "motion.png"
FULL = 0.9  # of a limit: a joint that uses more is at it

HELP = """Design a motion of MODEL that determines its inertias and frictions: an exciting motion.

Joints move by Fourier series that begin and end at rest, within the limits, max_speed and max_force of the model:

\b
  mbsrun excite models/recorded/two_link.yaml --unknown inertia,damping,friction -o build/exciting
  mbsrun animate models/recorded/two_link.yaml build/exciting/motion.csv -o build/exciting.html

The criterion measures the information matrix of the base parameters (see mbsrun identify): D by the determinant, E by
the least eigenvalue, A by the trace of the inverse, C by the deviation of one base parameter, --number. Several starts
are tried, and the best is moved towards the limits.

\b
The output folder gets
  motion.csv         time, coordinates, velocities, accelerations, torques with the model's numbers
  excitation.json    the series, as expressions for mbsrun inverse --motion; expected deviations; used parts of limits
  motion.png         coordinates, velocities and torques

\b
Exit codes
  0   written
  2   the model or an argument cannot be accepted, or no motion is within the limits; nothing written
"""


@click.command("excite", cls=ModelCommand, help=HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="The folder to write to.")
@click.option("--unknown", "unknown", multiple=True, metavar="KINDS", help="Unknown numbers, as in mbsrun identify.")
@click.option("--body", "bodies", multiple=True, metavar="NAME", help="A body of unknown inertia; by default all.")
@click.option("--joint", "joints", multiple=True, metavar="NAME", help="A joint of unknown numbers; by default all.")
@click.option(
    "--criterion",
    type=click.Choice(CRITERIA),
    default=MODEST.criterion,
    help="The measure of the information matrix; by default D.",
)
@click.option("--number", default="", metavar="NAME", help="The base parameter that criterion C makes surest.")
@click.option(
    "--torque-noise",
    "deviations",
    multiple=True,
    metavar="NAME=S",
    help="The standard deviation of a torque [N m], its weight; by default max_force.",
)
@click.option(
    "--duration",
    type=NumberType(),
    default=MODEST.duration,
    metavar="T",
    help="The length of the motion [s]; by default 10.",
)
@click.option(
    "--harmonics",
    type=click.IntRange(2, 50),
    default=MODEST.harmonics,
    help="The number of harmonics of the series; by default 5.",
)
@click.option("--starts", type=click.IntRange(1, 1000), default=MODEST.starts, help="Random starts; 4.")
@click.option("--seed", type=click.IntRange(0), default=MODEST.seed, help="The seed of random starts; by default 0.")
@click.option(
    "--max-speed",
    "quick",
    type=NumberType(),
    default=MODEST.speed,
    help="The largest speed of joints without max_speed; by default 2.",
)
@click.option(
    "--speed",
    type=NumberType(),
    default=SPEED,
    metavar="V",
    help="The speed that smooths dry friction [rad/s]; by default 0.02.",
)
@click.option(
    "--output-step", "step", type=NumberType(), default=MODEST.step, metavar="H", help="The time between rows [s]."
)
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A parameter of the model.")
@choose_format
@accept_robots
def excite_command(
    model: Path,
    out: Path | None,
    unknown: Sequence[str],
    bodies: Sequence[str],
    joints: Sequence[str],
    criterion: str,
    number: str,
    deviations: Sequence[str],
    duration: float,
    harmonics: int,
    starts: int,
    seed: int,
    quick: float,
    speed: float,
    step: float,
    parameters: Sequence[str],
) -> None:
    """Search, write, print."""
    words = [word.strip() for text in unknown for word in text.split(",")]
    settings = Settings(
        unknown=tuple(dict.fromkeys(words)) or (INERTIA,),
        bodies=tuple(bodies),
        joints=tuple(joints),
        speed=speed,
        parameters=read_numbers("parameter", parameters),
        noise=read_numbers("torque-noise", deviations),
    )
    samples = max(MODEST.samples, 40 * harmonics)
    wishes = Wishes(duration, harmonics, criterion, samples, starts, seed, quick, step, number)
    with show_progress() as report:
        found = excite(model, settings, wishes, report=report)
    out = out or Path(f"{model.stem}.exciting")
    out.mkdir(parents=True, exist_ok=True)
    names = _write(found, model, out)
    write_json(out / SUMMARY, _summarise(found, names))
    _show(found)
    say(f"wrote {list_written(out, (MOTION, SUMMARY, PICTURE))}")


def _write(found: Excitation, model: Path, out: Path) -> list[str]:
    """Write the table and the picture; return the names of the joints."""
    manifest = load(model, extent=EXTENT).manifest
    joints, driven = manifest.coordinates, [manifest.coordinates[i] for i in manifest.actuated]
    header = ["t [s]"]
    for kind, power in (("q", ""), ("qd", "/s"), ("qdd", "/s^2")):
        header += [f"{kind}[{c.name}] [{c.unit}{power}]" for c in joints]
    header += [f"u[{c.name}] [{c.force_unit}]" for c in driven]
    write_table(out / MOTION, header, np.hstack((found.t[:, None], found.q, found.qd, found.qdd, found.u)))
    names = [c.name for c in joints]
    panels = [
        Panel(label, dict(zip(names, values.T, strict=True)), {})
        for label, values in (("q [rad, m]", found.q), ("qd [rad/s, m/s]", found.qd))
    ]
    panels.append(Panel("u [N m, N]", dict(zip([c.name for c in driven], found.u.T, strict=True)), {}))
    plot_panels(found.t, panels, f"{manifest.model}: exciting motion", out / PICTURE)
    return names


def _summarise(found: Excitation, names: Sequence[str]) -> dict[str, object]:
    return {
        "format": FORMAT,
        "model": found.model,
        "criterion": found.criterion,
        "value": found.value,
        "value_of_a_start": found.before,
        "condition": found.condition,
        "period": found.duration,
        "motion": {name: found.write_expression(i) for i, name in enumerate(names)},
        "expected_deviations": dict(zip(found.names, found.deviations.tolist(), strict=True)),
        "used_parts_of_limits": found.shares,
    }


def _show(found: Excitation) -> None:
    """Print the criterion, the expected deviations and the limits that are reached."""
    table = Table(box=None, pad_edge=False)
    table.add_column("base parameter")
    table.add_column("deviation", justify="right")
    for name, deviation in zip(found.names, found.deviations.tolist(), strict=True):
        table.add_row(escape(name), f"{deviation:.3g}")
    print_table(table)
    click.echo("deviations for torques with noise of 1 N m (N), one row in each second; of 100, a tenth")
    gain = f"{found.criterion} {found.value:.4g}, from {found.before:.4g} of a start"
    click.echo(f"{gain}; condition {found.condition:.3g}")
    full = [name for name, share in found.shares.items() if share > FULL]
    click.echo(f"at their limits: {', '.join(full) or 'none'}")
