"""The same model gives the same bytes as when `generated/` was committed, under any hash seed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.golden import GOLDEN, ROOT

GENERATE = "import sys, pathlib, tests.golden; tests.golden.write_golden(sys.argv[1], pathlib.Path(sys.argv[2]))"


def read_folder(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("seed", ["0", "1"])
@pytest.mark.parametrize("name", GOLDEN)
def test_generated_code_is_as_committed(name: str, seed: str, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    subprocess.run([sys.executable, "-c", GENERATE, name, tmp_path / name], cwd=ROOT, env=environment, check=True)
    golden, fresh = read_folder(ROOT / "generated" / name), read_folder(tmp_path / name)
    assert sorted(fresh) == sorted(golden)
    changed = [file for file in golden if fresh[file] != golden[file]]
    assert not changed, "if the change is meant: `make golden`, and read the difference"


def test_every_committed_folder_is_compared() -> None:
    assert sorted(folder.name for folder in (ROOT / "generated").iterdir()) == sorted(GOLDEN)
