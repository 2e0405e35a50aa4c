"""The command line `mbsgen`: a model file in; a folder of C, a report, a picture or a result of a check out."""

from __future__ import annotations

import atexit
import difflib
import gc
import io
import sys
import warnings
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from mbsgen import __version__
from mbsgen.errors import MbsError
from mbsgen.help import CommandsBySubject, CommandsOnDemand, Entry
from mbsgen.quick_classes import quick_data_classes
from mbsgen.style import spare_docstrings

PACKAGES = ("sympy", "mpmath", "jinja2", "pydantic", "pyyaml", "click", "rich")  # that `--version` shows
BAD_INPUT = 2  # exit code: an unacceptable file or argument; 0 is success

HELP = """Turn the description of a multibody system into C kernels for its dynamics.

\b
  mbsgen models/pendulum.yaml -o pendulum    write C to the folder pendulum
  mbsgen show models/pendulum.yaml           print the tree of its bodies

MODEL is a YAML file (the folder models/ contains examples), or a file of URDF, MJCF, SDF or OpenSim. The default
COMMAND is `generate`. `mbsgen COMMAND --help` describes a command. If MODEL has the name of a command, write ./MODEL.

\b
Exit codes
  0   done
  1   the folder differs (--check), or compared equations differ
  2   the model or an argument cannot be accepted; nothing written
"""

SUBJECTS = {
    "Generate": (
        Entry("generate", "MODEL", "Write a folder of C from MODEL; the default command."),
        Entry("import", "MODEL", "Make a model file of MODEL, a file of URDF, MJCF, SDF or OpenSim."),
    ),
    "Look at a model": (
        Entry("show", "MODEL", "Print the tree of MODEL; with -o, draw it."),
        Entry("equations", "MODEL", "Print the equations of motion of MODEL."),
        Entry("report", "MODEL", "Count the operations of MODEL's functions."),
        Entry("scaling", "", "Count the operations of chains of growing length."),
    ),
    "Check a model": (
        Entry("check", "MODEL", "Print every fault of MODEL, and write nothing."),
        Entry("compare", "MODEL", "Compare MODEL, a file of URDF or OpenSim, with another program."),
    ),
}
ENTRIES = tuple(entry for entries in SUBJECTS.values() for entry in entries)


class ModelFirst(CommandsBySubject):
    """A group whose default command is `generate`: `mbsgen MODEL -o DIR`. A subcommand wins over a file of its name."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command before arguments that start with neither a command nor an option of the group."""
        own = {*self.commands, *ctx.help_option_names, "--version"}
        first = args[0] if args else ""
        is_word = first.isalpha() and first not in own and not Path(first).exists()
        if is_word and (near := difflib.get_close_matches(first, self.commands, 1)):
            raise click.UsageError(f"there is no command and no file {first!r}; did you mean {near[0]!r}?", ctx)
        return super().parse_args(ctx, ["generate", *args] if args and args[0] not in own else args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the first word to a command or a file."""
        return [*super().shell_complete(ctx, incomplete), CompletionItem(incomplete, type="file")]


def _show_versions(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the versions of mbsgen, Python and the packages that mbsgen uses."""
    if asked and not ctx.resilient_parsing:
        import platform
        from importlib.metadata import version  # takes a while to load

        found = {"Python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
        click.echo(f"mbsgen, version {__version__}")
        for name, text in found.items():
            click.echo(f"{name:<12}{text}")
        click.echo("compiler, cache and solvers: mbsrun --version")
        ctx.exit()


@click.group(
    cls=ModelFirst,
    help=HELP,
    subjects=SUBJECTS,
    commands=CommandsOnDemand("mbsgen.commands", ENTRIES),
    subcommand_metavar="[COMMAND] MODEL ...",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_versions, help="Show versions."
)
def cli() -> None:
    """Turn the description of a multibody system into C kernels: `mbsgen`."""


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    click.echo(f"warning: {message}", err=True)


def main() -> None:
    """Run the command line; a user's errors are printed without a traceback."""
    gc.disable()  # a command ends before cycles of objects fill memory; searches take a tenth of its time
    atexit.register(gc.freeze)  # the end of the process would search once more
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # the terminal's encoding may lack the characters of a name
    warnings.showwarning = _show_warning
    spare_docstrings()
    try:
        with quick_data_classes():
            cli(prog_name="mbsgen")
    except MbsError as error:
        click.echo(f"mbsgen: {error}" if "\n" not in str(error) else str(error), err=True)
        sys.exit(BAD_INPUT)
