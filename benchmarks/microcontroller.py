"""Instructions and memory that programs need on a bare Cortex-M7: `python -m benchmarks.microcontroller`.

The solver's example, kernels of the paper's arm and controllers of shipped problems are compiled by
`arm-none-eabi-gcc -O2` and run in QEMU, which counts instructions: every run finds the same numbers. Controllers solve
their problem, then control their own model for ten periods. The columns `solve`, `prepare` and `feedback` are numbers
of instructions, of the last two the medians over the periods. Kernels and controllers compute in single precision.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.pages import tabulate
from mbsgen.manifest import Kernel
from mbsgen.output import write_folder
from mbsgen.resources import folder
from mbsrun import bare, load
from mbsrun.controllers.emulation import Emulation, emulate
from mbsrun.controllers.making import make
from mbsrun.external import Mechanism, OnDemand, load_on_demand
from mbsrun.models import find_folder
from mbsrun.ocp.statement.statement import read_problem

MODELS = Path(__file__).parents[1] / "models"
ARM = MODELS / "arm_pendulum.yaml"
KERNELS = ("impl", "semi", "exp1", "exp2", "jac_impl", "jac_exp2")
PROBLEMS = ("cart_pole_balance", "cart_pole_swing_up", "planar_arm_reach")
PRECISIONS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "single precision": (("-DMBS_STAGES_FLOAT",), bare.SINGLE),
    "double precision": ((), bare.DOUBLE),
}
Array = NDArray[np.float64]


def write_main(kernels: Sequence[Kernel], prefix: str, given: Mapping[str, Array]) -> str:
    """Write a program that calls kernels, counts their instructions, and prints their nonzero results."""
    calls: list[str] = []
    for kernel in kernels:
        inputs = [f"in_{a.name}" for a in kernel.inputs if a.nnz]
        outputs = [a for a in kernel.outputs if a.nnz]
        starts = [0, *accumulate(a.nnz for a in outputs)]
        results = [f"result + {at}" for at in starts[:-1]]
        calls += [
            "began = mbs_bare_instructions();",
            f"failed |= {kernel.function}({', '.join([*inputs, *results])});",
            f'mbs_bare_print_integer("{kernel.name}", (long)(mbs_bare_instructions() - began));',
            f'for (i = 0; i < {starts[-1]}; ++i) mbs_bare_print_float("{kernel.name}.results", result[i]);',
        ]
    numbers = [
        f"static const mbs_real in_{name}[] = {{{', '.join(f'MBS_C({x!r})' for x in map(float, values))}}};"
        for name, values in given.items()
    ]
    most = max(sum(a.nnz for a in kernel.outputs) for kernel in kernels)
    headers = [f'#include "{prefix}.h"', '#include "mbs_bare.h"']
    body = [f"static mbs_real result[{most}];", "int main(void)", "{", "unsigned long began;", "int i, failed = 0;"]
    return "\n".join([*headers, *numbers, *body, *calls, "return failed;", "}", ""])


def run_kernels(
    place: Path, kernels: Sequence[Kernel], given: Mapping[str, Array], flags: Sequence[str] = ()
) -> bare.Outcome:
    """Run kernels of the arm with given arguments, in single precision; `place` takes the program."""
    generated, main = find_folder(ARM), place / "main.c"
    main.write_text(write_main(kernels, ARM.stem, given), encoding="utf-8")
    sources = sorted({generated / file for kernel in kernels for file in kernel.sources})
    image = bare.build([main, *sources], place / "image.elf", [*flags, "-DMBS_REAL=float", f"-I{generated}"])
    return bare.run(image.path)


def count_kernels(place: Path) -> list[list[str]]:
    """Return a row for each kernel: flops, sines and cosines, instructions."""
    arm = load(find_folder(ARM))
    kernels = [arm.describe(name) for name in KERNELS]
    sizes = {a.name: a.nnz for kernel in kernels for a in kernel.inputs if a.nnz}
    outcome = run_kernels(place, kernels, {name: np.linspace(-1, 1, size) for name, size in sizes.items()})
    counts = {kernel.name: outcome.numbers(kernel.name)[0] for kernel in kernels}
    return [[f"`{x.name}`", f"{x.flops.arithmetic}", f"{x.flops.trig}", f"{counts[x.name]:.0f}"] for x in kernels]


def run_example(place: Path) -> list[list[str]]:
    """Return rows of the solver's example, with a column for each precision."""
    stages = folder("csrc") / "stages"
    sources = [*sorted(stages.glob("*.c")), stages / "example" / "pendulum.c", stages / "example" / "bare.c"]
    rows: dict[str, list[str]] = {}
    for flags, unit in PRECISIONS.values():
        image = bare.build(sources, place / "pendulum.elf", [*flags, f"-I{stages}"], unit)
        found = bare.run(image.path)
        one = {name: found.numbers(name)[0] for name in ("iterations", "effort", "instructions", "bytes")}
        cells = {
            "iterations": f"{one['iterations']:.0f}",
            "effort": f"{one['effort']:.8g}",
            "instructions of the solve": _millions(one["instructions"]),
            "workspace, bytes": f"{one['bytes']:,.0f}",
            "code and constants, bytes": f"{image.code:,}",
            "stack, bytes": f"{found.stack:,}",
        }
        for name, cell in cells.items():
            rows.setdefault(name, [name]).append(cell)
    return list(rows.values())


