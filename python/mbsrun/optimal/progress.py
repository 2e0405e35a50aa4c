"""The progress of a solve: a line on a terminal, or a table with a curve in a notebook."""

from __future__ import annotations

import importlib
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from mbsrun.ocp.solving.runs import Progress, Watch
from mbsrun.optimal.display import write_table

PAUSE = 0.2  # s between two displays in a notebook
SIZE = (360, 90)  # of the curve [pixels]


@contextmanager
def show_progress() -> Iterator[Watch]:
    """Return a watch that shows iterations: in a notebook where one runs, or on the terminal."""
    display = find_display()
    if display is not None:
        board = Board(display)
        yield board
        board.show()
        return
    with Console(stderr=True).status("making the program") as status:
        yield lambda progress: status.update(describe(progress))


def describe(progress: Progress) -> str:
    """Describe an iteration in a line."""
    return f"iteration {progress.iteration}: cost {progress.cost:.8g}, violation {progress.violation:.1e}"


def find_display() -> Any:
    """Return IPython's module for displays where a notebook or its shell runs; None elsewhere."""
    shell = sys.modules.get("IPython")
    if shell is None or shell.get_ipython() is None:
        return None
    return importlib.import_module("IPython.display")


class Board:
    """The iterations of a solve in a notebook: the last one, and the violation of all."""

    def __init__(self, display: Any) -> None:
        self._display, self._handle = display, None
        self._shown = -math.inf
        self.seen: list[Progress] = []

    def __call__(self, progress: Progress) -> None:
        """Keep an iteration, and show it unless another was shown just before."""
        if progress.iteration == 0:
            self.seen.clear()
        self.seen.append(progress)
        if time.monotonic() - self._shown >= PAUSE:
            self.show()

    def show(self) -> None:
        """Show the present state, in place of the former one."""
        self._shown = time.monotonic()
        if self._handle is None:
            self._handle = self._display.display(self, display_id=True)
        else:
            self._handle.update(self)

    def _repr_html_(self) -> str:
        if not self.seen:
            return write_table("making the program", {})
        last = self.seen[-1]
        rows = {"cost": f"{last.cost:.8g}", "violation": f"{last.violation:.1e}"}
        return write_table(f"iteration {last.iteration}", rows) + draw_curve([x.violation for x in self.seen])


def draw_curve(values: list[float]) -> str:
    """Draw positive numbers over their index, on a logarithmic axis, as SVG."""
    width, height = SIZE
    known = [(i, math.log10(x)) for i, x in enumerate(values) if 0 < x < math.inf]
    if len(known) < 2:
        return ""
    least, most = min(y for _, y in known), max(y for _, y in known)
    across, up = width / max(len(values) - 1, 1), (height - 4) / ((most - least) or 1.0)
    points = " ".join(f"{i * across:.1f},{2 + (most - y) * up:.1f}" for i, y in known)
    title = f"violation, from 1e{most:.0f} to 1e{least:.0f}"
    return (
        f'<svg width="{width}" height="{height}" role="img"><title>{title}</title>'
        f'<polyline points="{points}" fill="none" stroke="#1f77b4" stroke-width="1.5"/></svg>'
    )
