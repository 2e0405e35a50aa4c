"""Messages, progress and exit codes that the commands share."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from mbsgen.families import Tell, say_nothing

DIFFERENT = 1  # exit code: a folder differs from the generated one, or compared equations differ; 0 is success


@contextmanager
def show_progress() -> Iterator[Tell]:
    """Show on a terminal which stage is at work; write nothing into pipes and files."""
    if not sys.stderr.isatty():
        yield say_nothing
        return
    from rich.console import Console  # takes a while to load
    from rich.markup import escape

    with Console(stderr=True).status("") as status:
        yield lambda stage: status.update(escape(stage))
