"""Programs that others wrote, in an environment beside the project's own: `python -m tests.peers FOLDER` makes it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / "peers"  # where `.ci/run` installs them
WHEELS = (
    "dymos==1.15.1",
    "openmdao==3.45.1",
    "networkx",
    "requests",
    "urllib3",
    "idna",
    "certifi",
    "charset-normalizer",
    "opensim==4.6",
)
PACKAGES = ("dymos", "opensim")


def make(folder: Path) -> None:
    """Install the wheels beside the packages of this interpreter, unless they are there."""
    if not all((folder / package).exists() for package in PACKAGES):
        options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--target", str(folder))
        subprocess.run([sys.executable, "-m", "pip", "install", *options, *WHEELS], check=True)
