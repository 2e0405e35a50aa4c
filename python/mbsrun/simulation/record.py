"""The folder of a simulated motion: every number, the plots, and the page that plays it.

The same motion writes the same files, except for the time of the run. Names of the model are in the files, not in their
names.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsgen.style import BAD, NEUTRAL, PALETTE, save_plot, styled
from mbsrun.animation import write_animation
from mbsrun.external import Mechanism
from mbsrun.kernel import Kernels
from mbsrun.quaternions import find_rates
from mbsrun.simulation.methods import METHODS
from mbsrun.simulation.motion import ClosureRecord, Keeping, Motion, Settings

Array = NDArray[np.float64]

FORMAT = "mbsrun simulation 1"
SUMMARY, TRAJECTORY, PLOTS, ANIMATION = "simulation.json", "trajectory.csv", "plots.png", "animation.html"
FILES = (SUMMARY, TRAJECTORY, PLOTS, ANIMATION)
COLORS = PALETTE
NAMED = 12  # coordinates that a legend still names


def write_motion(motion: Motion, kernels: Mechanism, folder: Path) -> None:
    """Write the folder of a motion; files of these names are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    manifest = kernels.manifest
    (folder / SUMMARY).write_text(_summarise(motion, kernels), encoding="utf-8")
    (folder / TRAJECTORY).write_text(_tabulate(motion, manifest), encoding="utf-8")
    plot_motion(motion, manifest, folder / PLOTS)
    title = manifest.model if motion.halt is None else f"{manifest.model}, incomplete: {motion.halt}"
    rates = find_rates(kernels, motion.q, motion.qd)
    write_animation(folder / ANIMATION, kernels, motion.t, motion.q, qd=rates, inputs=motion.inputs, title=title)


def describe_settings(settings: Settings) -> dict[str, object]:
    """List the settings that matter to the method."""
    wanted = ["duration", "method", *METHODS[settings.method].settings]
    found = {name: getattr(settings, name) for name in wanted} | {"formulation": settings.formulation.value}
    if settings.loops is not None:
        found["loops"] = settings.loops.value
    if settings.loops is Keeping.BAUMGARTE:
        found |= {"alpha": settings.alpha, "beta": settings.beta}
    return found


def _summarise(motion: Motion, kernels: Kernels) -> str:
    manifest, energy, halt = kernels.manifest, motion.energy, motion.halt
    summary = {
        "format": FORMAT,
        "complete": motion.is_complete,
        "halt": None if halt is None else asdict(halt),
        "warnings": list(motion.warnings),
        "model": manifest.model,
        "model_hash": manifest.model_hash,
        "parameters": dict(kernels.parameters),
        "settings": describe_settings(motion.settings),
        "coordinates": [c.name for c in manifest.coordinates],
        **({"configuration": list(manifest.configuration)} if manifest.configuration else {}),
        "inputs": list(manifest.inputs),
        "effort": asdict(motion.effort),
        "energy": None
        if energy is None
        else {
            "start": float(energy.total[0]),
            "end": float(energy.total[-1]),
            "work": float(energy.work[-1]),
            "largest_drift": float(np.abs(energy.drift).max()),
        },
        **({} if motion.closure is None else {"closure": _summarise_closure(motion.closure, manifest)}),
        "end": {"t": float(motion.t[-1]), "q": motion.q[-1].tolist(), "qd": motion.qd[-1].tolist()},
    }
    return json.dumps(summary, indent=1, ensure_ascii=False) + "\n"


def _summarise_closure(closure: ClosureRecord, manifest: Manifest) -> dict[str, object]:
    position, velocity = closure.most
    return {
        "loops": [loop.name for loop in manifest.loops],
        "driven": [manifest.coordinates[i].name for i in manifest.driven],
        "largest_position": position,
        "largest_velocity": velocity,
    }


