"""The price of bounds: `python -m benchmarks.bounds`; the time of functions with bounds by their time without."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from mbsgen.pipeline import Options, generate
from mbsgen.roles import Order, Role
from mbsgen.tape.rounding import PREFIX, UNIT
from mbsrun.kernel import Kernels
from mbsrun.measuring.functions import Code, find_function
from mbsrun.measuring.points import Cost
from mbsrun.measuring.timing import Watch, measure_costs

MODELS = Path(__file__).parents[1] / "models"
STATES = 256
DOUBLE = 2.0**-53


@click.command()
@click.argument("models", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--rounds", default=100, show_default=True, type=click.IntRange(min=1))
def main(models: tuple[Path, ...], rounds: int) -> None:
    """Time the formulations of MODELS and their derivatives, or of the paper's arm and the robot with six joints."""
    table = Table("model", "function", "flops", "with bounds", "ns", "with bounds", "ratio")
    for model in models or (MODELS / "arm_pendulum.yaml", MODELS / "six_axis.yaml"):
        for name, flops, costs in compare(model, rounds):
            ratio = costs[1].shortest / costs[0].shortest
            times = (f"{cost.shortest:.0f}" for cost in costs)
            table.add_row(model.stem, name, *map(str, flops), *times, f"{ratio:.2f}")
    Console().print(table)


def compare(model: Path, rounds: int) -> Iterator[tuple[str, tuple[int, int], list[Cost]]]:
    """Yield a function's name, and flops and times without and with bounds."""
    options = Options(functions=("impl", "semi", "exp1", "exp2"), derivatives=1, targets=("bounds",))
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of functions without bounds
        folder = Path(place) / "c"
        generate(model, folder, options)
        kernels = Kernels(folder)
        known = {kernel.name: kernel for kernel in kernels.manifest.kernels}
        for name, kernel in known.items():
            if PREFIX + name not in known or kernel.order is Order.LINEARISATION:
                continue
            pair = (kernel, known[PREFIX + name])
            library = kernels.compile(*(k.name for k in pair))
            rng = np.random.default_rng(0)
            states = {i.name: rng.uniform(-2, 2, (STATES, i.nnz)) for i in kernel.inputs if i.role is not Role.SETUP}
            states[UNIT.name] = np.full((STATES, 1), DOUBLE)
            codes = [Code(find_function(library, k.symbol)) for k in pair]
            watches = [Watch(code, code.lay(states)) for code in codes]
            yield name, (pair[0].flops.paper, pair[1].flops.paper), measure_costs(watches, rounds)


if __name__ == "__main__":
    main()
