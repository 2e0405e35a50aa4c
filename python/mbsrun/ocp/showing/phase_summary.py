"""The summary of a solution in phases: what a command prints, and the shortcomings of each phase."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.guessing.starts import describe_starts
from mbsrun.ocp.showing.summary import (
    list_program,
    list_sensitivities,
    list_shortcomings,
    name_unknown,
    number_names,
    summarise,
)
from mbsrun.ocp.solution.phases import LinkValues, PhasedSolution


def summarise_phases(solution: PhasedSolution) -> dict[str, str]:
    """Return the lines of a summary by their names."""
    if solution.problem.is_single:
        return summarise(solution.single) | dict(_list_followed(solution))
    return number_names(_list_lines(solution))


def _list_followed(solution: PhasedSolution) -> Iterator[tuple[str, str]]:
    for followed in solution.followed:
        yield "sequence", followed.describe()


def _list_lines(solution: PhasedSolution) -> Iterator[tuple[str, str]]:
    """List the lines of a summary."""
    yield "problem", f"{solution.name}, {_count(len(solution.phases), 'phase')}"
    yield from list_program(solution.run, solution.size, ("duration", f"{sum(solution.durations):.10g} s"))
    yield "cost", f"{solution.cost:.10g}"
    if solution.search is not None:
        yield "starts", describe_starts(solution.search)
    for unknown, value in zip(solution.unknowns, solution.unknown_values, strict=True):
        yield name_unknown(unknown.name), f"{value:.10g}"
    yield from list_sensitivities(solution.sensitivities)
    for name, phase in zip(solution.names, solution.phases, strict=True):
        yield f"phase {name}", f"model {phase.model}"
        yield from ((f"{name}: {key.strip()}", text) for key, text in summarise(phase).items() if _is_kept(key))
    for values in solution.values:
        yield f"link {values.source} to {values.target}", f"violation {values.violation:.1e}"
        yield from ((f"  {name} ", f"{value:.10g}") for name, value in values.terms if value)
        yield from _list_impulses(values)
    yield from _list_followed(solution)


KEPT = ("horizon", "cost", "violation", "loops", "closure", "intervals", "refinement", "slip")
KEPT_CHECKS = ("complementarity", "defect", "open loop", "between")


def _is_kept(key: str) -> bool:
    return key.strip() in (*KEPT, *KEPT_CHECKS) or key.strip().startswith("round ") or key.startswith("slack of ")


def _list_impulses(values: LinkValues) -> Iterator[tuple[str, str]]:
    for impulse in values.impulses:
        yield f"  impulse of {impulse.sensor} ", f"{', '.join(f'{x:.6g}' for x in impulse.components)} N s"
    for joint, value in values.stops:
        yield f"  impulse of the stop of {joint} ", f"{value:.6g}"


def list_phased_shortcomings(solution: PhasedSolution) -> list[str]:
    """List the shortcomings of a solution: its tolerance, and the accuracy of each phase."""
    differing = [f"the simulation from event to event {x.describe()}" for x in solution.followed if x.finding]
    if solution.problem.is_single:
        return [*list_shortcomings(solution.single), *differing]
    found = differing
    if solution.is_only_acceptable:
        found.append("IPOPT stopped at an acceptable level, short of the tolerance; try another guess or scaling")
    for name, phase in zip(solution.names, solution.phases, strict=True):
        own = replace(phase, run=replace(phase.run, status=SOLVED))  # the status is of all phases
        found += [f"phase {name}: {text}" for text in list_shortcomings(own)]
    return found


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"
