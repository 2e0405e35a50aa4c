"""`mbsrun fit-motion`: a model and recorded markers -> the motion of its joints (inverse kinematics)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import Fault, InputError
from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.animation import write_animation
from mbsrun.commands.console import NOT_SOLVED, NumberType, choose_format, list_written, say, show_progress
from mbsrun.commands.recorded import (
    cut,
    read_numbers,
    recording_options,
    set_parameters,
    split_pairs,
    write_json,
    write_storage,
    write_table,
)
from mbsrun.commands.robots import accept_robots
from mbsrun.external import Mechanism, load
from mbsrun.recordings import AXES, Recording, find_column, name_coordinate, read_column, read_recording
from mbsrun.recordings.fitting import FITTED, Fit, Fitter, Targets
from mbsrun.recordings.pictures import Panel, plot_panels
from mbsrun.smoothness import demand_smooth

Array = NDArray[np.float64]

FORMAT = "mbsrun fit 1"
TABLE, SUMMARY, PICTURE, ANIMATION = "motion.csv", "motion.json", "motion.png", "animation.html"
STORAGE = "motion.mot"

FIT_HELP = """Fit the motion of MODEL to recorded markers: inverse kinematics.

RECORDING is a file of positions over time: TRC, or CSV with columns such as x[hand], y[hand], z[hand]. A marker belongs
to the sensor (a frame of the model) of its name, or of --marker. Each frame is fitted by least squares, within the
limits of the coordinates and with loops closed:

\b
  mbsrun fit-motion models/recorded/arm.yaml models/recorded/swing.trc -o build/swing.fit

A marker that a frame lacks is left out of its sum. Where the others do not determine a coordinate, its cell in the
table stays empty. With --smooth S, the sum of squared distances [m²] plus S times the sum of squared accelerations
[rad²/s⁴, m²/s⁴] is the least for all frames together, and gaps that are no longer than --gap are filled so.

\b
The output folder gets
  motion.csv       time, coordinates, and for each marker the distance of its sensor [m];
                   mbsrun inverse-dynamics and guesses of mbsrun solve read it
  motion.mot       time and coordinates, as OpenSim has them
  motion.json      root mean square and largest distance by marker, frames that are at fault
  motion.png       coordinates and distances over time
  animation.html   plays the motion in any browser

\b
Exit codes
  0   written, with every coordinate in every frame
  1   written, but a frame did not converge, or leaves coordinates open
  2   the model, the recording or an argument cannot be accepted; nothing written
