"""The pictures of `mbsrun chart`: measured points of one task, in panels of work against error."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from mbsrun.measuring.fidelity import FidelityPoint
from mbsrun.measuring.fronts import Dot, Panel
from mbsrun.measuring.kernels import KERNELS, SLOPES
from mbsrun.measuring.motions import Standard
from mbsrun.measuring.optima import GridOptimum, OptimumPoint
from mbsrun.measuring.panels import panel_fidelity, panel_kernels, panel_motions, panel_optima
from mbsrun.measuring.pictures import draw_panels
from mbsrun.measuring.points import KernelPoint, MotionPoint


def draw_kernels(points: Sequence[KernelPoint], folder: Path) -> list[Path]:
    """Draw kernels.png, kernels_backward.png and derivatives.png; return their paths."""
    pictures: dict[str, tuple[str, str, Iterable[str]]] = {
        "kernels": ("Kernels: time against error", "error", KERNELS),
        "kernels_backward": ("Kernels: time against backward error", "backward", KERNELS),
        "derivatives": ("Derivatives: time against error", "error", SLOPES),
    }
    paths = []
    for name, (title, number, tasks) in pictures.items():
        panels = panel_kernels(points, number, tuple(tasks))
        paths += draw_panels(title, panels, folder, name) if panels else []
    return paths


def draw_motions(points: Sequence[MotionPoint], standard: Standard, folder: Path) -> list[Path]:
    """Draw simulation.png: error at the end, and drift of energy, against processor time; return its paths."""
    title = f"{points[0].mechanism}, {standard.duration:g} s of simulation: time against error"
    return draw_panels(title, panel_motions(points, standard), folder, "simulation")


def draw_optima(points: Sequence[OptimumPoint], grids: Sequence[GridOptimum], folder: Path) -> list[Path]:
    """Draw optimisation.png, a row for each control grid, and control_grid.png; return their paths."""
    name = points[0].mechanism
    paths = draw_panels(f"{name}: time of a solve against error", panel_optima(points, grids), folder, "optimisation")
    return [
        *paths,
        *draw_panels(f"{name}: what a finer grid gains", [_panel_grids(points, grids)], folder, "control_grid"),
    ]


def draw_fidelity(points: Sequence[FidelityPoint], folder: Path) -> list[Path]:
    """Draw fidelity.png: for each kernel, errors as supposed and anywhere, against time; return its paths."""
    title = f"{points[0].mechanism}: the time that a reduction saves, against its error"
    return draw_panels(title, panel_fidelity(points), folder, "fidelity")


def _panel_grids(points: Sequence[OptimumPoint], grids: Sequence[GridOptimum]) -> Panel:
    """Return the errors of control grids and of collocation on them, against the number of intervals."""
    first, usual = points[0].representation, points[0].tolerance
    dots = [Dot("the control grid alone", f"{g.intervals} intervals", g.intervals, g.error, g.finding) for g in grids]
    dots += [
        Dot(f"{p.family.capitalize()} {p.degree}", f"{p.intervals} intervals", p.intervals, p.error, p.finding)
        for p in points
        if (p.representation, p.tolerance) == (first, usual)
    ]
    floor = next((g.error_accuracy for g in grids if g.error_accuracy), None)
    return Panel("Which grid, for the cost?", tuple(dots), "intervals", "error of the cost, relative", "", floor=floor)
