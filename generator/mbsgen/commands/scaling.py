"""`mbsgen scaling`: the formulations' flops and equations for chains of growing length."""

from __future__ import annotations

import sys

import click

from mbsgen.formulations.catalogue import list_rows
from mbsgen.scaling import PERIOD, find_crossing, grow


@click.command("scaling")
@click.option(
    "--to", "largest", type=click.IntRange(12, 1000), default=24, show_default=True, help="The longest chain."
)
def scaling_command(largest: int) -> None:
    """Count the operations of chains of growing length.

    The links of a chain are equal, and their axes are z, y, x in turn. SEMI and EXP1 are counted up to 50 links.
    """
    sizes = range(PERIOD, largest + 1, PERIOD)
    found = {}
    for name, row in list_rows().items():
        within = [n for n in sizes if n <= row.longest]
        with click.progressbar(within, label=name, file=sys.stderr) as steps:
            found[name] = grow(name, steps)
    click.echo("bodies" + "".join(f"{name:>9} eqs  " for name in found))
    for n in sizes:
        cells = (g.counts.get(n) for g in found.values())
        click.echo(f"{n:6}" + "".join(f"{c.paper:8}{c.equations:6}" if c else " " * 14 for c in cells))
    for name, growth in found.items():
        if growth.degree("flops") is None:  # the chains are too short to show it
            continue
        click.echo(f"{name}: flops of degree {growth.degree('flops')}, equations of {growth.degree('equations')}")
    crossing = find_crossing(found["EXP1"].counts, found["EXP2"].counts)
    click.echo(f"EXP2 takes fewer flops than EXP1 from {crossing} bodies on" if crossing else "EXP1 takes fewer flops")
