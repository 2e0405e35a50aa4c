"""Drawing: Tree, joint coordinates -> a picture of the mechanism in space beside its tree.

All numbers are evaluated from tapes: poses from `frames`, masses and centres of mass from `masses`. A loop is drawn
between its ends, which are placed as sensors: a rod as a line, any other loop as a ring at the first end, and a dashed
line to the second one where the loop is open. In the tree a dashed line joins the two bodies.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import NDArray
from sympy import Expr

from mbsgen.formulations import ports
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.coupling import couple
from mbsgen.formulations.results.poses import build_frames
from mbsgen.formulations.states import declare_state
from mbsgen.model.symbols import exact, round_number, to_double, total
from mbsgen.model.tree import Cut, Kind, Loop, LoopFrame, Motion, Sensor, Tree
from mbsgen.style import PALETTE
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape

Array = NDArray[np.float64]

FORMATS = ("png", "svg")
COLORS = PALETTE[:-1]
AXES = {Motion.REVOLUTE: "-", Motion.PRISMATIC: "--"}  # line styles of joint axes
TURNED = {Motion.REVOLUTE: "about", Motion.PRISMATIC: "along"}
INK = "0.35"  # of everything except bodies
SHARE = 0.58  # of the picture's width, for the mechanism in space
_LONGEST = 24  # characters of a name in a picture
_MASSES = 0.15  # where the column of masses ends, of the width of the tree
_MOST = 60  # bodies that are named in a picture, and loops
_OPEN = 1e-6  # of the size of a mechanism: ends of a loop that are farther apart are joined by a line
SMALL = 1e-9  # rad or m: rounding of a coordinate that is 0
LOOSE = (0, (4, 3))  # the style of lines of loops: dashes


@dataclass(frozen=True)
class Scene:
    """A mechanism at one configuration, in the base frame."""

    origins: Array  # of the bodies, shape (bodies, 3) [m]
    axes: Array  # of their joints, unit vectors, shape (bodies, 3)
    centres: Array  # of mass, shape (bodies, 3) [m]; the origin of a body that has none
    masses: Array  # shape (bodies,) [kg]
    sensors: Array  # shape (sensors, 3) [m]
    ends: Array  # of the loops, first and second, shape (loops, 2, 3) [m]


def pose(tree: Tree, q: Sequence[float]) -> Scene:
    """Compute all positions at the joint coordinates `q` [rad or m] and the default parameters."""
    n, s = len(tree.bodies), len(tree.sensors)
    ends = [_sense(end) for loop in tree.loops for end in (loop.first, loop.second)]
    at = {"q": list(q)}
    for port, kind in ((ports.PARAMETERS, Kind.RUNTIME), (ports.DESIGN, Kind.DIFFERENTIATED)):
        at[port.name] = [parameter.value for parameter in tree.parameters if parameter.kind is kind]
    frames, masses = (
        {name: np.array(values, float) for name, values in evaluate(tape, at).items()}
        for tape in (
            couple(build_frames(replace(tree.uncoupled, sensors=(*tree.sensors, *ends))), tree),
            couple(_build_masses(tree.uncoupled), tree),
        )
    )
    places = frames["p"].reshape(-1, 3)
    rotations = frames["R"].reshape(-1, 3, 3).transpose(0, 2, 1)[:n]  # columns: axes of the bodies
    axes, first = (np.einsum("brc,bc->br", rotations, masses[name].reshape(n, 3)) for name in ("axis", "S"))
    centres = places[:n] + np.divide(first.T, masses["m"], where=masses["m"] != 0, out=np.zeros((3, n))).T
    return Scene(places[:n], axes, centres, masses["m"], places[n : n + s], places[n + s :].reshape(-1, 2, 3))


def _sense(end: LoopFrame) -> Sensor:
    return Sensor("end", end.body, end.position, end.axes)


def list_masses(tree: Tree) -> list[float]:
    """List the masses of the bodies, at the default parameters: kg."""
    return [_evaluate(tree, total((body.mass, *(part.mass for part in body.parts)))) for body in tree.bodies]


def _evaluate(tree: Tree, number: Expr) -> float:
    """Return a number at the default parameters."""
    values = {parameter.symbol: exact(parameter.value) for parameter in tree.parameters}
    return to_double(round_number(number.xreplace(values)))


def _build_masses(tree: Tree) -> Tape:
    """Write `masses`: inputs q [, p]; outputs m, and by body its first moment S and its joint's axis, in its axes."""
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, state)
    written = [chain.matrix(body.axes).transposed for body in tree.bodies]  # into the author's axes
    S = [turn.apply(link.S) for turn, link in zip(written, chain.links, strict=True)]
    e = [turn.column(body.joint.axis) for turn, body in zip(written, tree.bodies, strict=True)]
    builder.output_dense("m", [[link.m] for link in chain.links])
    builder.output_dense("S", [[v[r] for v in S] for r in range(3)])
    builder.output_dense("axis", [[v[r] for v in e] for r in range(3)])
    return builder.build("masses")


