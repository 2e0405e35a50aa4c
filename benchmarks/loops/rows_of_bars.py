"""Rows of four-bars through their singular poses: `python -m benchmarks.loops.rows_of_bars`.

All uprights of a row turn alike, so one equation of one angle is the truth. In the level poses, a row has as many
freedoms as uprights: a program may halt there, or go on in another branch. The error is the distance of B0, the end of
the first upright, from the truth at the end of the motion; the closure and the energy are the worst along it. Times are
of the processor, without generation.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.integrate import solve_ivp

from benchmarks.loops.models import write_four_bars
from benchmarks.pages import tabulate
from mbsrun.external import Mechanism, load
from mbsrun.models import Extent
from mbsrun.simulation import Keeping, Settings, simulate
from mbsrun.simulation.drive import hold

Array = NDArray[np.float64]

BARS = (2, 5, 10)
SPAN = 20.0  # s
GRAVITY = 9.81
FUNCTIONS = ("exp2", "semi", "semi_res", "energy", "power", "frames", "loops", "loop_rates", "loop_jacobian")
SETTINGS = (
    Settings(SPAN, "dop853", rtol=1e-6, atol=1e-6, loops=Keeping.PROJECTION, max_seconds=inf),
    Settings(SPAN, "rk4", step=1e-2, loops=Keeping.PROJECTION, max_seconds=inf),
    Settings(SPAN, "rk4", step=5e-3, loops=Keeping.PROJECTION, max_seconds=inf),
)


@dataclass(frozen=True)
class Row:
    """A motion of N four-bars."""

    bars: int
    method: str
    status: str
    miss: float  # m, of B0 at the end
    closure: float  # m
    energy: float  # J
    seconds: float  # of the processor


def find_angle(bars: int, span: float) -> float:
    """Return the angle of all uprights after a time, from -1 rad/s upright, by the equation of one pendulum."""
    ratio = GRAVITY * ((bars + 1) / 2 + bars) / ((bars + 1) / 3 + bars)
    found = solve_ivp(
        lambda _, y: (y[1], ratio * np.sin(y[0])), (0, span), (0.0, -1.0), "DOP853", rtol=1e-13, atol=1e-13
    )
    return float(found.y[0, -1])


def lean(bars: int, angle: float) -> Array:
    """Return the coordinates a0, b1, a1, b2, ... for one angle of all uprights; or their rates."""
    return angle * np.array([1.0, *[-1.0, 1.0] * bars])


def measure(plant: Mechanism, bars: int, settings: Settings) -> Row:
    """Simulate a row."""
    before = time.process_time()
    motion = simulate(plant, hold(np.zeros(0)), lean(bars, 0.0), lean(bars, -1.0), settings)
    seconds = time.process_time() - before
    accuracy = f"step {settings.step:g} s" if settings.method == "rk4" else f"tolerance {settings.rtol:g}"
    name = f"{settings.method}, {accuracy}"
    if motion.halt is not None:
        return Row(bars, name, str(motion.halt), np.inf, np.inf, np.inf, seconds)
    truth, found = find_angle(bars, settings.duration), float(motion.q[-1, 0])
    miss = float(np.hypot(np.sin(found) - np.sin(truth), np.cos(found) - np.cos(truth)))
    assert motion.closure is not None, "a row has loops"
    assert motion.energy is not None, "the kernels measure it"
    closure, energy = motion.closure.most[0], float(np.abs(motion.energy.drift).max())
    return Row(bars, name, "complete", miss, closure, energy, seconds)


def write_page(rows: Sequence[Row], span: float) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    titles = ["four-bars", "method", "status", "error [m]", "closure [m]", "energy [J]", "CPU [s]"]
    lines = ["# Rows of four-bars", "", f"`python -m benchmarks.loops.rows_of_bars` wrote this page: {span:g} s.", ""]
    lines += [about, "", *tabulate(titles, map(_list_cells, rows))]
    return "\n".join(lines) + "\n"


def _list_cells(row: Row) -> list[str]:
    errors = [f"{x:.1e}" for x in (row.miss, row.closure, row.energy)]
    return [str(row.bars), row.method, row.status, *errors, f"{row.seconds:.3f}"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loops.rows_of_bars", description=__doc__)
    parser.add_argument("--bars", nargs="+", type=int, default=BARS, help="40 take minutes to generate")
    parser.add_argument("--span", type=float, default=SPAN, help="seconds of motion")
    parser.add_argument("--out", type=Path, default=Path("build/bench-loops/rows_of_bars.md"), help="the page")
    given = parser.parse_args(arguments)
    console, rows = Console(), list[Row]()
    for bars in given.bars:
        with tempfile.TemporaryDirectory() as folder:
            model = Path(folder) / "bars.yaml"
            model.write_text(write_four_bars(bars), encoding="utf-8")
            plant = load(model, extent=Extent(FUNCTIONS, 0))
        for settings in SETTINGS:
            rows.append(measure(plant, bars, replace(settings, duration=given.span)))
            console.print("  ".join(_list_cells(rows[-1])))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(write_page(rows, given.span), encoding="utf-8")
    console.print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
