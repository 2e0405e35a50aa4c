"""Track a stride of a body with 31 freedoms and 80 muscles: `python -m benchmarks.moco.stride`.

The body is `benchmarks.moco.body`. Its tendons are rigid, and activations follow excitations with 15 and 60 ms. Costs
are the squared distances of angles and speeds from the stride, squared excitations, and squared forces of the motors.
The ground's forces are given. `--intervals` sets the grid of Hermite and Simpson's rule.
"""

from __future__ import annotations

import argparse
import csv
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import mbsrun
from benchmarks.compilation import describe_machine
from benchmarks.moco.body import FREEDOMS, read_muscles, write_body
from benchmarks.pages import tabulate
from mbsgen.importing import Choices, import_model, write_imported
from mbsrun.optimal.control import OptimalControl

Array = NDArray[np.float64]

STRIDE = Path(__file__).with_name("stride.csv")
FEET = ("calcn_r", "calcn_l")
ANGLES, SPEEDS, EXCITATIONS, MOTORS = 100.0, 1.0, 0.1, 1e-3  # weights
FIRST = 1e-2  # the barrier parameter: from a larger one, all muscles would pull at first


@dataclass(frozen=True)
class Measured:
    """How a stride was tracked."""

    intervals: int
    status: str
    cost: float
    iterations: int
    making: float  # s by the clock to generate and compile, or to find what was made before
    seconds: float  # of the search, by the clock
    processor: float  # s, of the same
    apart: float  # rad, root of the mean squared distance of angles
    hardest: float  # of all activations, the largest
    pelvis: float  # N or N m, root of the mean square of the six motors of the pelvis
    legs: float  # N m, the same of the legs' motors


def main() -> None:
    """Solve, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--intervals", type=int, default=50, help="of the grid; 50")
    parser.add_argument("--folder", type=Path, default=Path("build/stride"), help="of the model and the problem")
    parser.add_argument("--out", type=Path, default=Path("build/stride.md"), help="the page")
    given = parser.parse_args()
    page = write_page(measure(prepare(given.folder, given.intervals)))
    print(page)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(page, encoding="utf-8")


def prepare(folder: Path, intervals: int) -> Path:
    """Write the model, the stride with its speeds, and the problem into a folder; return the problem's file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "body.osim"
    file.write_text(write_body(), encoding="utf-8")
    imported = import_model(file, Choices(opened=FEET))
    (folder / "body.yaml").write_text(write_imported(imported), encoding="utf-8")
    columns = read_stride()
    table = np.stack([*columns.values()], axis=1)
    np.savetxt(folder / "stride.csv", table, fmt="%.10g", delimiter=",", header=",".join(columns), comments="")
    problem = folder / "stride.ocp.yaml"
    problem.write_text(write_problem(intervals, float(columns["time"][-1])), encoding="utf-8")
    return problem


def read_stride() -> dict[str, Array]:
    """Return times, coordinates, their speeds, and forces of the ground, by the names of columns: (samples,) each."""
    rows = [row for row in csv.reader(STRIDE.read_text("utf-8").splitlines()) if not row[0].startswith("#")]
    found = dict(zip(rows[0], np.array(rows[1:], dtype=np.float64).T, strict=True))
    t = found["time"]
    for name in FREEDOMS:
        mean = (found[name][-1] - found[name][0]) / t[-1]  # of the speed
        swing = found[name] - mean * t
        swing[-1] = swing[0]
        found[f"speed_{name}"] = np.asarray(CubicSpline(t, swing, bc_type="periodic")(t, 1) + mean)
    return found


