"""The summary of a solution in phases: what a command prints, and the shortcomings of each phase."""

from __future__ import annotations

from dataclasses import replace

from mbsrun.ocp.multistart import describe_starts
from mbsrun.ocp.phases.solution import LinkValues, PhasedSolution
from mbsrun.ocp.status import SOLVED
from mbsrun.ocp.summary import describe_run, list_shortcomings, summarise


def summarise_phases(solution: PhasedSolution) -> dict[str, str]:
    """Return the lines of a summary by their names."""
    run, size = solution.run, solution.size
    rows = {
        "problem": f"{solution.name}, {_count(len(solution.phases), 'phase')}",
        "status": describe_run(run),
        "time": f"{run.seconds:.2f} s",
        "  processor": f"{run.cpu_seconds:.2f} s: {run.cpu_seconds_evaluating:.2f} s for functions and derivatives, "
        f"{run.cpu_seconds_solving:.2f} s for linear algebra and the rest",
        "duration": f"{sum(solution.durations):.10g} s",
        "program": f"{size.variables} variables, {size.constraints} constraints",
        "nonzeros": f"{size.jacobian_nonzeros} in the Jacobian, {size.hessian_nonzeros} in the Hessian's triangle",
        "cost": f"{solution.cost:.10g}",
    }
    if solution.search is not None:
        rows["starts"] = describe_starts(solution.search)
    for unknown, value in zip(solution.unknowns, solution.unknown_values, strict=True):
        rows[unknown.name] = f"{value:.10g}"
    for name, phase in zip(solution.names, solution.phases, strict=True):
        rows[f"phase {name}"] = f"model {phase.model}"
        own = summarise(phase)
        rows |= {f"{name}: {key.strip()}": text for key, text in own.items() if _is_kept(key)}
    for values in solution.values:
        rows[f"link {values.source} to {values.target}"] = f"violation {values.violation:.1e}"
        rows |= {f"  {name} ": f"{value:.10g}" for name, value in values.terms if value}
        rows |= _list_impulses(values)
    return rows


KEPT = ("horizon", "cost", "violation", "loops", "closure", "intervals", "refinement", "slip")
KEPT_CHECKS = ("complementarity", "defect", "open loop")


def _is_kept(key: str) -> bool:
    return key.strip() in (*KEPT, *KEPT_CHECKS) or key.strip().startswith("round ") or key.startswith("slack of ")


def _list_impulses(values: LinkValues) -> dict[str, str]:
    return {
        f"  impulse of {impulse.sensor}": f"{', '.join(f'{x:.6g}' for x in impulse.components)} N s"
        for impulse in values.impulses
    }


def list_phased_shortcomings(solution: PhasedSolution) -> list[str]:
    """List the shortcomings of a solution: its tolerance, and the accuracy of each phase."""
    found = []
    if solution.is_only_acceptable:
        found.append("IPOPT stopped at an acceptable level, short of the tolerance; try another guess or scaling")
    for name, phase in zip(solution.names, solution.phases, strict=True):
        own = replace(phase, run=replace(phase.run, status=SOLVED))  # the status is of all phases
        found += [f"phase {name}: {text}" for text in list_shortcomings(own)]
    return found


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"
