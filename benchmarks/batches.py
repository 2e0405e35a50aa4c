"""Kernels in batches, one state after the other and in lanes, beside peers: `python -m benchmarks.batches`.

Times are processor times of one core, in ns a state: the least of many calls for 8192 states, into arrays that are
there. In arrays by rows a state's numbers follow each other, in arrays by columns the states do; both give the same
digits. Other programs run beside on this machine, so times vary by some tens of percent from run to run.

Peers compute the same mechanisms in the same run, in one thread and a process for each (`batch_peers.py`); their
results are compared with the kernels'. `--python PEER=COMMAND` starts a peer by another interpreter, for versions of
JAX that it works with, or is quicker with.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import mbsrun
from benchmarks import batch_peers
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from benchmarks.robots import ROBOTS, find_robot
from benchmarks.step_gradients import Steps, measure_steps
from mbsgen.manifest import Kernel
from mbsgen.pipeline import Options, generate
from mbsrun import many
from mbsrun.kernel import Array, Kernels

ROOT = Path(__file__).parents[1]
MODELS = {
    "arm_pendulum": ROOT / "models" / "arm_pendulum.yaml",
    "panda": ROOT / "benchmarks" / "models" / "panda.yaml",
    "four_bar": ROOT / "models" / "four_bar.yaml",
}
FUNCTIONS = ("impl", "exp2")
STATES = 8192
MOTIONS, STEPS = 2048, 100
TREES = ("arm_pendulum", "panda")
COMPARED = ("arm_pendulum", "panda", *ROBOTS)  # with peers
XLA = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


@dataclass(frozen=True)
class Times:
    """Nanoseconds a state, by the way of computing."""

    one: float
    rows: float
    columns: float


Row = tuple[str, str, Times]  # mechanism, kernel, times
Told = Mapping[str, float | str]  # a peer's time, or a reason, by function


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/batches.md"), help="the page")
    parser.add_argument("--repeats", type=int, default=200, help="calls of which the quickest counts")
    parser.add_argument("--python", nargs="*", default=[], metavar="PEER=COMMAND", help="interpreters of peers")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds of a peer in a mechanism, with compilation")
    arguments = parser.parse_args()
    pythons = dict(item.split("=", 1) for item in arguments.python)
    with TemporaryDirectory() as folder:
        models = MODELS | {name: path for name in ROBOTS if (path := find_robot(name, Path(folder)))}
        rows = [row for name, model in models.items() for row in measure_model(name, model, arguments.repeats)]
        motions = {name: measure_motions(MODELS[name], max(1, arguments.repeats // 20)) for name in TREES}
        steps = list(measure_steps(MODELS["panda"], arguments.repeats))
        compared = {name: model for name, model in models.items() if name in COMPARED}
        peers = {name: measure_peers(name, model, pythons, arguments.limit) for name, model in compared.items()}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(write_page(rows, motions, steps, peers), encoding="utf-8")
    print(f"{arguments.out} holds the figures.")


def measure_peers(name: str, model: Path, pythons: Mapping[str, str], limit: float) -> dict[str, Told]:
    """Measure all peers in a mechanism, each in a process; print a line for each."""
    found = {}
    for peer in batch_peers.PEERS:
        command = [pythons.get(peer, sys.executable), "-m", "benchmarks.batch_peers", peer, str(model)]
        environment = os.environ | {"JAX_ENABLE_X64": "1", "XLA_FLAGS": XLA, "OMP_NUM_THREADS": "1"}
        try:
            run = subprocess.run(
                command, capture_output=True, text=True, timeout=limit, check=False, cwd=ROOT, env=environment
            )
            found[peer] = read_answer(run.stdout, run.stderr)
        except subprocess.TimeoutExpired:
            found[peer] = dict.fromkeys(FUNCTIONS, f"more than {limit:.0f} s, with compilation")
        print(f"{name:<14}{peer:<20}{found[peer]}")
    return found


def read_answer(printed: str, errors: str) -> Told:
    """Read what a peer's process has printed."""
    last = printed.strip().splitlines()[-1:]
    try:
        told: Told = json.loads(last[0])
    except (IndexError, json.JSONDecodeError):
        return dict.fromkeys(FUNCTIONS, (errors.strip().splitlines() or ["it ended"])[-1][:120])
    return told


def measure_model(name: str, model: Path, repeats: int) -> Iterator[Row]:
    """Measure every function of a mechanism; print a line for each."""
    with TemporaryDirectory() as folder:
        generate(model, Path(folder) / name, Options(functions=FUNCTIONS, derivatives=1))
        kernels = mbsrun.load(Path(folder) / name)
        for function in FUNCTIONS:
            for kernel in (function, f"jac_{function}"):
                found = measure(kernels, kernel, repeats)
                print(f"{name:<14}{kernel:<12}{found.one:9.1f}{found.rows:9.1f}{found.columns:9.1f}")
                yield name, kernel, found


def measure_motions(model: Path, repeats: int) -> float:
    """Return the steps of the classical Runge-Kutta method that a core takes in a second, of 2048 motions."""
    with TemporaryDirectory() as folder:
        generate(model, Path(folder) / "model", Options(functions=("exp2",), derivatives=0))
        mechanism = mbsrun.load(Path(folder) / "model")
        starts = np.random.default_rng(0).uniform(0.1, 0.6, (MOTIONS, len(mechanism.manifest.coordinates)))
        least = float("inf")
        for _ in range(repeats):
            start = time.process_time()
            found = mbsrun.rollout(mechanism, starts, 0 * starts, step=1e-3, steps=STEPS, every=STEPS)
            least = min(least, time.process_time() - start)
        assert not found.status.any()
    print(f"{model.stem:<14}{MOTIONS * STEPS / least / 1e6:9.2f} million steps a second")
    return MOTIONS * STEPS / least


