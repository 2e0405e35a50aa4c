"""Commands of `mbsrun`, run in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mbsrun import cli

Run = Callable[..., tuple[object, str, str]]  # words -> exit code, stdout, stderr


def make_run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run commands in a folder."""
    monkeypatch.chdir(folder)

    def call(*arguments: str) -> tuple[object, str, str]:
        monkeypatch.setattr("sys.argv", ["mbsrun", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    return call
