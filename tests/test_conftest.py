"""A missing tool is a visible skip for a developer and a failure in CI."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

A_TEST = """
def test_it(requires):
    requires("what-nobody-has")
"""
A_MODULE = """
import pytest
pytest.importorskip("what-nobody-has")
"""


def test_a_tool_on_the_path_is_found(requires: Callable[[str], str]) -> None:
    assert os.access(requires("sh"), os.X_OK)


@pytest.mark.parametrize("source", [A_TEST, A_MODULE], ids=["test", "module"])
@pytest.mark.parametrize(("ci", "word"), [("", "SKIPPED"), ("true", "CI skips nothing")])
def test_what_is_missing_skips_at_home_and_fails_in_ci(tmp_path: Path, source: str, ci: str, word: str) -> None:
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "test_it.py").write_text(source, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", tmp_path],
        env={**os.environ, "CI": ci},
        capture_output=True,
        text=True,
        check=False,
    )
    passes = run.returncode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    assert passes == (not ci), run.stdout
    assert word in run.stdout
    assert "what-nobody-has" in run.stdout


def test_skips_are_listed(pytestconfig: pytest.Config) -> None:
    assert "-rs" in pytestconfig.getini("addopts")