"""


@click.command("fit-motion", cls=ModelCommand, help=FIT_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("file", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="The folder to write to.")
@click.option("--marker", "markers", multiple=True, metavar="MARKER=SENSOR", help="The sensor of a marker, by name.")
@click.option(
    "--weight",
    "weights",
    multiple=True,
    metavar="MARKER=W",
    help="The weight of a squared distance; by default 1; 0 leaves it out.",
)
@click.option(
    "--coordinate",
    "coordinates",
    multiple=True,
    metavar="NAME=W",
    help="A recorded coordinate to stay near, and the weight of its squared deviation [m²/rad²].",
)
@click.option("--smooth", type=NumberType(), default=0.0, metavar="S", help="The weight of squared accelerations; 0.")
@click.option(
    "--gap", type=NumberType(), default=0.1, metavar="T", help="With --smooth: the longest gap to fill [s]; 0.1."
)
@recording_options
@choose_format
@accept_robots
@click.pass_context
def fit_motion_command(
    context: click.Context,
    /,
    model: Path,
    file: Path,
    out: Path | None,
    markers: Sequence[str],
    weights: Sequence[str],
    coordinates: Sequence[str],
    smooth: float,
    gap: float,
    start: float | None,
    end: float | None,
    parameters: Sequence[str],
) -> None:
    """Read, fit, write, print."""
    if not (smooth >= 0 and gap >= 0):
        raise click.UsageError("--smooth and --gap must not be negative")
    recording = cut(read_recording(file), start, end)
    mechanism = load(model, extent=FITTED)
    demand_smooth(mechanism.manifest, "a fit", stops=False)
    mechanism = mechanism.with_parameters(**set_parameters(mechanism, parameters))
    manifest = mechanism.manifest
    pairs = _pair_markers(recording, manifest, split_pairs("marker", markers, recording.markers))
    numbers = read_numbers("weight", weights, list(pairs))
    pairs = {marker: i for marker, i in pairs.items() if numbers.get(marker, 1.0) != 0}
    targets = _read_targets(
        recording, manifest, pairs, numbers, read_numbers("coordinate", coordinates, manifest.positions)
    )
    with show_progress() as report:
        fit = Fitter(mechanism, targets).fit(smooth, report)
    shown = _blank(fit, smooth, gap)
    out = out or Path(f"{file.stem}.fit")
    out.mkdir(parents=True, exist_ok=True)
    _write(out, mechanism, fit, shown, list(pairs), smooth)
    _print_summary(fit, shown, list(pairs), manifest)
    say(f"wrote {list_written(out, (TABLE, STORAGE, SUMMARY, PICTURE, ANIMATION))}")
    context.exit(NOT_SOLVED if not fit.converged.all() or np.isnan(shown).any() else 0)


def _pair_markers(recording: Recording, manifest: Manifest, named: Mapping[str, str]) -> dict[str, int]:
    """Return the sensor of each marker: as named, or the one of its name; other markers are left out."""
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    for marker, sensor in named.items():
        if sensor not in sensors:
            told = f"{marker}: the model has no sensor {sensor!r}; there are {', '.join(sensors) or 'none'}"
            raise click.BadParameter(told, param_hint="--marker")
    wanted = {**{name: name for name in recording.markers if name in sensors}, **named}
    if not wanted:
        found = ", ".join(recording.markers[:8]) or "none"
        finding = f"no marker has the name of a sensor: markers are {found}, sensors are {', '.join(sensors) or 'none'}"
        raise InputError([Fault(recording.file, 0, "", finding, "name pairs by --marker MARKER=SENSOR")])
    left = [name for name in recording.markers if name not in wanted]
    if left:
        say(f"left out, since no sensor has their names: {', '.join(left[:8])}{', ...' if left[8:] else ''}")
    return {marker: sensors.index(sensor) for marker, sensor in wanted.items()}


def _read_targets(
    recording: Recording,
    manifest: Manifest,
    pairs: Mapping[str, int],
    weights: Mapping[str, float],
    coordinates: Mapping[str, float],
) -> Targets:
    """Read markers and coordinates with their weights."""
    if any(not 0 <= weight < np.inf for weight in (*weights.values(), *coordinates.values())):
        raise click.UsageError("weights must not be negative")
    units = {c.name: c.unit for c in manifest.coordinates}
    places = [[read_column(recording, f"{axis}[{marker}]", "m") for axis in AXES] for marker in pairs]
    values = [
        read_column(recording, find_column(recording, name_coordinate(name)) or name, units.get(name, ""))
        for name in coordinates
    ]
    K = len(recording.times)
    return Targets(
        times=recording.times,
        sensors=tuple(pairs.values()),
        markers=np.array(places).reshape(-1, 3, K).transpose(2, 0, 1),
        marker_weights=np.array([weights.get(marker, 1.0) for marker in pairs]),
        coordinates=tuple(manifest.positions.index(name) for name in coordinates),
        values=np.array(values).reshape(-1, K).T,
        value_weights=np.array(list(coordinates.values())),
    )


def _blank(fit: Fit, smooth: float, gap: float) -> Array:
    """Return the poses, NaN where the markers leave them open; smooth ones in short gaps are kept."""
    shown = fit.q.copy()
    for i, column in enumerate(fit.is_undetermined.T):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], column, [False])).astype(int)))
        for first, after in edges.reshape(-1, 2):
            is_inside = first > 0 and after < len(column)
            if not (smooth > 0 and is_inside and fit.times[after] - fit.times[first - 1] <= gap * (1 + 1e-9)):
                shown[first:after, i] = np.nan
    return shown


def _write(out: Path, mechanism: Mechanism, fit: Fit, shown: Array, markers: Sequence[str], smooth: float) -> None:
    manifest = mechanism.manifest
    units = {c.name: c.unit for c in manifest.coordinates}
    header = ["t [s]", *(f"q[{name}] [{units.get(name, '-')}]" for name in manifest.positions)]
    header += [f"error[{marker}] [m]" for marker in markers]
    write_table(out / TABLE, header, np.concatenate((fit.times[:, None], shown, fit.errors), axis=1))
    write_storage(out / STORAGE, manifest.positions, fit.times, shown)
    write_json(out / SUMMARY, _summarise(fit, shown, mechanism, markers, smooth))
    panels = [
        Panel(
            unit, {name: shown[:, i] for i, name in enumerate(manifest.positions) if units.get(name, "-") == unit}, {}
        )
        for unit in dict.fromkeys(units.get(name, "-") for name in manifest.positions)
    ]
    panels.append(Panel("distance [mm]", {name: 1e3 * fit.errors[:, i] for i, name in enumerate(markers)}, {}))
    plot_panels(fit.times, panels, f"{manifest.model}: fitted motion", out / PICTURE)
    write_animation(out / ANIMATION, mechanism, fit.times, fit.q, title=f"{manifest.model}: fitted motion")


def _summarise(
    fit: Fit, shown: Array, mechanism: Mechanism, markers: Sequence[str], smooth: float
) -> dict[str, object]:
    manifest = mechanism.manifest
    return {
        "format": FORMAT,
        "model": manifest.model,
        "model_hash": manifest.model_hash,
        "parameters": dict(mechanism.parameters),
        "frames": len(fit.times),
        "smooth": smooth,
        "rms": _measure(fit.errors),
        "markers": {name: _describe(fit, i) for i, name in enumerate(markers)},
        "not_converged": fit.times[~fit.converged].tolist(),
        "open": {
            name: int(np.isnan(shown[:, i]).sum())
            for i, name in enumerate(manifest.positions)
            if np.isnan(shown[:, i]).any()
        },
        "at_limits": {name: int(n) for name, n in zip(manifest.positions, fit.at_limits.sum(axis=0), strict=True) if n},
    }


def _measure(errors: Array) -> float | None:
    """Return the root mean square of the distances that are known."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _describe(fit: Fit, i: int) -> dict[str, object]:
    errors = fit.errors[:, i]
    known = np.isfinite(errors)
    worst = int(np.nanargmax(errors)) if known.any() else None
    return {
        "frames": int(known.sum()),
        "rms": _measure(errors),
        "largest": None if worst is None else float(errors[worst]),
        "at": None if worst is None else float(fit.times[worst]),
    }


