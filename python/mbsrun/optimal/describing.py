"""A problem in words: Problem and manifest -> the lines that a notebook and a terminal show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from mbsgen.manifest import Manifest
from mbsrun.ocp.methods import choose
from mbsrun.ocp.problem.problem import Aims, Delay, Form, Problem, Range, Target, WrenchComponent
from mbsrun.quantities import SIGNAL

LONGEST = 12  # parts of one line; more are counted


def describe_problem(problem: Problem, manifest: Manifest) -> dict[str, str]:
    """Return the parts of a problem by their names; parts that it does not have are left out."""
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    method = choose(problem.solver, calls_casadi=bool(problem.functions))
    rows = {
        "model": f"{manifest.model}: coordinates {_list(manifest.positions)}; "
        f"inputs {_list(manifest.coordinates[i].name for i in manifest.actuated)}; sensors {_list(sensors)}",
        "horizon": _describe_horizon(problem),
        "grid": _describe_grid(problem),
        "cost": _list(_list_terms(problem)),
        "start": _list(_list_start(problem, manifest)),
        "end": _list(_list_end(problem, manifest)),
        "bounds": _list(_list_bounds(problem, manifest)),
        "constraints": _list(
            _write_range(_name(c.expression, problem), c.range) + (f" ({c.at})" if c.at != "path" else "")
            for c in problem.constraints
            if not c.name
        ),
        **_describe_additions(problem, manifest),
        "constants": _list(f"{name} = {value:g}" for name, value in problem.constants),
        "solver": f"{method}, tolerance {problem.solver.tolerance:g}",
    }
    return {name: value for name, value in rows.items() if value != NOTHING}


NOTHING = "none"


def _describe_additions(problem: Problem, manifest: Manifest) -> dict[str, str]:
    """Describe states, controls, unknowns, integrals and references of the problem, and values of parameters."""
    inputs = [f"u_{manifest.coordinates[i].name}" for i in manifest.actuated]
    return {
        "states": _list(f"{x.name}' = {_name(x.rate, problem)}" for x in problem.states),
        "controls": _list(_write_range(x.name, x.bounds) for x in problem.controls),
        "delays": _list(_describe_delay(x, inputs, problem) for x in problem.delays),
        "driven": _list(f"{manifest.coordinates[x.joint].name} = {x.expression}" for x in problem.driven),
        "forces": _list(f"{inputs[x.input]} = {x.expression}" for x in problem.forces),
        "wrenches": _list(map(_describe_component, problem.wrenches)),
        "contacts": _list(x.sensor for x in problem.contacts),
        "unknowns": _list(_write_range(x.name, x.bounds) for x in problem.unknowns),
        "integrals": _list(_write_range(_name(x.expression, problem), x.range) for x in problem.integrals),
        "parameters": _list(f"{name} = {value:g}" for name, value in problem.parameters),
        "references": _list(x.name for x in problem.references),
    }


def _describe_delay(delay: Delay, inputs: Sequence[str], problem: Problem) -> str:
    name = inputs[delay.index] if delay.kind == "input" else problem.controls[delay.index].name
    before = "free" if delay.history is None else f"{delay.history:g}"
    return f"{name} by {delay.seconds:g} s, {before} before"


def _list(parts: Iterable[str]) -> str:
    """Join parts; of many, the first."""
    every = list(parts)
    if len(every) > LONGEST:
        every = [*every[:LONGEST], f"and {len(every) - LONGEST} more"]
    return ", ".join(every) or NOTHING


def _describe_horizon(problem: Problem) -> str:
    if problem.horizon_range is None:
        return f"{problem.horizon:g} s"
    return f"free, {_write_range('T', problem.horizon_range)}, guess {problem.horizon:g} s"


def _describe_grid(problem: Problem) -> str:
    way = f", {problem.integrator}, {problem.steps} steps" if problem.form is Form.SHOOTING else ""
    return (
        f"{problem.intervals} intervals, {problem.family.value} points of degree {problem.degree}, "
        f"form {problem.form.value}{way}, {problem.representation.value}"
    )


def _describe_component(component: WrenchComponent) -> str:
    if component.component == SIGNAL:
        name = f"signal_{component.wrench}"
    else:
        name = f"{'fm'[component.component // 3]}{'xyz'[component.component % 3]}_{component.wrench}"
    return _write_range(name, component.bounds) if component.expression is None else f"{name} = {component.expression}"


def _name(expression: str, problem: Problem) -> str:
    """Return an expression; or, of the name of a function in CasADi, its text."""
    return next((function.text for function in problem.functions if function.name == expression), expression)


def _list_terms(problem: Problem) -> list[str]:
    terms = zip(problem.cost.weights, problem.cost.names, strict=True)
    first = 2 + len(problem.cost.running)
    at_end = range(first, first + len(problem.cost.terminal))
    return [
        f"{weight:g} * {_name(name, problem)}{' (end)' if i in at_end else ''}"
        for i, (weight, name) in enumerate(terms)
        if weight
    ]


def _list_start(problem: Problem, manifest: Manifest) -> list[str]:
    names = [f"q_{name}" for name in manifest.positions] + [f"qd_{c.name}" for c in manifest.coordinates]
    values = (*problem.start_q, *problem.start_qd)
    given = [
        f"{name} free" if i in problem.free_start else f"{name} = {value:g}"
        for i, (name, value) in enumerate(zip(names, values, strict=True))
        if value or i in problem.free_start
    ]
    rest = "the rest 0" if given else "all 0"
    return [*given, rest] if len(given) < len(values) else given


def _list_end(problem: Problem, manifest: Manifest) -> list[str]:
    end, names = problem.end, [c.name for c in manifest.coordinates]
    return [
        *(f"{name} at ({_write_target(target)})" for name, target in end.sensors),
        *(f"{name} turned: {_write_aims(aims)}" for name, aims in end.orientations),
        *(f"q_{manifest.positions[i]} = {value:g}" for i, value in end.coordinates),
        *(["velocity 0"] if end.velocity_zero else []),
        *(["acceleration 0"] if end.acceleration_zero else []),
        *(f"qd_{names[i]} = {value:g}" for i, value in end.velocities),
        *(f"qdd_{names[i]} = {value:g}" for i, value in end.accelerations),
        *(f"{name} moves at ({_write_target(velocity)})" for name, velocity in end.sensor_velocities),
    ]


def _write_aims(aims: Aims) -> str:
    return ", ".join(f"{'xyz'[k]} along ({_write_target(direction)})" for k, direction in aims)


def _list_bounds(problem: Problem, manifest: Manifest) -> list[str]:
    names = [c.name for c in manifest.coordinates]
    every = (
        *zip((f"q_{name}" for name in manifest.positions), problem.bounds.q, strict=True),
        *zip((f"qd_{name}" for name in names), problem.bounds.qd, strict=True),
        *zip((f"u_{names[i]}" for i in manifest.actuated), problem.bounds.u, strict=True),
        *(
            (f"rate of u_{names[i]}", limits)
            for i, limits in zip(manifest.actuated, problem.bounds.rates, strict=False)
        ),
        *((f"rate of {control.name}", control.rates) for control in problem.controls),
    )
    return [_write_range(name, limits) for name, limits in every if limits != (-math.inf, math.inf)]


def _write_range(name: str, limits: Range) -> str:
    """Write `lower <= name <= upper`, without the side that is not bounded."""
    lower, upper = limits
    if lower == upper:
        return f"{name} = {lower:g}"
    before = "" if lower == -math.inf else f"{lower:g} <= "
    after = "" if upper == math.inf else f" <= {upper:g}"
    return f"{before}{name}{after}"


def _write_target(target: Target) -> str:
    return ", ".join("free" if x is None else f"{x:g}" for x in target)
