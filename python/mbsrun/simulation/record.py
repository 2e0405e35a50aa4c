"""The folder of a simulated motion: every number, the plots, and the page that plays it.

The same motion writes the same files, except for the time of the run. Names of the model are in the files, not in their
names.
"""

from __future__ import annotations

import csv
import io
import json
import math
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
from mbsrun.curves import Curve, Panel, draw_curves, plain, plot
from mbsrun.external import Mechanism
from mbsrun.kernel import Kernels
from mbsrun.quantities import Quantity, find_unit, label_forces, label_motion, label_multipliers, list_input_units
from mbsrun.quaternions import find_rates
from mbsrun.simulation.integration.methods import METHODS
from mbsrun.simulation.motion import ClosureRecord, Impacts, Keeping, Kind, Mode, Motion, Settings

Array = NDArray[np.float64]

FORMAT = "mbsrun simulation 1"
SUMMARY, TRAJECTORY, PLOTS, ANIMATION = "simulation.json", "trajectory.csv", "plots.png", "animation.html"
FILES = (SUMMARY, TRAJECTORY, PLOTS, ANIMATION)
COLORS = PALETTE


def write_motion(motion: Motion, kernels: Mechanism, folder: Path, columns: Sequence[str] = ()) -> None:
    """Write the folder of a motion; files of these names are replaced.

    `columns` are further columns of the table, by names or patterns. Raises UnknownNameError for one without a number.
    """
    chosen = motion.numbers.select(columns) if columns else ()
    manifest = kernels.manifest
    table = _tabulate(motion, manifest, chosen)  # it may fail
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SUMMARY).write_text(_summarise(motion, kernels), encoding="utf-8")
    (folder / TRAJECTORY).write_text(table, encoding="utf-8")
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
    if settings.impacts is not Impacts.NEWTON:
        found["impacts"] = settings.impacts.value
    if settings.latches:
        found["latches"] = {
            x.name: [[a, b if math.isfinite(b) else None] for a, b in x.times] for x in settings.latches
        }
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
            **({} if energy.friction is None else {"friction": float(energy.friction[-1])}),
            **({} if energy.impacts is None else {"impacts": float(energy.impacts[-1])}),
        },
        **_summarise_events(motion),
        **({} if motion.closure is None else {"closure": _summarise_closure(motion.closure, manifest)}),
        "end": {"t": float(motion.t[-1]), "q": motion.q[-1].tolist(), "qd": motion.qd[-1].tolist()},
    }
    return json.dumps(summary, indent=1, ensure_ascii=False) + "\n"


def _list_switching(manifest: Manifest) -> list[int]:
    return [i for i, c in enumerate(manifest.coordinates) if not c.is_smooth]


def _summarise_events(motion: Motion) -> dict[str, object]:
    """List the events, and the numbers of modes in the table, of a model whose joints switch."""
    if motion.modes is None:
        return {}
    events = [
        {"t": x.time, "joint": x.joint, "event": x.kind.value, "before": x.before, "after": x.after}
        for x in motion.events
    ]
    return {"modes": {mode.name.lower(): int(mode) for mode in Mode}, "events": events}


def _summarise_closure(closure: ClosureRecord, manifest: Manifest) -> dict[str, object]:
    position, velocity = closure.most
    return {
        "loops": [loop.name for loop in manifest.loops],
        "driven": [manifest.coordinates[i].name for i in manifest.driven],
        "largest_position": position,
        "largest_velocity": velocity,
    }


