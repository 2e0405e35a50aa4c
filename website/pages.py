"""The pages of the documents, as the site shows them: Markdown of the checkout -> Markdown whose links stay within.

A link to a page of the site stays a link to it. Any other file of the checkout that a page points to is copied, and
offered for download; a folder becomes a list of its files. A file that the commands of a page write, and the page
shows, becomes a picture, a frame, or a text.
"""

from __future__ import annotations

import html
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath
from typing import Any

from website.blocks import list_shown, replace_shown, write_script
from website.examples import Example

LINK = re.compile(r"(\]\()([^)\s#]+)(#[^)\s]*)?(\))")
FILES = "files"  # the folder of files that are no pages
WORKER = "iframe-worker.js"  # for the search, in pages that are opened as files
WRITTEN = "written"  # the folder of files that the commands of pages write
STYLE = """\
.md-typeset img { max-width: 100%; }
.md-typeset iframe { width: 100%; height: 480px; border: 1px solid var(--md-default-fg-color--lightest); }
.md-typeset iframe.tall { height: 860px; }
.md-typeset table:not([class]) { display: block; overflow-x: auto; }
.md-typeset :is(code, p, li) { overflow-wrap: anywhere; }
.md-typeset :is(td, th) { overflow-wrap: break-word; }
.md-typeset :is(td, th) code { overflow-wrap: normal; word-break: normal; }
.md-typeset .wrap code { white-space: pre-wrap; }
.md-typeset .help code { font-size: .6rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(max(8rem, 22%), 1fr)); gap: 1rem; }
.cards a { border: 1px solid var(--md-default-fg-color--lightest); border-radius: .3rem; padding: .6rem; }
.cards a { color: inherit; }
.front { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 18rem), 1fr)); gap: 0 2rem; }
.front { align-items: center; margin-bottom: 1rem; }
.front > * { min-width: 0; }
.front h1 { margin-bottom: .6rem; }
.front .md-button { margin-bottom: .4rem; }
.front img { width: 100%; border-radius: .3rem; background: white; }
.ways { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 16rem), 1fr)); gap: .4rem 1.5rem; }
.ways p { margin: 0; }
.front img.narrow { display: none; }
@media (max-width: 600px) { .front img.wide { display: none; } .front img.narrow { display: block; } }
.cards img { width: 100%; aspect-ratio: 8 / 5; object-fit: contain; background: white; }
"""

