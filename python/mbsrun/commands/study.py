"""The command `mbsrun study`: start a study that lies beside the package, in the folder `studies` of the sources."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from mbsgen.errors import MbsError

SOURCES = Path(__file__).resolve().parents[3]  # in a checkout or an editable install
MODULE = "studies.docquier"


class NotInstalledError(MbsError):
    """The folder of a study is missing: an installed package does not contain it."""


@click.command(
    "study",
    add_help_option=False,
    context_settings={"ignore_unknown_options": True},
)
@click.argument("arguments", metavar="PROBLEM", nargs=-1, type=click.UNPROCESSED)
def study_command(arguments: tuple[str, ...]) -> None:
    """Pass all arguments to the command of the study, `python -m studies.docquier`."""
    find_study(SOURCES).main(args=list(arguments), prog_name="mbsrun study")


def find_study(sources: Path) -> click.Command:
    """Import the command of the study from a folder of sources. Raises NotInstalledError."""
    folder = sources.joinpath(*MODULE.split("."))
    if not (folder / "command.py").is_file():
        raise NotInstalledError(
            f"the study is not part of the installed package: there is no folder {folder}; take the sources of mbsgen, "
            f"and run there: python -m {MODULE} PROBLEM"
        )
    if str(sources) not in sys.path:
        sys.path.append(str(sources))
    from studies.docquier.command import study_command as found  # an installed package does not have it

    return found
