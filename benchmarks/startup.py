"""Measure commands from their start to their end: `python -m benchmarks.startup [--before CHECKOUT]`.

Each run is a new process, measured in the processor time of it and its children. Bytecode is there, and, except in one
row, generated and compiled files are in the cache. With another checkout, both run in turn, so that both are disturbed
alike. The shortest of some rounds counts.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from benchmarks.robots import find_robot

ROOT = Path(__file__).parents[1]
ROUNDS = 5
SEED, JOINTS = 1, 12  # of the tree
PAGE = "startup.md"

_MBSGEN, _MBSRUN = ("-c", "from mbsgen.cli import main; main()"), ("-c", "from mbsrun.cli import main; main()")
_CALL = """
import numpy, mbsrun
kernels = mbsrun.load({model!r})
rest = numpy.zeros(6)
kernels.impl(q=rest, qd=rest, qdd=rest, u=numpy.zeros(4))
"""


@dataclass(frozen=True)
class Task:
    """A process, by the arguments of Python."""

    name: str
    arguments: tuple[str, ...]
    rounds: int = ROUNDS
    is_cold: bool = False  # begins with an empty cache


@dataclass(frozen=True)
class Row:
    """The seconds of each run of a task, by checkout."""

    name: str
    seconds: Mapping[str, list[float]] = field(default_factory=dict)

    def shortest(self, checkout: str) -> float:
        """Return the shortest run."""
        return min(self.seconds[checkout])


def write_tree(seed: int, joints: int) -> str:
    """Write a model of random joints: three of four turn, any branching, full inertias, turned axes."""
    rng = np.random.default_rng(seed)

    def write(values: NDArray[np.float64]) -> str:
        return f"[{', '.join(f'{x:.4f}' for x in values)}]"

    lines = [f"name: tree_of_{joints}", "gravity: [0, 0, -9.81]", "bodies:"]
    for i in range(joints):
        moments = rng.normal(size=(3, 3))
        spread = 0.02 * moments @ moments.T + 0.01 * np.eye(3)
        inertia = np.trace(spread) * np.eye(3) - spread  # of a body that there can be
        places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
        joint = {
            "name": f"q{i}",
            "type": "revolute" if rng.random() < 0.75 else "prismatic",
            "axis": "xyz"[rng.integers(3)],
            "position": write(rng.uniform(-0.5, 0.5, 3)),
            "orientation": f"{{rpy: {write(rng.uniform(-1, 1, 3))}}}",
        }
        lines += [
            f"  - name: b{i}",
            *([f"    parent: b{rng.integers(max(0, i - 3), i)}"] if i else []),
            f"    joint: {{{', '.join(f'{key}: {value}' for key, value in joint.items())}}}",
            f"    mass: {rng.uniform(0.5, 3):.4f}",
            f"    com: {write(rng.uniform(-0.3, 0.3, 3))}",
            f"    inertia: {{{', '.join(f'{key}: {inertia[place]:.4f}' for key, place in places.items())}}}",
        ]
    return "\n".join(lines) + "\n"


def list_tasks(folder: Path, rounds: int) -> Iterator[Task]:
    """List the tasks; they write to a folder."""
    arm, swing = ROOT / "models" / "arm_pendulum.yaml", ROOT / "models" / "cart_pole_swing_up.ocp.yaml"
    yield Task("`mbsgen --help`", (*_MBSGEN, "--help"), rounds)
    yield Task("`mbsrun --help`", (*_MBSRUN, "--help"), rounds)
    yield Task("`import mbsrun`", ("-c", "import mbsrun"), rounds)
    yield Task(
        "`mbsrun solve` of the cart-pole, with all files", (*_MBSRUN, "solve", str(swing), "-o", f"{folder}/s"), rounds
    )
    yield Task("`mbsgen` of the paper's arm, with all files", (*_MBSGEN, str(arm), "-o", f"{folder}/arm"), rounds)
    tree = folder / "tree.yaml"
    tree.write_text(write_tree(SEED, JOINTS), encoding="utf-8")
    few = max(1, rounds // 2)
    yield Task(f"`mbsgen` of a tree of {JOINTS} joints", (*_MBSGEN, str(tree), "-o", f"{folder}/tree"), few)
    if talos := find_robot("talos", folder):
        first = (*_MBSGEN, str(talos), "-o", f"{folder}/talos", "--derivatives", "1")
        forms = ("--functions", "impl,semi_res,exp1,exp2")
        yield Task("`mbsgen` of Talos, four formulations with first derivatives", (*first, *forms), few)
    call = ("-c", _CALL.format(model=str(arm)))
    yield Task("first call of the arm's `impl`, with nothing in the cache", call, rounds, is_cold=True)


def measure(tasks: Sequence[Task], checkouts: Mapping[str, Path]) -> Iterator[Row]:
    """Run each task once to warm up, then in rounds, by the code of each checkout in turn."""
    with tempfile.TemporaryDirectory() as kept:
        for task in tasks:
            row = Row(task.name, {name: [] for name in checkouts})
            for k in range(task.rounds + 1):
                for name, checkout in checkouts.items():
                    seconds = _run(task, checkout, Path(kept) / name)
                    if k:
                        row.seconds[name].append(seconds)
            yield row


def _run(task: Task, checkout: Path, kept: Path) -> float:
    """Return the processor time of a process and its children [s]. Raises CalledProcessError where it fails."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment |= {
        "PYTHONPATH": os.pathsep.join(str(checkout / part) for part in ("generator", "python")),
        "PYTHONPYCACHEPREFIX": str(kept / "bytecode"),
        "XDG_CACHE_HOME": str(kept / "cache"),
    }
    with tempfile.TemporaryDirectory() as empty:
        if task.is_cold:
            environment["XDG_CACHE_HOME"] = empty
        before = os.times()
        subprocess.run((sys.executable, *task.arguments), env=environment, check=True, capture_output=True, cwd=empty)
        after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def _find_version(checkout: Path) -> str:
    """Return the commit of a checkout, or its path where it has none."""
    command = ("git", "-C", str(checkout), "rev-parse", "--short", "HEAD")
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return found.stdout.strip() or checkout.name


