"""Derivatives of a solution for a command: numbers by their names, lines of a summary, and a file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbsrun.ocp.optima.status import SENTENCES, SMOOTH
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solution.phases import PhasedSolution

if TYPE_CHECKING:
    from mbsrun.optimal.control import OptimalControl
    from mbsrun.optimal.derivatives import Derivatives
    from mbsrun.optimal.phases import PhasedControl

ALL = "all"
FILE = "derivatives.json"


def read_control(file: Path, by: Sequence[str]) -> OptimalControl | PhasedControl:
    """Read a problem, and check the names of numbers. Raises InputError, ProblemError."""
    from mbsrun.optimal.control import read_problem  # here, and late: it takes long to load

    control = read_problem(file)
    control.check_numbers([name for name in by if name != ALL])
    return control


def differentiate(
    control: OptimalControl | PhasedControl, outcome: PhasedSolution, plants: Plants, by: Sequence[str]
) -> Derivatives:
    """Differentiate a solution. Raises ProblemError."""
    from mbsrun.optimal.control import OptimalControl  # here, and late: it takes long to load
    from mbsrun.optimal.phases import SolvedPhases
    from mbsrun.optimal.result import Solved

    names = None if ALL in by else by
    if isinstance(control, OptimalControl):
        return control.derivatives(Solved(outcome.single, plants.phases[0]), names)
    return control.derivatives(SolvedPhases(outcome, plants), names)


def list_rows(derivatives: Derivatives) -> Iterator[tuple[str, str]]:
    """List the lines of a summary."""
    yield "derivatives", f"{derivatives.status}: {derivatives.reason}; {derivatives.active} active limits"
    yield from ((f"  d cost / d {name} ", f"{value:.8g}") for name, value in derivatives.cost.items())


def list_gaps(derivatives: Derivatives) -> list[str]:
    """List the numbers by which there is no derivative, with the reasons."""
    by_reason: dict[str, list[str]] = {}
    for name, status in derivatives.statuses.items():
        if status != SMOOTH:
            by_reason.setdefault(status, []).append(name)
    return [f"no derivative by {', '.join(names)} ({x}): {SENTENCES[x]}" for x, names in by_reason.items()]


def write_derivatives(derivatives: Derivatives, folder: Path) -> str:
    """Write derivatives of cost and motions by each number; return the file's name."""
    numbers = {name: _describe(derivatives, name) for name in derivatives.names}
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(x)}" for name, x in numbers.items())
    status = json.dumps(derivatives.status)
    text = f'{{\n "format": "mbsrun derivatives 1",\n "status": {status},\n "numbers": {{\n{lines}\n }}\n}}\n'
    (folder / FILE).write_text(text, encoding="utf-8")
    return FILE


def _describe(derivatives: Derivatives, name: str) -> dict[str, Any]:
    cost, status = derivatives.cost[name], derivatives.statuses[name]
    found: dict[str, Any] = {"status": status, "cost": cost if math.isfinite(cost) else None}
    if status == SMOOTH:
        found["phases"] = [
            {part: getattr(motion, part).tolist() for part in ("t", "q", "qd", "u", "states", "controls", "unknowns")}
            for motion in derivatives.by(name).phases
        ]
    return found
