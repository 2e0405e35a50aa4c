"""The command `mbsrun lab`."""

from __future__ import annotations

import click

from mbsrun.commands.studies import run_study


@click.command("lab", add_help_option=False, context_settings={"ignore_unknown_options": True})
@click.argument("arguments", metavar="[CASES | MODEL]...", nargs=-1, type=click.UNPROCESSED)
def lab_command(arguments: tuple[str, ...]) -> None:
    """Pass all arguments to the laboratory, in the folder `studies/laboratory`."""
    run_study("laboratory", "lab", arguments)
