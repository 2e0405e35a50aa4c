"""A wheel holds all that generation needs; an editable install reads the checkout and copies nothing.

Nothing here asks the network: the wheels are built by the installed hatchling, and installed without dependencies.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = (
    *("pyproject.toml", "README.md", "LICENSE", "LICENSE-GENERATED"),
    *("generator", "python", "templates", "csrc", "studies"),
)
PLACES = """\
import mbsgen, mbsrun
from mbsgen.resources import folder
print(mbsgen.__file__, mbsrun.__file__, folder("templates"), folder("csrc"))
"""


def run(*command: str | Path, **environment: str) -> str:
    """Run a command away from the checkout; a failure shows what it said."""
    done = subprocess.run(
        command, cwd="/", env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def files_below(folder: Path) -> set[str]:
    return {
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }


def test_parts_of_the_package_are_installed_from_its_folder() -> None:
    """No index has this package, so `NAME[part]` finds nothing; `.[part]` names a part of it."""
    parts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    texts = {
        file: file.read_text("utf-8")
        for folder in ("docs", "generator", "python", "studies", "website", "benchmarks", "README.md")
        for file in ([ROOT / folder] if (ROOT / folder).is_file() else (ROOT / folder).rglob("*"))
        if file.suffix in (".py", ".md", ".ipynb")
    }
    named = {part for text in texts.values() for part in re.findall(r"install (?:-e )?'?\.\[(\w+)\]", text)}
    assert not [file for file, text in texts.items() if re.search(r"\bmbsgen\[\w+\]", text)]
    assert {"compiler", "mesh", "notebook", "study"} <= named <= set(parts)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy what a build reads, so that building leaves nothing in the real checkout."""
    copy = tmp_path_factory.mktemp("checkout")
    for name in PROJECT:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, copy)
    return copy


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", out],
        cwd=checkout,
        capture_output=True,
        check=True,
    )
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel in a separate folder; on PYTHONPATH it precedes any other install."""
    target = tmp_path_factory.mktemp("installed")
    run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", target, wheel)
    return target


def test_the_wheel_holds_both_packages_with_templates_csrc_and_licences(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for source, place in {
        "generator/mbsgen": "mbsgen",
        "python/mbsrun": "mbsrun",
        "templates": "mbsgen/templates",
        "csrc": "mbsgen/csrc",
        "studies": "mbsrun/sources/studies",
    }.items():
        wanted = {f"{place}/{file}" for file in files_below(ROOT / source)}
        assert wanted, f"{source} is empty"
        assert wanted <= names
    licences = {name.rpartition("/")[2] for name in names if "/licenses/" in name}
    assert licences == {"LICENSE", "LICENSE-GENERATED"}


def test_an_installed_wheel_reads_its_own_files(installed: Path) -> None:
    places = run(sys.executable, "-c", PLACES, PYTHONPATH=str(installed)).split()
    expected = ("mbsgen/__init__.py", "mbsrun/__init__.py", "mbsgen/templates", "mbsgen/csrc")
    assert places == [str(installed / place) for place in expected]


@pytest.mark.parametrize(("study", "given"), [("study", "problem.ocp.yaml"), ("lab", "F99")])
def test_an_installed_wheel_starts_studies(installed: Path, study: str, given: str) -> None:
    """A problem or a case that is missing is refused by the study itself, with 2 and without a traceback."""
    command = [sys.executable, "-m", "mbsrun", study, given]
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    done = subprocess.run(command, cwd="/", env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert given in done.stderr
    assert "Traceback" not in done.stderr


def test_an_installed_wheel_generates_the_committed_bytes(installed: Path, tmp_path: Path) -> None:
    model, golden, out = (
        ROOT / "models" / "double_pendulum.yaml",
        ROOT / "generated" / "double_pendulum",
        tmp_path / "out",
    )
    run(installed / "bin" / "mbsgen", model, "-o", out, "--python", "--matlab", PYTHONPATH=str(installed))
    assert files_below(out) == files_below(golden)
    assert not [file for file in files_below(golden) if (out / file).read_bytes() != (golden / file).read_bytes()]


def test_an_installed_wheel_compiles_where_the_machine_has_no_compiler(installed: Path, tmp_path: Path) -> None:
    """With Zig's, for this machine and for the page's module."""
    pytest.importorskip("ziglang")
    page, environment = tmp_path / "page.html", {"PYTHONPATH": str(installed), "PATH": str(tmp_path)}
    run(sys.executable, "-m", "mbsrun", "playground", ROOT / "models" / "pendulum.yaml", "-o", page, **environment)
    assert '"name": "pendulum"' in page.read_text(encoding="utf-8")


def test_an_editable_install_reads_the_checkout_and_copies_nothing(checkout: Path, tmp_path: Path) -> None:
    """In a separate environment, where no other install of the project can replace this one."""
    venv.create(tmp_path / "venv", symlinks=True)
    python = tmp_path / "venv" / "bin" / "python"
    dependencies = sysconfig.get_path("purelib")  # on PYTHONPATH: its packages count, its `.pth` files don't
    options = ("--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--ignore-installed")
    run(python, "-m", "pip", "install", *options, "--editable", checkout, PYTHONPATH=dependencies)
    places = run(python, "-c", PLACES, PYTHONPATH=dependencies).split()
    expected = ("generator/mbsgen/__init__.py", "python/mbsrun/__init__.py", "templates", "csrc")
    assert places == [str(checkout / place) for place in expected]
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    assert not {file for file in files_below(site) if file.startswith(("mbsgen/", "mbsrun/"))}
