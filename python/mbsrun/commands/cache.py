"""`mbsrun cache`: list or remove what was generated and compiled."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import click
from rich import box, filesize
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbsrun.cache import Entry, cache_folder, list_entries, remove
from mbsrun.commands.console import (
    UNCUT,
)

DAY = 86400.0  # s
KINDS = {"generated": "generated", "object": "objects", "library": "libraries", "unfinished": "unfinished"}


CACHE_HELP = """List what was generated and compiled for `mbsrun`, or remove it.

Removed entries are made again when they are needed; entries that another process is making now stay.
"""


@click.command("cache", help=CACHE_HELP)
@click.option("--clear", is_flag=True, help="Remove all of it.")
@click.option(
    "--older-than",
    "days",
    metavar="DAYS",
    type=click.FloatRange(min=0),
    help="Remove entries that were not used for DAYS.",
)
def cache_command(clear: bool, days: float | None) -> None:
    """List the cache by model; remove entries."""
    if clear and days is not None:
        raise click.UsageError("--clear removes everything; give it, or --older-than, but not both")
    place = cache_folder(os.environ)
    entries = list_entries(place)
    if not clear and days is None:
        _print_cache(place, entries)
        return
    now = time.time()
    chosen = [e for e in entries if (clear or now - e.used > DAY * (days or 0.0)) and not e.is_being_made(now)]
    remove(chosen)
    click.echo(f"removed {len(chosen)} of {_count(entries)}, {filesize.decimal(sum(e.size for e in chosen))}")


def _print_cache(place: Path, entries: Sequence[Entry]) -> None:
    """Print a line for each model, and one for entries of no model."""
    table = Table(box=box.SIMPLE)
    table.add_column("model")
    for column in (*KINDS.values(), "size", "last used"):
        table.add_column(column, justify="right")
    for model in sorted({entry.model for entry in entries}):
        own = [entry for entry in entries if entry.model == model]
        counts = (sum(entry.kind == kind for entry in own) for kind in KINDS)
        last = time.strftime("%Y-%m-%d %H:%M", time.localtime(max(entry.used for entry in own)))
        table.add_row(Text(model or "-"), *map(str, counts), filesize.decimal(sum(e.size for e in own)), last)
    out = Console(highlight=False, width=None if sys.stdout.isatty() else UNCUT)
    if entries:
        out.print(table)
    out.print(Text(f"{_count(entries)}, {filesize.decimal(sum(e.size for e in entries))}, in {place}"), soft_wrap=True)


def _count(entries: Sequence[Entry]) -> str:
    return f"{len(entries)} {'entry' if len(entries) == 1 else 'entries'}"
