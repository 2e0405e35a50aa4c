"""The command line `mbsrun`: one group of commands, and one place where errors become messages."""

from __future__ import annotations

import sys
from importlib.metadata import version

import click

from mbsgen.errors import MbsError
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
  mbsrun simulate MODEL -o DIR  integrate a motion, and write it, plots and an animation to DIR
  mbsrun inverse MODEL -o FILE  compute the forces that a given motion takes, as a table
  mbsrun fit-motion MODEL RECORDING  fit the motion of joints to recorded markers
  mbsrun inverse-dynamics MODEL RECORDING  compute the forces that a recorded motion takes
  mbsrun linearise MODEL        find linear equations, modes and transfer functions about a pose at rest
  mbsrun animate MODEL MOTION... -o FILE  write a page, a GIF, a picture or an MP4
  mbsrun solve PROBLEM -o DIR   solve, and write solution and pictures to DIR
  mbsrun sweep PROBLEM -o FILE  solve for a grid of targets, by a protocol, and print its effort
  mbsrun controller PROBLEM -o DIR  write a controller in C: solves, and steps in real time
  mbsrun track PROBLEM -o DIR   control a simulated plant by solving from every measured state
  mbsrun study PROBLEM          solve for all targets, formulations and costs of a paper, and report
  mbsrun chart kernels MODEL    draw speed against accuracy of kernels, or of simulation
  mbsrun advise MODEL           recommend the fastest choices for a model, at an accuracy
  mbsrun fmu MODEL -o FILE      write a functional mock-up unit (FMI 2.0, 3.0)
  mbsrun playground MODEL -o FILE  write a page on which the model moves, computed by its own C
  mbsrun lab                    run the cases in which methods fail, and judge
  mbsrun cache                  list generated and compiled files, or clear them

MODEL and PROBLEM are YAML files; models/ holds examples. Summaries go to stdout, progress and messages to stderr.
"""


COMMANDS = (
    simulate_command,
    inverse_command,
    fit_motion_command,
    inverse_dynamics_command,
    linearise_command,
    solve_command,
    sweep_command,
    animate_command,
    track_command,
    controller_command,
    study_command,
    chart,
    advise_command,
    lab_command,
    playground_command,
    fmu_command,
    cache_command,
)


def _show_versions(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print everything that was found: versions, compiler, cache."""
    if asked and not ctx.resilient_parsing:
        click.echo(f"mbsrun, version {version('mbsgen')}")
        for name, text in describe_installation().items():
            click.echo(f"{name:<12}{text}")
        ctx.exit()


@click.group(
    help=HELP,
    commands=COMMANDS,
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
