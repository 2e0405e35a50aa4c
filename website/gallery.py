"""The gallery: examples that were run, with their commands, pictures, run times and files to download."""

from __future__ import annotations

import hashlib
import html
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from website import forked, notebooks
from website.examples import Example

RECORD = "run.json"  # in the folder of a run
SOURCES = ("generator", "python", "csrc", "templates", "models")  # what decides the result of a run
LONGEST = 600  # seconds
SHOWN = 40  # lines of a command's output
QUICKLY = "-O1"  # flags of the compiler: an example takes two thirds of the processor time, and shows the same
FRONT = (  # examples on the front page
    "bound",
    "six_axis",
    "play_cart_pole",
    "muscles",
    "stewart",
    "walker",
    "delta_pick",
    "equations",
)


class ExampleError(Exception):
    """An example whose commands fail."""


@dataclass(frozen=True)
class Result:
    """An example that was run in a folder."""

    example: Example
    folder: Path
    output: str
    seconds: float

    @property
    def page(self) -> str:
        """Return the place of its page."""
        return f"gallery/{self.example.name}.md"

    @property
    def files(self) -> list[str]:
        """List its files for download, by their paths in the folder."""
        example = self.example
        return list(dict.fromkeys((example.picture, *example.files, *_place_notebook(example))))


def run(example: Example, root: Path, runs: Path, programs: Path) -> Result:
    """Run the commands of an example in a copy of the models, unless they were run on the same sources before.

    `programs` is a folder of the project's commands.
    """
    folder, key = runs / example.name, _identify(example, root)
    record = folder / RECORD
    if record.exists():
        known = json.loads(record.read_text(encoding="utf-8"))
        if known["key"] == key:
            return Result(example, folder, known["output"], known["seconds"])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(root / "models", folder / "models")
    (folder / "build").mkdir()
    path = os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ["PATH"]])
    begin = time.perf_counter()
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", example.commands],
        cwd=folder,
        env={"CFLAGS": QUICKLY, **os.environ, "PATH": path, "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    seconds = time.perf_counter() - begin
    if done.returncode:
        raise ExampleError(f"{example.name}: {done.stdout}{done.stderr}")
    missing = [name for name in (example.picture, *example.files) if not (folder / name).exists()]
    if missing:
        raise ExampleError(f"{example.name} did not write {', '.join(missing)}")
    for notebook in _place_notebook(example):
        _execute(example, folder / notebook, programs)
    known = {"key": key, "output": done.stdout, "seconds": seconds}
    record.write_text(json.dumps(known), encoding="utf-8")
    return Result(example, folder, done.stdout, seconds)


def _place_notebook(example: Example) -> list[str]:
    """Return the path of an example's notebook, beside its problem; none where there are no cells."""
    first = next((file for file in example.files if file.startswith("models/")), "")
    return [f"{Path(first).parent.as_posix()}/{example.name}.ipynb"] if example.notebook else []


def _execute(example: Example, path: Path, programs: Path) -> None:
    """Write the notebook of an example, and run it."""
    path.write_text(notebooks.write(example), encoding="utf-8")
    done = subprocess.run(
        [programs / forked.PYTHON, f"from website import notebooks; notebooks.run_file({str(path)!r})"],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    if done.returncode:
        raise ExampleError(f"{path.name}: {done.stdout}{done.stderr}")


def _identify(example: Example, root: Path) -> str:
    """Return a hash of everything that decides the result."""
    found = hashlib.sha256(repr(example).encode())
    found.update(Path(notebooks.__file__).read_bytes())
    for source in SOURCES:
        for path in sorted((root / source).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                found.update(path.relative_to(root).as_posix().encode())
                found.update(path.read_bytes())
    return found.hexdigest()


def list_pages(results: Sequence[Result]) -> list[str | dict[str, str]]:
    """List the pages of the gallery for the navigation."""
    return ["gallery/index.md", *({result.example.title: result.page} for result in results)]


def write(results: Sequence[Result], target: Path) -> None:
    """Write the gallery's pages, and copy the files that they show."""
    (target / "gallery").mkdir(parents=True, exist_ok=True)
    for result in results:
        files = target / "gallery" / result.example.name
        files.mkdir(parents=True, exist_ok=True)
        for each in result.files:
            shutil.copyfile(result.folder / each, files / Path(each).name)
        (target / result.page).write_text(_describe(result), encoding="utf-8")
    page = ["---", "hide: [toc]", "---", "# Gallery", "", "Each example was run when this site was built.", ""]
    page += [write_cards(results, ""), ""]
    (target / "gallery" / "index.md").write_text("\n".join(page), encoding="utf-8")


def write_front_cards(results: Sequence[Result]) -> str:
    """Write cards of a few examples, for the site's front page; of others where these were not run."""
    chosen = [result for result in results if result.example.name in FRONT]
    return write_cards(chosen or results[: len(FRONT)], "gallery/")


def write_cards(results: Sequence[Result], folder: str) -> str:
    """Write a card for each example: a picture and a sentence, with a link; `folder` is the gallery's."""
    cards = (
        f'<a href="{folder}{result.example.name}.html">'
        f'<img src="{folder}{result.example.name}/{Path(result.example.picture).name}" '
        f'alt="{html.escape(result.example.title)}"><br><b>{html.escape(result.example.title)}</b><br>'
        f"{html.escape(result.example.text.split('. ')[0].rstrip('.'))}.</a>"
        for result in results
    )
    return "\n".join(['<div class="cards">', *cards, "</div>"])


def _describe(result: Result) -> str:
    """Write the page of an example."""
    example, name = result.example, result.example.name
    shown = [file for file in example.files if file.endswith(".html")]
    lines = [f"# {example.title}", "", example.text, ""]
    lines += ["```sh", example.commands.strip(), "```", ""]
    if not shown:
        picture = Path(example.picture).name
        lines += [f"[![{example.title}]({name}/{picture})]({name}/{picture})", ""]
    for file in shown:
        size = ' class="tall"' if "mbsrun playground" in example.commands else ""
        lines += [f'<iframe{size} src="{name}/{Path(file).name}" title="{html.escape(example.title)}"></iframe>', ""]
    output = result.output.strip().splitlines()
    if output:
        kept = output[:SHOWN] + ([f"... ({len(output) - SHOWN} more lines)"] if len(output) > SHOWN else [])
        lines += ["The commands print", "", "```text", *kept, "```", ""]
    lines += [
        f"They took {result.seconds:.0f} s here, with generation and compilation where nothing was in the cache.",
        "",
    ]
    names = [Path(file).name for file in result.files]
    lines += ["## Files", "", ", ".join(f"[{file}]({name}/{file})" for file in names) + ".", ""]
    for file in example.files:
        if file.startswith("models/") and file.endswith(".yaml"):
            text = (result.folder / file).read_text(encoding="utf-8").strip()
            lines += [f"### {Path(file).name}", "", "```yaml", text, "```", ""]
    return "\n".join(lines)
