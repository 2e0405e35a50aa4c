"""Kernels on a GPU: `python -m benchmarks.gpu`, which needs a GPU of NVIDIA, and else writes nothing.

Millions of states a second, the most of some runs of 20 launches, from Python; results go into arrays that are there,
states side by side in memory. Before, results of some states are compared with the processor's. Peers compute the
Panda: frax its own, MuJoCo's MJX and MuJoCo Warp ours, whose results are compared as well. Each is measured where it is
installed and finds the GPU.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mbsrun
import mbsrun.cuda
from benchmarks.batches import MODELS
from benchmarks.gpu_peers import Numbers, list_peers
from benchmarks.pages import tabulate
from mbsgen.manifest import Kernel
from mbsrun.cuda import Array, CudaError, Functions
from mbsrun.cuda.driver import Driver, find_driver
from mbsrun.cuda.images import write_source
from mbsrun.cuda.nvrtc import find_nvrtc
from mbsrun.models import Extent

FUNCTIONS = {"impl": ("qdd", "Phi"), "exp2": ("u", "qdd")}  # with the third input of the Panda, and the result
STATES, LAUNCHES, RUNS = 1 << 21, 20, 5
COMPARED = 200  # states
ROUNDING = {"float32": 2e-4, "float64": 1e-11}  # of results relative to their largest number
OTHERS = ("frax",)  # peers whose Panda has other masses
ARCHITECTURES = ("sm_80", "sm_90")


@dataclass(frozen=True)
class Row:
    """Millions of states a second."""

    mechanism: str
    kernel: str
    rates: Mapping[str, float]  # by precision


@dataclass(frozen=True)
class Contest:
    """Millions of states a second of a function of the Panda."""

    function: str
    dtype: str
    ours: float
    peers: Mapping[str, float]


def main() -> None:
    """Measure, and write the page; say so where there is no GPU."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/gpu.md"), help="the page")
    parser.add_argument("--registers", type=Path, metavar="PAGE", help="write this page alone, which needs no GPU")
    arguments = parser.parse_args()
    if arguments.registers:
        save(arguments.registers, write_registers())
        return
    try:
        driver, compiler = find_driver(), find_nvrtc()
    except CudaError as fault:
        print(f"Nothing is measured, and no page is written: {fault}.")
        return
    card, architecture = driver.describe(0)
    machine = f"{card} ({architecture}), NVRTC {'.'.join(map(str, compiler.version))}"
    print(machine)
    rows = [row for name, model in MODELS.items() for row in measure_model(driver, name, model)]
    save(arguments.out, write_page(machine, rows, list(measure_peers(driver, rows))))


def save(page: Path, text: str) -> None:
    """Write a page, and say where."""
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")
    print(f"{page} holds the figures.")


def measure_model(driver: Driver, name: str, model: Path) -> Iterator[Row]:
    """Measure every function of a mechanism; print a line for each."""
    kernels = mbsrun.load(model, extent=Extent(tuple(FUNCTIONS), 1))
    functions = mbsrun.cuda.load(kernels)
    for function in FUNCTIONS:
        for kernel in (function, f"jac_{function}"):
            rates = {dtype: measure(driver, kernels, functions, kernel, dtype) for dtype in ROUNDING}
            print(f"{name:<14}{kernel:<12}", *(f"{x:12.1f}" for x in rates.values()))
            yield Row(name, kernel, rates)


def measure(driver: Driver, kernels: mbsrun.Mechanism, functions: Functions, name: str, dtype: str) -> float:
    """Return millions of states a second. Raises AssertionError where results differ from the processor's."""
    given = draw(kernels.describe(name), STATES, dtype)
    there: dict[str, Any] = {key: put(driver, array) for key, array in given.items()}
    results, status = functions.batch(name, **there)
    assert not status.get().any(), f"{name} fails in some states"
    for key, expected in compute_few(kernels, name, given).items():
        compare(results[key].get(), expected, dtype, f"{name} {key}")
    return find_rate(lambda: functions.batch(name, out=results, **there), lambda: wait(driver))


def compute_few(kernels: mbsrun.Mechanism, name: str, given: Mapping[str, Numbers]) -> dict[str, Any]:
    """Return the processor's results of the first states."""
    few: dict[str, Any] = {key: array[:COMPARED].astype(float) for key, array in given.items()}
    return kernels.batch(name, **few)[0]


def compare(found: Numbers, expected: Numbers, dtype: str, name: str) -> None:
    """Compare results of the first states. Raises AssertionError."""
    largest = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(found[:COMPARED], expected, rtol=0, atol=ROUNDING[dtype] * largest, err_msg=name)


