"""Pictures of a solution: trajectories over time (Docquier, Bruls, Fisette, Fig. 8), and the mechanism on its way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import cycle
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
from mbsrun.curves import Curve, Panel, draw_curves, plain, plot, within
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Range, Target
from mbsrun.ocp.solution.solution import Rounds, Solution, Starts
from mbsrun.quantities import Quantity, find_unit, name_components
from mbsrun.quaternions import find_rates
from mbsrun.skeleton import Skeleton, place

Array = NDArray[np.float64]

WIDE = 5.0  # ratio of the highest cost to the lowest from which on the axis is logarithmic
SMALLEST = 1e-15  # a defect that is shown
POSES = 9  # of the mechanism, evenly in time
COLORS = PALETTE
UNBOUNDED = (-np.inf, np.inf)
TIME = ListedColormap(colormaps["viridis_r"](np.linspace(0.2, 1, 256)))  # without its pale end


def plot_trajectories(solution: Solution, manifest: Manifest, path: Path) -> None:
    """Plot coordinates, velocities and inputs over time, and write the picture."""
    save(make_trajectories(solution, manifest), path)


@styled
def make_trajectories(solution: Solution, manifest: Manifest) -> Figure:
    """Plot coordinates, velocities, inputs, and what the problem adds over time: a panel for each unit."""
    curves = list_curves(solution, manifest, choose_colors([manifest]))
    figure, _ = draw_curves(curves, (0.0, float(solution.trajectory.t[-1])))
    figure.suptitle(write_title(solution))
    return figure


def choose_colors(manifests: Iterable[Manifest]) -> dict[str, str]:
    """Choose a color for each coordinate and velocity, by name: q has other names where there are quaternions."""
    every = dict.fromkeys(name for m in manifests for name in (*m.positions, *(c.name for c in m.coordinates)))
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(every)}


def read_times(trajectory: Trajectory) -> Array:
    """Return the times of all points that are plotted: where each interval begins, and its collocation points."""
    return np.concatenate((trajectory.t[:-1, None], trajectory.point_t), axis=1).ravel()


def list_curves(solution: Solution, manifest: Manifest, colors: Mapping[str, str]) -> list[Curve]:
    """List the curves of a solution: its motion, then what the problem adds."""
    motion = _list_motion(solution, manifest, colors) if manifest.coordinates else []
    return [*motion, *_list_additions(solution), *_list_wrenches(solution, manifest)]


def _list_motion(solution: Solution, manifest: Manifest, colors: Mapping[str, str]) -> list[Curve]:
    """List coordinates, velocities, inputs and forces of driven joints."""
    trajectory, t, bounds = solution.trajectory, read_times(solution.trajectory), solution.problem.bounds
    q, qd = (
        np.concatenate((mesh[:-1, None], points), axis=1).reshape(len(t), -1)
        for mesh, points in ((trajectory.q, trajectory.point_q), (trajectory.qd, trajectory.point_qd))
    )
    joints = manifest.coordinates
    driven = [joints[i] for i in manifest.driven]
    kinds = {c.name: "" if c.actuated else " (driven)" if c in driven else " (passive)" for c in joints}
    lines = {c.name: "-" if c.actuated else "--" for c in joints}

    def style(name: str) -> dict[str, Any]:
        return {"color": colors[name], "linestyle": lines.get(name, "-")}

    units = [find_unit(Quantity("q", i), manifest) for i in range(len(manifest.positions))]

    def draw(name: str, values: Array, limits: Range) -> Callable[..., Any]:
        return within(plot(t, values, **style(name)), values, limits, colors[name])

    curves = [
        Curve(Panel("Joint coordinates", "q", unit), name + kinds.get(name, ""), draw(name, values, limits))
        for name, unit, values, limits in zip(manifest.positions, units, q.T, bounds.q, strict=True)
    ]
    curves += [
        Curve(
            Panel("Joint velocities", r"\dot{q}", f"{c.unit}/s"), c.name + kinds[c.name], draw(c.name, values, limits)
        )
        for c, values, limits in zip(joints, qd.T, bounds.qd, strict=True)
    ]
    for k, c in enumerate(joints[i] for i in manifest.actuated):
        points = trajectory.point_u[:, :, k : k + 1]
        drawn = _draw_input(trajectory, trajectory.u[:, k], points, color=colors[c.name])
        drawn = within(drawn, points if points.size else trajectory.u[:, k], bounds.u[k], colors[c.name])
        curves.append(Curve(Panel("Inputs", "u", c.force_unit), c.name, drawn))
    if solution.driving is not None:
        times = trajectory.point_t.ravel()
        curves += [
            Curve(
                Panel("Forces of driven joints", r"\tau", c.force_unit),
                c.name + kinds[c.name],
                plot(times, solution.driving[:, :, k].ravel(), color=colors[c.name], linestyle="--"),
            )
            for k, c in enumerate(driven)
        ]
    return curves


def _list_additions(solution: Solution) -> list[Curve]:
    """List the states, integrals and controls that the problem adds; nothing states their units."""
    trajectory, problem, t = solution.trajectory, solution.problem, read_times(solution.trajectory)
    states = np.concatenate((trajectory.states[:-1, None], trajectory.point_states), axis=1).reshape(len(t), -1)
    names = [*(state.name for state in problem.states), *(part.expression for part in problem.integrals)]
    ranges = [*(state.bounds for state in problem.states), *(UNBOUNDED for _ in problem.integrals)]
    curves = [
        Curve(Panel("Further states"), name, within(plot(t, values, color=color), values, limits, color))
        for color, (name, values, limits) in zip(cycle(COLORS), zip(names, states.T, ranges, strict=True), strict=False)
    ]
    for k, (color, control) in enumerate(zip(cycle(COLORS), problem.controls, strict=False)):
        points, values = trajectory.point_controls[:, :, k : k + 1], trajectory.controls[:, k]
        name = f"slack of {control.softens}" if control.softens else control.bounds_from_above or control.name
        drawn = _draw_input(trajectory, values, points, color=color)
        drawn = within(drawn, points if points.size else values, control.bounds, color)
        curves.append(Curve(Panel("Slacks" if control.softens else "Further controls"), name, drawn))
    return curves


def _list_wrenches(solution: Solution, manifest: Manifest) -> list[Curve]:
    """List the components of open wrenches, and the signals, that are not 0."""
    trajectory = solution.trajectory
    forces = trajectory.point_w.reshape(trajectory.point_t.size, trajectory.point_w.shape[2])
    curves = []
    for k, (component, values) in enumerate(zip(name_components(manifest), forces.T, strict=True)):
        if values.any():
            unit = find_unit(Quantity("w", k), manifest)
            title = "Open wrenches" if unit else "Signals"
            drawn = plot(trajectory.point_t.ravel(), values, color=COLORS[k % len(COLORS)])
            curves.append(Curve(Panel(title, "w" if unit else "", unit), component or "wrench", drawn))
    return curves


@styled
def plot_curves(t: Array, curves: Sequence[tuple[str, str, Array]]) -> Figure:
    """Plot numbers over time by their names and units, a panel for each unit."""
    units = [unit for _, unit, _ in curves]

    def find_panel(name: str, unit: str) -> Panel:
        return Panel(name if units.count(unit) == 1 else "", unit=unit)

    drawn = [
        Curve(find_panel(name, unit), name, plot(t, values, color=COLORS[units[:k].count(unit) % len(COLORS)]))
        for k, (name, unit, values) in enumerate(curves)
    ]
    figure, _ = draw_curves(drawn, (float(t[0]), float(t[-1])))
    return figure


def _draw_input(trajectory: Trajectory, values: Array, points: Array, **style: Any) -> Callable[[Axes, str], Any]:
    """Return a function that draws an input: constant values (N,), or values (N, d, 1) of polynomials."""
    if points.size:
        return plot(trajectory.point_t.ravel(), points.ravel(), linewidth=1.5, **style)
    return lambda axes, label: axes.stairs(
        values, trajectory.t, baseline=None, linewidth=1.5, label=plain(label), **style
    )


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


@styled
def plot_cases(name: str, places: Mapping[str, Array], costs: Array, path: Path) -> None:
    """Plot the costs (K,) of cases over one key or two, values (K,) by name; crosses have no solution."""
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes, solved = figure.subplots(), np.isfinite(costs)
    (first, x), *others = places.items()
    axes.set_xlabel(first)
    if others:
        ((second, y),) = others
        shown = axes.scatter(x[solved], y[solved], c=costs[solved], cmap="viridis", s=40)
        figure.colorbar(shown, ax=axes, label="cost")
        axes.plot(x[~solved], y[~solved], "x", color=COLORS[1])
        axes.set_ylabel(second)
    else:
        order = np.argsort(x[solved], kind="stable")
        axes.plot(x[solved][order], costs[solved][order], "o-", color=COLORS[0], markersize=4)
        low = costs[solved].min() if solved.any() else 0.0
        axes.plot(x[~solved], np.full(int((~solved).sum()), low), "x", color=COLORS[1])
        axes.set_ylabel("cost")
    axes.set_title(f"{name}: {int(solved.sum())} of {costs.size} cases solved")
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


def write_title(solution: Solution) -> str:
    return f"{plain(solution.problem.name)}: {plain(solution.model)}, cost {solution.cost.total:.6g}"


def save(figure: Figure, path: Path) -> None:
    """Write a picture; equal pictures have equal bytes."""
    save_plot(figure, path)
