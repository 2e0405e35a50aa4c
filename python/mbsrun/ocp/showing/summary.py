"""The summary of a solution: what a command prints and a notebook shows, and the shortcomings of a solution."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from mbsrun.closure import CLOSED
from mbsrun.ocp.guessing.starts import describe_starts
from mbsrun.ocp.problem.problem import Loops, Unknown
from mbsrun.ocp.solution.solution import Resimulation, Run, Size, Solution

UNUSED = 1e-6  # a slack that counts as 0: solvers keep it off its bound
NAMES = (  # of lines; an unknown may have the same one
    *("problem", "status", "time", "horizon", "duration", "program", "nonzeros", "cost", "starts", "violation"),
    *("loops", "closure", "intervals", "refinement", "complementarity", "slip", "defect", "between"),
)
SHOWN = 3  # constraints that a warning names
LOOPS: Mapping[Loops, str] = {
    Loops.REDUCED: "reduced: the independent coordinates are states",
    Loops.MULTIPLIERS: "with multipliers: all coordinates are states",
}


def describe_run(run: Run) -> str:
    """Return the solver's word, its iterations and its name."""
    return f"{run.status}, {run.iterations} iterations" + (f" of {run.method}" if run.method else "")


def summarise(solution: Solution) -> dict[str, str]:
    """Return the lines of a summary by their names; a solution that was not re-simulated has no line on accuracy."""
    return number_names(_list_lines(solution))


