"""Kernels on a GPU: `python -m benchmarks.gpu`, which needs a GPU of NVIDIA, and else writes nothing.

Millions of states a second, the most of some runs of 20 launches, from Python; results go into arrays that are there,
states side by side in memory. Before, results of some states are compared with the processor's. frax computes the
functions of the Panda that it brings, where it is installed (`pip install frax`) and JAX has a GPU.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import mbsrun
import mbsrun.cuda
from benchmarks.batches import FRAX, MODELS
from benchmarks.pages import tabulate
from mbsgen.manifest import Kernel
from mbsrun.cuda import Array, CudaError, Functions
from mbsrun.cuda.driver import Driver, find_driver
from mbsrun.cuda.nvrtc import find_nvrtc
from mbsrun.models import Extent

FUNCTIONS = ("impl", "exp2")
STATES, LAUNCHES, RUNS = 1 << 21, 20, 5
COMPARED = 200  # states
ROUNDING = {"float32": 2e-4, "float64": 1e-11}  # of results relative to their largest number


@dataclass(frozen=True)
class Row:
    """Millions of states a second."""

    mechanism: str
    kernel: str
    ours: Mapping[str, float]  # by precision
    frax: Mapping[str, float]


def main() -> None:
    """Measure, and write the page; say so where there is no GPU."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/gpu.md"), help="the page")
    arguments = parser.parse_args()
    try:
        driver, compiler = find_driver(), find_nvrtc()
    except CudaError as fault:
        print(f"Nothing is measured, and no page is written: {fault}.")
        return
    card, architecture = driver.describe(0)
    print(f"{card}, {architecture}, NVRTC {'.'.join(map(str, compiler.version))}")
    rows = [row for name, model in MODELS.items() for row in measure_model(driver, name, model)]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(write_page(f"{card} ({architecture})", rows), encoding="utf-8")
    print(f"{arguments.out} holds the figures.")


def measure_model(driver: Driver, name: str, model: Path) -> list[Row]:
    """Measure every function of a mechanism; print a line for each."""
    kernels = mbsrun.load(model, extent=Extent(FUNCTIONS, 1))
    functions = mbsrun.cuda.load(kernels)
    rows = []
    for function in FUNCTIONS:
        for kernel in (function, f"jac_{function}"):
            ours = {dtype: measure(driver, kernels, functions, kernel, dtype) for dtype in ROUNDING}
            is_shared = name == "panda" and kernel in FRAX
            frax = {dtype: x for dtype in ROUNDING if is_shared and (x := measure_frax(FRAX[kernel], dtype))}
            rows.append(Row(name, kernel, ours, frax))
            print(f"{name:<14}{kernel:<12}", *(f"{x:12.1f}" for x in (*ours.values(), *frax.values())))
    return rows


def measure(driver: Driver, kernels: mbsrun.Mechanism, functions: Functions, name: str, dtype: str) -> float:
    """Return millions of states a second. Raises AssertionError where results differ from the processor's."""
    given = draw(kernels.describe(name), STATES, dtype)
    there: dict[str, Any] = {key: put(driver, array) for key, array in given.items()}
    results, status = functions.batch(name, **there)
    few = {key: array[:COMPARED].astype(float) for key, array in given.items()}
    expected, _ = kernels.batch(name, **few)
    assert not status.get().any(), f"{name} fails in some states"
    for key, array in expected.items():
        largest = np.abs(array).max(initial=1.0)
        found = results[key].get()[:COMPARED]
        np.testing.assert_allclose(found, array, rtol=0, atol=ROUNDING[dtype] * largest, err_msg=f"{name} {key}")
    return find_rate(lambda: functions.batch(name, out=results, **there), lambda: wait(driver))


def wait(driver: Driver) -> None:
    """Wait for the default stream."""
    with driver.using(0):
        driver.wait(0)


def find_rate(start: Callable[[], object], finish: Callable[[], object]) -> float:
    """Return millions of states a second, of the quickest run."""
    start()
    finish()
    least = float("inf")
    for _ in range(RUNS):
        begin = time.perf_counter()
        for _ in range(LAUNCHES):
            start()
        finish()
        least = min(least, time.perf_counter() - begin)
    return 1e-6 * STATES * LAUNCHES / least


def draw(kernel: Kernel, states: int, dtype: str) -> dict[str, Any]:
    """Draw states in which mechanisms are closed, or nearly, and none fails."""
    rng = np.random.default_rng(0)
    given = (a for a in kernel.inputs if a.nnz and a.cols == 1)
    return {a.name: rng.uniform(0.1, 0.6, (states, a.rows)).astype(dtype) for a in given}


def put(driver: Driver, array: np.ndarray[Any, np.dtype[Any]]) -> Array:
    """Copy an array of states to the GPU, with the states side by side."""
    states, _ = array.shape
    with driver.using(0):
        made = Array(driver, 0, array.shape, (1, states), array.dtype.name, 0)
        driver.copy_to(made.pointer, array.T.tobytes())
    return made


def measure_frax(function: str, dtype: str) -> float | None:
    """Measure frax's function of the Panda, mapped over the states and compiled; None where it or a GPU is missing."""
    if find_spec("frax") is None or find_spec("jax") is None:
        return None
    import jax

    try:
        jax.devices("gpu")
    except RuntimeError:
        return None
    jax.config.update("jax_enable_x64", dtype == "float64")
    robot = import_module("frax.robots.franka_panda").load_panda()
    gravity = jax.numpy.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81], dtype)
    functions = {
        "rnea": lambda q, v, a: robot.rnea(q, v, a, gravity, None),
        "forward_dynamics": lambda q, v, tau: robot.forward_dynamics(q, v, tau, None),
    }
    compute = jax.jit(jax.vmap(functions[function]))
    rng = np.random.default_rng(0)
    states = [jax.numpy.asarray(rng.uniform(0.1, 0.6, (STATES, 7)).astype(dtype)) for _ in range(3)]
    last: list[Any] = [None]

    def start() -> None:
        last[0] = compute(*states)

    return find_rate(start, lambda: last[0].block_until_ready())


def write_page(machine: str, rows: Sequence[Row]) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    lines = ["# On a GPU", "", f"`python -m benchmarks.gpu` wrote this page: {machine}.", "", about, ""]
    titles = ["mechanism", "kernel", "float32", "float64", "frax, float32", "frax, float64"]
    cells = (
        [row.mechanism, row.kernel]
        + [f"{found[dtype]:.0f}" if dtype in found else "" for found in (row.ours, row.frax) for dtype in ROUNDING]
        for row in rows
    )
    return "\n".join([*lines, *tabulate(titles, cells, words=2)]) + "\n"


if __name__ == "__main__":
    main()
