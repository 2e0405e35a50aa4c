"""Options of commands that take a robot's file (URDF, MJCF, SDF) for a model."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from mbsgen.robots import OPTIONS, read_locks
from mbsrun.commands.console import say
from mbsrun.models import import_robot


def accept_robots(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of robots' files; where some are given, the command gets the path of the imported model."""

    @functools.wraps(command)
    def call(
        *,
        model: Path,
        base: str,
        sensors: tuple[str, ...],
        opened: tuple[str, ...],
        rigid_tendons: bool,
        degroote: bool,
        locks: tuple[str, ...],
        lock_massless: bool,
        mimic: str,
        loop_tolerance: float | None,
        **own: Any,
    ) -> None:
        context = click.get_current_context()
        options = (
            "base",
            "sensors",
            "opened",
            "rigid_tendons",
            "degroote",
            "locks",
            "lock_massless",
            "mimic",
            "loop_tolerance",
        )
        if any(context.get_parameter_source(option) is ParameterSource.COMMANDLINE for option in options):
            choices = {
                "base": base,
                "sensors": tuple(dict.fromkeys(sensors)),
                "opened": tuple(dict.fromkeys(opened)),
                "rigid_tendons": rigid_tendons,
                "degroote": degroote,
                "locked": read_locks(locks),
                "lock_massless": lock_massless,
                "mimic": mimic,
                "loop_tolerance": loop_tolerance,
            }
            model, warnings = import_robot(model, choices)
            for warning in warnings:
                say(warning)
        command(model=model, **own)

    for option in reversed(OPTIONS):
        call = option(call)
    return call
