"""Motions through ten thousand impacts: orders and energies, `python -m benchmarks.events`.

A pendulum hits a stop with e = 1; from rest at the angle a, its impacts at the angle s follow from elliptic integrals:

    t_n = (2 n - 1) (K(k^2) - F(phi, k^2)) / w,    k = sin(a/2),    sin phi = sin(s/2)/k.

A mass on a spring whose damper pushes, x'' = c x' - k x, hits a stop at 0. With w^2 = k - c^2/4, each flight takes
pi/w and makes it exp(c pi/2 w) times as fast, so that with e = exp(-c pi/2 w) it leaves with its first speed each time.
`dop853` follows both at a row of tolerances.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.special import ellipk, ellipkinc

import mbsrun
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsrun.models import Extent
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold

FUNCTIONS = Extent(("exp2", "impl", "semi", "semi_res", "energy", "power", "frames"), 1)
IMPACTS = 10_000
SMALL = 1e-4  # an error from which on it falls with the order of the method
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
G, LENGTH, START, STOP = 9.81, 0.6, 1.0, -0.3
PENDULUM = f"""
name: pendulum
gravity: [0, 0, -{G}]
bodies:
  - name: rod
    joint: {{type: revolute, axis: y, actuated: false, limits: [{STOP}, 2], stops: {{restitution: 1}}}}
    mass: 0.5
    com: [0, 0, -{LENGTH}]
"""
SPRING, PUSH = 1.0, 0.1
PACE = np.sqrt(SPRING - PUSH**2 / 4)
HAMMER = f"""
name: hammer
gravity: [0, 0, 0]
bodies:
  - name: mass
    joint:
      type: prismatic
      axis: x
      actuated: false
      limits: [0, null]
      force: {PUSH}*qd - {SPRING}*q
      stops: {{restitution: {np.exp(-PUSH * np.pi / 2 / PACE)}}}
    mass: 1
"""


@dataclass(frozen=True)
class Row:
    """A motion at one tolerance."""

    tolerance: float
    impacts: int
    steps: int
    late: float  # error of the last impact's time [s],
    error: float  # and of the speed after it [m/s or rad/s]
    drift: float  # of the energy, over what impacts took, or the energy exchanged
    seconds: float  # of processor time

    @property
    def time(self) -> float:
        """Return the time for an impact, with its flight [ms]."""
        return 1e3 * self.seconds / self.impacts


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/events.md"), help="the page")
    parser.add_argument("--impacts", type=int, default=IMPACTS)
    arguments = parser.parse_args()
    pendulum = list(swing(arguments.impacts, TOLERANCES))
    hammer = list(strike(arguments.impacts, TOLERANCES))
    page = write_page(arguments.impacts, pendulum, hammer)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(page, encoding="utf-8")
    print(page)


def swing(impacts: int, tolerances: Sequence[float]) -> Iterator[Row]:
    """Simulate the pendulum up to a number of impacts, at each tolerance."""
    k = np.sin(START / 2)
    flight = (ellipk(k**2) - ellipkinc(np.arcsin(np.sin(STOP / 2) / k), k**2)) / np.sqrt(G / LENGTH)
    speed = np.sqrt(2 * G / LENGTH * (np.cos(STOP) - np.cos(START)))
    yield from _measure(PENDULUM, START, 0.0, (2 * impacts - 1) * flight, flight, speed, tolerances)


def strike(impacts: int, tolerances: Sequence[float]) -> Iterator[Row]:
    """Simulate the mass on the spring likewise."""
    flight = np.pi / PACE
    yield from _measure(HAMMER, 0.0, 1.0, impacts * flight, flight, 1.0, tolerances)


def _measure(
    text: str, q: float, qd: float, last: float, flight: float, speed: float, tolerances: Sequence[float]
) -> Iterator[Row]:
    """Simulate up to half a flight after the last impact, which leaves at a speed."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "model.yaml"
        file.write_text(text, encoding="utf-8")
        kernels = mbsrun.load(file, extent=FUNCTIONS)
        for tolerance in tolerances:
            duration = last + flight / 2
            settings = Settings(duration, rtol=tolerance, atol=tolerance, output_step=duration / 100, max_seconds=1e3)
            begin = time.process_time()
            motion = simulate(kernels, hold([]), [q], [qd], settings)
            seconds, end, energy = time.process_time() - begin, motion.events[-1], motion.energy
            assert energy is not None, "all energies are known"
            exchanged = float(
                energy.impacts[-1] if energy.impacts is not None and energy.impacts[-1] else energy.exchanged
            )
            drift = float(np.abs(energy.drift).max()) / exchanged
            errors = abs(end.time - last), abs(end.after - speed)
            yield Row(tolerance, len(motion.events), motion.effort.steps, *errors, drift, seconds)


def find_order(rows: Sequence[Row]) -> float:
    """Return the slope of the error over the steps, where errors are small and above rounding."""
    chosen = [row for row in rows if row.error < SMALL and row.tolerance > rows[-1].tolerance]
    x, y = np.log([row.steps for row in chosen]), np.log([row.error for row in chosen])
    return float(-np.polyfit(x, y, 1)[0])


def write_page(impacts: int, pendulum: Sequence[Row], hammer: Sequence[Row]) -> str:
    """Return the page."""
    titles = (
        "tolerance",
        "steps",
        "last impact late by [s]",
        "its speed",
        "drift of energy",
        "time for an impact [ms]",
    )
    lines = ["# Ten thousand impacts", "", describe_machine(), ""]
    for name, rows in (
        ("A pendulum at a stop, e = 1", pendulum),
        ("A mass on a spring that is pushed, e = 0.85", hammer),
    ):
        cells = [
            (f"{x.tolerance:.0e}", f"{x.steps}", *(f"{y:.1e}" for y in (x.late, x.error, x.drift)), f"{x.time:.2f}")
            for x in rows
        ]
        power = f"the error falls with the number of steps to the power of {find_order(rows):.1f}"
        lines += [f"## {name}", "", f"{impacts} impacts; {power}.", "", *tabulate(titles, cells, 0), ""]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
