"""`python -m website`: build the site."""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import click
from mkdocs.commands.build import build
from mkdocs.config import load_config
from rich.progress import Progress

from website import commands, forked, gallery, messages, pages, reference
from website.browser import bundle
from website.examples import EXAMPLES, Example

ROOT = Path(__file__).parents[1]
SWING_UP = "play_cart_pole"  # the example that swings up, with a solver in its page


@click.command(help="Build the site in the folder OUT: pages, gallery, references. Examples that ran before are kept.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), default=ROOT / "build" / "site", help="By default build/site."
)
@click.option("--only", multiple=True, metavar="NAME", help="Run these examples alone, and show no others.")
@click.option(
    "--quick",
    is_flag=True,
    help="A preview without the reference of Python; no commands of pages, and one message of each class.",
)
def main(out: Path, only: tuple[str, ...], *, quick: bool) -> None:
    """Write the pages, run the examples, and let MkDocs make HTML of them."""
    unknown = set(only) - {example.name for example in EXAMPLES}
    if unknown:
        raise click.UsageError(f"no example {', '.join(sorted(unknown))}")
    chosen = [example for example in EXAMPLES if not only or example.name in only]
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    out = out.resolve()  # MkDocs counts from its own file
    source = out.parent / f"{out.name}-pages"
    shutil.rmtree(source, ignore_errors=True)
    shown = {} if quick else pages.list_examples(ROOT)
    with tempfile.TemporaryDirectory() as place, forked.serve(Path(place)) as programs:
        results = _run([*shown.values(), *chosen], out.parent / f"{out.name}-runs", programs)
        messages.write(source, programs, 1 if quick else None)
    folders = {path: result.folder for path, result in zip(shown, results, strict=False)}
    navigation = pages.write(ROOT, source, folders)
    results = results[len(shown) :]
    gallery.write(results, source)
    pages.write_front(ROOT, source, gallery.write_front_cards(results))
    commands.write(source)
    listed = [] if quick else [{"Python": reference.PAGES}]
    if not quick:
        reference.write(source)
        _write_browser(source, out.parent / f"{out.name}-browser", results)
    config = load_config(
        str(Path(__file__).with_name("mkdocs.yml")),
        docs_dir=str(source),
        site_dir=str(out),
        nav=[
            *navigation,
            {"Gallery": gallery.list_pages(results)},
            {"Reference": [{"Commands": commands.PAGES}, *listed, {"Messages": messages.PAGES}]},
        ],
        strict=True,
    )
    build(config)
    click.echo(f"wrote {out / 'index.html'}")


def _write_browser(source: Path, work: Path, results: Sequence[gallery.Result]) -> None:
    """Write the page that generates in a browser, where the programs that make it are installed."""
    pages = (x.folder / "build" / "cart_pole.html" for x in results if x.example.name == SWING_UP)
    try:
        bundle.write(source / bundle.FOLDER, work, next(pages, None))
    except bundle.BundleError as error:
        shutil.rmtree(source / bundle.FOLDER, ignore_errors=True)
        click.echo(f"the site lacks the page that generates in a browser: {error}", err=True)
    else:
        bundle.link(source)


def _run(examples: Sequence[Example], runs: Path, programs: Path) -> list[gallery.Result]:
    """Run examples, and show which one."""
    results = []
    with Progress() as bar:
        task = bar.add_task("examples", total=len(examples))
        for example in examples:
            bar.update(task, description=example.name)
            results.append(gallery.run(example, ROOT, runs, programs))
            bar.advance(task)
    return results


if __name__ == "__main__":
    main()
