"""`python -m benchmarks`: measure, print tables of figures and ratios, and write them as JSON and as a chart."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
from rich.console import Console

from benchmarks.compilation import BuildError, Workshop, describe_flags, describe_machine, find_cache, find_includes
from benchmarks.preparation import Prepared, prepare
from benchmarks.study import DisagreementError, measure
from benchmarks.table import Row, Run, compare, draw_chart, make_tables, write_json, write_markdown
from mbsgen.errors import MbsError
from mbsrun.measuring.store import Store

ROOT = Path(__file__).parents[1]
MODELS = (
    ROOT / "models" / "arm_pendulum.yaml",
    ROOT / "benchmarks" / "models" / "ur5.yaml",
    ROOT / "benchmarks" / "models" / "panda.yaml",
)
QUICK = (ROOT / "models" / "double_pendulum.yaml",)


@click.command()
@click.argument("models", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("-o", "--out", default=Path("build/bench"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--rounds", default=200, show_default=True, type=click.IntRange(min=1))
@click.option("--hessians/--no-hessians", default=True, help="Compare second derivatives too.")
@click.option("--quick", is_flag=True, help="A small mechanism, few rounds, and nothing that needs a C++ compiler.")
@click.option("--prepare", "only", is_flag=True, help="Generate and compile everything, and measure nothing.")
@click.option("--again", is_flag=True, help="Measure mechanisms of earlier runs again.")
def main(
    models: tuple[Path, ...], out: Path, rounds: int, hessians: bool, quick: bool, only: bool, again: bool
) -> None:
    """Compare generated kernels of MODELS, or of the paper's arm, a UR5 and a Panda, with other programs.

    A later run finds the candidates of --prepare, and then takes a minute.
    """
    console = Console(width=None if sys.stdout.isatty() else 160)
    if quick:
        models, rounds = models or QUICK, min(rounds, 10)
    includes = None if quick else find_includes()
    if includes is None:
        told = "Without Pinocchio." if quick else "Without Pinocchio: pip install '.[bench]' brings its headers."
        console.print(told, markup=False)
    workshop = Workshop(find_cache(), includes)
    out.mkdir(parents=True, exist_ok=True)
    try:
        prepared = []
        for model in models or MODELS:
            with console.status(model.stem) as status:
                report = _follow(status.update, model.stem)
                prepared.append(prepare(model, workshop, report, hessians=hessians))
        if only:
            console.print(f"{workshop.folder} holds what was prepared.")
            return
        store = Store(out / "benchmarks.jsonl", Row, is_renewed=again)
        for run in _measure(prepared, rounds, store, console):
            (out / "benchmarks.json").write_text(write_json(run), encoding="utf-8")
    except (MbsError, BuildError, DisagreementError, ArithmeticError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    (out / "benchmarks.md").write_text(write_markdown(run), encoding="utf-8")
    draw_chart(run.comparisons, out / "benchmarks.png")
    console.print(
        f"{out / 'benchmarks.json'} holds the figures, and benchmarks.md beside it; benchmarks.png charts the ratios."
    )


def _measure(prepared: Iterable[Prepared], rounds: int, store: Store[Row], console: Console) -> Iterator[Run]:
    """Measure the mechanisms that the store lacks, and print all rows; yield the run after each mechanism."""
    run = Run(describe_machine(), describe_flags(), rounds, {})
    for one in prepared:
        with console.status(one.model) as status:
            work = partial(_compare, one, rounds, _follow(status.update, one.model))
            rows = store.find_or_measure((run.machine, run.flags, rounds, one.digest), work)
        for table in make_tables(one.model, rows):
            console.print(table)
        run = replace(run, comparisons={**run.comparisons, one.model: rows})
        yield run


def _compare(prepared: Prepared, rounds: int, report: Callable[[str], None]) -> Sequence[Row]:
    return compare(measure(prepared, rounds, report))


def _follow(update: Callable[[str], None], name: str) -> Callable[[str], None]:
    return lambda text: update(f"{name}: {text}")


if __name__ == "__main__":
    main()
