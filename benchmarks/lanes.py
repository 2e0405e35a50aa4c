"""Kernels alone, of one state and in lanes: `python -m benchmarks.lanes`.

Times are of one core, in ns a state: the least of many passes over states whose numbers lie in lanes already, so
nothing is moved. A batch from arrays takes longer, since numbers go to lanes and results to memory (batches.md). The
least of three copies of a library counts: the same machine code can take three times as long by its place in memory.
Instructions are the ones on vectors in a kernel's machine code for several states; "at the stack" is the part of them
that reads or writes a number for which no register was free.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import mbsrun
from benchmarks.batches import FUNCTIONS, MODELS, draw
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from benchmarks.robots import ROBOTS, find_robot
from mbsgen.pipeline import Options, generate
from mbsrun import many
from mbsrun.kernel import Array, Kernels
from mbsrun.library import compile_library, find_compiler
from mbsrun.measuring.timing import Pool, load_timing

GROUPS = 8  # of states, that a pass goes through: their numbers stay in the caches near the core
COPIES = 3
SAMPLE_NS = 300_000.0  # of a round: shorter than the turns that a system gives to programs on a busy core
LINE = 64  # bytes that vectors are aligned to
_VECTOR = re.compile(r"^\s+v\w+\s.*%[xyz]mm", re.MULTILINE)  # of x86
_STACK = re.compile(r"\(%r[sb]p[,)]")


@dataclass(frozen=True)
class Found:
    """A kernel: nanoseconds a state, and its vector instructions."""

    mechanism: str
    kernel: str
    one: float
    lanes: float
    width: int
    instructions: int
    at_stack: int


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/lanes.md"), help="the page")
    parser.add_argument("--rounds", type=int, default=200, help="of which the quickest counts")
    parser.add_argument("--only", nargs="*", default=[*MODELS, *ROBOTS], help="mechanisms")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        robots = {name: path for name in ROBOTS if (path := find_robot(name, Path(folder)))}
        chosen = {name: path for name, path in (MODELS | robots).items() if name in arguments.only}
        rows = [row for name, path in chosen.items() for row in measure_model(name, path, arguments.rounds)]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(write_page(rows), encoding="utf-8")
    print(f"{arguments.out} holds the figures.")


def measure_model(name: str, model: Path, rounds: int) -> Iterator[Found]:
    """Measure each function of a mechanism, and its Jacobian; print a line for each."""
    with TemporaryDirectory() as folder:
        generate(model, Path(folder) / name, Options(functions=FUNCTIONS, derivatives=1))
        kernels = mbsrun.load(Path(folder) / name)
        for kernel in (x for function in FUNCTIONS for x in (function, f"jac_{function}")):
            found = measure(kernels, name, kernel, rounds)
            print(
                f"{name:<14}{kernel:<12}{found.one:9.1f}{found.lanes:9.1f}{found.at_stack:7d} of {found.instructions}"
            )
            yield found


def measure(kernels: Kernels, mechanism: str, name: str, rounds: int) -> Found:
    """Measure one kernel. Raises ArithmeticError where it fails in one of the states."""
    entry, (loop, several) = kernels.bind(name), kernels.choose_loop(name, 10**9)
    width = loop.width if several else 1
    inputs, sizes = draw(kernels.describe(name)), {port.argument.name: port.argument.nnz for port in entry.inputs}
    times = []
    for states in sorted({1, width}):
        given = [_lay(inputs[x][: GROUPS * states], states) if sizes[x] else np.zeros(0) for x in sizes]
        places = [port.position for port in entry.inputs]
        results = [_align(port.argument.nnz * states) for port in entry.outputs]
        steps = [sizes[x] * states for x in sizes]
        arguments = _Arguments(
            entry.n_in, entry.n_out, places, given, steps, results, [p.position for p in entry.outputs]
        )
        times.append(min(arguments.measure(x, rounds) for x in _load_copies(kernels, name, states)) / states)
    instructions, at_stack = count_vectors(kernels, name, width)
    return Found(mechanism, name, times[0], times[-1], width, instructions, at_stack)


def _load_copies(kernels: Kernels, name: str, states: int) -> Iterator[int]:
    """Yield the addresses of a kernel in copies of its library, which lie in other places of memory."""
    kernel, compiler = kernels.describe(name), many.for_states(find_compiler(os.environ), states)
    library = compile_library(kernels.folder, kernels.manifest.prefix, kernel.sources, compiler)
    with TemporaryDirectory() as folder:
        for k in range(COPIES):
            loaded = ctypes.CDLL(str(shutil.copy(library, Path(folder) / f"{k}.so")))
            yield ctypes.cast(getattr(loaded, kernel.symbol + many.end_name(states)), ctypes.c_void_p).value or 0


class _Arguments:
    """Inputs of many calls, and results of the last one, for the timing loop in C."""

    def __init__(
        self,
        n_in: int,
        n_out: int,
        places: Sequence[int],
        given: Sequence[Array],
        steps: Sequence[int],
        results: Sequence[Array],
        ends: Sequence[int],
    ) -> None:
        self._kept: list[Any] = [*given, *results]
        self._arg, self._res = (ctypes.c_void_p * n_in)(), (ctypes.c_void_p * n_out)()
        self._steps = np.zeros(n_in, dtype=np.int64)
        for place, array, step in zip(places, given, steps, strict=True):
            self._arg[place], self._steps[place] = array.ctypes.data, step
        for place, array in zip(ends, results, strict=True):
            self._res[place] = array.ctypes.data
        self.n_in = n_in

    def measure(self, address: int, rounds: int) -> float:
        """Return the least nanoseconds of a call."""
        arg, res = ctypes.addressof(self._arg), ctypes.addressof(self._res)
        pool = Pool(GROUPS, self.n_in, arg, self._steps.ctypes.data, res, None, None, address)
        time = load_timing()
        once = float(time(ctypes.addressof(pool), 1))
        passes = max(1, min(100, round(SAMPLE_NS / (abs(once) * GROUPS))))
        least = min(float(time(ctypes.addressof(pool), passes)) for _ in range(rounds))
        if least < 0:
            raise ArithmeticError("the kernel fails in one of the states")
        return least


def _align(size: int) -> Array:
    """Return an array that begins where a line of memory does."""
    whole = np.zeros(size + LINE // 8)
    first = -whole.ctypes.data % LINE // 8
    return whole[first : first + size]


def _lay(rows: Array, states: int) -> Array:
    """Lay states (GROUPS * states, numbers) side by side: each number of a group's states after the other."""
    laid = _align(rows.size)
    laid[:] = rows.reshape(GROUPS, states, -1).transpose(0, 2, 1).ravel()
    return laid


