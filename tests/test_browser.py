"""The page that generates in a browser: it moves before Python is there, takes a change, and says what is wrong."""

from __future__ import annotations

import itertools
import json
import math
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbsrun
from mbsgen.browser import answer
from mbsgen.picture import describe_picture
from mbsrun.animation.actors import BALL, LARGEST, THINNEST, make_actor
from mbsrun.animation.visuals import show_drawings
from mbsrun.measuring.fronts import Dot, state_finding
from mbsrun.skeleton import place
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
    assert seen["costs"] == ["", "IMPL", "SEMI", "EXP1", "EXP2"]
    assert seen["lines"] == 4
    assert {"euler", "rk4", "rk45", "dop853"} <= {name.split(" on ")[0] for name in seen["names"]}
    assert seen["finding"].endswith(".")
    assert " on EXP" in seen["finding"]
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


# --- the front of error against time ---

NODE = """
const { vm, fs } = { vm: require("node:vm"), fs: require("node:fs") };
for (const file of %s) vm.runInThisContext(fs.readFileSync(file, "utf8").replace("typeof module", "typeof absent"));
const given = JSON.parse(fs.readFileSync(0, "utf8"));
(async () => console.log(JSON.stringify(await (%s)(given))))();
"""
FILES = [str(ROOT / "templates" / "html" / "kernels.js"), str(ROOT / "website" / "browser" / "front.js")]


def _run_scripts(node: str, function: str, given: Any) -> Any:
    done = subprocess.run(
        [node, "-e", NODE % (json.dumps(FILES), function)],
        input=json.dumps(given),
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_the_finding_is_the_sentence_of_the_charts(requires: Callable[[str], str]) -> None:
    """For drawn works and errors, the page and `mbsrun chart` state the same."""
    rng = np.random.default_rng(3)
    panels = [
        [
            {"line": f"m{k % 4} on EXP2", "setting": "", "work": float(w), "error": float(e)}
            for k, (w, e) in enumerate(10.0 ** np.column_stack((rng.uniform(-6, -2, 24), rng.uniform(-14, 3, 24))))
        ]
        for _ in range(200)
    ]
    floors = [float(10.0 ** rng.uniform(-16, -6)) for _ in panels]
    function = "(all) => all.map(([dots, floor]) => stateFinding(dots, floor))"
    found = _run_scripts(requires("node"), function, [*zip(panels, floors, strict=True)])
    expected = [
        state_finding([Dot(x["line"], "", x["work"], x["error"]) for x in dots], floor)
        for dots, floor in zip(panels, floors, strict=True)
    ]
    assert found == expected


def test_fixed_steps_have_the_order_of_their_method(requires: Callable[[str], str]) -> None:
    """The double pendulum ends where SciPy's integration of its kernel does; halved steps divide errors by 2^order."""
    text = (ROOT / "models" / "double_pendulum.yaml").read_text(encoding="utf-8")
    methods = bundle.list_methods()
    given = {"machine": json.loads(answer(text))["machine"], "methods": methods}
    found = _run_scripts(requires("node"), "({ machine, methods }) => measureFront(machine, methods)", given)
    kernels = mbsrun.load(ROOT / "models" / "double_pendulum.yaml")

    def rate(_: float, y: Any) -> Any:
        return np.concatenate((y[2:], kernels.exp2(q=y[:2], qd=y[2:], u=[])["qdd"]))

    end = solve_ivp(rate, (0, 1), [0, 0, 1, 1], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(found["end"], end, atol=1e-11)  # SciPy's tolerance of a step, times their number
    assert found["floor"] < 1e-12
    for method in methods:
        errors = [x["error"] for x in found["dots"] if x["line"].startswith(f"{method['name']} ")]
        slopes = [math.log2(a / b) for a, b in itertools.pairwise(errors) if 1e-11 < b < a < 1e-2]
        assert slopes[-1] > method["order"] - 0.5, method["name"]


# --- the picture ---

SHAPES = """
name: shapes
gravity: [0, 0, -9.81]
bodies:
  - name: arm
    joint: {name: a, type: revolute, axis: y}
    mass: 1
    com: [0, 0, -0.5]
    visual:
      - {shape: capsule, radius: 0.02, length: 1, position: [0, 0, -0.5], color: "#123456"}
      - {shape: sphere, radius: 0.1, position: [0, 0, -1]}
  - name: tool
    parent: arm
    joint: {name: b, type: prismatic, axis: x, position: [0, 0, -1]}
    mass: 2
    visual: {shape: box, size: [0.1, 0.2, 0.3]}
  - name: load
    parent: tool
    joint: {name: c, type: prismatic, axis: z}
    mass: 3
forces:
  - {name: rope, type: cable, from: {body: base, position: [0, 0, 1]}, to: {body: load}, stiffness: 100, rest: 1}
"""


@pytest.mark.parametrize("name", ["double_pendulum", "satellite", "legged/bounder", "shapes"])
def test_the_picture_is_the_one_of_animations(name: str, tmp_path: Path) -> None:
    """Solids equal the solids of `mbsrun animate`, with the sizes that are limited there; drums of joints have none."""
    path = tmp_path / "model.yaml"
    path.write_text(SHAPES if name == "shapes" else (ROOT / "models" / f"{name}.yaml").read_text(encoding="utf-8"))
    kernels = mbsrun.load(path)
    picture = describe_picture(kernels.manifest)
    q = np.zeros(len(kernels.manifest.positions))
    q[[first + 3 for first in kernels.manifest.quaternions]] = 1.0
    visuals = tuple(show_drawings(kernels.manifest))
    actor = make_actor(name, kernels.manifest, place(kernels, q[None]), visuals=visuals)
    assert len(picture["solids"]) == len(actor.solids)
    for given, solid in zip(picture["solids"], actor.solids, strict=True):
        assert (given["layer"], given["frame"], given["kind"]) == (solid.layer, solid.frame, solid.kind)
        assert given["color"] == solid.color
        np.testing.assert_allclose(given["at"], solid.at, atol=1e-12)
        if given["layer"] != "joints":
            size = np.array(given["size"])
            wanted = BALL * actor.size * size if "ball" in given else size
            if given["layer"] == "solids":
                wanted = np.clip(wanted, THINNEST * actor.size, LARGEST * actor.size)
            elif given["layer"] == "contacts":
                wanted = np.maximum(wanted, 0.018 * actor.size)
            np.testing.assert_allclose(
                _spread(wanted, given["axes"]), _spread(solid.size, solid.axes), atol=1e-9 * actor.size**2
            )
    assert [(x["kind"], x["ends"]) for x in picture["lines"]] == [
        (line.kind, [{"frame": end.frame, "at": list(end.at)} for end in line.ends]) for line in actor.lines
    ]


def _spread(size: Any, axes: Any) -> Any:
    """Return a matrix of the edges and the axes of a solid that does not depend on signs and on the order of axes."""
    turn = np.array(axes).reshape(3, 3)
    return turn.T @ np.diag(np.square(size)) @ turn
