"""Published examples of OpenSim Moco, solved by both programs on the same grids: `python -m benchmarks.moco`.

MBSGEN_OPENSIM names a Python that has OpenSim (`pip install opensim` in a separate environment); without it, OpenSim of
build/peers is taken.

Moco starts from its own guess, with a tolerance of 1e-6, for the time that it takes: with each of four options, of
which the quickest counts whose cost is ours to 1 %. It also starts from our motion on the same grid, with 1e-8 and its
default options: without second derivatives, its search stops short of an optimum that is flat. This solve shows whether
our motion is an optimum of its program, since then the cost stays.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsrun import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solution.table import list_additions, list_motion
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
HANGING = FOLDER.parents[1] / "models" / "moco" / "hanging.ocp.yaml"
PEERS = FOLDER.parents[1] / "build" / "peers"
RUNS = 5
ITERATIONS = 300  # of Moco
AGREED = 1e-6  # of the cost
NEAR = 1e-2  # of the cost: how far options may end from ours
SOLVED = "Solve_Succeeded"
OPTIONS = tuple(product(("limited-memory", "exact"), ("central", "forward")))  # Hessians, differences: defaults first


@dataclass(frozen=True)
class Case:
    """A problem of both programs; paths of Moco, and our numbers of the motion."""

    name: str
    title: str
    file: Path
    joints: Mapping[str, str]  # Moco's coordinates, and ours
    controls: Mapping[str, str]  # Moco's controls, and our states or controls
    states: Mapping[str, str] = field(default_factory=dict)
    derivatives: Mapping[str, str] = field(
        default_factory=dict
    )  # Moco's derivatives, and our controls or accelerations
    scales: Mapping[str, float] = field(default_factory=dict)  # of controls: our number over Moco's


def _drive(joints: Mapping[str, str]) -> dict[str, str]:
    return {f"/forceset/tau_{ours}": f"input_{ours}" for ours in joints.values()}


_SLIDER = {"/jointset/slider/position": "position"}
_LEG = {f"/jointset/{q}/{q}": q for q in ("ankle", "knee", "hip")}
CASES = (
    Case("sliding_mass", "sliding mass, least time", FOLDER / "sliding_mass.ocp.yaml", _SLIDER, _drive(_SLIDER)),
    Case(
        "squat",
        "squat to stand, torques",
        FOLDER / "squat.ocp.yaml",
        _LEG,
        _drive(_LEG),
        scales={f"/forceset/tau_{q}": force for q, force in (("ankle", 150.0), ("knee", 300.0), ("hip", 150.0))},
    ),
    Case(
        "hanging",
        "hanging muscle",
        HANGING,
        {"/jointset/joint/height": "height"},
        {"/forceset/muscle": "muscle_excitation"},
        states={"/forceset/muscle/activation": "muscle", "/forceset/muscle/normalized_tendon_force": "tendon"},
        derivatives={
            "/jointset/joint/height/accel": "acceleration height",
            "/forceset/muscle/implicitderiv_normalized_tendon_force": "tendon_rate",
        },
    ),
)


@dataclass(frozen=True)
class Run:
    """One solve by Moco."""

    cost: float
    status: str
    iterations: int
    seconds: float
    processor: float
    options: str = ""


@dataclass(frozen=True)
class Row:
    """One case by both programs."""

    case: Case
    grid: str
    cost: float
    seconds: float  # of the search, the least of some
    processor: float
    iterations: int
    own: Run  # from Moco's own guess
    near: Run  # from our motion

    @property
    def off(self) -> float:
        """Return how far Moco's cost from our motion is from ours, relative to ours."""
        return (self.near.cost - self.cost) / self.cost

    @property
    def off_alone(self) -> float:
        """Return the same from Moco's own guess."""
        return (self.own.cost - self.cost) / self.cost


