"""Plant every fault of the list, one at a time, and run the tests that must notice it: `python -m tests.mutants`.

Golden files do not count. The tests first run without the fault: where they fail, the fault is not tried. A fault is
killed if a test fails, and survives if all pass; a run that cannot collect its tests is an error of the list. Outcomes
are kept in `build/mutants.json` until the tree changes. `--drawn N` plants N faults that a machine draws from a
`--seed`, in the files whose paths have the text of `--only` in them.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from tests.mutants.drawn import draw
from tests.mutants.faults import GOLDEN, ROOT, Fault, read_faults

FOLDERS = ("benchmarks", "csrc", "docs", "generated", "generator", "models", "python", "studies", "templates", "tests")
FILES = ("pyproject.toml", "Makefile", "README.md", "ARCHITECTURE.md", "CHANGELOG.md", "LICENSE", "LICENSE-GENERATED")
RECORD = ROOT / "build" / "mutants.json"
SECONDS = 600  # a fault may make a test hang; that is noticed too
KILLED, SURVIVED, BROKEN = "killed", "survived", "not run"
FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/.+?)(?: - .*)?$", re.MULTILINE)  # of pytest's summary
ENOUGH = 0.95


@dataclass(frozen=True)
class Outcome:
    """The result of the tests of a fault."""

    verdict: str
    test: str = ""  # the test that fails, or why there is none


@dataclass
class Trial:
    """A copy of the tree in which faults are planted, and the outcomes of the tests without a fault."""

    tree: Path
    baselines: dict[tuple[str, ...], Outcome] = field(default_factory=dict)

    def try_fault(self, fault: Fault) -> Outcome:
        """Run the tests of a fault without it, once for each set of tests, and with it."""
        if fault.tests not in self.baselines:
            self.baselines[fault.tests] = self._run(fault.tests)
        baseline = self.baselines[fault.tests]
        if baseline.verdict != SURVIVED:
            return Outcome(BROKEN, f"without the fault: {baseline.test}")
        original = (self.tree / fault.file).read_bytes()
        try:
            fault.apply(self.tree)
            return self._run(fault.tests)
        finally:
            (self.tree / fault.file).write_bytes(original)

    def _run(self, tests: tuple[str, ...]) -> Outcome:
        paths = os.pathsep.join(str(self.tree / name) for name in ("generator", "python"))
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", f"--ignore={GOLDEN}", *tests]
        with tempfile.TemporaryDirectory() as cache:
            own = {"PYTHONPATH": paths, "XDG_CACHE_HOME": cache, "PYTHONDONTWRITEBYTECODE": "1"}
            environment = {**os.environ, **own, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # no test needs a plugin
            try:
                run = subprocess.run(
                    command,
                    cwd=self.tree,
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=SECONDS,
                    check=False,
                )
            except subprocess.TimeoutExpired:
                return Outcome(KILLED, f"no end after {SECONDS} s")
        if run.returncode == 1:
            return Outcome(KILLED, ", ".join(FAILED.findall(run.stdout)))
        if run.returncode < 0:
            return Outcome(KILLED, f"ended by signal {-run.returncode}")  # such as a fault of memory
        return Outcome(SURVIVED) if run.returncode == 0 else Outcome(BROKEN, f"pytest returns {run.returncode}")


@click.command()
@click.option("--only", default="", help="Plant the faults alone whose name, or file, has this in it.")
@click.option("--drawn", type=click.IntRange(1), metavar="N", help="Plant N faults that a machine draws.")
@click.option("--seed", type=int, default=0, help="Of the drawn ones.")
def main(only: str, drawn: int | None, seed: int) -> None:
    """Print which faults are killed, and by which test; exit with 1 if fewer than 95 % are."""
    faults = draw(drawn, only, seed) if drawn else [f for f in read_faults() if only in f.name or only in f.file]
    known = _read_record()
    with _copy_tree() as tree:
        state, trial = _fingerprint(tree), Trial(tree)
        for fault in track(faults, "faults", console=Console(stderr=True)):
            key = f"{state} {fault}"
            if key not in known:
                known[key] = trial.try_fault(fault)
                _write_record(known)
    outcomes = {fault: known[f"{state} {fault}"] for fault in faults}
    table = Table("fault", "file", "verdict", Column("test", overflow="fold"))
    for fault, outcome in outcomes.items():
        table.add_row(fault.name, fault.file, outcome.verdict, outcome.test)
    killed = sum(outcome.verdict == KILLED for outcome in outcomes.values())
    console = Console()
    console.print(table)
    console.print(f"{killed} of {len(outcomes)} faults are killed.")
    sys.exit(killed < ENOUGH * len(outcomes))


@contextmanager
def _copy_tree() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in FOLDERS:
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in FILES:
            shutil.copy2(ROOT / name, tree / name)
        yield tree


def _fingerprint(tree: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(p for p in tree.rglob("*") if p.is_file()):
        digest.update(str(path.relative_to(tree)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


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
