"""OpenSim in another process, since it brings libraries that no process can share with ours.

It is the one of the Python that MBSGEN_OPENSIM names, or that `python -m tests.peers build/peers` installed.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import peers


def ask(script: Path, text: str = "", folder: Path | None = None) -> str:
    """Return the last line that a script prints for an input; skip the test where OpenSim is missing."""
    python, path = os.environ.get("MBSGEN_OPENSIM"), os.environ.get("PYTHONPATH", "")
    if python is None and not (peers.FOLDER / "opensim").exists():
        pytest.skip("python -m tests.peers build/peers installs OpenSim; MBSGEN_OPENSIM names a Python that has it")
    own = os.pathsep.join([path, str(peers.FOLDER)])
    run = subprocess.run(
        [python or sys.executable, str(script)],
        input=text,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path if python else own},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()[-1]