def _print_summary(fit: Fit, shown: Array, markers: Sequence[str], manifest: Manifest) -> None:
    K = len(fit.times)
    click.echo(f"{'frames':<16}{K}, from {fit.times[0]:g} to {fit.times[-1]:g} s; {fit.iterations} iterations")
    total = _measure(fit.errors)
    if total is not None:
        click.echo(f"{'distance':<16}{1e3 * total:.4g} mm, root mean square")
    for i, name in enumerate(markers):
        known = fit.errors[:, i][np.isfinite(fit.errors[:, i])]
        told = (
            "in no frame"
            if not known.size
            else f"{1e3 * np.sqrt(np.mean(known**2)):.4g} mm, {1e3 * known.max():.4g} mm at most"
        )
        missing = f"; missing in {K - known.size} frames" if known.size < K else ""
        click.echo(f"  {name:<14}{told}{missing}")
    for i, name in enumerate(manifest.positions):
        if fit.at_limits[:, i].any():
            say(f"warning: {name} is at a limit in {int(fit.at_limits[:, i].sum())} of {K} frames")
        if np.isnan(shown[:, i]).any():
            say(f"warning: in {int(np.isnan(shown[:, i]).sum())} of {K} frames, the markers do not determine {name}")
    if not fit.converged.all():
        times = ", ".join(f"{t:g}" for t in fit.times[~fit.converged][:5])
        say(f"warning: {int((~fit.converged).sum())} of {K} frames did not converge, such as t = {times} s")
