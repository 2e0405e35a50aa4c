"""Inverse dynamics of a minute of recorded motion: `python -m benchmarks.moco.recorded`.

Talos with 38 freedoms, its base free, moves by sums of sines for 60 s at 100 Hz: as many freedoms as a whole body has.
The time of ours is of all from samples to forces: splines through each column, their first and second derivatives,
forces. A kernel alone, ours or Pinocchio's, gets positions, velocities and accelerations that are there already. Ours
computes samples in lanes; Pinocchio is called from Python for each sample.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray

import mbsrun
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from benchmarks.robots import find_file, find_robot
from mbsrun.external import Mechanism
from mbsrun.models import INTEGRATED
from mbsrun.recordings import Column, Recording, Treatment
from mbsrun.simulation.recorded import analyse

Array = NDArray[np.float64]
SECONDS, RATE = 60.0, 100.0
ROUNDS = 9


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/recorded.md"), help="the page")
    parser.add_argument("--folder", type=Path, default=Path("build/recorded"))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = find_robot("talos", given.folder)
    if file is None:
        parser.exit(2, "the package example-robot-data is not installed\n")
    page = write_page(measure(mbsrun.load(file, extent=INTEGRATED)))
    print(page)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(page, encoding="utf-8")


def record(mechanism: Mechanism, seconds: float = SECONDS) -> Recording:
    """Make a recording: each coordinate is a sum of three sines of 0.3 to 2 Hz."""
    names, rng = mechanism.manifest.positions, np.random.default_rng(1)
    t = np.arange(round(seconds * RATE) + 1) / RATE
    rates, sizes, phases = (rng.uniform(a, b, (3, len(names), 1)) for a, b in ((0.3, 2), (-0.3, 0.3), (0, 2 * np.pi)))
    q = (sizes * np.sin(2 * np.pi * rates * t + phases)).sum(axis=0)
    return Recording("sines", t, tuple(Column(name) for name in names), q.T)


def measure(mechanism: Mechanism) -> list[tuple[str, float]]:
    """Return the processor seconds of each way, the least of some rounds."""
    recording, file = record(mechanism), find_file("talos")
    robot = pinocchio.buildModelFromUrdf(str(file), pinocchio.JointModelFreeFlyer())
    found = analyse(recording, mechanism, Treatment()).forces
    own, data = [found.qd[:, : robot.nv], found.qdd[:, : robot.nv]], robot.createData()
    states = [(pinocchio.randomConfiguration(robot), *pair) for pair in zip(*own, strict=True)]
    given = {"q": found.q, "qd": found.qd, "qdd": found.qdd, "u": np.zeros_like(found.u)}
    return [
        ("mbsrun, its kernel alone", _take_least(lambda: mechanism.impl(**given))),
        ("mbsrun, from samples to forces", _take_least(lambda: analyse(recording, mechanism, Treatment()))),
        ("Pinocchio, its rnea alone", _take_least(lambda: [pinocchio.rnea(robot, data, *state) for state in states])),
    ]


def _take_least(work: Callable[[], object]) -> float:
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def write_page(rows: list[tuple[str, float]]) -> str:
    """Write the page."""
    titles = ("", "processor s", "times real time")
    cells = [(name, f"{seconds:.3f}", f"{SECONDS / seconds:,.0f}") for name, seconds in rows]
    lines = [
        "# Inverse dynamics of a minute",
        "",
        "Written by `python -m benchmarks.moco.recorded`. " + " ".join((__doc__ or "").split("\n\n", 1)[1].split()),
        f"The least of {ROUNDS} rounds. Reading and writing of files, tables and pictures come on top.",
        "",
        *tabulate(titles, cells),
        "",
        describe_machine(),
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
