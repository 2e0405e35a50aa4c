"""The smallest models of all kinds: a quick look at each, before `tests/test_commands.py` tries every command."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from mbsgen.cli import cli
from tests.model_kinds import KINDS, write_model


@pytest.mark.parametrize("name", KINDS)
def test_a_kind_is_read_or_refused(name: str, tmp_path: Path) -> None:
    """`check` and `show` accept all of them but the ones in which nothing can move."""
    file = tmp_path / f"{name}.yaml"
    file.write_text(write_model(name), "utf-8")
    refused = KINDS[name].refused.get("")
    for command in ("check", "show"):
        done = CliRunner().invoke(cli, [command, str(file)])
        if refused is None:
            assert done.exit_code == 0, done.output
        else:
            assert refused in str(done.exception)