def number_names(lines: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return lines by their names; the second one of a name, as of two equal terms of a cost, has (2) behind it."""
    found: dict[str, str] = {}
    count: Counter[str] = Counter()
    for name, text in lines:
        count[name] += 1
        end = name[len(name.rstrip()) :]
        found[name if count[name] == 1 else f"{name.rstrip()} ({count[name]}){end}"] = text
    return found


def write_line(name: str, text: str, width: int) -> str:
    """Return a line of a summary, with a space between a long name and its text."""
    return f"{name.rstrip():<{width - 1}} {text}"


def name_unknown(name: str) -> str:
    """Return the name of an unknown's line, which no other line has."""
    return f"unknown {name}" if name in NAMES else name


def _list_lines(solution: Solution) -> Iterator[tuple[str, str]]:
    """List the lines of a summary."""
    run, size, cost, check = solution.run, solution.size, solution.cost, solution.resimulation
    violation = solution.violation
    yield "problem", f"{solution.problem.name}, model {solution.model}"
    yield from list_program(run, size, ("horizon", f"{solution.trajectory.t[-1]:.10g} s"))
    yield "cost", f"{cost.total:.10g}"
    if solution.starts is not None:
        yield "starts", describe_starts(solution.starts)
    yield from ((f"  {name} ", f"{value:.10g}") for name, value in cost.terms if value != 0)
    lengths = "" if violation.lengths is None else f", {violation.lengths:.1e} of quaternions' lengths"
    yield "violation", f"{violation.constraints:.1e} of constraints, {violation.bounds:.1e} of bounds{lengths}"
    yield from _describe_loops(solution).items()
    yield from _list_driving_forces(solution)
    yield from _describe_grid(solution).items()
    yield from ((name_unknown(x.name), f"{value:.10g}") for x, value in _list_unknowns(solution) if not x.softens)
    yield from _list_slacks(solution)
    yield from list_sensitivities(solution.sensitivities)
    if violation.complementarity is not None:
        most = f"{violation.complementarity:.1e} at most"
        yield "complementarity", f"{most}, of force times distance [N m], and friction off the slip [W]"
    if check is not None and check.slip is not None:
        along = _number(check.slip_along, check)
        yield "slip", f"{check.slip:.1e} m of a contact at all points; {along} along the re-simulated motion"
    if check is not None:
        accuracy = solution.problem.asked_accuracy
        yield "defect", f"{_number(check.defect, check)} in an interval, at most; {accuracy:.1e} asked for"
        yield (
            "open loop",
            f"{_number(check.open_loop_error, check)} off at the end, under the inputs alone{_describe_lost(check)}",
        )
        if check.margins is None or check.margins.each:
            yield "between", _describe_margins(check)


def list_sensitivities(found: Iterable[tuple[str, float]]) -> Iterator[tuple[str, str]]:
    """List the derivatives of the cost."""
    yield from ((f"d cost / d {name} ", f"{value:.8g}") for name, value in found)


def list_program(run: Run, size: Size, duration: tuple[str, str]) -> Iterator[tuple[str, str]]:
    """List the lines on a solve and on its program."""
    yield "status", describe_run(run)
    if run.instead:
        yield "  instead", run.instead
    if run.decrease is not None:
        convex = "" if run.gap is None else "; the program is convex, so this is its gap of duality"
        yield "optimality", f"small changes lower the cost by {run.decrease:.1e} at most, to first order{convex}"
    yield "time", f"{run.seconds:.2f} s"
    parts = f"{run.cpu_seconds_evaluating:.2f} s for functions and derivatives"
    yield (
        "  processor",
        f"{run.cpu_seconds:.2f} s: {parts}, {run.cpu_seconds_solving:.2f} s for linear algebra and the rest",
    )
    yield duration
    yield "program", f"{size.variables} variables, {size.constraints} constraints"
    yield "nonzeros", f"{size.jacobian_nonzeros} in the Jacobian, {size.hessian_nonzeros} in the Hessian's triangle"


def list_shortcomings(solution: Solution) -> list[str]:
    """List the shortcomings of a solution: tolerance, accuracy, an unfinished check."""
    check, found = solution.resimulation, []
    if solution.is_only_acceptable:
        found.append("the solver stopped at an acceptable level, short of the tolerance; try another guess or scaling")
    if check is not None and check.unfinished:
        found.append(
            f"the re-simulation did not finish, {check.unfinished}, so the accuracy is unknown; "
            "take a shorter horizon, or check a part of it"
        )
    elif check is not None and (check.closure or 0.0) > CLOSED:
        found.append(
            f"along the re-simulated motion the loops open by {check.closure:.1e}, more than {CLOSED:.0e}; "
            "take a shorter horizon, or check a part of it"
        )
    elif check is not None and not check.is_accurate:
        found.append(
            f"the largest defect of an interval, {_number(check.defect, check)}, is above the accuracy asked for, "
            f"{solution.problem.asked_accuracy:.1e}; take more intervals or a higher degree, or let refine choose them"
        )
    if check is not None and check.margins is not None and check.margins.violated:
        named = [margin.describe() for margin in check.margins.violated]
        more = f"; and {len(named) - SHOWN} more" if len(named) > SHOWN else ""
        found.append(
            f"between the points of the grid, {'; '.join(named[:SHOWN])}{more}; take more intervals there, or let "
            "refine split them"
        )
    return found


def _describe_lost(check: Resimulation) -> str:
    """Describe where the motion under the inputs alone was put back on the solution."""
    if not check.lost:
        return ""
    times = "once" if len(check.lost) == 1 else f"{len(check.lost)} times, first"
    return f"; unstable: it left the solution, and was put back on it, {times} at {check.lost[0]:.4g} s"


def _describe_margins(check: Resimulation) -> str:
    """Describe by how much bounds and constraints are violated between the points of the grid."""
    if check.margins is None:
        return _number(None, check)
    worst = check.margins.worst
    assert worst is not None, "margins of nothing have no line"
    if worst.is_kept:
        most = max((margin.violation for margin in check.margins.each), default=0.0)
        return f"the grid's points, bounds and constraints are violated by {max(most, 0.0):.1e} at most"
    violated = check.margins.violated
    more = f"; {len(violated) - 1} more" if len(violated) > 1 else ""
    return f"the grid's points, {worst.describe()}; tolerated {worst.tolerated:.1e}{more}"


def _describe_grid(solution: Solution) -> dict[str, str]:
    """Describe intervals that differ, and the rounds of a refinement."""
    problem, lengths, rows = solution.problem, np.diff(solution.trajectory.t), {}
    if problem.mesh is not None:
        rows["intervals"] = f"{problem.intervals}, from {lengths.min():.3g} s to {lengths.max():.3g} s"
    if solution.refinement is None:
        return rows
    made = len(solution.refinement.rounds) - 1
    rows["refinement"] = f"{made} round{'' if made == 1 else 's'}; {solution.refinement.finding}"
    for k, each in enumerate(solution.refinement.rounds):
        found = f"{each.status}" if each.cost is None else f"cost {each.cost:.8g}, {each.iterations} iterations"
        defect = "unknown" if each.defect is None else f"{each.defect:.1e}"
        grid = f"{len(each.times) - 1} intervals, degree {each.degree}, {each.variables} variables"
        rows[f"  round {k}"] = f"{grid}: {found}, defect {defect}" + (f"; {each.change}" if each.change else "")
    return rows


def _list_unknowns(solution: Solution) -> Iterator[tuple[Unknown, float]]:
    """List the numbers that the solver chose."""
    return zip(solution.problem.unknowns, solution.trajectory.unknowns.tolist(), strict=True)


def _list_slacks(solution: Solution) -> Iterator[tuple[str, str]]:
    """List the slacks, and by how much constraints are violated."""
    trajectory = solution.trajectory
    points = trajectory.spread_inputs()[1]
    for i, control in enumerate(solution.problem.controls):
        if control.softens:
            k, j = np.unravel_index(points[:, :, i].argmax(), points.shape[:2])
            most = float(points[k, j, i])
            where = f", the most from {trajectory.t[k]:.4g} to {trajectory.t[k + 1]:.4g} s"
            yield f"slack of {control.softens} ", _write_slack(most, where)
    for unknown, value in _list_unknowns(solution):
        if unknown.softens:
            yield f"slack of {unknown.softens} ", _write_slack(value, "")


def _write_slack(most: float, where: str) -> str:
    return f"{most:.6g}{where}" if most > UNUSED else "not used"


def _describe_loops(solution: Solution) -> dict[str, str]:
    """Describe how closed loops became variables, and how well they are closed."""
    loops, check, violation = solution.problem.loops, solution.resimulation, solution.violation
    if loops is None:
        return {}
    along = "" if check is None else f"; {_number(check.closure, check)} along the re-simulated motion"
    return {
        "loops": LOOPS[loops],
        "closure": f"{violation.closure:.1e} at all points, {violation.closure_rate:.1e} per s{along}",
    }


def _list_driving_forces(solution: Solution) -> Iterator[tuple[str, str]]:
    """List the least and the largest force of each driven joint [N, N m]."""
    if solution.driving is not None:
        for name, values in zip(solution.driven, np.moveaxis(solution.driving, -1, 0), strict=True):
            yield f"tau[{name}]", f"{values.min():.6g} to {values.max():.6g}"


def _number(value: float | None, check: Resimulation) -> str:
    reason = "the re-simulation did not finish" if check.unfinished else "the integrator gave up"
    return f"unknown ({reason})" if value is None else f"{value:.1e}"
