"""The site builds without a warning, needs no other site, and fits a telephone and a screen."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import nbformat
import pytest
import sympy as sp
from click.testing import CliRunner

import mbsrun
from website import notebooks, reference
from website.__main__ import main
from website.browser import bundle
from website.examples import EXAMPLES
from website.gallery import ExampleError, run
from website.pages import CHART, FILM, PHONE, Staging, list_examples, write_front

ROOT = Path(__file__).parents[1]
LOADED = re.compile(r"""<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=["']([^"']+)["']""")
NAVIGATES = re.compile(r"""<link\b[^>]*\brel=["'](?:canonical|next|prev|edit)["']""")
WIDTHS = (390, 1280)
PAGES = (
    "index",
    "start",
    "tutorials/index",
    "tutorials/cpp_loop",
    "model",
    "problem",
    "gallery/index",
    "gallery/pendulum",
    "commands/mbsrun",
    "messages/models",
)
WIDE = """\
<html><body><script>
const pages = %s, widths = %s, found = {};
async function measure() {
  for (const page of pages) for (const width of widths) {
    const frame = document.createElement("iframe");
    frame.sandbox = "allow-same-origin";  // pages are laid out without their scripts
    frame.style.width = width + "px"; frame.style.height = "800px"; frame.src = page;
    const loaded = new Promise(resolve => frame.onload = resolve);
    document.body.appendChild(frame); await loaded;
    const root = frame.contentDocument.documentElement;
    if (root.scrollWidth > width) found[page + " " + width] = root.scrollWidth;
    frame.remove();
  }
  document.title = "measured " + JSON.stringify(found);
}
measure();
</script></body></html>
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site with one example; MkDocs takes any open link for an error."""
    out = tmp_path_factory.mktemp("website") / "site"
    done = CliRunner().invoke(main, ["-o", str(out), "--quick", "--only", "pendulum"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return out


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    loaded = [
        (page.name, tag.group(1))
        for page in pages
        for tag in LOADED.finditer(page.read_text(encoding="utf-8"))
        if not NAVIGATES.match(tag.group(0)) and re.match(r"(?:https?:)?//", tag.group(1))
    ]
    assert loaded == []
    styles = [
        (path.name, found)
        for path in site.rglob("*.css")
        for found in re.findall(r"url\(['\"]?(https?:[^)]*)", path.read_text("utf-8"))
    ]
    assert styles == []


def test_an_example_shows_its_motion_and_its_files(site: Path) -> None:
    page = (site / "gallery" / "pendulum.html").read_text(encoding="utf-8")
    assert '<iframe src="pendulum/animation.html"' in page
    for name in ("animation.html", "pendulum.yaml", "trajectory.csv", "plots.png", "pendulum.png"):
        assert (site / "gallery" / "pendulum" / name).stat().st_size > 0
        assert f'href="pendulum/{name}"' in page
    assert "revolute" in page  # the text of the model


def test_references_are_there(site: Path) -> None:
    assert "mbsrun linearise" in (site / "commands" / "mbsrun.html").read_text(encoding="utf-8")
    assert "problem.yaml:8: end.pose.hing" in (site / "messages" / "problems.html").read_text(encoding="utf-8")


def test_pages_fit_a_telephone_and_a_screen(site: Path, requires: Callable[[str], str]) -> None:
    """No page scrolls sideways at 390 and 1280 pixels, in Chromium."""
    chromium = requires("chromium")
    pages = [f"{name}.html" for name in PAGES]
    assert [page for page in pages if not (site / page).exists()] == []
    (site / "widths.html").write_text(WIDE % (json.dumps(pages), json.dumps(WIDTHS)), encoding="utf-8")
    done = subprocess.run(
        [
            chromium,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--allow-file-access-from-files",
            "--window-size=1400,900",
            "--virtual-time-budget=20000",
            "--dump-dom",
            (site / "widths.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    measured = re.search(r"<title>measured (.*?)</title>", done.stdout)
    assert measured is not None, done.stderr[-2000:]
    assert json.loads(measured.group(1).replace("&quot;", '"')) == {}


def test_the_search_works_without_a_server(site: Path, requires: Callable[[str], str]) -> None:
    """Chromium permits no worker to a page that is a file; the script of the search runs in a frame there."""
    command = [requires("chromium"), "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000"]
    page = f"{(site / 'index.html').as_uri()}?q=excavator"
    done = subprocess.run([*command, "--dump-dom", page], capture_output=True, text=True, timeout=300, check=True)
    assert re.search(r"\d+ matching documents", done.stdout)


def test_the_front_page_shows_film_chart_and_figures(tmp_path: Path) -> None:
    """The figures are the README's sentences, without their links."""
    write_front(ROOT, tmp_path, "CARDS")
    front = (tmp_path / "index.md").read_text(encoding="utf-8")
    for path in (FILM, CHART, PHONE):
        assert f"](written/{Path(path).name})" in front
        assert (tmp_path / "written" / Path(path).name).read_bytes() == (ROOT / path).read_bytes()
    assert "\nCARDS\n" in front
    assert re.search(r"\n- \*\*[\d.]+ times faster\*\* than .*\.\n", front)
    assert "([figures]" not in front
    (tmp_path / "playground.md").touch()
    bundle.link(tmp_path)
    for name in ("index.md", "playground.md"):
        assert f"]({bundle.FOLDER}/index.html)" in (tmp_path / name).read_text(encoding="utf-8")


def test_an_example_that_fails_stops_the_build(tmp_path: Path) -> None:
    broken = replace(EXAMPLES[0], commands="echo seen >&2; exit 3\n")
    with pytest.raises(ExampleError, match="seen"):
        run(broken, ROOT, tmp_path, tmp_path)


def test_a_notebook_of_equations_shows_formulas() -> None:
    """SymPy's objects have a method for pictures that returns none."""
    shown = notebooks.show(sp.Matrix([sp.Symbol("x")]))
    assert "".join(shown["text/latex"]) == r"$\displaystyle \left[\begin{matrix}x\end{matrix}\right]$"
    assert shown.keys() == {"text/plain", "text/latex"}


def test_a_page_shows_what_its_commands_wrote(tmp_path: Path) -> None:
    """A picture and a page of HTML are shown from their copies, a report as text; without a run, nothing is shown."""
    names = {"way.png": "![a way](../written/docs/way/build/way.png)", "way.html": "<iframe", "way.md": "| seen |"}
    page = "".join(f"<!-- shows build/{name}: a way -->\n" for name in names)
    for name in names:
        (tmp_path / "run" / "build").mkdir(parents=True, exist_ok=True)
        (tmp_path / "run" / "build" / name).write_text("# Title\n| seen |\n")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "way.md").write_text(page)
    places = {"docs/way.md": "docs/way.md"}
    staged = Staging(tmp_path, tmp_path / "site", places, {"docs/way.md": tmp_path / "run"}).rewrite("docs/way.md")
    assert [shown for shown in names.values() if shown not in staged] == []
    assert (tmp_path / "site" / "written" / "docs" / "way" / "build" / "way.html").exists()
    assert Staging(tmp_path, tmp_path / "site", places).rewrite("docs/way.md").strip() == ""


def test_pages_that_show_files_are_run() -> None:
    found = list_examples(ROOT)
    assert {"docs/start.md", "docs/tutorials/swing_up.md"} <= set(found)
    assert "mbsrun solve models/cart_pole_swing_up.ocp.yaml" in found["docs/tutorials/swing_up.md"].commands
    assert "python - <<" in found["docs/tutorials/swing_up.md"].commands


def test_the_gallery_is_large() -> None:
    assert len(EXAMPLES) >= 25
    assert len({example.name for example in EXAMPLES}) == len(EXAMPLES)
    assert 3 * len([example for example in EXAMPLES if example.notebook]) >= len(EXAMPLES)


def test_a_notebook_is_valid_and_keeps_the_outputs_of_its_cells(tmp_path: Path) -> None:
    example = next(example for example in EXAMPLES if example.notebook)
    nbformat.validate(json.loads(notebooks.write(example)))
    quick = replace(example, notebook=("print('seen')\n1 + 1", "x = 3"))
    file = tmp_path / "quick.ipynb"
    file.write_text(notebooks.write(quick), encoding="utf-8")
    assert notebooks.execute(file) == [2]
    found = json.loads(file.read_text(encoding="utf-8"))
    nbformat.validate(found)
    shown = [
        [next(iter(output.keys() & {"text", "data"})) for output in cell["outputs"]] for cell in found["cells"][1:]
    ]
    assert shown == [["text", "data"], []]
    assert found["cells"][1]["outputs"][1]["data"] == {"text/plain": ["2"]}


def test_the_reference_of_python_lists_every_public_name() -> None:
    assert sorted(reference.FIRST) == sorted(mbsrun.__all__)
