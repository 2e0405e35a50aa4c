"""Further columns of tables, by names or patterns that an option gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import click

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem
from mbsrun.quantities import list_quantities
from mbsrun.results import Numbers

F = TypeVar("F", bound=Callable[..., object])


def _split(_: click.Context, __: click.Parameter, given: Sequence[str]) -> tuple[str, ...]:
    """Return the names of all options in order; commas part them."""
    return tuple(name for text in given for name in (part.strip() for part in text.split(",")) if name)


def more_columns(command: F) -> F:
    """Add the option to a command."""
    return click.option(
        "--columns",
        multiple=True,
        callback=_split,
        metavar="NAMES",
        help="Further columns of the table, by names or patterns: --columns 'energy,reaction_*'.",
    )(command)


def check_columns(columns: Sequence[str], parts: Sequence[tuple[Problem, Plant]]) -> None:
    """Demand that each name or pattern fits a number of one of some problems. Raises UnknownNameError."""
    known = [Numbers(plant, list_quantities(plant.manifest, problem.added), {}) for problem, plant in parts]
    for column in columns:
        if not any(numbers.select_known([column]) for numbers in known):
            raise known[0].refuse(column)
