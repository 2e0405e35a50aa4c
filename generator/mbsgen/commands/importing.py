"""The argument MODEL, a model file or a file in another format, and the options of its import."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import click

from mbsgen.importing import Choices, Mimic, Notice, import_model, is_foreign, list_formats
from mbsgen.model.model import Model
from mbsgen.robots import OPTIONS as ROBOT
from mbsgen.robots import option as robot_option
from mbsgen.robots import read_finite, read_locks

MODEL = click.argument("model", type=click.Path(path_type=Path))

_IMPORTING = (
    robot_option("--name", help="The model's name; by default, the name in the file."),
    *ROBOT,
    robot_option("--gravity", metavar="X,Y,Z", help="In m/s2; by default, the file's own, or 0,0,-9.81."),
    robot_option("--quaternions", is_flag=True, help="Give balls and free bodies quaternions, not turns in a row."),
    robot_option(
        "--friction-speed",
        type=click.FloatRange(0, 1e6, min_open=True),
        default=Choices.friction_speed,
        show_default=True,
        help="The speed at which dry friction reaches 3/4 of its force, rad/s or m/s.",
    ),
    robot_option("--dry-friction", is_flag=True, help="Let joints stick and slide, in simulations alone."),
    robot_option(
        "--stops",
        type=click.FloatRange(0, 1),
        metavar="E",
        help="Stop joints at their limits in simulations, with this restitution.",
    ),
    robot_option(
        "--contacts",
        type=click.FloatRange(0, 1),
        metavar="E",
        help="Let the geoms of MJCF touch rigidly, with this restitution.",
    ),
    robot_option(
        "--contacts-of",
        type=click.Choice(("all", "planes")),
        default="all",
        show_default=True,
        help="Which pairs of geoms touch: all that may, or the ones with planes alone.",
    ),
    robot_option(
        "--quarter-turns",
        type=click.FloatRange(0, 0.01),
        default=Choices.quarter_turns,
        show_default=True,
        help="Round angles within this distance of a quarter turn to it, rad.",
    ),
    robot_option("--allow-unphysical", is_flag=True, help="Accept inertias that no body can have."),
    robot_option(
        "--root",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
        help="The folder of meshes and other files that MODEL refers to; by default, MODEL's own folder.",
    ),
)


def importing(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of files that are imported; the command gets them as `choices`."""

    @functools.wraps(command)
    def call(
        *,
        model: Path,
        name: str | None,
        base: Literal["fixed", "floating"],
        gravity: str | None,
        sensors: tuple[str, ...],
        opened: tuple[str, ...],
        rigid_tendons: bool,
        degroote: bool,
        locks: tuple[str, ...],
        lock_massless: bool,
        mimic: Mimic,
        loop_tolerance: float | None,
        quaternions: bool,
        friction_speed: float,
        dry_friction: bool,
        stops: float | None,
        contacts: float | None,
        contacts_of: Literal["all", "planes"],
        quarter_turns: float,
        allow_unphysical: bool,
        root: Path | None,
        **own: object,
    ) -> None:
        choices = Choices(
            name=name,
            base=base,
            gravity=None if gravity is None else _read_gravity(gravity),
            sensors=tuple(dict.fromkeys(sensors)),
            opened=tuple(dict.fromkeys(opened)),
            rigid_tendons=rigid_tendons,
            degroote=degroote,
            locked=read_locks(locks),
            lock_massless=lock_massless,
            mimic=mimic,
            loop_tolerance=loop_tolerance,
            quaternions=quaternions,
            friction_speed=friction_speed,
            dry_friction=dry_friction,
            stops=stops,
            contacts=contacts,
            contacts_of=contacts_of,
            quarter_turns=quarter_turns,
            allow_unphysical=allow_unphysical,
            root=root,
        )
        if choices != Choices() and not is_foreign(model):
            raise click.UsageError(
                f"{model} is a model file: --name, --base, --lock and the like are for files of {list_formats()}"
            )
        command(model=model, choices=choices, **own)

    for option in reversed(_IMPORTING):
        call = option(call)
    return call


def read_model(model: Path, choices: Choices) -> Path | Model:
    """Import a foreign model and print its notices; return the path of any other model."""
    if not is_foreign(model):
        return model
    imported = import_model(model, choices)
    tell(imported.notices)
    return imported.model


def tell(notices: Sequence[Notice]) -> None:
    """Print the notices of an import."""
    for notice in notices:
        click.echo(str(notice), err=True)


def _read_gravity(text: str) -> tuple[float, float, float]:
    values = [read_finite(word) for word in text.split(",")]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise click.BadParameter(
            f"{text!r} is not three numbers; write, for example, 0,0,-9.81", param_hint="--gravity"
        )
    x, y, z = values
    return x, y, z
