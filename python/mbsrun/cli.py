"""The command line `mbsrun`: one group of commands, and one place where errors become messages."""

from __future__ import annotations

import atexit
import gc
import sys

import click

from mbsgen.errors import MbsError
from mbsgen.help import CommandsBySubject, CommandsOnDemand, Entry
from mbsgen.quick_classes import quick_data_classes
from mbsgen.quick_imports import quick_imports
from mbsgen.style import spare_docstrings

BAD_INPUT = 2  # exit code: an unacceptable file or argument

HELP = """Simulate multibody systems, and solve their optimal control problems.

\b
  mbsrun simulate models/cart_pole.yaml --duration 5 --pose pole=2 -o moves
  mbsrun solve models/cart_pole_swing_up.ocp.yaml -o swing_up

MODEL is a YAML file, a file of URDF, MJCF, SDF or OpenSim, or a folder that mbsgen wrote; PROBLEM is a YAML file. The
folder models/ contains examples. `mbsrun COMMAND --help` describes a command. Results are printed to stdout, progress
and messages to stderr.
"""

COMMANDS = {
    "Motions": (
        Entry("simulate", "MODEL", "Integrate a motion; write it with an animation."),
        Entry("inverse", "MODEL", "Compute the forces that a given motion takes."),
        Entry("range", "MODEL", "Find how far the joints can move."),
        Entry("linearise", "MODEL", "Find linear equations, modes and poles about a pose."),
        Entry("animate", "MODEL", "Write motions as a page, a GIF, a picture or an MP4."),
    ),
    "Optimal control": (
        Entry("solve", "PROBLEM", "Find an optimal motion; write it with an animation."),
        Entry("continue", "PROBLEM", "Go from an easy problem to a hard one, in steps."),
        Entry("sweep", "PROBLEM", "Solve for many targets, or many values of numbers."),
    ),
    "Controllers": (
        Entry("controller", "PROBLEM", "Write a model predictive controller in C."),
        Entry("track", "PROBLEM", "Test predictive control on a simulated mechanism."),
    ),
    "Recorded motions": (
        Entry("scale", "SUBJECT", "Fit a model to a subject, by markers or a table."),
        Entry("fit-motion", "MODEL", "Fit the motion of joints to recorded markers (ik)."),
        Entry("inverse-dynamics", "MODEL", "Compute the forces of a recorded motion (id)."),
        Entry("so", "MODEL", "Find the muscles' activations of a recorded motion."),
        Entry("excite", "MODEL", "Design motions that determine inertias."),
        Entry("identify", "MODEL", "Find inertias and frictions from recorded torques."),
    ),
    "Other programs": (
        Entry("cuda", "MODEL", "Compile kernels for a GPU; print their registers."),
        Entry("fmu", "MODEL", "Write a functional mock-up unit of FMI 2.0 or 3.0."),
        Entry("playground", "MODEL", "Write a page on which the mechanism moves."),
    ),
    "Speed and accuracy": (
        Entry("advise", "MODEL", "Recommend the fastest choice for an accuracy."),
        Entry("chart", "", "Measure speed against accuracy, and draw it."),
        Entry("lab", "[CASES]...", "Run cases in which methods fail, or map a model."),
        Entry("study", "PROBLEM", "Repeat the study of a paper, and write a report."),
    ),
    "Files": (Entry("cache", "", "List generated and compiled files, or remove them."),),
}


def _show_versions(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print everything that was found: versions, compiler, cache."""
    if asked and not ctx.resilient_parsing:
        from importlib.metadata import version  # both take a while to load

        from mbsrun.environment import describe_installation

        click.echo(f"mbsrun, version {version('mbsgen')}")
        for name, text in describe_installation().items():
            click.echo(f"{name:<12}{text}")
        ctx.exit()


@click.group(
    cls=CommandsBySubject,
    help=HELP,
    subjects=COMMANDS,
    others={"ik": "fit-motion", "id": "inverse-dynamics"},
    commands=CommandsOnDemand("mbsrun.commands", (entry for entries in COMMANDS.values() for entry in entries)),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_versions, help="Show versions."
)
def cli() -> None:
    """Simulate, and solve optimal control problems: `mbsrun`."""


def main() -> None:
    """Run the command line; print a user's errors without a traceback."""
    # Searches for cycles of objects take up to a tenth of a solve: modules alone are 200,000 objects.
    gc.set_threshold(500_000, 20, 20)
    atexit.register(gc.freeze)  # the last search of a process, whose memory is given back as a whole
    spare_docstrings()
    try:
        with quick_data_classes(), quick_imports():
            cli()
    except MbsError as error:
        click.echo(str(error), err=True)
        sys.exit(BAD_INPUT)
    except OSError as error:
        click.echo(f"{error.filename}: {error.strerror}" if error.filename else str(error), err=True)
        sys.exit(BAD_INPUT)
