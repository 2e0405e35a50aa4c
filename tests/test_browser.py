"""The page that generates in a browser: it moves before Python is there, takes a change, and says what is wrong."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from mbsgen.browser import answer
from website.browser import bundle

ROOT = Path(__file__).parents[1]
VISIT = Path(__file__).parent / "browser_visit.html"
LONGEST = 300.0  # s, with Python, on a machine that does other things
DRAWING = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the page; what is fetched and compiled stays in build/. Another mechanism stands for the swing-up."""
    folder = tmp_path_factory.mktemp("page")
    try:
        bundle.write(folder, ROOT / "build" / "site-browser", _write_other(folder / "other.html"))
    except bundle.BundleError as error:
        pytest.skip(str(error))
    shutil.copy(VISIT, folder / "visit.html")
    return folder


def _write_other(page: Path) -> Path:
    """Write a page of `mbsrun playground` without a controller, which takes no compiler here."""
    found = json.loads(answer((ROOT / "models" / "cart_pole.yaml").read_text(encoding="utf-8")))
    actor = {"name": "cart_pole", "frames": found["picture"]["frames"], "solids": [], "lines": []}
    scene = {"bounds": {"low": [-1, -1, -1], "high": [1, 1, 1]}, "meshes": [], "mechanisms": [actor]}
    ends = found["picture"]["ends"]
    content = json.dumps({"machine": found["machine"], "controllers": [], "scene": scene, "added": ends})
    page.write_text(bundle.fill_scripts().replace("@CONTENT@", content), encoding="utf-8")
    return page


class _Visited(ThreadingHTTPServer):
    """Serves a folder, and keeps what the visitor posts."""

    def __init__(self, folder: Path) -> None:
        self.found: dict[str, Any] = {}
        self.asked: list[str] = []
        self.done = threading.Event()
        server = self

        class Handler(SimpleHTTPRequestHandler):
            def __init__(self, *args: Any) -> None:
                super().__init__(*args, directory=str(folder))

            def log_message(self, *_: Any) -> None:
                server.asked.append(self.path)

            def do_POST(self) -> None:
                server.found = json.loads(self.rfile.read(int(self.headers["content-length"])))
                self.send_response(204)
                self.end_headers()
                server.done.set()

        super().__init__(("127.0.0.1", 0), Handler)


@pytest.fixture
def server(site: Path) -> Iterator[_Visited]:
    with _Visited(site) as found:
        threading.Thread(target=found.serve_forever, daemon=True).start()
        yield found
        found.shutdown()


def test_a_visitor_sees_it_move_and_changes_it(
    server: _Visited, tmp_path: Path, requires: Callable[[str], str]
) -> None:
    """The double pendulum moves first, then its changed model; a fault is a sentence, and the mechanism stays."""
    options = ("--headless", "--no-sandbox", f"--user-data-dir={tmp_path}", *DRAWING)
    address = f"http://127.0.0.1:{server.server_port}/visit.html"
    with subprocess.Popen([requires("chromium"), *options, address], stderr=subprocess.DEVNULL) as browser:
        is_done = server.done.wait(LONGEST)
        browser.terminate()
    assert is_done
    seen = server.found
    assert seen["moving"] < seen["python"] < seen["generated"]
    assert (seen["changed"], seen["title"], seen["kept"]) == ("", "other", "other")
    assert seen["equations"]
    assert seen["swing"] == "cart_pole"
    assert seen["report"].startswith("# What other costs")
    assert "model.yaml:9: parameters.m2" in seen["fault"] or "bodies[1].mass: a mass of -3" in seen["fault"]


def test_the_answer_is_the_faults_of_the_command_line() -> None:
    """Each is a sentence with its line; the folder of the browser's file is not shown."""
    found = json.loads(answer("name: rod\nbodies:\n  - name: a\n    mass: -1\n"))
    assert [each.split(":")[:2] for each in found["faults"]] == [["model.yaml", line] for line in "134"]


def test_loops_are_refused_in_one_sentence() -> None:
    """They need NumPy, which the page lacks."""
    found = json.loads(answer((ROOT / "models" / "four_bar.yaml").read_text(encoding="utf-8")))
    assert len(found["faults"]) == 1
    assert "`mbsrun playground`" in found["faults"][0]