def _tabulate(motion: Motion, manifest: Manifest) -> str:
    """Write a line for each time, with every digit; names are bracketed, so that no cell begins like a formula."""
    units, forces = ({c.name: getattr(c, key) for c in manifest.coordinates} for key in ("unit", "force_unit"))
    names = [*units]
    header = ["t [s]", *(f"q[{x}] [{units.get(x, '-')}]" for x in manifest.positions)]  # quaternions have no unit
    header += [f"qd[{name}] [{unit}/s]" for name, unit in units.items()]
    header += [f"input[{x}]" + (f" [{forces[x]}]" if x in forces else "") for x in manifest.inputs]
    columns = [motion.t[:, None], motion.q, motion.qd, motion.inputs]
    if motion.energy is not None:
        header += ["kinetic [J]", "potential [J]", "work [J]"]
        columns += [x[:, None] for x in (motion.energy.kinetic, motion.energy.potential, motion.energy.work)]
    if motion.closure is not None:
        closure = motion.closure
        header += ["open", "opening", *(f"lam[{x}]" for x in manifest.equations)]
        header += [f"tau[{name}] [{forces[name]}]" for name in (names[i] for i in manifest.driven)]
        columns += [closure.position[:, None], closure.velocity[:, None], closure.multipliers, closure.driving]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(np.concatenate(columns, axis=1).tolist())
    return text.getvalue()


def plot_motion(motion: Motion, manifest: Manifest, path: Path) -> None:
    """Write the picture of a motion."""
    figure = draw_motion(motion, manifest)
    save_plot(figure, path)


@styled
def draw_motion(motion: Motion, manifest: Manifest) -> Figure:
    """Plot coordinates, velocities, inputs, energies and their drift over time."""
    rows = 4 + bool(motion.inputs.shape[1])
    figure = Figure(figsize=(8, 2.6 * rows), layout="constrained")
    axes = list(figure.subplots(rows, 1, sharex=True))
    units = dict.fromkeys(c.unit for c in manifest.coordinates)
    _plot(axes[0], motion.t, motion.q, manifest.positions, f"$q$ [{', '.join(units)}]")
    _plot(axes[1], motion.t, motion.qd, (), rf"$\dot{{q}}$ [{', '.join(f'{unit}/s' for unit in units)}]")
    if motion.inputs.shape[1]:
        _plot(axes[2], motion.t, motion.inputs, manifest.inputs, "inputs [N m, N]")
    _plot_energy(axes[-2], motion)
    _plot_drift(axes[-1], motion)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(motion.t[0], motion.t[-1] or 1.0)
    figure.suptitle(
        _plain(manifest.model) + ("" if motion.halt is None else f": incomplete\n{_plain(str(motion.halt))}")
    )
    return figure


def _plot(axes: Axes, t: Array, values: Array, names: Sequence[str], label: str) -> None:
    for i, column in enumerate(values.T):
        axes.plot(t, column, color=COLORS[i % len(COLORS)], label=_plain(names[i]) if names else None)
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
    if names and len(names) <= NAMED:
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


def _plot_energy(axes: Axes, motion: Motion) -> None:
    axes.set_ylabel("energy [J]")
    axes.grid(alpha=0.3)
    energy = motion.energy
    if energy is None:
        _excuse(axes)
        return
    for name, values in (("kinetic", energy.kinetic), ("potential", energy.potential)):
        axes.plot(motion.t, values, label=name, linewidth=1)
    axes.plot(motion.t, energy.total, label="total", color="black")
    axes.plot(motion.t, energy.total[0] + energy.work, "--", label="start + work", color=BAD)
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


def _plot_drift(axes: Axes, motion: Motion) -> None:
    """Plot the drift on a logarithmic scale, between rounding and what is warned of."""
    axes.set_ylabel("|energy drift| [J]")
    axes.grid(alpha=0.3)
    energy = motion.energy
    if energy is None:
        _excuse(axes)
        return
    least = max(energy.rounding, np.finfo(float).tiny)  # 0 has no place on this scale
    axes.semilogy(motion.t, np.maximum(np.abs(energy.drift), least), color="black", label="drift", linewidth=1)
    axes.axhline(max(energy.tolerated, least), linestyle="--", color=BAD, label="warning above")
    axes.axhline(least, linestyle=":", color=NEUTRAL, label="rounding")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


def _excuse(axes: Axes) -> None:
    axes.text(0.5, 0.5, "unknown: it overflows, or a kernel fails on the way", transform=axes.transAxes, ha="center")


def _plain(name: str) -> str:
    """Keep a name of the user's from being read as a formula, or as an instruction to leave it out."""
    return "\u200b" + name.replace("$", r"\$") if name.startswith("_") else name.replace("$", r"\$")
