"""Work and precision of the community's motions: `python -m benchmarks.community`; a page to build/community."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import click
from rich.console import Console

from benchmarks.community.ours import list_community
from benchmarks.community.page import write_page
from benchmarks.community.problems import PROBLEMS
from benchmarks.compilation import BuildError, describe_machine
from benchmarks.loops.kernels import hash_sources
from benchmarks.loops.motions import Diagram, Way, list_peers, measure_problem
from benchmarks.loops.problems import Problem
from benchmarks.preparation import hash_file
from mbsgen.errors import MbsError
from mbsrun.measuring.store import Store
from mbsrun.models import fingerprint_generator


@click.command()
@click.option("-o", "--out", default=Path("build/community"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(min=1), help="Of each motion.")
@click.option("--motion", "motions", multiple=True, type=click.Choice(list(PROBLEMS)), help="By default all.")
@click.option("--again", is_flag=True, help="Measure what earlier runs measured again.")
def main(out: Path, repeats: int, motions: tuple[str, ...], again: bool) -> None:
    """Compare motions of the community's benchmark mechanisms with other programs, by error and time."""
    console = Console(width=None if sys.stdout.isatty() else 200)
    out.mkdir(parents=True, exist_ok=True)
    store, diagrams = Store(out / "motions.jsonl", Diagram, is_renewed=again), []
    facts = (describe_machine(), fingerprint_generator().hex(), hash_sources(), repeats)
    try:
        for name in motions or PROBLEMS:
            with console.status(name) as status:
                problem = PROBLEMS[name]()
                key = (*facts, hash_file(problem.model), hash_file(Path(__file__).with_name("ours.py")))
                work = partial(_measure, problem, repeats, status.update)
                diagrams += store.find_or_measure(key, work)
    except (MbsError, BuildError, ArithmeticError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    page = write_page(diagrams, describe_machine(), repeats)
    (out / "community.md").write_text(page, encoding="utf-8")
    console.print(page, markup=False)


def _measure(problem: Problem, repeats: int, report: Callable[[str], None]) -> list[Diagram]:
    with tempfile.TemporaryDirectory() as place:
        ways = [*list_community(problem), *list_peers(problem, Path(place)), *_list_trees(problem)]
        return [measure_problem(problem, ways, repeats, report)]


def _list_trees(problem: Problem) -> Iterator[Way]:
    """List the ways of Exudyn in minimal coordinates, if it is installed."""
    if find_spec("exudyn") is not None:
        from benchmarks.community.trees import list_trees

        yield from list_trees(problem)


if __name__ == "__main__":
    main()