def write_problem(intervals: int, period: float) -> str:
    """Write the problem file."""
    free = f"{{{', '.join(f'{name}: null' for name in FREEDOMS)}}}"
    speeds = [f"    - {{expression: (qd_{x} - ref_stride_speed_{x})**2, weight: {SPEEDS:g}}}" for x in FREEDOMS]
    loads = []
    for foot in FEET:
        parts = ([f"ref_stride_{kind}{axis}_{foot[-1]}" for axis in "xyz"] for kind in "fm")
        force, moment = (f"[{', '.join(names)}]" for names in parts)
        loads.append(f"  {foot}: {{force: {force}, moment: {moment}}}")
    lines = [
        "model: body.yaml",
        f"horizon: {period:g}",
        f"intervals: {intervals}",
        "scheme: lobatto",
        "degree: 3",
        "inputs: polynomial",
        f"muscles: {{rise: 0.015, fall: 0.06, effort: {EXCITATIONS:g}, guess: 0.1}}",
        "references: {stride: {file: stride.csv}}",
        "cost:",
        f"  inputs: {MOTORS:g}",
        f"  track: [{{reference: stride, coordinates: [{', '.join(FREEDOMS)}], weight: {ANGLES:g}}}]",
        "  running:",
        *speeds,
        "wrenches:",
        *loads,
        f"start: {{pose: {free}, velocity: {free}}}",
        "guess: {solution: stride.csv}",
        f"solver: {{method: mbs, objective_scaling: 1, options: {{mu_init: {FIRST:g}}}}}",
    ]
    return "\n".join(lines) + "\n"


def measure(file: Path) -> Measured:
    """Solve a problem."""
    begin = time.perf_counter()
    problem = mbsrun.read_problem(file)
    assert isinstance(problem, OptimalControl), "it has no phases"
    making = time.perf_counter() - begin
    solved = problem.solve(check=False)
    run, table = solved.solution.run, solved.solution.trajectory
    making += time.perf_counter() - begin - making - run.seconds
    names = [c.name for c in problem.plant.manifest.coordinates]
    columns = read_stride()
    wanted = np.stack([CubicSpline(columns["time"], columns[name])(table.t) for name in names], axis=1)
    turns = [k for k, name in enumerate(names) if not name.startswith("pelvis_t") or name == "pelvis_tilt"]
    at_pelvis = np.array([name.startswith("pelvis") for name in names])
    of_legs = np.array([name.startswith(("hip", "knee", "ankle", "subtalar")) for name in names])
    u = table.spread_inputs()[0].reshape(-1, len(names))
    return Measured(
        problem.value.intervals,
        solved.status,
        solved.cost,
        run.iterations,
        making,
        run.seconds,
        run.cpu_seconds,
        _find_mean(table.q[:, turns] - wanted[:, turns]),
        float(table.states[:, : len(read_muscles())].max()),
        _find_mean(u[:, at_pelvis]),
        _find_mean(u[:, of_legs]),
    )


def _find_mean(x: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(x**2)))


def write_page(row: Measured) -> str:
    """Write the page."""
    titles = ("intervals", "status", "cost", "iterations", "s", "processor s", "s to make", "angles apart [rad]")
    cells = (
        str(row.intervals),
        row.status,
        f"{row.cost:.9g}",
        str(row.iterations),
        f"{row.seconds:.1f}",
        f"{row.processor:.1f}",
        f"{row.making:.0f}",
        f"{row.apart:.2g}",
    )
    return "\n".join(
        [
            "# A stride of 80 muscles",
            "",
            "Written by `python -m benchmarks.moco.stride`. " + " ".join((__doc__ or "").split("\n\n", 1)[1].split()),
            "The stride is made, not recorded. Moco is not measured here. `s to make` is for generating and compiling,",
            "or for finding what was made before.",
            "",
            f"The largest activation is {row.hardest:.2g}. Motors of the pelvis give {row.pelvis:.2g} N or N m in the",
            f"mean, motors of the legs {row.legs:.2g} N m: muscles do the rest.",
            "",
            *tabulate(titles, [cells]),
            "",
            describe_machine(),
            "",
        ]
    )


if __name__ == "__main__":
    main()
