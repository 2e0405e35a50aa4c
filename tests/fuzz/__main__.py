"""The command line of the fuzzers: each of its commands is one kind of search, and fails where it finds something."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tests.fuzz import inputs


@click.group()
def cli() -> None:
    """Search for what nobody thought of; the same seed finds the same."""


@cli.command("inputs")
@click.option("--count", default=1000, show_default=True, help="Files to try of each kind.")
@click.option("--seed", default=0, show_default=True, help="The first seed; each file has the next.")
@click.option("--kind", "kinds", multiple=True, type=click.Choice(list(inputs.KINDS)), help="Only these kinds.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the files that are not taken well.")
def inputs_command(count: int, seed: int, kinds: tuple[str, ...], keep: Path | None) -> None:
    """Mutate the files that ship: each is accepted, or refused in words."""
    failures = 0
    for name in kinds or inputs.KINDS:
        tally = inputs.search(inputs.KINDS[name], count, seed, keep)
        failures += len(tally.findings)
        click.echo(f"{name}: {tally.accepted} accepted, {tally.refused} refused, {len(tally.findings)} not taken well")
        for finding in tally.findings:
            click.echo(f"  seed {finding.seed}: {finding.text}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    cli(prog_name="python -m tests.fuzz")
