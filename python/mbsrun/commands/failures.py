"""The message of a command where a problem has no solution."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mbsrun.commands.console import say
from mbsrun.ocp.solution.solution import SOLUTION
from mbsrun.ocp.solving.placing import name_place

if TYPE_CHECKING:
    from mbsrun.ocp.solution.solution import Failure


def print_failure(failure: Failure, file: Path, out: Path) -> None:
    """Print why there is no solution, with the line of the part at fault; and that an earlier one is still there."""
    place = f"{name_place(file, failure.place)}: " if failure.place else ""
    say(f"{place}not solved ({failure.run.status}): {failure.finding}; {failure.remedy}")
    if (out / SOLUTION).exists():
        say(f"{out / SOLUTION} is from an earlier solve")