def measure(kernels: Kernels, name: str, repeats: int) -> Times:
    """Measure a kernel. Raises AssertionError where the ways differ by more than rounding."""
    rows = draw(kernels.describe(name))
    columns = {key: np.asfortranarray(array) for key, array in rows.items()}
    fewest, bytes_per_state = many.FEWEST, many.BYTES_PER_STATE
    many.FEWEST = STATES + 1
    one, expected = time_batch(kernels, name, rows, repeats)
    many.FEWEST, many.BYTES_PER_STATE = 1, 10**9
    try:
        lanes = [time_batch(kernels, name, inputs, repeats) for inputs in (rows, columns)]
    finally:
        many.FEWEST, many.BYTES_PER_STATE = fewest, bytes_per_state
    for _, results in lanes:
        for key, array in results.items():
            np.testing.assert_allclose(array, expected[key], rtol=0, atol=1e-9 * np.abs(expected[key]).max(initial=1.0))
    return Times(one, *(seconds for seconds, _ in lanes))


def draw(kernel: Kernel) -> dict[str, Array]:
    """Draw states in which mechanisms are closed, or nearly, and none fails."""
    rng = np.random.default_rng(0)
    given = (a for a in kernel.inputs if a.nnz and a.cols == 1)
    return {a.name: rng.uniform(0.1, 0.6, (STATES, a.rows)) for a in given}


def time_batch(kernels: Kernels, name: str, inputs: Mapping[str, Any], repeats: int) -> tuple[float, dict[str, Array]]:
    """Return the least time in ns a state, and the results."""
    results, status = kernels.batch(name, **inputs)
    assert not status.any(), f"{name} fails in {np.count_nonzero(status)} states"
    return time_call(lambda: kernels.batch(name, out=results, **inputs), repeats), results


def time_call(call: Callable[[], object], repeats: int) -> float:
    """Return the least time of a call in ns a state."""
    least = float("inf")
    for _ in range(repeats):
        start = time.process_time_ns()
        call()
        least = min(least, time.process_time_ns() - start)
    return least / STATES


def write_page(
    rows: Sequence[Row],
    motions: Mapping[str, float],
    steps: Sequence[Steps],
    peers: Mapping[str, Mapping[str, Told]],
) -> str:
    """Write the tables as a page."""
    about, further = ((__doc__ or "").split("\n\n")[k].strip().replace("\n", " ") for k in (1, 2))
    machine = f"{describe_machine()}; {os.getloadavg()[0]:.1f} processes wanted its {os.cpu_count()} cores at the end"
    lines = ["# Batches", "", f"`python -m benchmarks.batches` wrote this page: {machine}.", "", about, ""]
    cells = (
        [name, kernel, *(f"{ns:.1f}" for ns in (x.one, x.rows, x.columns)), f"{x.one / min(x.rows, x.columns):.1f}"]
        for name, kernel, x in rows
    )
    titles = ["mechanism", "kernel", "one by one", "lanes, rows", "lanes, columns", "gain"]
    lines += [*tabulate(titles, cells, words=2), "", "## Motions", ""]
    made = ([name, f"{1e-6 * found:.1f}"] for name, found in motions.items())
    lines += [*tabulate(["mechanism", f"million steps of RK4 a second, {MOTIONS} motions"], made), ""]
    lines += [
        "Steps of the Panda with their gradient: the product of weights with the derivatives by q, qd and u, by the "
        "adjoint's kernel in lanes, from C (`step_gradients.py`). Millions a second:",
        "",
    ]
    each = ([x.method, str(x.width), f"{x.alone:.1f}", f"{x.with_gradient:.1f}"] for x in steps)
    lines += [*tabulate(["method", "lanes", "steps", "steps with gradient"], each), "", "## Peers", "", further, ""]
    return "\n".join([*lines, *_write_peers(rows, peers)]) + "\n"


def _write_peers(rows: Sequence[Row], peers: Mapping[str, Mapping[str, Told]]) -> Iterator[str]:
    yield " ".join((batch_peers.__doc__ or "").split("\n\n")[1].split())
    yield ""
    ours = {(name, kernel): min(x.rows, x.columns) for name, kernel, x in rows}
    reasons: dict[tuple[str, str], list[str]] = {}
    cells = []
    for name, found in peers.items():
        for function in FUNCTIONS:
            row = [name, function, f"{ours[name, function]:.0f}"]
            for peer, told in found.items():
                ns = told[function]
                if isinstance(ns, str):
                    reasons.setdefault((peer, ns), []).append(f"{function} of {name}")
                row.append("" if isinstance(ns, str) else f"{ns:.0f} ({ns / ours[name, function]:.0f})")
            cells.append(row)
    yield "Times in ns a state; in brackets, how many times ours that is."
    yield ""
    yield from tabulate(["mechanism", "function", "lanes", *batch_peers.PEERS], cells, words=2)
    if reasons:
        yield from ["", "Not measured:", ""]
        yield from (f"- {peer}: {', '.join(places)}: {why}" for (peer, why), places in reasons.items())


if __name__ == "__main__":
    main()
