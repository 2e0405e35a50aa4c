"""The command line `mbsrun`: one group of commands, and one place where errors become messages."""

from __future__ import annotations

import sys
from importlib.metadata import version

import click

from mbsgen.errors import MbsError
from mbsgen.help import CommandsBySubject
from mbsrun.commands.advise import advise_command
from mbsrun.commands.animate import animate_command
from mbsrun.commands.cache import cache_command
from mbsrun.commands.chart import chart
from mbsrun.commands.console import (
    BAD_INPUT,
    say,
)
from mbsrun.commands.controller import controller_command
from mbsrun.commands.fit_motion import fit_motion_command
from mbsrun.commands.fmu import fmu_command
from mbsrun.commands.inverse import inverse_command
from mbsrun.commands.inverse_dynamics import inverse_dynamics_command
from mbsrun.commands.lab import lab_command
from mbsrun.commands.linearise import linearise_command
from mbsrun.commands.playground import playground_command
from mbsrun.commands.simulate import simulate_command
from mbsrun.commands.solve import solve_command
from mbsrun.commands.study import study_command
from mbsrun.commands.sweep import sweep_command
from mbsrun.commands.track import track_command
from mbsrun.environment import describe_installation

HELP = """Simulate multibody systems, and solve their optimal control problems.

\b
  mbsrun simulate models/cart_pole.yaml --duration 5 --pose pole=2 -o moves
  mbsrun solve models/cart_pole_swing_up.ocp.yaml -o swing_up

MODEL is a YAML file, a file of URDF, MJCF or SDF, or a folder that mbsgen wrote; PROBLEM is a YAML file. models/ holds
examples. `mbsrun COMMAND --help` describes a command. Summaries go to stdout, progress and messages to stderr.
"""

COMMANDS = {
    "Motions": (simulate_command, inverse_command, linearise_command, animate_command),
    "Optimal control": (solve_command, sweep_command),
    "Controllers": (controller_command, track_command),
    "Recorded motions": (fit_motion_command, inverse_dynamics_command),
    "Other programs": (fmu_command, playground_command),
    "Speed and accuracy": (advise_command, chart, lab_command, study_command),
    "Files": (cache_command,),
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
