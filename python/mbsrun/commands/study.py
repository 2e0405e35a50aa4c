"""The command `mbsrun study`."""

from __future__ import annotations

import click

from mbsrun.commands.studies import run_study


@click.command("study", add_help_option=False, context_settings={"ignore_unknown_options": True})
@click.argument("arguments", metavar="PROBLEM", nargs=-1, type=click.UNPROCESSED)
def study_command(arguments: tuple[str, ...]) -> None:
    """Pass all arguments to the study of a paper, in the folder `studies/docquier`."""
    run_study("docquier", "study", arguments)
