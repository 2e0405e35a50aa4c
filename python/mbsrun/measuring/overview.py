"""All layers of a model in one picture, one table and one interactive page, with the advised choices.

A panel for each need of each task: torques, accelerations and derivatives, a motion, a solve, and what may be left out.
Each dot has the command that repeats it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mbsgen.manifest import Manifest
from mbsrun.measuring.advice import Advice, Option
from mbsrun.measuring.explorer import render_explorer
from mbsrun.measuring.fidelity import WHOLE, FidelityPoint
from mbsrun.measuring.fronts import Dot, Panel, find_front
from mbsrun.measuring.motions import Course
from mbsrun.measuring.panels import (
    CALL_TIME,
    MOTION_TIME,
    OF_DEFECTS,
    OF_ENDS,
    SOLVE_TIME,
    draw_reduction,
    name_kernel,
    name_setting,
    name_way,
)
from mbsrun.measuring.pictures import draw_panels
from mbsrun.measuring.sections import Cell, Table, write_table

MOTION = "motion.yaml"  # the file of the motion that was measured
QUESTIONS = {
    "control": ("{need}: which formulation, which precision?", CALL_TIME, "largest error, relative"),
    "simulate": ("A motion of {duration:g} s: which method, which step?", MOTION_TIME, OF_ENDS),
    "optimise": ("{problem}: which grid, which formulation?", SOLVE_TIME, OF_DEFECTS),
}


@dataclass(frozen=True)
class Sources:
    """The files that repeat the measurements, as a command line names them."""

    model: str
    folder: str  # of the measurements
    problem: str = ""  # a problem file; empty: the reach that is stated for any model
    duration: float = 0.0  # of the motion [s]


@dataclass(frozen=True)
class Layer:
    """A panel, with the task and the need it belongs to."""

    task: str
    need: str
    panel: Panel


def list_layers(surveys: Sequence[Advice], reductions: Sequence[FidelityPoint], sources: Sources) -> list[Layer]:
    """Return a layer for each need of each survey, and for each kernel of the reductions."""
    pairs = [(advice, need) for advice in surveys for need in advice.needs]
    layers = [Layer(advice.task, need, _draw_need(advice, need, sources)) for advice, need in pairs]
    kernels = dict.fromkeys(point.kernel for point in reductions)
    return [*layers, *(_draw_kernel(kernel, reductions, sources, surveys[0].accuracy) for kernel in kernels)]


def draw_overview(title: str, layers: Sequence[Layer], folder: Path) -> list[Path]:
    """Write fronts.png beside its variants, fronts.csv, fronts.json and fronts.html; return their paths."""
    paths = draw_panels(title, [layer.panel for layer in layers], folder, "fronts")
    paths += write_table(tabulate_fronts(layers), folder, "fronts")
    paths.append(folder / "fronts.html")
    paths[-1].write_text(render_explorer(title, [layer.panel for layer in layers]), encoding="utf-8")
    return paths


def write_course(course: Course, folder: Path) -> Path:
    """Write the start and the duration of a drawn motion as a settings file of `mbsrun simulate`; return its path."""
    manifest = course.mechanism.manifest
    pose = ", ".join(f"{name}: {float(x)!r}" for name, x in zip(manifest.positions, course.q, strict=True))
    names = [c.name for c in manifest.coordinates]
    rates = ", ".join(f"{name}: {float(x)!r}" for name, x in zip(names, course.qd, strict=True) if x)
    velocity = f", velocity: {{{rates}}}" if rates else ""
    path = folder / MOTION
    path.write_text(f"duration: {course.duration!r}\nstart: {{pose: {{{pose}}}{velocity}}}\n", encoding="utf-8")
    return path


def tabulate_fronts(layers: Sequence[Layer]) -> Table:
    """List all dots: whether they are on the front, and which one is advised."""
    columns = ("task", "need", "method", "setting", "time", "unit", "error", "front", "advised", "command", "finding")
    note = "front: no other setting of the same need is both faster and more accurate."
    return Table("Speed against accuracy", columns, tuple(_list_rows(layers)), note)


def _list_rows(layers: Sequence[Layer]) -> Iterator[tuple[Cell, ...]]:
    for layer in layers:
        panel = layer.panel
        front = find_front(panel.good)
        for dot in panel.dots:
            time = None if dot.work is None else float(f"{dot.work:.4g}")
            marks = ("yes" if dot in front else "", "yes" if dot == panel.choice else "")
            numbers = (time, panel.unit, dot.error)
            yield (layer.task, layer.need, dot.line, dot.setting, *numbers, *marks, dot.command, dot.finding)


def _draw_need(advice: Advice, need: str, sources: Sources) -> Panel:
    question, work, error = QUESTIONS[advice.task]
    problem = sources.problem or "A reach in 1 s"
    question = question.format(need=need.capitalize(), duration=sources.duration, problem=problem)
    own = [option for option in advice.options if option.need == need]
    dots = {id(option): _draw_option(advice.task, option, sources) for option in own}
    best = advice.choose(need)
    choice = None if best is None else dots[id(best)]
    unit = own[0].unit
    return Panel(question, tuple(dots.values()), work, error, unit, advice.accuracy, choice)


def _draw_option(task: str, option: Option, sources: Sources) -> Dot:
    chosen = dict(option.choices)
    line, setting, command = {"control": _tell_kernel, "simulate": _tell_motion, "optimise": _tell_solve}[task](
        chosen, sources
    )
    work = None if option.cost is None else option.price
    return Dot(line, setting, work, option.error, option.finding, command)


def _tell_kernel(chosen: Mapping[str, str], sources: Sources) -> tuple[str, str, str]:
    way, precision = chosen["kernel"], chosen["precision"]
    kernel = way.split(", ")[0].removeprefix("jac_")
    single = "  # compile with -DMBS_REAL=float" if precision == "float32" else ""
    command = f"mbsgen {sources.model} --functions {kernel} -o {kernel}{single}"
    return name_way(way), name_setting(way, precision, ""), command


def _tell_motion(chosen: Mapping[str, str], sources: Sources) -> tuple[str, str, str]:
    method, formulation = chosen["method"], chosen["formulation"]
    setting, value = next((key, chosen[key]) for key in ("step", "tolerance") if key in chosen)
    options = f"--step {value}" if setting == "step" else f"--rtol {value} --atol {value}"
    command = (
        f"mbsrun simulate {sources.model} --settings {sources.folder}/{MOTION} --method {method} "
        f"--formulation {formulation} {options}"
    )
    return f"{method} on {formulation.upper()}", f"{setting} {value}" + (" s" if setting == "step" else ""), command


def _tell_solve(chosen: Mapping[str, str], sources: Sources) -> tuple[str, str, str]:
    scheme, degree, intervals = chosen["scheme"], chosen["degree"], chosen["intervals"]
    line, setting = f"{scheme.capitalize()} {degree}, {chosen['representation']}", f"{intervals} intervals"
    if not sources.problem:
        return line, setting, f"mbsrun advise {sources.model} --task optimise"
    grid = f"scheme: {scheme}, degree: {degree}, intervals: {intervals}"
    form = chosen["representation"].lower()
    return line, setting, f"mbsrun solve {sources.problem} --representation {form}  # with {grid}"


def _draw_kernel(kernel: str, points: Sequence[FidelityPoint], sources: Sources, accuracy: float) -> Layer:
    own = [p for p in points if p.kernel == kernel]
    (whole,) = [p for p in own if p.reduction == WHOLE]
    command = f"mbsrun chart fidelity {sources.model} -o {sources.folder}"
    dots = tuple(draw_reduction(p, command=command) for p in own if p.reduction != WHOLE)
    time = None if whole.ns is None else whole.ns.shortest
    useful = [dot for dot in dots if dot.is_good and dot.place[1] <= accuracy and dot.place[0] * 1.1 < (time or 0.0)]
    choice = min(useful, key=lambda dot: dot.place, default=None)
    question = f"Reductions, for {name_kernel(kernel)}: which parts may go?"
    error = "largest error in any state, by the largest result"
    panel = Panel(question, dots, CALL_TIME, error, "ns", accuracy, choice, whole=time)
    return Layer("reduce", kernel, panel)


def title_overview(manifest: Manifest) -> str:
    """Return the title of the picture."""
    count = len(manifest.coordinates)
    return f"{manifest.model}, {'1 joint' if count == 1 else f'{count} coordinates'}: speed against accuracy"
