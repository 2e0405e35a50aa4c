"""A search from many starts, on the console: its progress, and the costs that it found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import click
from rich import box
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mbsrun.commands.console import open_messages, print_table
from mbsrun.ocp.guessing.starts import describe_turns
from mbsrun.ocp.searching.multistart import Watch
from mbsrun.ocp.solution.solution import Starts

SHOWN = 10  # minima that are printed


@contextmanager
def show_search(count: int) -> Iterator[Watch]:
    """Show how many starts ended, and the lowest cost; yield the function that takes the outcomes."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=open_messages(), transient=True) as bar:
        task = bar.add_task("solving", total=count)

        def show(starts: Starts) -> None:
            best = "" if starts.best is None else f", lowest cost {starts.best.cost:.8g}, found {starts.times} times"
            bar.update(
                task,
                completed=len(starts.results) + len(starts.hops),
                total=count + len(starts.hops),
                description=f"solving{best}",
            )

        yield show


def print_starts(starts: Starts, remedy: str) -> None:
    """Print the minima, how often each was found, and the starts that found none."""
    table = Table(box=box.SIMPLE)
    table.add_column("cost", justify="right")
    table.add_column("found", justify="right")
    table.add_column("whole turns")
    for minimum in starts.minima[:SHOWN]:
        table.add_row(f"{minimum.cost:.8g}", str(minimum.found), describe_turns(minimum.turns))
    if starts.minima:
        print_table(table)
    if len(starts.minima) > SHOWN:
        click.echo(f"and {len(starts.minima) - SHOWN} higher costs")
    if starts.hops:
        least = min((hop.cost for hop in starts.hops if hop.cost is not None), default=None)
        click.echo(f"{len(starts.hops)} hops" + ("" if least is None else f", lowest cost {least:.8g}"))
    failed = Counter(start.status for start in (*starts.results, *starts.hops) if start.cost is None)
    if failed:
        click.echo("no solution: " + ", ".join(f"{count} {status}" for status, count in failed.most_common()))
    if len(starts.results) < starts.asked:
        click.echo(f"{len(starts.results)} of {starts.asked} starts were made{remedy}")