def describe_joint(tree: Tree, number: int) -> str:
    """Return a joint's type in words."""
    joint = tree.bodies[number - 1].joint
    kind = f"{joint.motion.value} {TURNED[joint.motion]} {'xyz'[joint.axis]}"
    for x in tree.couplings:
        if x.follower == number:
            offset = _evaluate(tree, x.offset)
            terms = [
                f"{_shorten(tree.bodies[leader - 1].joint.name)} times {_evaluate(tree, ratio):g}"
                for leader, ratio in x.terms
            ]
            return f"{kind}, follows {' + '.join([*terms, *([f'{offset:g}'] if offset else [])])}"
    kind = kind if joint.actuated else f"{kind}, passive"
    if joint.stops is not None:
        kind += ", compliant stops" if joint.stops.restitution is None else f", stops of {joint.stops.restitution:g}"
    if joint.dry is None:
        return kind
    kind += ", one-way clutch" if joint.dry.one_way else ", dry friction"
    return kind if joint.dry.load is None else f"{kind} by its load"


def draw(tree: Tree, q: Sequence[float]) -> Figure:
    """Draw the mechanism in space, and its tree beside it."""
    scene = pose(tree, q)
    height = max(6.5, 0.3 * min(len(tree.bodies), _MOST) + 1.2)
    figure = Figure(figsize=(13, height))
    FigureCanvasAgg(figure)
    space = figure.add_axes((0.0, 0.04, SHARE - 0.02, 0.9), projection="3d")
    assert isinstance(space, Axes3D)
    _draw_mechanism(space, tree, scene)
    _draw_tree(figure.add_axes((SHARE, 0.04, 0.99 - SHARE, 0.9)), tree, scene.masses)
    figure.suptitle(f"{_shorten(tree.name)} {_describe_coordinates(tree, q)}", parse_math=False)
    return figure


def _describe_coordinates(tree: Tree, q: Sequence[float]) -> str:
    moved = [f"{_shorten(name)} = {x:g}" for name, x in zip(tree.coordinates, q, strict=True) if x]
    if tree.closure is not None:
        joints = [tree.joints[i].name for i in tree.closure.independent]
        chosen = [(name, q[tree.coordinates.index(name)]) for name in joints if name in tree.coordinates]
        moved = [f"{_shorten(name)} = {x:.3g}" for name, x in chosen if abs(x) > SMALL]
    if not moved:
        return "at q = 0"
    return f"at {', '.join(moved[:6])}{', ...' if len(moved) > 6 else ''}"


