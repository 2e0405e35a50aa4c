"""`mbsrun identify`: a model file and recordings with torques -> its inertias and frictions, with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
from rich.markup import escape
from rich.table import Table

from mbsgen.help import ModelCommand
from mbsrun.commands.console import (
    NOT_SOLVED,
    NumberType,
    choose_format,
    list_written,
    print_table,
    say,
    show_progress,
)
from mbsrun.commands.recorded import cut, read_loads, read_numbers, split_pairs, write_json
from mbsrun.commands.robots import accept_robots
from mbsrun.identification.estimation import CORRELATED
from mbsrun.identification.identify import identify
from mbsrun.identification.pictures import plot_numbers, plot_residuals
from mbsrun.identification.result import Identification
from mbsrun.identification.settings import INERTIA, KINDS, LOSSES, SPEED, Settings
from mbsrun.identification.writing import summarise, write_model
from mbsrun.measuring import sections
from mbsrun.measuring.page import render_page
from mbsrun.recordings import Treatment, read_recording

SUMMARY, MODEL, PAGE = "identification.json", "identified.yaml", "identification.html"
RESIDUALS, NUMBERS = "residuals.png", "numbers.png"
WEAK = 0.5  # standard deviation, relative to the value, from which a number is hardly determined

HELP = f"""Identify numbers of MODEL from recorded motions with torques.

Each RECORDING holds coordinates over time (q[NAME], or NAME) and torques of actuated joints (u[NAME]). Velocities and
accelerations are taken from qd[NAME] and qdd[NAME] where all of them are there; else splines give them, which --noise
smooths. --cutoff filters coordinates and torques alike.

\b
  mbsrun identify models/recorded/two_link.yaml models/recorded/two_link.csv --unknown inertia,damping -o build/found

Unknown numbers are chosen by --unknown, once or more, and parameters of the model by --fit:

\b
{chr(10).join(f"  {kind:<10}{text}" for kind, text in KINDS.items())}

Forces depend on sums of these numbers alone: the base parameters. They are estimated by weighted least squares, with
standard deviations and intervals of 95 %. Numbers that no motion or no recording determines are listed, and keep the
model's values. The written bodies are the nearest to the model's that have the sums, and that can be built.

\b
The output folder gets
  identified.yaml       the model with the found numbers; remarks give their uncertainty
  identification.json   base parameters, correlations, residuals, cross validation
  identification.html   a page with all tables and pictures
  residuals.png         measured and computed torques
  numbers.png           standard deviations and correlations

\b
Exit codes
  0   written, and the recordings determine all base parameters
  1   written, but the recordings leave some open
  2   the model, a recording or an argument cannot be accepted; nothing written
