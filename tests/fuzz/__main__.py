"""The command line of the fuzzers: each of its commands is one kind of search, and fails where it finds something."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import click

from tests.fuzz import bounds, inputs, linkages, loops, mechanisms, mjcf_files, phased, problems, robots, touching


@click.group()
def cli() -> None:
    """Search for unforeseen faults; the same seed finds the same."""


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


@cli.command("mechanisms")
@click.option("--count", default=1000, show_default=True, help="Mechanisms to try.")
@click.option("--seed", default=0, show_default=True, help="The first seed; each mechanism has the next.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the model files that disagree.")
def mechanisms_command(count: int, seed: int, keep: Path | None) -> None:
    """Draw mechanisms: all functions agree with virtual power in absolute coordinates."""
    sys.exit(run(mechanisms.search, count, seed, keep))


@cli.command("loops")
@click.option("--count", default=200, show_default=True, help="Mechanisms to try; a fourth as many linkages follow.")
@click.option("--seed", default=0, show_default=True, help="The first seed; each mechanism has the next.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the model files that disagree.")
def loops_command(count: int, seed: int, keep: Path | None) -> None:
    """Draw closed mechanisms: all functions agree with free bodies, and linkages move alike wherever they are cut."""
    failed = run(loops.search, count, seed, keep)
    click.echo("linkages, cut at two places:")
    sys.exit(run(linkages.search, count // 4, seed, None if keep is None else keep / "linkages") or failed)


@cli.command("problems")
@click.option(
    "--count",
    default=600,
    show_default=True,
    help="Problems to try; a fourth as many of two phases, and with a contact, follow.",
)
@click.option("--seed", default=0, show_default=True, help="The first seed; each problem has the next.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the problems that disagree.")
def problems_command(count: int, seed: int, keep: Path | None) -> None:
    """Draw optimal control problems: their programs agree with a transcription of another hand."""
    failed = run(problems.search, count, seed, keep)
    for title, search in (("problems of two phases", phased.search), ("problems with a contact", touching.search)):
        click.echo(f"{title}:")
        failed = run(search, count // 4, seed, keep) or failed
    sys.exit(failed)


@cli.command("mjcf")
@click.option("--count", default=1000, show_default=True, help="Files to try.")
@click.option("--seed", default=0, show_default=True, help="The first seed; each file has the next.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the files that disagree.")
def mjcf_command(count: int, seed: int, keep: Path | None) -> None:
    """Draw files of MJCF from its schema: what is imported without a warning moves as in MuJoCo."""
    sys.exit(run(mjcf_files.search, count, seed, None if keep is None else keep.resolve()))


@cli.command("robots")
@click.option("--count", default=400, show_default=True, help="Robots to try.")
@click.option("--seed", default=0, show_default=True, help="The first seed; each robot has the next.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the files that disagree.")
def robots_command(count: int, seed: int, keep: Path | None) -> None:
    """Draw robots in URDF and SDF: Pinocchio and Drake read the same motions."""
    if not robots.has_drake():
        click.echo("without Drake, which `pip install drake` installs: robots in URDF of joints with one freedom alone")
    sys.exit(run(robots.search, count, seed, keep))


@cli.command("bounds")
@click.option(
    "--states", "--count", default=1_000_000, show_default=True, help="States to try for each function of each case."
)
@click.option("--seed", default=0, show_default=True, help="Of the states.")
@click.option("--case", "cases", multiple=True, help="Only the cases whose names contain this.")
@click.option("--precision", type=click.Choice(list(bounds.UNITS)), default="double", show_default=True)
def bounds_command(states: int, seed: int, cases: tuple[str, ...], precision: str) -> None:
    """Draw states: no rounding error of a function exceeds the bound that the generated code returns beside it."""
    failed = 0
    for case in bounds.list_cases():
        if not cases or any(part in case.name for part in cases):
            for tally in bounds.search(case, states, seed, precision):
                click.echo(str(tally))
                failed += not tally.is_sound
    sys.exit(1 if failed else 0)


def run(search: Callable[..., mechanisms.Tally], count: int, seed: int, keep: Path | None) -> int:
    """Run a search and show its findings; return the exit status."""

    def show(number: int, tally: mechanisms.Tally) -> None:
        if tally.findings and tally.findings[-1][0] == number:
            click.echo(f"  seed {number}: {tally.findings[-1][1]}")
        if (number - seed + 1) % 100 == 0:
            click.echo(f"{summary(tally)}; go on with --seed {number + 1}")

    def summary(tally: mechanisms.Tally) -> str:
        return f"{tally.agreed} agree, {len(tally.refused)} refused, {len(tally.findings)} disagree"

    tally = search(count, seed, keep, show)
    click.echo(summary(tally))
    return 1 if tally.findings else 0


if __name__ == "__main__":
    cli(prog_name="python -m tests.fuzz")
