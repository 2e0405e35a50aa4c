"""Kernels in batches, one state after the other and in lanes: `python -m benchmarks.batches`.

Times are of one core, in ns a state: the least of many calls for 8192 states, into arrays that are there. In arrays by
rows a state's numbers follow each other, in arrays by columns the states do; both give the same digits. frax, if it is
installed (`pip install frax`), computes the function of the Panda that it brings, in doubles, on one thread of JAX.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import mbsrun
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from benchmarks.robots import ROBOTS, find_robot
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
FRAX = {"impl": "rnea", "exp2": "forward_dynamics"}


@dataclass(frozen=True)
class Times:
    """Nanoseconds a state, by the way of computing."""

    one: float
    rows: float
    columns: float


Row = tuple[str, str, Times, float | None]  # mechanism, kernel, times, and frax's


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/batches.md"), help="the page")
    parser.add_argument("--repeats", type=int, default=200, help="calls of which the quickest counts")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        models = MODELS | {name: path for name in ROBOTS if (path := find_robot(name, Path(folder)))}
        rows = [row for name, model in models.items() for row in measure_model(name, model, arguments.repeats)]
        motions = {name: measure_motions(MODELS[name], max(1, arguments.repeats // 20)) for name in TREES}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(write_page(rows, motions), encoding="utf-8")
    print(f"{arguments.out} holds the figures.")


def measure_model(name: str, model: Path, repeats: int) -> Iterator[Row]:
    """Measure every function of a mechanism; print a line for each."""
    with TemporaryDirectory() as folder:
        generate(model, Path(folder) / name, Options(functions=FUNCTIONS, derivatives=1))
        kernels = mbsrun.load(Path(folder) / name)
        for function in FUNCTIONS:
            for kernel in (function, f"jac_{function}"):
                found = measure(kernels, kernel, repeats)
                peer = measure_frax(FRAX[kernel], repeats) if name == "panda" and kernel in FRAX else None
                print(f"{name:<14}{kernel:<12}{found.one:9.1f}{found.rows:9.1f}{found.columns:9.1f} {peer or ''}")
                yield name, kernel, found, peer


def measure_motions(model: Path, repeats: int) -> float:
    """Return the steps of the classical Runge-Kutta method that a core takes in a second, of 2048 motions."""
    with TemporaryDirectory() as folder:
        generate(model, Path(folder) / "model", Options(functions=("exp2",), derivatives=0))
        mechanism = mbsrun.load(Path(folder) / "model")
        starts = np.random.default_rng(0).uniform(0.1, 0.6, (MOTIONS, len(mechanism.manifest.coordinates)))
        least = float("inf")
        for _ in range(repeats):
            start = time.perf_counter()
            found = mbsrun.rollout(mechanism, starts, 0 * starts, step=1e-3, steps=STEPS, every=STEPS)
            least = min(least, time.perf_counter() - start)
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
        start = time.perf_counter_ns()
        call()
        least = min(least, time.perf_counter_ns() - start)
    return least / STATES


def measure_frax(function: str, repeats: int) -> float | None:
    """Measure frax's function in doubles, mapped over the states and compiled; None where it is not installed."""
    if find_spec("frax") is None:
        return None
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    os.environ.setdefault(  # one thread, and what frax recommends
        "XLA_FLAGS",
        "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
        " --xla_cpu_scheduler_type=CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
    )
    import jax

    jax.config.update("jax_enable_x64", True)
    robot = import_module("frax.robots.franka_panda").load_panda()
    gravity = jax.numpy.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
    functions = {
        "rnea": lambda q, v, a: robot.rnea(q, v, a, gravity, None),
        "forward_dynamics": lambda q, v, tau: robot.forward_dynamics(q, v, tau, None),
    }
    compute = jax.jit(jax.vmap(functions[function]))
    rng = np.random.default_rng(0)
    states = [jax.numpy.asarray(rng.uniform(0.1, 0.6, (STATES, 7))) for _ in range(3)]
    compute(*states).block_until_ready()
    return time_call(lambda: compute(*states).block_until_ready(), repeats)


def write_page(rows: Sequence[Row], motions: Mapping[str, float]) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    lines = ["# Batches", "", f"`python -m benchmarks.batches` wrote this page: {describe_machine()}.", "", about, ""]
    cells = (
        [name, kernel, *(f"{ns:.1f}" for ns in (found.one, found.rows, found.columns)), *_ratios(found, peer)]
        for name, kernel, found, peer in rows
    )
    titles = ["mechanism", "kernel", "one by one", "lanes, rows", "lanes, columns", "gain", "frax", "frax by ours"]
    steps = ([name, f"{1e-6 * found:.1f}"] for name, found in motions.items())
    second = tabulate(["mechanism", f"million steps of RK4 a second, {MOTIONS} motions"], steps)
    return "\n".join([*lines, *tabulate(titles, cells, words=2), "", *second]) + "\n"


def _ratios(found: Times, peer: float | None) -> list[str]:
    gain = f"{found.one / min(found.rows, found.columns):.1f}"
    return [gain, "", ""] if peer is None else [gain, f"{peer:.0f}", f"{peer / min(found.rows, found.columns):.0f}"]


if __name__ == "__main__":
    main()