"""


@click.command("identify", cls=ModelCommand, help=HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("files", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="The folder to write to.")
@click.option("--unknown", "unknown", multiple=True, metavar="KINDS", help="Unknown numbers; by default inertia.")
@click.option("--fit", "fitted", multiple=True, metavar="NAME", help="An unknown run-time parameter of the model.")
@click.option("--body", "bodies", multiple=True, metavar="NAME", help="A body of unknown inertia; by default all.")
@click.option("--joint", "joints", multiple=True, metavar="NAME", help="A joint of unknown numbers; by default all.")
@click.option("--torques", "others", multiple=True, type=click.Path(path_type=Path), help="A recording of the torques.")
@click.option("--column", "columns", multiple=True, metavar="NAME=COLUMN", help="The column of a coordinate.")
@click.option("--torque", "torques", multiple=True, metavar="NAME=COLUMN", help="The column of a joint's torque.")
@click.option("--current", "currents", multiple=True, metavar="NAME=COLUMN", help="The column of a motor's current.")
@click.option("--motor", "motors", multiple=True, metavar="NAME=K", help="The torque of a unit of current [N m/A].")
@click.option("--unmeasured", multiple=True, metavar="NAME", help="An actuated joint whose torque is not recorded.")
@click.option(
    "--wrench",
    "wrenches",
    multiple=True,
    metavar="NAME=FORCE[,POINT[,MOMENT]]",
    help="The recorded columns of an external force.",
)
@click.option(
    "--torque-noise",
    "deviations",
    multiple=True,
    metavar="NAME=S",
    help="The standard deviation of a torque [N m]; by default from the residuals.",
)
@click.option("--loss", type=click.Choice(LOSSES), default=LOSSES[0], help="huber limits the weight of outliers.")
@click.option(
    "--speed",
    type=NumberType(),
    default=SPEED,
    metavar="V",
    help="The speed that smooths dry friction [rad/s]; by default 0.02.",
)
@click.option("--prior", type=NumberType(), metavar="W", help="Relative deviation of the model's inertias.")
@click.option("--unphysical", is_flag=True, help="Permit masses and inertias that no body can have.")
@click.option(
    "--noise", type=NumberType(), metavar="S", help="The standard deviation of recorded coordinates [rad, m]."
)
@click.option(
    "--cutoff", type=NumberType(), metavar="F", help="The frequency of a low-pass filter, forward and backward [Hz]."
)
@click.option(
    "--gap", type=NumberType(), default=Treatment.gap, metavar="T", help="The longest gap to bridge [s]; 0.1."
)
@click.option("--from", "start", type=NumberType(), metavar="T", help="The first time of each recording [s].")
@click.option("--until", "end", type=NumberType(), metavar="T", help="The last time [s].")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A parameter of the model.")
@choose_format
@accept_robots
@click.pass_context
def identify_command(
    context: click.Context,
    model: Path,
    files: Sequence[Path],
    out: Path | None,
    unknown: Sequence[str],
    fitted: Sequence[str],
    bodies: Sequence[str],
    joints: Sequence[str],
    others: Sequence[Path],
    columns: Sequence[str],
    torques: Sequence[str],
    currents: Sequence[str],
    motors: Sequence[str],
    unmeasured: Sequence[str],
    wrenches: Sequence[str],
    deviations: Sequence[str],
    loss: str,
    speed: float,
    prior: float | None,
    unphysical: bool,
    noise: float | None,
    cutoff: float | None,
    gap: float,
    start: float | None,
    end: float | None,
    parameters: Sequence[str],
) -> None:
    """Read, estimate, write, print."""
    if not (gap >= 0 and (noise is None or noise > 0) and (cutoff is None or cutoff > 0)):
        raise click.UsageError("--noise and --cutoff must be positive, and --gap not negative")
    words = [word.strip() for text in unknown for word in text.split(",")]
    settings = Settings(
        unknown=tuple(dict.fromkeys(words)) or (() if fitted else (INERTIA,)),
        fitted=tuple(dict.fromkeys(fitted)),
        bodies=tuple(bodies),
        joints=tuple(joints),
        treatment=Treatment(noise=noise, gap=gap, cutoff=cutoff),
        columns=split_pairs("column", columns),
        torques=split_pairs("torque", torques),
        currents=split_pairs("current", currents),
        motors=read_numbers("motor", motors),
        unmeasured=tuple(unmeasured),
        loads={name: read_loads(text) for name, text in split_pairs("wrench", wrenches).items()} or None,
        noise=read_numbers("torque-noise", deviations),
        speed=speed,
        loss=loss,
        prior=prior,
        unphysical=unphysical,
        parameters=read_numbers("parameter", parameters),
    )
    with show_progress() as report:
        recordings = [cut(read_recording(file), start, end) for file in files]
        found = identify(model, recordings, settings, torques=[read_recording(file) for file in others], report=report)
    text = write_model(found, model)
    out = out or Path(f"{model.stem}.identified")
    out.mkdir(parents=True, exist_ok=True)
    (out / MODEL).write_text(text, encoding="utf-8")
    write_json(out / SUMMARY, summarise(found))
    plot_residuals(found, out / RESIDUALS)
    plot_numbers(found, out / NUMBERS)
    (out / PAGE).write_text(_write_page(found, out), encoding="utf-8")
    _show(found)
    say(f"wrote {list_written(out, (MODEL, SUMMARY, PAGE, RESIDUALS, NUMBERS))}")
    context.exit(NOT_SOLVED if found.undetermined else 0)


def _show(found: Identification) -> None:
    """Print the base parameters, the residuals, and the numbers that stay open."""
    table = Table(box=None, pad_edge=False)
    for heading in ("base parameter", "value", "deviation", "95 %", "model", "unit"):
        table.add_column(heading, justify="left" if heading in ("base parameter", "unit") else "right")
    for x in found.base:
        found_ones = [f"{x.value:.6g}", f"{x.deviation:.2g}", f"{x.low:.5g} to {x.high:.5g}"]
        numbers = found_ones if x.is_determined else ["", "", ""]
        table.add_row(escape(x.name), *numbers, f"{x.before:.6g}", x.unit)
    print_table(table)
    rests = Table(box=None, pad_edge=False)
    for heading in ("torque", "root mean square", "residual", "before", "left out", "unit"):
        rests.add_column(heading, justify="left" if heading in ("torque", "unit") else "right")
    for y in found.torques:
        rests.add_row(escape(y.joint), *(f"{v:.4g}" for v in (y.size, y.deviation, y.before, y.left_out)), y.unit)
    print_table(rests)
    for line in _list_remarks(found):
        click.echo(line)


def _list_remarks(found: Identification) -> list[str]:
    lines = [f"{found.freedom} rows more than unknowns, condition {found.condition:.3g}"]
    if found.unfelt:
        lines.append(f"no motion determines {', '.join(found.unfelt)}")
    if found.undetermined:
        lines.append(f"these recordings do not determine {', '.join(found.undetermined)}")
    if weak := [x.name for x in found.base if x.is_determined and x.deviation > WEAK * abs(x.value)]:
        lines.append(f"less sure than half their size: {', '.join(weak)}")
    noise = CORRELATED / max(found.freedom / len(found.torques), 1) ** 0.5
    if any(x.correlation > noise for x in found.torques):
        lines.append(
            "residuals are correlated in time, as where the model lacks a force; deviations are widened for it"
        )
    if found.is_moved:
        lines.append(f"bodies that can be built are {found.distance:.2g} standard deviations away from the estimate")
    return lines


def _write_page(found: Identification, out: Path) -> str:
    """Return one page with the tables and the pictures."""
    numbers = sections.Table(
        "Base parameters",
        ("sum", "value", "standard deviation", "from", "to", "model", "unit"),
        tuple(
            (x.name, x.value, x.deviation, x.low, x.high, x.before, x.unit)
            if x.is_determined
            else (x.name, None, None, None, None, x.before, x.unit)
            for x in found.base
        ),
        "m, S and J are mass, first moment and tensor of a body about the origin of its frame; intervals are of 95 %.",
    )
    rests = sections.Table(
        "Residuals",
        ("torque", "root mean square", "residual", "with the model's numbers", "of parts left out", "unit"),
        tuple(
            (x.joint, x.size, x.deviation, x.before, None if x.left_out != x.left_out else x.left_out, x.unit)
            for x in found.torques
        ),
    )
    bodies = sections.Table(
        "Numbers",
        ("number", "value", "model", "unit"),
        tuple((x.name, float(v), x.value, x.unit) for x, v in zip(found.unknowns, found.values, strict=True)),
        "The bodies nearest to the model's that have the sums above and can be built.",
        is_folded=True,
    )
    pictures = [_read_picture(out / name, title) for name, title in ((RESIDUALS, "Torques"), (NUMBERS, "Certainty"))]
    items: tuple[sections.Table | sections.Picture, ...] = (
        numbers,
        rests,
        bodies,
        *(x for x in pictures if x is not None),
    )
    section = sections.Section("identification", "Base parameters", "\n".join(_list_remarks(found)), items)
    names = ", ".join(Path(trace.name).name for trace in found.traces)
    return render_page(f"{found.model}: identification", [f"Recordings: {names}."], [section])


def _read_picture(path: Path, title: str) -> sections.Picture | None:
    """Return a picture as a page shows it; a PDF is left out."""
    from mbsgen.style import in_format

    own = in_format(path)
    kind = sections.KINDS.get(own.suffix)
    return None if kind is None else sections.Picture(title, kind, own.read_bytes())
