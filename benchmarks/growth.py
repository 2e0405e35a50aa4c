"""Measure the price of size: robots with floating bases, and chains of many joints; `python -m benchmarks.growth`.

For each mechanism: the times of generation and compilation, the size of the C, and the time of a call beside the
quickest peer: short recursions in CasADi, Pinocchio in C++, or Pinocchio's algorithms written as C by CasADi.
Residuals and accelerations, and the first derivatives of IMPL and EXP2.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.candidates import CASADI, LARGE, LARGEST, OURS, PINOCCHIO, SHORT, Candidate
from benchmarks.compilation import BuildError, Workshop, describe_flags, describe_machine, find_cache, find_includes
from benchmarks.preparation import Prepared, Wanted, describe_kernel, hash_file, prepare_peers
from benchmarks.robots import ROBOTS, find_robot
from benchmarks.study import DisagreementError, Study, measure
from benchmarks.table import Basis, Quickest, find_quickest
from mbsgen.errors import MbsError
from mbsgen.pipeline import Options, generate
from mbsrun import load
from mbsrun.forms import VALUES
from mbsrun.measuring.mechanisms import write_chain
from mbsrun.measuring.store import Store
from mbsrun.models import fingerprint_generator

JACOBIANS = ("jac_impl", "jac_exp2")
SIZES = (8, 16, 32, 64, 100)
BASES: tuple[Basis, ...] = ("same header", "as they come")
MARKS = {PINOCCHIO: "P", CASADI: "C", SHORT: "S"}
SAME = dict.fromkeys(("exp1", "exp2"), ("exp1", "exp2")) | {"jac_exp2": ("jac_exp1", "jac_exp2")}
CALLS = ("flops", "ns", "ns/flop", "quickest peer, same header", "ratio", "quickest peer, as it comes", "ratio")
MAKING = ("generated s", "C kB", "compiled s", "MB")
LINEAR = ("impl", "exp2")  # linear in the length of a chain, and measured on the longest
LARGEST_CUBIC = 50  # joints up to which all values are measured
LARGEST_EXPANDED = 20  # joints up to which CasADi writes out M^-1 d Phi: beyond, it takes minutes and megabytes


@dataclass(frozen=True)
class Mechanism:
    """The functions to measure for a model file."""

    path: Path
    joints: int | None  # of a chain
    values: tuple[str, ...]
    jacobians: tuple[str, ...]

    @property
    def name(self) -> str:
        """Return the model's name."""
        return self.path.stem

    @property
    def wanted(self) -> Wanted:
        """Return the functions of the peers."""
        return Wanted(
            self.values, self.jacobians, self.joints is None or self.joints <= LARGEST_CUBIC, LARGEST_EXPANDED
        )


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
    compiled_mb: float  # the most that the compiler held, for any kernel of the mechanism up to this one
    ns: float
    ns_median: float
    quickest: Mapping[Basis, Quickest]  # nothing without a peer


@dataclass(frozen=True)
class Made:
    """The kernels of a mechanism, compiled."""

    candidates: tuple[Candidate, ...]
    costs: Mapping[str, tuple[float, int, float, float]]  # of each kernel, as a Row has them


def describe_robot(path: Path) -> Mechanism:
    """Describe a robot: everything is measured."""
    return Mechanism(path, None, VALUES, JACOBIANS)


def describe_chain(size: int, folder: Path) -> Mechanism:
    """Describe a chain: less is measured of a longer one."""
    values = VALUES if size <= LARGEST_CUBIC else LINEAR
    return Mechanism(write_chain(size, folder), size, values, JACOBIANS)


