"""The commands in the documents work, and the files that they link to exist.

Every fenced `sh` and `python` block is run, in order, in a copy of the checkout that the blocks of a document share.
What is generated and compiled is kept for all documents. A command that would search long searches less, see FEWER. A
block that opens with `# not run` cannot be run within a test: `.ci/run` runs the same lines.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.readme import HEADLINES, OVERVIEW, RESULTS, fill, fill_all, link, write_overview
from mbsrun import bare
from tests import acados
from website import forked
from website.blocks import NOT_RUN, Block, list_shown, read_blocks

ROOT = Path(__file__).parents[1]
ACADOS = ROOT / "build" / "acados"  # where `.ci/run` installs it
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FEWER = {
    "--starts 20": "--starts 3",
    "--azimuths 0.8 1.2 3": "--azimuths 0.8 1.2 2",
    "4096, 256, 45, 120, 0.025": "64, 32, 1, 20, 0.025",
    " --emulate": "",  # the tests of controllers run it
    "cmake -S": "cmake -DCMAKE_BUILD_TYPE=Debug -S",
}
TOOLS = {"docs/microcontroller.md": tuple(bare.PACKAGES), "docs/rust.md": ("cargo",)}  # skipped without them
LIBRARIES = {
    "docs/coming_from.md": ("mujoco", "pinocchio"),
    "docs/learning.md": ("jax", "torch"),
    "docs/tutorials/learn.md": ("jax",),
}  # skipped without them
SHELL = ("bash", "-euo", "pipefail", "-c")
SEPARATE = "README.md"  # its commands are started as a user starts them, each in a new process


def name(document: Path) -> str:
    return document.relative_to(ROOT).as_posix()


def blocks(document: Path) -> list[Block]:
    """List the blocks of a document that can be run."""
    return read_blocks(document.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a folder of the project's commands, which start at once."""
    with forked.serve(tmp_path_factory.mktemp("programs")) as folder:
        yield folder


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if blocks(d)], ids=name)
def test_what_a_document_says_to_type_works(
    document: Path, tmp_path: Path, requires: Callable[[str], str], programs: Path
) -> None:
    """Blocks run, print the lines that the document quotes after them, and write the files that it shows."""
    for tool in TOOLS.get(name(document), ()):
        requires(tool)
    for library in LIBRARIES.get(name(document), ()):
        pytest.importorskip(library)
    checkout = tmp_path / "checkout"
    unwanted = (".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "build", "dist")
    shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(*unwanted), symlinks=True)
    own = [] if name(document) == SEPARATE else [str(programs)]
    path = os.pathsep.join([*own, str(Path(sys.executable).parent), os.environ["PATH"]])
    interpreters = {"sh": SHELL, "python": (str(programs / forked.PYTHON),) if own else (sys.executable, "-c")}
    for block in blocks(document):
        if block.text.startswith(NOT_RUN):
            continue
        text = block.text
        for many, few in FEWER.items():
            text = text.replace(many, few)
        run = subprocess.run(
            [*interpreters[block.language], text],
            cwd=checkout,
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert run.returncode == 0, f"{text}\n{run.stdout}{run.stderr}"
        printed = [line.split() for line in (run.stdout + run.stderr).splitlines()]
        assert [line for line in block.quoted if line.split() not in printed] == [], run.stdout + run.stderr
    assert [file for file in list_shown(document.read_text(encoding="utf-8")) if not (checkout / file).is_file()] == []


def test_what_is_made_fewer_stands_in_a_document() -> None:
    texts = [block.text for document in DOCUMENTS for block in blocks(document)]
    assert [many for many in FEWER if not any(many in text for text in texts)] == []


def test_c_of_the_theory_is_generated() -> None:
    """Each line of C on the page stands in the generated file that the page links to."""
    page = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    generated = (ROOT / "generated" / "double_pendulum" / "double_pendulum_impl.c").read_text(encoding="utf-8")
    shown = [line for block in re.findall(r"^```c\n(.*?)^```$", page, re.M | re.S) for line in block.splitlines()]
    assert shown
    assert [line for line in shown if line not in generated] == []


@pytest.mark.skipif(not ACADOS.exists(), reason=f"python3 tests/acados.py {ACADOS.relative_to(ROOT)} installs acados")
def test_the_example_for_acados_runs(tmp_path: Path) -> None:
    """In a separate environment, for the version of the wheel, which passes no time."""
    text = (ROOT / "docs" / "acados.md").read_text(encoding="utf-8")
    (command,), (example,) = (re.findall(rf"^```{kind}\n(.*?)^```$", text, re.M | re.S) for kind in ("sh", "py"))
    shutil.copytree(ROOT / "models", tmp_path / "models")
    untimed = command.replace("--acados ", "--acados-untimed ")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for line, variables in (
        ([*SHELL, untimed], {"PATH": path}),
        ([str(ACADOS / "bin" / "python"), "-c", example], acados.variables(ACADOS)),
    ):
        run = subprocess.run(
            line, cwd=tmp_path, env={**os.environ, **variables}, capture_output=True, text=True, check=False
        )
        assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines()[-1].startswith("0 0.419")


def test_what_is_not_run_here_is_run_by_ci() -> None:
    """The lines of blocks marked `# not run`, comments aside, are lines of `.ci/run`."""
    done = {line.strip() for line in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()}
    left = [block.text for document in DOCUMENTS for block in blocks(document) if block.text.startswith(NOT_RUN)]
    commands = {line.partition("#")[0].strip() for block in left for line in block.splitlines()} - {""}
    assert commands
    assert commands <= done


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_what_a_document_points_to_is_there(document: Path) -> None:
    links = LINK.findall(document.read_text(encoding="utf-8"))
    local = [link.partition("#")[0] for link in links if not re.match(r"[a-z]+:|#", link)]
    assert not [link for link in local if not (document.parent / link).exists()]


def test_the_readme_shows_the_figures_of_the_benchmarks() -> None:
    """`python -m benchmarks.readme` writes them there: no figure in these parts is typed in by hand."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert link("[a](b.md)\n[c](https://d)") == "[a](benchmarks/results/b.md)\n[c](https://d)"
    assert fill(text, HEADLINES, "figures").count("\n\nfigures\n\n") == 1
    assert fill_all(text) == text
    assert (RESULTS / OVERVIEW).read_text(encoding="utf-8") == write_overview()


def test_the_readme_is_among_the_documents() -> None:
    assert ROOT / "README.md" in DOCUMENTS
    assert any(not block.text.startswith(NOT_RUN) for block in blocks(ROOT / "README.md"))
