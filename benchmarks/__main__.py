"""`python -m benchmarks`: measure, print tables of figures and ratios, and write them as JSON and as a chart."""

from __future__ import annotations

from pathlib import Path

import click
from rich.console import Console
from rich.status import Status

from benchmarks.compilation import BuildError, Workshop, describe_machine, find_includes
from benchmarks.study import Depth, DisagreementError, study
from benchmarks.table import compare, draw_chart, make_tables, write_json, write_markdown
from mbsgen.errors import MbsError

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
def main(models: tuple[Path, ...], out: Path, rounds: int, hessians: bool, quick: bool) -> None:
    """Compare generated kernels of MODELS, or of the paper's arm, a UR5 and a Panda, with what others reach."""
    console = Console()
    if quick:
        models, rounds = models or QUICK, min(rounds, 10)
    includes = None if quick else find_includes()
    if includes is None:
        told = "Without Pinocchio." if quick else "Without Pinocchio: pip install '.[bench]' brings its headers."
        console.print(told, markup=False)
    workshop = Workshop(out.absolute(), includes)
    comparisons = {}
    try:
        for model in models or MODELS:
            with console.status(model.stem) as status:

                def report(text: str, name: str = model.stem, status: Status = status) -> None:
                    status.update(f"{name}: {text}")

                found = study(model, workshop, Depth(rounds, hessians), report)
            comparisons[found.model] = compare(found)
            for table in make_tables(found.model, comparisons[found.model]):
                console.print(table)
    except (MbsError, BuildError, DisagreementError, ArithmeticError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    machine = describe_machine()
    (out / "benchmarks.json").write_text(write_json(comparisons, machine, rounds), encoding="utf-8")
    (out / "benchmarks.md").write_text(write_markdown(comparisons, machine, rounds), encoding="utf-8")
    draw_chart(comparisons, out / "benchmarks.png")
    console.print(
        f"{out / 'benchmarks.json'} holds the figures, and benchmarks.md beside it; benchmarks.png charts the ratios."
    )


if __name__ == "__main__":
    main()
