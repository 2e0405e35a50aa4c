"""`mbsrun cuda`: a model -> machine code for a GPU, with the registers that each kernel takes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click

from mbsgen.help import ModelCommand
from mbsrun.commands.console import print_table, say
from mbsrun.commands.robots import accept_robots
from mbsrun.cuda.images import DOUBLE_ALONE, write_source
from mbsrun.cuda.nvrtc import Resources
from mbsrun.external import load
from mbsrun.library import count_cores
from mbsrun.models import Extent

CUDA_HELP = """Compile the kernels of MODEL for a GPU, which this machine need not have; print their registers.

\b
  mbsrun cuda models/arm_pendulum.yaml --functions impl,exp1 --derivatives 1

The table shows, for each thread, registers (255 at most), the stack, and the bytes that do not fit into registers.
With -o, a file NAME.sm_90.float64.cubin holds the machine code of each kernel, for programs that load it by CUDA's
driver.

\b
Exit codes
  0   compiled
  2   the model or an argument cannot be accepted, or there is no compiler; nothing written
"""


@click.command("cuda", cls=ModelCommand, help=CUDA_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--arch", default="sm_90", show_default=True, help="The architecture: 9.0 of an H100 is sm_90.")
@click.option("--float32", is_flag=True, help="In single precision.")
@click.option("--functions", metavar="NAME,...", help="Only these functions; by default all.")
@click.option(
    "--derivatives", type=click.IntRange(0, 2), default=2, show_default=True, help="The highest order of derivatives."
)
@click.option(
    "-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="The folder for machine code."
)
@accept_robots
def cuda_command(
    model: Path, arch: str, float32: bool, functions: str | None, derivatives: int, out: Path | None
) -> None:
    """Generate, compile, print, write."""
    if not re.fullmatch(r"sm_\d+[af]?", arch):
        raise click.BadParameter(f"{arch!r} is no architecture; give one such as sm_80 or sm_90", param_hint="--arch")
    names = None if functions is None else tuple(filter(None, map(str.strip, functions.split(","))))
    kernels = load(model, extent=Extent(names, derivatives))
    dtype = "float32" if float32 else "float64"
    sources = {kernel.name: write_source(kernels, kernel) for kernel in kernels.manifest.kernels}
    if float32:
        sources = {name: source for name, source in sources.items() if DOUBLE_ALONE not in source.files}
    with ThreadPoolExecutor(count_cores()) as pool:
        found = dict(zip(sources, pool.map(lambda source: source.compile(arch, dtype), sources.values()), strict=True))
    _print({name: resources for name, (_, resources) in found.items()})
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for name, (code, _) in found.items():
            (out / f"{name}.{arch}.{dtype}.cubin").write_bytes(code)
        say(f"wrote {len(found)} files to {out}")


def _print(rows: Mapping[str, Resources]) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE)
    table.add_column("kernel")
    for column in ("registers", "stack [B]", "spilled [B]"):
        table.add_column(column, justify="right")
    for name, x in rows.items():
        table.add_row(name, str(x.registers), str(x.stack), str(x.spilled))
    print_table(table)
