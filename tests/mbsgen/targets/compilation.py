"""The strict flags that generated C is compiled with, and runs of tools."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

STRICT = ["-std=c99", "-Werror"] + [
    f"-W{name}"
    for name in ("all", "extra", "pedantic", "shadow", "conversion", "double-promotion", "missing-prototypes", "undef")
]
Requires = Callable[[str], str]


def run(*command: str | Path, cwd: Path | None = None) -> str:
    """Run a command and return its output; a failure shows what it wrote."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