def main() -> None:
    """Solve all cases, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/moco.md"), help="the page")
    parser.add_argument("--case", action="append", choices=[case.name for case in CASES], help="some cases alone")
    given = parser.parse_args()
    rows = []
    for case in CASES:
        if given.case is None or case.name in given.case:
            rows.append(measure(case))
            print(f"{case.name}: {rows[-1].cost:.9g}, Moco {rows[-1].near.cost:.9g}", flush=True)
    page = write_page(rows)
    print(page)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(page, encoding="utf-8")


def measure(case: Case) -> Row:
    """Solve one case by both programs."""
    problem, plant = read_problem(case.file, load)
    seconds, processor = math.inf, math.inf
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    for _ in range(RUNS):
        wall, own = time.perf_counter(), time.process_time()
        solve(problem, plant)
        seconds, processor = min(seconds, time.perf_counter() - wall), min(processor, time.process_time() - own)
    alone = choose([ask(case, 1e-6, None, options) for options in OPTIONS], found.cost.total)
    near = ask(case, 1e-8, write_motion(case, found))
    grid = f"{problem.intervals} intervals, {problem.family.value} {problem.degree}"
    return Row(case, grid, found.cost.total, seconds, processor, found.run.iterations, alone, near)


def choose(runs: Sequence[Run], cost: float) -> Run:
    """Return the quickest run that ends near a cost; the first one where none does."""
    solved = [run for run in runs if run.status == SOLVED and abs(run.cost - cost) <= NEAR * abs(cost)]
    return min(solved, key=lambda run: run.processor) if solved else runs[0]


def write_motion(case: Case, solution: Solution) -> dict[str, Any]:
    """Write a motion at all points of its grid, by Moco's paths."""
    problem, plant, trajectory = solution.problem, load(read_model(case.file)), solution.trajectory
    t, q, qd, qdd, _ = list_motion(trajectory)
    states, controls = list_additions(trajectory)
    names = [c.name for c in plant.manifest.coordinates]
    values: dict[str, Array] = {state.name: column for state, column in zip(problem.states, states.T, strict=False)}
    values |= {control.name: column for control, column in zip(problem.controls, controls.T, strict=True)}
    values |= {f"acceleration {name}": column for name, column in zip(names, qdd.T, strict=True)}
    columns = {f"{path}/value": q[:, names.index(name)] for path, name in case.joints.items()}
    columns |= {f"{path}/speed": qd[:, names.index(name)] for path, name in case.joints.items()}
    columns |= {path: values[name] for path, name in case.states.items()}
    return {
        "time": t.ravel().tolist(),
        "states": {path: column.tolist() for path, column in columns.items()},
        "controls": {path: (values[x] / case.scales.get(path, 1.0)).tolist() for path, x in case.controls.items()},
        "derivatives": {path: values[name].tolist() for path, name in case.derivatives.items()},
    }


def read_model(file: Path) -> Path:
    """Return the model of a problem file."""
    line = next(x for x in file.read_text("utf-8").splitlines() if x.startswith("model: "))
    return file.parent / line.removeprefix("model: ").strip()


def ask(case: Case, tolerance: float, guess: dict[str, Any] | None, options: tuple[str, str] = OPTIONS[0]) -> Run:
    """Solve a case by Moco with some of OPTIONS, in a separate folder, where it leaves its log."""
    python, path = os.environ.get("MBSGEN_OPENSIM"), os.environ.get("PYTHONPATH", "")
    if python is None and not (PEERS / "opensim").exists():
        raise SystemExit(
            "no OpenSim: let MBSGEN_OPENSIM name a Python that has it, or call python -m tests.peers build/peers"
        )
    own = path if python else os.pathsep.join([path, str(PEERS)])
    asked = {"case": case.name, "tolerance": tolerance, "iterations": ITERATIONS, "guess": guess}
    asked |= {"hessian": options[0], "differences": options[1]}
    with TemporaryDirectory() as folder:
        run = subprocess.run(
            [python or sys.executable, str(FOLDER / "peer.py")],
            input=json.dumps(asked),
            cwd=folder,
            env={**os.environ, "PYTHONPATH": own, "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
    if run.returncode:
        raise SystemExit(f"{case.name}: OpenSim fails:\n{run.stderr}")
    return Run(**json.loads(run.stdout.splitlines()[-1]), options=", ".join(options))


def write_page(rows: list[Row]) -> str:
    """Write the page."""
    costs = [
        (
            row.case.title,
            row.grid,
            f"{row.cost:.9g}",
            f"{row.near.cost:.9g}",
            f"{row.off:+.1e}",
            str(row.near.iterations),
            f"{row.off_alone:+.1e}",
            f"{row.own.status}, {row.own.iterations}",
        )
        for row in rows
    ]
    times = [
        (
            row.case.title,
            str(row.iterations),
            f"{row.seconds:.3f}",
            f"{row.processor:.3f}",
            str(row.own.iterations),
            f"{row.own.seconds:.1f}",
            f"{row.own.processor:.2f}",
            f"{row.own.processor / row.processor:.0f}",
            row.own.options,
        )
        for row in rows
    ]
    agreed = sum(abs(row.off) <= AGREED for row in rows)
    headings = ("problem", "grid", "our cost", "Moco's from our motion", "off", "its steps", "off, alone", "alone")
    clocks = ("problem", "our steps", "s", "processor s", "Moco's steps", "s", "processor s", "ratio", "Moco's options")
    return "\n".join(
        [
            "# Examples of OpenSim Moco",
            "",
            "Written by `python -m benchmarks.moco`. " + " ".join((__doc__ or "").split("\n\n", 2)[2].split()),
            "",
            f"From our motion, Moco's cost is ours to {AGREED:g} in {agreed} of {len(rows)} problems. `off` is its",
            "distance from our cost, relative to this; `alone` is from Moco's own guess. With `lobatto`, both have",
            "Hermite and Simpson's rule and linear controls, Moco's default; with `radau`, controls are free at each",
            "point. The squat has numbers of our own, since the wheel brings no model. "
            f"Moco may take {ITERATIONS} steps.",
            "",
            *tabulate(headings, costs, words=2),
            "",
            f"Times are of a whole solve in a running process: ours the least of {RUNS}, with judge and re-simulation;",
            "Moco's of `study.solve()` from its own guess, in one thread. The ratio is the one of processor times.",
            "Moco's options are the approximation of the Hessian, and the scheme of differences.",
            "",
            *tabulate(clocks, times),
            "",
            describe_machine(),
            "",
        ]
    )


if __name__ == "__main__":
    main()
