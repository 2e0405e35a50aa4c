"""The command `mbsrun study`: start the study in the folder `studies`, beside the package or within it."""

from __future__ import annotations

import sys
from pathlib import Path

import click

HERE = Path(__file__).resolve()
PLACES = HERE.parents[3], HERE.parents[1] / "sources"  # in a checkout or an editable install; in an installed package


@click.command(
    "study",
    add_help_option=False,
    context_settings={"ignore_unknown_options": True},
)
@click.argument("arguments", metavar="PROBLEM", nargs=-1, type=click.UNPROCESSED)
def study_command(arguments: tuple[str, ...]) -> None:
    """Pass all arguments to the command of the study, `python -m studies.docquier`."""
    find_study().main(args=list(arguments), prog_name="mbsrun study")


def find_study() -> click.Command:
    """Import the command of the study."""
    place = next(place for place in PLACES if (place / "studies" / "docquier" / "command.py").is_file())
    if str(place) not in sys.path:
        sys.path.append(str(place))
    from studies.docquier.command import study_command as found

    return found
