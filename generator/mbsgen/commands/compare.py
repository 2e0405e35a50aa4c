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
@click.option(
    "--with", "peer", type=click.Choice(["pinocchio", "opensim"]), required=True, help="The program to compare with."
)
@click.option(
    "--states", type=click.IntRange(1, 100_000), help="The number of random states, with opensim; 5 by default."
)
@importing
def compare_command(model: Path, peer: str, states: int | None, choices: Choices) -> None:
    """Compare MODEL, a file of URDF or OpenSim, with another program.

    Prints the largest differences of the residual Phi, the mass matrix M, the bias c and the accelerations qdd at
    random states, relative to the largest entry, and their known causes. Of closed loops, it compares forces and
    accelerations at closed states. Exit code 1: an unexplained difference.
    """
    if peer == "opensim":
        _compare_with_opensim(model, choices, states)
    elif states is not None:
        raise click.UsageError("--states is for a comparison with opensim")
    else:
        _compare_with_pinocchio(model, choices)


def _compare_with_opensim(model: Path, choices: Choices, states: int | None) -> None:
    from mbsgen.osim_comparison import AROUND, NEAR, SHAPED, STATES, TOLERANCE, compare_with_opensim

    if model.suffix.lower() != ".osim":
        raise click.UsageError(f"{model}: files of OpenSim are compared with opensim")
    found = compare_with_opensim(model, choices, count=states or STATES)
    width = max(map(len, found.misses)) + 3
    for name, miss in found.misses.items():
        click.echo(f"{name:{width}}{miss:.1e}")
    click.echo(f"{len(found.lines)} muscles and springs along paths" if found.lines else "no muscles")
    for name in found.absent:
        click.echo(f"{name}: not in the model")
    if not found.agrees:
        seen = any(name.endswith((AROUND, SHAPED)) for name in found.misses)
        around = f", or by {NEAR:g} around cylinders, ellipsoids and tori" if seen else ""
        click.echo(f"the models differ by more than {TOLERANCE:g}{around}", err=True)
        sys.exit(DIFFERENT)


def _compare_with_pinocchio(model: Path, choices: Choices) -> None:
    from mbsgen.comparison import RESULTS, TOLERANCE, compare_with_pinocchio

    if model.suffix.lower() != ".urdf":
        raise click.UsageError(f"{model}: files of URDF are compared, since pinocchio reads these")
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
