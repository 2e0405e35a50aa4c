"""Planted faults, and the tests that must notice them: `faults.toml`, read and applied to a copy of the tree."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIST = Path(__file__).parent / "faults.toml"
EQUIVALENT = Path(__file__).parent / "equivalent.toml"
GOLDEN = "tests/test_golden.py"  # shows that something changed, not that it is wrong: it kills no fault

FILES = (  # that faults are drawn in
    "csrc/stages/*.c",
    *(f"csrc/mbs_{name}.c" for name in ("check", "cone", "dense", "explicit", "least", "many", "radau", "rollout")),
    *(f"csrc/mbs_{name}.c" for name in ("stepping", "variational")),
    *(f"csrc/kkt/mbs_{name}.c" for name in ("front", "ipopt", "ldl", "order", "partners", "plan")),
    *(f"csrc/{name}/*.c" for name in ("cases", "fmi", "program", "threads")),
    *(f"python/mbsrun/{name}/*.py" for name in ("controllers", "linearisation", "recordings", "tracking")),
    "python/mbsrun/simulation/**/*.py",
    "python/mbsrun/ocp/*/**/*.py",
)


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


def read_equivalent() -> dict[tuple[str, str, str], str]:
    """Read the drawn faults that were judged to change nothing: the reasons by file, text and what takes its place."""
    found = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("fault", [])
    return {(entry["file"], entry["find"], entry["replace"]): entry["reason"] for entry in found}


def list_files(only: str = "") -> list[str]:
    """List the files that faults are drawn in."""
    found = {path.relative_to(ROOT).as_posix() for pattern in FILES for path in ROOT.glob(pattern)}
    return sorted(file for file in found if only in file)
