"""Options that the commands on recordings share."""

from __future__ import annotations

import csv
import functools
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsrun.commands.animated import equip
from mbsrun.commands.console import NumberType
from mbsrun.external import Mechanism, load
from mbsrun.kernel import Kernels
from mbsrun.models import INTEGRATED
from mbsrun.recordings import Recording, Treatment, read_recording
from mbsrun.simulation.recorded import Load
from mbsrun.smoothness import demand_smooth

Array = NDArray[np.float64]

F = TypeVar("F", bound=Callable[..., object])

_TIMES = (
    click.option("--from", "start", type=NumberType(), metavar="T", help="The first time of the recording [s]."),
    click.option("--until", "end", type=NumberType(), metavar="T", help="The last time [s]."),
    click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A run-time parameter."),
)


def recording_options(command: F) -> F:
    """Add the options of times and parameters to a command."""
    return functools.reduce(lambda function, option: option(function), reversed(_TIMES), command)


_MOTION = (
    click.argument("model", type=click.Path(path_type=Path)),
    click.argument("file", metavar="RECORDING", type=click.Path(path_type=Path)),
    click.option(
        "-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="The folder to write to."
    ),
    click.option("--column", "columns", multiple=True, metavar="NAME=COLUMN", help="The column of a coordinate."),
    click.option(
        "--forces", "other", type=click.Path(path_type=Path), metavar="FILE", help="A recording of the forces."
    ),
    click.option(
        "--wrench",
        "wrenches",
        multiple=True,
        metavar="NAME=FORCE[,POINT[,MOMENT]]",
        help="The recorded columns of an external force.",
    ),
    click.option("--noise", type=NumberType(), metavar="S", help="The standard deviation of the samples [rad, m]."),
    click.option(
        "--cutoff",
        type=NumberType(),
        metavar="F",
        help="The frequency of a low-pass filter, forward and backward [Hz].",
    ),
    click.option(
        "--degree", type=click.Choice(["3", "5"]), default="5", help="The degree of the splines; by default 5."
    ),
    click.option(
        "--gap", type=NumberType(), default=Treatment.gap, metavar="T", help="The longest gap to bridge [s]; 0.1."
    ),
)


@dataclass(frozen=True)
class OpenMotion:
    """A recorded motion, and the mechanism that moves."""

    recording: Recording
    mechanism: Mechanism
    columns: Mapping[str, str]  # of coordinates
    loads: Mapping[str, Load] | None
    load_recording: Recording | None


@dataclass(frozen=True)
class GivenMotion:
    """The arguments of a command on a recorded motion with the forces that act meanwhile."""

    model: Path
    file: Path
    columns: Sequence[str]
    other: Path | None
    wrenches: Sequence[str]
    treatment: Treatment
    start: float | None
    end: float | None
    parameters: Sequence[str]

    def open(self, purpose: str) -> OpenMotion:
        """Read the recordings, and load the model with the parameters of the motion; `purpose` is for messages."""
        recording = cut(read_recording(self.file), self.start, self.end)
        load_recording = None if self.other is None else read_recording(self.other)
        plain = load(self.model, extent=INTEGRATED)
        demand_smooth(plain.manifest, purpose, stops=False)
        given = set_parameters(plain, self.parameters)
        mechanism = equip(plain.with_parameters(**given), self.model, INTEGRATED, self.file, given)
        named = split_pairs("wrench", self.wrenches, [wrench.name for wrench in mechanism.manifest.wrenches])
        return OpenMotion(
            recording,
            mechanism,
            split_pairs("column", self.columns, mechanism.manifest.positions),
            {name: read_loads(text) for name, text in named.items()} or None,
            load_recording,
        )


def accept_motion(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a recorded motion with the forces that act meanwhile; `gather_motion` collects them."""

    @functools.wraps(command)
    def call(*, degree: str, noise: float | None, gap: float, cutoff: float | None, **own: Any) -> None:
        if not (gap >= 0 and (noise is None or noise > 0) and (cutoff is None or cutoff > 0)):
            raise click.UsageError("--noise and --cutoff must be positive, and --gap not negative")
        command(treatment=Treatment(int(degree), noise, gap, cutoff), **own)

    return functools.reduce(lambda function, option: option(function), reversed(_MOTION), recording_options(call))


def gather_motion(command: Callable[..., None]) -> Callable[..., None]:
    """Collect the arguments of a recorded motion in one, `given`; this is the innermost decorator."""
    names = [field.name for field in fields(GivenMotion)]

    @functools.wraps(command)
    def call(**own: Any) -> None:
        command(given=GivenMotion(**{name: own.pop(name) for name in names}), **own)

    return call


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


def write_storage(path: Path, names: Sequence[str], times: Array, rows: Array) -> None:
    """Write a table of OpenSim, .mot or .sto, of coordinates in rad and m, (K, n)."""
    head = [
        "Coordinates",
        "version=1",
        f"nRows={len(times)}",
        f"nColumns={len(names) + 1}",
        "inDegrees=no",
        "endheader",
    ]
    table = ["\t".join(map(repr, row)) for row in np.column_stack((times, rows)).tolist()]
    path.write_text("\n".join([*head, "\t".join(("time", *names)), *table]) + "\n", encoding="utf-8")


def write_json(path: Path, parts: Mapping[str, object]) -> None:
    """Write a summary."""
    path.write_text(json.dumps(parts, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
