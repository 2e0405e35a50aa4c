"""`mbsrun so`: a model with muscles and a recorded motion -> the least activations that the motion takes."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.commands.console import NOT_SOLVED, NumberType, choose_format, list_written, say
from mbsrun.commands.recorded import GivenMotion, accept_motion, gather_motion, write_json, write_table
from mbsrun.commands.robots import accept_robots
from mbsrun.recordings.pictures import Panel, plot_panels
from mbsrun.simulation.muscles import list_muscles
from mbsrun.simulation.recorded import retrace
from mbsrun.simulation.sharing import Shares, share

Array = NDArray[np.float64]

FORMAT = "mbsrun static optimisation 1"
TABLE, SUMMARY, PICTURE = "activations.csv", "activations.json", "activations.png"

HELP = """Find the least activations of the muscles of MODEL that a recorded motion takes: static optimisation.

At each time, the sum of squared activations and of squared reserves is the least, where a reserve of --reserve counts
as much as a full activation. Tendons are rigid. RECORDING, splines and recorded forces are as `mbsrun
inverse-dynamics` takes them:

\b
  mbsrun so build/leg.yaml build/leg.mot --reserve 1

\b
The output folder gets
  activations.csv    time, activations, tensions, reserve[NAME]: the generalised force that muscles do not provide
  activations.json   mean and largest value of each
  activations.png    activations, tensions and reserves over time

\b
Exit codes
  0   written
  1   written, but at some times the search did not end
  2   the model, the recording or an argument cannot be accepted; nothing written
"""


@click.command("so", cls=ModelCommand, help=HELP)
@accept_motion
@click.option(
    "--reserve",
    type=NumberType(),
    default=1.0,
    metavar="F",
    help="The reserve that costs as much as a full activation; by default 1 N m.",
)
@click.option("--least", type=NumberType(), default=0.0, metavar="A", help="The least activation; 0.")
@click.option("--most", type=NumberType(), default=1.0, metavar="A", help="The largest activation; 1.")
@click.option("--no-passive", is_flag=True, help="Leave passive fibres and damping out, as OpenSim's tool does.")
@choose_format
@accept_robots
@gather_motion
def so_command(
    given: GivenMotion, out: Path | None, reserve: float, least: float, most: float, no_passive: bool
) -> None:
    """Read, share, write, print."""
    if not (reserve > 0 and 0 <= least < most):
        raise click.UsageError("--reserve must be positive, and --least 0 or more, and below --most")
    opened = given.open("static optimisation")
    mechanism, manifest = opened.mechanism, opened.mechanism.manifest
    muscles = list_muscles(manifest)
    motion = retrace(
        opened.recording,
        mechanism,
        given.treatment,
        columns=opened.columns,
        loads=opened.loads,
        load_recording=opened.load_recording,
        idle=muscles.signals,
    )
    found = share(mechanism, motion, reserve=reserve, bounds=(least, most), is_passive=not no_passive)
    out = out or Path(f"{given.file.stem}.activations")
    out.mkdir(parents=True, exist_ok=True)
    parts = {
        **{f"activation[{name}]": x for name, x in zip(muscles.names, found.activations.T, strict=True)},
        **{f"tension[{name}]": x for name, x in zip(muscles.names, found.tensions.T, strict=True)},
        **{f"reserve[{name}]": x for name, x in zip(found.coordinates, found.reserves.T, strict=True)},
    }
    write_table(out / TABLE, ["t", *parts], np.column_stack((found.t, *parts.values())))
    write_json(out / SUMMARY, _summarise(manifest, found, parts, reserve))
    _plot(manifest, found.t, parts, out / PICTURE)
    _print_summary(found, parts)
    say(f"wrote {list_written(out, (TABLE, SUMMARY, PICTURE))}")
    if found.unsolved:
        say(f"at {found.unsolved} of {len(found.t)} times the search did not end")
        raise SystemExit(NOT_SOLVED)


def _summarise(manifest: Manifest, found: Shares, parts: dict[str, Array], reserve: float) -> dict[str, object]:
    return {
        "format": FORMAT,
        "model": manifest.model,
        "model_hash": manifest.model_hash,
        "reserve": reserve,
        "times": len(found.t),
        "unsolved": found.unsolved,
        "parts": {
            name: {"mean": float(x.mean()), "rms": float(np.sqrt(np.mean(x**2))), "largest": float(np.abs(x).max())}
            for name, x in parts.items()
        },
    }


def _plot(manifest: Manifest, times: Array, parts: dict[str, Array], path: Path) -> None:
    panels = [
        Panel(label, {name.split("[")[1][:-1]: x for name, x in parts.items() if name.startswith(kind)}, {})
        for kind, label in (
            ("activation", "activations"),
            ("tension", "tensions [N]"),
            ("reserve", "reserves [N m, N]"),
        )
    ]
    plot_panels(times, panels, f"{manifest.model}: static optimisation", path)


def _print_summary(found: Shares, parts: dict[str, Array]) -> None:
    click.echo(f"{'times':<24}{len(found.t)}, from {found.t[0]:g} to {found.t[-1]:g} s")
    for name, x in parts.items():
        if not name.startswith("tension"):
            click.echo(f"{name:<24}{x.min():.4g} to {x.max():.4g}, root mean square {np.sqrt(np.mean(x**2)):.4g}")
