"""Pictures of a solution: trajectories over time (Docquier, Bruls, Fisette, Fig. 8), and the mechanism on its way."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from mbsgen.manifest import Frame, Manifest
from mbsgen.style import BAD, GOOD, PALETTE, save_plot, styled
from mbsrun.animation import Marker, Motion, Part, Wanted, make_film, write_page
from mbsrun.ocp.design import equip
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Target
from mbsrun.ocp.solution import Rounds, Solution, Starts
from mbsrun.ocp.trajectory import Trajectory
from mbsrun.quantities import name_components
from mbsrun.quaternions import find_rates
from mbsrun.skeleton import Skeleton, place

Array = NDArray[np.float64]

WIDE = 5.0  # ratio of the highest cost to the lowest from which on the axis is logarithmic
SMALLEST = 1e-15  # a defect that is shown
POSES = 9  # of the mechanism, evenly in time
COLORS = PALETTE
TIME = ListedColormap(colormaps["viridis_r"](np.linspace(0.2, 1, 256)))  # without its pale end


def plot_trajectories(solution: Solution, manifest: Manifest, path: Path) -> None:
    """Plot coordinates, velocities and inputs over time, and write the picture."""
    save(make_trajectories(solution, manifest), path)


@styled
def make_trajectories(solution: Solution, manifest: Manifest) -> Figure:
    """Plot coordinates, velocities and inputs over time."""
    t = read_times(solution.trajectory)
    added = bool(solution.problem.every_state or solution.problem.controls or solution.trajectory.point_w.any())
    if not manifest.coordinates:
        figure = Figure(figsize=(8, 5), layout="constrained")
        axes = figure.subplots()
        plot_additions(axes, solution, t)
        _plot_wrenches(axes, solution, manifest)
        axes.set_xlabel("time [s]")
        axes.legend(frameon=False)
        figure.suptitle(write_title(solution))
        return figure
    rows = 2 + bool(manifest.actuated or manifest.driven) + added
    figure = Figure(figsize=(8, 3 * rows), layout="constrained")
    panels = list(figure.subplots(rows, 1, sharex=True))
    if added:
        plot_additions(panels[-1], solution, t)
        _plot_wrenches(panels[-1], solution, manifest)
    draw_motion(panels, solution, manifest, choose_colors([manifest]))
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0, solution.trajectory.t[-1])
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(write_title(solution))
    return figure


def choose_colors(manifests: Iterable[Manifest]) -> dict[str, str]:
    """Choose a color for each coordinate and velocity, by name: q has other names where there are quaternions."""
    every = dict.fromkeys(name for m in manifests for name in (*m.positions, *(c.name for c in m.coordinates)))
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(every)}


def read_times(trajectory: Trajectory) -> Array:
    """Return the times of all points that are plotted: where each interval begins, and its collocation points."""
    return np.concatenate((trajectory.t[:-1, None], trajectory.point_t), axis=1).ravel()


def draw_motion(panels: Sequence[Axes], solution: Solution, manifest: Manifest, colors: Mapping[str, str]) -> None:
    """Plot coordinates, velocities and, if there are any, inputs with forces of driven joints, each in its panel."""
    trajectory, t = solution.trajectory, read_times(solution.trajectory)
    q, qd = (
        np.concatenate((mesh[:-1, None], points), axis=1).reshape(len(t), -1)
        for mesh, points in ((trajectory.q, trajectory.point_q), (trajectory.qd, trajectory.point_qd))
    )
    coordinates, velocities = panels[:2]
    names = [c.name for c in manifest.coordinates]
    driven = [manifest.coordinates[i] for i in manifest.driven]
    kinds = {c.name: "" if c.actuated else " (driven)" if c in driven else " (passive)" for c in manifest.coordinates}
    labels = {c.name: plain(c.name) + kinds[c.name] for c in manifest.coordinates}
    lines = {c.name: "-" if c.actuated else "--" for c in manifest.coordinates}
    for i, name in enumerate(manifest.positions):
        own, line = labels.get(name, plain(name)), lines.get(name, "-")
        coordinates.plot(t, q[:, i], label=own, color=colors[name], linestyle=line)
    for i, name in enumerate(names):
        label = None if name in manifest.positions else labels[name]
        velocities.plot(t, qd[:, i], label=label, color=colors[name], linestyle=lines[name])
    actuated = [manifest.coordinates[i] for i in manifest.actuated]
    for k, c in enumerate(actuated):
        points = trajectory.point_u[:, :, k : k + 1]
        _plot_input(panels[2], trajectory, trajectory.u[:, k], points, color=colors[c.name])
    if solution.driving is not None:
        for k, c in enumerate(driven):
            panels[2].plot(trajectory.point_t.ravel(), solution.driving[:, :, k].ravel(), "--", color=colors[c.name])
    _name(coordinates, "Joint coordinates", "q", _join(c.unit for c in manifest.coordinates))
    _name(velocities, "Joint velocities", r"\dot{q}", _join(f"{c.unit}/s" for c in manifest.coordinates))
    if actuated or driven:
        title, symbol = ("Inputs, and forces of driven joints dashed", r"u, \tau") if driven else ("Inputs", "u")
        _name(panels[2], title, symbol, _join(c.force_unit for c in (*actuated, *driven)))


@styled
def plot_curves(t: Array, curves: Mapping[str, Array]) -> Figure:
    """Plot numbers over time by their names, all in one picture."""
    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.subplots()
    for name, values in curves.items():
        axes.plot(t, values, label=plain(name))
    axes.set_xlabel("time [s]")
    axes.set_xlim(t[0], t[-1])
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def plot_additions(axes: Axes, solution: Solution, t: Array) -> None:
    """Plot the states and controls that the problem adds, at times t."""
    trajectory, problem = solution.trajectory, solution.problem
    states = np.concatenate((trajectory.states[:-1, None], trajectory.point_states), axis=1).reshape(len(t), -1)
    names = [*(state.name for state in problem.states), *(part.expression for part in problem.integrals)]
    for name, values in zip(names, states.T, strict=True):
        axes.plot(t, values, label=plain(name))
    for k, control in enumerate(problem.controls):
        points = trajectory.point_controls[:, :, k : k + 1]
        name = f"slack of {control.softens}" if control.softens else control.name
        _plot_input(axes, trajectory, trajectory.controls[:, k], points, linestyle="--", label=plain(name))
    axes.set_title("Further states, open wrenches dotted, controls dashed", loc="left", fontsize="medium")
    axes.grid(alpha=0.3)


def _plot_wrenches(axes: Axes, solution: Solution, manifest: Manifest) -> None:
    """Plot the components of open wrenches that are not 0."""
    trajectory = solution.trajectory
    forces = trajectory.point_w.reshape(trajectory.point_t.size, trajectory.point_w.shape[2])
    for component, values in zip(name_components(manifest), forces.T, strict=True):
        if values.any():
            axes.plot(trajectory.point_t.ravel(), values, linestyle=":", label=plain(component or "wrench"))


def _plot_input(axes: Axes, trajectory: Trajectory, values: Array, points: Array, **style: Any) -> None:
    """Plot an input: constant values (N,) of the intervals, or values (N, d, 1) at the points of polynomials."""
    if points.size:
        axes.plot(trajectory.point_t.ravel(), points.ravel(), linewidth=1.5, **style)
    else:
        axes.stairs(values, trajectory.t, baseline=None, linewidth=1.5, **style)


@styled
def plot_starts(starts: Starts, path: Path) -> None:
    """Plot the cost that each start found, the lowest first, by kind of start, and write the picture."""
    solved = sorted((start for start in starts.results if start.cost is not None), key=lambda start: start.cost or 0.0)
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    for k, kind in enumerate(dict.fromkeys(start.kind for start in starts.results)):
        own = [(rank, start.cost or 0.0) for rank, start in enumerate(solved, 1) if start.kind == kind]
        axes.plot(*zip(*own, strict=True) if own else ([], []), "o", color=COLORS[k], label=f"{kind} ({len(own)})")
    costs = [start.cost or 0.0 for start in solved]
    if solved:
        axes.axhline(costs[0], color="0.6", linewidth=1, zorder=0)
    if solved and costs[0] > 0 and costs[-1] > WIDE * costs[0]:
        axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("start, by cost")
    axes.set_ylabel("cost")
    axes.legend(title="kind of start (solved)", frameon=False)
    failed = len(starts.results) - len(solved)
    axes.set_title(
        f"lowest cost found {starts.times} times in {len(starts.results)} starts; {failed} without a solution"
    )
    save(figure, path)


def plot_mesh(refinement: Rounds, path: Path) -> None:
    """Plot the defect of every interval over time, round by round, and write the picture."""
    save(make_mesh(refinement), path)


@styled
def make_mesh(refinement: Rounds) -> Figure:
    """Plot the defect of every interval over time, round by round."""
    rounds = [each for each in refinement.rounds if each.defects]
    figure = Figure(figsize=(8, 1.2 + 1.3 * max(len(rounds), 1)), layout="constrained")
    panels = figure.subplots(max(len(rounds), 1), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for k, (axes, each) in enumerate(zip(panels, rounds, strict=False)):
        t, defects = np.array(each.times), np.maximum(each.defects, SMALLEST)
        is_accurate = defects <= refinement.accuracy
        for chosen, color in ((is_accurate, GOOD), (~is_accurate, BAD)):
            axes.bar(t[:-1][chosen], defects[chosen], np.diff(t)[chosen], align="edge", color=color, alpha=0.5)
        axes.plot(t, np.full(t.size, SMALLEST), "|", color="black", markersize=8, clip_on=False)
        axes.axhline(refinement.accuracy, color="black", linewidth=0.8, linestyle="--")
        axes.set_yscale("log")
        axes.set_ylim(bottom=SMALLEST)
        axes.set_title(f"round {k}: {len(t) - 1} intervals, degree {each.degree}", loc="left", fontsize="small")
    panels[-1].set_xlabel("time [s]")
    figure.supylabel("defect of an interval", fontsize="medium")
    return figure


def draw_mechanism(solution: Solution, plant: Plant, path: Path) -> None:
    """Draw the mechanism at several times, with the paths and targets of its sensors, and write the picture."""
    save(make_mechanism(solution, plant), path)


@styled
def make_mechanism(solution: Solution, plant: Plant) -> Figure:
    """Draw the mechanism at several times, with the paths and targets of its sensors."""
    trajectory = solution.trajectory
    plant = equip(plant, solution.problem, trajectory.unknowns)
    skeleton = place(plant, trajectory.q)
    frames, p = skeleton.frames, skeleton.p
    figure = Figure(figsize=(8, 7), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    times = Normalize(0, solution.trajectory.t[-1])
    draw_poses(axes, skeleton, trajectory.t, times)
    targets = {marker.name: marker.position for marker in list_targets(solution, plant)}
    for i, frame in enumerate(frames):
        target = targets.get(f"target of {frame.name}")
        if frame.sensor and target:
            name = plain(frame.name)
            axes.plot(*p[:, :, i].T, color=BAD, linewidth=1.5, label=f"path of {name}")
            axes.plot(*target, "*", color=BAD, markersize=14, label=f"target of {name}")
    axes.plot(0, 0, 0, "s", color="black", markersize=7, label="base")
    frame_up(axes, list_points(p))
    figure.colorbar(ScalarMappable(times, TIME), ax=axes, label="time [s]", shrink=0.6, pad=0.1)
    axes.legend(loc="upper left", frameon=False)
    figure.suptitle(write_title(solution))
    return figure


def animate(solution: Solution, plant: Plant, path: Path) -> None:
    """Write a page that plays the motion, with the targets of its sensors."""
    path.write_text(make_animation(solution, plant), encoding="utf-8")


def make_animation(solution: Solution, plant: Plant) -> str:
    """Return the text of a page that plays the motion, with the targets of its sensors."""
    wanted = Wanted(solution.problem.name, list_targets(solution, plant))
    return write_page(make_film([Motion((make_part(solution, plant),))], wanted))


def list_targets(solution: Solution, plant: Plant) -> tuple[Marker, ...]:
    """List the targets of sensors; along free axes, a target is where the sensor ends."""
    targets = solution.problem.end.sensors
    if not targets:
        return ()
    ends = equip(plant, solution.problem, solution.trajectory.unknowns)("frames", q=solution.trajectory.q[-1])["p"]
    found = {frame.name: ends[:, i] for i, frame in enumerate(plant.manifest.frames) if frame.sensor}
    return tuple(Marker(f"target of {name}", _complete(target, found[name])) for name, target in targets)


def _complete(target: Target, end: Array) -> tuple[float, float, float]:
    x, y, z = (float(e) if t is None else t for t, e in zip(target, end, strict=True))
    return x, y, z


def make_part(solution: Solution, plant: Plant, name: str = "") -> Part:
    """Make the part of an animation that shows a solution, with its inputs and open wrenches."""
    trajectory = solution.trajectory
    plant = equip(plant, solution.problem, trajectory.unknowns)
    rates = find_rates(plant, trajectory.q, trajectory.qd)
    w = trajectory.point_w.mean(axis=1) if trajectory.point_w.size else None
    u, w = (None if x is None or not x.size else np.concatenate((x, x[-1:])) for x in (trajectory.u, w))
    return Part(plant, trajectory.t, trajectory.q, rates, name, u, w)


def _draw_pose(axes: Axes3D, frames: Sequence[Frame], p: Array, color: object, width: float) -> None:
    for i, frame in enumerate(frames):
        start = p[:, frame.parent] if frame.parent >= 0 else np.zeros(3)
        if not np.array_equal(start, p[:, i]):
            ends = np.stack((start, p[:, i]), axis=1)
            axes.plot(*ends, color=color, linewidth=width, marker="o", markersize=1.2 * width, solid_capstyle="round")


def draw_poses(axes: Axes3D, skeleton: Skeleton, t: Array, times: Normalize, poses: int = POSES) -> None:
    """Draw some poses of a motion at times t, in the colors of the times."""
    p = skeleton.p
    for k in np.linspace(0, len(p) - 1, min(poses, len(p))).round().astype(int):
        color = TIME(times(t[k]))
        _draw_pose(axes, skeleton.frames, p[k], color, 3.0 if k in (0, len(p) - 1) else 1.2)
        for link in skeleton.links:
            ends = p[k][:, [link.first, link.second]]
            axes.plot(*ends, color=color, linewidth=1.2, linestyle="-" if link.is_rod else ":")


def list_points(p: Array) -> Array:
    """List the points of a skeleton at all times, (points, 3)."""
    return p.transpose(0, 2, 1).reshape(-1, 3)


def frame_up(axes: Axes3D, points: Array) -> None:
    """Show all points (points, 3) and the base, at the same scale in every direction."""
    points = np.concatenate((points, np.zeros((1, 3))))
    middle, half = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0).max() / 2 or 1.0
    for set_limits, centre in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        set_limits(centre - half, centre + half)
    axes.set_box_aspect((1, 1, 1))
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")
    axes.view_init(elev=22, azim=-50)


def _name(axes: Axes, title: str, symbol: str, unit: str) -> None:
    axes.set_title(title, loc="left", fontsize="medium")
    axes.set_ylabel(f"${symbol}$ [{unit}]")
    axes.grid(alpha=0.3)
    axes.axhline(0, color="black", linewidth=0.6)


def plain(name: str) -> str:
    """Keep a name of the user's from being read as a formula."""
    return name.replace("$", r"\$")


def _join(units: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(units))


def write_title(solution: Solution) -> str:
    return f"{plain(solution.problem.name)}: {plain(solution.model)}, cost {solution.cost.total:.6g}"


def save(figure: Figure, path: Path) -> None:
    """Write a picture; equal pictures have equal bytes."""
    save_plot(figure, path)
