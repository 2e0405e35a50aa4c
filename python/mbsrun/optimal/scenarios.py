"""Scenarios that share their first inputs: a problem and the values of its keys in each -> the data of phases.

    minimise  sum_s J_s(x_s, u_s)   such that   the first inputs of every u_s are u_0

Each scenario is a phase to which no link leads. The u_0 are unknowns, which are states of every stage. So the method by
stages eliminates a scenario down to u_0 before it begins the next one: it sums the Schur complements of the scenarios.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mbsgen.documents import Data
from mbsgen.manifest import Manifest
from mbsrun.ocp.problem.problem import Problem, Range
from mbsrun.ocp.problem.rewriting import RATE
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.many import Over, change, list_cases
from mbsrun.quantities import name_quantities

SHARED = ("solver", "unknowns")  # keys that scenarios have in common
FIRST = "first_"  # before the name of an input: the unknown that all scenarios begin with


def name_scenarios(count: int) -> tuple[str, ...]:
    """Name scenarios."""
    return tuple(f"scenario{k}" for k in range(count))


def state_scenarios(
    name: str, data: Mapping[str, Data], problem: Problem, manifest: Manifest, over: Over
) -> dict[str, Data]:
    """Return the data of a problem in phases, a scenario each. Raises ProblemError."""
    cases = list_cases(name, over)
    _check(name, problem, [key for case in cases for key in case])
    firsts = _list_first(problem, manifest)
    own = [change(name, _spell_cost(data, problem), case) for case in cases]
    whole: dict[str, Data] = {key: value for key, value in data.items() if key in (*SHARED, "model")}
    unknowns = whole.get("unknowns")
    added: dict[str, Data] = {
        f"{FIRST}{key}": {"range": _write_range(bounds), "guess": guess} for key, bounds, guess in firsts
    }
    whole["unknowns"] = (unknowns if isinstance(unknowns, dict) else {}) | added
    ties: list[Data] = [{"expression": f"{x} - {FIRST}{x}", "range": [0, 0], "at": "start"} for x, _, _ in firsts]
    whole["phases"] = [
        _state_phase(title, case, ties) for title, case in zip(name_scenarios(len(own)), own, strict=True)
    ]
    return whole


def _spell_cost(data: Mapping[str, Data], problem: Problem) -> dict[str, Data]:
    """Write the default cost down: a phase without a cost has none."""
    return {**data, "cost": data.get("cost") or {"inputs": problem.cost.inputs}} if problem.cost.inputs else {**data}


def _state_phase(title: str, data: Mapping[str, Data], ties: Sequence[Data]) -> Data:
    constraints = data.get("constraints")
    kept = {key: value for key, value in data.items() if key not in SHARED}
    return kept | {"name": title, "constraints": [*(constraints if isinstance(constraints, list) else []), *ties]}


def _check(name: str, problem: Problem, keys: Sequence[str]) -> None:
    """Refuse what has no first inputs, and values of keys that are of the whole."""
    faults = []
    if problem.inputs != "constant" or any(control.name.startswith(RATE) for control in problem.controls):
        remedy = "leave inputs out: scenarios share inputs that are constant over an interval"
        faults.append(("inputs", "inputs that change within an interval", remedy))
    if problem.delays:
        faults.append(("inputs.delay", "an input that acts later than it is given", "leave delays out"))
    strange = sorted({key for key in keys if key.split(".")[0] in SHARED})
    faults += [(key, "all scenarios have it in common", "give it in the problem") for key in strange]
    if faults:
        raise ProblemError(name, faults)


def _list_first(problem: Problem, manifest: Manifest) -> list[tuple[str, Range, float]]:
    """List the inputs and controls that are chosen, with bounds and guesses. Raises ProblemError where none is."""
    given = {force.input for force in problem.forces}
    names = name_quantities("u", [manifest.coordinates[i].name for i in manifest.actuated])
    pairs = enumerate(zip(names, problem.bounds.u, strict=True))
    found = [(x, bounds, min(max(0.0, bounds[0]), bounds[1])) for i, (x, bounds) in pairs if i not in given]
    found += [(x.name, x.bounds, x.guess) for x in problem.controls if not x.is_auxiliary]
    if not found:
        raise ProblemError(problem.name, [("inputs", "there are none that scenarios could share", "give controls")])
    return found


def _write_range(bounds: Range) -> Data:
    return [None if math.isinf(limit) else limit for limit in bounds]