def _tabulate(motion: Motion, manifest: Manifest, more: Sequence[str]) -> str:
    """Write a line for each time, with every digit; names are bracketed, so that no cell begins like a formula."""
    names = [c.name for c in manifest.coordinates]
    header = ["t [s]", *label_motion(manifest, rates=1)]
    given = zip(manifest.inputs, list_input_units(manifest), strict=True)
    header += [f"input[{name}]" + (f" [{unit}]" if unit else "") for name, unit in given]
    columns = [motion.t[:, None], motion.q, motion.qd, motion.inputs]
    if motion.energy is not None:
        header += ["kinetic [J]", "potential [J]", "work [J]"]
        columns += [x[:, None] for x in (motion.energy.kinetic, motion.energy.potential, motion.energy.work)]
        if motion.energy.friction is not None and motion.energy.impacts is not None:
            header += ["friction [J]", "impacts [J]"]
            columns += [motion.energy.friction[:, None], motion.energy.impacts[:, None]]
    if motion.closure is not None:
        closure = motion.closure
        header += ["open", "opening", *label_multipliers(manifest)]
        header += label_forces(manifest, "tau", manifest.driven)
        columns += [closure.position[:, None], closure.velocity[:, None], closure.multipliers, closure.driving]
    if motion.modes is not None:
        switching = _list_switching(manifest)
        header += [f"mode[{names[i]}]" for i in switching]
        columns.append(motion.modes[:, switching].astype(np.float64))
    header += map(motion.numbers.label, more)
    columns += [motion[name][:, None] for name in more]
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
    """Plot coordinates, velocities and inputs over time, a panel for each unit; then energies and their drift."""
    joints, t = manifest.coordinates, motion.t
    units = [find_unit(Quantity("q", i), manifest) for i in range(len(manifest.positions))]
    shown = [("coordinates", "q", name, *x) for name, *x in zip(manifest.positions, units, motion.q.T, strict=True)]
    names, speeds = [c.name for c in joints], [f"{c.unit}/s" for c in joints]
    shown += [("velocities", r"\dot{q}", name, *x) for name, *x in zip(names, speeds, motion.qd.T, strict=True)]
    given = zip(manifest.inputs, list_input_units(manifest), motion.inputs.T, strict=True)
    shown += [("inputs", "", name, *x) for name, *x in given]
    places = {name: k for own in (manifest.positions, manifest.inputs) for k, name in enumerate(own)}
    places |= {name: k for k, name in enumerate(names)}
    curves = [
        Curve(Panel(title, symbol, unit), name, plot(t, values, color=COLORS[places[name] % len(COLORS)]))
        for title, symbol, name, unit, values in shown
    ]
    strips = int(motion.modes is not None and bool(manifest.switching))
    figure, axes = draw_curves(curves, (float(t[0]), float(t[-1]) or 1.0), more=2 + strips)
    _plot_energy(axes[-2], motion)
    _plot_drift(axes[-1], motion)
    if motion.modes is not None and manifest.switching:
        _plot_modes(axes[0], motion, motion.modes, _list_switching(manifest), manifest)
    figure.suptitle(plain(manifest.model) + ("" if motion.halt is None else f": incomplete\n{plain(str(motion.halt))}"))
    return figure


def _plot_modes(axes: Axes, motion: Motion, modes: NDArray[np.int_], joints: Sequence[int], manifest: Manifest) -> None:
    """Plot a strip for each joint, coloured by its mode, with a mark at each impact."""
    t, names = motion.t, [manifest.coordinates[i].name for i in joints]
    edges = np.concatenate((t, t[-1:]))
    for row, i in enumerate(joints):
        starts = np.flatnonzero(np.diff(modes[:, i], prepend=modes[0, i] + 1))
        ends = np.append(starts[1:], len(t))
        for text, color in _MODE_COLORS.items():
            spans = [
                (edges[a], edges[b] - edges[a])
                for a, b in zip(starts, ends, strict=True)
                if _MODE_NAMES[Mode(int(modes[a, i]))] == text
            ]
            axes.broken_barh(spans, (row - 0.4, 0.8), facecolors=color, label=text if row == 0 else None)
    hits = [x for x in motion.events if x.kind is Kind.IMPACT]
    axes.plot(
        [x.time for x in hits], [names.index(x.joint) for x in hits], "|", color="black", markersize=8, label="impact"
    )
    axes.set_title("modes", loc="left", fontsize="medium")
    axes.set_yticks(range(len(names)), [plain(name) for name in names])
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


_MODE_NAMES = {
    Mode.FREE: "moves freely",
    Mode.FORWARD: "slides",
    Mode.BACKWARD: "slides",
    Mode.STICKS: "sticks",
    Mode.LOWER: "rests on a stop",
    Mode.UPPER: "rests on a stop",
}
_MODE_COLORS = dict(zip(dict.fromkeys(_MODE_NAMES.values()), ("#e8e8e8", *PALETTE), strict=False))


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
    is_lossless = energy.friction is None or energy.impacts is None
    text = "start + work" if is_lossless else "start + work − losses"
    axes.plot(motion.t, energy.total - energy.drift, "--", label=text, color=BAD)
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
