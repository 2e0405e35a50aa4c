"""Rows of figures: what one way of solving took; kept in a file as they come, shown as tables."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from rich import box
from rich.table import Table

from benchmarks.compilation import describe_flags
from benchmarks.ocp.peer import FLAGS

SAME = 1e-6  # relative difference of costs within which two optima are one
OURS = "mbsgen"
STAGES = "by stages"  # the project's own method, in the place of IPOPT
POINTS = "CasADi, by points, compiled"
LONG = 3.0  # s; what takes longer is solved once
COLUMNS = ("build [s]", "iterations", "evaluation [ms]", "algebra [ms]", "solve, CPU [s]", "optimum")


@dataclass(frozen=True)
class Row:
    """The effort of one way of solving in one representation: its quickest round, and medians over all."""

    representation: str
    way: str
    seconds_building: float  # of the processor: program and compilation
    variables: int
    constraints: int
    status: str
    iterations: int
    cost: float
    cpu_seconds: float
    cpu_seconds_evaluating: float
    rounds: int
    cpu_seconds_median: float
    cpu_seconds_evaluating_median: float

    @property
    def evaluating(self) -> float:
        """Return milliseconds per iteration for functions and derivatives."""
        return 1e3 * self.cpu_seconds_evaluating / max(self.iterations, 1)

    @property
    def evaluating_median(self) -> float:
        """Return the median of the same."""
        return 1e3 * self.cpu_seconds_evaluating_median / max(self.iterations, 1)

    @property
    def solving(self) -> float:
        """Return milliseconds per iteration for linear algebra, and IPOPT's own."""
        return 1e3 * (self.cpu_seconds - self.cpu_seconds_evaluating) / max(self.iterations, 1)

    def compare(self, ours: Row) -> tuple[str, ...]:
        """Write the figures of COLUMNS, each with how many times ours it is."""
        is_same = abs(self.cost - ours.cost) <= SAME * abs(ours.cost)
        return (
            f"{self.seconds_building:.1f}",
            str(self.iterations),
            f"{self.evaluating:.2f} · {self.evaluating_median:.2f} ({self.evaluating / ours.evaluating:.2g})",
            f"{self.solving:.1f} ({self.solving / ours.solving:.2g})",
            f"{self.cpu_seconds:.2f} · {self.cpu_seconds_median:.2f} ({self.cpu_seconds / ours.cpu_seconds:.2g})",
            f"{self.cost:.8g}" if is_same else f"{self.cost:.8g}, another",
        )


@dataclass(frozen=True)
class Measured:
    """The rows of a representation, and the load of the machine: processes that want to run, in means of a minute."""

    rows: tuple[Row, ...]
    load_before: float
    load_after: float

    @property
    def representation(self) -> str:
        """Return the representation of all rows."""
        return self.rows[0].representation

    @property
    def ours(self) -> Row:
        """Return the row that others are compared with."""
        return next(row for row in self.rows if row.way == OURS)


@dataclass(frozen=True)
class Figures:
    """The results of a run, and the machine."""

    about: str  # machine, rounds and problem
    cores: int
    seconds_generating: float | None
    measured: tuple[Measured, ...] = ()

    @property
    def rows(self) -> list[Row]:
        """List the rows of all representations."""
        return [row for part in self.measured for row in part.rows]


def write_figures(figures: Figures, folder: Path) -> None:
    """Write the figures, and the page that shows them."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {name: value for name, value in asdict(figures).items() if name != "measured"}
    content["rows"] = [asdict(row) for row in figures.rows]
    content["loads"] = [(part.load_before, part.load_after) for part in figures.measured]
    (folder / "ocp.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (folder / "ocp.md").write_text(write_page(figures), "utf-8")


def show(figures: Figures) -> Table:
    """Lay the rows out for a terminal."""
    seconds = figures.seconds_generating
    made = "" if seconds is None else f"; loading the model took {seconds:.1f} s"
    table = Table(title=f"one solve{made}; ours is {OURS!r}", box=box.SIMPLE)
    for column in ("representation", "way"):
        table.add_column(column)
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for part in figures.measured:
        for row in part.rows:
            table.add_row(row.representation, row.way, *row.compare(part.ours))
    return table


def write_page(figures: Figures) -> str:
    """Write a table for each representation, and what the machine was doing."""
    loads = [load for part in figures.measured for load in (part.load_before, part.load_after)]
    lines = [
        "# Optimal control: what was measured",
        "",
        f"{figures.about}; our C with `{describe_flags()}`, CasADi's with `{' '.join(FLAGS)}`.",
        "",
        "Times are of the processor, compilers included, and per iteration where they are in ms: the quickest",
        f"round, then the median. A solve of more than {LONG:g} s runs once. A figure in brackets is relative to",
        f"{OURS}. The [page of the benchmark](../ocp/README.md) describes who is compared, and how.",
        "",
        "All numbers of the model are folded into the code, for everybody, and masses are lumped in ours. Two things",
        "differ: our kernels have their own sine and cosine, all others use the C library (some 2 % of their",
        "evaluation); our rows have our own linear solver unless they say mumps, all others have MUMPS. `By points` is",
        "C that CasADi writes of the dynamics and their derivatives, in the program that our kernels stand in.",
    ]
    if loads:
        wanting = f"{min(loads):.1f} to {max(loads):.1f} processes"
        lines += ["", f"{wanting}, in means of a minute, wanted to run on {figures.cores} cores meanwhile."]
        if max(loads) > figures.cores:
            lines[-1] += " So the run was disturbed, and ratios say more than times."
    if figures.seconds_generating is not None:
        lines += ["", f"Generating the model took {figures.seconds_generating:.1f} s, before all that is built below."]
    for part in figures.measured:
        lines += ["", f"## {part.representation}", "", f"| | {' | '.join(COLUMNS)} |"]
        lines += ["|---|" + "---:|" * len(COLUMNS)]
        lines += [f"| {row.way} | {' | '.join(row.compare(part.ours))} |" for row in part.rows]
    return "\n".join(lines) + "\n"
