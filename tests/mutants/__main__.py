"""Plant faults, one at a time, and run the tests that must notice each: `python -m tests.mutants`.

The list is `faults.toml`. `--drawn N` plants N faults that a machine draws from a `--seed`; a fault that compiles to
the same, or not at all, is replaced by another. A fault is killed if a test fails that passes without it, and survives
if all pass; golden files do not count. Faults of `equivalent.toml` were judged by hand to change nothing, and are
counted apart. Outcomes are kept in `build/mutants.json` until the tree changes: a stopped run goes on where it was.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from queue import SimpleQueue

import click
from rich.console import Console
from rich.table import Column, Table

from tests.mutants.drawn import draw
from tests.mutants.faults import ROOT, Fault, read_equivalent, read_faults
from tests.mutants.trial import BROKEN, KILLED, REFUSED, SAME, SURVIVED, Outcome, Trial, copy_tree, fingerprint

RECORD = ROOT / "build" / "mutants.json"
EQUIVALENT = "equivalent"
ENOUGH = 0.95


@click.command()
@click.option("--only", default="", help="Plant the faults alone whose name, or file, has this in it.")
@click.option("--drawn", type=click.IntRange(1), metavar="N", help="Plant N faults that a machine draws.")
@click.option("--seed", type=int, default=0, help="Of the drawn ones.")
@click.option("--workers", type=click.IntRange(1), default=2, show_default=True, help="Faults tried at once.")
def main(only: str, drawn: int | None, seed: int, workers: int) -> None:
    """Print which faults are killed, and by which test; exit with 1 if fewer than 95 % are."""
    with tempfile.TemporaryDirectory() as place:
        trials = [Trial(Path(place) / f"tree{k}", Path(place) / "cache") for k in range(workers)]
        (Path(place) / "cache").mkdir(mode=0o700)
        for trial in trials:
            copy_tree(trial.tree)
        if drawn is None:
            faults = [fault for fault in read_faults() if only in fault.name or only in fault.file]
        else:
            faults, left = choose_drawn(draw(only, seed), drawn, trials[0])
            click.echo("Left out of the draw: " + "; ".join(f"{count} {why}" for why, count in sorted(left.items())))
        outcomes = dict(zip(faults, run(faults, trials), strict=True))
    show(outcomes)
    counts = Counter(outcome.verdict for outcome in outcomes.values())
    sys.exit(counts[KILLED] < ENOUGH * (len(outcomes) - counts[EQUIVALENT]))


def choose_drawn(faults: Iterable[Fault], count: int, trial: Trial) -> tuple[list[Fault], Counter[str]]:
    """Take the first faults that change what is compiled; return them by file, and how many others came between."""
    chosen: list[Fault] = []
    left = Counter({SAME: 0, REFUSED: 0})
    for fault in faults:
        why = trial.compare(fault)
        if why:
            left[why] += 1
        else:
            chosen.append(fault)
        if len(chosen) == count:
            break
    return sorted(chosen, key=lambda fault: fault.file), left


def run(faults: list[Fault], trials: list[Trial]) -> list[Outcome]:
    """Try faults, one in each tree at a time, and keep each outcome at once."""
    known, state, equivalent = _read_record(), fingerprint(trials[0].tree), read_equivalent()
    free = SimpleQueue[Trial]()
    for trial in trials:
        free.put(trial)

    def judge(fault: Fault) -> Outcome:
        if (fault.file, fault.find, fault.replace) in equivalent:
            return Outcome(EQUIVALENT, equivalent[fault.file, fault.find, fault.replace])
        key = f"{state} {fault}"
        if key not in known:
            trial = free.get()
            try:
                known[key] = trial.try_fault(fault)
            finally:
                free.put(trial)
            _write_record(dict(known))
            click.echo(f"{fault.name}: {known[key].verdict} {known[key].test}", err=True)
        return known[key]

    with ThreadPoolExecutor(len(trials)) as pool:
        return list(pool.map(judge, faults))


def show(outcomes: dict[Fault, Outcome]) -> None:
    """Print a table of all outcomes, and how many there are of each kind."""
    table = Table("fault", "verdict", Column("test", overflow="fold"))
    for fault, outcome in outcomes.items():
        table.add_row(fault.name, outcome.verdict, outcome.test)
    counts = Counter(outcome.verdict for outcome in outcomes.values())
    console = Console()
    console.print(table)
    told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in (KILLED, SURVIVED, EQUIVALENT, BROKEN))
    rest = len(outcomes) - counts[EQUIVALENT]
    console.print(f"{len(outcomes)} faults: {told}. {counts[KILLED]} of {rest} that are not equivalent are killed.")


def _read_record() -> dict[str, Outcome]:
    if not RECORD.exists():
        return {}
    found = json.loads(RECORD.read_text(encoding="utf-8"))
    return {key: Outcome(**entry) for key, entry in found.items() if isinstance(entry, dict)}


def _write_record(known: dict[str, Outcome]) -> None:
    RECORD.parent.mkdir(exist_ok=True)
    text = json.dumps({key: asdict(outcome) for key, outcome in known.items()}, indent=1)
    RECORD.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
