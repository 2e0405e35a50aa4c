"""Measured points -> panels: kernels, simulations, solves on a grid, and reductions."""

from __future__ import annotations

import re
from collections.abc import Sequence

from mbsrun.measuring.fidelity import WHOLE, FidelityPoint
from mbsrun.measuring.fronts import Dot, Panel, write_error
from mbsrun.measuring.kernels import EXACT
from mbsrun.measuring.motions import Standard
from mbsrun.measuring.optima import GridOptimum, OptimumPoint
from mbsrun.measuring.points import Cost, KernelPoint, MotionPoint, SolvePoint

PRECISIONS = {"float64": "double", "float32": "single"}
OF_ENDS = "largest error at the end [rad, m; rad/s, m/s]"
OF_DEFECTS = "largest defect of an interval [rad, m; rad/s, m/s]"
MOTION_TIME, SOLVE_TIME, CALL_TIME = "processor time of the motion", "processor time of a solve", "time of a call"
MEANINGS = {"impl": "torques", "semi": "mass matrix", "exp1": "accelerations", "exp2": "accelerations"}


def name_way(way: str) -> str:
    """Write a way to compute a function as text: jac_exp1 is EXP1, differences keep their kind alone."""
    kernel, *more = way.removeprefix("jac_").split(", ")
    name = re.sub(r"^(impl|semi|exp1|exp2)", lambda found: found[0].upper(), kernel).replace("_res", "")
    name = name.replace("_red", ", reduced")
    if not more:
        return name
    return f"{more[0]} of {name}" if "differences" in more[0] else f"{more[0]}, {name}"


def name_setting(way: str, precision: str, flags: str) -> str:
    """Write precision, flags and a step of differences as text."""
    parts = [PRECISIONS.get(precision, precision), flags, *way.split(", ")[2:]]
    return ", ".join(part for part in parts if part)


def draw_kernel(point: KernelPoint, number: str = "error", command: str = "") -> Dot:
    """Return the dot of a kernel; `number` is its error, or its backward error."""
    failed = point.finding or ("it fails in some states" if point.failed else "")
    setting = name_setting(point.way, point.precision, point.flags)
    return Dot(name_way(point.way), setting, _shortest(point.ns), getattr(point, number), failed, command)


def panel_kernels(points: Sequence[KernelPoint], number: str, tasks: Sequence[str]) -> list[Panel]:
    """Return a panel for each mechanism and task."""
    panels = []
    for mechanism, task in dict.fromkeys((p.mechanism, p.task) for p in points if p.task in tasks):
        own = [p for p in points if (p.mechanism, p.task) == (mechanism, task) and p.precision != EXACT]
        dots = tuple(draw_kernel(p, number) for p in own)
        if number == "error" or any(dot.error is not None for dot in dots):
            joints = "1 joint" if own[0].joints == 1 else f"{own[0].joints} joints"
            error = "largest error, relative" if number == "error" else "largest backward error, relative"
            panels.append(Panel(f"{mechanism}, {joints}: {task}", dots, CALL_TIME, error, "ns"))
    return panels


def draw_motion(point: MotionPoint, number: str = "error", command: str = "") -> Dot:
    """Return the dot of a simulation; `number` is its error, or its drift."""
    line = f"{point.method} on {point.formulation.upper()}"
    unit = " s" if point.setting == "step" else ""
    setting = f"{point.setting} {point.value:.2g}{unit}"
    return Dot(line, setting, _shortest(point.seconds), getattr(point, number), point.finding, command)


def panel_motions(points: Sequence[MotionPoint], standard: Standard) -> list[Panel]:
    """Return a panel for the error at the end, and one for the drift of the energy."""
    errors = tuple(draw_motion(p) for p in points)
    drifts = tuple(draw_motion(p, "drift") for p in points)
    panels = [Panel("Which method, for the place at the end?", errors, MOTION_TIME, OF_ENDS, floor=standard.accuracy)]
    drift = "largest drift of energy, by the energy exchanged"
    return [*panels, Panel("Which method, for the energy?", drifts, MOTION_TIME, drift)]


def draw_solve(point: SolvePoint, command: str = "") -> Dot:
    """Return the dot of a solve on a grid."""
    line = f"{point.family.capitalize()} {point.degree}, {point.representation}"
    setting = f"{point.intervals} intervals"
    return Dot(line, setting, _shortest(point.seconds), point.defect, point.finding, command)


def panel_optima(points: Sequence[OptimumPoint], grids: Sequence[GridOptimum]) -> list[Panel]:
    """Return two panels for each control grid: the error of the cost, and the defect."""
    panels = []
    for grid in grids:
        own = [p for p in points if p.intervals == grid.intervals]
        where = f"{grid.intervals} intervals"
        known = "" if grid.error is None else f"; the grid itself errs by {write_error(grid.error)}"
        costs, defects = (tuple(_draw_optimum(p, number) for p in own) for number in ("error", "defect"))
        error = "error of the cost, relative"
        panels.append(Panel(f"{where}, for the cost{known}", costs, SOLVE_TIME, error, floor=grid.accuracy or None))
        panels.append(Panel(f"{where}, for the motion", defects, SOLVE_TIME, OF_DEFECTS))
    return panels


def _draw_optimum(point: OptimumPoint, number: str) -> Dot:
    line = f"{point.representation}, {point.family.capitalize()}"
    setting = f"degree {point.degree}, tolerance {point.tolerance:g}"
    return Dot(line, setting, _shortest(point.seconds), getattr(point, number), point.finding)


SUBJECTS = {  # of sentences, by the names of reductions
    r"(.*) locked": r"locking \1",
    r"(.*) without mass": r"\1 without its mass",
    r"no (.*)": r"leaving out \1",
    r"tolerance (.*)": r"a tolerance of \1",
    r"constant parameters": "keeping parameters constant",
    r"sensor (.*) alone": r"keeping sensor \1 alone",
}


def name_reduction(reduction: str) -> str:
    """Write a reduction as the subject of a sentence in the singular."""
    for pattern, subject in SUBJECTS.items():
        if found := re.fullmatch(pattern, reduction):
            return found.expand(subject)
    return reduction


def draw_reduction(point: FidelityPoint, number: str = "error_anywhere", command: str = "") -> Dot:
    """Return the dot of a reduction, with the share of the operations that it saves."""
    saved = "" if point.flops is None else f"{1 - point.flops / point.flops_whole:.0%} fewer operations"
    line = name_reduction(point.reduction)
    return Dot(line, saved, _shortest(point.ns), getattr(point, number), point.finding, command)


def panel_fidelity(points: Sequence[FidelityPoint]) -> list[Panel]:
    """Return panels for each kernel: states that agree with the reduction, and any states."""
    titles = {"error": "states that agree", "error_anywhere": "any state"}
    panels = []
    for kernel in dict.fromkeys(p.kernel for p in points):
        own = [p for p in points if p.kernel == kernel]
        (whole,) = [p for p in own if p.reduction == WHOLE]
        for number in titles:
            dots = tuple(draw_reduction(p, number) for p in own if p.reduction != WHOLE)
            question = f"Reductions, for {name_kernel(kernel)}: {titles[number]}"
            error = "largest error, by the whole model's largest result"
            panels.append(Panel(question, dots, CALL_TIME, error, "ns", whole=_shortest(whole.ns)))
    return panels


def name_kernel(kernel: str) -> str:
    """Write what a kernel computes, and its name."""
    return f"{MEANINGS[kernel]} by {kernel.upper()}" if kernel in MEANINGS else kernel


def _shortest(cost: Cost | None) -> float | None:
    return None if cost is None else cost.shortest
