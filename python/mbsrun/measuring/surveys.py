"""Measure the options that a model has for a task, and return them as advice; measurements are kept in a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mbsrun.measuring import kernels, motions, solves
from mbsrun.measuring.advice import Advice, advise_control, advise_optimisation, advise_simulation
from mbsrun.measuring.mechanisms import Subject
from mbsrun.measuring.points import KernelPoint, MotionPoint, SolvePoint, write_points
from mbsrun.measuring.store import Store

Report = Callable[[str, int, int], None]  # takes the current step, the number of finished steps and of all


def survey_simulation(
    course: motions.Course, out: Path, accuracy: float, scope: motions.MotionScope, report: Report
) -> Advice:
    """Measure methods of simulation on a motion."""
    report("reference", 0, 1)
    standard = motions.find_standard(course)
    store = Store(out / "simulation.jsonl", MotionPoint)
    points = motions.measure_motions(course, standard, scope, store, report)
    write_points(points, out, "simulation")
    return advise_simulation(course, standard, points, accuracy)


def survey_optimisation(
    case: solves.Case, title: str, out: Path, accuracy: float, scope: solves.SolveScope, report: Report
) -> Advice:
    """Measure collocation of a problem on several grids; `title` names the problem."""
    store = Store(out / "problem.jsonl", SolvePoint)
    points = solves.measure_solves(case, accuracy, scope, store, report)
    write_points(points, out, "problem")
    return advise_optimisation(case.mechanism.manifest.model, title, points, accuracy)


def survey_control(model: Path, out: Path, accuracy: float, quick: bool, report: Report) -> Advice:
    """Measure all kernels of a model in double and single precision."""
    subject = Subject(model, kernels.DERIVATIVES)
    scope = kernels.KernelScope((), (kernels.USUAL, kernels.SINGLE), 3 if quick else 40, 4 if quick else 16)
    store = Store(out / "control.jsonl", KernelPoint)
    points: list[KernelPoint] = []
    tasks = kernels.list_tasks(subject.manifest, derivatives=True)
    for done, task in enumerate(tasks):
        report(task, done, len(tasks))
        points += kernels.measure_task(subject, task, scope, store)
    write_points(points, out, "control")
    return advise_control(subject.manifest.model, points, accuracy, scope.judged)