def measure_peers(driver: Driver, rows: Sequence[Row]) -> Iterator[Contest]:
    """Measure the peers on the Panda; print a line for each function."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # memory for everybody
    kernels = mbsrun.load(MODELS["panda"], extent=Extent(tuple(FUNCTIONS), 1))
    wait(driver)
    for function, (last, result) in FUNCTIONS.items():
        for dtype in ROUNDING:
            ours = next((r.rates[dtype] for r in rows if (r.mechanism, r.kernel) == ("panda", function)), 0.0)
            given = draw(kernels.describe(function), STATES, dtype)
            force = given.get("u")
            if function == "impl" and force is not None:
                force[...] = 0  # the peers' inverse dynamics have none
            expected, found = compute_few(kernels, function, given)[result], {}
            for name, (prepare, dtypes) in list_peers().items():
                if dtype not in dtypes:
                    continue
                work = prepare(function, given["q"], given["qd"], given[last])
                found[name] = find_rate(work.start, work.finish)
                if name not in OTHERS:
                    compare(work.read(), expected, dtype, f"{name} {function}")
            print(f"panda {function} {dtype}: {ours:.1f}", *(f"{name} {x:.2f}" for name, x in found.items()))
            yield Contest(function, dtype, ours, found)


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


def draw(kernel: Kernel, states: int, dtype: str) -> dict[str, Numbers]:
    """Draw states in which mechanisms are closed, or nearly, and none fails."""
    rng = np.random.default_rng(0)
    given = (a for a in kernel.inputs if a.nnz and a.cols == 1)
    return {a.name: rng.uniform(0.1, 0.6, (states, a.rows)).astype(dtype) for a in given}


def put(driver: Driver, array: Numbers) -> Array:
    """Copy an array of states to the GPU, with the states side by side."""
    states, _ = array.shape
    with driver.using(0):
        made = Array(driver, 0, array.shape, (1, states), array.dtype.name, 0)
        driver.copy_to(made.pointer, array.T.tobytes())
    return made


def write_page(machine: str, rows: Sequence[Row], contests: Sequence[Contest]) -> str:
    """Write the tables as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    lines = ["# On a GPU", "", f"`python -m benchmarks.gpu` wrote this page: {machine}.", "", about, ""]
    cells = ([row.mechanism, row.kernel, *(f"{row.rates[dtype]:.0f}" for dtype in ROUNDING)] for row in rows)
    lines += [*tabulate(["mechanism", "kernel", *ROUNDING], cells, words=2), ""]
    names = list(dict.fromkeys(name for contest in contests for name in contest.peers))
    if not names:
        return "\n".join([*lines, "No peer found the GPU."]) + "\n"
    titles = ["Panda", "precision", "ours", *(title for name in names for title in (name, f"{name}: ratio"))]
    return "\n".join([*lines, *tabulate(titles, (_compare(contest, names) for contest in contests), words=2)]) + "\n"


def _compare(contest: Contest, names: Sequence[str]) -> list[str]:
    cells = [contest.function, contest.dtype, f"{contest.ours:.0f}"]
    for name in names:
        rate = contest.peers.get(name)
        cells += ["", ""] if rate is None else [f"{rate:.3g}", f"{contest.ours / rate:.0f}"]
    return cells


def write_registers() -> str:
    """Write the registers, and the bytes that are stored for want of them, of kernels of the mechanisms as a page."""
    version = ".".join(map(str, find_nvrtc().version))
    about = "Registers of each thread, and bytes that they have no room for: no GPU is needed to know them."
    wrote = f"`python -m benchmarks.gpu --registers PAGE` wrote this page: NVRTC {version}."
    lines = ["# Registers on a GPU", "", wrote, "", about]
    columns = [(architecture, dtype) for architecture in ARCHITECTURES for dtype in ROUNDING]
    rows = []
    for name, model in MODELS.items():
        kernels = mbsrun.load(model, extent=Extent(tuple(FUNCTIONS)))
        for kernel in kernels.manifest.kernels:
            source = write_source(kernels, kernel)
            found = [source.compile(architecture, dtype)[1] for architecture, dtype in columns]
            rows.append([name, kernel.name, *(f"{x.registers}, {x.spilled}" for x in found)])
            print(*rows[-1], sep="  ")
    titles = ["mechanism", "kernel", *(f"{architecture}, {dtype}" for architecture, dtype in columns)]
    return "\n".join([*lines, "", *tabulate(titles, rows, words=2)]) + "\n"


if __name__ == "__main__":
    main()
