"""Libraries that the tests compile are kept apart from the user's, and shared by the processes of a run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """Name a folder of this run; under pytest-xdist all its workers have the same."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if hasattr(request.config, "workerinput") else own


@pytest.fixture(scope="session", autouse=True)
def cache(run_folder: Path) -> Iterator[Path]:
    """Compile into a cache of the run's own, with the compiler's plain flags."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(run_folder / "cache"))
        patch.delenv("CFLAGS", raising=False)
        yield run_folder / "cache" / "mbsgen"
