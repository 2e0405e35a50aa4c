"""`mbsrun scale`: settings of a subject -> its model: a scaled model file, with tables and a picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from mbsrun.commands.console import NOT_SOLVED, choose_format, list_written, say
from mbsrun.commands.recorded import write_json, write_storage
from mbsrun.subjects import Fitted, fit_subject, plot_subject

FORMAT = "mbsrun scaling 1"
FACTORS, DISTANCES, MARKERS = "factors.csv", "distances.csv", "markers.csv"
POSE, SUMMARY, PICTURE = "pose.mot", "scaling.json", "scaling.png"

HELP = """Fit a model to a subject: by distances of markers, by factors, or by a table of segments.

SUBJECT is a file of settings in YAML, or the setup of OpenSim's ScaleTool, whose parts are taken as far as they have
counterparts. It names the model, of OpenSim or in YAML, and recordings of markers, all relative to itself:

\b
  mbsrun scale models/subjects/leg.subject.yaml -o build/subject

Bodies are stretched along their axes by factors, muscles' fibres and tendons as their lines, inertias with the bodies.
Then the pose is fitted to the recorded markers, and markers move to their places on the subject.

\b
The output folder gets
  scaled.osim      the scaled model, or scaled.yaml
  factors.csv      factors and masses of bodies
  distances.csv    pairs of markers in the model and on the subject [m]
  markers.csv      distance of each marker from the subject's, before and after it moves [m]
  pose.mot         the pose that fits best, as OpenSim has it
  scaling.json     all of these
  scaling.png      factors, and errors of markers

\b
Exit codes
  0   written
  1   written, but the pose did not converge, or markers leave coordinates open
  2   a file cannot be accepted; nothing written
"""


@click.command("scale", help=HELP)
@click.argument("subject", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="The folder to write to.")
@choose_format
@click.pass_context
def scale_command(context: click.Context, /, subject: Path, out: Path | None) -> None:
    """Read, scale, write, print."""
    out = out or Path(f"{subject.name.split('.')[0]}.scaled")
    found = fit_subject(subject)
    out.mkdir(parents=True, exist_ok=True)
    file = f"scaled{found.scaled.suffix}"
    (out / file).write_text(found.scaled.text, encoding="utf-8")
    _write_tables(found, out)
    write_storage(out / POSE, [*found.pose], np.zeros(1), np.array([[*found.pose.values()]]))
    write_json(out / SUMMARY, _summarise(found))
    plot_subject(found, f"{subject.name}: scaling", out / PICTURE)
    for notice in found.notices:
        say(notice)
    _print_summary(found)
    say(f"wrote {list_written(out, (file, FACTORS, DISTANCES, MARKERS, POSE, SUMMARY, PICTURE))}")
    if not found.converged:
        say("warning: the pose did not converge")
    if found.undetermined:
        say(f"warning: the markers do not determine {', '.join(found.undetermined)}")
    context.exit(NOT_SOLVED if found.undetermined or not found.converged else 0)


def _write_tables(found: Fitted, out: Path) -> None:
    scaled = found.scaled
    rows = [(x.body, *scaled.factors[x.body], x.before, x.after) for x in scaled.weights]
    _write(out / FACTORS, ("body", "x", "y", "z", "mass before [kg]", "mass [kg]"), rows)
    pairs = [(x.measurement, *x.markers, x.model, x.subject, x.subject / x.model) for x in scaled.distances]
    _write(out / DISTANCES, ("measurement", "marker", "marker", "model [m]", "subject [m]", "ratio"), pairs)
    markers = [(x.name, x.weight, x.error, x.left) for x in found.markers]
    _write(out / MARKERS, ("marker", "weight", "error before [m]", "error [m]"), markers)


def _write(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([header, *rows])


def _summarise(found: Fitted) -> dict[str, object]:
    scaled = found.scaled
    return {
        "format": FORMAT,
        "factors": {name: list(x) for name, x in scaled.factors.items()},
        "masses": {x.body: x.after for x in scaled.weights},
        "lines": dict(scaled.lines),
        "distances": [
            {"measurement": x.measurement, "markers": list(x.markers), "model": x.model, "subject": x.subject}
            for x in scaled.distances
        ],
        "markers": {x.name: {"weight": x.weight, "error": x.error, "left": x.left} for x in found.markers},
        "pose": dict(found.pose),
        "converged": found.converged,
        "undetermined": list(found.undetermined),
    }


def _print_summary(found: Fitted) -> None:
    scaled = found.scaled
    before, after = (sum(getattr(x, key) for x in scaled.weights) for key in ("before", "after"))
    click.echo(f"{'mass':<16}{before:.6g} to {after:.6g} kg")
    for x in scaled.weights:
        factors = " ".join(f"{f:.4f}" for f in scaled.factors[x.body])
        click.echo(f"  {x.body:<14}{factors}   {x.before:.4g} to {x.after:.4g} kg")
    if found.markers:
        used = np.array([x.error for x in found.markers if x.weight])
        rms = f"{1e3 * np.sqrt(np.mean(used**2)):.4g}" if used.size else "-"
        click.echo(f"{'markers':<16}{rms} mm before they move, root mean square of {used.size}")
    for name, ratio in scaled.lines.items():
        click.echo(f"  {name:<14}{ratio:.4f} of its length")
