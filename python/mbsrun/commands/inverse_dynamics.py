"""`mbsrun inverse-dynamics`: a model and a recorded motion -> the forces that it takes."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.commands.console import choose_format, list_written, say, show_progress
from mbsrun.commands.recorded import GivenMotion, accept_motion, gather_motion, write_json, write_table
from mbsrun.commands.robots import accept_robots
from mbsrun.external import Mechanism
from mbsrun.quantities import Quantity, find_unit, label_forces
from mbsrun.recordings.pictures import Panel, plot_panels
from mbsrun.simulation.inverse import Forces, tabulate
from mbsrun.simulation.muscles import list_muscles
from mbsrun.simulation.recorded import Recalled, analyse

Array = NDArray[np.float64]

FORMAT = "mbsrun inverse dynamics 1"
TABLE, SUMMARY, PICTURE = "forces.csv", "forces.json", "forces.png"

HELP = """Compute the forces that a recorded motion of MODEL takes: inverse dynamics.

Parameters are the ones that the motion was made with, as the file beside it or --parameter gives them.

RECORDING holds coordinates over time: the motion.csv of mbsrun fit-motion, a table of mbsrun simulate or solve, a CSV,
MOT or STO file. Splines of degree 5 give velocities and accelerations; --noise smooths them, --cutoff filters the
samples before:

\b
  mbsrun inverse-dynamics models/recorded/arm.yaml build/swing.fit/motion.csv --noise 2e-3

Recorded forces act as wrenches that the model leaves open (force: input, moment: input). Columns that mbsrun simulate
wrote are found by their names. For others, --wrench gives the beginnings of their names, which end in x, y and z:

\b
  --forces grf.mot --wrench foot=ground_force_v,ground_force_p,ground_torque_

These are the force, the point where it acts, and a free moment, along the axes of the base. With a point, the model
needs a sensor of the wrench's name at its position.

--without-muscles computes the forces that muscles and other actuators give together, as OpenSim's tool does; no
activations are read. Else the recording has the column of each signal.

\b
The output folder gets
  forces.csv    time, coordinates, velocities, accelerations, forces of joints and loops;
                rest[NAME]: the generalised force that no actuator provides
  forces.json   root mean square and largest value of each force
  forces.png    coordinates and forces over time

\b
Exit codes
  0   written
  2   the model, the recording or an argument cannot be accepted; nothing written
"""


@click.command("inverse-dynamics", cls=ModelCommand, help=HELP)
@accept_motion
@click.option(
    "--without-muscles",
    is_flag=True,
    help="Compute the sum of the forces of muscles and other actuators, without activations.",
)
@choose_format
@accept_robots
@gather_motion
def inverse_dynamics_command(given: GivenMotion, out: Path | None, without_muscles: bool) -> None:
    """Read, compute, write, print."""
    opened = given.open("inverse dynamics")
    mechanism, manifest = opened.mechanism, opened.mechanism.manifest
    with show_progress() as report:
        found = analyse(
            opened.recording,
            mechanism,
            given.treatment,
            columns=opened.columns,
            loads=opened.loads,
            load_recording=opened.load_recording,
            without=list_muscles(manifest) if without_muscles else None,
            report=lambda done, total: report("computing forces", done, total),
        )
    out = out or Path(f"{given.file.stem}.forces")
    out.mkdir(parents=True, exist_ok=True)
    header, rows = tabulate(found.forces, mechanism)
    header += label_forces(manifest, "rest", range(len(manifest.coordinates)))
    write_table(out / TABLE, header, np.concatenate((rows, found.forces.rest), axis=1))
    forces = _list_forces(found.forces, manifest)
    write_json(out / SUMMARY, _summarise(found, mechanism, forces))
    _plot(found.forces, manifest, forces, out / PICTURE)
    _print_summary(found, forces)
    say(f"wrote {list_written(out, (TABLE, SUMMARY, PICTURE))}")


def _list_forces(forces: Forces, manifest: Manifest) -> dict[str, Array]:
    """List the forces of joints, and the missing ones, by name."""
    names = [c.name for c in manifest.coordinates]
    found = {f"u[{names[i]}]": forces.u[:, k] for k, i in enumerate(manifest.actuated)}
    found |= {f"tau[{names[i]}]": forces.tau[:, k] for k, i in enumerate(manifest.driven)}
    scale = max((float(np.abs(x).max()) for x in found.values()), default=0.0)
    rests = {f"rest[{name}]": forces.rest[:, i] for i, name in enumerate(names)}
    return found | {name: x for name, x in rests.items() if np.abs(x).max() > 1e-9 * (1 + scale)}


def _summarise(found: Recalled, mechanism: Mechanism, forces: dict[str, Array]) -> dict[str, object]:
    return {
        "format": FORMAT,
        "model": mechanism.manifest.model,
        "model_hash": mechanism.manifest.model_hash,
        "parameters": dict(mechanism.parameters),
        "samples": found.samples,
        "times": len(found.forces.t),
        "gaps_bridged": found.bridged,
        "gaps_left_open": found.left_open,
        "spare": found.forces.spare,
        "forces": {
            name: {"rms": float(np.sqrt(np.mean(x**2))), "least": float(x.min()), "largest": float(x.max())}
            for name, x in forces.items()
        },
    }


def _plot(forces: Forces, manifest: Manifest, named: dict[str, Array], path: Path) -> None:
    """Plot coordinates and forces over time, interrupted where times were left out."""
    coordinates = {name: forces.q[:, i] for i, name in enumerate(manifest.positions)}
    units = [find_unit(Quantity("q", i), manifest) for i in range(len(manifest.positions))]
    own = {f"{kind}[{c.name}]": c.force_unit for c in manifest.coordinates for kind in ("u", "tau", "rest")}
    panels = _split("q", coordinates, dict(zip(manifest.positions, units, strict=True)))
    panels += _split("forces", named, own)
    plot_panels(forces.t, panels, f"{manifest.model}: inverse dynamics", path)


def _split(title: str, lines: dict[str, Array], units: dict[str, str]) -> list[Panel]:
    """Return a panel for each unit."""
    return [
        Panel(f"{title} [{unit}]" if unit else title, {x: y for x, y in lines.items() if units[x] == unit}, {})
        for unit in dict.fromkeys(units[name] for name in lines)
    ]


def _print_summary(found: Recalled, forces: dict[str, Array]) -> None:
    times = found.forces.t
    click.echo(f"{'times':<24}{len(times)} of {found.samples}, from {times[0]:g} to {times[-1]:g} s")
    if found.bridged or found.left_open:
        click.echo(f"{'gaps':<24}{found.bridged} bridged, {found.left_open} left out")
    for name, column in forces.items():
        rms = np.sqrt(np.mean(column**2))
        click.echo(f"{name:<24}{column.min():.6g} to {column.max():.6g}, root mean square {rms:.6g}")
    if found.forces.spare:
        click.echo(f"{found.forces.spare} more forces than degrees of freedom: the ones of least norm are shown")
