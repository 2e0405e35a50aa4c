"""Planted faults, and the tests that must notice them: `faults.toml`, read and applied to a copy of the tree."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIST = Path(__file__).parent / "faults.toml"
GOLDEN = "tests/test_golden.py"  # shows that something changed, not that it is wrong: it kills no fault


@dataclass(frozen=True)
class Fault:
    """One change of the source that makes the program wrong."""

    name: str
    file: str  # below the root
    find: str  # stands in the file exactly once
    replace: str
    tests: tuple[str, ...]  # files or test ids; one of them must fail

    def apply(self, root: Path) -> None:
        """Plant the fault in the tree at `root`. Raises ValueError where the text does not stand there once."""
        path = root / self.file
        text = path.read_text(encoding="utf-8")
        if text.count(self.find) != 1:
            raise ValueError(f"{self.name}: {self.file} has {text.count(self.find)} places for {self.find!r}")
        path.write_text(text.replace(self.find, self.replace), encoding="utf-8")


def read_faults() -> list[Fault]:
    """Read the list."""
    found = tomllib.loads(LIST.read_text(encoding="utf-8"))["fault"]
    return [Fault(**{**entry, "tests": tuple(entry["tests"])}) for entry in found]
