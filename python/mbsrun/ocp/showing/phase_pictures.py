"""Pictures of a solution in phases: trajectories side by side, all poses in one drawing, and animations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from mbsgen.style import styled
from mbsrun.animation import render_parts
from mbsrun.curves import fill, list_panels, plain
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.showing.pictures import (
    TIME,
    choose_colors,
    draw_poses,
    frame_up,
    list_curves,
    list_points,
    make_part,
)
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.skeleton import place

NARROWEST = 0.15  # the width of a short phase's panels, relative to the longest one's
POSES = 5  # of each phase


@styled
def make_phased_trajectories(solution: PhasedSolution, phases: Sequence[Solution], plants: Plants) -> Figure:
    """Plot coordinates, velocities, inputs, and what phases add over time: a column for each phase."""
    manifests = [plant.manifest for plant in plants.phases]
    colors, longest = choose_colors(manifests), max(solution.durations)
    curves = [list_curves(phase, manifest, colors) for phase, manifest in zip(phases, manifests, strict=True)]
    rows = list_panels(curve for own in curves for curve in own)
    figure = Figure(figsize=(4 + 3 * len(phases), max(2.6 * len(rows), 3)), layout="constrained")
    panels = figure.subplots(
        max(len(rows), 1),
        len(phases),
        sharex="col",
        sharey="row",
        squeeze=False,
        width_ratios=[max(duration / longest, NARROWEST) for duration in solution.durations],
    )
    for name, phase, own, column in zip(solution.names, phases, curves, panels.T, strict=True):
        fill(column[: len(rows)], rows, own)
        column[0].set_title(plain(name))
        column[-1].set_xlabel("time [s]")
        column[-1].set_xlim(phase.trajectory.t[0], phase.trajectory.t[-1])
    for axes in panels[:, 1:].ravel():
        axes.set_ylabel("")
        axes.set_title("", loc="left")
    handles = {
        text: handle for axes in panels.ravel() for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(_title(solution))
    return figure


@styled
def make_phased_mechanism(solution: PhasedSolution, phases: Sequence[Solution], plants: Plants) -> Figure:
    """Draw the mechanisms of all phases on their way."""
    figure = Figure(figsize=(8, 7), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    times = Normalize(0, max(float(phase.trajectory.t[-1]) for phase in phases))
    points = []
    for phase, plant in zip(phases, plants.phases, strict=True):
        skeleton = place(_equip(phase, plant), phase.trajectory.q)
        draw_poses(axes, skeleton, phase.trajectory.t, times, POSES)
        points.append(list_points(skeleton.p))
    axes.plot(0, 0, 0, "s", color="black", markersize=7, label="base")
    frame_up(axes, np.concatenate(points))
    figure.colorbar(ScalarMappable(times, TIME), ax=axes, label="time [s]", shrink=0.6, pad=0.1)
    figure.suptitle(_title(solution))
    return figure


def write_animations(
    solution: PhasedSolution, phases: Sequence[Solution], plants: Plants, folder: Path
) -> tuple[str, ...]:
    """Write the pages of `make_animations`, and name them."""
    pages = make_animations(solution, phases, plants)
    for name, text in pages.items():
        (folder / name).write_text(text, encoding="utf-8")
    return tuple(pages)


def make_animations(solution: PhasedSolution, phases: Sequence[Solution], plants: Plants) -> dict[str, str]:
    """Return a page that plays all phases, or one for each where they do not follow each other, by their names."""
    named = zip(solution.names, phases, plants.phases, strict=True)
    parts = [make_part(phase, plant, name) for name, phase, plant in named]
    if all(np.isclose(a.t[-1], b.t[0]) for a, b in pairwise(parts)):
        return {"animation.html": render_parts(parts, solution.name)}
    return {
        f"{name}.html": render_parts([part], f"{solution.name}: {name}")
        for name, part in zip(solution.names, parts, strict=True)
    }


def _equip(phase: Solution, plant: Plant) -> Plant:
    return equip(plant, phase.problem, phase.trajectory.unknowns)


def _title(solution: PhasedSolution) -> str:
    return f"{plain(solution.name)}: cost {solution.cost:.6g}"
