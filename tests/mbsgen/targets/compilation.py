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


def name_in(real: str, function: str, prefix: str = "sample") -> str:
    """Return the name of a function in a library of a precision."""
    return function if real == "double" else function.replace(prefix, f"{prefix}_float", 1)


def run(*command: str | Path, cwd: Path | None = None) -> str:
    """Run a command and return its output; a failure shows what it wrote."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
