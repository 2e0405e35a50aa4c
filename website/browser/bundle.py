"""The page that generates in a browser: Pyodide, the generator with its packages as bytecode, a first mechanism.

Pyodide and pydantic's WebAssembly come from npm and PyPI, at the versions of `package-lock.json` and of the installed
pydantic. All other packages are copied from this Python, since they are Python alone. The built page loads nothing from
elsewhere.
"""

from __future__ import annotations

import base64
import hashlib
import importlib
import json
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mbsgen import browser, resources
from mbsrun.simulation.integration.tableaus import DOP853, EULER, RK4, RK45

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FOLDER = "try"  # of the site
FILES = ("pyodide.mjs", "pyodide.asm.mjs", "pyodide.asm.wasm", "python_stdlib.zip", "pyodide-lock.json")
PACKAGES = ("sympy", "mpmath", "jinja2", "markupsafe", "pydantic", "annotated_types", "typing_inspection", "yaml")
MODULES = ("typing_extensions",)
PLATFORM = (
    "--platform",
    "pyemscripten_2026_0_wasm32",
    "--python-version",
    "314",
    "--implementation",
    "cp",
    "--abi",
    "cp314",
)
LEFT_OUT = ("tests", "__pycache__", "benchmarks", "*.so", "*.pyi")
UNUSED = ("physics", "stats", "vector", "codegen", "categories", "diffgeom", "holonomic", "crypto", "v1")  # of packages
SCRIPTS = ("renderer.js", "kernels.js", "playground.js")
OWN = ("index.html", "page.js", "worker.js", "front.js", "front-worker.js", "chart.js")
METHODS = (("euler", 1, EULER), ("rk4", 4, RK4), ("rk45", 5, RK45), ("dop853", 8, DOP853))  # with orders
LINK = f"""
## Without an installation

[This page]({FOLDER}/index.html) runs the generator in the browser: change the model, and see it move, with its
equations and operation counts.
"""
GALLERY = "[Gallery](gallery/index.md){ .md-button }\n"  # a button of the front page
BUTTON = f"[Try it here]({FOLDER}/index.html){{ .md-button }}\n"
FIRST = "double_pendulum"  # the mechanism that moves at once


class BundleError(Exception):
    """A program or package that the page is made of is missing."""


def write(out: Path, work: Path, swing_up: Path | None = None) -> None:
    """Write the page into a folder; `work` keeps what was fetched and compiled. Raises BundleError.

    swing_up: a page of `mbsrun playground` with a controller, which a button shows.
    """
    work = work.resolve()  # programs run there
    out.mkdir(parents=True, exist_ok=True)
    pyodide = _fetch_pyodide(work)
    _copy(pyodide, out / "pyodide", FILES)
    shutil.copy(_compile(pyodide, work), out / "tool.zip")
    _copy(HERE, out, OWN)
    _copy(resources.folder("templates") / "html", out, ("kernels.js",))
    (out / "mechanism.html").write_text(fill_scripts(), encoding="utf-8")
    (out / "methods.json").write_text(json.dumps(list_methods()), encoding="utf-8")
    text = (ROOT / "models" / f"{FIRST}.yaml").read_text(encoding="utf-8")
    if swing_up is not None:
        shutil.copy(swing_up, out / "swing_up.html")
    first = {"text": text, "swings": swing_up is not None, **json.loads(browser.answer(text))}
    (out / "first.json").write_text(json.dumps(first), encoding="utf-8")


def list_methods() -> list[dict[str, Any]]:
    """List the coefficients of methods of fixed steps, without stages that serve estimates of errors alone."""
    found = []
    for name, order, pair in METHODS:
        A, b = pair.tableau.A, pair.tableau.b
        stages = max(k for k, weight in enumerate(b, 1) if weight)
        found.append({"name": name, "order": order, "A": A[:stages], "b": b[:stages]})
    return found


def link(pages: Path) -> None:
    """Add to the guide of playgrounds, and to the buttons of the front page, that the page is there."""
    with (pages / "playground.md").open("a", encoding="utf-8") as file:
        file.write(LINK)
    front = pages / "index.md"
    text = front.read_text(encoding="utf-8")
    assert GALLERY in text, "the front page has a button of the gallery"
    front.write_text(text.replace(GALLERY, GALLERY + BUTTON), encoding="utf-8")


def _copy(source: Path, target: Path, names: tuple[str, ...]) -> None:
    target.mkdir(exist_ok=True)
    for name in names:
        shutil.copy(source / name, target / name)


def _run(*command: str | Path, cwd: Path) -> None:
    program = shutil.which(str(command[0]))
    if program is None:
        raise BundleError(f"{command[0]} is not installed; the page that generates in a browser is made with it")
    done = subprocess.run([program, *command[1:]], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BundleError(f"{command[0]} failed: {(done.stderr or done.stdout).strip()}")


def _fetch_pyodide(work: Path) -> Path:
    """Install the locked npm package, and return its folder."""
    folder = work / "npm"
    folder.mkdir(parents=True, exist_ok=True)
    _copy(HERE, folder, ("package.json", "package-lock.json"))
    found = folder / "node_modules" / "pyodide"
    if not found.is_dir():
        _run("npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", cwd=folder)
    return found


def _compile(pyodide: Path, work: Path) -> Path:
    """Return the archive of bytecode; it is made anew where a source has changed."""
    given = work / "given"
    shutil.rmtree(given, ignore_errors=True)
    given.mkdir()
    for name in PACKAGES:
        shutil.copytree(_find(name).parent, given / name, ignore=shutil.ignore_patterns(*LEFT_OUT, *UNUSED))
    for name in MODULES:
        shutil.copy(_find(name), given)
    shutil.copytree(ROOT / "generator" / "mbsgen", given / "mbsgen", ignore=shutil.ignore_patterns(*LEFT_OUT))
    for name in ("templates", "csrc"):
        shutil.copytree(resources.folder(name), given / "mbsgen" / name, ignore=shutil.ignore_patterns("build"))
    _unpack_pydantic(work, given)
    archive = work / f"{_hash(given)}.zip"
    if not archive.exists():
        _run("node", HERE / "compile.mjs", pyodide, given, archive, cwd=work)
    return archive


def _find(name: str) -> Path:
    file = importlib.import_module(name).__file__
    assert file is not None, "a package of the environment is a file"
    return Path(file)


def _unpack_pydantic(work: Path, given: Path) -> None:
    """Unpack pydantic's compiled part, of the version that the installed pydantic needs."""
    wheels = work / "wheels"
    if not list(wheels.glob("*.whl")):
        wanted = f"pydantic_core=={version('pydantic_core')}"
        _run(
            sys.executable,
            "-m",
            "pip",
            "download",
            "-q",
            "--no-deps",
            "--abi",
            "cp314",
            *PLATFORM,
            "-d",
            wheels,
            wanted,
            cwd=work,
        )
    (wheel,) = wheels.glob("*.whl")
    shutil.unpack_archive(wheel, given, "zip")


def _hash(folder: Path) -> str:
    digest = hashlib.sha256((HERE / "compile.mjs").read_bytes())
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(str(file.relative_to(folder)).encode() + file.read_bytes())
    return digest.hexdigest()[:40]


def fill_scripts() -> str:
    """Return the page of `mbsrun playground` with its scripts, and with room for a mechanism."""
    folder = resources.folder("templates") / "html"
    script = "".join((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    page = (folder / "playground.html").read_text(encoding="utf-8")
    return page.replace("@SCRIPT_HASH@", f"sha256-{digest}").replace("@SCRIPT@", script)
