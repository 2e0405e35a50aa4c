"""The command line `mbsrun`: one group of commands, and one place where errors become messages."""

from __future__ import annotations

import sys
from importlib.metadata import version

import click

from mbsgen.errors import MbsError
from mbsgen.help import CommandsBySubject, CommandsOnDemand
from mbsrun.commands.console import BAD_INPUT, say
from mbsrun.environment import describe_installation

HELP = """Simulate multibody systems, and solve their optimal control problems.

\b
  mbsrun simulate models/cart_pole.yaml --duration 5 --pose pole=2 -o moves
  mbsrun solve models/cart_pole_swing_up.ocp.yaml -o swing_up

MODEL is a YAML file, a file of URDF, MJCF or SDF, or a folder that mbsgen wrote; PROBLEM is a YAML file. models/ holds
examples. `mbsrun COMMAND --help` describes a command. Summaries go to stdout, progress and messages to stderr.
"""

COMMANDS = {
    "Motions": ("simulate", "inverse", "linearise", "animate"),
    "Optimal control": ("solve", "sweep"),
    "Controllers": ("controller", "track"),
    "Recorded motions": ("fit-motion", "inverse-dynamics"),
    "Other programs": ("fmu", "playground"),
    "Speed and accuracy": ("advise", "chart", "lab", "study"),
    "Files": ("cache",),
}


def _show_versions(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print everything that was found: versions, compiler, cache."""
    if asked and not ctx.resilient_parsing:
        click.echo(f"mbsrun, version {version('mbsgen')}")
        for name, text in describe_installation().items():
            click.echo(f"{name:<12}{text}")
        ctx.exit()


@click.group(
    cls=CommandsBySubject,
    help=HELP,
    subjects=COMMANDS,
    commands=CommandsOnDemand("mbsrun.commands", (name for names in COMMANDS.values() for name in names)),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_versions, help="Show versions."
)
def cli() -> None:
    """Simulate, and solve optimal control problems: `mbsrun`."""


def main() -> None:
    """Run the command line; print a user's errors without a traceback."""
    try:
        cli()
    except MbsError as error:
        say(str(error))
        sys.exit(BAD_INPUT)
    except OSError as error:
        say(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        sys.exit(BAD_INPUT)
