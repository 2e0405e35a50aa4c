"""Flops of `impl` with tolerances, as docs/scenes.md lists them; `python -m benchmarks.tolerances` renews its table."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from benchmarks.pages import tabulate
from benchmarks.robots import find_robot
from mbsgen.pipeline import Options, generate

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "scenes.md"
TOLERANCES = (None, 1e-3, 1e-2, 5e-2)  # None: the whole model
ROBOTS = {"ANYmal, floating": "anymal", "Talos, floating": "talos"}
SIX_AXIS = ROOT / "models" / "six_axis.yaml"
TABLE = re.compile(r"^\| +\| whole \|.*?(?=\n\n|\n\Z)", re.M | re.S)


def count_flops(model: Path, folder: Path) -> list[int]:
    """Count the flops of `impl` for each tolerance, as `mbsgen` prints them."""
    found = []
    for tolerance in TOLERANCES:
        options = Options(functions=("impl",), derivatives=0, tolerance=tolerance)
        (kernel,) = (x for x in generate(model, folder / f"{tolerance}", options).manifest.kernels if x.name == "impl")
        found.append(kernel.flops.paper)
    return found


def fill(page: str, counts: Mapping[str, list[int]]) -> str:
    """Replace the table of a page. Raises ValueError where there is none."""
    titles = ["", *("whole" if x is None else f"{x:g}" for x in TOLERANCES)]
    lines = tabulate(titles, ([name, *map(str, row)] for name, row in counts.items()))
    new, number = TABLE.subn(lambda _: "\n".join(lines), page)
    if number != 1:
        raise ValueError("the page has no table of tolerances")
    return new


@click.command()
def main() -> None:
    """Count, and renew the table. The robots' files come with `pip install '.[bench]'`."""
    with TemporaryDirectory() as folder:
        models: dict[str, Path] = {"`models/six_axis.yaml`": SIX_AXIS}
        for title, name in ROBOTS.items():
            path = find_robot(name, Path(folder))
            if path is None:
                raise click.ClickException(f"no file of {name}: pip install '.[bench]' brings it")
            models[title] = path
        counts = {title: count_flops(path, Path(folder) / path.stem) for title, path in models.items()}
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), counts), encoding="utf-8")


if __name__ == "__main__":
    main()
