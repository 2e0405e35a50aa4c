"""`mbsgen compare`: the equations of an imported file beside another program's."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from mbsgen.commands.console import DIFFERENT
from mbsgen.commands.importing import MODEL, importing
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices


@click.command("compare", cls=ModelCommand)
@MODEL
@click.option("--with", "peer", type=click.Choice(["pinocchio"]), required=True, help="The program to compare with.")
@importing
def compare_command(model: Path, peer: str, choices: Choices) -> None:
    """Compare MODEL, a URDF file, with another program.

    Prints the largest differences of the residual Phi, the mass matrix M, the bias c and the accelerations qdd at
    random states, relative to the largest entry, and their known causes. Of closed loops, it compares forces and
    accelerations at closed states. Exit code 1: an unexplained difference.
    """
    from mbsgen.comparison import RESULTS, TOLERANCE, compare_with_pinocchio

    if model.suffix.lower() != ".urdf":
        raise click.UsageError(f"{model}: files of URDF are compared, since {peer} reads these")
    found = compare_with_pinocchio(model, choices)
    for title, misses in (("as imported", found.imported), ("without damping, friction and rotors", found.bare)):
        click.echo(f"{title:38}" + "".join(f"{name} {misses[name]:.1e}   " for name in RESULTS).rstrip())
    if found.closed:
        shown = "".join(f"{name} {miss:.1e}   " for name, miss in found.closed.items()).rstrip()
        click.echo(f"{'with loops, at closed states':38}{shown}")
    for line in found.named:
        click.echo(line)
    if not found.agrees:
        click.echo(f"the equations differ by more than {TOLERANCE:g}", err=True)
        sys.exit(DIFFERENT)