def make_kernels(mechanism: Mechanism, cache: Path) -> Made:
    """Generate and compile the kernels of a model file anew, in a separate process.

    So the compiler's memory is known for each mechanism. Raises InputError, CompileError.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_make, mechanism, cache).result()


def _make(mechanism: Mechanism, cache: Path) -> Made:
    os.environ["XDG_CACHE_HOME"] = str(cache)  # an empty cache
    names = (*mechanism.values, *mechanism.jacobians)
    start = time.process_time()
    options = Options(functions=mechanism.values, derivatives=int(bool(mechanism.jacobians)))
    product = generate(mechanism.path, cache / mechanism.name, options)
    generated = time.process_time() - start
    kernels = load(cache / mechanism.name)
    candidates, costs = [], {}
    for name in names:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        library = kernels.compile(name)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        source = product.files[f"{product.manifest.prefix}_{name}.c"]
        costs[name] = (generated, len(source), after.ru_utime - before.ru_utime, after.ru_maxrss / 1024)
        candidates.append(describe_kernel(product.manifest, library, name))
    return Made(tuple(candidates), costs)


def time_kernels(made: Made, peers: Prepared, rounds: int) -> Iterator[Row]:
    """Time kernels beside their peers. Raises BuildError, DisagreementError, ArithmeticError."""
    both = replace(peers, candidates=(*made.candidates, *peers.candidates))
    study = measure(both, rounds)
    for name, costs in made.costs.items():
        yield _make_row(study, peers.sizes.joints, name, costs)


def _make_row(study: Study, joints: int, kernel: str, costs: tuple[float, int, float, float]) -> Row:
    (ours,) = (m for m in study.measurements if (m.candidate.author, m.candidate.function) == (OURS, kernel))
    computed = SAME.get(kernel, (kernel,))
    peers = [m for m in study.measurements if m.candidate.author != OURS and m.candidate.function in computed]
    quickest = {basis: found for basis in BASES if (found := find_quickest(basis, [ours], peers))}
    assert ours.candidate.flops is not None, "kernels are counted"
    assert ours.times is not None, "kernels are timed"
    times = float(ours.times.min()), float(np.median(ours.times))
    return Row(study.model, joints, kernel, ours.candidate.flops, *costs, *times, quickest)


def make_tables(rows: Sequence[Row]) -> tuple[Table, Table]:
    """Return the rows as tables for a terminal: costs of calls, and costs of making the kernels."""
    return (
        _lay_out("nanoseconds per call", CALLS, rows, _write_calls),
        _lay_out("to make them", MAKING, rows, _write_making),
    )


def _lay_out(title: str, columns: Sequence[str], rows: Sequence[Row], write: Callable[[Row], tuple[str, ...]]) -> Table:
    table = Table(title=title, title_justify="left")
    for column in ("", "joints", "kernel", *columns):
        table.add_column(column, no_wrap=True, justify="right" if column in columns else "left")
    for row in rows:
        table.add_row(row.mechanism, str(row.joints), row.kernel, *write(row))
    return table


def _write_calls(row: Row) -> tuple[str, ...]:
    found = [row.quickest.get(basis) for basis in BASES]
    peers = (
        text
        for peer in found
        for text in (
            ("–", "–")
            if peer is None
            else (f"{peer.ns:.0f} {MARKS[peer.author]}", f"{peer.ratio:#.3g} · {peer.ratio_median:#.3g}")
        )
    )
    return (f"{row.flops}", f"{row.ns:.0f} · {row.ns_median:.0f}", f"{row.ns / row.flops:.2f}", *peers)


def _write_making(row: Row) -> tuple[str, ...]:
    figures = (row.generated_s, row.source_bytes / 1e3, row.compiled_s, row.compiled_mb)
    return tuple(f"{x:.{digits}f}" for x, digits in zip(figures, (1, 0, 1, 0), strict=True))


def write_markdown(rows: Sequence[Row], machine: str, rounds: int) -> str:
    """Write the rows as a page."""
    lines = [
        "# The price of size",
        "",
        f"{machine}; C with `{describe_flags()}`.",
        "",
        f"Times of a call are the shortest of {rounds} rounds, then the median. *generated* is the processor time for",
        "all kernels of a mechanism together, *compiled* the time for each. *MB* is the largest memory of the compiler",
        "for this kernel and those above it, of the same mechanism. Flops are of kernels with all numbers of the model",
        "in them and masses lumped.",
        "",
        "The ratio says how many times faster our kernel is than the quickest peer: S, short recursions as C of",
        "CasADi; P, Pinocchio in C++; C, Pinocchio's algorithms as C that CasADi writes. In the columns *same header*,",
        "peers use our sine and cosine, or the C library's where these are quicker. In the columns *as it comes*, they",
        "use the C library's.",
        "",
        f"CasADi's C with more than {LARGE:,} operations is compiled by -O1, with more than {LARGEST:,} not at all.",
        f"CasADi writes derivatives of accelerations, -M^-1 d Phi, for up to {LARGEST_EXPANDED} joints.",
        "Derivatives of our own equations by CasADi are not among these peers.",
        "",
        f"| | joints | kernel | {' | '.join((*CALLS, *MAKING))} |",
        "|---|---:|---|" + "---:|" * len((*CALLS, *MAKING)),
        *(
            f"| {row.mechanism} | {row.joints} | {row.kernel} "
            f"| {' | '.join((*_write_calls(row), *_write_making(row)))} |"
            for row in rows
        ),
    ]
    return "\n".join(lines) + "\n"


def _write(rows: Sequence[Row], machine: str, rounds: int, out: Path) -> None:
    content = {"machine": machine, "rounds": rounds, "rows": [asdict(row) for row in rows]}
    (out / "growth.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (out / "growth.md").write_text(write_markdown(rows, machine, rounds), encoding="utf-8")


@click.command()
@click.option("-o", "--out", default=Path("build/bench"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--rounds", default=50, show_default=True, type=click.IntRange(min=1))
@click.option("--robot", "robots", multiple=True, type=click.Choice(list(ROBOTS)), help="By default all.")
@click.option("--size", "sizes", multiple=True, type=click.IntRange(1, 256), help="Of chains; by default 8 to 100.")
@click.option("--prepare", "only", is_flag=True, help="Write and compile the peers, and measure nothing.")
@click.option("--again", is_flag=True, help="Measure mechanisms of earlier runs again.")
def main(out: Path, rounds: int, robots: tuple[str, ...], sizes: tuple[int, ...], only: bool, again: bool) -> None:
    """Measure the generation, compilation and calls of robots with floating bases and of long chains."""
    console = Console(width=None if sys.stdout.isatty() else 160)
    out.mkdir(parents=True, exist_ok=True)
    workshop = Workshop(find_cache(), find_includes())
    try:
        prepared = []
        for mechanism in _list_mechanisms(out, robots, sizes, console):
            with console.status(f"{mechanism.name}: writing and compiling peers"):
                prepared.append((mechanism, prepare_peers(mechanism.path, workshop, lambda _: None, mechanism.wanted)))
        if only:
            console.print(f"{workshop.folder} holds what was prepared.")
            return
        rows = _measure(prepared, rounds, out, console, again=again)
    except (MbsError, BuildError, DisagreementError, ArithmeticError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    for table in make_tables(rows):
        console.print(table)
    console.print(f"{out / 'growth.json'} holds the figures, growth.md the table.")


def _list_mechanisms(out: Path, robots: Sequence[str], sizes: Sequence[int], console: Console) -> Iterator[Mechanism]:
    """List the requested mechanisms, or all."""
    everything = not robots and not sizes
    for name in ROBOTS if everything else robots:
        path = find_robot(name, out)
        if path is None:
            console.print(f"Without {name}: pip install '.[bench]' brings its file.", markup=False)
        else:
            yield describe_robot(path)
    for size in SIZES if everything else sizes:
        yield describe_chain(size, out)


def _measure(
    prepared: Sequence[tuple[Mechanism, Prepared]], rounds: int, out: Path, console: Console, *, again: bool
) -> list[Row]:
    """Measure the mechanisms that the store lacks, and write all rows after each mechanism."""
    machine, generator = describe_machine(), fingerprint_generator().hex()
    store = Store(out / "growth.jsonl", Row, is_renewed=again)
    rows: list[Row] = []
    for mechanism, peers in prepared:
        facts = (machine, rounds, generator, hash_file(mechanism.path), peers.digest)
        rows += store.find_or_measure(facts, partial(_measure_one, mechanism, peers, rounds, console))
        _write(rows, machine, rounds, out)
    return rows


def _measure_one(mechanism: Mechanism, peers: Prepared, rounds: int, console: Console) -> list[Row]:
    with tempfile.TemporaryDirectory() as cache:
        with console.status(f"{mechanism.name}: generating and compiling"):
            made = make_kernels(mechanism, Path(cache))
        with console.status(f"{mechanism.name}: timing"):
            return list(time_kernels(made, peers, rounds))


if __name__ == "__main__":
    main()