def run_controller(name: str, place: Path) -> list[str]:
    """Make the controller of a shipped problem, and run it: its row."""
    models: list[Path] = []

    def load_model(model: Path) -> Mechanism | OnDemand:
        models.append(model)
        return load_on_demand(model)

    problem, plant = read_problem(MODELS / f"{name}.ocp.yaml", load_model)
    made = make(problem, plant, models[-1])
    write_folder(made.files, place)
    found = emulate(place, made.manifest, made.manifest.memory.single)
    sizes = f"{made.manifest.intervals}, {len(made.manifest.states)}, {len(made.manifest.inputs)}"
    return [f"`{name}`", sizes, *_list_cells(found)]


def _list_cells(found: Emulation) -> list[str]:
    done = sum(step == "stepped" for step in found.steps)
    counts = [_millions(x) for x in (found.solve, found.prepare.usual, found.feedback.usual)]
    memory = [f"{x:,}" for x in (found.workspace, found.code, found.stack)]
    return [found.status, f"{found.iterations}", f"{done} of {len(found.steps)}", *counts, *memory]


def _millions(instructions: float) -> str:
    return f"{instructions / 1e6:.3g} M"


def write_page(problems: Sequence[str], place: Path) -> str:
    """Measure all, and return the page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    titles = "problem", "intervals, states, inputs", "status", "iterations", "steps", "`solve`", "`prepare`"
    controllers = [run_controller(name, place / name) for name in problems]
    parts = [
        "# On a microcontroller",
        "`python -m benchmarks.microcontroller` wrote this page.",
        about,
        "## The solver",
        "`csrc/stages/example/bare.c`: a pendulum swings up in 60 intervals, with 2 states and 1 input.",
        "\n".join(tabulate(["", *PRECISIONS], run_example(place))),
        "## Kernels of the paper's arm",
        "\n".join(tabulate(["kernel", "flops", "sines and cosines", "instructions"], count_kernels(place))),
        "## Controllers",
        "\n".join(tabulate([*titles, "`feedback`", "workspace, bytes", "code, bytes", "stack, bytes"], controllers)),
    ]
    return "\n\n".join(parts) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.microcontroller", description=__doc__)
    parser.add_argument("--problems", nargs="*", choices=PROBLEMS, default=PROBLEMS, help="of the controllers; all")
    parser.add_argument("--out", type=Path, default=Path("build/microcontroller.md"), help="the page")
    given = parser.parse_args(arguments)
    bare.find_tools()
    with tempfile.TemporaryDirectory() as place, Console().status("compiling and emulating"):
        page = write_page(given.problems, Path(place))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(page, encoding="utf-8")
    Console().print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