def count_vectors(kernels: Kernels, name: str, width: int) -> tuple[int, int]:
    """Count the vector instructions of a kernel for several states, and the ones that read or write the stack."""
    compiler = many.for_states(find_compiler(os.environ), width)
    sources = [str(kernels.folder / source) for source in kernels.describe(name).sources]
    command = [*compiler.command, "-O3", *compiler.flags, "-w", "-S", "-o", "-", *sources]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    vectors = _VECTOR.findall(text)
    return len(vectors), sum(bool(_STACK.search(line)) for line in vectors)


def write_page(rows: Sequence[Found]) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    machine = f"{describe_machine()}; {os.getloadavg()[0]:.1f} processes wanted its {os.cpu_count()} cores at the end"
    lines = ["# Lanes", "", f"`python -m benchmarks.lanes` wrote this page: {machine}.", "", about, ""]
    titles = ["mechanism", "kernel", "one by one", "lanes", "gain", "lanes' width", "instructions", "at the stack"]
    cells = (
        [
            *(x.mechanism, x.kernel, f"{x.one:.1f}", f"{x.lanes:.1f}", f"{x.one / x.lanes:.1f}", str(x.width)),
            *(str(x.instructions), f"{100 * x.at_stack / max(1, x.instructions):.0f} %"),
        ]
        for x in rows
    )
    return "\n".join([*lines, *tabulate(titles, cells, words=2)]) + "\n"


if __name__ == "__main__":
    main()