def _shorten(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..."


def render(tree: Tree, q: Sequence[float], form: str) -> bytes:
    """Draw a tree as a file of one of FORMATS; the same tree gives the same bytes."""
    metadata: Mapping[str, None] = {"Software": None} if form == "png" else {"Date": None, "Creator": None}
    stream = BytesIO()
    with warnings.catch_warnings(), matplotlib.rc_context({"svg.hashsalt": "mbsgen"}):
        warnings.filterwarnings(
            "ignore", "Glyph .* missing from font"
        )  # the picture shows a box; the text tree, the name
        draw(tree, q).savefig(stream, format=form, dpi=150, metadata=dict(metadata))
    return stream.getvalue()


# -- in space -------------------------------------------------------------------------------------------------------


def _draw_mechanism(space: Axes3D, tree: Tree, scene: Scene) -> None:
    points = np.concatenate((np.zeros((1, 3)), scene.origins, scene.centres, scene.sensors, scene.ends.reshape(-1, 3)))
    size = float(np.ptp(points, axis=0).max()) or 1.0
    reach = 0.09 * size * min(1.0, 15 / len(tree.bodies))
    dot = min(1.0, 40 / len(tree.bodies))
    ends = np.concatenate((scene.origins + reach * scene.axes, scene.origins - reach * scene.axes))
    _frame_up(space, np.concatenate((points, ends)))
    heaviest = scene.masses.max(initial=0.0) or 1.0
    for i, body in enumerate(tree.bodies):
        color, origin = COLORS[i % len(COLORS)], scene.origins[i]
        start = scene.origins[body.parent - 1] if body.parent else np.zeros(3)
        carrier = COLORS[(body.parent - 1) % len(COLORS)] if body.parent else INK
        _draw_line(space, start, origin, color=carrier, linewidth=4.5, alpha=0.9, solid_capstyle="round")
        if scene.masses[i] > 0:
            _draw_line(space, origin, scene.centres[i], color=color, linewidth=1.2, linestyle=":")
            area = dot * (25 + 200 * scene.masses[i] / heaviest)
            space.scatter(*scene.centres[i], s=area, color=color, edgecolors="white", depthshade=False, zorder=5)
        arm = reach * scene.axes[i]
        _draw_line(space, origin - arm, origin + arm, color="black", linewidth=1.1, linestyle=AXES[body.joint.motion])
        space.quiver(*(origin + 0.7 * arm), *(0.3 * arm), color="black", linewidth=1.1, arrow_length_ratio=1.0)
        space.scatter(*origin, s=22 * dot, color="white", edgecolors="black", depthshade=False, zorder=6)
    for sensor, place in zip(tree.sensors, scene.sensors, strict=True):
        origin = scene.origins[sensor.body - 1] if sensor.body else np.zeros(3)
        carrier = COLORS[(sensor.body - 1) % len(COLORS)] if sensor.body else INK
        _draw_line(space, origin, place, color=carrier, linewidth=4.5, alpha=0.9, solid_capstyle="round")
        space.scatter(*place, s=55, color="black", marker="x", depthshade=False, zorder=7)
    _draw_loops(space, tree, scene, size, dot)
    space.scatter(0, 0, 0, s=60, color=INK, marker="s", depthshade=False, zorder=4)
    _fit(space)
    _draw_legend(space, tree)
    if len(tree.bodies) <= _MOST:
        starts = np.concatenate((np.zeros((1, 3)), scene.origins))[[body.parent for body in tree.bodies]]
        inner = [starts + part * (scene.origins - starts) for part in (0.15, 0.3, 0.5, 0.7, 0.85)]
        _write_names(space, tree, scene, np.concatenate((points, ends, *inner)))


def _draw_loops(space: Axes3D, tree: Tree, scene: Scene, size: float, dot: float) -> None:
    for loop, ends in zip(tree.loops, scene.ends, strict=True):
        for end, place in zip((loop.first, loop.second), ends, strict=True):
            origin = scene.origins[end.body - 1] if end.body else np.zeros(3)
            color = COLORS[(end.body - 1) % len(COLORS)] if end.body else INK
            _draw_line(space, origin, place, color=color, linewidth=4.5, alpha=0.9, solid_capstyle="round")
        is_rod = loop.cut is Cut.ROD
        if is_rod or np.linalg.norm(ends[1] - ends[0]) > _OPEN * size:
            _draw_line(space, *ends, color="black", linewidth=1.6, linestyle="-" if is_rod else LOOSE)
        for place in ends if is_rod else ends[:1]:
            space.scatter(*place, s=60 * dot, color="white", edgecolors="black", depthshade=False, zorder=6)
            space.scatter(*place, s=14 * dot, color="black", depthshade=False, zorder=7)


def _draw_line(space: Axes3D, start: Array, end: Array, **style: object) -> None:
    space.plot(*np.stack((start, end), axis=1), **style)


def _frame_up(space: Axes3D, points: Array) -> None:
    """Show all points, at the same scale in every direction."""
    low, high = points.min(0), points.max(0)
    middle, spans = (low + high) / 2, high - low
    spans = np.maximum(1.08 * spans, 0.45 * spans.max())
    for limit, centre, span in zip((space.set_xlim, space.set_ylim, space.set_zlim), middle, spans, strict=True):
        limit(centre - span / 2, centre + span / 2)
    space.set_box_aspect(spans)
    for axis, name in zip((space.xaxis, space.yaxis, space.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{name} [m]")
        axis.labelpad = 9
        axis.set_major_locator(matplotlib.ticker.MaxNLocator(5, steps=[1, 2, 5, 10]))
    space.tick_params(labelsize=8)
    space.view_init(elev=20, azim=-60)


def _fit(space: Axes3D) -> None:
    """Shrink the drawing in space until the labels of its axes are within the picture."""
    figure = space.get_figure()
    assert isinstance(figure, Figure)
    zoom = 1.0
    for _ in range(4):  # labels keep their size, so one step is not enough
        figure.draw_without_rendering()
        room, drawn = _find_page(figure), space.get_tightbbox()
        middle = space.get_window_extent()
        if drawn is None:
            return
        reach = max(
            (drawn.x1 - (middle.x0 + middle.x1) / 2) / (room.x1 - (middle.x0 + middle.x1) / 2),
            ((middle.x0 + middle.x1) / 2 - drawn.x0) / ((middle.x0 + middle.x1) / 2 - room.x0),
            (drawn.y1 - (middle.y0 + middle.y1) / 2) / (room.y1 - (middle.y0 + middle.y1) / 2),
            ((middle.y0 + middle.y1) / 2 - drawn.y0) / ((middle.y0 + middle.y1) / 2 - room.y0),
        )
        if reach <= 1:
            return
        zoom *= 0.97 / reach
        lengths = [high - low for low, high in (space.get_xlim(), space.get_ylim(), space.get_zlim())]
        space.set_box_aspect(lengths, zoom=zoom)


def _find_page(figure: Figure) -> Bbox:
    """Return the part of the picture, in pixels, for the mechanism and its labels: below the title."""
    width, height = figure.get_size_inches() * figure.dpi
    return Bbox.from_extents(4, 4, SHARE * width, height - 40)


def _draw_legend(space: Axes3D, tree: Tree) -> None:
    motions = [m for m in Motion if any(body.joint.motion is m for body in tree.bodies)]
    entries = [
        Line2D([], [], color="black", linestyle=AXES[m], linewidth=1.1, label=f"axis, {m.value}") for m in motions
    ]
    entries.append(Line2D([], [], color=INK, marker="o", linestyle=":", markersize=8, label="centre of mass"))
    if tree.sensors:
        entries.append(Line2D([], [], color="black", marker="x", linestyle="", label="frame"))
    if tree.loops:
        ring = Line2D([], [], color="black", marker="o", linestyle=LOOSE, linewidth=1.2, markersize=8, label="loop")
        ring.set_markerfacecolor("white")
        entries.append(ring)
    entries.append(Line2D([], [], color=INK, marker="s", linestyle="", label="base"))
    space.legend(handles=entries, loc="upper left", frameon=False, fontsize=8)


def _write_names(space: Axes3D, tree: Tree, scene: Scene, points: Array) -> None:
    """Write the names of joints and frames near them, one label for each place, clear of `points`."""
    names: dict[tuple[float, ...], list[str]] = {}
    for i, body in enumerate(tree.bodies):
        names.setdefault(tuple(np.round(scene.origins[i], 9)), []).append(_shorten(body.joint.name))
    for sensor, place in zip(tree.sensors, scene.sensors, strict=True):
        names.setdefault(tuple(np.round(place, 9)), []).append(f"[{_shorten(sensor.name)}]")
    for loop, ends in zip(tree.loops, scene.ends, strict=True):
        names.setdefault(tuple(np.round(ends[0], 9)), []).append(f"({_shorten(loop.name)})")
    figure = space.get_figure()
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()  # the projection is known thereafter
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in (_project(space, point) for point in points)]
    for place, listed in names.items():
        x, y = _project(space, np.array(place))
        tip = figure.transFigure.inverted().transform((x, y))  # pixels are another size where the picture is saved
        text = space.annotate(
            "\n".join(", ".join(listed[k : k + 3]) for k in range(0, len(listed), 3)),
            tip,
            xycoords="figure fraction",
            xytext=tip,
            textcoords="figure fraction",
            fontsize=8.5,
            ha="center",
            va="center",
            zorder=10,
            parse_math=False,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
            arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.6},
        )
        box = text.get_window_extent()
        room = _find_room(x, y, box.width + 8, box.height + 6, taken, _find_page(figure))
        text.set_position(figure.transFigure.inverted().transform(room))
        taken.append(text.get_window_extent())


def _project(space: Axes3D, point: Array) -> tuple[float, float]:
    x, y, _ = proj_transform(*point, space.get_proj())
    across, up = space.transData.transform((x, y))
    return float(across), float(up)


def _find_room(
    x: float, y: float, width: float, height: float, taken: Sequence[Bbox], page: Bbox
) -> tuple[float, float]:
    """Return a centre near (x, y) for a box that overlaps none of the given boxes, or as few as possible."""
    best, fewest = (x, y), len(taken) + 1
    for reach in (0.0, 10.0, 22.0, 36.0, 52.0, 70.0, 90.0, 120.0, 160.0):
        for turn in range(12):
            angle = np.pi * (turn / 6 + 0.25)
            centre = (
                _keep(x + np.cos(angle) * (width / 2 + 8 + reach), page.x0 + width / 2, page.x1 - width / 2),
                _keep(y + np.sin(angle) * (height / 2 + 8 + reach), page.y0 + height / 2, page.y1 - height / 2),
            )
            box = Bbox.from_bounds(centre[0] - width / 2, centre[1] - height / 2, width, height)
            hits = sum(box.overlaps(other) for other in taken)
            if hits < fewest:
                best, fewest = centre, hits
        if not fewest:
            break
    return best


def _keep(value: float, low: float, high: float) -> float:
    return float(min(max(value, low), high))


# -- the tree -------------------------------------------------------------------------------------------------------


def _draw_tree(panel: Axes, tree: Tree, masses: Array) -> None:
    """List the bodies, one per line, indented by depth, then the loops; masses are in a column before the bodies."""
    panel.axis("off")
    listed, depths = list_rows(tree)
    rows = listed[:_MOST]
    indent = min(0.05, 0.3 / max(depths[i] for i in rows))
    panel.set_xlim(0, 1)
    loops = tree.loops[:_MOST]
    panel.set_ylim(max(len(rows) + bool(loops) + len(loops), 14) + 1.5, -0.8)
    size = 9.5 if len(rows) + len(loops) <= 30 else 8.0
    panel.text(_MASSES, 0.0, "mass [kg]", fontsize=size, va="center", ha="right", color=INK)
    panel.text(_MASSES + 0.02, 0.0, "base", fontsize=size, va="center", color=INK)
    heights = {0: 0.0}
    lines: list[tuple[Annotation, Annotation]] = []
    style: dict[str, Any] = {"fontsize": size, "va": "center", "parse_math": False}
    for row, i in enumerate(rows, 1):
        body, x = tree.bodies[i - 1], _MASSES + 0.02 + indent * depths[i]
        trunk = x - indent + 0.012
        panel.plot([trunk, trunk, x - 0.006], [heights[body.parent] + 0.35, row, row], color=INK, linewidth=0.8)
        panel.plot(x + 0.008, row, "o", color=COLORS[(i - 1) % len(COLORS)], markersize=7)
        name = panel.annotate(_shorten(body.name), (x + 0.03, row), weight="bold", **style)
        text = f"   {_shorten(body.joint.name)}: {describe_joint(tree, i)}"
        lines.append((name, panel.annotate(text, (1, 0.5), xycoords=name, **style)))
        mass = f"{masses[i - 1]:.4g}" if masses[i - 1] else "0"
        panel.text(_MASSES, row, mass, fontsize=size, va="center", ha="right")
        heights[i] = row
    if len(listed) > len(rows):
        panel.text(_MASSES, len(rows) + 1, f"and {len(listed) - len(rows)} more bodies", va="center", color=INK)
    dots = {0: (_MASSES + 0.04, 0.0)} | {i: (_MASSES + 0.028 + indent * depths[i], heights[i]) for i in rows}
    for row, loop in enumerate(loops, len(rows) + 2):
        name = panel.annotate(_shorten(loop.name), (_MASSES + 0.02, row), weight="bold", style="italic", **style)
        text = f"   {describe_loop(tree, loop)}"
        lines.append((name, panel.annotate(text, (1, 0.5), xycoords=name, **style)))
        if loop.first.body in dots and loop.second.body in dots:
            _join(panel, dots[loop.first.body], dots[loop.second.body])
    _narrow(panel, lines)


def describe_loop(tree: Tree, loop: Loop) -> str:
    """Return a loop's type and its bodies in words."""
    ends = [_shorten(tree.bodies[end.body - 1].name) if end.body else "base" for end in (loop.first, loop.second)]
    return f"{loop.cut.value} between {ends[0]} and {ends[1]}"


def _join(panel: Axes, first: tuple[float, float], second: tuple[float, float]) -> None:
    """Draw a dashed arc between two bodies, to the left of their names."""
    upper, lower = sorted((first, second), key=lambda dot: dot[1])
    arrow = {"arrowstyle": "-", "linestyle": LOOSE, "color": INK, "linewidth": 1.0, "connectionstyle": "arc3,rad=0.3"}
    panel.annotate("", lower, xytext=upper, arrowprops=arrow, zorder=0)


def _narrow(panel: Axes, lines: Sequence[tuple[Annotation, Annotation]]) -> None:
    """Shrink lines that would leave the picture, each by as much as necessary."""
    end = panel.get_window_extent().x1
    for name, text in lines:
        for _ in range(3):  # widths go in steps
            start, far = name.get_window_extent().x0, text.get_window_extent().x1
            if far <= end:
                break
            size = float(name.get_fontsize()) * 0.98 * (end - start) / (far - start)
            name.set_fontsize(size)
            text.set_fontsize(size)


def list_rows(tree: Tree) -> tuple[list[int], dict[int, int]]:
    """Number the bodies from the base outwards, each before its children, and count their depths from 1."""
    rows: list[int] = []
    depths = {0: 0}
    waiting = list(reversed(tree.children(0)))
    while waiting:
        i = waiting.pop()
        rows.append(i)
        depths[i] = depths[tree.bodies[i - 1].parent] + 1
        waiting.extend(reversed(tree.children(i)))
    return rows, depths
