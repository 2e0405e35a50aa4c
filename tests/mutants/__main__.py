"""Plant every fault of the list, one at a time, and run the tests that must notice it: `python -m tests.mutants`.

Golden files do not count. A fault is killed if a test fails, and survives if all pass; a run that cannot collect its
tests is an error of the list. What was decided is kept in `build/mutants.json` until the tree changes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tests.mutants.faults import GOLDEN, ROOT, Fault, read_faults

FOLDERS = ("benchmarks", "csrc", "docs", "generated", "generator", "models", "python", "templates", "tests")
FILES = ("pyproject.toml", "Makefile", "README.md", "ARCHITECTURE.md", "CHANGELOG.md", "LICENSE", "LICENSE-GENERATED")
RECORD = ROOT / "build" / "mutants.json"
SECONDS = 600  # a fault may make a test hang; that is noticed too
KILLED, SURVIVED, BROKEN = "killed", "survived", "not run"
ENOUGH = 0.95


@click.command()
@click.option("--only", default="", help="Plant the faults alone whose name has this in it.")
def main(only: str) -> None:
    """Print which faults are killed; exit with 1 if fewer than 95 % are."""
    faults = [f for f in read_faults() if only in f.name]
    known = _read_record()
    with _copy_tree() as tree:
        state = _fingerprint(tree)
        for fault in track(faults, "faults", console=Console(stderr=True)):
            key = f"{state} {fault}"
            if key not in known:
                known[key] = try_fault(fault, tree)
                _write_record(known)
    verdicts = {fault: known[f"{state} {fault}"] for fault in faults}
    table = Table("fault", "file", "verdict")
    for fault, verdict in verdicts.items():
        table.add_row(fault.name, fault.file, verdict)
    killed = sum(v == KILLED for v in verdicts.values())
    console = Console()
    console.print(table)
    console.print(f"{killed} of {len(verdicts)} faults are killed.")
    sys.exit(killed < ENOUGH * len(verdicts))


def try_fault(fault: Fault, tree: Path) -> str:
    """Plant a fault in the copy of the tree, run its tests, and take it out again; return the verdict."""
    original = (tree / fault.file).read_bytes()
    with tempfile.TemporaryDirectory() as cache:
        try:
            fault.apply(tree)
            return _run(fault, tree, cache)
        finally:
            (tree / fault.file).write_bytes(original)


def _run(fault: Fault, tree: Path, cache: str) -> str:
    paths = os.pathsep.join(str(tree / name) for name in ("generator", "python"))
    environment = {**os.environ, "PYTHONPATH": paths, "XDG_CACHE_HOME": cache, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", f"--ignore={GOLDEN}", *fault.tests]
    try:
        run = subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return KILLED
    return {0: SURVIVED, 1: KILLED}.get(run.returncode, BROKEN)


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


def _read_record() -> dict[str, str]:
    return json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}


def _write_record(known: dict[str, str]) -> None:
    RECORD.parent.mkdir(exist_ok=True)
    RECORD.write_text(json.dumps(known, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
