"""Commands on recordings, in an empty folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mbsrun.running import Run, make_run


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in an empty folder."""
    return make_run(tmp_path, monkeypatch, capsys)
