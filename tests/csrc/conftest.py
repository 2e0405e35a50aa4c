"""The solver for problems in stages, compiled once for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.csrc.stages import Library, compile_solver


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_solver(tmp_path_factory.mktemp("stages"))


@pytest.fixture(scope="session")
def library(compiled: Path) -> Library:
    return Library(compiled)


@pytest.fixture(scope="session")
def single(tmp_path_factory: pytest.TempPathFactory) -> Library:
    """The solver in single precision."""
    return Library(compile_solver(tmp_path_factory.mktemp("single"), "-DMBS_STAGES_FLOAT", "-O0"), "float")
