"""A plugin of pytest that notes which lines each test executes: of Python by `coverage`, of C by gcov.

`MBS_WATCH` names the folder of the notes. It gets `python.db`, with the ids of tests as contexts, `tests.jsonl` with
the id and the processor time of each test, and `counts/N` with the counts of C of the N-th test. The compiler is this
file too, as a program that adds counters to the project's own C: `CC` names it.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER = "MBS_WATCH"
FLUSH = "mbs_watch_flush"
FLUSH_SOURCE = f"""
void __gcov_dump(void);
void __gcov_reset(void);
void {FLUSH}(void);
void {FLUSH}(void) {{ __gcov_dump(); __gcov_reset(); }}
"""
COMPILER = "gcc"
LONGEST = 8.0  # s of processor; longer tests are not watched


class Watching:
    """Notes of one run."""

    def __init__(self, folder: Path) -> None:
        """Begin to count lines of Python, before the project's modules are imported."""
        import coverage  # of this plugin alone: no test needs it

        self.folder, self.flushes = folder, dict[str, Any]()
        self.known = len(_read_lines(folder / "tests.jsonl"))
        self.python = coverage.Coverage(
            data_file=str(folder / "python.db"), data_suffix=True, source=[str(ROOT / "python")], config_file=False
        )
        self.python.start()

    def pytest_runtest_protocol(self, item: Any) -> Generator[None, object, object]:
        """Attribute what a test executes, with its fixtures, to it."""
        from tests.durations import measure_processor

        self._flush("none")
        os.environ["GCOV_PREFIX"] = str(self.folder / "counts" / str(self.known))
        self.python.switch_context(item.nodeid)
        start = measure_processor()
        result = yield
        told = {"test": item.nodeid, "seconds": round(measure_processor() - start, 2)}
        self.python.switch_context("")
        self._flush(str(self.known))
        self.known += 1
        with (self.folder / "tests.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(told) + "\n")
        return result

    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        """Leave out the tests that take too long to be run for every fault."""
        from tests.durations import name_function, read_durations

        known = read_durations()
        long = [item for item in items if known.get(name_function(item.nodeid), 0.0) > LONGEST]
        config.hook.pytest_deselected(items=long)
        items[:] = [item for item in items if item not in long]

    def pytest_sessionfinish(self) -> None:
        """Write the notes."""
        self.python.stop()
        self.python.save()
        os.environ["GCOV_PREFIX"] = str(self.folder / "counts" / "none")

    def _flush(self, name: str) -> None:
        """Write the counts of all loaded libraries, and let them begin at 0."""
        os.environ["GCOV_PREFIX"] = str(self.folder / "counts" / name)
        for line in _read_lines(Path("/proc/self/maps")):
            path = line.split(maxsplit=5)[-1]
            if ".so" in path and path not in self.flushes and not path.startswith(("/usr", "/lib", sys.prefix)):
                try:
                    self.flushes[path] = getattr(ctypes.CDLL(path), FLUSH, None)
                except OSError:
                    self.flushes[path] = None
        for flush in filter(None, self.flushes.values()):
            flush()


def _read_lines(path: Path) -> list[str]:
    return path.read_text("utf-8").splitlines() if path.exists() else []


def pytest_configure(config: Any) -> None:
    """Watch where a folder is named."""
    if FOLDER in os.environ:
        import pytest

        Watching.pytest_runtest_protocol = pytest.hookimpl(wrapper=True)(Watching.pytest_runtest_protocol)  # type: ignore[method-assign]
        config.pluginmanager.register(Watching(Path(os.environ[FOLDER])))


def compile_with_counters(arguments: list[str]) -> int:
    """Compile as asked, with counters in the project's own files, and keep the notes that gcov needs."""
    folder = Path(os.environ[FOLDER])
    own = {path.name for path in (*ROOT.glob("csrc/**/*.c"), *ROOT.glob("tests/csrc/laws/*.c"))}
    sources = [Path(word).name for word in arguments if word.endswith(".c")]
    is_link = "-c" not in arguments and "-E" not in arguments
    words = [re.sub(r"^-O[23]$", "-O1", word) for word in arguments]
    if not is_link and not own.intersection(sources):
        return subprocess.run([COMPILER, *words], check=False).returncode
    if "-shared" in words:
        source = folder / "flush.c"
        source.write_text(FLUSH_SOURCE, encoding="utf-8")
        words.append(str(source))
    done = subprocess.run([COMPILER, *words, "-w", "--coverage"], check=False)
    out = Path(words[words.index("-o") + 1]).absolute().parent if "-o" in words else Path.cwd()
    for note in out.glob("*.gcno"):
        kept = folder / "notes" / str(note).lstrip("/")
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(note, kept)
    return done.returncode


if __name__ == "__main__":
    sys.exit(compile_with_counters(sys.argv[1:]))
