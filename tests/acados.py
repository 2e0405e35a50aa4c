"""A separate environment for acados: `python3 tests/acados.py FOLDER`.

The wheel contains acados' library, its template renderer and its Python interface. The interface looks for them in the
layout of a source tree, ACADOS_SOURCE_DIR; so the folder gets links in that layout. Only Python is needed.
"""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

WHEELS = ("comma-deps-acados==0.2.2.post92", "casadi>=3.6", "cffi", "numpy", "scipy", "setuptools<81")


def make(folder: Path) -> None:
    """Make the environment, unless it is there."""
    if not (folder / "source" / "lib").exists():
        venv.create(folder, with_pip=True)
        python = folder / "bin" / "python"
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *WHEELS], check=True)
        (package,) = folder.glob("lib/python3.*/site-packages/acados")
        interface = folder / "source" / "interfaces" / "acados_template"
        interface.mkdir(parents=True)
        (interface / "acados_template").symlink_to(package / "acados_template")
        for part in ("bin", "include", "lib"):
            (folder / "source" / part).symlink_to(package / "install" / part)


def variables(folder: Path) -> dict[str, str]:
    """Return the environment variables under which the environment's Python finds acados."""
    source = folder / "source"
    return {
        "ACADOS_SOURCE_DIR": str(source),
        "LD_LIBRARY_PATH": str(source / "lib"),
        "PYTHONPATH": str(source / "interfaces" / "acados_template"),
    }


if __name__ == "__main__":
    make(Path(sys.argv[1]).resolve())