TUTORIALS = "tutorials"  # their folder
GUIDES: list[dict[str, Any]] = [  # titles, and the pages of `docs`
    {"Overview": ["readme.md", "conventions.md", "coming_from.md"]},
    {
        "Model": [
            "model.md",
            "loops.md",
            "importing.md",
            "scenes.md",
            "equations.md",
            "theory.md",
            "linearise.md",
        ],
    },
    {
        "Compute": [
            "kernels.md",
            "kernels_python.md",
            "batches.md",
            "several_models.md",
            "learning.md",
            "gpu.md",
            "cpp.md",
            "rust.md",
            "julia.md",
            "wasm.md",
        ]
    },
    {
        "Simulate": [
            "simulation.md",
            "stops.md",
            "contacts.md",
            "tyres.md",
            "animation.md",
            "playground.md",
            "fmu.md",
        ]
    },
    {
        "Optimise": [
            "problem.md",
            "phases.md",
            "python.md",
            "gait.md",
            "muscles.md",
            "opensim.md",
            "quantities.md",
            "derivatives.md",
            "classics.md",
            "solver.md",
        ]
    },
    {"Measure": ["recordings.md", "scaling.md", "identification.md", "known_inputs.md"]},
    {"Control": ["controller.md", "track.md", "memory.md", "microcontroller.md", "acados.md"]},
    {
        "Trust": [
            "accuracy.md",
            "laboratory.md",
            "reproduction.md",
            "study.md",
            "study/README.md",
            "laboratory/verdicts.md",
        ],
    },
    {
        "Project": ["architecture.md", "contributing.md", "changelog.md"],
    },
]
TITLES = {"readme.md": "What there is"}  # of pages whose own title says less
ELSEWHERE = {  # pages that are not in `docs`
    "README.md": "readme.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
FIGURES = "figures"  # the folder of published measurements


@dataclass
class Staging:
    """The pages of a checkout, by their path in it, and the files that they point to."""

    root: Path
    target: Path
    pages: dict[str, str]
    runs: Mapping[str, Path] = field(default_factory=dict)  # folders in which the commands of pages were run
    files: set[str] = field(default_factory=set)

    def rewrite(self, path: str) -> str:
        """Return the text of a page, with links to the places of the site."""
        here = PurePosixPath(path).parent
        there = PurePosixPath(self.pages[path]).parent
        text = (self.root / path).read_text(encoding="utf-8")

        def replace(match: re.Match[str]) -> str:
            link, anchor = match.group(2), match.group(3) or ""
            if re.match(r"[a-z]+:", link):
                return match.group(0)
            place = self.place(normpath(str(here / link)))
            return f"{match.group(1)}{relpath(place, str(there))}{anchor}{match.group(4)}"

        return replace_shown(LINK.sub(replace, text), lambda file, title: self.show(path, file, title))

    def show(self, path: str, file: str, title: str) -> str:
        """Return a picture, a frame or the text of a file that a page's commands wrote, or nothing without a run."""
        if path not in self.runs:
            return ""
        if file.endswith(".md"):
            text = (self.runs[path] / file).read_text(encoding="utf-8")
            return f"*{title}:*\n{text.partition(chr(10))[2]}"  # without the text's own title
        here = PurePosixPath(self.pages[path])
        place = PurePosixPath(WRITTEN, here.with_suffix(""), file)
        (self.target / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(self.runs[path] / file, self.target / place)
        link = relpath(str(place), str(here.parent))
        if file.endswith(".html"):
            return f'<iframe src="{link}" title="{html.escape(title)}"></iframe>'
        return f"![{title}]({link})"

    def place(self, path: str) -> str:
        """Return where the site has a file or folder of the checkout."""
        if path in self.pages:
            return self.pages[path]
        if f"{path}/README.md" in self.pages:
            return self.pages[f"{path}/README.md"]
        self.files.add(path)
        return f"{FILES}/{path}" + ("/index.md" if (self.root / path).is_dir() else "")

    def write(self) -> None:
        """Write all pages, and the files that they point to."""
        for path, place in self.pages.items():
            target = self.target / place
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(self.rewrite(path), encoding="utf-8")
        for path in sorted(self.files):
            self.copy(path)

    def copy(self, path: str) -> None:
        """Copy a file, or the files of a folder with a list of them."""
        source, target = self.root / path, self.target / FILES / path
        if not source.is_dir():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
            return
        target.mkdir(parents=True, exist_ok=True)
        names = sorted(file.name for file in source.iterdir() if file.is_file() and file.suffix != ".md")
        for name in names:
            shutil.copyfile(source / name, target / name)
        lines = [f"# {path}", "", *(f"- [{name}]({name})" for name in names), ""]
        (target / "index.md").write_text("\n".join(lines), encoding="utf-8")


def list_examples(root: Path) -> dict[str, Example]:
    """Return, by the path of each page that shows files, its commands as an example that is run."""
    found = {}
    for path in sorted((root / "docs").glob("**/*.md")):
        text = path.read_text(encoding="utf-8")
        if shown := list_shown(text):
            name = path.relative_to(root).with_suffix("").as_posix().replace("/", "-")
            found[path.relative_to(root).as_posix()] = Example(
                name, name, "", write_script(text), shown[0], tuple(shown)
            )
    return found


def write(root: Path, target: Path, runs: Mapping[str, Path]) -> list[dict[str, Any]]:
    """Write the pages of a checkout to a folder, and return the site's navigation.

    `runs` holds, by the path of a page, the folder in which its commands were run.
    """
    pages = {f"docs/{path.relative_to(root / 'docs').as_posix()}": "" for path in sorted(root.glob("docs/**/*.md"))}
    pages = {path: path.removeprefix("docs/") for path in pages}
    pages |= {path: place for path, place in ELSEWHERE.items() if (root / path).exists()}
    measured = [path.relative_to(root / "benchmarks") for path in sorted(root.glob("benchmarks/**/*.md"))]
    pages |= {f"benchmarks/{path.as_posix()}": f"{FIGURES}/{path.as_posix()}" for path in measured}
    Staging(root, target, pages, runs).write()
    (target / "site.css").write_text(STYLE, encoding="utf-8")
    shutil.copyfile(Path(__file__).with_name(WORKER), target / WORKER)
    return _navigate(set(pages.values()), (root / "docs" / TUTORIALS / "README.md").read_text(encoding="utf-8"))


def _navigate(known: set[str], tutorials: str) -> list[dict[str, Any]]:
    """Return the navigation: start, tutorials in the order of their list, guides."""
    parts = {title: listed for part in GUIDES for title, listed in part.items()}
    guides: list[dict[str, Any]] = [
        {title: [{TITLES[page]: page} if page in TITLES else page for page in listed if page in known]}
        for title, listed in parts.items()
    ]
    listed = [f"{TUTORIALS}/README.md"]
    listed += [f"{TUTORIALS}/{link.group(2)}" for link in LINK.finditer(tutorials) if "/" not in link.group(2)]
    named = {"start.md", *listed} | {page for own in parts.values() for page in own}
    others = sorted(page for page in known - named if not page.startswith(FIGURES))
    figures = sorted(page for page in known if page.startswith(FIGURES))
    guides += [{"Figures": figures}, *([{"More": others}] if others else [])]
    return [{"Home": "index.md"}, {"Start": "start.md"}, {"Tutorials": listed}, {"Guides": guides}]


def write_front(root: Path, target: Path, cards: str) -> None:
    """Write the front page: what the project is for, a film, commands, figures with their chart, cards of examples.

    The figures are sentences of the README.
    """
    (target / WRITTEN).mkdir(parents=True, exist_ok=True)
    for path in (FILM, CHART, PHONE):
        shutil.copyfile(root / path, target / WRITTEN / Path(path).name)
    figures = read_figures((root / "README.md").read_text(encoding="utf-8"))
    (target / "index.md").write_text(FRONT.format(figures=figures, cards=cards), encoding="utf-8")


def read_figures(readme: str) -> str:
    """Return the sentences of the README about speed, without their links."""
    _, _, rest = readme.partition("<!-- begin: benchmarks/results/headlines -->")
    sentences, mark, _ = rest.partition("<!-- end -->")
    assert mark, "the README shows figures"
    return re.sub(r"\s*\(\[figures\]\([^)]*\)\)", "", sentences.strip())


FILM, CHART, PHONE = "docs/arm_reach.gif", "benchmarks/results/faster.png", "benchmarks/results/faster_narrow.png"
FRONT = """\
---
title: mbsgen
hide: [navigation, toc]
---
<div class="front" markdown>
<div markdown>
# Equations of motion, as&nbsp;C

Describe a robot or another mechanism in a file. mbsgen writes C code for its dynamics, with exact first and second
derivatives. mbsrun simulates it, finds optimal motions, and turns them into controllers for small hardware.

[Start here](start.md){{ .md-button .md-button--primary }}
[Gallery](gallery/index.md){{ .md-button }}
</div>
![An arm carries a pendulum to a given place, and holds it upright](written/arm_reach.gif)
</div>

{cards}

<div class="front" markdown>
<div markdown>
## Install

```sh
make demo && . .venv/bin/activate  # in a clone
mbsgen models/arm_pendulum.yaml -o build/arm
mbsrun solve models/arm_reach.ocp.yaml -o build/reach
```

It needs Python 3.11 and a C compiler, on Linux.
</div>
<div markdown>
## A line of code

```python
import mbsrun

arm = mbsrun.load("models/arm_pendulum.yaml")
arm.exp2(q=[0.1] * 6, qd=[0] * 6, u=[0] * 4)["qdd"]
mbsrun.read_problem("models/arm_reach.ocp.yaml").solve()
```
</div>
</div>

## How fast

<div class="front" markdown>
<div markdown>
{figures}

[All figures](figures/results/overview.md), with the limits of each comparison.
</div>
<div markdown>
![Times faster than the quickest peer, by kind of work](written/faster.png){{ .wide }}
![Times faster than the quickest peer, by kind of work](written/faster_narrow.png){{ .narrow }}
</div>
</div>

## I want to

<div class="ways" markdown>

learn it by doing: [tutorials](tutorials/README.md)

take my robot's file: [importing](importing.md)

describe a mechanism: [model files](model.md), [closed loops](loops.md)

read its equations: [equations](equations.md)

compute from Python: [kernels in Python](kernels_python.md)

compute from C or C++: [kernels](kernels.md), [C++](cpp.md)

simulate it: [simulation](simulation.md)

find an optimal motion: [problem files](problem.md)

control it in real time: [controllers](controller.md), [microcontrollers](microcontroller.md)

measure its inertias: [identification](identification.md)

know how exact it is: [accuracy](accuracy.md)

come from another program: [words and calls](coming_from.md)

</div>
"""
