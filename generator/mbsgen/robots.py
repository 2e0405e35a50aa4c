"""Options for robots' files (URDF, MJCF, SDF) that the command lines of mbsgen and mbsrun share."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable

import click

from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsgen.help import RobotOption

option = functools.partial(click.option, cls=RobotOption)
OPTIONS = (
    option(
        "--base",
        type=click.Choice(["fixed", "floating"]),
        default="fixed",
        show_default=True,
        help="Fix URDF's root link, or let it float.",
    ),
    option("--sensor", "sensors", multiple=True, metavar="NAME", help="A link, body or site to become a frame."),
    option(
        "--open", "opened", multiple=True, metavar="NAME", help="Give a body a sensor, and a wrench that is an input."
    ),
    option("--rigid-tendons", is_flag=True, help="Give muscles rigid tendons, whatever the file says."),
    option("--degroote", is_flag=True, help="Give muscles the curves of De Groote, whatever the file says."),
    option("--lock", "locks", multiple=True, metavar="JOINT=VALUE", help="Hold a joint at a coordinate."),
    option("--lock-massless", is_flag=True, help="Hold at 0 the joints that move nothing, and list them."),
    option(
        "--mimic",
        type=click.Choice(["couple", "lock", "free"]),
        default="couple",
        show_default=True,
        help="Couple joints that follow others, lock them where the others are at 0, or make them independent.",
    ),
    option(
        "--loop-tolerance",
        type=click.FloatRange(0, 0.005),
        help="The violation up to which an equation of a loop counts as redundant; by default, by the file's digits.",
    ),
)


def read_locks(pairs: Iterable[str]) -> tuple[tuple[str, float], ...]:
    """Read the values JOINT=VALUE of --lock. Raises BadParameter."""
    return tuple(map(_read_lock, pairs))


def _read_lock(text: str) -> tuple[str, float]:
    name, sign, written = text.rpartition("=")
    value = read_finite(written)
    if not sign or not math.isfinite(value):
        raise click.BadParameter(
            f"{text!r} gives no joint a number; write, for example, finger=0.02", param_hint="--lock"
        )
    return name.strip(), value


def read_finite(text: str) -> float:
    """Read a number, or an expression such as `30 deg`; nan for anything else."""
    try:
        return evaluate(parse(text), {}, FLOATS)
    except ExpressionError:
        return math.nan
