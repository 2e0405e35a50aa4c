"""Call graphs of C files anywhere, by a GCC and flags that a test chooses."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from mbsrun.stack import GRAPHS, Function, read_graphs


def compile_graphs(compiler: Sequence[str], sources: Sequence[Path], place: Path) -> dict[str, Function]:
    """Compile sources into the folder `place`; return their functions."""
    for source in sources:
        subprocess.run([*compiler, GRAPHS, "-c", str(source), "-o", str(place / f"{source.stem}.o")], check=True)
    return read_graphs([(place / f"{source.stem}.ci").read_text("utf-8") for source in sources])
