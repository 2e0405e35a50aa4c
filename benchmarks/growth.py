"""What size costs: robots with floating bases, and chains of many joints; `python -m benchmarks.growth`.

For each mechanism: how long generating and compiling take, how large the C is, and the time of a call beside
Pinocchio's in C++ and, for robots, beside Pinocchio's algorithms written as C by CasADi. Residuals and accelerations,
and the first derivatives of IMPL and EXP2.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from benchmarks.candidates import CASADI, OURS, PINOCCHIO, Candidate
from benchmarks.compilation import BuildError, Workshop, describe_machine, find_includes, of_model
from benchmarks.mechanism import write_mechanism
from benchmarks.robots import ROBOTS, find_robot
from benchmarks.study import (
    DisagreementError,
    Measurement,
    describe_kernel,
    describe_pinocchio,
    measure,
    trace_values,
)
from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest
from mbsgen.pipeline import Options, generate, read_tree
from mbsrun import load
from mbsrun.study.mechanisms import write_chain

VALUES = ("impl", "semi", "exp1", "exp2")
JACOBIANS = ("jac_impl", "jac_exp2")
SIZES = (8, 16, 32, 64, 128)
MARKS = {PINOCCHIO: "", CASADI: "*"}
LINEAR = ("impl", "exp2")  # what grows by the length of a chain, and is measured on the longest
LARGEST_CUBIC, LARGEST_JACOBIAN = 50, 32  # chains of which all values, and Jacobians, are measured


@dataclass(frozen=True)
class Row:
    """One kernel of one mechanism."""

    mechanism: str
    joints: int
    kernel: str
    flops: int
    generated_s: float  # processor time of all of the mechanism's kernels together
    source_bytes: int
    compiled_s: float  # processor time
    compiled_mb: float  # the most that the compiler held, for any kernel up to this one
    ns: float
    peer: str | None  # the quickest one
    peer_ns: float | None

    @property
    def ratio(self) -> float | None:
        """Give how many times ours the quickest peer takes."""
        return None if self.peer_ns is None else self.peer_ns / self.ns


@dataclass(frozen=True)
class Made:
    """The kernels of a mechanism, compiled."""

    name: str
    joints: int
    mechanism: Path  # as the peers read it
    manifest: Manifest
    candidates: tuple[Candidate, ...]
    costs: Mapping[str, tuple[float, int, float, float]]  # of each kernel, as a Row has them
    traced: bool  # whether CasADi writes the peers' values, too


def make_kernels(path: Path, workshop: Workshop, *, traced: bool) -> Made:
    """Generate and compile the kernels of a model file. Raises InputError, BuildError, ValueError."""
    tree = read_tree(path)
    own = of_model(workshop, tree.name)
    own.folder.mkdir(parents=True, exist_ok=True)
    mechanism = own.folder / "mechanism.txt"
    mechanism.write_text(write_mechanism(tree), encoding="utf-8")
    values = VALUES if traced or len(tree.bodies) <= LARGEST_CUBIC else LINEAR
    jacobians = JACOBIANS if traced or len(tree.bodies) <= LARGEST_JACOBIAN else ()

    start = time.process_time()
    product = generate(path, own.folder / "generated", Options(functions=values, derivatives=int(bool(jacobians))))
    generated = time.process_time() - start
    kernels = load(own.folder / "generated")
    candidates, costs = [], {}
    for name in (*values, *jacobians):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        library = kernels.compile(name)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        source = product.files[f"{product.manifest.prefix}_{name}.c"]
        costs[name] = (generated, len(source), after.ru_utime - before.ru_utime, after.ru_maxrss / 1024)
        candidates.append(describe_kernel(product.manifest, library, name))
    return Made(tree.name, len(tree.bodies), mechanism, product.manifest, tuple(candidates), costs, traced)


def time_kernels(made: Made, workshop: Workshop, rounds: int) -> Iterator[Row]:
    """Time kernels beside their peers. Raises BuildError, DisagreementError, ArithmeticError."""
    candidates = list(made.candidates)
    if workshop.includes is not None:
        candidates += describe_pinocchio(made.manifest, workshop.compile_pinocchio(), made.mechanism)
        candidates += trace_values(workshop, made.mechanism) if made.traced else []
    measured = measure(candidates, made.manifest, workshop, rounds)
    for name, costs in made.costs.items():
        yield _make_row(made.name, made.joints, name, measured, costs)


def _make_row(
    mechanism: str, joints: int, kernel: str, measured: Sequence[Measurement], costs: tuple[float, int, float, float]
) -> Row:
    times = [
        (float(m.times.min()), m.candidate) for m in measured if m.candidate.function == kernel and m.times is not None
    ]
    ((own, ours),) = (found for found in times if found[1].author == OURS)
    peers = ((ns, candidate.author) for ns, candidate in times if candidate.author != OURS)
    peer_ns, peer = min(peers, default=(None, None))
    assert ours.flops is not None, "kernels are counted"
    return Row(mechanism, joints, kernel, ours.flops, *costs, own, peer, peer_ns)


def make_tables(rows: Sequence[Row]) -> tuple[Table, Table]:
    """Lay the rows out for a terminal: what calls take, and what it takes to make the kernels."""
    return (
        _lay_out("nanoseconds per call", ["flops", "ns", "ns/flop", "peer ns", "ratio"], rows, _tell_calls),
        _lay_out("to make them", ["generated s", "C kB", "compiled s", "MB"], rows, _tell_making),
    )


def _lay_out(title: str, columns: Sequence[str], rows: Sequence[Row], tell: Callable[[Row], tuple[str, ...]]) -> Table:
    table = Table(title=title, title_justify="left")
    for column in ("", "joints", "kernel", *columns):
        table.add_column(column, no_wrap=True, justify="right" if column in columns else "left")
    for row in rows:
        table.add_row(row.mechanism, str(row.joints), row.kernel, *tell(row))
    return table


def _tell_calls(row: Row) -> tuple[str, ...]:
    peer = (
        ("–", "–")
        if row.ratio is None or row.peer is None
        else (f"{row.peer_ns:.0f}{MARKS[row.peer]}", f"{row.ratio:#.3g}")
    )
    return (f"{row.flops}", f"{row.ns:.0f}", f"{row.ns / row.flops:.2f}", *peer)


def _tell_making(row: Row) -> tuple[str, ...]:
    figures = (row.generated_s, row.source_bytes / 1e3, row.compiled_s, row.compiled_mb)
    return tuple(f"{x:.{digits}f}" for x, digits in zip(figures, (1, 0, 1, 0), strict=True))


def write_markdown(rows: Sequence[Row], machine: str, rounds: int) -> str:
    """Write the rows as a page."""
    lines = [
        "# What size costs",
        "",
        f"{machine}; the shortest of {rounds} rounds. Generating is told for all kernels of a mechanism together, in",
        "processor time, as compiling is, for each; MB are the most that the compiler held for any kernel so far. The",
        "ratio is how many times ours the quickest peer takes: Pinocchio in C++, or, for robots, with a star, its",
        "algorithms as C that CasADi writes.",
        "",
        "| | joints | kernel | flops | ns | ns/flop | peer ns | ratio | generated s | C kB | compiled s | MB |",
        "|---|---:|---|" + "---:|" * 9,
        *(
            f"| {row.mechanism} | {row.joints} | {row.kernel} | {' | '.join((*_tell_calls(row), *_tell_making(row)))} |"
            for row in rows
        ),
    ]
    return "\n".join(lines) + "\n"


@click.command()
@click.option("-o", "--out", default=Path("build/bench"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--rounds", default=50, show_default=True, type=click.IntRange(min=1))
@click.option("--robot", "robots", multiple=True, type=click.Choice(list(ROBOTS)), help="By default all.")
@click.option("--size", "sizes", multiple=True, type=click.IntRange(1, 256), help="Of chains; by default 8 to 128.")
def main(out: Path, rounds: int, robots: tuple[str, ...], sizes: tuple[int, ...]) -> None:
    """Tell what robots with floating bases and long chains cost to generate, to compile and to call."""
    console = Console()
    out.mkdir(parents=True, exist_ok=True)
    workshop = Workshop(out.absolute(), find_includes())
    everything = not robots and not sizes
    rows: list[Row] = []
    os.environ["XDG_CACHE_HOME"] = str(out.absolute() / f"growth.{os.getpid()}")  # so that all is compiled anew
    try:
        made = []  # all, before any peer is compiled: the most memory that a compiler held is known of all together
        for name in ROBOTS if everything else robots:
            path = find_robot(name, out)
            if path is None:
                console.print(f"Without {name}: pip install '.[bench]' brings its file.", markup=False)
                continue
            with console.status(f"{name}: generating and compiling"):
                made.append(make_kernels(path, workshop, traced=True))
        for size in SIZES if everything else sizes:
            with console.status(f"a chain of {size}: generating and compiling"):
                made.append(make_kernels(write_chain(size, out), workshop, traced=False))
        for kernels in made:
            with console.status(f"{kernels.name}: timing"):
                rows += time_kernels(kernels, workshop, rounds)
    except (MbsError, BuildError, DisagreementError, ArithmeticError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    finally:
        shutil.rmtree(os.environ["XDG_CACHE_HOME"], ignore_errors=True)
    for table in make_tables(rows):
        console.print(table)
    machine = describe_machine()
    content = {"machine": machine, "rounds": rounds, "rows": [asdict(row) for row in rows]}
    (out / "growth.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    (out / "growth.md").write_text(write_markdown(rows, machine, rounds), encoding="utf-8")
    console.print(f"{out / 'growth.json'} holds the figures, growth.md the table.")


if __name__ == "__main__":
    main()
