"""Measure: `python -m benchmarks.loops`; tables to the terminal, figures to build/bench-loops."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import click
from rich.console import Console

from benchmarks.compilation import BuildError, describe_flags, describe_machine
from benchmarks.loops.kernels import Row, hash_sources, measure_model
from benchmarks.loops.models import find_model
from benchmarks.loops.motions import Diagram, measure_motion
from benchmarks.loops.ours import list_ours
from benchmarks.loops.peers import compile_all
from benchmarks.loops.problems import PROBLEMS
from benchmarks.loops.table import Results, make_tables, write_json, write_markdown
from benchmarks.preparation import hash_file
from mbsgen.errors import MbsError
from mbsrun.measuring.store import Store
from mbsrun.models import fingerprint_generator

MODELS = Path(__file__).parents[2] / "models"
KERNELS = (
    *(MODELS / f"{x}.yaml" for x in ("four_bar", "slider_crank", "five_bar", "delta", "knee_leg")),
    *(MODELS / f"{x}.yaml" for x in ("excavator", "wishbone", "stewart")),
    *(find_model(x) for x in ("four_bars", "andrews", "bricard")),
)


@click.command()
@click.option("-o", "--out", default=Path("build/bench-loops"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--rounds", default=20, show_default=True, type=click.IntRange(min=1), help="Of kernels.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(min=1), help="Of motions.")
@click.option("--model", "models", multiple=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--motion", "motions", multiple=True, type=click.Choice(list(PROBLEMS)))
@click.option("--prepare", "only", is_flag=True, help="Compile the other programs, and measure nothing.")
@click.option("--again", is_flag=True, help="Measure what earlier runs measured again.")
def main(
    out: Path, rounds: int, repeats: int, models: tuple[Path, ...], motions: tuple[str, ...], only: bool, again: bool
) -> None:
    """Compare kernels and motions of mechanisms with loops with other programs; by default all."""
    console = Console(width=None if sys.stdout.isatty() else 200)
    out.mkdir(parents=True, exist_ok=True)
    try:
        with console.status("compiling the other programs"):
            missing = compile_all()
        for name in missing:
            console.print(f"Without {name}: its headers are missing.", markup=False)
        if only:
            return
        everything = not models and not motions
        results = Results(describe_machine(), describe_flags(), rounds, repeats, (), ())
        kernels = Store(out / "kernels.jsonl", Row, is_renewed=again)
        diagrams = Store(out / "motions.jsonl", Diagram, is_renewed=again)
        facts = (results.machine, fingerprint_generator().hex(), hash_sources())
        for model in KERNELS if everything else models:
            with console.status(model.stem) as status:
                work = partial(measure_model, model, rounds, _follow(status.update, model.stem))
                rows = kernels.find_or_measure((*facts, rounds, hash_file(model)), work)
            results = results.add_rows(rows)
            _write(results, out)
        for name in PROBLEMS if everything else motions:
            with console.status(name) as status:
                measured = partial(_measure, name, repeats, _follow(status.update, name))
                found = diagrams.find_or_measure((*facts, repeats, hash_file(find_model(name))), measured)
            results = results.add_diagrams(found)
            _write(results, out)
    except (MbsError, BuildError, ArithmeticError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    for table in make_tables(results):
        console.print(table)
    console.print(f"{out / 'loops.json'} holds the figures, loops.md the tables.")


def _measure(name: str, repeats: int, report: Callable[[str], None]) -> Sequence[Diagram]:
    problem = PROBLEMS[name]()
    return [measure_motion(problem, list(list_ours(problem)), repeats, report)]


def _write(results: Results, out: Path) -> None:
    (out / "loops.json").write_text(write_json(results), encoding="utf-8")
    (out / "loops.md").write_text(write_markdown(results), encoding="utf-8")


def _follow(update: Callable[[str], None], name: str) -> Callable[[str], None]:
    return lambda text: update(f"{name}: {text}")


if __name__ == "__main__":
    main()