def write_page(rows: Sequence[Row], checkouts: Mapping[str, Path], load: float) -> str:
    """Write a page in Markdown."""
    is_pair = len(checkouts) > 1
    titles = ("", "before [s]", "now [s]", "times faster") if is_pair else ("", "now [s]")

    def write_cells(row: Row) -> list[str]:
        if not is_pair:
            return [row.name, f"{row.shortest('now'):.2f}"]
        before, now = row.shortest("before"), row.shortest("now")
        return [row.name, f"{before:.2f}", f"{now:.2f}", f"{before / now:.2f}"]

    rounds = max(len(row.seconds["now"]) for row in rows)
    versions = " and ".join(map(_find_version, checkouts.values()))
    lines = [
        "# From the start of a command to its end",
        "",
        f"`python -m benchmarks.startup`: {describe_machine()}; {rounds} rounds, the shortest counts; {load:.1f} "
        "processes wanted to run.",
        "",
        "Processor time of a whole process with its children, in seconds. Bytecode is there; the cache is warm except",
        f"in the last row. The tree of {JOINTS} random joints is written with all second derivatives.",
        *([f"Both versions run in turn, so their ratio says more than their times: {versions}."] if is_pair else []),
        "",
        *tabulate(titles, map(write_cells, rows)),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and print the page; write it where a folder is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help="another checkout to run in turn")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--only", metavar="WORD", help="tasks whose name has this word")
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help=f"where to write {PAGE}")
    given = parser.parse_args()
    checkouts = ({"before": given.before.resolve()} if given.before else {}) | {"now": ROOT}
    with tempfile.TemporaryDirectory() as folder:
        tasks = [task for task in list_tasks(Path(folder), given.rounds) if not given.only or given.only in task.name]
        page = write_page([*measure(tasks, checkouts)], checkouts, os.getloadavg()[0])
    print(page, end="")
    if given.output:
        given.output.mkdir(parents=True, exist_ok=True)
        (given.output / PAGE).write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
