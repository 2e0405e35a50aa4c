"""Inputs and components of wrenches that expressions give, in an order in which each reads earlier ones alone.

    u_i = a(t, q, qd, states, controls, other u and w),    w_i likewise

In a program they are variables at the points, with these equations. Elsewhere they are computed level by level.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.expressions import ExpressionError
from mbsgen.manifest import Manifest
from mbsrun.ocp.problem.problem import Problem, list_names
from mbsrun.quantities import find_component, list_quantities, name_components


@dataclass(frozen=True)
class Given:
    """An entry of u or w, and the expression of it."""

    place: str  # in a problem
    kind: str  # u or w
    index: int
    expression: str


def list_given(problem: Problem, manifest: Manifest) -> list[Given]:
    """List everything that expressions give."""
    found = [Given(f"forces[{i}]", "u", part.input, part.expression) for i, part in enumerate(problem.forces)]
    for i, part in enumerate(problem.every_component):
        index = find_component(manifest, part.wrench, part.component)
        if part.expression is not None and index is not None:
            found.append(Given(f"wrenches[{i}]", "w", index, part.expression))
    return found


def order_given(problem: Problem, manifest: Manifest) -> tuple[list[list[Given]], list[Given]]:
    """Return the levels, of which each reads earlier ones alone; and the ones that read each other in a circle."""
    left = list_given(problem, manifest)
    read = {part: _read(part, problem, manifest) for part in left}
    levels: list[list[Given]] = []
    while left:
        open_ones = {(part.kind, part.index) for part in left}
        level = [part for part in left if not read[part] & open_ones]
        if not level:
            return levels, left
        levels.append(level)
        left = [part for part in left if part not in level]
    return levels, []


def find_faults(problem: Problem, manifest: Manifest) -> Iterator[tuple[str, str, str]]:
    """Find expressions that read accelerations or forces of driven joints, which depend on them, or go in a circle."""
    for part in list_given(problem, manifest):
        kinds = {kind for kind, _ in _read(part, problem, manifest)}
        if kinds & {"qdd", "tau"}:
            named = "accelerations" if "qdd" in kinds else "forces of driven joints"
            finding = f"the expression reads {named}, which depend on it"
            yield (f"{part.place}.expression", finding, "write it by coordinates, velocities and states")
    for part in order_given(problem, manifest)[1]:
        yield (f"{part.place}.expression", "expressions that read each other in a circle", "let one read states alone")


def list_open_components(problem: Problem, manifest: Manifest) -> list[str]:
    """Name the components of open wrenches that have no value in a problem."""
    known = {find_component(manifest, part.wrench, part.component) for part in problem.every_component}
    names = enumerate(name_components(manifest))
    return [name or f"component {i} of w" for i, name in names if i not in known]


def _read(part: Given, problem: Problem, manifest: Manifest) -> frozenset[tuple[str, int]]:
    """Return kind and index of the quantities that an expression reads; none where it cannot be read."""
    known = list_quantities(manifest, problem.added)
    try:
        read = list_names(part.expression, problem.functions)
    except ExpressionError:
        return frozenset()
    return frozenset((known[name].kind, known[name].index) for name in read if name in known)


def place_unknown(problem: Problem, manifest: Manifest) -> Mapping[int, float]:
    """Return the guess of each entry of w that is unknown."""
    found: dict[int, float] = {}
    for part in problem.every_component:
        index = find_component(manifest, part.wrench, part.component)
        if part.expression is None and index is not None:
            found[index] = min(max(part.guess, part.bounds[0]), part.bounds[1])
    return found


def list_texts(levels: Sequence[Sequence[Given]]) -> list[list[str]]:
    """Return the expressions of all levels."""
    return [[part.expression for part in level] for level in levels]
