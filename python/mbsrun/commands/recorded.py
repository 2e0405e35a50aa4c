"""Options that the commands on recordings share."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsrun.commands.console import NumberType
from mbsrun.kernel import Kernels
from mbsrun.recordings import Recording
from mbsrun.simulation.recorded import Load

Array = NDArray[np.float64]

F = TypeVar("F", bound=Callable[..., object])

_TIMES = (
    click.option("--from", "start", type=NumberType(), metavar="T", help="The first time of the recording [s]."),
    click.option("--until", "end", type=NumberType(), metavar="T", help="The last one [s]."),
    click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A run-time parameter."),
)


def recording_options(command: F) -> F:
    """Add the options of times and parameters to a command."""
    return reduce(lambda function, option: option(function), reversed(_TIMES), command)


def cut(recording: Recording, start: float | None, end: float | None) -> Recording:
    """Keep the requested part of a recording."""
    kept = recording.cut(-np.inf if start is None else start, np.inf if end is None else end)
    if len(kept.times) < 2:
        first, last = recording.times[[0, -1]]
        told = f"{len(kept.times)} samples are left; the recording is from {first:g} to {last:g} s"
        raise click.BadParameter(told, param_hint="--from and --until")
    return kept


def split_pairs(option: str, pairs: Sequence[str], known: Collection[str] | None = None) -> dict[str, str]:
    """Split NAME=TEXT, each name once; with `known`, names must be among them."""
    found: dict[str, str] = {}
    for pair in pairs:
        name, sign, text = (part.strip() for part in pair.partition("="))
        if not (name and sign and text) or name in found or (known is not None and name not in known):
            among = "" if known is None else f", for some of {', '.join(known) or 'none'}"
            raise click.BadParameter(
                f"found {pair!r}; give NAME=VALUE, each name once{among}", param_hint=f"--{option}"
            )
        found[name] = text
    return found


def read_numbers(option: str, pairs: Sequence[str], known: Collection[str] | None = None) -> dict[str, float]:
    """Read NAME=NUMBER, each name once."""
    found = {}
    for name, text in split_pairs(option, pairs, known).items():
        try:
            found[name] = evaluate(parse(text), {}, FLOATS)
        except ExpressionError as error:
            raise click.BadParameter(f"{name}: {error}", param_hint=f"--{option}") from None
    return found


def set_parameters(kernels: Kernels, pairs: Sequence[str]) -> dict[str, float]:
    """Read values of the model's parameters."""
    return read_numbers("parameter", pairs, list(kernels.parameters))


def read_loads(text: str) -> Load:
    """Read FORCE[,POINT[,MOMENT]]; a part may be empty."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) > 3 or not any(parts):
        raise click.BadParameter(
            f"found {text!r}; give FORCE, FORCE,POINT or FORCE,POINT,MOMENT", param_hint="--wrench"
        )
    force, point, moment = (*parts, "", "")[:3]
    return Load(force, point or None, moment or None)


def write_table(path: Path, header: Sequence[str], rows: Array) -> None:
    """Write CSV with every digit; NaN are empty cells."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([["" if np.isnan(x) else x for x in row] for row in rows.tolist()])


def write_json(path: Path, parts: Mapping[str, object]) -> None:
    """Write a summary."""
    path.write_text(json.dumps(parts, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
