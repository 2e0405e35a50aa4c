"""Commands and compiled programs that tests run."""

from __future__ import annotations

import subprocess
from pathlib import Path


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command, whatever its status."""
    return subprocess.run(list(map(str, command)), cwd=cwd, capture_output=True, text=True, timeout=120, check=False)


def read_numbers(program: Path) -> list[float]:
    """Run a program, and return the numbers that it prints."""
    done = run(program, cwd=program.parent)
    assert done.returncode == 0, done.stderr
    return list(map(float, done.stdout.split()))
