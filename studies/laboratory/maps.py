"""Draw maps of lost digits: against the condition, over mass ratio and length, towards a lock.

A status is a cross at the upper edge, or an empty field with a note, so the maps also show failures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from mbsgen.style import BAD, PALETTE, in_format, styled
from mbsrun.measuring.pictures import save_picture
from mbsrun.measuring.sections import Caption, Outline, Table, write_outline, write_table
from studies.laboratory import chains, locks
from studies.laboratory.case import Loss, Report, Workspace
from studies.laboratory.digits import EXPLICIT
from studies.laboratory.mechanisms import describe_spatial, describe_straight, draw

LENGTHS = (2, 5, 10, 20)
RATIOS = tuple(10.0**k for k in range(0, 13, 2))
FLOOR, TOP = 1e-17, 10.0  # the range of drawn errors
WORST = 1e22  # the largest distinguished condition
COLORS = {"EXP1": BAD, "EXP2": PALETTE[0]}
DARK = 1e-6  # an error whose field is too dark for black letters
NOWHERE = 1e-14  # rad: the place of the lock itself
_COLUMNS = tuple(field.name for field in fields(Loss))


OUTLINE = Outline(
    "laboratory",
    5,
    "Where methods fail: the laboratory",
    "Cases in which methods lose digits, diverge or mislead, each with a criterion, and a verdict for each "
    "formulation, method or representation. Errors are of accelerations, by the largest, against 50 digits at the same "
    "inputs.",
    (
        Caption("verdicts.json"),
        Caption(
            "map_condition.png",
            "Lost digits and their estimates",
            "Errors of EXP1 and EXP2 against the condition of the mass matrix, which raises false alarms; against the "
            "condition of the matrix scaled to a diagonal of ones; and against the estimate by the kernel `condition`. "
            "Dotted: u times the condition, or the estimate itself; crosses: a status instead of a result.",
        ),
        Caption(
            "map_mass_ratio.png",
            "Digits lost by mass ratio of the tip, and length of the chain",
            "The mass of the last rod by the mass of another, against the number of rods. In each field the error, and "
            "in brackets the estimate of `condition`.",
        ),
        Caption(
            "map_lock.png",
            "Digits lost by the distance from a lock",
            "Dots: errors; bars: estimates of `condition`; crosses: a status instead. The distance is in rad.",
        ),
        *(Caption(f"{name}.json") for name in ("map_condition", "map_mass_ratio", "map_lock", "findings")),
    ),
)


def measure_maps(workspace: Workspace, report: Report, *, quick: bool = False) -> list[Loss]:
    """Measure the losses for the maps; losses that cases measured are read from the store."""
    lengths, ratios = (LENGTHS[:2], RATIOS[::3]) if quick else (LENGTHS, RATIOS)
    jobs = [partial(chains.weigh_tip, workspace, size, ratio) for size in lengths for ratio in ratios]
    jobs += [partial(_take_lock, workspace, lock, d) for lock in ("Cardan", "wrist", "elbow") for d in locks.DISTANCES]
    jobs += [partial(_take_harmless, workspace, factors) for factors in chains.HARMLESS.values()]
    jobs += [partial(_take_chain, workspace, kind, size) for kind in ("straight", "spatial") for size in lengths]
    losses: list[Loss] = []
    for done, job in enumerate(jobs):
        report("maps", done, len(jobs))
        losses += job()
    return losses


@styled
def draw_maps(losses: Sequence[Loss], folder: Path) -> list[Path]:
    """Draw the maps, each with its table, and write captions of all files; return the paths."""
    paths = _write(losses, "map_condition", "Lost digits, the condition, and the estimate of `condition`", folder)
    tips = [x for x in losses if x.mechanism == "heavy tip"]
    paths += _write(tips, "map_mass_ratio", "Digits lost by mass ratio of the tip, and length of the chain", folder)
    near = [x for x in losses if x.mechanism in _list_locks(losses)]
    paths += _write(near, "map_lock", "Digits lost by the distance from a lock", folder)
    for name, figure in (
        ("map_condition", _draw_condition(losses)),
        ("map_mass_ratio", _draw_ratios(tips)),
        ("map_lock", _draw_locks(near)),
    ):
        paths.append(in_format(folder / f"{name}.png"))
        save_picture(figure, paths[-1], 90)
    return [*paths, write_outline(OUTLINE, folder)]


def _take_lock(workspace: Workspace, lock: str, distance: float) -> list[Loss]:
    return locks.approach(workspace, lock, distance)[2]


def _take_harmless(workspace: Workspace, factors: Sequence[float]) -> list[Loss]:
    return chains.weigh_links(workspace, factors)[2]


def _take_chain(workspace: Workspace, kind: str, size: int) -> list[Loss]:
    text, q = (describe_straight(size), 0.0) if kind == "straight" else (describe_spatial(size), None)
    return chains.measure_chain(workspace, f"{kind} chain", size, text, draw(size, [size], q=q))[1]


def _write(losses: Sequence[Loss], name: str, title: str, folder: Path) -> list[Path]:
    rows = tuple(tuple(asdict(loss)[key] for key in _COLUMNS) for loss in losses)
    note = (
        "number: ratio of masses, or distance from the lock [rad]; condition, scaled: of the mass matrix, and of it "
        "scaled to a diagonal of ones; estimate: the error by the kernel `condition`, empty where it promises "
        "no digit; error: of accelerations against 50 digits, empty where a status named a joint instead"
    )
    return write_table(Table(title, _COLUMNS, rows, note), folder, name)


def _list_locks(losses: Sequence[Loss]) -> list[str]:
    known = ("Cardan", "wrist", "elbow")
    return [name for name in known if any(x.mechanism == name for x in losses)]


def _draw_condition(losses: Sequence[Loss]) -> Figure:
    figure = Figure(figsize=(15, 5.5), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    titles = (
        ("condition", "condition of M: raises false alarms"),
        ("scaled", "condition of M, scaled to a diagonal of ones"),
        ("estimate", "estimate of `condition`"),
    )
    markers = dict(zip(dict.fromkeys(x.mechanism for x in losses), "ovs^D*Ph", strict=False))
    for axes, (name, title) in zip(panels, titles, strict=True):
        for loss in losses:
            x = getattr(loss, name)
            x = TOP if x is None and name == "estimate" else x
            _place(axes, loss, float(np.clip(x, FLOOR, TOP if name == "estimate" else WORST)), markers[loss.mechanism])
        axes.set_xscale("log")
        axes.set_xlabel(title)
        ends = np.array(axes.get_xlim())
        line = ends if name == "estimate" else ends * 2.0**-53
        axes.plot(ends, line, color="0.6", linewidth=0.8, linestyle=":", zorder=0)
        axes.set_xlim(*ends)
        _finish(axes)
    panels[0].set_ylabel("error of the accelerations")
    for mechanism, marker in markers.items():
        panels[2].plot([], [], marker=marker, color="0.4", linestyle="", label=mechanism)
    for way, color in COLORS.items():
        panels[2].plot([], [], marker="o", color=color, linestyle="", label=way)
    panels[0].legend(*panels[2].get_legend_handles_labels(), fontsize=7, loc="center left")
    figure.suptitle("dotted: u times the condition, or the estimate itself; x: a status instead", fontsize=9)
    return figure


def _draw_ratios(losses: Sequence[Loss]) -> Figure:
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    ways = list(EXPLICIT)
    lengths = sorted({x.joints for x in losses})
    ratios = sorted({x.number for x in losses})
    grid = figure.subplots(1, len(ways), squeeze=False)
    for axes, way in zip(grid[0], ways, strict=True):
        field = np.full((len(lengths), len(ratios)), np.nan)
        for loss in (x for x in losses if x.way == way):
            r, c = lengths.index(loss.joints), ratios.index(loss.number)
            estimate = "no digit" if loss.estimate is None else f"{loss.estimate:.0e}"
            if loss.error is not None:
                field[r, c] = max(loss.error, FLOOR)
            estimate = f"status\n({estimate})" if loss.error is None else f"{loss.error:.0e}\n({estimate})"
            ink = "white" if loss.error is not None and loss.error > DARK else "black"
            axes.text(c, r, estimate, ha="center", va="center", fontsize=7, color=ink)
        image = axes.imshow(field, norm=LogNorm(1e-16, 1e-2), cmap="YlOrRd", origin="lower", aspect="auto")
        axes.set_xticks(range(len(ratios)), [f"{x:.0e}" for x in ratios])
        axes.set_yticks(range(len(lengths)), [str(x) for x in lengths])
        axes.set_xlabel("mass of the last rod, by the mass of another")
        axes.set_ylabel("rods")
        axes.set_title(f"{way}: error (in brackets: the estimate of `condition`)", fontsize=9)
        figure.colorbar(image, ax=axes)
    return figure


def _draw_locks(losses: Sequence[Loss]) -> Figure:
    names = _list_locks(losses)
    figure = Figure(figsize=(5 * len(names), 4.6), layout="constrained")
    grid = figure.subplots(1, len(names), squeeze=False, sharey=True)
    for axes, name in zip(grid[0], names, strict=True):
        for way, color in COLORS.items():
            own = [x for x in losses if x.mechanism == name and x.way == way]
            for loss in own:
                _place(axes, loss, max(loss.number, NOWHERE), "o")
            estimate = [(max(x.number, NOWHERE), min(TOP, x.estimate)) for x in own if x.estimate is not None]
            axes.plot(*zip(*estimate, strict=True), color=color, marker="_", linestyle="", label=f"{way}, estimate")
            axes.plot([], [], color=color, marker="o", linestyle="", label=way)
        axes.set_xscale("log")
        axes.axhline(locks.SIX_DIGITS, color="0.5", linewidth=0.8, linestyle=":")
        axes.set_xlabel(f"distance from the lock [rad]; {NOWHERE:g} stands for 0")
        axes.set_title(f"{name}: x: a status instead of an error", fontsize=9)
        axes.legend(fontsize=7)
        _finish(axes)
    grid[0, 0].set_ylabel("error of the accelerations")
    return figure


def _place(axes: Axes, loss: Loss, x: float, marker: str) -> None:
    color = COLORS[loss.way]
    if loss.error is None:
        axes.plot(x, TOP, marker="x", color=color, markersize=5, linestyle="")
    else:
        axes.plot(
            x, min(max(loss.error, FLOOR), TOP), marker=marker, color=color, markersize=4, linestyle="", alpha=0.7
        )


def _finish(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.set_ylim(FLOOR / 2, 3 * TOP)
    axes.grid(color="0.9", linewidth=0.5)
